# pyright: reportAttributeAccessIssue=false, reportUnknownLambdaType=false
"""Clarabel: an interior-point method for min 1/2 z'P z + q'z, A z + s = b, s in a cone; duals P z + q + A'y = 0."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import clarabel
import numpy as np

from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.interrupts import interrupts_noted
from lin_freq_ocp.program.backends.base import Claim, Solution
from lin_freq_ocp.program.program import Program, StandardForm

CLAIMS = {
    "Solved": Claim.SOLVED,
    "AlmostSolved": Claim.SOLVED,
    "PrimalInfeasible": Claim.INFEASIBLE,
    "AlmostPrimalInfeasible": Claim.INFEASIBLE,
    "DualInfeasible": Claim.UNBOUNDED,
    "AlmostDualInfeasible": Claim.UNBOUNDED,
    "MaxTime": Claim.TIME_LIMIT,
    "MaxIterations": Claim.LIMIT,
    "InsufficientProgress": Claim.SOLVED,  # stopped at rounding level; the residuals decide
    "CallbackTerminated": Claim.INTERRUPTED,
}

# (cost, dual cost, relative residual) -> whether the point is good enough
Enough = Callable[[float, float, float], bool]
COST_FACTOR = 10.0  # on the cost, as Clarabel's regularisation is absolute and disturbs small costs


def solve(program: Program, tolerance: float, time_limit: float | None) -> Solution:
    """Solve the standard form of a program."""
    form = program.standard()
    found = solve_form(form, tolerance, time_limit)
    return found if found.y is None else replace(found, y=form.dual(len(program.lower), found.y))


def solve_form(
    form: StandardForm, tolerance: float, time_limit: float | None, enough: Enough | None = None
) -> Solution:
    """Solve a standard form; y are the duals of its rows, in the dual cone.

    ``enough`` is asked after every iteration, and ends the solve with the claim STOPPED; linear systems are then solved
    without refinement, which takes half as long and is exact enough for a first few digits.
    """
    end = np.inf if time_limit is None else now() + time_limit
    cones = [clarabel.ZeroConeT(form.equations), clarabel.NonnegativeConeT(form.inequalities)]
    cones += [clarabel.SecondOrderConeT(count) for count in form.cones]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = tolerance
    settings.max_threads = 1
    if time_limit is not None:
        settings.time_limit = time_limit
    settings.iterative_refinement_enable = enough is None
    P, q, stopped = COST_FACTOR * form.P, COST_FACTOR * form.q, [False]
    run = clarabel.DefaultSolver(P, q, form.A, form.b, cones, settings)
    with interrupts_noted() as noted:

        def ends(info: clarabel.DefaultInfo) -> bool:
            costs = info.cost_primal / COST_FACTOR, info.cost_dual / COST_FACTOR
            stopped[0] = enough is not None and enough(*costs, max(info.res_primal, info.res_dual))
            return stopped[0] or noted.is_set() or now() > end

        run.set_termination_callback(ends)
        answer = run.solve()
    claim, message = CLAIMS.get(str(answer.status), Claim.FAILED), str(answer.status)
    if claim is Claim.INTERRUPTED and not noted.is_set():
        # its own clock begins after its set-up
        claim, message = (Claim.STOPPED, message) if stopped[0] else (Claim.TIME_LIMIT, "MaxTime")
    z, dual = np.array(answer.x), np.array(answer.z)
    if not (np.isfinite(z).all() and np.isfinite(dual).all()):
        return Solution(claim if claim is Claim.TIME_LIMIT else Claim.FAILED, None, None, message)
    return Solution(claim, z, dual / COST_FACTOR, message)
