"""OSQP: an operator-splitting method for the form of ``Program``, l <= A z <= u; duals P z + q + A'y = 0."""

from __future__ import annotations

from contextlib import redirect_stdout
from io import StringIO

import numpy as np
import osqp
import scipy.sparse as sp

from lin_freq_ocp.program.backends.base import Claim, Solution
from lin_freq_ocp.program.program import Program

MAX_ITERATIONS = 200_000  # its default of 4000 stops far from the answer
FINEST = 1e-7  # tolerance below which OSQP stalls; polishing does the rest

CLAIMS = {
    "solved": Claim.SOLVED,
    "solved inaccurate": Claim.SOLVED,
    "primal infeasible": Claim.INFEASIBLE,
    "primal infeasible inaccurate": Claim.INFEASIBLE,
    "dual infeasible": Claim.UNBOUNDED,
    "dual infeasible inaccurate": Claim.UNBOUNDED,
    "maximum iterations reached": Claim.LIMIT,
    "run time limit reached": Claim.TIME_LIMIT,
    "interrupted": Claim.INTERRUPTED,
}


def solve(program: Program, tolerance: float, time_limit: float | None) -> Solution:
    """Solve with polishing."""
    run = osqp.OSQP()
    eps = max(tolerance, FINEST)
    limit = {} if time_limit is None else {"time_limit": time_limit}
    run.setup(
        P=sp.csc_matrix(sp.triu(program.P)),  # it warns of sparse arrays
        q=program.q,
        A=sp.csc_matrix(program.A),
        l=program.lower,
        u=program.upper,
        verbose=False,
        eps_abs=eps,
        eps_rel=eps,
        polishing=True,
        max_iter=MAX_ITERATIONS,
        **limit,
    )
    with redirect_stdout(StringIO()):  # it prints a remark on polishing even if it is not verbose
        answer = run.solve(raise_error=False)
    message = str(answer.info.status)
    claim = CLAIMS.get(message, Claim.FAILED)
    z, y = answer.x, answer.y
    if claim is Claim.INFEASIBLE:
        z, y = None, answer.prim_inf_cert
    elif claim is Claim.UNBOUNDED:
        z, y = answer.dual_inf_cert, None
    return Solution(claim, _finite(z), _finite(y), message)


def _finite(values: object) -> np.ndarray | None:
    array = None if values is None else np.array(values, dtype=float)
    return array if array is not None and np.isfinite(array).all() else None
