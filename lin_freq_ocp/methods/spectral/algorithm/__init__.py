"""The active-set iterations of the Fourier-domain method, and what is read from their end."""
