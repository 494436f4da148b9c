"""The algebra of nonnegative orthants and second-order cones side by side (Vandenberghe, 2010, section 4).

Arrays are (rows, members), a column for each point. With ``ends`` = (k, k + d_1, ...), the first k rows are >= 0, and
d_1, d_2, ... rows after them are cones v_0 >= |(v_1, ...)|. The identity e has ones in the k rows and the heads v_0.
The scaling of Nesterov and Todd, (w, eta), has W z = W^{-1} s: in an orthant w = sqrt(s/z), in a cone
W^2 = eta^2 (2 w w' - J) with w'Jw = 1, J = diag(1, -1, ..), and eta (cones, members).

``Cone`` applies the functions to rows of which some are absent.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate, pairwise

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask

FREE = 1e30  # w of a row that is left out: 1/w^2 is negligible next to the others
LEAST_SQUARE = 1e-300  # of a cone's s'Js: rounding may make it zero at the boundary

Ends = tuple[int, ...]


def inner(a: Array, b: Array) -> Array:
    """Return a'b of each member, (members,)."""
    return (a * b).sum(axis=0)


def tail_norms(v: Array, first: int, last: int) -> Array:
    """Return |(v_1, ...)| of the cone in rows first .. last - 1, (members,)."""
    return np.sqrt(inner(v[first + 1 : last], v[first + 1 : last]))


def determinants(v: Array, first: int, last: int) -> Array:
    """Return v'Jv of the cone in rows first .. last - 1, (members,), without the cancellation of squares."""
    size = tail_norms(v, first, last)
    return np.maximum((v[first] - size) * (v[first] + size), LEAST_SQUARE)


def spectral_values(ends: Ends, v: Array) -> Array:
    """Return the entries of the orthant, then v_0 - |(v_1, ...)| and v_0 + |(v_1, ...)| of each cone, as rows."""
    values = np.empty((ends[0] + 2 * (len(ends) - 1), v.shape[1]))
    values[: ends[0]] = v[: ends[0]]
    for j in range(len(ends) - 1):
        size, row = tail_norms(v, ends[j], ends[j + 1]), ends[0] + 2 * j
        values[row], values[row + 1] = v[ends[j]] - size, v[ends[j]] + size
    return values


def product(ends: Ends, a: Array, b: Array) -> Array:
    """Return the Jordan product, a o b."""
    out = a * b
    for j in range(len(ends) - 1):
        first, last = ends[j], ends[j + 1]
        out[first] = inner(a[first:last], b[first:last])
        out[first + 1 : last] = a[first] * b[first + 1 : last] + b[first] * a[first + 1 : last]
    return out


def quotient(ends: Ends, a: Array, d: Array) -> Array:
    """Return the v with a o v = d."""
    out = np.empty_like(d)
    out[: ends[0]] = d[: ends[0]] / a[: ends[0]]
    for j in range(len(ends) - 1):
        first, last = ends[j], ends[j + 1]
        head, tail = a[first], a[first + 1 : last]
        out[first] = (head * d[first] - inner(tail, d[first + 1 : last])) / determinants(a, first, last)
        out[first + 1 : last] = (d[first + 1 : last] - tail * out[first]) / head
    return out


def compute_scaling(ends: Ends, s: Array, z: Array) -> tuple[Array, Array]:
    """Return (w, eta) of interior points; that of W^-1 if z comes first."""
    w, eta = np.empty_like(s), np.empty((len(ends) - 1, s.shape[1]))
    w[: ends[0]] = np.sqrt(s[: ends[0]] / z[: ends[0]])
    for j in range(len(ends) - 1):
        first, last = ends[j], ends[j + 1]
        of_s, of_z = np.sqrt(determinants(s, first, last)), np.sqrt(determinants(z, first, last))
        gamma = np.sqrt(np.maximum((1 + inner(s[first:last], z[first:last]) / (of_s * of_z)) / 2, 1.0))
        of_s_twice, of_z_twice = of_s * (2 * gamma), of_z * (2 * gamma)
        w[first + 1 : last] = s[first + 1 : last] / of_s_twice - z[first + 1 : last] / of_z_twice
        w[first] = np.sqrt(1 + inner(w[first + 1 : last], w[first + 1 : last]))
        eta[j] = np.sqrt(of_s / of_z)
    return w, eta


