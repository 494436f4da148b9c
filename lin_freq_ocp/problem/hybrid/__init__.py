"""Dynamics and controls with modes, kinks or levels, and search trees as data."""

from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.levels import SwitchedDynamics
from lin_freq_ocp.problem.levels import LEVELS

LEVELS[LinearDynamics] = SwitchedDynamics
