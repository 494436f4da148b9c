"""The side of the rows that couple times: their Schur complement, S = F P F' + C, dense.

P is the response of the regulator: its columns F P are solutions of one recursion for many gradients at once. A fixed
x_T adds rho |x_T - its state|^2 to the system that the recursion solves, which leaves the answer alone and keeps the
closed loop stable on long horizons of unstable dynamics.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.linalg as la

from lin_freq_ocp.arrays import Array, Indices
from lin_freq_ocp.methods.structured.kkt.recursions import Loops
from lin_freq_ocp.methods.structured.kkt.side import Compliance, Step
from lin_freq_ocp.methods.structured.model.coupling import Rows
from lin_freq_ocp.methods.structured.model.stages import Stages

COLUMNS = 256  # of the response at once: enough for vector instructions, few enough for the memory
TERMINAL_WEIGHT = 1e2  # of the distance from the terminal state, relative to the largest curvature
LEAST_CURVATURE = 1e-3  # of order 1 are the units
LEAST_SHIFT = 1e-14  # of the diagonal of S, relative, at first, where its factorisation fails
CACHED_BYTES = 1e9  # of columns of F that are kept between steps


class StoppedSide:
    """The Schur complement on all rows that couple times."""

    def __init__(self, stages: Stages, loops: Loops):
        self._stages, self._coupling, self._loops = stages, stages.coupling, loops
        self._families = list(_families(stages))
        self._weights = np.zeros(stages.states)
        curvature = float(np.abs(np.einsum("tii->ti", stages.H[:-1])).max(initial=0.0))
        self._weights[self._coupling.terminal] = TERMINAL_WEIGHT * max(curvature, LEAST_CURVATURE)
        count = self._coupling.count
        self._blocks = [np.arange(a, min(count, a + COLUMNS)) for a in range(0, count, COLUMNS)]
        size = 8 * len(stages.H) * len(self._coupling.channels) * count
        self._columns = {i: self._gradients(rows) for i, rows in enumerate(self._blocks) if size <= CACHED_BYTES}

    def factor(self, Phi: Array, compliance: Compliance) -> None:
        """Prepare for Phi (T+1, n+k, n+k) and C."""
        stages, n = self._stages, self._stages.states
        Phi = Phi.copy()
        Phi[-1, :n, :n] += np.diag(self._weights)
        self._regulator = self._loops.factor(stages.A, stages.B, Phi, stages.fixed)
        if not self._coupling.count:
            return
        S = self._response()
        _add_compliance(S, self._coupling.equation_count, compliance)
        self._scale = 1 / np.sqrt(np.maximum(np.diag(S), np.finfo(float).tiny))
        S *= self._scale
        S *= self._scale[:, None]
        self._factor = robust_cholesky(S)

    def solve(self, gradient: Array, c: Array, x0: Array, f: Array) -> Step:
        """Return the solution for gradient (T+1, n+k), c (T+1, n), x0 (n,), f (rows,)."""
        terminal, count = self._coupling.terminal, self._coupling.count
        gradient, ends = gradient.copy(), f[: len(self._coupling.terminal)]
        gradient[-1, terminal] -= self._weights[terminal] * ends
        y, eta, initial = self._regulator.solve(gradient, c, x0)
        if not count:
            return Step(y, eta, initial, np.zeros(0))
        missing = self._forward(y[:, self._coupling.channels, None], y[-1, : self._stages.states, None])[:, 0] - f
        nu = self._scale * la.cho_solve((self._factor, True), self._scale * missing, check_finite=False)
        self._add_adjoint(nu, gradient)
        y, eta, initial = self._regulator.solve(gradient, c, x0)
        nu[: len(terminal)] += self._weights[terminal] * (y[-1, terminal] - ends)
        return Step(y, eta, initial, nu)

    def _response(self) -> Array:
        """Return F P F', (rows, rows)."""
        count = self._coupling.count
        S = np.empty((count, count))
        for i, rows in enumerate(self._blocks):
            of_channels, of_end = self._columns[i] if i in self._columns else self._gradients(rows)
            Y, end = self._regulator.responses(self._coupling.channels, of_channels, of_end)
            S[:, rows] = -self._forward(Y, end)
        S += S.T.copy()
        S *= 0.5
        return S

    def _gradients(self, chosen: Indices) -> tuple[Array, Array]:
        """Return rows of F as gradients on channels (T+1, channels, k) and on x_T (n, k)."""
        stages, terminal = self._stages, self._coupling.terminal
        signals = np.zeros((len(stages.H), len(self._coupling.channels), len(chosen)))
        end = np.zeros((stages.states, len(chosen)))
        of_end = np.flatnonzero(chosen < len(terminal))
        end[terminal[chosen[of_end]], of_end] = 1.0
        for rows, at in self._families:
            inside = np.flatnonzero(np.isin(chosen, at, assume_unique=True))
            if len(inside):
                part = np.zeros((*signals.shape[:2], len(inside)))
                rows.add_columns(np.searchsorted(at, chosen[inside]), part)
                signals[:, :, inside] += part
        return signals, end

    def _forward(self, signals: Array, end: Array) -> Array:
        """Return F y of signals (T+1, channels, k) and x_T (n, k)."""
        values = np.empty((self._coupling.count, signals.shape[2]))
        values[: len(self._coupling.terminal)] = end[self._coupling.terminal]
        for rows, at in self._families:
            values[at] = rows.forward(signals)
        return values

    def _add_adjoint(self, nu: Array, gradient: Array) -> None:
        channels, terminal = self._coupling.channels, self._coupling.terminal
        signals = np.zeros((len(gradient), len(channels), 1))
        for rows, at in self._families:
            rows.add_adjoint(nu[at, None], signals)
        gradient[:, channels] += signals[:, :, 0]
        gradient[-1, terminal] += nu[: len(terminal)]


def robust_cholesky(S: Array) -> Array:
    """Return the lower factor of a symmetric matrix with a diagonal of ones, shifted as far as it must be."""
    shift = LEAST_SHIFT
    while True:
        shifted = S.copy(order="F")
        shifted.flat[:: len(S) + 1] += shift
        factor, failed = la.lapack.dpotrf(shifted, lower=1, overwrite_a=1, clean=0)
        if not failed:
            return factor
        shift *= 100


def _families(stages: Stages) -> Iterator[tuple[Rows, Indices]]:
    """Yield every family of rows beyond those of x_T with its rows of F."""
    first = len(stages.coupling.terminal)
    for part in (*stages.coupling.equations, *stages.coupling.inequalities):
        yield part.rows, first + np.arange(part.rows.count)
        first += part.rows.count
    for part in stages.coupling.balls:
        heads = 0 if part.heads is None else 1
        at = first + np.arange(len(part.radius) * (part.dim + heads)).reshape(len(part.radius), -1)
        if part.heads is not None:
            yield part.heads, at[:, 0]
        yield part.rows, at[:, heads:].ravel()
        first += at.size


def _add_compliance(S: Array, first: int, compliance: Compliance) -> None:
    """Add C behind the first rows, which are equations."""
    unequal = first + np.arange(len(compliance.inequalities))
    S[unequal, unequal] += compliance.inequalities
    first += len(unequal)
    for blocks in compliance.balls:
        balls, d = blocks.shape[:2]
        at = first + np.arange(balls * d).reshape(balls, d)
        S[at[:, :, None], at[:, None, :]] += blocks
        first += balls * d
