"""Cells of states with affine functions below the cost to go, and the least of them over ranges of cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.problem.arrays import Array, Indices

ROUNDING = 64 * float(np.finfo(np.float64).eps)
"""Of the sum of absolute terms that a bound is made of, what is subtracted from it; boxes are wider by this part."""


@dataclass(frozen=True, eq=False)
class Grid:
    """The cells of the states at one time, and an affine function on each.

    Attributes
    ----------
    lower, width : (n,)
        Of all cells together, and of one; width 0 where the state is fixed.
    shape : (n,) integers
    values, slopes : (cells, pieces), (cells, pieces, n)
        V is the largest of values + slopes (x - centre).
    first, last : (cells, n)
        Bounds of the states of a cell from which trajectories go on.
    """

    lower: Array
    width: Array
    shape: Indices
    values: Array
    slopes: Array
    first: Array
    last: Array

    @property
    def centres(self) -> Array:
        """Return the centres of all cells, (cells, n)."""
        places = np.stack(np.unravel_index(np.arange(int(self.shape.prod())), tuple(self.shape)), axis=1)
        return self.lower + (places + 0.5) * self.width

    def piece_at(self, cell: Indices, x: Array) -> Array:
        """Return the slopes of V at points in cells, (points, n)."""
        value = self.values[cell] + np.einsum("psn,pn->ps", self.slopes[cell], x - self.centres[cell])
        return self.slopes[cell, value.argmax(axis=1)]

    @property
    def least(self) -> Array:
        """Return a lower bound of V on every cell, (cells,)."""
        return (self.values - (np.abs(self.slopes) * self.width / 2).sum(axis=2)).max(axis=1)

    def places(self, x: Array, towards: int = 0) -> Indices:
        """Return the cells of points along each state, (..., n); towards -1 or 1, those that rounding may hide, too."""
        width = np.where(self.width > 0, self.width, 1.0)
        share = (x - self.lower) / width + towards * ROUNDING * (1 + np.abs(x / width))
        return np.clip(np.floor(np.nan_to_num(share)), 0, self.shape - 1).astype(np.intp)

    def flat(self, places: Indices) -> Indices:
        """Return numbers of cells from their places along each state."""
        return np.asarray(np.ravel_multi_index(tuple(np.moveaxis(places, -1, 0)), tuple(self.shape)), dtype=np.intp)


class RangeMinima:
    """The least of V over ranges of cells, by doubling."""

    def __init__(self, grid: Grid):
        least = grid.least
        self._tables: dict[tuple[int, ...], Array] = {}
        self._shape = tuple(int(size) for size in grid.shape)
        finite = np.isfinite(grid.values)
        self.steepest = float(np.abs(grid.slopes[finite]).max(initial=0.0))
        levels = [max(1, int(np.log2(size)) + 1) for size in self._shape]
        for level in np.ndindex(*levels):
            table = least.reshape(self._shape)
            for axis, doubled in enumerate(level):
                for k in range(doubled):
                    table = np.minimum(table, _shifted(table, axis, 2**k))
            self._tables[level] = table

    def least(self, first: Indices, final: Indices) -> Array:
        """Return the least of V over the cells first .. final along each state."""
        levels = np.log2(final - first + 1).astype(int)
        found = np.full(len(first), np.inf)
        for level, table in self._tables.items():
            rows = np.flatnonzero((levels == level).all(axis=1))
            for corner in np.ndindex(*[2] * first.shape[1]):
                at = [
                    first[rows, j] if not side else final[rows, j] - 2 ** level[j] + 1 for j, side in enumerate(corner)
                ]
                found[rows] = np.minimum(found[rows], table[tuple(at)])
        return found


def _shifted(table: Array, axis: int, by: int) -> Array:
    """Return the table moved so that an entry is that of ``by`` cells later; inf where there is none."""
    moved = np.full_like(table, np.inf)
    size = table.shape[axis]
    if by < size:
        source = [slice(None)] * table.ndim
        place = [slice(None)] * table.ndim
        source[axis], place[axis] = slice(by, size), slice(0, size - by)
        moved[tuple(place)] = table[tuple(source)]
    return moved
