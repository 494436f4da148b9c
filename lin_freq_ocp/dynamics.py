"""Dynamics: linear, piecewise affine and piecewise smooth."""

from lin_freq_ocp.formulas.differentiable import DifferentiableFunction
from lin_freq_ocp.problem.dynamics.affine_mode import AffineMode, SmoothPiece
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.dynamics.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.dynamics.piecewise_smooth import PiecewiseSmoothDynamics, SmoothMode

__all__ = [
    "AffineMode",
    "DifferentiableFunction",
    "LinearDynamics",
    "PiecewiseAffineDynamics",
    "PiecewiseSmoothDynamics",
    "SmoothMode",
    "SmoothPiece",
]
