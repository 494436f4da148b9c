"""The pointwise rows that hold with equality for now, and how they act on each other (docs/spectral.md, 5)."""

from __future__ import annotations

from copy import copy
from typing import NamedTuple

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask, require_memory
from lin_freq_ocp.methods.spectral.kkt.bordered_system import BorderedSystem
from lin_freq_ocp.methods.spectral.model.lti import Bounds, Lti

LOCAL_ROWS = 300  # working rows beyond which the small QP costs more than the signals of all samples
COPIES = 6  # dense matrices of the size of the working set that a small QP has at the same time


class Rows(NamedTuple):
    """Pointwise rows: times t, rows f of F, signs +1 (upper bound) or -1 (lower), and multipliers if known."""

    t: Indices
    f: Indices
    sign: Array
    weights: Array | None = None


def bounded(rows: Rows, lti: Lti) -> Rows:
    """Return the rows that have a bound and are no equation."""
    inner = rows.t < lti.horizon
    lower, upper = np.full(len(rows.t), -np.inf), np.full(len(rows.t), np.inf)
    t, f = rows.t[inner], rows.f[inner]
    lower[inner], upper[inner] = lti.lower[f, t], lti.upper[f, t]
    last = np.flatnonzero(~inner)
    last = last[np.isnan(lti.end[rows.f[last]])]
    lower[last], upper[last] = lti.last_lower[rows.f[last]], lti.last_upper[rows.f[last]]
    kept = np.isfinite(np.where(rows.sign > 0, upper, lower)) & (lower < upper)
    kept &= (rows.t > 0) | (rows.f >= lti.state_dim) | np.isnan(lti.start[rows.f % lti.state_dim])
    weights = None if rows.weights is None else rows.weights[kept]
    return Rows(rows.t[kept], rows.f[kept], rows.sign[kept], weights)


