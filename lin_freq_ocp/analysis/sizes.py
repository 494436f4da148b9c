"""Scales of a search: the unit of its gaps, and modes with the sizes of components. The judge has its own."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.analysis.measures import stated_sizes
from lin_freq_ocp.problem.dynamics.mode_arrays import ModeArrays
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory

SOLVER_ROUNDING = 1e-12
"""Deviations of states and controls, relative to their sizes, that the search does not distinguish from zero."""

FINEST_GAP = 1e-6
"""A gap that costs no more than SOLVER_ROUNDING counts as this."""


def search_scale(problem: OptimalControlProblem, trajectory: Trajectory) -> float:
    """Return the sum of the absolute terms of the cost, or what rounding errors cost, over FINEST_GAP."""
    cost, (x, u) = problem.quadratic, (trajectory.x, trajectory.u)
    linear = x[:-1] * cost.q, u * cost.r, x[-1:] * cost.p
    signed = np.append(linear[0].sum(axis=1) + linear[1].sum(axis=1), linear[2].sum())
    total = float(np.abs(cost.stage_values(x, u) - signed).sum() + sum(np.abs(part).sum() for part in linear))
    total += sum(float(np.abs(term.cost(x, u)).sum()) for term in problem.terms)
    sizes = zip(stated_sizes(problem), (x, u), strict=True)
    moved = (np.broadcast_to(SOLVER_ROUNDING * size, signal.shape) for size, signal in sizes)
    return max(total, cost.magnitudes().value(*moved) / FINEST_GAP)


def measured_modes(problem: OptimalControlProblem) -> ModeArrays:
    """Return the modes of a problem at all times, which measure components by the sizes that the data state."""
    return problem.piecewise.arrays(problem.horizon).with_sizes(*stated_sizes(problem))
