"""Active set for min 1/2 lam'A lam + b'lam, lam >= 0, one row at a time, whose support stays independent.

Lawson and Hanson's method with an updated Cholesky factor: the one that survives states riding a bound for long, where
neighbouring rows are nearly parallel. A row enters only if its pivot is not rounding; those that may not stay out.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from lin_freq_ocp.problem.arrays import Array

PIVOT = 1e-9
"""Square of the sine of a row's angle to the others (A has diagonal 1) below which it does not enter."""

SLOPE = 1e-12
"""Slope at which a row may stay out; relative to the multipliers too, by SLOPE_GROWTH."""

SLOPE_GROWTH = 1e-4
"""How much of the largest multiplier counts in that."""

CONTENT = 1e-9
"""Slope left on rows that may not enter at which the answer is still good."""

VANISHED = 1e-15
"""Weight, relative to the largest, at which a row has left."""


class _Support:
    """The rows with lam > 0, and the Cholesky factor of their part of A."""

    def __init__(self, A: Array):
        self.A, self.rows = A, list[int]()
        self.factor = np.zeros(A.shape, order="F")

    def push(self, j: int) -> bool:
        """Let row j enter, if it is independent enough of the others."""
        k = len(self.rows)
        v = dtrtrs(self.factor[:k, :k], self.A[self.rows, j], lower=1)[0] if k else np.zeros(0)
        pivot = self.A[j, j] - v @ v
        if pivot < PIVOT:
            return False
        self.factor[k, :k], self.factor[k, k] = v, np.sqrt(pivot)
        self.rows.append(j)
        return True

    def pop(self, i: int) -> None:
        """Let the i-th row leave."""
        L = self.factor
        del self.rows[i]
        k, later = len(self.rows), self.rows[i:]
        head = L[i + 1 : k + 1, :i].copy()
        tail, _ = dpotrf(self.A[np.ix_(later, later)] - head @ head.T, lower=1)
        L[i:k, :i], L[i:k, i:k] = head, np.tril(tail)

    def minimiser(self, b: Array) -> Array:
        """Return the minimum over the support, without signs."""
        k = len(self.rows)
        half = dtrtrs(self.factor[:k, :k], b[self.rows], lower=1)[0]
        return -dtrtrs(self.factor[:k, :k], half, lower=1, trans=1)[0]


def active_set(A: Array, b: Array, start: Array) -> Array | None:
    """Return lam, or None if the slopes of rows that may not enter are too large; A has diagonal 1."""
    count = len(b)
    lam, support, blocked = np.maximum(start, 0.0), _Support(A), np.zeros(len(b), dtype=bool)
    for j in np.argsort(-lam)[: np.count_nonzero(lam)]:
        if not support.push(int(j)):
            lam[j] = 0.0
    for _ in range(10 * count + 100):
        if _descend(support, b, lam):
            blocked[:] = False
        slope = A @ lam + b
        entering = slope.copy()
        entering[support.rows], entering[blocked] = 0.0, 0.0
        j = int(np.argmin(entering))
        if entering[j] > -SLOPE * (1 + SLOPE_GROWTH * lam.max(initial=0.0)):
            return lam if slope.min() > -CONTENT else None
        if not support.push(j):
            blocked[j] = True
    return None


def _descend(support: _Support, b: Array, lam: Array) -> bool:
    """Move lam to the minimum over its support, dropping rows that turn negative; return whether any did."""
    dropped = False
    while support.rows:
        goal, now = support.minimiser(b), lam[support.rows]
        bad = goal <= 0
        if not bad.any():
            lam[:] = 0.0
            lam[support.rows] = goal
            break
        dropped = True
        step = np.min(now[bad] / np.maximum(now[bad] - goal[bad], 1e-300))
        now = now + step * (goal - now)
        leaving = np.flatnonzero(bad & (now <= VANISHED * max(1.0, now.max())))
        if not len(leaving):
            leaving = [int(np.argmin(np.where(bad, now, np.inf)))]
        lam[support.rows] = now
        for i in leaving[::-1]:
            lam[support.rows[i]] = 0.0
            support.pop(int(i))
    return dropped
