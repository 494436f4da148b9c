"""The regulator that approximates the reduced system: all coefficients free, and weights clipped.

Let Phi_c be Phi without the excess of its largest weights. The Hessian of y'Phi_c y in all samples of u couples the
kept coefficients k with the stopped ones s only as far as weights vary over time, and M_c = H_kk, while the inverse of
a regulator gives

    N' H^-1 N = (H_kk - H_ks H_ss^-1 H_sk)^-1.

If the weights are within a ratio q, both differ by 1 - ((q - 1)/(q + 1))^2 at most (Wielandt's inequality); hence the
clip of excess.py. Jumps of the state, with a price of rho, stand for the starts: (starts - ends)^2 rho is added to H.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.methods.structured.kkt.kept.excess import control_weights
from lin_freq_ocp.methods.structured.kkt.kept.space import KeptSpace

JUMP_WEIGHT = 10.0  # rho relative to the weight of the control: of order 1, for both to keep their digits
BLOCK_BYTES = 3e7  # of the signals of one block: they stay in the cache
MOST_COLUMNS = 64


class SecondLevel:
    """The clipped regulator of a space, restricted to v."""

    def __init__(self, space: KeptSpace, height: float):
        self._space, n, m, T = space, space.states, space.controls, space.horizon
        self._height = height  # largest squared column of the rows of starts and x_T
        per = -(-n // m)  # stages for a jump, of m components each
        jumps = np.zeros(T + 1, dtype=np.intp)
        jumps[space.breaks] = per
        self._at = np.arange(T + 1) + np.cumsum(jumps)
        self._starts = self._at[space.breaks]
        stages = T + 1 + per * len(space.breaks)
        self._jumps = np.setdiff1d(np.arange(stages), self._at)
        self._A, self._B = np.tile(np.eye(n), (stages, 1, 1)), np.zeros((stages, n, m))
        self._A[self._at], self._B[self._at] = space.A, space.B
        for i in range(n):
            self._B[self._starts - per + i // m, i, i % m] = 1.0
        self._still = np.zeros((stages, n))
        self._entries = np.arange(n + m) if len(space.breaks) or len(space.free) else np.arange(n, n + m)
        per_column = 8 * stages * len(self._entries)
        self._block = int(np.clip(BLOCK_BYTES / per_column, 8, MOST_COLUMNS))

    def factor(self, clipped: Array) -> None:
        """Factor the regulator of clipped weights (T+1, nz, nz)."""
        space, n, m = self._space, self._space.states, self._space.controls
        clipped, level = clipped.copy(), float(control_weights(clipped, n).mean())
        rho = JUMP_WEIGHT * level / (1 + self._height)
        clipped[-1, space.terminal, space.terminal] += rho
        expanded = np.zeros((len(self._A), n + m, n + m))
        expanded[self._at] = clipped
        expanded[self._jumps[:, None], np.arange(n, n + m), np.arange(n, n + m)] = rho
        self._regulator = space.loops.factor(self._A, self._B, expanded, space.fixed)

    def solve(self, r: Array) -> Array:
        """Return the approximate M^-1 r."""
        space, n, kept = self._space, self._space.states, self._space.coefficients.count
        gradient = np.zeros((len(self._A), n + space.controls))
        gradient[self._at, n:] = -space.coefficients.synthesis(r[None, :kept])[:, :, 0]
        starts, first = np.split(-r[kept:], [space.continuity])
        gradient[self._starts, :n] = starts.reshape(-1, n)
        gradient[0, space.free] += first
        y, _, _ = self._regulator.solve(gradient, self._still, self._still[0])
        z = space.coefficients.analysis(y[self._at, n:, None])[0]
        return np.concatenate([z, y[self._starts, :n].ravel(), y[0, space.free]])

    def solve_many(self, rows: Array) -> Array:
        """Return the approximate M^-1 of rows (count, size), as rows."""
        space, n, kept = self._space, self._space.states, self._space.coefficients.count
        found = np.empty_like(rows)
        controls, states = slice(-space.controls, None), slice(0, n)
        for a in range(0, len(rows), self._block):
            part = rows[a : a + self._block]
            R = np.zeros((len(self._A), len(self._entries), len(part)))
            R[self._at, controls] = space.coefficients.synthesis(part[:, :kept])
            if len(self._entries) > space.controls:
                R[self._starts, states] = part[:, kept : kept + space.continuity].T.reshape(-1, n, len(part))
                R[0, space.free] += part[:, kept + space.continuity :].T
            Y, _ = self._regulator.responses(self._entries, R, np.zeros((n, len(part))))
            own = found[a : a + self._block]
            own[:, :kept] = -space.coefficients.analysis(Y[self._at, controls])
            if len(self._entries) > space.controls:
                own[:, kept : kept + space.continuity] = -Y[self._starts, states].reshape(-1, len(part)).T
                own[:, kept + space.continuity :] = -Y[0, space.free].T
        return found
