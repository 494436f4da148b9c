"""Every installed solver of qpsolvers: min 1/2 z'P z + q'z, G z <= h, A z = b; P z + q + G'z_G + A'y = 0."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from importlib.metadata import metadata

import numpy as np
import qpsolvers
import scipy.sparse as sp

from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import MissingExtraError, UnsupportedError, suggestion
from lin_freq_ocp.program.backends.base import Claim, Solution, Solver
from lin_freq_ocp.program.program import Program

# the options for the tolerance of each solver; others run with their default
SETTINGS: dict[str, Callable[[float], dict[str, object]]] = {
    "clarabel": lambda tolerance: dict.fromkeys(("tol_feas", "tol_gap_abs", "tol_gap_rel"), tolerance),
    "piqp": lambda tolerance: dict.fromkeys(("eps_abs", "eps_rel", "eps_duality_gap_abs"), tolerance),
    "proxqp": lambda tolerance: {
        **dict.fromkeys(("eps_abs", "eps_duality_gap_abs", "eps_duality_gap_rel"), tolerance),
        "check_duality_gap": True,
    },
    "scs": lambda tolerance: {"eps_abs": tolerance, "eps_rel": tolerance, "max_iters": 200_000},
    "osqp": lambda tolerance: {"eps_abs": tolerance, "eps_rel": tolerance, "max_iter": 200_000, "polishing": True},
}
# HiGHS's active set may cycle, and no limit ends it by default
ITERATION_LIMITS: dict[str, dict[str, object]] = {"highs": {"qp_iteration_limit": 50_000}}
# the option for the time limit of each solver; others have none
TIME_LIMITS = {
    "clarabel": "time_limit",
    "osqp": "time_limit",
    "highs": "time_limit",
    "daqp": "time_limit",
    "scs": "time_limit_secs",
}


def solver(member: str) -> Solver:
    """Return a solver function that calls qpsolvers with ``member``."""
    installed = f"Installed: {', '.join(sorted(qpsolvers.available_solvers))}."
    known = [*qpsolvers.available_solvers, *(metadata("qpsolvers").get_all("Provides-Extra") or [])]
    if member not in known:
        advice = suggestion(member, known) or installed
        raise UnsupportedError(f"backend: got 'qpsolvers:{member}', which is no solver of qpsolvers. {advice}")
    if member not in qpsolvers.available_solvers:
        advice = f"Install it with: pip install 'qpsolvers[{member}]'."
        raise MissingExtraError(f"backend 'qpsolvers:{member}': not installed. {installed} {advice}")
    return partial(_solve, member)


def _solve(member: str, program: Program, tolerance: float, time_limit: float | None) -> Solution:
    form = program.standard()
    # it takes sparse matrices, no sparse arrays
    typed = sp.csc_matrix if member in qpsolvers.sparse_solvers else (lambda matrix: np.asarray(matrix.todense()))
    count = form.equations
    inequalities = (typed(form.A[count:]), form.b[count:]) if form.inequalities else (None, None)
    equations = (typed(form.A[:count]), form.b[:count]) if count else (None, None)
    problem = qpsolvers.Problem(typed(program.P), program.q, *inequalities, *equations)
    settings = {**(SETTINGS[member](tolerance) if member in SETTINGS else {}), **ITERATION_LIMITS.get(member, {})}
    if time_limit is not None:
        if member not in TIME_LIMITS:
            raise UnsupportedError(f"time_limit: backend 'qpsolvers:{member}' cannot stop at one; leave it out.")
        settings[TIME_LIMITS[member]] = time_limit
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # qpsolvers warns of conversions; residuals tell what matters
        start = now()
        try:
            answer = qpsolvers.solve_problem(problem, member, None, False, **settings)
        except qpsolvers.exceptions.QPError as error:
            return Solution(Claim.FAILED, None, None, str(error))
    missed = Claim.FAILED if time_limit is None or now() - start < time_limit else Claim.TIME_LIMIT
    parts = [answer.x, answer.y if count else np.zeros(0), answer.z if form.inequalities else np.zeros(0)]
    x, y, z = (np.full(1, np.nan) if part is None else np.asarray(part) for part in parts)
    if not all(np.isfinite(part).all() for part in (x, y, z)):
        return Solution(missed, None, None, "no solution")
    claim = Claim.SOLVED if answer.found else missed
    return Solution(claim, x, form.dual(len(program.lower), np.append(y, z)), f"found: {answer.found}")
