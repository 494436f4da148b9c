"""The small QP over the working rows: min lam'S lam / 2 + d'lam over lam >= 0, S often singular (docs/spectral.md, 6).

S is positive semidefinite, and numerically singular where a state or a control stays at a bound. The exchange measures
every answer by the signals that follow from it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dtrtrs

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.methods.spectral import tolerances as tol
from lin_freq_ocp.methods.spectral.kkt.interior_point import interior_point

PIVOTING_ROWS = 300  # up to which block pivoting is tried first
PIVOTING_STEPS = 12  # after which it has not converged
PATIENCE = 2  # its steps in a row without fewer wrong rows
ACTIVE_SET_ROWS = 400  # up to which an active set is grown row by row, if states are among them
ACTIVE_SET_CONTROLS = 120  # the same where nearly all are controls: with more, an interior point is faster
ACTIVE_SET_STEPS = 10  # per row, after which it has not converged
MOSTLY_CONTROLS = 0.9  # share of control rows from which the multipliers are not unique, and active sets cycle


def nonnegative_qp(
    S: Array, d: Array, start: Array, unconstrained: Array | None = None, stop: Callable[[], str | None] = lambda: None
) -> tuple[Array, bool]:
    """Return (lam, whether it is accurate) from a warm start >= 0; not accurate if ``stop`` ends it early.

    ``unconstrained`` is a diagonal with diag - S >= 0 of low rank, 1/R for control rows and zero for others, if any.
    """
    unit = 1 / np.sqrt(np.maximum(np.diagonal(S), tol.TINY))
    size = max(float((np.abs(d) * unit).max()), tol.TINY)
    A, b, warm = S * unit[:, None], d * unit / size, start / unit / size
    A *= unit
    lam = block_pivoting(A, b, warm) if len(d) <= PIVOTING_ROWS else None
    if lam is not None:
        return lam * unit * size, True
    controls = 0.0 if unconstrained is None else float((unconstrained > 0).mean())
    if len(d) <= (ACTIVE_SET_ROWS if controls < MOSTLY_CONTROLS else ACTIVE_SET_CONTROLS):
        lam = active_set(A, b)
    accurate = lam is not None
    if lam is None:
        lam, accurate = interior_point(A, b, None if unconstrained is None else unconstrained * unit**2, stop, warm)
    return lam * unit * size, accurate


def block_pivoting(A: Array, b: Array, start: Array) -> Array | None:
    """Exchange all wrong rows at once; None if that does not converge, or if the rows are nearly dependent."""
    active, fewest, patience = (start > 0) | (A @ start + b < 0), len(b) + 1, PATIENCE
    for _ in range(PIVOTING_STEPS):
        lam, rows = np.zeros(len(b)), active.nonzero()[0]
        if len(rows):
            factor, solution, failed = dposv(A.take(rows, 0).take(rows, 1), b[rows], lower=1)
            if failed or factor.diagonal().min() < tol.PIVOTING_PIVOT:
                return None
            lam[rows] = -solution
        wrong = np.where(active, lam < 0, A @ lam + b < -tol.WRONG_SLOPE)
        count = np.count_nonzero(wrong)
        if count == 0:
            return lam
        patience = PATIENCE if count < fewest else patience - 1
        if patience < 0:
            return None
        fewest = min(fewest, count)
        active ^= wrong
    return None


def active_set(A: Array, b: Array) -> Array | None:
    """Return the answer by Lawson and Hanson's method on a Cholesky factor; None if it cycles or is not accurate."""
    from scipy.optimize import nnls  # slow to import

    regular = A + tol.QP_RIDGE * np.eye(len(b))
    factor, failed = dpotrf(regular, lower=1)
    if failed:
        return None
    try:
        lam, _ = nnls(factor.T, dtrtrs(factor, -b, lower=1)[0], maxiter=ACTIVE_SET_STEPS * len(b))
    except RuntimeError:
        return None
    return lam if (A @ lam + b).min() > -tol.ACTIVE_SET_ACCURATE * max(1.0, float(lam.max())) else None
