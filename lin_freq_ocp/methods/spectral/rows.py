"""Pointwise rows: their violations, the working set, and their responses to each other's multipliers.

docs/spectral.md, 5 and 7. Row f at time t is F_f y_t. A round measures all rows by FFTs (Violations);
the few rows that are presumed active form the working set (WorkingSet).
"""

from __future__ import annotations

from copy import copy
from typing import NamedTuple

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.resources import require_memory
from lin_freq_ocp.methods.spectral.kkt import BorderedSystem
from lin_freq_ocp.methods.spectral.model import Lti

STATE_PEAKS = 40  # violated local maxima of states that enter in one round: samples of a long arc are nearly dependent
NEARLY_ACTIVE = 0.05  # relative distance inside a control's bound up to which samples enter: arcs grow faster
SMALL_VIOLATION = 0.3  # largest relative violation with which nearly active samples are significant
LARGEST_SCALE = 1e3  # largest bound that violations are relative to; larger bounds count as this one
ABSENT = -1.0  # violation of a row that cannot be violated
COPIES = 6  # dense matrices of the size of the working set that a small QP has at the same time


class Rows(NamedTuple):
    """Pointwise rows: times t, rows f of F, signs +1 (upper bound) or -1 (lower), and multipliers if known."""

    t: Indices
    f: Indices
    sign: Array
    weights: Array | None = None

    def take(self, chosen: Mask | Indices) -> Rows:
        """Return some of the rows."""
        weights = None if self.weights is None else self.weights[chosen]
        return Rows(self.t[chosen], self.f[chosen], self.sign[chosen], weights)

    def active(self) -> Rows:
        """Return the rows with a multiplier above zero."""
        return self if self.weights is None else self.take(self.weights > 0)


def bounded_rows(rows: Rows, lti: Lti) -> Rows:
    """Return the rows that have a bound and are not fixed by an equation."""
    return rows.take(np.isfinite(lti.bounds.at(rows.t, rows.f, rows.sign)) & ~lti.is_fixed(rows.t, rows.f))


