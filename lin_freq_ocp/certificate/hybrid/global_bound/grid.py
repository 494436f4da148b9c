"""Cells of states with affine functions below the cost-to-go, and the least of them over ranges of cells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.certificate.hybrid.global_bound.tolerances import ROUNDING


def index_tuples(shape: Indices) -> Indices:
    """Return the indices of all entries of an array of this shape, (entries, n)."""
    return np.indices(tuple(shape), dtype=np.intp).reshape(len(shape), -1).T


@dataclass(frozen=True, eq=False)
class Lattice:
    """A regular grid over the states at one time, and the cells of it that are looked at.

    Attributes
    ----------
    lower, width : (n,)
        The lower corner of the grid, and the width of a cell: 0 where the state is fixed.
    shape : (n,) integers
    cells : (cells, n) integers
        Indices of every cell.
    finest : (n,)
        Cells that are no wider are not halved.
    """

    lower: Array
    width: Array
    shape: Indices
    cells: Indices
    finest: Array

    @classmethod
    def full(cls, lower: Array, upper: Array, finest: Array, each: int) -> Lattice:
        """Return a lattice with ``each`` cells along each state, one where that is too narrow; all are looked at."""
        shape = np.where(upper - lower > finest, each, 1).astype(np.intp)
        return cls(lower, (upper - lower) / shape, shape, index_tuples(shape), finest)

    @property
    def upper(self) -> Array:
        """Return the upper corner, (n,)."""
        return self.lower + self.width * self.shape

    @property
    def split(self) -> Indices:
        """Return into how many parts a cell is cut along each state, (n,): 2, or 1 where it is too narrow."""
        return np.where(self.width > self.finest, 2, 1).astype(np.intp)

    @cached_property
    def centres(self) -> Array:
        """Return the centres of the cells, (cells, n)."""
        return self.lower + (self.cells + 0.5) * self.width

    @cached_property
    def _numbers(self) -> Indices:
        """Return the number of the cell at every index, -1 where it is not looked at."""
        numbers = np.full(tuple(self.shape), -1, dtype=np.intp)
        numbers[tuple(self.cells.T)] = np.arange(len(self.cells))
        return numbers

    def indices(self, x: Array, towards: int = 0) -> Indices:
        """Return the indices of points along each state, (..., n); towards -1 or 1, those that rounding may hide."""
        width = np.where(self.width > 0, self.width, 1.0)
        share = (x - self.lower) / width + towards * ROUNDING * (1 + np.abs(x / width))
        return np.asarray(np.clip(np.floor(np.nan_to_num(share)), 0, self.shape - 1), dtype=np.intp)

    def numbers(self, indices: Indices) -> Indices:
        """Return the numbers of the cells at indices (..., n), -1 where there is none."""
        return self._numbers[tuple(np.moveaxis(indices, -1, 0))]

    def variation(self, slopes: Array) -> Array:
        """Return the largest change of slopes (..., n) from the centre of a cell, (...)."""
        return (np.abs(slopes) * self.width / 2).sum(axis=-1)

    def halved(self, kept: Mask) -> tuple[Lattice, Indices]:
        """Return some of the cells cut into halves along each state that has a width, and the cell each comes from."""
        split = self.split
        corners = index_tuples(split)
        parents = np.repeat(np.flatnonzero(kept), len(corners))
        cells = self.cells[parents] * split + np.tile(corners, (int(kept.sum()), 1))
        first = cells.min(axis=0)
        lower, width = self.lower + first * (self.width / split), self.width / split
        return Lattice(lower, width, cells.max(axis=0) - first + 1, cells - first, self.finest), parents


@dataclass(frozen=True, eq=False)
class CostToGo:
    """An affine function below the cost-to-go on every cell, or the largest of several.

    Attributes
    ----------
    values, slopes : (cells, pieces), (cells, pieces, n)
        V is the largest of values + slopes (x - centre); inf where no trajectory goes on.
    first, last : (cells, n)
        Bounds of the states of a cell from which trajectories go on.
    """

    lattice: Lattice
    values: Array
    slopes: Array
    first: Array
    last: Array

    def pieces_at(self, cell: Indices, x: Array) -> Array:
        """Return the values of all pieces at points in cells, (points, pieces)."""
        return self.values[cell] + np.einsum("psn,pn->ps", self.slopes[cell], x - self.lattice.centres[cell])

    def slopes_at(self, cell: Indices, x: Array) -> Array:
        """Return the slopes of V at points in cells, (points, n)."""
        return self.slopes[cell, self.pieces_at(cell, x).argmax(axis=1)]

    def at(self, x: Array) -> Array:
        """Return V at points, (points,); inf where no trajectory goes on."""
        lattice = self.lattice
        cell = lattice.numbers(lattice.indices(np.nan_to_num(x)))
        goes_on = (cell >= 0) & ((x >= self.first[cell]) & (x <= self.last[cell])).all(axis=1)
        goes_on &= ((x >= lattice.lower) & (x <= lattice.upper)).all(axis=1)
        return np.where(goes_on, self.pieces_at(cell, x).max(axis=1), np.inf)

    @cached_property
    def least(self) -> Array:
        """Return a lower bound of V on every cell, (cells,)."""
        return (self.values - self.lattice.variation(self.slopes)).max(axis=1)

    def most(self, cell: Indices, parts: Lattice, slopes: Array) -> Array:
        """Return an upper bound of V - slopes (x - centre) on parts of cells (parts,), (parts, pieces)."""
        apart = self.slopes[cell][:, :, None] - slopes[:, None]
        return (self.pieces_at(cell, parts.centres)[:, :, None] + parts.variation(apart)).max(axis=1)


class Minima:
    """The least of V over ranges of indices, from blocks of 2^k cells along each state."""

    def __init__(self, after: CostToGo):
        lattice = after.lattice
        table = np.full(tuple(lattice.shape), np.inf)
        table[tuple(lattice.cells.T)] = after.least
        self._tables = [table]
        while max(table.shape) > 1:
            for axis, size in enumerate(table.shape):
                table = np.minimum.reduceat(table, np.arange(0, size, 2), axis=axis)
            self._tables.append(table)
        finite = np.isfinite(after.values)
        self.steepest = np.abs(after.slopes[finite]).max(axis=0, initial=0.0)  # of V along each state
        self.spread = float(np.ptp(after.values[finite])) if finite.any() else 0.0

    def least(self, first: Indices, final: Indices) -> Array:
        """Return a lower bound of V over the indices first .. final: that of the blocks they lie in."""
        level = np.ceil(np.log2((final - first).max(axis=1) + 1)).astype(int)
        found = np.full(len(first), np.inf)
        for k in np.unique(level):
            rows = np.flatnonzero(level == k)
            ends = first[rows] >> k, final[rows] >> k
            for corner in np.ndindex(*[2] * first.shape[1]):
                at = tuple(ends[side][:, j] for j, side in enumerate(corner))
                found[rows] = np.minimum(found[rows], self._tables[k][at])
        return found
