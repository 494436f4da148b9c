"""Factors of small symmetric matrices, and products of vectors, compiled by numba."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.methods.structured.kkt.compiled.compilation import jit

PIVOT = 1e-14
"""Least pivot relative to the diagonal entry before elimination: below it there is rounding only."""


@jit
def cholesky(M: Array, size: int) -> None:
    """Replace the leading block by its lower factor; a pivot of a zero row is set by the largest diagonal entry."""
    largest = 0.0
    for j in range(size):
        largest = max(largest, M[j, j])
    if largest == 0.0:
        largest = 1.0
    for j in range(size):
        own = M[j, j] if M[j, j] > 0.0 else largest
        pivot = M[j, j]
        for i in range(j):
            pivot -= M[j, i] * M[j, i]
        pivot = np.sqrt(max(pivot, PIVOT * own))
        M[j, j] = pivot
        for i in range(j + 1, size):
            value = M[i, j]
            for m in range(j):
                value -= M[i, m] * M[j, m]
            M[i, j] = value / pivot


@jit
def cholesky_solve(L: Array, size: int, b: Array) -> None:
    """Replace b by (L L')^-1 b."""
    for i in range(size):
        value = b[i]
        for m in range(i):
            value -= L[i, m] * b[m]
        b[i] = value / L[i, i]
    for i in range(size - 1, -1, -1):
        value = b[i]
        for m in range(i + 1, size):
            value -= L[m, i] * b[m]
        b[i] = value / L[i, i]


@jit
def dot(x: Array, y: Array) -> float:
    """Return x'y."""
    value = 0.0
    for i in range(len(x)):
        value += x[i] * y[i]
    return value


@jit
def largest(x: Array) -> float:
    """Return the largest absolute entry."""
    value = 0.0
    for i in range(len(x)):
        value = max(value, abs(x[i]))
    return value
