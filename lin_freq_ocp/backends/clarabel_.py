# pyright: reportAttributeAccessIssue=false, reportUnknownLambdaType=false
"""Clarabel: an interior-point method for min 1/2 z'P z + q'z, A z + s = b, s in a cone; duals P z + q + A'y = 0."""

from __future__ import annotations

import time

import clarabel
import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.backends.base import Claim, Solution
from lin_freq_ocp.backends.interrupt import interrupts_noted
from lin_freq_ocp.transcription.program import Program
from lin_freq_ocp.transcription.standard_form import StandardForm

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

COST_FACTOR = 10.0
"""Its regularisation is absolute and disturbs small costs: it gets the cost this much larger."""


def solve(program: Program, tolerance: float, time_limit: float | None) -> Solution:
    """Solve; a row outside cones becomes an equation, or its finite sides become inequalities."""
    end = np.inf if time_limit is None else time.perf_counter() + time_limit
    sides, curved = program.one_sided(), program.in_cones
    A = sp.csc_matrix(sp.vstack([sides.A, sides.G, -program.A[curved]]))
    b = np.concatenate([sides.b, sides.h, -program.lower[curved]])
    cones = [clarabel.ZeroConeT(len(sides.b)), clarabel.NonnegativeConeT(len(sides.h))]
    cones += [clarabel.SecondOrderConeT(cone.stop - cone.start) for cone in program.cones]
    upper, q = sp.csc_matrix(COST_FACTOR * sp.triu(program.P)), COST_FACTOR * program.q
    solver = clarabel.DefaultSolver(upper, q, A, b, cones, _settings(tolerance, time_limit))
    with interrupts_noted() as noted:
        solver.set_termination_callback(lambda info: noted.is_set() or time.perf_counter() > end)
        answer = solver.solve()
    claim, words = CLAIMS.get(str(answer.status), Claim.FAILED), str(answer.status)
    if claim is Claim.INTERRUPTED and not noted.is_set():  # its own clock begins after its set-up
        claim, words = Claim.LIMIT, "MaxTime"
    z, dual = np.array(answer.x), np.array(answer.z)
    if not (np.isfinite(z).all() and np.isfinite(dual).all()):
        return Solution(claim if claim is Claim.LIMIT else Claim.FAILED, None, None, words)
    of_rows, of_cones = np.split(dual / COST_FACTOR, [len(sides.b) + len(sides.h)])
    y = sides.dual(len(program.lower), *np.split(of_rows, [len(sides.b)]))
    y[curved] = -of_cones
    return Solution(claim, z, y, words)


def solve_standard(form: StandardForm, tolerance: float, time_limit: float | None = None) -> Solution:
    """Solve a standard form; the duals are those of its rows, >= 0 at inequalities and in the cones."""
    cones = [clarabel.ZeroConeT(form.equations), clarabel.NonnegativeConeT(form.inequalities)]
    cones += [clarabel.SecondOrderConeT(count) for count in form.cones]
    settings = _settings(tolerance, time_limit)
    settings.presolve_enable = False
    answer = clarabel.DefaultSolver(form.P, form.q, form.A, form.b, cones, settings).solve()
    claim = CLAIMS.get(str(answer.status), Claim.FAILED)
    z, y = np.array(answer.x), np.array(answer.z)
    if not (np.isfinite(z).all() and np.isfinite(y).all()):
        return Solution(Claim.FAILED, None, None, str(answer.status))
    return Solution(claim, z, y, str(answer.status))


def _settings(tolerance: float, time_limit: float | None) -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = tolerance
    settings.max_threads = 1
    if time_limit is not None:
        settings.time_limit = time_limit
    return settings
