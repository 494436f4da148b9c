"""The reduced system of the kept side for long horizons, by projected conjugate gradients.

See Gould, Hribar and Nocedal (2001), and Dollar et al. (2006) for C > 0. No matrix is larger than the unknowns times
rows and directions of large weights, which are rows Y as well: all rows are B = (Y, E), their compliance is (D^-1, C).
The preconditioner is the same system with P, the regulator of second_level.py, in the place of M.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as la

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.methods.structured.kkt.dense import Cholesky
from lin_freq_ocp.methods.structured.kkt.kept.excess import Noise, rows_of
from lin_freq_ocp.methods.structured.kkt.kept.second_level import SecondLevel
from lin_freq_ocp.methods.structured.kkt.kept.space import KeptSpace

REDUCTION = 1e-9  # of the residual in one solution, so that seldom another is needed
MOST_ITERATIONS = 100  # 5 to 15 are common
PROJECTIONS = 2  # on the rows: the second leaves rounding, which large weights multiply
PATIENCE = 10  # iterations in which the residual should fall: else rounding holds it


class TwoLevel:
    """Projected conjugate gradients on the reduced system."""

    def __init__(self, space: KeptSpace):
        self._space, self._E, self._noise = space, space.rows(), Noise(space)
        held = self._E[: space.continuity + len(space.terminal)]
        self._second = SecondLevel(space, float((held * held).sum(0).max(initial=0.0)))
        self.iterations: list[int] = []

    def factor(self, Phi: Array, C: Array) -> bool:
        """Prepare for Phi (T+1, nz, nz) and C (rows, rows)."""
        self._clipped, self._excess = self._noise.clipped(Phi)
        self._second.factor(self._clipped)
        self._directions = len(self._excess.times)
        self._B = np.concatenate([rows_of(self._excess, self._space), self._E])
        self._PB = self._second.solve_many(self._B)
        S = self._B @ self._PB.T
        self._C = la.block_diag(np.diag(1 / self._excess.weights), C)
        self._schur = Cholesky(S + self._C)
        return False

    def solve(self, r: Array, e: Array) -> tuple[Array, Array]:
        """Return v and nu."""
        zero, count = np.zeros(len(self._B)), self._directions
        right = np.concatenate([zero[:count], e])
        v, nu = self._projected(np.zeros_like(r), right) if e.any() else (np.zeros_like(r), zero.copy())
        left = r - self._applied(v, nu) if nu.any() else r.copy()
        target, direction, of_rows = REDUCTION * _largest(r), np.zeros_like(r), zero
        slope, least, since, iterations = 1.0, np.inf, 0, 0
        while (error := _largest(left)) > target and iterations < MOST_ITERATIONS:
            least, since = (error, iterations) if error < least else (least, since)
            if iterations - since > PATIENCE:
                break
            step, prices = self._projected(left, zero)
            slope, before = float(left @ step), slope
            beta = slope / before if iterations else 0.0
            direction, of_rows = step + beta * direction, prices + beta * of_rows
            bent = self._applied(direction, of_rows)
            curvature = float(direction @ bent)
            if not (slope > 0 and curvature > 0):
                break
            v += slope / curvature * direction
            nu += slope / curvature * of_rows
            left -= slope / curvature * bent
            iterations += 1
        self.iterations.append(iterations)
        return v, nu[count:]

    def _applied(self, v: Array, nu: Array) -> Array:
        """Return M v, of clipped weights, plus nu times all rows."""
        space, excess = self._space, self._excess
        y, _ = space.simulated(v)
        of_y, prices = space.priced(nu[self._directions :])
        of_y += space.loops.times(self._clipped, y)
        np.add.at(of_y, excess.times, nu[: self._directions, None] * excess.directions)
        return space.gradient(of_y, prices)

    def _projected(self, r: Array, e: Array) -> tuple[Array, Array]:
        """Solve the system of the preconditioner."""
        v = self._second.solve(r) if r.any() else np.zeros_like(r)
        nu = np.zeros_like(e)
        for _ in range(PROJECTIONS if len(e) else 0):
            more = self._schur.solve(self._B @ v - self._C @ nu - e)
            v, nu = v - more @ self._PB, nu + more
        return v, nu


def _largest(values: Array) -> float:
    return float(np.abs(values).max(initial=0.0))
