"""Compile the loops of the structured method ahead: ``python -m lin_freq_ocp.methods.structured``."""

from lin_freq_ocp.methods.structured.kkt.compiled import loops, paths, small

loops.KERNELS.prepare()
small.KERNELS.prepare()
paths.KERNELS.prepare()