def apply_scaling(ends: Ends, w: Array, eta: Array, v: Array) -> Array:
    """Return W v."""
    out = w * v
    for j in range(len(ends) - 1):
        first, last, factor = ends[j], ends[j + 1], eta[j]
        along = inner(w[first + 1 : last], v[first + 1 : last])
        out[first] = factor * (out[first] + along)
        move = v[first] + along / (1 + w[first])
        out[first + 1 : last] = factor * (v[first + 1 : last] + w[first + 1 : last] * move)
    return out


def apply_scaling_twice(ends: Ends, w: Array, eta: Array, v: Array) -> Array:
    """Return W^2 v."""
    out = w * w * v
    for j in range(len(ends) - 1):
        first, last = ends[j], ends[j + 1]
        twice, square = 2 * inner(w[first:last], v[first:last]), eta[j] * eta[j]
        out[first] = square * (twice * w[first] - v[first])
        out[first + 1 : last] = square * (twice * w[first + 1 : last] + v[first + 1 : last])
    return out


def steepest(ends: Ends, lam: Array, direction: Array) -> float:
    """Return 1/a for the longest step a from lam along a direction that stays in the cone; zero if any step does."""
    slope = float((-direction[: ends[0]] / lam[: ends[0]]).max(initial=0.0))
    for j in range(len(ends) - 1):
        first, last = ends[j], ends[j + 1]
        size, head, tail = np.sqrt(determinants(lam, first, last)), direction[first], direction[first + 1 : last]
        along = (lam[first] * head - inner(lam[first + 1 : last], tail)) / size
        move = (along + head) / (lam[first] / size + 1.0) / size
        across = tail - move * lam[first + 1 : last]
        slope = max(slope, float(((np.sqrt(inner(across, across)) - along) / size).max(initial=0.0)))
    return slope


