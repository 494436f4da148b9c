"""Compile the loops of the structured method ahead: ``python -m lin_freq_ocp.methods.structured``."""

from lin_freq_ocp.methods.structured.kkt.kernels import KERNELS

KERNELS.prepare()
