"""Dense symmetric positive definite matrices: a Cholesky factors of them, scaled to a diagonal of ones."""

from __future__ import annotations

import numpy as np
from scipy.linalg import blas, lapack

from lin_freq_ocp.base.arrays import Array

LEAST_SHIFT = 1e-14  # of the diagonal of ones, at first, for a matrix that rounding made indefinite


class Cholesky:
    """M = D^-1 L L' D^-1, M shifted as far as it must be; only the lower triangle of M counts, and M is overwritten.

    The factor of a matrix that is not finite is not finite either. ``definite``: M needed no more than the least shift.
    """

    def __init__(self, M: Array):
        self._scale = 1 / np.sqrt(np.maximum(np.diag(M), np.finfo(float).tiny))
        M *= self._scale
        M *= self._scale[:, None]
        shift = LEAST_SHIFT
        while True:
            shifted = M.copy(order="C")
            shifted.flat[:: len(M) + 1] += shift
            self._upper, failed = lapack.dpotrf(shifted.T, lower=0, overwrite_a=1, clean=0)  # L'
            if not failed or not np.isfinite(shift):
                self.definite = not failed and shift == LEAST_SHIFT
                break
            shift *= 100

    def solve(self, right: Array) -> Array:
        """Return M^-1 right, for right (rows,) or (rows, k)."""
        if not right.size:
            return right.copy()
        scale = self._scale if right.ndim == 1 else self._scale[:, None]
        return scale * lapack.dpotrs(self._upper, scale * right, lower=0)[0]

    def rooted(self, rows: Array) -> Array:
        """Return rows R with R R' = M, (count, rows of M)."""
        return blas.dtrmm(1.0, self._upper, (rows / self._scale).T, overwrite_b=1).T

    def whitened(self, right: Array) -> Array:
        """Return L^-1 D right, (rows, k): its Gram matrix is right' M^-1 right."""
        if not right.size:
            return right.copy()
        return blas.dtrsm(1.0, self._upper, self._scale[:, None] * right, trans_a=1)


def gram(rows: Array, total: Array | None = None) -> Array:
    """Return the lower triangle of rows'rows, added to that of a total, which is overwritten."""
    if total is None:
        total = np.zeros((rows.shape[1], rows.shape[1]))
    return blas.dsyrk(1.0, rows.T, beta=1.0, c=total.T, overwrite_c=1).T if rows.size else total
