"""One node of a search over modes: its relaxation is solved as accurately as the search needs it.

Compiled code solves path relaxations. Without it, and where it stalls, Clarabel solves shares of modes. The duals of
either enter the bound over boxes (program/hybrid/path_relaxation.py), and only that bound closes a node.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.methods.hybrid.search.path_native import INFEASIBLE, STALLED, path_library, run_path
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.backends.base import Claim
from lin_freq_ocp.program.hybrid.path_relaxation import PathRelaxation
from lin_freq_ocp.program.hybrid.relaxation import ModeRelaxation
from lin_freq_ocp.program.hybrid.rows import Duals
from lin_freq_ocp.transform.hybrid.mode_reach import Reach

# Relative residual and gap of a point at which a node is known to need a split
CLEAR_RESIDUAL, CLEAR_GAP = 1e-3, 3e-5


@dataclass(frozen=True, eq=False)
class NodeSolution:
    """The solution of one relaxation: a lower bound (inf: infeasible; -inf: not solved), and weights (T, modes)."""

    reach: Reach
    bound: float
    duals: Duals | None = None
    trajectory: Trajectory | None = None
    weights: Array | None = None

    @property
    def sequence(self) -> Indices | None:
        """Return the only sequence left, if there is one."""
        allowed = self.reach.allowed
        return np.argmax(allowed, axis=1) if (allowed.sum(axis=1) == 1).all() else None


@dataclass(frozen=True)
class Decision:
    """The test by which a solver stops early at a node with several sequences, with the cutoff in its objective.

    The bound is computed anew from the duals (``ModeRelaxation.proven``), so that these need not solve the relaxation.
    """

    cutoff: float
    several: bool

    def __call__(self, cost: float, dual: float, residual: float) -> bool:
        """Return whether, by the solver's values, the bound is above the cutoff or the node must be split."""
        gap = cost - dual
        if residual > CLEAR_RESIDUAL or gap < 0:
            return False
        split = self.several and gap <= CLEAR_GAP * max(1.0, abs(cost)) and cost + gap < self.cutoff
        return split or dual - gap > self.cutoff


COMPILED_TOLERANCE = 5e-8  # residual and gap: a tenth of the half of the gap that closed leaves do not use
# A node is split as soon as its bound misses its cost by this part of the distance to the cutoff: interior points give
# better splits than solutions, and take fewer steps
CLEAR = 0.7
PROVEN = 2e-7  # distance of bound and cost, relative to the cost, at which a node is solved


def solve_path_relaxation(relaxation: PathRelaxation, reach: Reach, cutoff: float | None) -> NodeSolution | None:
    """Solve the path relaxation of a reach in C, as ``solve_relaxation``; None if that is not possible."""
    library = path_library()
    member = None if library is None else relaxation.path_member(reach)
    if library is None or member is None:
        return None
    if member.program is None:
        return NodeSolution(reach, np.inf, relaxation.no_path())
    program, clear = member.program, 0.0 if cutoff is None else CLEAR * _is_undecided(reach)
    decisive = np.inf if cutoff is None else relaxation.objective(cutoff)
    run = run_path(library, program, COMPILED_TOLERANCE, PROVEN, decisive, clear)
    w, p, z, tau = run.w, run.p, run.z, run.tau
    if run.end == STALLED or not (np.isfinite(p).all() and np.isfinite(z).all()):
        return None
    if run.end != INFEASIBLE:
        duals = relaxation.path_duals(program, p / tau, z / tau, w / tau)
        return NodeSolution(reach, relaxation.cost(run.proven), duals, *relaxation.path_point(program, w / tau))
    unit = tau * run.bound
    duals = relaxation.path_duals(program, p / unit, z / unit, None)
    return NodeSolution(reach, np.inf, duals) if relaxation.proven(reach, duals) == np.inf else None


def solve_by_clarabel(
    relaxation: ModeRelaxation, reach: Reach, tolerances: Sequence[float], end: float, cutoff: float | None
) -> NodeSolution | None:
    """Return the solution by shares of modes: to a tolerance, or a rough one that decides; None if there is neither."""
    from lin_freq_ocp.program.backends.clarabel_ import solve_form  # slow to import

    member = relaxation.member(reach)
    attempts: list[tuple[float, Decision | None]] = [(tolerance, None) for tolerance in tolerances]
    if cutoff is not None and relaxation.proves:
        attempts.insert(0, (tolerances[0], Decision(relaxation.objective(cutoff), _is_undecided(reach))))
    for tolerance, enough in attempts:
        left = end - now()
        if left <= 0:
            return NodeSolution(reach, -np.inf)
        solution = solve_form(member.form, tolerance, None if left == np.inf else left, enough)
        y, z = solution.y, solution.z
        if solution.claim is Claim.INTERRUPTED:
            raise KeyboardInterrupt
        if y is not None and enough is None and solution.claim is Claim.INFEASIBLE:
            return NodeSolution(reach, np.inf, relaxation.duals(member, y, None))
        if y is None or z is None or solution.claim not in (Claim.SOLVED, Claim.STOPPED):
            continue
        duals, point = relaxation.duals(member, y, z), relaxation.point(member, z)
        if enough is None:
            return NodeSolution(reach, relaxation.cost(member.form.dual_objective(z, y)), duals, *point)
        # a rough solution may decide: the node is closed by its duals, or to be split
        bound = relaxation.proven(reach, duals)
        if (enough.several and solution.claim is Claim.STOPPED) or not relaxation.objective(bound) <= enough.cutoff:
            return NodeSolution(reach, bound, duals, *point)
    return None


def _is_undecided(reach: Reach) -> bool:
    """Whether a reach leaves several modes at some time."""
    return bool((reach.allowed.sum(axis=1) > 1).any())
