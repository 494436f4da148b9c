"""The small QP over the working rows: min lam'S lam / 2 + d'lam over 0 <= lam <= u, S often singular.

docs/spectral.md, 6 and 12. u is the price of a soft row and infinite for a hard one; a row with lam = u > 0 is
saturated: it is violated, and its slope S lam + d, which is its slack, is at most 0.

S is positive semidefinite, and numerically singular where a state or a control stays at a bound. The exchange measures
every answer by the signals that follow from it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg.lapack import dposv

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.methods.spectral import tolerances as tol
from lin_freq_ocp.methods.spectral.kkt.interior_point import interior_point

PIVOTING_ROWS = 300  # up to which block pivoting is tried first
PIVOTING_STEPS = 12  # after which it has not converged
PATIENCE = 2  # its steps in a row without fewer wrong rows


def bounded_qp(
    S: Array,
    d: Array,
    start: Array,
    unconstrained: Array | None = None,
    stop: Callable[[], str | None] = lambda: None,
    upper: Array | None = None,
    response: Array | None = None,
) -> tuple[Array, bool]:
    """Return (lam, whether it is accurate) from a warm start >= 0; not accurate if ``stop`` ends it early.

    ``upper`` is u, None if all of it is infinite. A row with a price that equations decide is saturated if it is
    violated: its entry of S is rounding of zero, relative to its ``response`` without equations.

    ``unconstrained`` is a diagonal with diag - S >= 0 of low rank, 1/R for control rows and zero for others, if any.
    """
    if upper is not None and response is not None:
        decided = np.isfinite(upper) & (np.diagonal(S) < tol.DECIDED_SOFT * response)
        if decided.any():
            return _with_decided(S, d, start, unconstrained, stop, upper, decided)
    unit = 1 / np.sqrt(np.maximum(np.diagonal(S), tol.TINY))
    size = max(float((np.abs(d) * unit).max()), tol.TINY)
    A, b, warm = S * unit[:, None], d * unit / size, start / unit / size
    A *= unit
    most = None if upper is None else upper / unit / size
    lam = block_pivoting(A, b, warm, most) if len(d) <= PIVOTING_ROWS else None
    if lam is not None:
        return _in_units(lam, unit * size, most, upper), True
    thin = None if unconstrained is None else unconstrained * unit**2
    lam, accurate = interior_point(A, b, thin, stop, warm, most)
    return _in_units(lam, unit * size, most, upper), accurate


def _with_decided(
    S: Array,
    d: Array,
    start: Array,
    unconstrained: Array | None,
    stop: Callable[[], str | None],
    upper: Array,
    decided: Mask,
) -> tuple[Array, bool]:
    """Return the answer with rows that equations decide, (count,), at a bound of their multipliers."""
    lam, rest, accurate = np.where(decided & (d < 0), upper, 0.0), ~decided, True
    if rest.any():
        free = None if unconstrained is None else unconstrained[rest]
        target = d[rest] + S[np.ix_(rest, decided)] @ lam[decided]
        lam[rest], accurate = bounded_qp(S[np.ix_(rest, rest)], target, start[rest], free, stop, upper[rest])
    return lam, accurate


def _in_units(lam: Array, units: Array, most: Array | None, upper: Array | None) -> Array:
    """Return lam in the units of the problem, exactly at its upper bounds where it is there."""
    return lam * units if most is None or upper is None else np.where(lam >= most, upper, lam * units)


def block_pivoting(A: Array, b: Array, start: Array, upper: Array | None = None) -> Array | None:
    """Exchange all wrong rows at once; None if that does not converge, or if the rows are nearly dependent."""
    fewest, patience, slope = len(b) + 1, PATIENCE, A @ start + b
    saturated = np.zeros(len(b), dtype=bool) if upper is None else start >= upper
    active = ((start > 0) | (slope < 0)) & ~saturated
    for _ in range(PIVOTING_STEPS):
        lam, rows, target = np.zeros(len(b)), active.nonzero()[0], b
        if upper is not None and saturated.any():
            lam[saturated] = upper[saturated]
            target = b + A[:, saturated] @ lam[saturated]
        if len(rows):
            factor, solution, failed = dposv(A.take(rows, 0).take(rows, 1), target[rows], lower=1)
            if failed or factor.diagonal().min() < tol.PIVOTING_PIVOT:
                return None
            lam[rows] = -solution
        slope = A @ lam + b
        wrong = np.where(active, lam < 0, slope < -tol.WRONG_SLOPE)
        if upper is not None:
            above = active & (lam > upper)
            leaving = saturated & (slope > tol.WRONG_SLOPE)
            wrong = above | leaving | (wrong & ~saturated)
            saturated = (saturated & ~leaving) | above
        count = np.count_nonzero(wrong)
        if count == 0:
            return lam
        patience = PATIENCE if count < fewest else patience - 1
        if patience < 0:
            return None
        fewest = min(fewest, count)
        active ^= wrong
    return None
