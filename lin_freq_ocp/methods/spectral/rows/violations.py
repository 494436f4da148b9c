"""Which rows a point violates, and which of them enter the working set (docs/spectral.md, 7)."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.methods.spectral.model.lti import Lti

STATE_PEAKS = 40  # violated local maxima of states that enter in one round: samples of a long arc are nearly dependent
NEARLY_ACTIVE = 0.05  # relative distance inside a control's bound up to which samples enter: arcs grow faster
SMALL_VIOLATION = 0.3  # largest relative violation with which nearly active samples are significant
LARGEST_SCALE = 1e3  # largest size, in units of what they bound, that violations are relative to
ABSENT = -1.0  # excess of a row that cannot be violated


class Violations:
    """Excess over the bounds, relative to them, of every bounded row of F at every time; negative inside.

    ``rows`` are the rows of F with a bound at some time, ``excess`` (bounded, T) is theirs at t < T, ``last`` (n,) that
    of x_T, ``worst`` the largest. ``fixed_keys`` are f T + t of the rows that equations fix: they cannot be violated,
    nor can saturated rows, which may exceed their bounds.
    """

    def __init__(self, lti: Lti):
        self.lti, n = lti, lti.state_dim
        self.rows = np.flatnonzero((np.isfinite(lti.lower) | np.isfinite(lti.upper)).any(1))
        self.lower, self.upper = _chosen(lti.lower, self.rows), _chosen(lti.upper, self.rows)
        self.state_rows: Mask = np.asarray(~lti.F[self.rows, n:].any(1))
        largest = np.zeros(len(lti.F))
        largest[self.rows] = np.maximum(_largest_finite(self.lower), _largest_finite(self.upper))
        self.free_end = np.isnan(lti.end)
        ends = np.where(self.free_end, [lti.last_lower, lti.last_upper], 0.0)
        largest[:n] = np.maximum(largest[:n], np.where(np.isfinite(ends), np.abs(ends), 0.0).max(0))
        self.scale = np.where(largest > 0, np.minimum(largest, LARGEST_SCALE), 1.0)
        self._row_scale = self.scale[self.rows, None]
        t, f = lti.fixed_points
        f = np.concatenate([f, np.flatnonzero(~np.isnan(lti.start))])
        t = np.concatenate([t, np.zeros(len(f) - len(t), dtype=np.intp)])
        index = np.full(len(lti.F), -1)
        index[self.rows] = np.arange(len(self.rows))
        bounded = index[f] >= 0
        self.fixed = index[f[bounded]], t[bounded]
        self.fixed_keys = f * lti.horizon + t
        self.excess, self.last, self.worst = np.zeros((0, 0)), np.zeros(n), 0.0
        self._index, none = index, np.zeros(0, dtype=np.intp)
        self.set_saturated(none, none)

    def set_saturated(self, t: Indices, f: Indices) -> None:
        """Take the rows f of F at times t, at T of components of x_T, as saturated, and no others."""
        inner = t < self.lti.horizon
        self._saturated = self._index[f[inner]], t[inner]
        self._saturated_last = f[~inner]

    def measure(self, y: Array, last: Array) -> float:
        """Measure a point, y (n+m, T) and last = x_T; return the worst excess."""
        return self.measure_values(self.values(y), last)

    def values(self, y: Array) -> Array:
        """Return F y of the bounded rows, shape (bounded, T)."""
        return y[self.rows] if len(self.lti.F) == len(y) else self.lti.F[self.rows] @ y

    def measure_values(self, values: Array, last: Array) -> float:
        """Measure what ``values`` returned, and last = x_T; return the worst excess."""
        lti, n = self.lti, self.lti.state_dim
        below = self.lower - values
        self.excess = np.subtract(values, self.upper, out=self.excess if self.excess.size else None)
        self.above = self.excess >= below
        np.maximum(self.excess, below, out=self.excess)
        self.excess /= self._row_scale
        self.excess[self.fixed] = ABSENT
        self.excess[self._saturated] = ABSENT
        over = np.maximum(last - lti.last_upper, lti.last_lower - last) / self.scale[:n]
        over[self._saturated_last] = ABSENT
        self.last, self.last_above = np.where(self.free_end, over, ABSENT), last > lti.last_upper
        self.worst = max(float(self.excess.max(initial=ABSENT)), float(self.last.max()))
        return self.worst

    def entering(self, tolerance: float) -> tuple[Indices, Indices, Array]:
        """Return (t, f, sign) of the rows to add: peaks of states, every (nearly) active sample of the others."""
        i, t = self._chosen_entries(tolerance)
        ends = np.flatnonzero(self.last > tolerance / 2)
        sign = np.concatenate([np.where(self.above[i, t], 1.0, -1.0), np.where(self.last_above[ends], 1.0, -1.0)])
        times = np.concatenate([t, np.full(len(ends), self.lti.horizon)])
        return times, np.concatenate([self.rows[i], ends]), sign

    def chosen(self, tolerance: float) -> tuple[Indices, Array]:
        """Return the same rows as flat indices over (bounded, T) and the components of x_T, and signs."""
        i, t = self._chosen_entries(tolerance)
        index, above = i * self.lti.horizon + t, self.above[i, t]
        if self.free_end.any():
            ends = np.flatnonzero(self.last > tolerance / 2)
            index = np.concatenate([index, self.excess.size + ends])
            above = np.concatenate([above, self.last_above[ends]])
        return index, np.where(above, 1.0, -1.0)

    def flat_bounds(self) -> tuple[Array, Array]:
        """Return lower and upper bounds over the same."""
        lti = self.lti
        return np.append(self.lower, lti.last_lower), np.append(self.upper, lti.last_upper)

    def flat_prices(self) -> tuple[Array, Array] | None:
        """Return the prices of lower and upper bounds over the same; None if all are hard."""
        prices = self.lti.prices
        if prices is None:
            return None
        lower, upper = prices.lower[self.rows], prices.upper[self.rows]
        return np.append(lower, prices.last_lower), np.append(upper, prices.last_upper)

    def _chosen_entries(self, tolerance: float) -> tuple[Indices, Indices]:
        """Return (i, t) of the entries of ``excess`` that enter: of states with saturated samples, not only peaks."""
        threshold = np.where(self.state_rows, tolerance / 2, nearly_active(self.worst, tolerance))
        i, t = np.nonzero(self.excess > threshold[:, None])
        states = self.state_rows[i]
        if len(self._saturated[0]):
            states &= ~np.isin(i, self._saturated[0])
        if not states.any():
            return i, t
        here, last = self.excess[i, t], self.lti.horizon - 1
        beside = np.maximum(self.excess[i, np.maximum(t - 1, 0)], self.excess[i, np.minimum(t + 1, last)])
        peaks = states & (here >= beside)
        if np.count_nonzero(peaks) > STATE_PEAKS:
            peaks &= here >= np.partition(here[peaks], -STATE_PEAKS)[-STATE_PEAKS]
        kept = peaks | ~states
        return i[kept], t[kept]


def _chosen(bounds: Array, rows: Indices) -> Array:
    """Return some rows of bounds (rows, T), without memory where they do not depend on time."""
    if bounds.strides[1] == 0:
        return np.broadcast_to(bounds[rows, :1], (len(rows), bounds.shape[1]))
    return bounds[rows]


def nearly_active(worst: float, tolerance: float) -> float:
    """Return the excess from which samples of controls and stage rows enter."""
    return -min(2 * worst, NEARLY_ACTIVE) if worst < SMALL_VIOLATION else tolerance / 2


def _largest_finite(bounds: Array) -> Array:
    """Return the largest finite |bound| of every row, 0 where there is none; bounds (rows, T)."""
    if bounds.size and bounds.strides[1] == 0:
        bounds = bounds[:, :1]
    return np.where(np.isfinite(bounds), np.abs(bounds), 0.0).max(1, initial=0.0)
