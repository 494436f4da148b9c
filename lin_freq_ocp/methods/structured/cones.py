"""Orthants and second-order cones side by side, with their Nesterov-Todd scalings (Vandenberghe, 2010, section 4).

Arrays are (N, p): N stages, or N balls. In each, the first entries are >= 0, the others form second-order cones
v_0 >= |(v_1, ...)|. The scaling W has lam = W z = W^{-1} s: in an orthant w = sqrt(s/z), in a cone
W^2 = eta^2 (2 w w' - J) with w'Jw = 1, J = diag(1, -1, ..).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask

FREE = 1e30  # w of a row that is left out: 1/w^2 is negligible next to the others
LEAST_SQUARE = 1e-300  # of a cone's s'Js: rounding may make it zero at the boundary


class Cone:
    """The cone of rows (N, p), of which some are ``present``, at a scaling; at first W = 1."""

    def __init__(self, present: Mask, sizes: Sequence[int]):
        self.present, count = present, present.shape[1]
        ends = np.cumsum([count - sum(sizes), *sizes])
        self.orthant = slice(0, int(ends[0]))
        self.blocks = tuple(slice(int(a), int(b)) for a, b in pairwise(ends))
        self.identity = np.zeros(present.shape)
        self.identity[:, self.orthant] = present[:, self.orthant]
        for block in self.blocks:
            self.identity[:, block.start] = present[:, block.start]
        self.degree = int(self.identity.sum())
        self._absent = ~present
        self.reset()

    def reset(self) -> None:
        """Set W = 1."""
        self.w, self.lam = np.where(self.present, self.identity, 1.0), self.identity.copy()
        for block in self.blocks:
            self.w[:, block] = np.eye(1, block.stop - block.start)
        self.eta = np.ones((len(self.w), len(self.blocks)))
        self._powers: dict[int, Array] = {}

    def scale(self, s: Array, z: Array) -> None:
        """Set the scaling of interior points s and z."""
        inside = slice(None), self.orthant
        of_s, of_z = (np.where(self._absent[inside], 1.0, v[inside]) for v in (s, z))
        self.w[inside] = np.sqrt(of_s / of_z)
        self._powers = {}
        for i, block in enumerate(self.blocks):
            absent, unit = self._absent[:, block.start, None], np.eye(1, block.stop - block.start)
            p, q = np.where(absent, unit, s[:, block]), np.where(absent, unit, z[:, block])
            of_s, of_z = (np.sqrt(_square(v[:, 0], v[:, 1:])) for v in (p, q))
            p, q = p / of_s[:, None], q / of_z[:, None]
            gamma = np.sqrt(np.maximum((1 + (p * q).sum(1)) / 2, 1.0))
            tail = (p[:, 1:] - q[:, 1:]) / (2 * gamma[:, None])
            self.w[:, block.start] = np.sqrt(1 + (tail * tail).sum(1))
            self.w[:, block.start + 1 : block.stop] = tail
            self.eta[:, i] = np.sqrt(of_s / of_z)
        self.lam = self.scaled(z, 1)

    def leave_out(self) -> None:
        """Set the scaling at which the rows of an orthant do not count."""
        self.w, self._powers = np.full(self.present.shape, FREE), {}

    def scaled(self, v: Array, power: int) -> Array:
        """Return W^power v, for the powers -2, -1, 1 and 2."""
        if not self.blocks:
            return v * self._power(power)
        result = np.empty_like(v)
        result[:, self.orthant] = v[:, self.orthant] * self._power(power)
        for i, block in enumerate(self.blocks):
            result[:, block] = self._block_scaled(i, self.w[:, block], v[:, block], power)
        result[self._absent] = 0.0
        return result

    def _power(self, power: int) -> Array:
        """Return w^power of the orthant, zero where absent."""
        if power not in self._powers:
            w = self.w[:, self.orthant]
            once = np.where(self.present[:, self.orthant], w if power > 0 else 1 / w, 0.0)
            self._powers[power] = once if abs(power) == 1 else once * once
        return self._powers[power]

    def product(self, a: Array, b: Array) -> Array:
        """Return the Jordan product, a o b."""
        result = a * b
        for block in self.blocks:
            p, q = a[:, block], b[:, block]
            result[:, block.start] = (p * q).sum(1)
            result[:, block.start + 1 : block.stop] = p[:, :1] * q[:, 1:] + q[:, :1] * p[:, 1:]
        return result

    def quotient(self, d: Array) -> Array:
        """Return the v with lam o v = d."""
        result = np.empty_like(d)
        inside = slice(None), self.orthant
        result[inside] = d[inside] / np.where(self._absent[inside], 1.0, self.lam[inside])
        for block in self.blocks:
            p, q = self.lam[:, block], d[:, block]
            head = np.where(self._absent[:, block.start], 1.0, p[:, 0])
            first = (head * q[:, 0] - (p[:, 1:] * q[:, 1:]).sum(1)) / _square(head, p[:, 1:])
            result[:, block.start] = first
            result[:, block.start + 1 : block.stop] = (q[:, 1:] - p[:, 1:] * first[:, None]) / head[:, None]
        result[self._absent] = 0.0
        return result

    def longest(self, scaled: Array) -> float:
        """Return the longest step from lam along a scaled direction that stays in the cone; inf if any does."""
        inside = slice(None), self.orthant
        lam = np.where(self._absent[inside], 1.0, self.lam[inside])
        steepest = float((-scaled[inside] / lam).max(initial=0.0))
        for block in self.blocks:
            present = self.present[:, block.start]
            p, d = self.lam[present, block], scaled[present, block]
            size = np.sqrt(_square(p[:, 0], p[:, 1:]))
            p = p / size[:, None]
            along = p[:, 0] * d[:, 0] - (p[:, 1:] * d[:, 1:]).sum(1)
            across = d[:, 1:] - ((along + d[:, 0]) / (p[:, 0] + 1.0))[:, None] * p[:, 1:]
            steepest = max(steepest, float(((np.linalg.norm(across, axis=1) - along) / size).max(initial=0.0)))
        return 1.0 / steepest if steepest > 0 else np.inf

    def clip_change(self, v: Array, low: float, high: float) -> Array:
        """Return the change of v that takes its spectral values into low .. high, as ``clip_change`` does."""
        change = np.zeros_like(v)
        change[:, self.orthant] = clip_change(v[:, self.orthant], low, high)
        for block in self.blocks:
            head, tail = v[:, block.start], v[:, block.start + 1 : block.stop]
            size = np.linalg.norm(tail, axis=1)
            upper, lower = clip_change(head + size, low, high), clip_change(head - size, low, high)
            change[:, block.start] = (upper + lower) / 2
            change[:, block.start + 1 : block.stop] = (
                tail * ((upper - lower) / (2 * np.where(size > 0, size, 1)))[:, None]
            )
        change[self._absent] = 0.0
        return change

    def margin(self, v: Array) -> float:
        """Return the distance to the boundary, negative outside."""
        least = float(v[:, self.orthant][self.present[:, self.orthant]].min(initial=np.inf))
        for block in self.blocks:
            inside = v[self.present[:, block.start], block]
            least = min(least, float((inside[:, 0] - np.linalg.norm(inside[:, 1:], axis=1)).min(initial=np.inf)))
        return least

    @property
    def inverse_squares(self) -> tuple[Array, Array]:
        """Return 1/w^2 and 1/eta^2 of orthant rows and cones, zero where absent, and the w of the cones."""
        heads = [self.orthant, *(slice(block.start, block.start + 1) for block in self.blocks)]
        scales = np.column_stack([self.w[:, self.orthant], self.eta])
        present = np.column_stack([self.present[:, head] for head in heads])
        return np.where(present, scales**-2.0, 0.0), np.ascontiguousarray(self.w[:, self.orthant.stop :])

    def block_squares(self, i: int) -> Array:
        """Return W^2 of the i-th cone of every row, (N, d, d)."""
        w = self.w[:, self.blocks[i]]
        square = 2 * w[:, :, None] * w[:, None, :]
        diagonal = np.arange(w.shape[1])
        square[:, diagonal, diagonal] += np.where(diagonal == 0, -1.0, 1.0)
        return self.eta[:, i, None, None] ** 2 * square

    def _block_scaled(self, i: int, w: Array, v: Array, power: int) -> Array:
        factor, sign = self.eta[:, i] ** power, 1.0 if power > 0 else -1.0
        tail = sign * w[:, 1:]
        along = (tail * v[:, 1:]).sum(1)
        result = np.empty_like(v)
        if abs(power) == 1:
            result[:, 0] = w[:, 0] * v[:, 0] + along
            result[:, 1:] = v[:, 1:] + tail * (v[:, 0] + along / (1 + w[:, 0]))[:, None]
        else:
            twice = 2 * (w[:, 0] * v[:, 0] + along)
            result[:, 0] = twice * w[:, 0] - v[:, 0]
            result[:, 1:] = twice[:, None] * tail + v[:, 1:]
        return factor[:, None] * result


def clip_change(values: Array, low: float, high: float) -> Array:
    """Return the changes that take values into low .. high; none falls by more than ``high``."""
    return np.maximum(np.clip(values, low, high) - values, -high)


def _square(head: Array, tail: Array) -> Array:
    """Return v'Jv without the cancellation of squares."""
    size = np.sqrt((tail * tail).sum(1))
    return np.maximum((head - size) * (head + size), LEAST_SQUARE)
