"""All rows that a family of programs may have; each member takes some of them.

Rows come in groups, one for each time and mode, all of a kind having the same size: so a member is chosen by masks and
assembled by a few vector operations. A search over modes asks for thousands of programs that differ in little.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.arrays import Array, Indices, Mask


class Sense(Enum):
    """Kinds of rows, in the order of the standard form."""

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
    """Rows sum_j A_ij z_j = b_i, or <= b_i, or b - A z in a cone; collected kind by kind."""

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


@dataclass(frozen=True, eq=False)
class Assembled:
    """The matrix and right-hand side of a member, and which rows of the template it has, in its order."""

    A: sp.csc_matrix
    b: Array
    rows: Indices
    senses: Mapping[Sense, int]


class Assembler:
    """A finished template."""

    def __init__(self, row: Indices, column: Indices, values: Array, right: Array, senses: Indices, columns: int):
        self.values, self.right, self.columns = values, right, columns
        self._senses = senses
        self._row_order = np.argsort(senses, kind="stable")
        rank = np.empty(len(senses), dtype=np.intp)
        rank[self._row_order] = np.arange(len(senses))
        self._order = np.lexsort((rank[row], column))
        self._row, self._column = row[self._order], column[self._order]

    def member(self, rows: Mask, columns: Mask, values: Array, right: Array) -> Assembled:
        """Return the member with some rows and columns, of all coefficients in the order they were added."""
        kept = self._row_order[rows[self._row_order]]
        place = np.empty(len(rows), dtype=np.int32)
        place[kept] = np.arange(len(kept), dtype=np.int32)
        data = values[self._order]
        keep = rows[self._row] & columns[self._column] & (data != 0)
        counts = np.bincount(self._column[keep], minlength=self.columns)[columns]
        pointers = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        A = sp.csc_matrix((data[keep], place[self._row[keep]], pointers), shape=(len(kept), len(counts)))
        found = np.bincount(self._senses[kept], minlength=len(Sense))
        return Assembled(A, right[kept], kept, {sense: int(found[sense.value]) for sense in Sense})
