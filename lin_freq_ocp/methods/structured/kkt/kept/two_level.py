"""The reduced system of the kept side for long horizons, by projected conjugate gradients.

See Gould, Hribar and Nocedal (2001), and Dollar et al. (2006) for C > 0. No matrix is larger than the unknowns times
rows and active directions. The preconditioner is the system itself with P + Y'D Y in place of M: the clipped regulator
of second_level.py, and the directions Y that it leaves out. With all rows B = (Y, E) that is one dense matrix,
B P^-1 B' + diag(D^-1, C).
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.methods.structured.kkt.dense import Cholesky
from lin_freq_ocp.methods.structured.kkt.kept.second_level import Excess, SecondLevel
from lin_freq_ocp.methods.structured.kkt.kept.space import KeptSpace

REDUCTION = 1e-9  # of the residual in one solution, so that seldom another is needed
MOST_ITERATIONS = 100  # 5 to 15 are common
PATIENCE = 10  # iterations in which the residual should fall: else rounding holds it


class TwoLevel:
    """Projected conjugate gradients on the reduced system."""

    def __init__(self, space: KeptSpace):
        self._space, self._E = space, space.rows()
        held = self._E[: space.continuity + len(space.terminal)]
        self._second = SecondLevel(space, float((held * held).sum(0).max(initial=0.0)))
        self.iterations: list[int] = []

    def factor(self, Phi: Array, C: Array) -> None:
        """Prepare for Phi (T+1, nz, nz) and C (rows, rows)."""
        self._Phi = Phi
        excess = self._second.factor(Phi)
        count = len(excess.weights)
        self._B = np.concatenate([self._responses(excess), self._E])
        self._PB = self._second.solve_many(self._B)
        S = self._B @ self._PB.T
        S[range(count), range(count)] += 1 / excess.weights
        S[count:, count:] += C
        self._directions = count
        self._schur = Cholesky(S)

    def solve(self, r: Array, e: Array) -> tuple[Array, Array]:
        """Return v and nu."""
        v, nu = self._projected(np.zeros_like(r), e) if e.any() else (np.zeros_like(r), np.zeros_like(e))
        left = r - self._space.curvature(self._Phi, v, nu) if v.any() or nu.any() else r.copy()
        size = float(np.abs(r).max(initial=0.0))
        zero, direction, slope, iterations = np.zeros_like(e), np.zeros_like(r), 1.0, 0
        of_rows, least, since = zero, np.inf, 0
        while size * REDUCTION < (error := float(np.abs(left).max(initial=0.0))) and iterations < MOST_ITERATIONS:
            least, since = (error, iterations) if error < least else (least, since)
            if iterations - since > PATIENCE:
                break
            step, prices = self._projected(left, zero)
            slope, before = float(left @ step), slope
            if not slope > 0:
                break
            beta = slope / before if iterations else 0.0
            direction, of_rows = step + beta * direction, prices + beta * of_rows
            bent = self._space.curvature(self._Phi, direction, of_rows)
            curvature = float(direction @ bent)
            if not curvature > 0:
                break
            v += slope / curvature * direction
            nu += slope / curvature * of_rows
            left -= slope / curvature * bent
            iterations += 1
        self.iterations.append(iterations)
        return v, nu

    def _projected(self, r: Array, e: Array) -> tuple[Array, Array]:
        """Solve the system of the preconditioner."""
        v = self._second.solve(r) if r.any() else np.zeros_like(r)
        missing = self._B @ v
        missing[self._directions :] -= e
        w = self._schur.solve(missing) if len(missing) else missing
        return v - w @ self._PB, w[self._directions :]

    def _responses(self, excess: Excess) -> Array:
        """Return the directions as rows on v."""
        space = self._space
        found = np.empty((len(excess.times), space.size))
        of_y = np.zeros((space.horizon + 1, space.states + space.controls))
        for row, t, direction in zip(found, excess.times, excess.directions, strict=True):
            of_y[t] = direction
            row[:] = space.gradient(of_y)
            of_y[t] = 0.0
        return found
