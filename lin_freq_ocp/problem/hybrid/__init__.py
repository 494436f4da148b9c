"""Dynamics and controls with modes, kinks or levels, and search trees as data."""

from lin_freq_ocp.problem.costs.formula_cost import PRICED
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.levels import SwitchedDynamics
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics
from lin_freq_ocp.problem.hybrid.priced import price_linear, price_smooth
from lin_freq_ocp.problem.levels import LEVELS

LEVELS[LinearDynamics] = SwitchedDynamics
PRICED[LinearDynamics] = price_linear
PRICED[PiecewiseSmoothDynamics] = price_smooth