class WorkingSet:
    """Rows sign F_f y_t <= limit with multipliers ``weights`` >= 0; at t = T, rows on the free components of x_T.

    Multipliers of soft rows are at most their ``prices``; a saturated row, whose multiplier is its price, is violated.

    ``coupling`` is C = [dG/dtheta'; -S_EW], (size + equations, count).
    """

    def __init__(self, border: BorderedSystem):
        self._border = border
        self.t: Indices = np.zeros(0, dtype=np.intp)
        self.f: Indices = np.zeros(0, dtype=np.intp)
        self.sign: Array = np.zeros(0)
        self.weights: Array = np.zeros(0)
        self.coupling: Array = np.zeros((len(border.matrix), 0))
        self._known_gram: Array | None = None
        self._present = np.zeros((2, len(border.lti.F), border.lti.horizon + 1), dtype=bool)

    def __len__(self) -> int:
        return len(self.t)

    @property
    def gram(self) -> Array:
        """S_W without the border's part, (count, count)."""
        if self._known_gram is None:
            require_memory(
                f"method 'spectral' with {len(self)} working rows (samples at a bound)",
                8.0 * COPIES * len(self) ** 2,
                "Choose a coarser grid or a shorter horizon.",
            )
            inner = self.inner
            t, f, sign = self.t[inner], self.f[inner], self.sign[inner]
            gram = self._border.kernels.gram(t, f, t, f)
            gram *= sign[:, None]
            gram *= sign
            if not inner.all():
                gram, of_inner = np.zeros((len(self), len(self))), gram
                gram[np.ix_(inner, inner)] = of_inner
            self._known_gram = gram
        return self._known_gram

    def eliminated(self, inverse: Array) -> tuple[Array, Array]:
        """Return K_b^{-1} C and S for an inverse of K_b; S is exactly symmetric: else the QP stalls at rounding."""
        Z = inverse @ self.coupling
        half = self.coupling.T @ (Z / 2)
        S = half + half.T
        S += self.gram
        return Z, S

    @property
    def inner(self) -> Mask:
        """Which rows act at t < T."""
        return self.t < self._border.lti.horizon

    def rows(self) -> tuple[Indices, Indices, Array]:
        """Return (t, f, sign)."""
        return self.t, self.f, self.sign

    def weighted(self, weights: Array) -> WorkingSet:
        """Return the same rows with other multipliers."""
        other = copy(self)
        other.weights = weights
        return other

    def keep(self, kept: Mask) -> None:
        """Drop all rows but these."""
        if not kept.all():
            self._mark(self.t[~kept], self.f[~kept], self.sign[~kept], False)
            self.t, self.f = self.t[kept], self.f[kept]
            self.sign, self.weights = self.sign[kept], self.weights[kept]
            self.coupling = self.coupling[:, kept]
            self._known_gram = None if self._known_gram is None else self._known_gram[np.ix_(kept, kept)]

    def add(self, t: Indices, f: Indices, sign: Array) -> int:
        """Add the rows that are new, with weight 0; return how many."""
        new = ~self._present[(sign > 0).astype(np.intp), f, t]
        t, f, sign = t[new], f[new], sign[new]
        if not len(t):
            return 0
        self._mark(t, f, sign, True)
        self.coupling, self._known_gram = np.hstack([self.coupling, self._coupling(t, f, sign)]), None
        self.t, self.f = np.concatenate([self.t, t]), np.concatenate([self.f, f])
        self.sign, self.weights = np.concatenate([self.sign, sign]), np.concatenate([self.weights, np.zeros(len(t))])
        return len(t)

    def replace(self, rows: Rows, coupling: Array) -> None:
        """Take other rows, with their coupling."""
        self._mark(self.t, self.f, self.sign, False)
        self.t, self.f, self.sign = rows.t, rows.f, rows.sign
        self.weights = np.zeros(len(rows.t)) if rows.weights is None else rows.weights
        self.coupling, self._known_gram = coupling, None
        self._mark(self.t, self.f, self.sign, True)

    def limits(self, lti: Lti) -> Array:
        """Return the right-hand sides of the rows, shape (count,)."""
        return self.sign * self._of_bounds(Bounds(lti.lower, lti.upper, lti.last_lower, lti.last_upper))

    def prices(self, lti: Lti) -> Array | None:
        """Return the largest multipliers of the rows, (count,), infinite for hard rows; None if all are hard."""
        return None if lti.prices is None else self._of_bounds(lti.prices)

    def free_response(self) -> Array:
        """Return how far a unit force moves each row without equations, (count,); x_T moves by itself."""
        inner = self.inner
        free = np.full(len(self), 1 / self._border.lti.curvature_unit)
        free[inner] = self._border.kernels.free_response(self.f[inner])
        return free

    def saturated(self, lti: Lti) -> Mask:
        """Return which rows have their price as multiplier, (count,)."""
        prices = self.prices(lti)
        return np.zeros(len(self), dtype=bool) if prices is None else self.weights >= prices

    def _of_bounds(self, bounds: Bounds) -> Array:
        """Return the entries of the rows in arrays for all bounds, (count,)."""
        inner, upper = self.inner, self.sign > 0
        found, t, f = np.empty(len(self)), self.t[inner], self.f[inner]
        found[inner] = np.where(upper[inner], bounds.upper[f, t], bounds.lower[f, t])
        last = self.f[~inner]
        found[~inner] = np.where(upper[~inner], bounds.last_upper[last], bounds.last_lower[last])
        return found

    def values(self, y: Array, last: Array) -> Array:
        """Return sign F_f y_t of the rows, shape (count,), for y (n+m, T) and last = x_T."""
        inner = self.inner
        result = np.empty(len(self))
        result[inner] = np.einsum("ri,ir->r", self._border.lti.F[self.f[inner]], y[:, self.t[inner]])
        result[~inner] = last[self.f[~inner]]
        return self.sign * result

    def _mark(self, t: Indices, f: Indices, sign: Array, present: bool) -> None:
        self._present[(sign > 0).astype(np.intp), f, t] = present

    def _coupling(self, t: Indices, f: Indices, sign: Array) -> Array:
        border, inner = self._border, t < self._border.lti.horizon
        result = np.zeros((len(self.coupling), len(t)))
        result[: border.size, inner] = border.values(t[inner], f[inner]).T
        result[border.size :, inner] = -border.responses(t[inner], f[inner])
        free = np.flatnonzero(~inner)
        result[border.at_end[np.searchsorted(border.free_end, f[free])], free] = 1.0
        return result * sign
