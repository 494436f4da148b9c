"""Rounds on a model of all bounded values, on short horizons: a round then costs little but its FFTs.

With the border eliminated, the values v of all bounded rows at all times are v = v_0 - S mu (docs/spectral.md, 5), with
S for all of them, and mu their multipliers, positive at upper and negative at lower bounds.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import fft

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.methods.spectral.kkt.bordered_system import BorderedSystem
from lin_freq_ocp.methods.spectral.kkt.dual_qp import bounded_qp
from lin_freq_ocp.methods.spectral.rows.violations import Violations
from lin_freq_ocp.methods.spectral.rows.working_set import LOCAL_ROWS, Rows

LARGEST = 10_000  # bounded values up to which the border's effect on all of them is computed at once
MODEL_ROUNDS = 12  # after which the true signals are evaluated


class WholeHorizon:
    """The bounded ``rows`` of F at all t < T in turn, then the components of x_T (t = T): one flat index.

    ``coupling`` (size + equations, values) is as in WorkingSet, ``through`` is K_b^{-1} times that.
    """

    def __init__(self, border: BorderedSystem, rows: Indices):
        lti, T, n = border.lti, border.lti.horizon, border.lti.state_dim
        self._border, self.rows, self._inner = border, rows, len(rows) * T
        self.t = np.concatenate([np.arange(self._inner) % T, np.full(n, T)])
        self.f = np.concatenate([np.repeat(rows, T), np.arange(n)])
        self._row_index = np.zeros(len(lti.F), dtype=np.intp)
        self._row_index[rows] = np.arange(len(rows))
        self.coupling = np.zeros((len(border.matrix), len(self.t)))
        self.coupling[:, : self._inner] = border.everywhere(rows).reshape(-1, self._inner)
        self.coupling[border.at_end, self._inner + border.free_end] = 1.0
        self.through = border.inverse @ self.coupling
        self._spaces = border.kernels.of_rows(rows)
        self.tabulated = False

    def flat_indices(self, t: Indices, f: Indices) -> Indices:
        """Return the flat indices of rows f at times t; at t = T, of component f of x_T."""
        T = self._border.lti.horizon
        return np.where(t < T, self._row_index[f] * T + t, self._inner + f)

    def duals(self, rows: Rows) -> ActiveSetDuals:
        """Return the same rows by flat indices."""
        indices, once = np.unique(self.flat_indices(rows.t, rows.f), return_index=True)
        weights = np.zeros(len(indices)) if rows.weights is None else rows.weights[once]
        return ActiveSetDuals(indices, rows.sign[once], weights)

    @cached_property
    def table(self) -> Array:
        """S of all values, (values, values): for many solves, if they are few enough."""
        T, kernels = self._border.lti.horizon, self._border.kernels.table
        S = self.coupling.T @ self.through
        lags = np.arange(T)[:, None] - np.arange(T)
        for i, f in enumerate(self.rows):
            for j, g in enumerate(self.rows):
                S[i * T : (i + 1) * T, j * T : (j + 1) * T] += kernels[f, g][lags]
        return (S + S.T) / 2

    def gram(self, index: Indices) -> Array:
        """Return S of some values."""
        if self.tabulated:
            return self.table.ravel().take(index[:, None] * len(self.t) + index)
        t, f = self.t[index], self.f[index]
        S = self.coupling[:, index].T @ self.through[:, index]
        S = (S + S.T) / 2
        inner = index < self._inner
        if inner.all():
            return S + self._border.kernels.gram(t, f, t, f)
        S[np.ix_(inner, inner)] += self._border.kernels.gram(t[inner], f[inner], t[inner], f[inner])
        return S

    def free_response(self, index: Indices) -> Array:
        """Return how far a unit force moves each of some values without equations; x_T moves by itself."""
        free = np.full(len(index), 1 / self._border.lti.curvature_unit)
        inner = index < self._inner
        free[inner] = self._border.kernels.free_response(self.f[index[inner]])
        return free

    def response(self, index: Indices, mu: Array) -> Array:
        """Return S mu of all values, for multipliers of some."""
        if self.tabulated:
            acting = mu.nonzero()[0]
            return mu[acting] @ self.table[index[acting]]
        pulses = np.zeros(len(self.t))
        pulses[index] = mu
        pulses = pulses[: self._inner].reshape(len(self.rows), -1)
        acting = pulses.any(1)
        answer = (self._spaces[acting].conj() * fft.rfft(pulses[acting])[:, None]).sum(0)
        values = (self.through[:, index] @ mu) @ self.coupling
        values[: self._inner] += fft.irfft((self._spaces * answer).sum(1), self._border.lti.horizon).ravel()
        return values


class ActiveSetDuals(NamedTuple):
    """Values with multipliers: flat indices, signs as in Rows, weights >= 0 (undefined if not ``accurate``)."""

    indices: Indices
    sign: Array
    weights: Array
    rounds: int = 0
    accurate: bool = True


def exchanged(
    whole: WholeHorizon,
    violations: Violations,
    start: ActiveSetDuals,
    base: Array,
    tolerance: float,
    unconstrained: Array | None,
    stop: Callable[[], str | None],
) -> ActiveSetDuals:
    """Exchange until no value violates its bound by more than the tolerance, for MODEL_ROUNDS at most.

    ``base`` is v_0, (values,); ``unconstrained`` is per row of F, see ``bounded_qp``.
    """
    index, sign, weights = start.indices, start.sign, start.weights
    found, n, inside = start, violations.lti.state_dim, np.zeros(len(base), dtype=bool)
    none = np.zeros(0, dtype=np.intp)
    (lower, upper), prices = violations.flat_bounds(), violations.flat_prices()
    for count in range(1, MODEL_ROUNDS + 1):
        values = base
        violations.set_saturated(none, none)
        if len(index):
            d = sign * (np.where(sign > 0, upper[index], lower[index]) - base[index])
            free = None if unconstrained is None else unconstrained[whole.f[index]] * (index < len(base) - n)
            most = None if prices is None else np.where(sign > 0, prices[1][index], prices[0][index])
            response = None if prices is None else whole.free_response(index)
            gram = whole.gram(index) * sign * sign[:, None]
            weights, accurate = bounded_qp(gram, d, weights, free, stop, most, response)
            found = ActiveSetDuals(index, sign, weights, count, accurate)
            if not accurate:
                break
            values = base - whole.response(index, sign * weights)
            if most is not None:
                saturated = index[weights >= most]
                violations.set_saturated(whole.t[saturated], whole.f[saturated])
        if violations.measure_values(values[:-n].reshape(len(whole.rows), -1), values[-n:]) < tolerance or stop():
            break
        kept = weights > 0
        index, sign, weights = index[kept], sign[kept], weights[kept]
        inside[:] = False
        inside[index] = True
        entering, side = violations.chosen(tolerance)
        new = ~inside[entering]
        added = np.count_nonzero(new)
        if not added or len(index) + added > LOCAL_ROWS:
            break
        index, sign = np.concatenate([index, entering[new]]), np.concatenate([sign, side[new]])
        weights = np.concatenate([weights, np.zeros(added)])
    return found
