"""Compile the loops of the structured method ahead, if numba can: ``python -m lin_freq_ocp.methods.structured``."""

from lin_freq_ocp.methods.structured.kkt.recursions import loops

loops()
