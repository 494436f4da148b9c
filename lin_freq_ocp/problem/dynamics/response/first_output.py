# ruff: noqa: D102  (a method without a docstring is described by ``AffineMap``)
"""x_0 - y_0(u): the first state is the first output, which all controls of a record may act on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.problem.dynamics.response.response import Response
from lin_freq_ocp.problem.terms.maps import AffineMap, Shapes, joined_rows

NAME = "first output"


@dataclass(frozen=True, eq=False)
class FirstOutput(AffineMap):
    """v = x_0 - y_0(u), a single group."""

    response: Response

    @property
    def shape(self) -> tuple[int, int]:
        return 1, self.response.base.shape[1]

    @property
    def positions(self) -> Indices:
        return np.array([0])

    @property
    def additions(self) -> float:
        return float(5 * np.log2(self.response.record) + 10)

    @property
    def dense_size(self) -> tuple[int, int]:
        rows, m = self.shape[1], self.response.G.shape[2]
        return rows, rows * m * self.response.horizon

    def values(self, x: Array, u: Array) -> Array:
        return x[:1] - self.response.states(u)[:1]

    def pull_back(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        of_x = np.zeros(shapes[0], dtype=weights.dtype)
        of_x[0] = weights[0]
        return of_x, -self.response.pull_back(of_x)

    def rows(self, horizon: int, n: int, m: int) -> tuple[sp.csr_array, Array]:
        first = self.response.matrix[:n]
        of_x = sp.csr_array(sp.hstack([sp.eye_array(n), sp.csr_array((n, horizon * n))]))
        return joined_rows(of_x, sp.csr_array(-first)), -self.response.base[0]

    def sizes(self, x: Array, u: Array) -> Array:
        return np.abs(x[:1]) + np.abs(self.response.states(u)[:1])

    def pulled_sizes(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        of_x, of_u = self.pull_back(weights, shapes)
        return np.abs(of_x), np.abs(of_u)
