"""One node of a search over modes: its relaxation is solved as well as the search needs it.

Path relaxations are solved by compiled code if available; by Clarabel otherwise, or if it stalls. The duals of either
enter the bound over boxes (program/hybrid/path_relaxation.py), and only that bound closes a node.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.problem.hybrid.mode_reach import Reach
from lin_freq_ocp.problem.hybrid.mode_tree import ModeMultipliers
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.backends.base import Claim
from lin_freq_ocp.program.hybrid.path_relaxation import PathDuals, PathMember, PathRelaxation, path_form
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


COMPILED_TOLERANCE = 5e-8  # residual and gap: a tenth of what leaves leave of the gap to be proven
# Part of what is left to the cutoff by which the bound of a node that is split may miss its cost: points within give
# better splits than solutions, and take fewer steps
CLEAR = 0.7
PROVEN = 2e-7  # a bound this close to the cost, relative to it, is that of a solution


def relaxed_path(
    relaxation: PathRelaxation,
    reach: Reach,
    tolerances: Sequence[float],
    end: float,
    cutoff: float | None,
    compiled: bool,
) -> Relaxed | None:
    """Solve the path relaxation of a reach, as ``relaxed``; None where there is none, or no solver solves it.

    ``compiled`` allows compiled code, which takes longer to be loaded than a few nodes take without.
    """
    member = relaxation.path_member(reach)
    if member is None:
        return None
    if member.program is None:
        return Relaxed(reach, np.inf, relaxation.no_path())
    several = bool((reach.allowed.sum(axis=1) > 1).any())
    enough = None if cutoff is None else Decision(relaxation.objective(cutoff), several)
    if compiled and compiled_is_there():
        found = _by_compiled_code(relaxation, member, enough)
        if found is not None:
            return found
    attempts = [(tolerance, None) for tolerance in tolerances]
    for tolerance, early in attempts if enough is None else [(tolerances[0], enough), *attempts]:
        found = _by_clarabel(relaxation, member, tolerance, end, early)
        if found is not None:
            return found
    return None


@cache
def compiled_is_there() -> bool:
    """Whether the code of path relaxations is compiled and cached; compiling it takes longer than most searches."""
    if find_spec("numba") is None:
        return False
    from lin_freq_ocp.methods.hybrid.search import path_kernels as paths

    return paths.KERNELS.ready


def compiled_is_loaded() -> bool:
    """Whether this process has loaded the compiled code of path relaxations."""
    paths = sys.modules.get("lin_freq_ocp.methods.hybrid.search.path_kernels")
    return paths is not None and paths.KERNELS.loaded


def _by_compiled_code(relaxation: PathRelaxation, member: PathMember, enough: Decision | None) -> Relaxed | None:
    """Return the node if compiled code decides it, and its bound holds."""
    from lin_freq_ocp.methods.hybrid.search import path_kernels as paths

    program = member.program
    assert program is not None
    paths.KERNELS.prepare()
    k, n = program.middle.shape[1], (program.C.shape[1] - 2) // 2
    G = np.concatenate([program.linear, program.cone], axis=1)
    data = paths.PathData(  # arrays with edges side by side: the last index
        np.ascontiguousarray(np.concatenate([program.C, program.signals], axis=1).transpose(1, 2, 0)),
        np.ascontiguousarray(program.places.T),
        program.t,
        program.coupled,
        program.b,
        np.ascontiguousarray(program.cost.T),
        np.ascontiguousarray(G.transpose(1, 2, 0)),
        program.linear.shape[1],
        np.ascontiguousarray((program.present / program.sizes)[:, 2 * k :].T),
        program.i,
        program.j,
        n,
    )
    cutoff, clear = (np.inf, 0.0) if enough is None else (enough.cutoff, CLEAR * enough.several)
    rows = len(data.G), len(program.t)
    point = np.empty(data.cost.shape), np.empty(len(program.b)), np.empty(rows), np.empty(rows)
    numbers = np.empty(paths.NUMBERS)
    end = paths.path_run(*data, *point, numbers, COMPILED_TOLERANCE, PROVEN, cutoff, clear)
    w, p, z, tau = point[0].T, point[1], point[2][: data.linear].T, float(numbers[paths.TAU])
    if end == paths.STALLED or not (np.isfinite(p).all() and np.isfinite(z).all()):
        return None
    if end == paths.INFEASIBLE:
        unit = tau * float(numbers[paths.BOUND])
        duals = relaxation.path_duals(program, p / unit, z / unit, None)
        return Relaxed(member.reach, np.inf, duals) if relaxation.path_bound(member, duals) > 0 else None
    duals, bound = relaxation.path_duals(program, p / tau, z / tau, w / tau), float(numbers[paths.PROVEN])
    return Relaxed(member.reach, relaxation.cost(bound), duals, *relaxation.path_point(program, w / tau))


def _by_clarabel(
    relaxation: PathRelaxation, member: PathMember, tolerance: float, end: float, enough: Decision | None
) -> Relaxed | None:
    """Return the node if Clarabel solves it to a tolerance, or ``enough`` ends it and its bound holds."""
    from lin_freq_ocp.program.backends.clarabel_ import solve_form  # slow to import

    program, left = member.program, end - now()
    assert program is not None
    if left <= 0:
        return Relaxed(member.reach, -np.inf)
    form = path_form(program)
    solution = solve_form(form, tolerance, None if left == np.inf else left, enough)
    if solution.claim is Claim.INTERRUPTED:
        raise KeyboardInterrupt
    if (
        solution.claim not in (Claim.SOLVED, Claim.STOPPED, Claim.INFEASIBLE)
        or solution.y is None
        or solution.z is None
    ):
        return None
    p, rest = np.split(solution.y, [len(program.b)])
    z = np.zeros(program.present.shape)
    z[program.present] = rest[: np.count_nonzero(program.present)]
    w = solution.z.reshape(program.cost.shape)
    if solution.claim is Claim.INFEASIBLE:
        return Relaxed(member.reach, np.inf, relaxation.path_duals(program, p, z, None)) if enough is None else None
    duals = relaxation.path_duals(program, p, z, w)
    bound = relaxation.cost(form.dual_objective(solution.z, solution.y))
    if enough is not None:
        bound = relaxation.path_bound(member, duals)
        split = enough.several and solution.claim is Claim.STOPPED
        if not split and relaxation.objective(bound) <= enough.cutoff:
            return None
    return Relaxed(member.reach, bound, duals, *relaxation.path_point(program, w))
