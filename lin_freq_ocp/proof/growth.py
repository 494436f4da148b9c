"""How many digits a recursion through the dynamics needs: by how much it can enlarge an error over the horizon."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array

DIGITS = 96  # bits beyond those that errors grow by: of a double, with some for the size of the terms and their number


def precision(A: Array, horizon: int) -> int:
    """Return the bits of a proof.

    Radii of balls grow as products of |A_t|. The linear system of the equations at the end squares both, once more than
    the recursion through its solution.
    """
    bits = 2 * growth(A, horizon) + 2 * growth(np.abs(A), horizon)
    return DIGITS + int(np.ceil(bits)) + 4 * int(np.log2(horizon + 1))


def growth(A: Array, horizon: int) -> float:
    """Return the base-2 logarithm of the largest norm of A_t ... A_s over the horizon, zero or above, or a bit more.

    A is (n, n) or (T, n, n). Logarithms are added up, as the product itself may overflow.
    """
    return _of_powers(A, horizon) if A.ndim == 2 else _of_products(A)


def _of_powers(A: Array, horizon: int) -> float:
    """Return the growth of powers of one matrix, by squaring."""
    power, logarithm, largest, steps = np.array(A), 0.0, 0.0, 1
    while steps <= horizon:
        size = float(np.linalg.norm(power))
        if size == 0:
            break
        logarithm, power = logarithm + np.log2(size), power / size
        largest = max(largest, logarithm * min(horizon / steps, 2.0))
        power, logarithm, steps = power @ power, 2 * logarithm, 2 * steps
    return largest


def _of_products(A: Array) -> float:
    """Return the growth of products, by the largest rise of the logarithm of a product from time 0 on."""
    product, logarithm, least, largest = np.eye(A.shape[-1]), 0.0, 0.0, 0.0
    for matrix in A:
        product = matrix @ product
        size = float(np.linalg.norm(product))
        if size == 0:
            return largest
        logarithm, product = logarithm + np.log2(size), product / size
        least = min(least, logarithm)
        largest = max(largest, logarithm - least)
    return largest
