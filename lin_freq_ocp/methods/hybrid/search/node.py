"""The solution of one node of a search over modes, and when it is known well enough."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.problem.hybrid.mode_reach import Reach
from lin_freq_ocp.problem.hybrid.mode_tree import ModeMultipliers
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.hybrid.path_bounds import PathDuals
from lin_freq_ocp.program.hybrid.path_relaxation import PathRelaxation
from lin_freq_ocp.program.hybrid.relaxation import Duals, ModeRelaxation

# Relative residual and gap of a point that is good enough to say that a node must be split
CLEAR_RESIDUAL, CLEAR_GAP = 1e-3, 3e-5


@dataclass(frozen=True, eq=False)
class Relaxed:
    """The solution of one relaxation: a lower bound (inf: infeasible; -inf: not solved), and weights (T, modes)."""

    reach: Reach
    bound: float
    duals: Duals | PathDuals | None = None
    trajectory: Trajectory | None = None
    weights: Array | None = None

    @property
    def sequence(self) -> Indices | None:
        """Return the only sequence left, if there is one."""
        allowed = self.reach.allowed
        return np.argmax(allowed, axis=1) if (allowed.sum(axis=1) == 1).all() else None


@dataclass(frozen=True)
class Decision:
    """When the relaxation of a node with several sequences is known well enough, with the cutoff in its objective.

    Its bound is computed anew from the duals (``ModeRelaxation.proven``), so that they need not be those of a solution.
    """

    cutoff: float
    several: bool

    def __call__(self, cost: float, dual: float, residual: float) -> bool:
        """Return whether the bound is above the cutoff, or the node must be split, as far as a solver can tell."""
        gap = cost - dual
        if residual > CLEAR_RESIDUAL or gap < 0:
            return False
        split = self.several and gap <= CLEAR_GAP * max(1.0, abs(cost)) and cost + gap < self.cutoff
        return split or dual - gap > self.cutoff


def multipliers_of(relaxation: ModeRelaxation, duals: Duals | PathDuals) -> ModeMultipliers:
    """Return the multipliers of the duals of a node."""
    if isinstance(duals, Duals):
        return relaxation.multipliers(duals)
    assert isinstance(relaxation, PathRelaxation)
    return relaxation.path_multipliers(duals)


def adjoint_of(relaxation: ModeRelaxation, duals: Duals | PathDuals) -> Array:
    """Return eta alone, (T, n)."""
    if isinstance(duals, Duals):
        return relaxation.adjoint(duals)
    assert isinstance(relaxation, PathRelaxation)
    return relaxation.path_adjoint(duals)
