"""Mode sequences of mixed-integer solvers: claims, which branch and bound proves or improves afterwards."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lin_freq_ocp.base.arrays import Indices
from lin_freq_ocp.base.clock import LEAST_SECONDS, now
from lin_freq_ocp.methods.candidate import require_convex
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.backends.base import Claim, backend
from lin_freq_ocp.program.hybrid.mixed_integer import big_m_program

DEFAULT_GAP = 1e-6  # relative gap asked of a solver, as accurate as its rows
AGREEMENT = 1e-6  # relative difference allowed between the claimed cost and that of the claimed trajectory


@dataclass(frozen=True, eq=False)
class SolverClaim:
    """The claim of a mixed-integer solver about a problem, in the problem's units."""

    status: Claim
    sequence: Indices | None  # modes (T,) of the best point found
    trajectory: Trajectory | None  # that point, as accurate as the solver's tolerances
    cost: float | None
    bound: float | None  # claimed lower bound on the cost
    message: str  # the status of the solver, and the fault of its claim if it has one
    seconds: dict[str, float] = field(default_factory=dict[str, float])  # wall times of "setup" and "solve"


# Violation of rows of order 1 by a point with rounded binaries: a solver's 1e-6 in the row and in each binary
POINT_TOLERANCE = 1e-5


def solve_miqp(
    problem: OptimalControlProblem, solver_name: str = "scip", time_limit: float | None = None, gap: float = DEFAULT_GAP
) -> SolverClaim:
    """Ask "scip" or "daqp" for the best mode sequence of a piecewise-affine problem, in ``time_limit`` seconds.

    It may stop at a relative ``gap`` between cost and bound. Raises UnsupportedError if the cost is not convex, a
    signal is not bounded, or the solver does not take the problem; MissingExtraError if it is not installed.
    """
    solver = backend(solver_name, binaries=True)
    require_convex(problem)
    started = now()
    try:
        mixed = big_m_program(problem, np.inf if time_limit is None else started + time_limit)
    except TimeoutError:
        seconds = {"setup": now() - started, "solve": 0.0}
        return SolverClaim(Claim.TIME_LIMIT, None, None, None, None, f"time limit of {time_limit:.3g} s", seconds)
    ready = now()
    left = None if time_limit is None else max(time_limit - (ready - started), LEAST_SECONDS)
    solution = solver(mixed.program, gap, left)
    seconds = {"setup": ready - started, "solve": now() - ready}
    bound = None if solution.bound is None else mixed.cost(solution.bound)
    status, message = solution.claim, solution.message
    if status is Claim.UNBOUNDED or (status is Claim.SOLVED and solution.z is None):  # all signals have bounds
        status = Claim.FAILED
    if solution.z is None:
        return SolverClaim(status, None, None, None, bound, message, seconds)
    z, sequence = solution.z.copy(), mixed.sequence(solution.z)
    z[mixed.program.binaries] = mixed.deltas(sequence)
    violation = mixed.program.residuals(z, np.zeros(len(mixed.program.lower))).primal
    if violation > POINT_TOLERANCE:
        status = Claim.FAILED
        message = f"{message}, but with binaries rounded its point violates a row of order 1 by {violation:.1e}"
    cost = mixed.cost(mixed.program.objective(z))
    return SolverClaim(status, sequence, mixed.trajectory(z), cost, bound, message, seconds)
