# ruff: noqa: D102  (a method without a docstring is described by ``Penalty``)
"""The price of the largest relative excess of several norms over their limits: one slack for all of them.

    h(v) = weight * max(0, max_j |v_j| / l_j - 1),    h*(lambda) = sum_j l_j |lambda_j|  where that is <= weight.

Conic form, with one slack s, a multiple L of the excess (L the largest limit, so that s has the unit of the values):

    (l_j + (l_j / L) s, v_j) in the second-order cone, s >= 0         cost (weight / L) s
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.problem.terms.penalties import across, norm_of, slope_of_norm
from lin_freq_ocp.problem.terms.penalty import ConicForm, Penalty


@dataclass(frozen=True, eq=False)
class LargestExcess(Penalty):
    """h(v) = weight * max(0, max over groups of |v| / limit - 1)."""

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
        """Return h(v), of all groups together, (1,): which of them has the largest excess is a matter of rounding."""
        return np.array([self.weight * self._raised(v)])

    def slope(self, v: Array, change: Array, near: float) -> float:
        excess = self.excess(v)
        reach = near / np.min(self.limit, initial=np.inf)
        largest = excess >= excess.max(initial=0.0) - reach
        rise = float(np.max(self.excess_slope(v, change, near), initial=-np.inf, where=largest))
        if not largest.any():
            return 0.0
        return float(self.weight) * (rise if excess.max() > reach else max(rise, 0.0))

    def unbounded(self, change: Array) -> tuple[float, float]:
        return 0.0, float(self.weight * self.recession(change).max(initial=0.0))

    def subgradient(self, multipliers: Array, eta_C: float) -> Array:
        limited = np.where(np.isfinite(self.limit)[:, None], multipliers, 0.0)
        most, spent = self.weight * eta_C, self._spent(limited).sum()
        return limited * (most / spent) if spent > most else limited

    def gap(self, v: Array, multipliers: Array, eta_C: float) -> Array:
        spent, raised = self._spent(multipliers), self._raised(v)
        gaps = spent * (1 + raised) - (multipliers * v).sum(1)
        return (gaps + self._of_largest(v, raised * (eta_C * self.weight - spent.sum())))[:, None]

    def misfit(self, v: Array, multipliers: Array) -> Array:
        return across(v, multipliers)[:, None]

    def sizes(self) -> Array:
        return np.where(np.isfinite(self.limit), self.limit, 0.0)[:, None]

    def bounds(self, shape: tuple[int, int]) -> tuple[Array, Array]:
        limit = np.broadcast_to(self.limit[:, None], shape)
        return -limit, limit

    def limit_multipliers(self, multipliers: Array) -> Array:
        return norm_of(multipliers, 2)[:, None]

    def least_slacks(self, v: Array) -> Array:
        return np.array([self._raised(v) * self._unit])

    def conic(self, groups: int, dim: int) -> ConicForm:
        limited = np.flatnonzero(np.isfinite(self.limit))
        limit, entries = self.limit[limited], limited[:, None] * dim + np.arange(dim)
        rows = np.append(np.column_stack([np.full(len(limited), -1), entries]).ravel(), -1)
        lower = np.append(np.column_stack([-limit, np.zeros(entries.shape)]).ravel(), 0.0)
        first = np.arange(len(limited)) * (dim + 1)
        slacks = np.zeros((len(rows), 1))
        slacks[first, 0], slacks[-1, 0] = limit / self._unit, 1.0
        price, paid = np.array([float(self.weight) / self._unit]), entries.reshape(1, -1)
        cones = tuple(slice(int(row), int(row) + dim + 1) for row in first)
        return ConicForm(rows, lower, np.full(len(rows), np.inf), sp.csr_array(slacks), price, paid, cones)

    def softened(self, weight: Array) -> Penalty:
        return replace(self, weight=weight)

    def widened(self, c: Array, amount: float) -> tuple[Array, Penalty]:
        return c, replace(self, limit=self.limit + amount)

    @property
    def _unit(self) -> float:
        """Return L."""
        return float(np.max(self.limit, initial=0.0, where=np.isfinite(self.limit))) or 1.0

    def _raised(self, v: Array) -> float:
        """Return the largest relative excess, zero or above."""
        return self.excess(v).max(initial=0.0)

    def _spent(self, multipliers: Array) -> Array:
        """Return l |lambda|, (groups,)."""
        size = norm_of(multipliers, 2)
        return np.where(size > 0, self.limit, 0.0) * size

    def _of_largest(self, v: Array, amount: Array | float) -> Array:
        """Return an amount at the group of the largest excess, zeros elsewhere, (groups,)."""
        found = np.zeros(len(v), dtype=v.dtype)
        if len(found):
            found[int(np.argmax(self.excess(v)))] = amount
        return found
