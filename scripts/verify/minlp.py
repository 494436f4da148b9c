"""A second opinion on piecewise-smooth problems from other people's global solvers: asked, measured, never believed."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from helpers.checks.claimed import differences
from lin_freq_ocp.methods.candidate import require_convex
from lin_freq_ocp.methods.hybrid.search.mixed import AGREEMENT, DEFAULT_GAP, SolverClaim
from lin_freq_ocp.methods.hybrid.smooth.local_optimum import LocalOptimum, smooth_optimum
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.program.backends.base import Claim, Solution
from lin_freq_ocp.program.units import COST_LEVEL
from lin_freq_ocp.transform.hybrid.forms import piecewise_smooth
from verify import minlp_scip
from verify.minlp_program import SmoothProgram, smooth_program

# Violation of a row of order 1 that a claimed point may have: a solver's 1e-6, through a few nodes of a formula
POINT_TOLERANCE = 1e-5


@dataclass(frozen=True, eq=False)
class GlobalClaim(SolverClaim):
    """The claims of a global solver about a problem; only ``excluded`` is proven.

    Attributes
    ----------
    slope : float
        What an error of 1 in the units of the program, where rows are of order 1, could change of J, roughly.
    excluded : bool
        Whether our intervals prove that there is no trajectory; the solver was not asked then.
    """

    slope: float = 0.0
    excluded: bool = False

    def mismatches(self, cost: float, scale: float) -> list[str]:
        """Return the errors of the claim, if its point led to a trajectory of that cost; ``scale`` is S."""
        allowed = AGREEMENT * scale + POINT_TOLERANCE * self.slope
        return differences(self, cost, allowed, "the trajectory it leads to")


def solve_minlp(
    problem: OptimalControlProblem, time_limit: float | None = None, gap: float = DEFAULT_GAP
) -> GlobalClaim:
    """Ask a global solver of mixed-integer nonlinear programs for the best trajectory of piecewise-smooth dynamics.

    Parameters
    ----------
    problem : OptimalControlProblem
        With a convex cost. Without bounds on states and controls, expect little of the claimed bound.
    time_limit : float, optional
        Seconds for the solver.
    gap : float
        Relative gap between cost and bound at which it may stop.

    Raises
    ------
    UnsupportedError
        If the dynamics are not piecewise smooth, or the cost is not convex.
    """
    require_convex(problem)
    started = time.perf_counter()
    program = smooth_program(problem)
    ready = time.perf_counter()
    left = None if time_limit is None else time_limit - (ready - started)
    if left is not None and left <= 0:
        words = f"time limit of {time_limit:.3g} s, over before the solver began"
        slope = program.cost(COST_LEVEL) * problem.horizon
        return GlobalClaim(
            Claim.TIME_LIMIT, None, None, None, None, words, {"setup": ready - started, "solve": 0.0}, slope
        )
    solution = minlp_scip.solve(program, left, gap)
    return _claim(program, solution, {"setup": ready - started, "solve": time.perf_counter() - ready})


def polished(problem: OptimalControlProblem, claim: GlobalClaim, end: float = np.inf) -> LocalOptimum | None:
    """Return the local optimum that the claimed point leads to, in its modes or the nearest; None if there is none."""
    if claim.trajectory is None or claim.sequence is None:
        return None
    found, _ = smooth_optimum(problem, claim.trajectory, claim.sequence, end)
    if found is not None and found.feasible:
        return found
    nearest = piecewise_smooth(problem).sequence_of(claim.trajectory.x, claim.trajectory.u)
    if np.array_equal(nearest, claim.sequence):
        return found
    return smooth_optimum(problem, claim.trajectory, nearest, end)[0] or found


def _claim(program: SmoothProgram, solution: Solution, seconds: dict[str, float]) -> GlobalClaim:
    bound = None if solution.bound is None else program.cost(solution.bound)
    status, words = solution.claim, solution.message
    slope = program.cost(COST_LEVEL) * program.problem.horizon
    if solution.z is None:
        return GlobalClaim(status, None, None, None, bound, words, seconds, slope, program.excluded)
    z, deltas = np.split(solution.z, [len(program.program.q)])
    sequence = np.argmax(deltas.reshape(program.possible.shape), axis=1)
    cost = program.cost(program.program.objective(z))
    return GlobalClaim(status, sequence, program.trajectory(z), cost, bound, words, seconds, slope)
