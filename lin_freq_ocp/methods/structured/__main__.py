"""Compile the loops of the structured method ahead: ``python -m lin_freq_ocp.methods.structured``."""

from lin_freq_ocp.methods.hybrid.search import path_kernels as paths
from lin_freq_ocp.methods.structured.kkt.compiled import loops

loops.KERNELS.prepare()
paths.KERNELS.prepare()
