# ruff: noqa: D102
"""Rows with norms, a_i + sum_b share_ib |z_b| <= limit_i: the limits of a plant that is known up to discs.

``Penalty`` (penalty.py) documents the methods without a docstring. Rows that differ in their limits only share one row
of ``share`` and one slack M. The conic form is

    (s_b, z_b) in the second-order cone,   share s - M <= 0,   a_i + M <= limit_i.

The support function is sum_i limit_i lambda_i for multipliers lambda >= 0 of a and zeta_b of z_b with
|zeta_b| <= sum_i lambda_i share_ib, else infinity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.problem.terms.penalties import cone_rows, norm_of, slope_of_norm
from lin_freq_ocp.problem.terms.penalty import HARD, Block, ConicForm, Penalty, block_rows


@dataclass(frozen=True, eq=False)
class NormRows(Penalty):
    """The rows a_i + sum_b share_ib |z_b| <= limit_i of one group of values (a, z), always hard."""

    limit: Array  # (rows,), finite
    share: Array  # (kinds, pairs), zero or above
    kind: Indices  # (rows,): the row of ``share`` that belongs to each

    @property
    def weights(self) -> Array:
        return HARD

    def excess(self, v: Array) -> Array:
        a, z = self._split(v)
        return self._join(a + self._norms(norm_of(z, 2)) - self.limit, np.full(len(z), -np.inf))

    def excess_slope(self, v: Array, change: Array, near: float) -> Array:
        a, dz = self._split(change)
        slopes = slope_of_norm(self._split(v)[1], dz, 2, near)
        return self._join(a + self._norms(slopes), 0 * slopes)

    def recession(self, change: Array) -> Array:
        a, z = self._split(change)
        return self._join(a + self._norms(norm_of(z, 2)), np.zeros(len(z)))

    def subgradient(self, multipliers: Array, eta_C: float) -> Array:
        of_rows, zeta = self._split(multipliers)
        of_rows, size = np.maximum(of_rows, 0.0), norm_of(zeta, 2)
        most = self._largest(of_rows)
        shrunk = zeta * np.where(size > most, most / np.where(size > 0, size, 1.0), 1.0)[:, None]
        return np.concatenate([of_rows, shrunk.ravel()])[None]

    def gap(self, v: Array, multipliers: Array, eta_C: float) -> Array:
        (a, z), (of_rows, zeta) = self._split(v), self._split(multipliers)
        size = norm_of(z, 2)
        slack = self.limit - a - self._norms(size)
        return self._join(of_rows * slack, self._largest(of_rows) * size - (zeta * z).sum(1))

    def relaxed(self, c: Array, amount: float | Array) -> tuple[Array, Penalty]:
        return c, replace(self, limit=self.limit + np.ravel(amount)[: len(self.limit)])

    def sizes(self) -> Array:
        return self._join(np.abs(self.limit), np.zeros(self.share.shape[1]))

    def bounds(self, shape: tuple[int, int]) -> tuple[Array, Array]:
        upper = np.full(shape, np.inf)
        upper[0, : len(self.limit)] = self.limit  # norms are zero or above
        return np.full(shape, -np.inf), upper

    def least_slacks(self, v: Array) -> Array:
        size = norm_of(self._split(v)[1], 2)
        return np.concatenate([size, self.share @ size])

    def conic(self, groups: int, dim: int) -> ConicForm:
        rows, (kinds, pairs) = len(self.limit), self.share.shape
        entries = rows + np.arange(2 * pairs).reshape(pairs, 2)
        of_cones, lower, cones = cone_rows(entries, np.zeros(pairs))
        radii = sp.csr_array(
            (np.ones(pairs), (3 * np.arange(pairs), np.arange(pairs))), shape=(3 * pairs, pairs + kinds)
        )
        sums = sp.csr_array(np.hstack([self.share, -np.eye(kinds)]))
        of_rows = sp.csr_array((np.ones(rows), (np.arange(rows), pairs + self.kind)), shape=(rows, pairs + kinds))
        blocks: list[Block] = [
            (of_cones, lower, np.inf, radii),
            (-1, -np.inf, 0.0, sums),
            (np.arange(rows), -np.inf, self.limit, of_rows),
        ]
        first = np.array([np.argmax(self.kind == kind) for kind in range(kinds)])
        paid = np.concatenate([entries, np.column_stack([first, first])])
        return block_rows(blocks, np.zeros(pairs + kinds), paid, cones)

    def _split(self, v: Array) -> tuple[Array, Array]:
        """Return a (rows,) and z (pairs, 2), or their multipliers."""
        rows = len(self.limit)
        return v[0, :rows], v[0, rows:].reshape(-1, 2)

    def _join(self, of_rows: Array, of_pairs: Array) -> Array:
        """Return a number of each row and of each pair in the places of values; the pair's is halved."""
        return np.concatenate([of_rows, np.repeat(of_pairs / 2, 2)])[None]

    def _norms(self, sizes: Array) -> Array:
        """Return sum_b share_ib sizes_b, (rows,)."""
        return (self.share @ sizes)[self.kind]

    def _largest(self, of_rows: Array) -> Array:
        """Return the largest |zeta_b| of subgradients with these multipliers of the rows, (pairs,)."""
        totals = np.zeros(len(self.share), dtype=of_rows.dtype)
        np.add.at(totals, self.kind, of_rows)
        return totals @ self.share
