"""The small QP over the working rows: min lam'S lam / 2 + d'lam over lam >= 0, S often singular (docs/spectral.md, 6).

S is positive semidefinite, and numerically singular wherever a state or a saturated control rides a bound. Nothing here
is trusted: the exchange judges every answer from the signals it leads to.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dtrtrs

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.methods.spectral.kkt.interior_point import interior_point

PIVOTING_ROWS = 300
"""Rows up to which exchanging all wrong rows at once is tried first."""

PIVOTING_STEPS = 12
"""Steps after which that has not converged."""

PATIENCE = 2
"""Steps in a row without fewer wrong rows after which it will not."""

PIVOTING_PIVOT = 1e-6
"""Cholesky pivot below which the rows are too dependent for it."""

ACTIVE_SET_ROWS = 400
"""Rows up to which an active set is grown one row at a time, if states are among them."""

ACTIVE_SET_CONTROLS = 120
"""The same where nearly all are controls: an interior point is faster from there on."""

ACTIVE_SET_STEPS = 10
"""Steps per row after which that has not converged."""

RIDGE = 1e-13
"""Added to the diagonal, which is 1: nearly parallel rows then share their multipliers."""

ACCURATE_ERROR = 1e-9
"""Slope left at which its answer is good."""

MOSTLY_CONTROLS = 0.9
"""Share of control rows from which the multipliers are not unique, and an interior point is what survives."""

WRONG = 1e-13
"""Slope, of a QP scaled to order 1, below which an inactive row is wrong."""

TINY = 1e-300
"""Keeps the scale of a row or slope that is exactly zero finite."""


def nonnegative_qp(
    S: Array, d: Array, start: Array, unconstrained: Array | None = None, stop: Callable[[], str | None] = lambda: None
) -> tuple[Array, bool]:
    """Return (lam, whether the method that found it was accurate).

    Parameters
    ----------
    S : (count, count), d : (count,)
    start : (count,)
        A warm start, >= 0.
    unconstrained : (count,), optional
        A diagonal with diag - S >= 0 and of low rank, zero where there is none: 1/R for control rows.
    stop : callable
        Says why to stop early, or None: then it returns the best that there is, with which it is not accurate.
    """
    unit = 1 / np.sqrt(np.maximum(np.diagonal(S), TINY))
    size = max(float((np.abs(d) * unit).max()), TINY)
    A, b, warm = S * unit[:, None] * unit, d * unit / size, start / unit / size
    lam = block_pivoting(A, b, warm) if len(d) <= PIVOTING_ROWS else None
    if lam is not None:
        return lam * unit * size, True
    controls = 0.0 if unconstrained is None else float((unconstrained > 0).mean())
    if len(d) <= (ACTIVE_SET_ROWS if controls < MOSTLY_CONTROLS else ACTIVE_SET_CONTROLS):
        lam = active_set(A, b)
    accurate = lam is not None
    if lam is None:
        lam, accurate = interior_point(A, b, None if unconstrained is None else unconstrained * unit**2, stop)
    return lam * unit * size, accurate


def block_pivoting(A: Array, b: Array, start: Array) -> Array | None:
    """Exchange all wrong rows at once; None if that does not converge, or if the rows are nearly dependent."""
    active, fewest, patience = (start > 0) | (A @ start + b < 0), len(b) + 1, PATIENCE
    for _ in range(PIVOTING_STEPS):
        lam, rows = np.zeros(len(b)), active.nonzero()[0]
        if len(rows):
            factor, solution, failed = dposv(A[rows[:, None], rows], b[rows], lower=1)
            if failed or factor.diagonal().min() < PIVOTING_PIVOT:
                return None
            lam[rows] = -solution
        wrong = np.where(active, lam < 0, A @ lam + b < -WRONG)
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

    regular = A + RIDGE * np.eye(len(b))
    factor, failed = dpotrf(regular, lower=1)
    if failed:
        return None
    try:
        lam, _ = nnls(factor.T, dtrtrs(factor, -b, lower=1)[0], maxiter=ACTIVE_SET_STEPS * len(b))
    except RuntimeError:
        return None
    return lam if (A @ lam + b).min() > -ACCURATE_ERROR * max(1.0, float(lam.max())) else None
