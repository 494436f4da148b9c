# ruff: noqa: D102  (a method without a docstring is described by ``AffineMap``)
"""Values of both ends, v = E_0 x_0 + E_T x_T - e, and what holds them near zero, entry by entry."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.problem.terms.maps import AffineMap, MatrixMap, Shapes, joined_rows
from lin_freq_ocp.problem.terms.penalty import HARD, ConicForm, Penalty, selected_rows


@dataclass(frozen=True, eq=False)
class EndsMap(MatrixMap):
    """v = E_0 x_0 + E_T x_T - e, a single group."""

    E_0: Array  # (rows, n)
    E_T: Array  # (rows, n)
    e: Array  # (rows,)
    horizon: int

    @property
    def shape(self) -> tuple[int, int]:
        return 1, len(self.e)

    @property
    def positions(self) -> Indices:
        return np.array([0, self.horizon])

    @property
    def additions(self) -> float:
        return float(2 * self.E_0.shape[1] + 1)

    def values(self, x: Array, u: Array) -> Array:
        return (self.E_0 @ x[0] + self.E_T @ x[-1] - self.e)[None]

    def pull_back(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        of_x, of_u = (np.zeros(shape, dtype=weights.dtype) for shape in shapes)
        of_x[0], of_x[-1] = weights[0] @ self.E_0, weights[0] @ self.E_T
        return of_x, of_u

    def rows(self, horizon: int, n: int, m: int) -> tuple[sp.csr_array, Array]:
        between = sp.csr_array((len(self.e), (horizon - 1) * n))
        of_x = sp.csr_array(sp.hstack([sp.csr_array(self.E_0), between, sp.csr_array(self.E_T)]))
        return joined_rows(of_x, sp.csr_array((len(self.e), horizon * m))), -self.e

    def magnitudes(self) -> AffineMap:
        return EndsMap(np.abs(self.E_0), np.abs(self.E_T), -np.abs(self.e), self.horizon)


@dataclass(frozen=True, eq=False)
class Within(Penalty):
    """|v| <= reach in every entry, always; with a reach of 0, the equation v = 0."""

    reach: float

    @property
    def weights(self) -> Array:
        return HARD

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

    def widened(self, c: Array, amount: float) -> tuple[Array, Penalty]:
        return c, replace(self, reach=self.reach + amount)

    def conic(self, groups: int, dim: int) -> ConicForm:
        count = groups * dim
        return selected_rows(np.arange(count), np.full(count, -self.reach), np.full(count, self.reach))


@dataclass(frozen=True, eq=False)
class Link:
    """Equations on both ends: their values, what these must satisfy, and whether they say x_T = x_0.

    ``repeats`` says whether spectra of states have T samples: x_T repeats x_0, beside other equations or none.
    """

    name: str
    values: AffineMap
    penalty: Within
    periodic: bool
    repeats: bool
