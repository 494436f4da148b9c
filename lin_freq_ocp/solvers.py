"""The methods of ``solve``: objects that hold their own options."""

from lin_freq_ocp.base.errors import answer_misspelt
from lin_freq_ocp.methods.spectral.solver import SpectralSolution, SpectralSolver
from lin_freq_ocp.solving.hybrid.modes import BranchAndBound, Enumeration, MixedInteger
from lin_freq_ocp.solving.hybrid.pulse_train import Angles
from lin_freq_ocp.solving.hybrid.smooth import Nonsmooth
from lin_freq_ocp.solving.linear import Convex, Spectral, Structured

# fmt: off
__all__ = [
    "Angles", "BranchAndBound", "Convex", "Enumeration", "MixedInteger", "Nonsmooth", "Spectral", "SpectralSolution",
    "SpectralSolver", "Structured",
]
# fmt: on

answer_misspelt(globals())
