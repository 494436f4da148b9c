# ruff: noqa: D102
"""The convex functions of sets, joint rows, costs and frequency constraints.

``Penalty`` (penalty.py) is their protocol and documents the methods without a docstring.

Their conic forms, with slacks s >= 0:

    HalfSpaces, hard         v <= limit
    HalfSpaces, soft         v - s <= limit, s >= 0                             cost weight * s, a slack per entry
    Within                   -reach <= v <= reach
    NormBall, 1              v - s <= 0, v + s >= 0                             cost weight * s, a slack per entry
    NormBall, inf, hard      -radius <= v <= radius
    NormBall, inf, soft      v - s <= radius, v + s >= -radius, s >= 0          cost weight * s, a slack per group
    NormBall, 2, hard        (radius, v) in the second-order cone; v = 0 where the radius is 0
    NormBall, 2, soft        (radius + s, v) in the second-order cone, s >= 0   cost weight * s, a slack per group
    StandardCone             v in the second-order cone
    LargestExcess            (l_j + (l_j / L) s, v_j) in the cone, s >= 0       cost (weight / L) * s, a single slack

L is the largest limit l_j, so that s has the unit of the values.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask, to_long_double
from lin_freq_ocp.problem.terms.penalty import Block, ConicForm, Penalty, block_rows, selected_rows

DUAL_ORDER = {1: np.inf, 2: 2, np.inf: 1}  # of a norm, the order of its dual norm


@dataclass(frozen=True, eq=False)
class HalfSpaces(Penalty):
    """h(v) = sum of weight * max(v - limit, 0), entry by entry: v <= limit, where the weight is infinite."""

    takes_batches: ClassVar[bool] = True
    polyhedral: ClassVar[bool] = True
    stackable: ClassVar[bool] = True
    limit: Array  # (groups, dim) or (dim,); inf where there is none
    weight: Array  # price per unit of violation, inf for a hard limit; broadcasts to (groups, dim)

    @property
    def weights(self) -> Array:
        return self.weight

    @property
    def unlimited(self) -> Mask:
        return np.isinf(self.limit)

    def excess(self, v: Array) -> Array:
        return v - self.limit

    def excess_slope(self, v: Array, change: Array, near: float) -> Array:
        return change

    def recession(self, change: Array) -> Array:
        return np.where(np.isfinite(self.limit), change, 0.0)

    def subgradient(self, multipliers: Array, eta_C: float) -> Array:
        return np.clip(multipliers, 0.0, np.where(np.isfinite(self.limit), self._scaled_weight(eta_C), 0.0))

    def gap(self, v: Array, multipliers: Array, eta_C: float) -> Array:
        slack = np.where(multipliers > 0, self.limit - v, 0.0)
        return multipliers * slack + eta_C * self._prices * np.maximum(v - self.limit, 0.0)

    def sizes(self) -> Array:
        return np.where(np.isfinite(self.limit), np.abs(self.limit), 0.0)

    def bounds(self, shape: tuple[int, int]) -> tuple[Array, Array]:
        return np.full(shape, -np.inf), np.broadcast_to(self.limit, shape)

    def limit_multipliers(self, multipliers: Array, v: Array, change: Array | None = None) -> Array:
        return multipliers if change is None else change

    def least_slacks(self, v: Array) -> Array:
        return np.zeros(0) if self.hard else np.maximum(v - self.limit, 0.0).ravel()[self._limited_entries(v.shape)]

    def conic(self, groups: int, dim: int) -> ConicForm:
        entries = self._limited_entries((groups, dim))
        upper, identity = self.bounds((groups, dim))[1].ravel()[entries], sp.csr_array(sp.eye_array(len(entries)))
        if self.hard:
            return selected_rows(entries, np.full(len(entries), -np.inf), upper)
        blocks: list[Block] = [(entries, -np.inf, upper, -identity), (-1, 0.0, np.inf, identity)]
        return block_rows(blocks, np.broadcast_to(self.weight, (groups, dim)).ravel()[entries], entries[:, None])

    def relaxed(self, c: Array, amount: float | Array) -> tuple[Array, Penalty]:
        return c, replace(self, limit=self.limit + amount)

    def absorbing(self, c: Array) -> tuple[Array, Penalty]:
        return np.zeros_like(c), replace(self, limit=(to_long_double(self.limit) - c).astype(np.float64))

    def stacked(self, parts: list[Any]) -> Penalty:
        weights = np.array([np.asarray(part.weight, dtype=float) for part in parts])
        return HalfSpaces(np.array([part.limit for part in parts]), weights.reshape(len(parts), -1))

    def _limited_entries(self, shape: tuple[int, ...]) -> Indices:
        return np.flatnonzero(np.isfinite(np.broadcast_to(self.limit, shape)))


@dataclass(frozen=True, eq=False)
class Within(Penalty):
    """|v| <= reach in every entry, always hard; with a reach of 0, the equation v = 0."""

    reach: float

    def excess(self, v: Array) -> Array:
        return np.abs(v) - self.reach

    def excess_slope(self, v: Array, change: Array, near: float) -> Array:
        return np.where(np.abs(v) > near, np.sign(v) * change, np.abs(change))

    def recession(self, change: Array) -> Array:
        return np.abs(change)

    def subgradient(self, multipliers: Array, eta_C: float) -> Array:
        return multipliers

    def gap(self, v: Array, multipliers: Array, eta_C: float) -> Array:
        return self.reach * np.abs(multipliers) - multipliers * v

    def sizes(self) -> Array:
        return np.full(1, self.reach)

    def bounds(self, shape: tuple[int, int]) -> tuple[Array, Array]:
        return np.full(shape, -self.reach), np.full(shape, self.reach)

    def relaxed(self, c: Array, amount: float | Array) -> tuple[Array, Penalty]:
        return c, replace(self, reach=self.reach + amount)

    def conic(self, groups: int, dim: int) -> ConicForm:
        count = groups * dim
        return selected_rows(np.arange(count), np.full(count, -self.reach), np.full(count, self.reach))


@dataclass(frozen=True, eq=False)
class NormBall(Penalty):
    """h(v) = sum over groups of weight * max(|v| - radius, 0): |v| <= radius, where the weight is infinite."""

    stackable: ClassVar[bool] = True
    order: float  # 1: sum of absolute values; 2: Euclidean; inf: largest absolute value
    radius: Array  # (groups,) or (), 0 or above; with an infinite weight, 0 means v = 0; inf where there is no limit
    weight: Array  # (groups,) or ()

    @property
    def weights(self) -> Array:
        return self.weight[..., None]

    @property
    def signature(self) -> tuple[object, ...]:
        return *super().signature, self.order

    def excess(self, v: Array) -> Array:
        return (norm_of(v, self.order) - self.radius)[:, None]

    def excess_slope(self, v: Array, change: Array, near: float) -> Array:
        return slope_of_norm(v, change, self.order, near)[:, None]

    def recession(self, change: Array) -> Array:
        return np.where(np.isfinite(self.radius), norm_of(change, self.order), 0.0)[:, None]

    def subgradient(self, multipliers: Array, eta_C: float) -> Array:
        largest = np.where(np.isfinite(self.radius), self._scaled_weight(eta_C)[..., 0], 0.0)
        size = norm_of(multipliers, DUAL_ORDER[self.order])
        shrink = np.where(size > largest, largest / np.where(size > 0, size, 1.0), 1.0)
        return multipliers * shrink[:, None]

    def gap(self, v: Array, multipliers: Array, eta_C: float) -> Array:
        size = norm_of(multipliers, DUAL_ORDER[self.order])
        support = np.where(size > 0, self.radius, 0.0) * size
        return (support - (multipliers * v).sum(1) + eta_C * self.cost(v))[:, None]

    def sizes(self) -> Array:
        return np.where(np.isfinite(self.radius), self.radius, 0.0)[..., None]

    def bounds(self, shape: tuple[int, int]) -> tuple[Array, Array]:
        radius = np.broadcast_to(np.broadcast_to(self.radius, shape[:1])[:, None], shape)
        return -radius, radius

    def limit_multipliers(self, multipliers: Array, v: Array, change: Array | None = None) -> Array:
        order = DUAL_ORDER[self.order]
        size = norm_of(multipliers, order) if change is None else slope_of_norm(multipliers, change, order, 0.0)
        return size[:, None]

    def least_slacks(self, v: Array) -> Array:
        if self.hard:
            return np.zeros(0)
        if self.order == 1:
            return np.abs(v).ravel()
        return np.maximum(self.excess(v), 0.0).ravel()[np.isfinite(np.broadcast_to(self.radius, v.shape[:1]))]

    def conic(self, groups: int, dim: int) -> ConicForm:
        radius = np.broadcast_to(self.radius, (groups,))
        limited = np.flatnonzero(np.isfinite(radius))
        weight = np.broadcast_to(self.weight, (groups,))[limited]
        entries = limited[:, None] * dim + np.arange(dim)
        flat, reach = entries.ravel(), np.repeat(radius[limited], dim)
        if self.order == 1:
            each = sp.csr_array(sp.eye_array(len(flat)))
            sides: list[Block] = [(flat, -np.inf, 0.0, -each), (flat, 0.0, np.inf, each)]
            return block_rows(sides, np.repeat(weight, dim), flat[:, None])
        if self.order == 2 and dim > 1:
            return self._cones(entries, radius[limited], weight)
        if self.hard:
            return selected_rows(flat, -reach, reach)
        identity = sp.csr_array(sp.eye_array(len(limited)))
        spread = sp.csr_array(sp.kron(identity, np.ones((dim, 1))))
        blocks: list[Block] = [(flat, -np.inf, reach, -spread), (flat, -reach, np.inf, spread)]
        return block_rows([*blocks, (-1, 0.0, np.inf, identity)], weight, entries)

    def relaxed(self, c: Array, amount: float | Array) -> tuple[Array, Penalty]:
        return c, replace(self, radius=self.radius + np.reshape(amount, np.shape(amount)[:1]))

    def stacked(self, parts: list[Any]) -> Penalty:
        weights = np.array([np.asarray(part.weight, dtype=float) for part in parts])
        return NormBall(self.order, np.array([part.radius for part in parts]), weights)

    def _cones(self, entries: Indices, radius: Array, weight: Array) -> ConicForm:
        """Return a cone (radius + s, v) for every group; a hard group of radius 0 is an equation."""
        round_, count = (radius > 0) | (not self.hard), 0 if self.hard else len(entries)
        zero, inside = entries[~round_].ravel(), entries[round_]
        rows, lower, slices = cone_rows(inside, radius[round_])
        first = np.arange(count) * (entries.shape[1] + 1)
        of_cones = sp.csr_array((np.ones(count), (first, np.arange(count))), shape=(len(rows), count))
        positive = sp.csr_array(sp.eye_array(count, format="csr")[radius[:count] > 0])  # else |v| <= s implies it
        blocks: list[Block] = [(rows, lower, np.inf, of_cones), (-1, 0.0, np.inf, positive)]
        equations = zero, 0.0, 0.0, sp.csr_array((len(zero), count))
        return block_rows([*blocks, equations], weight[:count], entries[:count], slices)


@dataclass(frozen=True, eq=False)
class StandardCone(Penalty):
    """The second-order cone v_0 >= |(v_1, v_2, ...)| in every group, always hard: h is its indicator."""

    stackable: ClassVar[bool] = True  # they have no limits

    def excess(self, v: Array) -> Array:
        return (norm_of(v[:, 1:], 2) - v[:, 0])[:, None]

    def excess_slope(self, v: Array, change: Array, near: float) -> Array:
        return (slope_of_norm(v[:, 1:], change[:, 1:], 2, near) - change[:, 0])[:, None]

    def recession(self, change: Array) -> Array:
        return self.excess(change)

    def subgradient(self, multipliers: Array, eta_C: float) -> Array:
        fitting = multipliers.copy()
        fitting[:, 0] = np.minimum(fitting[:, 0], -norm_of(fitting[:, 1:], 2))
        return fitting

    def gap(self, v: Array, multipliers: Array, eta_C: float) -> Array:
        return -(multipliers * v).sum(1)[:, None]

    def relaxed(self, c: Array, amount: float | Array) -> tuple[Array, Penalty]:
        return c + amount * (np.arange(len(c)) == 0), self

    def conic(self, groups: int, dim: int) -> ConicForm:
        count = groups * dim
        return selected_rows(np.arange(count), np.zeros(count), np.full(count, np.inf), cone_slices(groups, dim))


@dataclass(frozen=True, eq=False)
class LargestExcess(Penalty):
    """h(v) = weight * max(0, max over groups of |v_j| / l_j - 1): a price on the largest relative violation.

    h*(lambda) = sum_j l_j |lambda_j| if that is <= weight, else infinity.
    """

    limit: Array  # (groups,), above zero; inf where there is none
    weight: Array  # (), finite

    @property
    def weights(self) -> Array:
        return self.weight

    @property
    def unlimited(self) -> Mask:
        return np.isinf(self.limit)[:, None]

    def excess(self, v: Array) -> Array:
        return (norm_of(v, 2) / self.limit - 1)[:, None]

    def excess_slope(self, v: Array, change: Array, near: float) -> Array:
        return (slope_of_norm(v, change, 2, near) / self.limit)[:, None]

    def recession(self, change: Array) -> Array:
        return (norm_of(change, 2) / self.limit)[:, None]

    def cost(self, v: Array) -> Array:
        """Return h(v) of all groups, (1,): rounding decides which group has the largest violation."""
        return np.array([self.weight * self._largest_violation(v)])

    def slope(self, v: Array, change: Array, near: float) -> float:
        excess = self.excess(v)
        reach = near / np.min(self.limit, initial=np.inf)
        largest = excess >= excess.max(initial=0.0) - reach
        rise = float(np.max(self.excess_slope(v, change, near), initial=-np.inf, where=largest))
        return float(self.weight) * (rise if excess.max(initial=0.0) > reach else max(rise, 0.0))

    def unbounded(self, change: Array) -> tuple[Array, float]:
        return np.zeros((len(change), 1)), float(self.weight * self.recession(change).max(initial=0.0))

    def subgradient(self, multipliers: Array, eta_C: float) -> Array:
        limited = np.where(np.isfinite(self.limit)[:, None], multipliers, 0.0)
        most, support = self.weight * eta_C, self._support(limited).sum()
        return limited * (most / support) if support > most else limited

    def gap(self, v: Array, multipliers: Array, eta_C: float) -> Array:
        support, violation = self._support(multipliers), self._largest_violation(v)
        gaps = support * (1 + violation) - (multipliers * v).sum(1)
        if len(gaps):  # the rest of the weight belongs to the group of the largest violation
            gaps[int(np.argmax(self.excess(v)))] += violation * (eta_C * self.weight - support.sum())
        return gaps[:, None]

    def sizes(self) -> Array:
        return np.where(np.isfinite(self.limit), self.limit, 0.0)[:, None]

    def bounds(self, shape: tuple[int, int]) -> tuple[Array, Array]:
        limit = np.broadcast_to(self.limit[:, None], shape)
        return -limit, limit

    def limit_multipliers(self, multipliers: Array, v: Array, change: Array | None = None) -> Array:
        size = norm_of(multipliers, 2) if change is None else slope_of_norm(multipliers, change, 2, 0.0)
        return (1 + self._largest_violation(v)) * size[:, None]

    def least_slacks(self, v: Array) -> Array:
        return np.array([self._largest_violation(v) * self._unit])

    def conic(self, groups: int, dim: int) -> ConicForm:
        limited = np.flatnonzero(np.isfinite(self.limit))
        limit, entries = self.limit[limited], limited[:, None] * dim + np.arange(dim)
        rows, lower, cones = cone_rows(entries, limit)
        radii = sp.csr_array(np.column_stack([limit / self._unit, np.zeros(entries.shape)]).reshape(-1, 1))
        price, paid = np.array([float(self.weight) / self._unit]), entries.reshape(1, -1)
        blocks: list[Block] = [(rows, lower, np.inf, radii), (-1, 0.0, np.inf, sp.csr_array([[1.0]]))]
        return block_rows(blocks, price, paid, cones)

    def relaxed(self, c: Array, amount: float | Array) -> tuple[Array, Penalty]:
        return c, replace(self, limit=self.limit + amount)

    @property
    def _unit(self) -> float:
        """Return L."""
        return float(np.max(self.limit, initial=0.0, where=np.isfinite(self.limit))) or 1.0

    def _largest_violation(self, v: Array) -> float:
        """Return the largest relative violation, zero or above."""
        return self.excess(v).max(initial=0.0)

    def _support(self, multipliers: Array) -> Array:
        """Return l_j |lambda_j|, (groups,), whose sum is h*."""
        size = norm_of(multipliers, 2)
        return np.where(size > 0, self.limit, 0.0) * size


def cone_rows(entries: Indices, radius: Array) -> tuple[Indices, Array, tuple[slice, ...]]:
    """Return entries, lower limits and cones of rows (radius, v), for values v of these entries (cones, dim)."""
    rows = np.column_stack([np.full(len(entries), -1), entries])
    lower = np.column_stack([-radius, np.zeros(entries.shape)])
    return rows.ravel(), lower.ravel(), cone_slices(*rows.shape)


def cone_slices(count: int, size: int) -> tuple[slice, ...]:
    """Return the rows of ``count`` consecutive cones of ``size`` rows each."""
    return tuple(slice(g * size, (g + 1) * size) for g in range(count))


def norm_of(v: Array, order: float) -> Array:
    """Return |v| of every group, (groups,)."""
    if order == 2:
        return np.sqrt((v * v).sum(1))  # np.linalg.norm would round to double precision
    return np.abs(v).sum(1) if order == 1 else np.abs(v).max(1)


def slope_of_norm(v: Array, change: Array, order: float, near: float) -> Array:
    """Return the derivative of |v| along a change, (groups,); entries within ``near`` of a kink count as at it."""
    if order == 2:
        size = norm_of(v, 2)
        along = (v * change).sum(1) / np.where(size > 0, size, 1.0)
        return np.where(size > near, along, norm_of(change, 2))
    by_entry = np.where(np.abs(v) > near, np.sign(v) * change, np.abs(change))
    if order == 1:
        return by_entry.sum(1)
    largest = np.abs(v) >= np.abs(v).max(1, keepdims=True) - near
    return np.where(largest, by_entry, -np.inf).max(1)
