"""One node of the search: the relaxation of a mask of modes, solved and read."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.analysis.mode_reach import Reach
from lin_freq_ocp.arrays import Array, Indices
from lin_freq_ocp.backends.base import Claim, Solution, backend
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transcription.modes.relaxation import ModeRelaxation
from lin_freq_ocp.transcription.program import Program

# Residuals and gap asked of a node's relaxation: a hundredth of the gap that is to be proven; if that fails, a looser
# one, whose bound is weaker but checked all the same
TOLERANCES = (1e-8, 1e-6)
FINE = (1e-11, 1e-9)  # the same for leaves whose proof turned out too weak
DECIDED = (Claim.SOLVED, Claim.INFEASIBLE)


@dataclass(frozen=True, eq=False)
class Duals:
    """The duals y of the rows of the template that a relaxation had; eta_C = 0 for a Farkas ray."""

    rows: Indices
    y: Array
    eta_C: float


@dataclass(frozen=True, eq=False)
class Relaxed:
    """The answer to one relaxation.

    Attributes
    ----------
    reach : Reach
    bound : float
        The dual objective; inf if there is no point; -inf if the solver failed.
    duals : Duals or None
    trajectory : Trajectory or None
    weights : (T, modes) or None
        delta: how much of each mode the relaxed point has.
    """

    reach: Reach
    bound: float
    duals: Duals | None
    trajectory: Trajectory | None
    weights: Array | None

    @property
    def sequence(self) -> Indices | None:
        """Return the only sequence left, if there is one."""
        allowed = self.reach.allowed
        return np.argmax(allowed, axis=1) if (allowed.sum(axis=1) == 1).all() else None


def relaxed(
    relaxation: ModeRelaxation, reach: Reach, tolerances: Sequence[float] = TOLERANCES, end: float = np.inf
) -> Relaxed:
    """Solve the relaxation of a reach to the first tolerance that its solver reaches until ``end``."""
    if time.perf_counter() > end:
        return Relaxed(reach, -np.inf, None, None, None)
    member = relaxation.member(reach)
    program = member.program
    solution = next(
        (solution for solution in _solutions(program, tolerances, end) if solution.claim in DECIDED),
        Solution(Claim.FAILED, None, None, "no tolerance was reached"),
    )
    z, y = solution.z, solution.y
    if solution.claim is Claim.INFEASIBLE and y is not None:
        return Relaxed(reach, np.inf, Duals(member.rows, y, 0.0), None, None)
    if solution.claim is not Claim.SOLVED or z is None or y is None:
        return Relaxed(reach, -np.inf, None, None, None)
    bound = relaxation.cost(program.dual_objective(z, y))
    return Relaxed(reach, bound, Duals(member.rows, y, 1.0), *relaxation.point(member, z))


def _solutions(program: Program, tolerances: Sequence[float], end: float) -> Iterator[Solution]:
    """Yield a solution for each tolerance, as long as there is time; KeyboardInterrupt after Ctrl-C."""
    for tolerance in tolerances:
        left = end - time.perf_counter()
        if left <= 0:
            return
        solution = backend("clarabel")(program, tolerance, None if left == np.inf else left)
        if solution.claim is Claim.INTERRUPTED:
            raise KeyboardInterrupt
        yield solution
