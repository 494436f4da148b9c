"""Mode sequences from mixed-integer solvers: measured, and never believed."""

from __future__ import annotations

import time

import numpy as np

from lin_freq_ocp.backends.base import Solution, backend
from lin_freq_ocp.methods.claims import DEFAULT_GAP, SolverClaim, status_of
from lin_freq_ocp.methods.convex.sparse_program import require_convex
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.transcription.modes.mixed_integer import MixedInteger, big_m_program

# Violation of a row of order 1, with binaries rounded, up to which a claimed point counts as one: a solver's 1e-6 in
# the row, and as much in each binary times a coefficient of at most 1
POINT_TOLERANCE = 1e-5
# Seconds that a solver is given when setting up has used them all: it says that the limit was reached
LEAST_TIME = 1e-3


def solve_miqp(
    problem: OptimalControlProblem, solver_name: str = "scip", time_limit: float | None = None, gap: float = DEFAULT_GAP
) -> SolverClaim:
    """Ask a mixed-integer solver for the best mode sequence of a problem with piecewise-affine dynamics.

    Parameters
    ----------
    problem : OptimalControlProblem
        With a convex cost and bounded states and controls.
    solver_name : {"scip", "daqp"}
        "daqp" takes no Euclidean norms, and cannot be interrupted.
    time_limit : float, optional
        Seconds for the solver.
    gap : float
        Relative gap between cost and bound at which it may stop.

    Raises
    ------
    UnsupportedError
        If the dynamics are linear, the cost is not convex, something is unbounded, or the backend does not take the
        problem.
    MissingExtraError
        If the backend's package is not installed.
    """
    solver = backend(solver_name, binaries=True)
    require_convex(problem)
    started = time.perf_counter()
    try:
        mixed = big_m_program(problem, np.inf if time_limit is None else started + time_limit)
    except TimeoutError:
        seconds = {"setup": time.perf_counter() - started, "solve": 0.0}
        return SolverClaim("limit", None, None, None, None, f"time limit of {time_limit:.3g} s", seconds)
    ready = time.perf_counter()
    left = None if time_limit is None else max(time_limit - (ready - started), LEAST_TIME)
    solution = solver(mixed.program, gap, left)
    seconds = {"setup": ready - started, "solve": time.perf_counter() - ready}
    return _outcome(mixed, solution, seconds)


def _outcome(mixed: MixedInteger, solution: Solution, seconds: dict[str, float]) -> SolverClaim:
    bound = None if solution.bound is None else mixed.cost(solution.bound)
    status, words = status_of(solution)
    if status == "unbounded":  # with bounds on all states and controls, nothing is
        status = "failed"
    if solution.z is None:
        return SolverClaim(status, None, None, None, bound, words, seconds)
    z, sequence = solution.z.copy(), mixed.sequence(solution.z)
    z[mixed.program.binaries] = mixed.deltas(sequence)
    violation = mixed.program.residuals(z, np.zeros(len(mixed.program.lower))).primal
    if violation > POINT_TOLERANCE:
        status = "failed"
        words = f"{words}, but with binaries rounded its point violates a row of order 1 by {violation:.1e}"
    cost = mixed.cost(mixed.program.objective(z))
    return SolverClaim(status, sequence, mixed.trajectory(z), cost, bound, words, seconds)
