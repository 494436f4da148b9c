"""(zI - A)^{-1} at all bins at once, by back substitution in a complex Schur form A = U T U^* (docs/spectral.md, 2)."""

from __future__ import annotations

import numpy as np
from scipy.linalg import schur

from lin_freq_ocp.arrays import Array, ComplexArray


class Resolvent:
    """The resolvent of A; no powers of A occur, so unstable dynamics are as good as any."""

    def __init__(self, A: Array):
        self.triangle, self.unitary = schur(A.astype(np.complex128), output="complex")
        self.eigenvalues: ComplexArray = np.diagonal(self.triangle)
        self._adjoint = self.unitary.conj().T

    def apply(self, z: ComplexArray, rhs: ComplexArray) -> ComplexArray:
        """Return (z_k I - A)^{-1} rhs_k, for z (bins,) and rhs (n, columns, bins); inf or NaN at eigenvalues."""
        Y = _times(self._adjoint, rhs)
        for i in range(len(Y) - 1, -1, -1):
            for j in range(i + 1, len(Y)):
                if self.triangle[i, j]:
                    Y[i] += self.triangle[i, j] * Y[j]
            Y[i] /= z - self.triangle[i, i]
        return _times(self.unitary, Y)

    def apply_adjoint(self, z: ComplexArray, rhs: ComplexArray) -> ComplexArray:
        """Return (z_k I - A)^{-*} rhs_k, for rhs (n, bins)."""
        Y = self._adjoint @ rhs
        for i in range(len(Y)):
            for j in range(i):
                if self.triangle[j, i]:
                    Y[i] += self.triangle[j, i].conj() * Y[j]
            Y[i] /= (z - self.triangle[i, i]).conj()
        return self.unitary @ Y

    def size(self, z: ComplexArray) -> Array:
        """Return the sum of the absolute values of the entries of (z_k I - A)^{-1}, shape (bins,)."""
        n = len(self.triangle)
        identity = np.broadcast_to(np.eye(n, dtype=np.complex128)[:, :, None], (n, n, len(z)))
        return np.abs(self.apply(z, identity)).sum((0, 1))


def _times(matrix: ComplexArray, X: ComplexArray) -> ComplexArray:
    """Return the matrix applied along the first axis of X (n, columns, bins)."""
    return (matrix @ X.reshape(len(X), -1)).reshape(X.shape)