class Cone:
    """The cone of points (N, p) whose members lie along the rows; entries may not be ``present``, and are zero then.

    At first W = 1.
    """

    def __init__(self, present: Mask, sizes: Sequence[int]):
        self.present = present
        self._ends = tuple(accumulate(sizes, initial=present.shape[1] - sum(sizes)))
        self.orthant, self.blocks = slice(0, self._ends[0]), tuple(slice(*pair) for pair in pairwise(self._ends))
        self._heads = [*range(self._ends[0]), *self._ends[:-1]]
        unit = np.zeros(present.shape)
        unit[:, self._heads] = 1.0
        self.identity = unit * present
        self._absent = unit - self.identity  # interior points where nothing is present
        self._present_heads = present.T[self._heads]
        self._present_values = present.T[[*range(self._ends[0]), *np.repeat(self._ends[:-1], 2)]]
        self.degree = int(self.identity.sum())
        self.reset()

    def reset(self) -> None:
        """Set W = 1."""
        self.scale(self.identity, self.identity)

    def scale(self, s: Array, z: Array) -> None:
        """Set the scaling of interior points s and z."""
        self._set_scaling(*compute_scaling(self._ends, (s + self._absent).T, (z + self._absent).T))
        self.lam = self.scaled(z, 1)
        self._lam = (self.lam + self._absent).T

    def leave_out(self) -> None:
        """Set the scaling at which the rows of an orthant do not count."""
        self._set_scaling(np.full(self.present.shape, FREE).T, np.empty((0, len(self.present))))

    def _set_scaling(self, w: Array, eta: Array) -> None:
        """Set W and W^-1: both are zero where nothing is present."""
        inverse, k = -w, self._ends[0]
        inverse[self._heads], inverse[:k] = w[self._heads], 1 / w[:k]
        self._scalings = (inverse, 1 / eta), (w, eta)
        for entries, factors in self._scalings:
            entries[:k] *= self._present_heads[:k]
            factors *= self._present_heads[k:]
        self.w, self.eta = w.T, eta.T

    def scaled(self, v: Array, power: int) -> Array:
        """Return W^power v, for the powers -2, -1, 1 and 2."""
        apply = apply_scaling if abs(power) == 1 else apply_scaling_twice
        return apply(self._ends, *self._scalings[power > 0], v.T).T

    def product(self, a: Array, b: Array) -> Array:
        """Return the Jordan product, a o b."""
        return product(self._ends, a.T, b.T).T

    def quotient(self, d: Array) -> Array:
        """Return the v with lam o v = d."""
        return quotient(self._ends, self._lam, d.T).T

    def inverse(self, s: Array) -> Array:
        """Return the s^-1 with s o s^-1 = e of an interior point: the gradient of ``log_determinant``."""
        return quotient(self._ends, (s + self._absent).T, self.identity.T).T

    def longest(self, scaled: Array) -> float:
        """Return the longest step from lam along a scaled direction that stays in the cone; inf if any does."""
        slope = steepest(self._ends, self._lam, scaled.T)
        return 1.0 / slope if slope > 0 else np.inf

    def margin(self, v: Array) -> float:
        """Return the distance to the boundary, negative outside."""
        return float(spectral_values(self._ends, v.T)[self._present_values].min(initial=np.inf))

    def log_determinant(self, s: Array) -> float:
        """Return sum log s_i + 1/2 sum log s'Js, the barrier of orthant and cones; -inf outside of the interior."""
        values = spectral_values(self._ends, (s + self._absent).T)
        if not (values > 0).all():
            return -np.inf
        of_rows = np.log(values).sum(axis=1)
        return float(of_rows[self.orthant].sum() + 0.5 * of_rows[self._ends[0] :].sum())

    def raised(self, v: Array, margin: float) -> Array:
        """Return the point with entries, and heads of second-order cones, raised to a margin from the boundary."""
        values, k = spectral_values(self._ends, v.T), self._ends[0]
        v = v.copy()
        v[:, self._heads] += np.maximum(margin - np.concatenate([values[:k], values[k::2]]), 0.0).T
        return np.where(self.present, v, 0.0)

    def clip_change(self, v: Array, low: float, high: float) -> Array:
        """Return the change of v that takes its spectral values into low .. high; none falls by more than ``high``."""
        values, k, out = spectral_values(self._ends, v.T), self._ends[0], np.empty_like(v)
        changes = np.maximum(np.clip(values, low, high) - values, -high)
        out[:, self.orthant] = changes[:k].T
        for block, lower, upper in zip(self.blocks, changes[k::2], changes[k + 1 :: 2], strict=True):
            size = tail_norms(v.T, block.start, block.stop)
            out[:, block] = v[:, block] * ((upper - lower) / (2 * np.where(size > 0, size, 1)))[:, None]
            out[:, block.start] = (upper + lower) / 2
        return np.where(self.present, out, 0.0)

    @property
    def inverse_squares(self) -> tuple[Array, Array]:
        """Return 1/w^2 and 1/eta^2 of orthant rows and cones, zero where absent, and the w of the cones."""
        (w, eta), k = self._scalings[0], self._ends[0]
        return np.ascontiguousarray(np.concatenate([w[:k], eta]).T ** 2), np.ascontiguousarray(self.w[:, k:])

    def block_squares(self, i: int) -> Array:
        """Return W^2 of the i-th cone of every row, (N, d, d)."""
        w = self.w[:, self.blocks[i]]
        square = 2 * w[:, :, None] * w[:, None, :]
        diagonal = np.arange(w.shape[1])
        square[:, diagonal, diagonal] += np.where(diagonal == 0, -1.0, 1.0)
        return self.eta[:, i, None, None] ** 2 * square

    @property
    def head_ratio(self) -> Array:
        """Return the entries of W^2 of the only cone next to its first one, divided by that, (N, d)."""
        head, v = self.w[:, :1], self.w[:, 1:]
        return 2 * head * v / (2 * head**2 - 1)

    @property
    def tail_square(self) -> Array:
        """Return W^2 of the only cone, (N, d, d), once the head is eliminated.

        With w = (w_0, v), the closed form eta^2 (I - 2 v v'/(1 + 2 |v|^2)) stays definite; a difference would not.
        """
        v, square = self.w[:, 1:], self.eta[:, 0, None, None] ** 2
        moved = (2 / (1 + 2 * (v * v).sum(1)))[:, None, None] * v[:, :, None] * v[:, None, :]
        return square * (np.eye(v.shape[1]) - moved)

    @property
    def tail_inverse_root(self) -> Array:
        """Return the symmetric root of the inverse of ``tail_square``, (I + 2 v v')^(1/2)/eta."""
        v = self.w[:, 1:]
        along = 2 / (1 + np.sqrt(1 + 2 * (v * v).sum(1)))
        return (np.eye(v.shape[1]) + along[:, None, None] * v[:, :, None] * v[:, None, :]) / self.eta[:, 0, None, None]
