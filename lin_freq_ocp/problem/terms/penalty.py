"""The protocol of the convex functions h in hard constraints, soft constraints and nonsmooth costs.

Every h acts on values v of shape (groups, dim), group by group. The excess is the signed violation of the limits. A
finite weight is a price per unit of excess (a cost, a soft constraint); with an infinite weight the excess must be zero
or below (a hard constraint). The subgradients lambda of h are the multipliers. The Fenchel-Young gap recognises them:

    h(v) + h*(lambda) - <lambda, v> >= 0,   zero iff lambda is a subgradient of h at v,

where h* is the conjugate; for the indicator of a set, h* is the support function of the set and the gap that of the
normal cone. In a problem with eta_C = 0, finite weights count as zero.

A new convex function is a subclass of ``Penalty`` in a file of its own. It implements ``excess``, ``excess_slope``,
``recession``, ``subgradient``, ``gap`` and ``conic``; if it can be soft, ``weights``; if it is not weight *
max(excess, 0), also ``cost`` and ``slope``; and if it has slacks, ``least_slacks``. Solvers, the CVXPY export and the
certificate call these methods and never ask for the class. ``tests/helpers/own_kinds.py`` has a complete example.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask, with_fields
from lin_freq_ocp.base.errors import UnsupportedError

HARD = np.asarray(np.inf)  # the weight of a constraint that must hold


@dataclass(frozen=True, eq=False)
class ConicForm:
    """h(v) = min { prices's : lower <= v[entries] + slacks s <= upper, and the cones }.

    Every row has at most one value and any slacks. The rows of a cone minus their lower limits are (t, z) with
    t >= |z|; rows of cones come first. The multiplier of a value is the sum of the duals of its rows.
    """

    entries: Indices  # (rows,): the value of each row, numbered through the groups; -1: no value
    lower: Array  # (rows,)
    upper: Array  # (rows,)
    slacks: sp.csr_array  # (rows, slacks)
    prices: Array  # (slacks,)
    paid: Indices  # (slacks, k): the values whose excess a slack measures
    cones: tuple[slice, ...] = ()


class Penalty(ABC):
    """h(v) = sum of weight * max(excess, 0), a convex function of values (groups, dim); infinite weights are hard."""

    takes_batches: ClassVar[bool] = False  # whether values may have leading axes, for many trajectories
    polyhedral: ClassVar[bool] = False  # whether the bounds on the values are equivalent to the penalty
    stackable: ClassVar[bool] = False  # whether ``stacked`` joins penalties with different limits

    @property
    def weights(self) -> Array:
        """Return the prices per unit of excess, infinite for hard limits, which are the default; broadcasts to it."""
        return HARD

    @property
    def hard(self) -> bool:
        """Whether a limit must hold exactly."""
        return bool(np.isinf(self.weights).any())

    @property
    def signature(self) -> tuple[object, ...]:
        """Return the properties that penalties of different times must share to be stacked."""
        return (type(self), bool(np.isinf(self.weights).all())) if self.stackable else (id(self),)

    @property
    def unlimited(self) -> Mask:
        """Return which values have no limit and hence no multiplier; broadcasts to (groups, dim)."""
        return np.zeros(1, dtype=bool)

    @abstractmethod
    def excess(self, v: Array) -> Array:
        """Return the signed violation of the limits, below 0 inside, (groups, dim) or (groups, 1)."""

    @abstractmethod
    def excess_slope(self, v: Array, change: Array, near: float) -> Array:
        """Return the derivative of the excess along a change of v; within ``near`` of a kink, the larger one."""

    @abstractmethod
    def recession(self, change: Array) -> Array:
        """Return the slope of the excess along a change of v at infinity, where limits no longer matter."""

    @abstractmethod
    def subgradient(self, multipliers: Array, eta_C: float) -> Array:
        """Return the nearest multipliers that are subgradients of eta_C h at some v."""

    @abstractmethod
    def gap(self, v: Array, multipliers: Array, eta_C: float) -> Array:
        """Return the Fenchel-Young gap for subgradients of eta_C h, (groups, dim) or (groups, 1)."""

    @abstractmethod
    def conic(self, groups: int, dim: int) -> ConicForm:
        """Return rows and second-order cones that state h."""

    def cost(self, v: Array) -> Array:
        """Return h(v) of every group, (groups,), without the hard part."""
        return (self._prices * np.maximum(self.excess(v), 0.0)).sum(-1)

    def violation(self, v: Array) -> Array:
        """Return the violation of hard limits, zero or above, (groups, dim) or (groups, 1)."""
        return np.where(np.isinf(self.weights), np.maximum(self.excess(v), 0.0), 0.0)

    def slope(self, v: Array, change: Array, near: float) -> float:
        """Return the derivative of the soft part along a change of v; within ``near`` of a kink, the larger one.

        A value counts as at its limit if its excess is within ``near`` of zero.
        """
        excess, rise = self.excess(v), self.excess_slope(v, change, near)
        rise = np.where(excess > near, rise, np.where(excess < -near, 0.0, np.maximum(rise, 0.0)))
        return float((self._prices * rise).sum())

    def leaving(self, v: Array, change: Array, near: float) -> float:
        """Return the largest first-order violation of hard limits, active or violated ones, by a change of v."""
        active = np.isinf(self.weights) & (self.excess(v) >= -near)
        return float(np.max(np.where(active, self.excess_slope(v, change, near), 0.0), initial=0.0))

    def unbounded(self, change: Array) -> tuple[Array, float]:
        """Return the violations of hard limits and the cost per unit of a change of v at infinity."""
        rising = np.maximum(self.recession(change), 0.0)
        return np.where(np.isinf(self.weights), rising, 0.0), float((self._prices * rising).sum())

    def sizes(self) -> Array:
        """Return the absolute values of the limits, 0 for no limit; broadcasts to (groups, dim)."""
        return np.zeros(1)

    def bounds(self, shape: tuple[int, int]) -> tuple[Array, Array]:
        """Return bounds on the values that the limits imply, hard or soft, (groups, dim)."""
        return np.full(shape, -np.inf), np.full(shape, np.inf)

    def hard_bounds(self, shape: tuple[int, int], level: float = np.inf) -> tuple[Array, Array]:
        """Return the bounds that hard limits imply, and a price on excesses of at most ``level``."""
        (lower, upper), weights = self.bounds(shape), self.weights
        beyond = np.divide(
            level, weights, out=np.full(weights.shape, np.inf), where=(weights > 0) & np.isfinite(weights)
        )
        beyond = np.where(np.isinf(weights), 0.0, beyond)
        return lower - beyond, upper + beyond

    def limit_multipliers(self, multipliers: Array, v: Array, change: Array | None = None) -> Array | None:
        """Return minus the derivatives of h by its limits at v, from the multipliers; None if h has no limits.

        With a change of the multipliers, the change of these derivatives while the violation stays.
        """
        return None

    def least_slacks(self, v: Array) -> Array:
        """Return the least feasible slacks of the conic form, (slacks,)."""
        return np.zeros(0)

    def softened(self, weight: Array) -> Penalty:
        """Return the penalty with another weight."""
        if "weight" not in vars(self):
            raise UnsupportedError(f"{type(self).__name__} cannot be soft.")
        return with_fields(self, weight=weight)

    def relaxed(self, c: Array, amount: float | Array) -> tuple[Array, Penalty]:
        """Return the constant of the affine map and the penalty if the limits are higher by an amount."""
        raise UnsupportedError(f"{type(self).__name__} has no limits that could be higher.")

    def absorbing(self, c: Array) -> tuple[Array, Penalty]:
        """Return the constant of the affine map and the penalty if the limits absorb the constant, if they can."""
        return c, self

    def stacked(self, parts: list[Penalty]) -> Penalty:
        """Return one penalty of several groups, one for each of the parts, which share a signature."""
        return self

    @property
    def _prices(self) -> Array:
        """Return the finite weights, and 0 for infinite ones."""
        return np.where(np.isinf(self.weights), 0.0, self.weights)

    def _scaled_weight(self, eta_C: float) -> Array:
        """Return eta_C * weight; infinite weights stay infinite."""
        return np.where(np.isinf(self.weights), np.inf, eta_C * self._prices)


def weight_of(penalty: float | None) -> Array:
    """Return the weight of a penalty that users state: a price per unit of violation, or None for a hard constraint."""
    return HARD if penalty is None else np.asarray(penalty)


Block = tuple[Indices | int, Array | float, Array | float, sp.csr_array]  # entries, lower, upper and slacks of rows


def block_rows(blocks: Sequence[Block], prices: Array, paid: Indices, cones: tuple[slice, ...] = ()) -> ConicForm:
    """Return the rows of blocks in their order; a number applies to all rows of its block."""
    entries, lower, upper = (
        np.concatenate([np.broadcast_to(np.asarray(block[i]), block[3].shape[:1]) for block in blocks])
        for i in range(3)
    )
    slacks = sp.csr_array(sp.vstack([block[3] for block in blocks]))
    return ConicForm(entries, lower, upper, slacks, prices, paid, cones)


def selected_rows(entries: Indices, lower: Array, upper: Array, cones: tuple[slice, ...] = ()) -> ConicForm:
    """Return rows without slacks."""
    none = sp.csr_array((len(entries), 0))
    return ConicForm(entries, lower, upper, none, np.zeros(0), np.zeros((0, 1), dtype=int), cones)
