"""Maxima and minima of affine functions of (x, u), and the polyhedra on which they are affine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask, brief, names
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.polyhedra import SAME_FUNCTION, SMALLEST_PIECE, Cell, cell_of, irredundant, natural_sizes
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.formulas.operations import MAXIMUM
from lin_freq_ocp.formulas.text import Formulas, listed_formulas, text_of
from lin_freq_ocp.problem.dynamics.base import unique_names
from lin_freq_ocp.problem.hybrid.affine_mode import AffineMode
from lin_freq_ocp.problem.hybrid.formula_modes import FormulaPiece, affine_row, formula_pieces

# Polyhedra with an interior: finding them, and checking the regions of so many modes, takes seconds; a search over
# them takes longer.
MOST_PIECES = 256
LONGEST_TEXT = 40  # characters of an affine function in the name of a mode


def modes_of(
    f: Formulas, dimensions: tuple[int, int], state_names: Sequence[str] | None, control_names: Sequence[str] | None
) -> list[AffineMode]:
    """Return the modes of x_{t+1} = f(x_t, u_t); see ``PiecewiseAffineDynamics.from_formulas``."""
    n, m = dimensions
    formulas = listed_formulas("f", f, dimensions)
    if len(formulas) != n:
        raise ProblemError("f", f"{len(formulas)} formulas", f"{n}, one for each state")
    labels = names("dynamics.state_names", state_names, n, "x") + names("dynamics.control_names", control_names, m, "u")
    labels = [label.split(" [")[0] for label in labels]
    pieces = [_affine(piece, labels) for piece in formula_pieces(formulas, MOST_PIECES)]
    pieces = _merged([piece.irredundant() for piece in pieces])
    unique = unique_names([piece.name(labels) for piece in pieces])
    return [piece.mode(n, n + m, name) for piece, name in zip(pieces, unique, strict=True)]


@dataclass(frozen=True, eq=False)
class _Piece:
    """A choice of an argument for every maximum and minimum."""

    choices: Mapping[Formula, int]  # from a maximum or minimum to the number of the chosen argument
    values: Mapping[Formula, Array]  # to the chosen argument, an affine function (n + m + 1,)
    rows: Array  # (rows, n + m + 1): affine functions that are zero or below where the choice holds
    states: Array  # (n, n + m + 1): the map

    @cached_property
    def sizes(self) -> Array:
        return natural_sizes(self.rows[:, :-1], -self.rows[:, -1], np.full(self.rows.shape[1] - 1, np.inf), 0.0)

    def cell(self, sizes: Array) -> Cell:
        cell = cell_of(self.rows[:, :-1] * sizes, -self.rows[:, -1])
        assert cell is not None  # it has an interior
        return cell

    def irredundant(self) -> _Piece:
        """Return the piece without the rows that the others imply."""
        return replace(self, rows=self.rows[irredundant(self.cell(self.sizes), SMALLEST_PIECE)])

    def name(self, labels: Sequence[str]) -> str:
        parts: list[str] = []
        for branching, choice in self.choices.items():
            if branching.names:
                parts.append(branching.names[choice])
            else:
                text = _affine_text(self.values[branching], labels)
                parts.append(f"{'max' if branching.kind == MAXIMUM else 'min'} is {text}")
        return ", ".join(dict.fromkeys(part for part in parts if part))

    def mode(self, n: int, signals: int, name: str) -> AffineMode:
        A, B, offset = np.split(self.states, [n, signals], axis=1)
        if not len(self.rows):
            return AffineMode(A, B, offset[:, 0], name=name)
        G, H, constant = np.split(self.rows, [n, signals], axis=1)
        return AffineMode(A, B, offset[:, 0], G, H, -constant[:, 0] + 0.0, name)


def _affine(piece: FormulaPiece, labels: Sequence[str]) -> _Piece:
    """Return a piece whose map and region are affine."""
    others = dict.fromkeys((*piece.region, *piece.arguments.values()), "f")
    fields = {one: f"f[{i}]" for i, one in enumerate(piece.formulas)}
    fields = fields | {one: field for one, field in others.items() if one not in fields}
    found = {one: affine_row(one) for one in fields}
    for one, row in found.items():
        if row is None:
            expected = "affine functions of x and u, and maxima and minima of them"
            advice = "PiecewiseSmoothDynamics takes other formulas."
            raise ProblemError(fields[one], brief(text_of(one, labels)), expected, advice)
    rows = {one: row for one, row in found.items() if row is not None}
    values = {branching: rows[argument] for branching, argument in piece.arguments.items()}
    return _Piece(piece.choices, values, piece.rows, np.array([rows[one] for one in piece.formulas]))


def _affine_text(affine: Array, labels: Sequence[str]) -> str:
    """Return an affine function as text, shortened: "-x_0 + 2 u_0 - 1"."""
    terms = [(value, label) for value, label in zip(affine, [*labels, ""], strict=True) if value]
    text = "" if terms else "0"
    for value, label in terms:
        size = "" if label and abs(value) == 1 else f"{abs(value):.4g}"
        sign = (" - " if value < 0 else " + ") if text else ("-" if value < 0 else "")
        text += sign + " ".join(part for part in (size, label) if part)
    return text if len(text) <= LONGEST_TEXT else text[: LONGEST_TEXT - 3] + "..."


def _merged(pieces: list[_Piece]) -> list[_Piece]:
    """Return the pieces, with those of the same map whose union is a polyhedron joined."""
    merged = list(pieces)
    i = 0
    while i < len(merged):
        unions = ((j, _union(merged[i], merged[j])) for j in range(i + 1, len(merged)))
        j, union = next(((j, union) for j, union in unions if union is not None), (i, None))
        if union is None:
            i += 1
            continue
        del merged[j]
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
    units = replace(one, rows=np.vstack([one.rows, other.rows])).sizes
    first, second = one.cell(units), other.cell(units)
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
    return replace(one, choices=choices, rows=rows).irredundant()


def _holding(cell: Cell, other: Cell) -> Mask:
    """Return which rows of a cell hold on all of another."""
    return np.array(
        [(other & cell.beyond(row)).inner_point(SMALLEST_PIECE) is None for row in range(len(cell.limits))], dtype=bool
    )
