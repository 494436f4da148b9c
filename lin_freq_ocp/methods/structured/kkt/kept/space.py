"""The unknowns of the kept side, v = (z, starts, free entries of x_0), and the rows that are left on them.

Open loop diverges on unstable dynamics, and so the simulation starts anew at break times (multiple shooting): the
starts are unknowns. Rows, in this order: starts - ends of the simulations before them, x_T, rows that are no stop band.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.methods.structured.kkt.kept.coefficients import Coefficients, Remaining, StopBand
from lin_freq_ocp.methods.structured.kkt.kept.slacks import Slacks
from lin_freq_ocp.methods.structured.kkt.recursions import Loops
from lin_freq_ocp.methods.structured.model.stages import Stages

GROWTH = 1e3  # of the states between breaks: three digits are lost at most


class KeptSpace:
    """The map from v to y, and its adjoint."""

    def __init__(self, stages: Stages, slacks: Slacks, bands: list[StopBand], rest: list[Remaining], loops: Loops):
        self.loops, self.A = loops, stages.A
        self.B = np.ascontiguousarray(stages.B[:, :, slacks.controls])
        self.horizon, self.states, self.controls = stages.horizon, stages.states, len(slacks.controls)
        self.coefficients = Coefficients(stages, bands, slacks.controls)
        self.breaks = break_times(stages.A, GROWTH)
        self.free, self.fixed = np.flatnonzero(~stages.fixed), stages.fixed
        self._starts = self.coefficients.count + len(self.breaks) * self.states
        self.size = self._starts + len(self.free)
        self.terminal, self._rest = stages.coupling.terminal, rest
        place = np.full(stages.H.shape[1], -1)
        place[slacks.core] = np.arange(len(slacks.core))
        self._channels = place[stages.coupling.channels]
        self.continuity = len(self.breaks) * self.states
        self.counts = [self.continuity, len(self.terminal), *(len(part.at) for part in rest)]
        self.row_count = sum(self.counts)
        self.chosen = np.concatenate([np.arange(len(self.terminal)), *(part.at for part in rest)])
        self.zero = np.zeros((len(self.breaks), self.states))
        self._still = np.zeros_like(stages.d)

    def simulated(self, v: Array, y: Array | None = None, c: Array | None = None) -> tuple[Array, Array]:
        """Add the controls of v to y (T+1, nz), write its states, and return it with the ends (K, n)."""
        n, kept = self.states, self.coefficients.count
        if y is None:
            y = np.zeros((self.horizon + 1, n + self.controls))
        y[:, n:] += self.coefficients.synthesis(v[None, :kept])[:, :, 0]
        y[0, self.free] = v[self._starts :]
        starts = np.ascontiguousarray(v[kept : self._starts]).reshape(self.zero.shape)
        return y, self.loops.forward(self.A, self.B, self._still if c is None else c, self.breaks, starts, y)

    def gradient(self, of_y: Array, prices: Array | None = None) -> Array:
        """Return the gradient in v of of_y'y + prices'(starts - ends)."""
        prices = self.zero if prices is None else prices
        p, gw, of_starts = self.loops.backward(self.A, self.B, of_y, self.breaks, prices)
        z = self.coefficients.analysis(gw[:, :, None])[0]
        return np.concatenate([z, (of_starts + prices).ravel(), p[0, self.free]])

    def curvature(self, Phi: Array, v: Array) -> Array:
        """Return the gradient in v of 1/2 y'Phi y."""
        y, _ = self.simulated(v)
        return self.gradient(self.loops.times(Phi, y))

    def values(self, y: Array, ends: Array) -> Array:
        """Return what y adds to the rows when its simulations start from zero."""
        signals = y[:, self._channels, None] if self._rest else y[:, :0, None]
        rest = [part.rows.forward(signals)[:, 0] for part in self._rest]
        return np.concatenate([-ends.ravel(), y[-1, self.terminal], *rest])

    def right(self, f: Array) -> Array:
        """Return the right-hand sides of the rows from those of F."""
        return np.concatenate([np.zeros(self.continuity), f[self.chosen]])

    def priced(self, nu: Array) -> tuple[Array, Array]:
        """Return the gradient in y (T+1, nz), and the prices (K, n), of multipliers of the rows."""
        prices, terminal, rest = np.split(nu, np.cumsum(self.counts[:2]))
        of_y = np.zeros((self.horizon + 1, self.states + self.controls))
        of_y[-1, self.terminal] = terminal
        signals = np.zeros((self.horizon + 1, len(self._channels), 1))
        first = 0
        for part in self._rest:
            part.rows.add_adjoint(rest[first : first + len(part.at), None], signals)
            first += len(part.at)
        if first:
            of_y[:, self._channels] += signals[:, :, 0]
        return of_y, prices.reshape(self.zero.shape)

    def unpriced(self, nu: Array, coupling: Array) -> None:
        """Write the multipliers of the rows into those of F."""
        coupling[self.chosen] = nu[self.continuity :]

    def rows(self) -> Array:
        """Return the rows as a matrix (rows, size)."""
        found = np.empty((self.row_count, self.size))
        for i in range(self.row_count):
            of_y, prices = self.priced(np.eye(1, self.row_count, i)[0])
            found[i] = self.gradient(of_y, prices)
        return found


def break_times(A: Array, growth: float) -> Indices:
    """Return the times within 1 .. T-1 before which a product of transition matrices has grown so far."""
    found: list[int] = []
    product = np.eye(A.shape[1])
    for t in range(len(A) - 2):
        product = A[t] @ product
        if np.abs(product).max() > growth:
            found.append(t + 1)
            product = np.eye(A.shape[1])
    return np.array(found, dtype=np.intp)
