"""The reduced system of the kept side by dense factors.

M comes from one sweep forward and one backward for each column. E'E is added to it for the rows with C = 0: that leaves
the solution alone, and makes it definite where only these rows hold the starts. Large weights are rows as well.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as la

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.methods.structured.kkt.blocks import OpenLoop
from lin_freq_ocp.methods.structured.kkt.dense import Cholesky
from lin_freq_ocp.methods.structured.kkt.kept.excess import Noise, rows_of
from lin_freq_ocp.methods.structured.kkt.kept.space import KeptSpace

COLUMNS = 128  # of M at once
CACHED_BYTES = 3e8  # of the signals of the coefficients that are kept between steps
PROJECTIONS = 2  # on the rows: the second leaves rounding, which large weights multiply
WEIGHT = 10.0  # of E'E, relative to the mean diagonal of M: of order 1, for both to keep their digits
RAISED = (1.0, 1e2, 1e4)  # factors of the weight, for an M that is definite only on what the rows leave


class DenseReduced:
    """Cholesky factors of M + rho E'E and of the Schur complement of the rows."""

    def __init__(self, space: KeptSpace):
        self._space, self._E, self._noise = space, space.rows(), Noise(space)
        kept = space.coefficients.count
        self._blocks = [slice(a, min(kept, a + COLUMNS)) for a in range(0, kept, COLUMNS)]
        cached = 8 * (space.horizon + 1) * space.controls * kept <= CACHED_BYTES
        self._signals = [self._signals_of(block) for block in self._blocks] if cached else None

    def factor(self, Phi: Array, C: Array) -> bool:
        """Prepare for Phi (T+1, nz, nz) and C (rows, rows)."""
        clipped, excess = self._noise.clipped(Phi)
        M, E = self._hessian(clipped), self._E
        self._exact = ~C.any(axis=1)
        held = E[self._exact]
        size = WEIGHT * float(np.abs(np.diag(M)).mean()) / (1 + float((held * held).sum(0).max(initial=0.0)))
        for raised in RAISED:
            self._weight = raised * size
            self._M = Cholesky(M + self._weight * (held.T @ held))
            if self._M.definite or not len(held):
                break
        self._B = np.concatenate([rows_of(excess, self._space), E])
        self._MB = self._M.solve(self._B.T)
        self._C = la.block_diag(np.diag(1 / excess.weights), C)
        self._S = Cholesky(self._B @ self._MB + self._C)
        return self._M.definite

    def solve(self, r: Array, e: Array) -> tuple[Array, Array]:
        """Return v and nu."""
        exact, count = self._exact, len(self._B) - len(e)
        v = self._M.solve(r + self._weight * (self._E[exact].T @ e[exact]))
        right, nu = np.concatenate([np.zeros(count), e]), np.zeros(len(self._B))
        for _ in range(PROJECTIONS if len(nu) else 0):
            more = self._S.solve(self._B @ v - self._C @ nu - right)
            v, nu = v - self._MB @ more, nu + more
        return v, nu[count:]

    def _hessian(self, Phi: Array) -> Array:
        space, kept = self._space, self._space.coefficients.count
        M = np.empty((space.size, space.size))
        sweeps = OpenLoop(space.A, space.B, Phi, space.breaks)
        for i, block in enumerate(self._blocks):
            W = self._signals[i] if self._signals is not None else self._signals_of(block)
            starts = np.zeros((*space.zero.shape, W.shape[2]))
            GW, of_starts, _, _ = sweeps.columns(starts, W)
            M[block, :kept] = space.coefficients.analysis(GW)
            M[block, kept : kept + space.continuity] = of_starts.reshape(-1, W.shape[2]).T
        for i in range(kept, space.size):
            M[i] = space.curvature(Phi, np.eye(1, space.size, i)[0])
            M[:kept, i] = M[i, :kept]
        return M

    def _signals_of(self, block: slice) -> Array:
        coefficients = self._space.coefficients
        return coefficients.synthesis(np.eye(block.stop - block.start, coefficients.count, block.start))
