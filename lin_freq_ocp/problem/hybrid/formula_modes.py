"""The pieces of formulas with maxima and minima, and the polyhedra on which maxima of affine functions are affine.

A formula has a piece for each choice of arguments that can hold.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask, brief, component_names
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.polyhedra import (
    SAME_FUNCTION,
    SMALLEST_PIECE,
    Cell,
    cell_of,
    has_interior,
    irredundant,
    natural_sizes,
)
from lin_freq_ocp.formulas.jets import interval_jets, values_of
from lin_freq_ocp.formulas.nodes import Formula, evaluate, kinks, rebuild, text_of
from lin_freq_ocp.formulas.operations import EXTERNAL, MAXIMUM, MINIMUM, OPERATIONS
from lin_freq_ocp.formulas.text import Formulas, listed_formulas
from lin_freq_ocp.problem.dynamics.base import unique_names
from lin_freq_ocp.problem.hybrid.affine_mode import AffineMode

MOST_MODES = 64  # choices of the arguments of maxima and minima


@dataclass(frozen=True, eq=False)
class FormulaPiece:
    """A choice of arguments, and the formulas where it holds."""

    formulas: tuple[Formula, ...]  # without maxima and minima
    rows: Array  # (rows, n + m + 1): coefficients and constant of the affine switching functions of the region
    region: tuple[Formula, ...] = ()  # all switching functions: the choice holds where they are zero or below
    choices: Mapping[Formula, int] = field(default_factory=dict[Formula, int])  # from a maximum or minimum, by number
    arguments: Mapping[Formula, Formula] = field(default_factory=dict[Formula, Formula])  # the same, by formula
    labels: tuple[str, ...] = ()  # of the chosen arguments
    name: str = ""

    def split(self, branching: Formula) -> Iterator[FormulaPiece]:
        """Yield the choice with each argument chosen that can be."""
        arguments = rebuild(branching.arguments, self.arguments)
        affine = [affine_row(one) for one in arguments]
        sign = 1.0 if branching.kind == MAXIMUM else -1.0
        for choice, argument in enumerate(arguments):
            same = [_same((one, row), (argument, affine[choice])) for one, row in zip(arguments, affine, strict=True)]
            if any(same[:choice]):
                continue
            differences = [
                ((one - argument) * sign, _difference(row, affine[choice], sign))
                for one, row, equal in zip(arguments, affine, same, strict=True)
                if not equal
            ]
            label = branching.names[choice] if branching.names else f"{'max' if sign > 0 else 'min'} {choice}"
            # the choice holds where the differences are zero or below: not at all, or in a smaller region
            further = [row for _, row in differences if row is not None]
            flat = [row for row in further if not row[:-1].any()]
            rows = np.array([*self.rows, *(row for row in further if row[:-1].any())]).reshape(-1, self.rows.shape[1])
            if any(row[-1] > 0 for row in flat) or not has_interior(rows[:, :-1], -rows[:, -1], SMALLEST_PIECE):
                continue
            if _above_zero([one for one, row in differences if row is None]):
                continue
            region = (*self.region, *(one for one, row in differences if row is None or row[:-1].any()))
            choices, taken = {**self.choices, branching: choice}, {**self.arguments, branching: argument}
            labels = (*self.labels, label)
            yield replace(self, region=region, rows=rows, choices=choices, arguments=taken, labels=labels)


def formula_pieces(formulas: Sequence[Formula], most: int = MOST_MODES) -> list[FormulaPiece]:
    """Return a piece for each choice of arguments that can hold, at most ``most``.

    Left out are choices whose affine switching functions leave no interior, or whose other switching functions are
    above zero everywhere by interval bounds: pieces are closed, so that the rest covers everything. Of arguments that
    are the same function the first is taken.
    """
    given = tuple(formulas)
    pieces = [FormulaPiece(given, np.zeros((0, sum(given[0].dimensions) + 1)))] if given else []
    for branching in kinks(given, MAXIMUM, MINIMUM):
        pieces = [further for piece in pieces for further in piece.split(branching)]
        if len(pieces) > most:
            got = f"more than {most} combinations of arguments of maxima and minima that can hold"
            advice = "Use a formula that occurs several times as one object, and fewer maxima and minima."
            raise ProblemError("f", got, f"at most {most}", advice)
    short = [", ".join(dict.fromkeys(label for label in piece.labels if label)) for piece in pieces]
    long = [", ".join(piece.labels) for piece in pieces]
    names = unique_names(short if len({*short}) == len(short) else long)
    return [
        replace(piece, formulas=tuple(rebuild(given, piece.arguments)), name=name)
        for piece, name in zip(pieces, names, strict=True)
    ]


def affine_row(formula: Formula) -> Array | None:
    """Return coefficients and constant (n + m + 1,) of a formula that is affine as it stands; None of another."""
    k = sum(formula.dimensions)

    def row_of(one: Formula, parts: list[Array | None]) -> Array | None:
        rows = [part for part in parts if part is not None]
        if len(rows) < len(parts):
            return None
        row = OPERATIONS[one.kind].affine(one, rows)
        if row is None and one.kind != EXTERNAL and not any(part[:-1].any() for part in rows):
            value = float(values_of([one], np.zeros((1, k)))[0, 0])
            row = value * np.eye(k + 1)[k] if np.isfinite(value) else None
        return row

    return evaluate([formula], row_of)[0]


def _same(one: tuple[Formula, Array | None], other: tuple[Formula, Array | None]) -> bool:
    """Whether two formulas are one function, as far as can be seen."""
    if one[0] is other[0] or one[1] is None or other[1] is None:
        return one[0] is other[0]
    return bool((np.abs(one[1] - other[1]) <= SAME_FUNCTION * (np.abs(one[1]) + np.abs(other[1]))).all())


def _difference(row: Array | None, chosen: Array | None, sign: float) -> Array | None:
    """Return the affine switching function of another argument, differences that are rounding taken for zero."""
    if row is None or chosen is None:
        return None
    difference = sign * (row - chosen)
    return np.where(np.abs(difference) <= SAME_FUNCTION * (np.abs(row) + np.abs(chosen)), 0.0, difference)


def _above_zero(formulas: Sequence[Formula]) -> bool:
    """Whether one of the formulas is above zero everywhere."""
    if not formulas:
        return False
    everywhere = np.full((1, sum(formulas[0].dimensions)), np.inf)
    try:
        lower = interval_jets(formulas, -everywhere, everywhere, curved=False).values[0]
    except UnsupportedError:  # a function of which nothing is known over boxes
        return False
    return bool((lower > 0).any())


# Polyhedra with an interior: finding them, and checking the regions of so many modes, takes seconds; a search over
# them takes longer.
MOST_PIECES = 256
LONGEST_MODE_NAME = 40  # characters of an affine function in the name of a mode


def modes_of(
    f: Formulas, dimensions: tuple[int, int], state_names: Sequence[str] | None, control_names: Sequence[str] | None
) -> list[AffineMode]:
    """Return the modes of x_{t+1} = f(x_t, u_t); see ``PiecewiseAffineDynamics.from_formulas``."""
    n, m = dimensions
    formulas = listed_formulas("f", f, dimensions)
    if len(formulas) != n:
        raise ProblemError("f", f"{len(formulas)} formulas", f"{n}, one for each state")
    states = component_names("dynamics.state_names", state_names, n, "x")
    controls = component_names("dynamics.control_names", control_names, m, "u")
    labels = [label.split(" [")[0] for label in states + controls]
    pieces = [_affine(piece, labels) for piece in formula_pieces(formulas, MOST_PIECES)]
    pieces = _merge_pieces([piece.irredundant() for piece in pieces])
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
    return text if len(text) <= LONGEST_MODE_NAME else text[: LONGEST_MODE_NAME - 3] + "..."


def _merge_pieces(pieces: list[_Piece]) -> list[_Piece]:
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
    of_first, of_second = _rows_that_hold(first, second), _rows_that_hold(second, first)
    around = first.take(of_first) & second.take(of_second)
    for row in np.flatnonzero(~of_first):
        for other_row in np.flatnonzero(~of_second):
            beyond = around & first.beyond(int(row)) & second.beyond(int(other_row))
            if beyond.inner_point(SMALLEST_PIECE) is not None:
                return None
    choices = {key: choice for key, choice in one.choices.items() if other.choices.get(key) == choice}
    rows = np.vstack([one.rows[of_first], other.rows[of_second]])
    return replace(one, choices=choices, rows=rows).irredundant()


def _rows_that_hold(cell: Cell, other: Cell) -> Mask:
    """Return which rows of a cell hold on all of another."""
    return np.array(
        [(other & cell.beyond(row)).inner_point(SMALLEST_PIECE) is None for row in range(len(cell.limits))], dtype=bool
    )
