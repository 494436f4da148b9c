"""Whether matrices are positive semidefinite, in exact arithmetic."""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache

import numpy as np

from lin_freq_ocp.base.arrays import Array

RISES = (0.0, 2.0**-54, 2.0**-52, 2.0**-50, 2.0**-46)  # parts of a diagonal that a rounded product may lack
MOST_ROWS = 100  # of a matrix whose elimination in whole numbers takes at most seconds


def is_semidefinite(matrix: Array, rise: float = 0.0) -> bool:
    """Whether the symmetric part of a matrix, its diagonal times 1 + rise, is positive semidefinite, without rounding.

    A product c c' in floating point is rounded: its least eigenvalue may be -1e-17 instead of 0, and a cost with this
    Hessian falls below zero far away. Floating point cannot distinguish the two. Bareiss's (1968) elimination in whole
    numbers, which divides without remainder, can.
    """
    entries = [[Fraction(x) for x in row] for row in (matrix + 0.0).tolist()]
    unit = max((x.denominator for row in entries for x in row), default=1) * Fraction(rise).denominator
    rows = [
        [int(unit * (x + entries[j][i] + (2 * Fraction(rise) * x if i == j else 0))) for j, x in enumerate(row)]
        for i, row in enumerate(entries)
    ]
    before = 1
    while rows:
        (pivot, *rest), rows = rows[0], rows[1:]
        if pivot < 0 or (pivot == 0 and any(rest)):
            return False
        if pivot == 0:
            rows = [row[1:] for row in rows]
            continue
        rows = [[(pivot * x - row[0] * y) // before for x, y in zip(row[1:], rest, strict=True)] for row in rows]
        before = pivot
    return True


def least_rise(matrix: Array) -> float:
    """Return the least of RISES with which ``is_semidefinite``: 0 for a sum of squares; inf without one.

    The cost v'H v / 2 is at least minus this part of sum_i H_ii v_i^2 / 2.
    """
    diagonal = np.diagonal(matrix)
    if np.array_equal(matrix, np.diag(diagonal)):
        return 0.0 if (diagonal >= 0).all() else np.inf
    return _least_rise(np.ascontiguousarray(matrix, dtype=np.float64).tobytes(), len(matrix))


@lru_cache(maxsize=4096)
def _least_rise(content: bytes, size: int) -> float:
    matrix = np.frombuffer(content).reshape(size, size)
    if size > MOST_ROWS:
        return np.inf
    return next((rise for rise in RISES if is_semidefinite(matrix, rise)), np.inf)
