"""Maxima and minima of affine functions of (x, u), and the polyhedra on which they are affine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from lin_freq_ocp.arrays import Array, Mask, brief, names
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.formulas.nodes import MAXIMUM
from lin_freq_ocp.geometry.polyhedra import (
    SAME_FUNCTION,
    SMALLEST_PIECE,
    Cell,
    cell_of,
    has_interior,
    irredundant,
    natural_sizes,
)
from lin_freq_ocp.problem.dynamics.affine_mode import AffineMode
from lin_freq_ocp.problem.dynamics.expressions import Expression, affine_text
from lin_freq_ocp.problem.dynamics.labels import unique_names

MOST_PIECES = 256
"""Of the combinations of branches that are polyhedra with an interior: finding them, and checking the regions of so
many modes, takes seconds; a search over them takes longer."""


def modes_of(
    expressions: Any, state_names: Sequence[str] | None, control_names: Sequence[str] | None
) -> list[AffineMode]:
    """Return the modes of x_{t+1} = expressions, one for each state; see ``PiecewiseAffineDynamics.from_max_min``."""
    listed = list(expressions) if isinstance(expressions, (Sequence, np.ndarray)) else []
    given = [one for one in listed if isinstance(one, Expression)]
    if not given:
        raise ProblemError("expressions", brief(expressions), "a list of expressions made of lfo.affine_signals(n, m)")
    n, m = given[0].dimensions
    if len(listed) != n:
        raise ProblemError("expressions", f"{len(listed)}", f"{n}, one for each state of the signals")
    zero = given[0] * 0.0
    states = [zero + one for one in listed]
    labels = names("dynamics.state_names", state_names, n, "x") + names("dynamics.control_names", control_names, m, "u")
    pieces = _merged([_without_idle_rows(piece) for piece in _pieces(states)])
    found = unique_names([piece.name([label.split(" [")[0] for label in labels]) for piece in pieces])
    return [piece.mode(n, n + m, name) for piece, name in zip(pieces, found, strict=True)]


@dataclass(frozen=True, eq=False)
class _Piece:
    """A choice for every branching that was met, and what it comes to.

    Attributes
    ----------
    choices : mapping from a maximum or minimum to the number of the chosen argument
    values : mapping from a maximum or minimum to the affine function (n + m + 1,)
    rows : (rows, n + m + 1)
        Affine functions that are zero or below there.
    states : (n, n + m + 1)
        The map; empty until all choices are made.
    """

    choices: dict[Expression, int]
    values: dict[Expression, Array]
    rows: Array
    states: Array

    def value(self, one: Expression) -> Array:
        return one.affine + sum(factor * self.values[branching] for factor, branching in one.branchings)

    @cached_property
    def sizes(self) -> Array:
        return natural_sizes(self.rows[:, :-1], -self.rows[:, -1], np.full(self.rows.shape[1] - 1, np.inf), 0.0)

    def cell(self, sizes: Array) -> Cell | None:
        return cell_of(self.rows[:, :-1] * sizes, -self.rows[:, -1])

    @property
    def has_interior(self) -> bool:
        return has_interior(self.rows[:, :-1], -self.rows[:, -1], SMALLEST_PIECE)

    def name(self, labels: Sequence[str]) -> str:
        parts: list[str] = []
        for branching, choice in self.choices.items():
            if not branching.names:
                text = affine_text(self.values[branching], labels)
                parts.append(f"{'max' if branching.kind == MAXIMUM else 'min'} is {text}")
            else:
                parts.append(branching.names[choice])
        return ", ".join(dict.fromkeys(part for part in parts if part))

    def mode(self, n: int, signals: int, name: str) -> AffineMode:
        A, B, offset = np.split(self.states, [n, signals], axis=1)
        if not len(self.rows):
            return AffineMode(A, B, offset[:, 0], name=name)
        G, H, constant = np.split(self.rows, [n, signals], axis=1)
        return AffineMode(A, B, offset[:, 0], G, H, -constant[:, 0] + 0.0, name)


def _pieces(states: Sequence[Expression]) -> list[_Piece]:
    """Return all combinations of choices whose polyhedron has an interior."""
    length = len(states[0].affine)
    pieces = [_Piece({}, {}, np.zeros((0, length)), np.zeros((0, length)))]
    for branching in _in_order(states):
        pieces = [chosen for piece in pieces for chosen in _choices(piece, branching)]
        if len(pieces) > MOST_PIECES:
            raise ProblemError(
                "expressions",
                f"more than {MOST_PIECES} combinations of the arguments of maxima and minima",
                f"at most {MOST_PIECES}",
                "Use an expression that occurs several times as one object, and fewer maxima and minima.",
            )
    return [replace(piece, states=np.array([piece.value(state) for state in states])) for piece in pieces]


def _in_order(states: Sequence[Expression]) -> list[Expression]:
    """Return all branchings, those within others first."""
    found: dict[Expression, None] = {}

    def visit(one: Expression) -> None:
        for _, branching in one.branchings:
            if branching not in found:
                for argument in branching.arguments:
                    visit(argument)
                found[branching] = None

    for state in states:
        visit(state)
    return list(found)


def _choices(piece: _Piece, branching: Expression) -> Iterator[_Piece]:
    """Yield the piece with each argument chosen where that leaves an interior."""
    values = np.array([piece.value(argument) for argument in branching.arguments])
    for choice, value in enumerate(values):
        excess = values - value if branching.kind == MAXIMUM else value - values
        same = (np.abs(excess) <= SAME_FUNCTION * (np.abs(values) + np.abs(value))).all(axis=1)
        if same[:choice].any():
            continue  # an earlier argument, which is the same
        rows = np.where(np.abs(excess) <= SAME_FUNCTION * (np.abs(values) + np.abs(value)), 0.0, excess)[~same]
        chosen = _Piece(
            {**piece.choices, branching: choice},
            {**piece.values, branching: value},
            np.vstack([piece.rows, rows]),
            piece.states,
        )
        if chosen.has_interior:
            yield chosen


def _without_idle_rows(piece: _Piece) -> _Piece:
    """Return the piece without the rows that the others imply, nor those without coefficients, which hold."""
    rows = piece.rows[piece.rows[:, :-1].any(axis=1)]
    piece = replace(piece, rows=rows)
    cell = piece.cell(piece.sizes)
    assert cell is not None  # it has an interior
    return replace(piece, rows=rows[irredundant(cell, SMALLEST_PIECE)])


def _merged(pieces: list[_Piece]) -> list[_Piece]:
    """Return the pieces, those of the same map that make up a polyhedron together as one."""
    merged = list(pieces)
    i = 0
    while i < len(merged):
        j = next((j for j in range(i + 1, len(merged)) if _union(merged[i], merged[j]) is not None), None)
        if j is None:
            i += 1
            continue
        union = _union(merged[i], merged.pop(j))
        assert union is not None  # found above
        merged[i], i = union, 0
    return merged


def _union(one: _Piece, other: _Piece) -> _Piece | None:
    """Return the union of two pieces if they have the same map and it is a polyhedron.

    The rows of each that hold on the other, too, make up the least polyhedron around both; it is their union if no ball
    in it lies beyond a left-out row of each (Bemporad, Fukuda and Torrisi, Computational Geometry 18, 2001).
    """
    sizes = np.abs(one.states) + np.abs(other.states)
    if (np.abs(one.states - other.states) > SAME_FUNCTION * sizes).any():
        return None
    both = replace(one, rows=np.vstack([one.rows, other.rows]))
    cells = [piece.cell(both.sizes) for piece in (one, other)]
    first, second = cells
    assert first is not None and second is not None  # noqa: PT018
    if not first.apart_from(second, SMALLEST_PIECE):
        return None
    of_first, of_second = _holding(first, second), _holding(second, first)
    around = first.take(of_first) & second.take(of_second)
    for row in np.flatnonzero(~of_first):
        for other_row in np.flatnonzero(~of_second):
            beyond = around & first.beyond(int(row)) & second.beyond(int(other_row))
            if beyond.inner_point(SMALLEST_PIECE) is not None:
                return None
    choices = {key: choice for key, choice in one.choices.items() if other.choices.get(key) == choice}
    rows = np.vstack([one.rows[of_first], other.rows[of_second]])
    return _without_idle_rows(replace(one, choices=choices, rows=rows))


def _holding(cell: Cell, other: Cell) -> Mask:
    """Return which rows of a cell hold on all of another."""
    return np.array(
        [(other & cell.beyond(row)).inner_point(SMALLEST_PIECE) is None for row in range(len(cell.limits))], dtype=bool
    )
