# pyright: reportAttributeAccessIssue=false, reportUnknownLambdaType=false
"""Clarabel: an interior-point method for min 1/2 z'P z + q'z, A z + s = b, s in a cone; duals P z + q + A'y = 0."""

from __future__ import annotations

import clarabel
import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.backends.base import Claim, Solution
from lin_freq_ocp.backends.interrupt import interrupts_noted
from lin_freq_ocp.problem.arrays import Indices
from lin_freq_ocp.transcription.program import Program

CLAIMS = {
    "Solved": Claim.SOLVED,
    "AlmostSolved": Claim.SOLVED,
    "PrimalInfeasible": Claim.INFEASIBLE,
    "AlmostPrimalInfeasible": Claim.INFEASIBLE,
    "DualInfeasible": Claim.UNBOUNDED,
    "AlmostDualInfeasible": Claim.UNBOUNDED,
    "MaxTime": Claim.LIMIT,
    "MaxIterations": Claim.LIMIT,
    "InsufficientProgress": Claim.SOLVED,  # stopped at rounding level; the residuals decide
    "CallbackTerminated": Claim.INTERRUPTED,
}


def solve(program: Program, tolerance: float, time_limit: float | None) -> Solution:
    """Solve; every row becomes an equation, or its finite sides become inequalities."""
    equal = program.equality
    above = np.flatnonzero(~equal & np.isfinite(program.upper))
    below = np.flatnonzero(~equal & np.isfinite(program.lower))
    equations = np.flatnonzero(equal)
    A = sp.csc_matrix(sp.vstack([program.A[equations], program.A[above], -program.A[below]]))
    b = np.concatenate([program.upper[equations], program.upper[above], -program.lower[below]])
    cones = [clarabel.ZeroConeT(len(equations)), clarabel.NonnegativeConeT(len(above) + len(below))]
    solver = clarabel.DefaultSolver(
        sp.csc_matrix(sp.triu(program.P)), program.q, A, b, cones, _settings(tolerance, time_limit)
    )
    with interrupts_noted() as noted:
        solver.set_termination_callback(lambda info: noted.is_set())
        answer = solver.solve()
    return _solution(answer, len(program.lower), equations, above, below)


def _settings(tolerance: float, time_limit: float | None) -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = tolerance
    settings.max_threads = 1
    if time_limit is not None:
        settings.time_limit = time_limit
    return settings


def _solution(
    answer: clarabel.DefaultSolution, rows: int, equations: Indices, above: Indices, below: Indices
) -> Solution:
    claim = CLAIMS.get(str(answer.status), Claim.FAILED)
    z, dual = np.array(answer.x), np.array(answer.z)
    if not (np.isfinite(z).all() and np.isfinite(dual).all()):
        return Solution(Claim.FAILED, None, None, str(answer.status))
    y = np.zeros(rows)
    y[equations], of_above, of_below = np.split(dual, [len(equations), len(equations) + len(above)])
    y[above] += of_above
    y[below] -= of_below
    return Solution(claim, z, y, str(answer.status))
