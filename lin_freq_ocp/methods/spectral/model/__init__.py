"""The linear time-invariant problem in the Fourier domain: its data, its dynamics at every bin, and its kernels."""
