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
    """The groups of one kind: their rows in the template, (groups, size), and the positions of their coefficients."""

    rows: Indices
    entries: Indices

    def take(self, rows: Mask, chosen: Mask, within: Mask | None = None) -> None:
        """Set ``rows`` in the ``chosen`` groups (any shape of as many), of their rows only those ``within``."""
        mask = np.broadcast_to(chosen.reshape(-1, 1), self.rows.shape)
        if within is not None:
            mask = mask & within.reshape(self.rows.shape)
        rows[self.rows[mask]] = True


class RowTemplate:
    """Rows of every ``Sense``, collected kind by kind."""

    def __init__(self):
        self._rows: list[Indices] = []
        self._columns: list[Indices] = []
        self._values: list[Array] = []
        self._right: list[Array] = []
        self._senses: list[Indices] = []
        self._count = self._filled = 0

    def add(self, sense: Sense, right: Array, *entries: tuple[Indices, Indices, Array | float]) -> Groups:
        """Add groups of rows with right-hand sides b (..., size).

        Entries are the rows of coefficients within a group, (c,), their columns (..., c) and values. A value of zero is
        left out of members that do not replace it.
        """
        size = right.shape[-1]
        groups = int(np.prod(right.shape[:-1]))
        row = np.concatenate([part[0] for part in entries])
        column = np.concatenate([part[1] for part in entries], axis=-1).reshape(groups, -1)
        values = [np.broadcast_to(value, columns.shape) for _, columns, value in entries]
        value = np.concatenate(values, axis=-1).reshape(groups, -1)
        rows = self._count + np.arange(groups * size).reshape(groups, size)
        positions = self._filled + np.arange(value.size).reshape(value.shape)
        self._rows.append(rows[:, row].ravel())
        self._columns.append(column.ravel())
        self._values.append(value.ravel())
        self._right.append(right.ravel())
        self._senses.append(np.full(right.size, sense.value))
        self._count += right.size
        self._filled += value.size
        return Groups(rows, positions)

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
        numbers = np.cumsum(rows, dtype=np.int32) - np.int32(1)
        data = values[self._order]
        keep = rows[self._row] & columns[self._column] & (data != 0)
        counts = np.bincount(self._column[keep], minlength=self.columns)[columns]
        pointers = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        A = sp.csc_array((data[keep], numbers[self._row[keep]], pointers), shape=(len(kept), len(counts)))
        senses, limits = self._senses[kept], right[kept]
        lower = np.where(senses == Sense.INEQUALITY.value, -np.inf, limits)
        return A, lower, np.where(senses == Sense.CONE.value, np.inf, limits)