class Violations:
    """Violation of the bounds, relative to them, of every bounded row of F at every time; negative inside.

    ``rows`` are the rows of F with a limit at some time. ``violation`` (bounded, T) is their violation at t < T,
    ``last`` (n,) that of x_T, ``worst`` the largest. Rows that equations fix, and saturated rows, whose price is paid,
    do not count as violated.
    """

    def __init__(self, lti: Lti):
        self.lti, n, bounds = lti, lti.state_dim, lti.bounds
        limited = (np.isfinite(bounds.lower) | np.isfinite(bounds.upper)) & (bounds.lower < bounds.upper)
        self.rows = np.flatnonzero(limited.any(1))
        self.lower, self.upper = _select_bounds(bounds.lower, self.rows), _select_bounds(bounds.upper, self.rows)
        self.state_rows: Mask = np.asarray(~lti.F[self.rows, n:].any(1))
        self.free_end = np.isnan(lti.end)
        # violations are relative to the largest bound of the row, that of x_T included
        largest = np.zeros(len(lti.F))
        largest[self.rows] = np.maximum(_largest_finite(self.lower), _largest_finite(self.upper))
        ends = np.where(self.free_end, [bounds.last_lower, bounds.last_upper], 0.0)
        largest[:n] = np.maximum(largest[:n], np.where(np.isfinite(ends), np.abs(ends), 0.0).max(0))
        self.scale = np.where(largest > 0, np.minimum(largest, LARGEST_SCALE), 1.0)
        self._index = np.full(len(lti.F), -1)  # of each row of F among the bounded ones
        self._index[self.rows] = np.arange(len(self.rows))
        (t, f), start = lti.fixed_points, np.flatnonzero(~np.isnan(lti.start))
        t, index = np.append(t, 0 * start), self._index[np.append(f, start)]
        self.fixed = index[index >= 0], t[index >= 0]
        self.violation, self.last, self.worst = np.zeros((0, 0)), np.zeros(n), 0.0

    def values(self, y: Array) -> Array:
        """Return F y of the bounded rows, shape (bounded, T)."""
        return y[self.rows] if len(self.lti.F) == len(y) else self.lti.F[self.rows] @ y

    def measure_values(self, values: Array, last: Array, t: Indices, f: Indices) -> float:
        """Measure values (bounded, T) of the bounded rows, and last = x_T; return the worst violation.

        The rows f of F at times t are saturated; at t = T, f is a component of x_T.
        """
        bounds, n, inner = self.lti.bounds, self.lti.state_dim, t < self.lti.horizon
        self._saturated = self._index[f[inner]], t[inner]
        below = self.lower - values
        self.violation = np.subtract(values, self.upper, out=self.violation if self.violation.size else None)
        self.above = self.violation >= below
        np.maximum(self.violation, below, out=self.violation)
        self.violation /= self.scale[self.rows, None]
        self.violation[self.fixed] = ABSENT
        self.violation[self._saturated] = ABSENT
        self.worst = float(self.violation.max(initial=ABSENT))
        if self.free_end.any():
            at_end = np.maximum(last - bounds.last_upper, bounds.last_lower - last) / self.scale[:n]
            at_end[f[~inner]] = ABSENT
            self.last, self.last_above = np.where(self.free_end, at_end, ABSENT), last > bounds.last_upper
            self.worst = max(self.worst, float(self.last.max()))
        return self.worst

    def entering(self, tolerance: float) -> tuple[Indices, Indices, Array]:
        """Return (t, f, sign) of the rows to add: peaks of states, every (nearly) active sample of the others."""
        index, sign = self.entering_values(tolerance)
        T, inner, f = self.lti.horizon, index < self.violation.size, index - self.violation.size
        f[inner] = self.rows[index[inner] // T]
        return np.where(inner, index % T, T), f, sign

    def entering_values(self, tolerance: float) -> tuple[Indices, Array]:
        """Return the same rows as flat indices over (bounded, T) and the components of x_T, and signs."""
        threshold = np.where(self.state_rows, tolerance / 2, entering_violation(self.worst, tolerance))
        i, t = np.nonzero(self.violation > threshold[:, None])
        of_states = self.state_rows[i]
        if len(self._saturated[0]):  # of a state with saturated samples, all samples enter
            of_states &= ~np.isin(i, self._saturated[0])
        if of_states.any():
            violation, last = self.violation[i, t], self.lti.horizon - 1
            before, after = self.violation[i, np.maximum(t - 1, 0)], self.violation[i, np.minimum(t + 1, last)]
            peaks = of_states & (violation >= np.maximum(before, after))
            if np.count_nonzero(peaks) > STATE_PEAKS:
                peaks &= violation >= np.partition(violation[peaks], -STATE_PEAKS)[-STATE_PEAKS]
            i, t = i[peaks | ~of_states], t[peaks | ~of_states]
        index, above = i * self.lti.horizon + t, self.above[i, t]
        if self.free_end.any():
            ends = np.flatnonzero(self.last > tolerance / 2)
            index = np.concatenate([index, self.violation.size + ends])
            above = np.concatenate([above, self.last_above[ends]])
        return index, np.where(above, 1.0, -1.0)


def entering_violation(worst: float, tolerance: float) -> float:
    """Return the violation from which samples of controls and stage rows enter."""
    return -min(2 * worst, NEARLY_ACTIVE) if worst < SMALL_VIOLATION else tolerance / 2


def _select_bounds(bounds: Array, rows: Indices) -> Array:
    """Return some rows of bounds (rows, T); bounds that do not depend on time take no memory."""
    if bounds.strides[1] == 0:
        return np.broadcast_to(bounds[rows, :1], (len(rows), bounds.shape[1]))
    return bounds[rows]


def _largest_finite(bounds: Array) -> Array:
    """Return the largest finite |bound| of every row, 0 where there is none; bounds (rows, T)."""
    return np.where(np.isfinite(bounds), np.abs(bounds), 0.0).max(1, initial=0.0)


class WorkingSet:
    """Rows G y <= limit, each sign F_f y_t, with multipliers ``weights`` l >= 0; at t = T, on free components of x_T.

    ``limits`` and ``prices`` (count,) are their right-hand sides and largest multipliers, infinite for hard rows.
    ``coupling`` is C = [(G Y)'; -S_EW], (size + equations, count): the effect of theta on the rows, and the decrease of
    the equations by unit forces on the rows, S_EW = E_y N N^* G'. ``present`` (2, rows of F, T+1) is the mask of the
    rows, lower bounds first.
    """

    def __init__(self, kkt: BorderedSystem, lti: Lti):
        self.kkt, self.lti, none = kkt, lti, np.zeros(0, dtype=np.intp)
        self.t, self.f, self.sign = none, none, np.zeros(0)
        self.present = np.zeros((2, len(lti.F), lti.horizon + 1), dtype=bool)
        self.replace(Rows(none, none, np.zeros(0)), np.zeros((len(kkt.matrix), 0)))

    def __len__(self) -> int:
        return len(self.t)

    @property
    def inner(self) -> Mask:
        """Which rows act at t < T."""
        return self.t < self.lti.horizon

    def rows(self) -> Rows:
        """Return the rows with their weights."""
        return Rows(self.t, self.f, self.sign, self.weights)

    def weighted(self, weights: Array) -> WorkingSet:
        """Return the same rows with other multipliers."""
        working = copy(self)
        working.weights = weights
        return working

    def add(self, t: Indices, f: Indices, sign: Array) -> int:
        """Add the rows that are new, with weight 0; return how many."""
        new = ~self.present[(sign > 0).astype(np.intp), f, t]
        t, f, sign = t[new], f[new], sign[new]
        if not len(t):
            return 0
        indices, signs = (np.append(self.t, t), np.append(self.f, f)), np.append(self.sign, sign)
        rows = Rows(*indices, signs, np.append(self.weights, np.zeros(len(t))))
        self.replace(rows, np.hstack([self.coupling, self.kkt.coupling(t, f) * sign]))
        return len(t)

    def keep(self, chosen: Mask) -> None:
        """Drop all rows that are not chosen."""
        if not chosen.all():
            gram = None if self._cached_gram is None else self._cached_gram[np.ix_(chosen, chosen)]
            self.replace(self.rows().take(chosen), self.coupling[:, chosen])
            self._cached_gram = gram

    def replace(self, rows: Rows, coupling: Array) -> None:
        """Replace all rows and their coupling."""
        self.present[(self.sign > 0).astype(np.intp), self.f, self.t] = False
        self.t, self.f, self.sign = rows.t, rows.f, rows.sign
        self.weights = np.zeros(len(rows.t)) if rows.weights is None else rows.weights
        self.present[(self.sign > 0).astype(np.intp), self.f, self.t] = True
        self.coupling = coupling
        self.limits = self.sign * self.lti.bounds.at(self.t, self.f, self.sign)
        self.prices = self.lti.price_of(self.t, self.f, self.sign)
        self._cached_gram: Array | None = None

    @property
    def gram(self) -> Array:
        """S_W = G N N^* G', the decrease of the rows by unit forces on each other, at fixed theta and zeta."""
        if self._cached_gram is None:
            require_memory(
                f"method 'spectral' with {len(self)} working rows (samples at a bound)",
                8.0 * COPIES * len(self) ** 2,
                "Choose a coarser grid or a shorter horizon.",
            )
            self._cached_gram = self.kkt.kernels.gram_of_rows(self.t, self.f)
            self._cached_gram *= self.sign[:, None]
            self._cached_gram *= self.sign
        return self._cached_gram

    def slacks(self, y: Array, last: Array) -> Array:
        """Return limit - sign F_f y_t of the rows, shape (count,), for y (n+m, T) and last = x_T."""
        at_end = np.flatnonzero(~self.inner)
        values = self.lti.row_values(y, np.minimum(self.t, self.lti.horizon - 1), self.f)
        values[at_end] = last[self.f[at_end]]
        return self.limits - self.sign * values
