"""Dynamics: linear, by frequency response, piecewise affine and piecewise smooth."""

from lin_freq_ocp.base.errors import answer_misspelt
from lin_freq_ocp.formulas.differentiable import DifferentiableFunction
from lin_freq_ocp.problem.dynamics.frequency_response import FrequencyResponse
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.dynamics.plant import ContinuousPlant
from lin_freq_ocp.problem.hybrid.affine_mode import AffineMode, SmoothPiece
from lin_freq_ocp.problem.hybrid.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics, SmoothMode
from lin_freq_ocp.problem.hybrid.pulse_train import PulseTrain

# fmt: off
__all__ = [
    "AffineMode", "ContinuousPlant", "DifferentiableFunction", "FrequencyResponse", "LinearDynamics",
    "PiecewiseAffineDynamics", "PiecewiseSmoothDynamics", "PulseTrain", "SmoothMode", "SmoothPiece",
]
# fmt: on

answer_misspelt(globals())
