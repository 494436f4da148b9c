"""All rows that a family of programs may have; each member takes some of them.

Rows come in groups, one for each time and mode, all of a kind having the same size: so a member is chosen by masks and
assembled by a few vector operations. A search over modes asks for thousands of programs that differ in little.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TypeVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from lin_freq_ocp.base.arrays import Array, Indices, Mask

Scalar = TypeVar("Scalar", bound=np.generic)


class Sense(Enum):
    """Kinds of rows: A z = b, A z <= b, or A z - b in a second-order cone."""

    EQUATION = 0
    INEQUALITY = 1
    CONE = 2


@dataclass(frozen=True, eq=False)
class Groups:
    """The groups of one kind: ``rows`` (groups, size) of the template, all in turn, and so their ``entries``."""

    rows: Indices
    entries: Indices

    def take(self, rows: Mask, chosen: Mask, within: Mask | None = None) -> None:
        """Choose ``rows`` in the ``chosen`` groups (any shape of as many), of their rows only those ``within``."""
        own = self.of(rows)
        own[:] = chosen.reshape(-1, 1)
        if within is not None:
            own &= within.reshape(own.shape)

    def of(self, rows: NDArray[Scalar]) -> NDArray[Scalar]:
        """Return what belongs to these groups, (groups, size), as a view."""
        return _view(rows, self.rows)

    def coefficients(self, values: Array) -> Array:
        """Return the coefficients of these groups, (groups, entries), as a view."""
        return _view(values, self.entries)


def _view(whole: NDArray[Scalar], places: Indices) -> NDArray[Scalar]:
    first = int(places[0, 0]) if places.size else 0
    return whole[first : first + places.size].reshape(places.shape)


@dataclass(frozen=True, eq=False)
class StandardRows:
    """The rows of a standard form (``transcription.program``), from ``row`` of the template with these signs."""

    A: sp.csc_array
    b: Array
    equations: int
    inequalities: int
    row: Indices
    sign: Array


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
    """A finished template, which keeps its entries in the order of standard forms."""

    def __init__(self, row: Indices, column: Indices, values: Array, right: Array, senses: Indices, columns: int):
        self.values, self.right, self.columns = values, right, columns
        self._rows = np.argsort(senses, kind="stable")  # equations, inequalities, cones
        self._ends = np.searchsorted(senses[self._rows], [Sense.INEQUALITY.value, Sense.CONE.value])
        place = np.argsort(self._rows)[row]
        self._order = np.lexsort((place, column))
        self._place, self._column = place[self._order], column[self._order]
        self._row_sign = np.where(senses[self._rows] == Sense.CONE.value, -1.0, 1.0)
        self._sign = self._row_sign[self._place]

    def member(self, rows: Mask, columns: Mask, values: Array, right: Array) -> StandardRows:
        """Return the standard form of some rows and columns, from all coefficients in the order they were added."""
        taken = rows[self._rows]
        kept = np.flatnonzero(taken)
        numbers = np.cumsum(taken, dtype=np.int32) - np.int32(1)
        data = values[self._order]
        keep = np.flatnonzero(taken[self._place] & columns[self._column] & (data != 0))
        counts = np.bincount(self._column[keep], minlength=self.columns)[columns]
        pointers = np.append(np.int32(0), np.cumsum(counts, dtype=np.int32))
        A = sp.csc_array(
            (data[keep] * self._sign[keep], numbers[self._place[keep]], pointers), shape=(len(kept), len(counts))
        )
        row, sign = self._rows[kept], self._row_sign[kept]
        equations, unequal = (int(end) for end in np.searchsorted(kept, self._ends))
        return StandardRows(A, sign * right[row], equations, unequal - equations, row, sign)
