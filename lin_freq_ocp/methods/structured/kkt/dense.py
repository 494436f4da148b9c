"""Dense symmetric positive definite matrices: a Cholesky factor of the matrix scaled to a diagonal of ones."""

from __future__ import annotations

import numpy as np
import scipy.linalg as la

from lin_freq_ocp.arrays import Array

LEAST_SHIFT = 1e-14  # of the diagonal of ones, at first, for a matrix that rounding made indefinite


class Cholesky:
    """M = D^-1 L L' D^-1, M shifted as far as it must be; only the mean of M and M' counts, and M is overwritten.

    The factor of a matrix that is not finite is not finite either.
    """

    def __init__(self, M: Array):
        self._scale = 1 / np.sqrt(np.maximum(np.diag(M), np.finfo(float).tiny))
        M = 0.5 * (M + M.T)
        M *= self._scale
        M *= self._scale[:, None]
        shift = LEAST_SHIFT
        while True:
            shifted = M.T.copy(order="F")
            shifted.flat[:: len(M) + 1] += shift
            self._factor, failed = la.lapack.dpotrf(shifted, lower=1, overwrite_a=1, clean=0)
            if not failed or not np.isfinite(shift):
                break
            shift *= 100

    def solve(self, right: Array) -> Array:
        """Return M^-1 right, for right (rows,) or (rows, k)."""
        scale = self._scale if right.ndim == 1 else self._scale[:, None]
        return scale * la.cho_solve((self._factor, True), scale * right, check_finite=False)

    @property
    def root(self) -> Array:
        """Return R with R R' = M, lower triangular."""
        return np.tril(self._factor) / self._scale[:, None]

    def whitened(self, right: Array) -> Array:
        """Return L^-1 D right, (rows, k): its Gram matrix is right' M^-1 right."""
        scaled = self._scale[:, None] * right
        return la.solve_triangular(self._factor, scaled, lower=True, check_finite=False)
