"""Every solver that qpsolvers finds installed: min 1/2 z'P z + q'z, G z <= h, A z = b; P z + q + G'z_G + A'y = 0."""

from __future__ import annotations

import time
import warnings
from typing import Any

import numpy as np
import qpsolvers
import scipy.sparse as sp

from lin_freq_ocp.backends.base import Claim, Solution, Solver
from lin_freq_ocp.errors import MissingExtraError
from lin_freq_ocp.transcription.program import Program

SETTINGS: dict[str, Any] = {
    "clarabel": lambda tolerance: dict.fromkeys(("tol_feas", "tol_gap_abs", "tol_gap_rel"), tolerance),
    "piqp": lambda tolerance: dict.fromkeys(("eps_abs", "eps_rel", "eps_duality_gap_abs"), tolerance),
    "proxqp": lambda tolerance: {
        **dict.fromkeys(("eps_abs", "eps_duality_gap_abs", "eps_duality_gap_rel"), tolerance),
        "check_duality_gap": True,
    },
    "scs": lambda tolerance: {"eps_abs": tolerance, "eps_rel": tolerance, "max_iters": 200_000},
    "osqp": lambda tolerance: {"eps_abs": tolerance, "eps_rel": tolerance, "max_iter": 200_000, "polishing": True},
}
"""How each solver spells its tolerance; one that is not here runs with its own."""


def named(member: str) -> Solver:
    """Return a solver function that calls qpsolvers with ``member``."""
    if member not in qpsolvers.available_solvers:
        raise MissingExtraError(
            f"backend 'qpsolvers:{member}': not installed. "
            f"Installed: {', '.join(sorted(qpsolvers.available_solvers))}. "
            f"Install it with: pip install 'qpsolvers[{member}]'."
        )

    def solve(program: Program, tolerance: float, time_limit: float | None) -> Solution:
        return _solve(member, program, tolerance, time_limit)

    return solve


def _solve(member: str, program: Program, tolerance: float, time_limit: float | None) -> Solution:
    equal = program.equality
    above = np.flatnonzero(~equal & np.isfinite(program.upper))
    below = np.flatnonzero(~equal & np.isfinite(program.lower))
    equations = np.flatnonzero(equal)
    form = sp.csc_matrix if member in qpsolvers.sparse_solvers else _dense
    G = form(sp.vstack([program.A[above], -program.A[below]])) if len(above) + len(below) else None
    h = np.concatenate([program.upper[above], -program.lower[below]]) if G is not None else None
    A = form(program.A[equations]) if len(equations) else None
    b = program.upper[equations] if A is not None else None
    problem = qpsolvers.Problem(form(program.P), program.q, G, h, A, b)
    settings = SETTINGS[member](tolerance) if member in SETTINGS else {}
    if time_limit is not None and member in ("clarabel", "osqp", "highs"):
        settings["time_limit"] = time_limit
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # qpsolvers warns of conversions; residuals tell what matters
        start = time.perf_counter()
        try:
            answer = qpsolvers.solve_problem(problem, solver=member, **settings)
        except qpsolvers.exceptions.QPError as error:
            return Solution(Claim.FAILED, None, None, str(error))
    late = time_limit is not None and time.perf_counter() - start >= time_limit
    missed = Claim.LIMIT if late else Claim.FAILED
    needed = [answer.x, *([answer.y] if A is not None else []), *([answer.z] if G is not None else [])]
    if any(part is None or not np.isfinite(part).all() for part in needed):
        return Solution(missed, None, None, "no solution")
    y = np.zeros(len(program.lower))
    if A is not None:
        y[equations] = answer.y
    if G is not None:
        y[above] += answer.z[: len(above)]
        y[below] -= answer.z[len(above) :]
    return Solution(Claim.SOLVED if answer.found else missed, np.asarray(answer.x), y, f"found: {answer.found}")


def _dense(matrix: Any) -> np.ndarray:
    return np.asarray(matrix.todense())
