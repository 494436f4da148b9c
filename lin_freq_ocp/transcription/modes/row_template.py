"""All rows that a family of programs may have; each member takes some of them.

Rows come in groups, one for each time and mode, all of a kind having the same size: so a member is chosen by masks and
assembled by a few vector operations. A search over modes asks for thousands of programs that differ in little.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.arrays import Array, Indices, Mask


class Sense(Enum):
    """Kinds of rows: A z = b, A z <= b, or A z - b in a second-order cone."""

    EQUATION = 0
    INEQUALITY = 1
    CONE = 2


@dataclass(frozen=True, eq=False)
class Groups:
    """The groups of one kind.

    Attributes
    ----------
    rows : (groups, size)
        Their rows in the template.
    entries : (groups, coefficients)
        Where their coefficients stand in the list of all, in the order they were given.
    """

    rows: Indices
    entries: Indices


class RowTemplate:
    """Rows of every ``Sense``, collected kind by kind."""

    def __init__(self):
        self._rows: list[Indices] = []
        self._columns: list[Indices] = []
        self._values: list[Array] = []
        self._right: list[Array] = []
        self._senses: list[Indices] = []
        self._count = self._filled = 0

    def add(self, sense: Sense, right: Array, row: Indices, column: Indices, value: Array) -> Groups:
        """Add groups of rows.

        Parameters
        ----------
        sense : Sense
        right : (groups, size)
            b.
        row : (coefficients,)
            The row of each coefficient, counted within its group.
        column, value : (groups, coefficients)
            A value of zero is left out of every member that does not replace it.
        """
        groups, size = right.shape
        rows = self._count + np.arange(groups * size).reshape(groups, size)
        entries = self._filled + np.arange(value.size).reshape(value.shape)
        self._rows.append(rows[:, row].ravel())
        self._columns.append(np.broadcast_to(column, value.shape).ravel())
        self._values.append(np.asarray(value, dtype=np.float64).ravel())
        self._right.append(np.asarray(right, dtype=np.float64).ravel())
        self._senses.append(np.full(right.size, sense.value))
        self._count += right.size
        self._filled += value.size
        return Groups(rows, entries)

    def finished(self, columns: int) -> Assembler:
        """Return what makes members of it."""
        row, column, senses = (np.concatenate(part) for part in (self._rows, self._columns, self._senses))
        return Assembler(row, column, np.concatenate(self._values), np.concatenate(self._right), senses, columns)


class Assembler:
    """A finished template."""

    def __init__(self, row: Indices, column: Indices, values: Array, right: Array, senses: Indices, columns: int):
        self.values, self.right, self.columns = values, right, columns
        self._senses = senses
        self._order = np.lexsort((row, column))
        self._row, self._column = row[self._order], column[self._order]

    def member(self, rows: Mask, columns: Mask, values: Array, right: Array) -> tuple[sp.csc_array, Array, Array]:
        """Return A, lower and upper of some rows and columns, from all coefficients in the order they were added."""
        kept = np.flatnonzero(rows)
        place = np.cumsum(rows, dtype=np.int32) - np.int32(1)
        data = values[self._order]
        keep = rows[self._row] & columns[self._column] & (data != 0)
        counts = np.bincount(self._column[keep], minlength=self.columns)[columns]
        pointers = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        A = sp.csc_array((data[keep], place[self._row[keep]], pointers), shape=(len(kept), len(counts)))
        senses, limits = self._senses[kept], right[kept]
        lower = np.where(senses == Sense.INEQUALITY.value, -np.inf, limits)
        return A, lower, np.where(senses == Sense.CONE.value, np.inf, limits)
