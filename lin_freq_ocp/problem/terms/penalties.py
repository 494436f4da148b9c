"""Convex functions h of which hard constraints, soft constraints and nonsmooth costs are made.

Every h acts on values v of shape (groups, dim), group by group, and is told by its weight: finite, it is a price per
unit of excess (a cost, a soft constraint); infinite, the excess must be zero (a hard constraint). Its subgradients
lambda are the multipliers. They are recognised by the Fenchel-Young gap

    h(v) + h*(lambda) - <lambda, v> >= 0,   zero iff lambda is a subgradient of h at v,

where h* is the conjugate; for the indicator of a set, h* is the set's support function and the gap that of the normal
cone. In a problem with eta_C = 0, finite weights count as zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array


@dataclass(frozen=True, eq=False)
class Below:
    """h(v) = sum of weight * max(v - limit, 0), entry by entry: v <= limit, where the weight is infinite.

    Attributes
    ----------
    limit : (groups, dim) or (dim,)
        inf where there is none.
    weight : float or array that broadcasts to (groups, dim)
        Price per unit of excess; inf: hard.
    """

    limit: Array
    weight: Array

    def cost(self, v: Array) -> Array:
        """Return h(v) of every group, (groups,), without the hard part."""
        return (_finite(self.weight) * np.maximum(v - self.limit, 0.0)).sum(1)

    def violation(self, v: Array) -> Array:
        """Return the excess where the constraint is hard, (groups, dim)."""
        return np.where(np.isinf(self.weight), np.maximum(v - self.limit, 0.0), 0.0)

    def subgradient(self, multipliers: Array, eta_C: float) -> Array:
        """Return the nearest multipliers that are subgradients of h somewhere."""
        return np.clip(multipliers, 0.0, np.where(np.isfinite(self.limit), _scaled(self.weight, eta_C), 0.0))

    def gap(self, v: Array, multipliers: Array, eta_C: float) -> Array:
        """Return the Fenchel-Young gap of every entry for subgradients of h, (groups, dim)."""
        slack = np.where(multipliers > 0, self.limit - v, 0.0)
        return multipliers * slack + eta_C * _finite(self.weight) * np.maximum(v - self.limit, 0.0)

    def misfit(self, v: Array, multipliers: Array) -> Array:
        """Return how far the direction of multipliers is from that of v, to first order: here they have none."""
        return np.zeros(np.broadcast_shapes(v.shape, multipliers.shape))

    def sizes(self) -> Array:
        """Return the absolute values of the limits, 0 where there is none; broadcasts to (groups, dim)."""
        return np.where(np.isfinite(self.limit), np.abs(self.limit), 0.0)


@dataclass(frozen=True, eq=False)
class Norm:
    """h(v) = sum over groups of weight * max(|v| - radius, 0): |v| <= radius, where the weight is infinite.

    Attributes
    ----------
    order : float
        1: sum of absolute values; 2: Euclidean; inf: largest absolute value.
    radius : (groups,) or ()
        0 or above; with an infinite weight, 0 means v = 0. inf where there is no limit.
    weight : (groups,) or ()
    """

    order: float
    radius: Array
    weight: Array

    def cost(self, v: Array) -> Array:
        """Return h(v) of every group, (groups,), without the hard part."""
        return _finite(self.weight) * self._excess(v)

    def violation(self, v: Array) -> Array:
        """Return by how much |v| exceeds the radius where the constraint is hard, (groups, 1)."""
        return np.where(np.isinf(self.weight), self._excess(v), 0.0)[:, None]

    def subgradient(self, multipliers: Array, eta_C: float) -> Array:
        """Return multipliers of the same direction that are subgradients of h somewhere."""
        largest = np.where(np.isfinite(self.radius), _scaled(self.weight, eta_C), 0.0)
        size = self._dual_norm(multipliers)
        shrink = np.where(size > largest, largest / np.where(size > 0, size, 1.0), 1.0)
        return multipliers * shrink[:, None]

    def gap(self, v: Array, multipliers: Array, eta_C: float) -> Array:
        """Return the Fenchel-Young gap of every group for subgradients of h, (groups, 1)."""
        size = self._dual_norm(multipliers)
        support = np.where(size > 0, self.radius, 0.0) * size
        total = support - (multipliers * v).sum(1) + eta_C * _finite(self.weight) * self._excess(v)
        return total[:, None]

    def misfit(self, v: Array, multipliers: Array) -> Array:
        """Return |v| times the part of the multipliers across v (the gap is of second order in it), (groups, 1)."""
        return _across(v, multipliers)[:, None] if self.order == 2 else np.zeros((len(v), 1))

    def sizes(self) -> Array:
        """Return the radii, 0 where there is none; broadcasts to (groups, dim)."""
        return np.where(np.isfinite(self.radius), self.radius, 0.0)[..., None]

    def _excess(self, v: Array) -> Array:
        return np.maximum(self._norm(v) - self.radius, 0.0)

    def _norm(self, v: Array) -> Array:
        return _norm(v, self.order)

    def _dual_norm(self, v: Array) -> Array:
        return _norm(v, {1: np.inf, 2: 2, np.inf: 1}[self.order])


@dataclass(frozen=True, eq=False)
class Cone:
    """h is the indicator of the second-order cone: v_0 >= |(v_1, v_2, ...)|, group by group. Always hard."""

    @property
    def weight(self) -> Array:
        """Return infinity."""
        return np.asarray(np.inf)

    def cost(self, v: Array) -> Array:
        """Return 0 for every group, (groups,)."""
        return np.zeros(len(v))

    def violation(self, v: Array) -> Array:
        """Return by how much |(v_1, ...)| exceeds v_0, (groups, 1)."""
        return np.maximum(np.sqrt((v[:, 1:] ** 2).sum(1)) - v[:, 0], 0.0)[:, None]

    def subgradient(self, multipliers: Array, eta_C: float) -> Array:
        """Return multipliers in the polar cone, with -lambda_0 >= |(lambda_1, ...)|."""
        fitting = multipliers.copy()
        fitting[:, 0] = np.minimum(fitting[:, 0], -np.sqrt((fitting[:, 1:] ** 2).sum(1)))
        return fitting

    def gap(self, v: Array, multipliers: Array, eta_C: float) -> Array:
        """Return -<lambda, v>, (groups, 1)."""
        return -(multipliers * v).sum(1)[:, None]

    def misfit(self, v: Array, multipliers: Array) -> Array:
        """Return |(v_1, ...)| times the part of (lambda_1, ...) across it, (groups, 1)."""
        return _across(v[:, 1:], multipliers[:, 1:])[:, None]

    def sizes(self) -> Array:
        """Return 0: there is no limit."""
        return np.zeros(1)


Penalty = Below | Norm | Cone


def weight_of(penalty: float | None) -> Array:
    """Return the weight of a penalty as users give it: a price per unit of excess, or None for what must hold."""
    return np.asarray(np.inf if penalty is None else penalty)


def hard(weight: Array) -> bool:
    """Whether anything with this weight must hold exactly."""
    return bool(np.isinf(weight).any())


def _norm(v: Array, order: float) -> Array:
    if order == 2:
        return np.sqrt((v * v).sum(1))  # and not np.linalg.norm, which leaves extended precision
    return np.abs(v).sum(1) if order == 1 else np.abs(v).max(1)


def _finite(weight: Array) -> Array:
    """Return the weights that are prices, 0 for the infinite ones."""
    return np.where(np.isinf(weight), 0.0, weight)


def _scaled(weight: Array, eta_C: float) -> Array:
    """Return weight * eta_C, with infinity what it is."""
    return np.where(np.isinf(weight), np.inf, eta_C * _finite(weight))


def _across(v: Array, multipliers: Array) -> Array:
    """Return |v| |lambda - its part along v|, (groups,)."""
    square = (v * v).sum(1)
    along = (multipliers * v).sum(1) / np.where(square > 0, square, 1.0)
    rest = multipliers - along[:, None] * v
    return np.sqrt(square * (rest * rest).sum(1))
