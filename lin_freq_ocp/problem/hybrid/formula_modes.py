"""The pieces of formulas with maxima and minima: a piece for each choice of arguments that can hold.

Pieces of affine functions are the modes of piecewise-affine dynamics, on polyhedra.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask, brief
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.names import component_names
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
from lin_freq_ocp.formulas.operations import EXTERNAL, MAXIMUM, MINIMUM, OPERATIONS, TABLE, TIME
from lin_freq_ocp.formulas.text import Formulas, listed_formulas
from lin_freq_ocp.problem.dynamics.base import unique_names
from lin_freq_ocp.problem.hybrid.affine_mode import AffineMode

VARYING = (EXTERNAL, TIME, TABLE)  # operations that are no constants where their arguments are
MOST_MODES = 64  # choices of the arguments of maxima and minima


@dataclass(frozen=True, eq=False)
class FormulaPiece:
    """A choice of arguments of maxima and minima, and the formulas where it holds."""

    formulas: tuple[Formula, ...]  # without maxima and minima
    rows: Array  # (rows, n + m + 1): coefficients and constant of the affine switching functions
    region: tuple[Formula, ...] = ()  # all switching functions: the choice holds where none is above zero
    choices: Mapping[Formula, int] = field(default_factory=dict[Formula, int])  # chosen arguments by number
    arguments: Mapping[Formula, Formula] = field(default_factory=dict[Formula, Formula])  # and as formulas
    labels: tuple[str, ...] = ()  # of the chosen arguments
    name: str = ""

    def split(self, branching: Formula) -> Iterator[FormulaPiece]:
        """Yield the piece of each argument of a maximum or minimum that can be chosen in this piece."""
        arguments = rebuild(branching.arguments, self.arguments)
        affine = [affine_row(argument) for argument in arguments]
        sign = 1.0 if branching.kind == MAXIMUM else -1.0
        for choice, (chosen, chosen_row) in enumerate(zip(arguments, affine, strict=True)):
            differences = list[tuple[Formula, Array | None]]()  # switching functions, with rows of affine ones
            for i, (argument, row) in enumerate(zip(arguments, affine, strict=True)):
                difference = None
                if row is not None and chosen_row is not None:  # differences that are rounding are zero
                    difference, size = sign * (row - chosen_row), np.abs(row) + np.abs(chosen_row)
                    difference = np.where(np.abs(difference) <= SAME_FUNCTION * size, 0.0, difference)
                if argument is not chosen and (difference is None or difference.any()):
                    differences.append(((argument - chosen) * sign, difference))
                elif i < choice:  # the same function as an earlier argument, which has been chosen already
                    break
            else:
                # the choice holds where no difference is above zero: not at all, or in a smaller region
                added = [row for _, row in differences if row is not None]
                rows = np.array([*self.rows, *(row for row in added if row[:-1].any())]).reshape(-1, self.rows.shape[1])
                if any(row[-1] > 0 for row in added if not row[:-1].any()):
                    continue
                if not has_interior(rows[:, :-1], -rows[:, -1], SMALLEST_PIECE):
                    continue
                if _is_above_zero([formula for formula, row in differences if row is None]):
                    continue
                label = branching.names[choice] if branching.names else f"{'max' if sign > 0 else 'min'} {choice}"
                yield replace(
                    self,
                    region=(*self.region, *(formula for formula, row in differences if row is None or row[:-1].any())),
                    rows=rows,
                    choices={**self.choices, branching: choice},
                    arguments={**self.arguments, branching: chosen},
                    labels=(*self.labels, label),
                )


def formula_pieces(
    formulas: Sequence[Formula], most: int = MOST_MODES, region: Sequence[Formula] = ()
) -> list[FormulaPiece]:
    """Return a piece for each choice of arguments that can hold in a region, at most ``most``.

    There is no piece for a choice whose affine switching functions leave no interior, or with another switching
    function above zero everywhere by interval bounds. Pieces are closed, so that the others cover everything. Of
    arguments that are the same function, the first is chosen.
    """
    whole = tuple(formulas)
    rows = np.array([row for row in map(affine_row, region) if row is not None])
    rows = rows.reshape(-1, sum(whole[0].dimensions) + 1 if whole else 1)
    pieces = [FormulaPiece(whole, rows, tuple(region))] if whole else []
    for branching in kinks(whole, MAXIMUM, MINIMUM):
        pieces = [part for piece in pieces for part in piece.split(branching)]
        if len(pieces) > most:
            got = f"more than {most} combinations of arguments of maxima and minima that can hold"
            advice = "Use a formula that occurs several times as one object, and fewer maxima and minima."
            raise ProblemError("f", got, f"at most {most}", advice)
    short = [", ".join(dict.fromkeys(label for label in piece.labels if label)) for piece in pieces]
    long = [", ".join(piece.labels) for piece in pieces]
    names = unique_names(short if len({*short}) == len(short) else long)
    return [
        replace(piece, formulas=tuple(rebuild(whole, piece.arguments)), name=name)
        for piece, name in zip(pieces, names, strict=True)
    ]


def affine_row(formula: Formula) -> Array | None:
    """Return coefficients and constant, (n + m + 1,), of a formula of affine operations; None of another."""
    k = sum(formula.dimensions)

    def row_of(formula: Formula, parts: list[Array | None]) -> Array | None:
        rows = [part for part in parts if part is not None]
        if len(rows) < len(parts):
            return None
        row = OPERATIONS[formula.kind].affine(formula, rows)
        if row is None and formula.kind not in VARYING and not any(part[:-1].any() for part in rows):
            value = float(values_of([formula], np.zeros((1, k)))[0, 0])
            row = value * np.eye(k + 1)[k] if np.isfinite(value) else None
        return row

    return evaluate([formula], row_of)[0]


def _is_above_zero(formulas: Sequence[Formula]) -> bool:
    """Whether interval bounds prove that one of the formulas is above zero everywhere."""
    if not formulas:
        return False
    everywhere = np.full((1, sum(formulas[0].dimensions)), np.inf)
    try:
        lower = interval_jets(formulas, -everywhere, everywhere, curved=False).values[0]
    except UnsupportedError:  # a function without interval bounds
        return False
    return bool((lower > 0).any())


# Pieces with an interior: it takes seconds to find so many and to check their regions, and longer to search over them.
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
    pieces = [_affine_piece(piece, labels).irredundant() for piece in formula_pieces(formulas, MOST_PIECES)]
    # pieces of the same map whose union is a polyhedron are one mode
    i = 0
    while i < len(pieces):
        unions = ((j, _union(pieces[i], pieces[j])) for j in range(i + 1, len(pieces)))
        j, union = next(((j, union) for j, union in unions if union is not None), (i, None))
        if union is None:
            i += 1
            continue
        del pieces[j]
        pieces[i], i = union, 0
    unique = unique_names([piece.name(labels) for piece in pieces])
    return [piece.mode(n, n + m, name) for piece, name in zip(pieces, unique, strict=True)]


@dataclass(frozen=True, eq=False)
class _Piece:
    """A piece with an affine map: a choice of an argument for every maximum and minimum."""

    choices: Mapping[Formula, int]  # the number of the chosen argument of each maximum and minimum
    values: Mapping[Formula, Array]  # the chosen argument, an affine function (n + m + 1,)
    rows: Array  # (rows, n + m + 1): affine functions; the choice holds where none is above zero
    states: Array  # (n, n + m + 1): the map

    @cached_property
    def sizes(self) -> Array:
        return natural_sizes(self.rows[:, :-1], -self.rows[:, -1], np.full(self.rows.shape[1] - 1, np.inf), 0.0)

    def cell(self, sizes: Array) -> Cell:
        cell = cell_of(self.rows[:, :-1] * sizes, -self.rows[:, -1])
        assert cell is not None  # it has an interior
        return cell

    def irredundant(self) -> _Piece:
        """Return the piece without redundant rows."""
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


def _affine_piece(piece: FormulaPiece, labels: Sequence[str]) -> _Piece:
    """Return a piece with an affine map and region, or raise ProblemError."""
    fields = dict.fromkeys((*piece.formulas, *piece.region, *piece.arguments.values()), "f")
    fields |= {formula: f"f[{i}]" for i, formula in enumerate(piece.formulas)}
    rows = dict[Formula, Array]()
    for formula, name in fields.items():
        row = affine_row(formula)
        if row is None:
            expected = "affine functions of x and u, and maxima and minima of them"
            advice = "PiecewiseSmoothDynamics takes other formulas."
            raise ProblemError(name, brief(text_of(formula, labels)), expected, advice)
        rows[formula] = row
    values = {branching: rows[argument] for branching, argument in piece.arguments.items()}
    return _Piece(piece.choices, values, piece.rows, np.array([rows[formula] for formula in piece.formulas]))


def _affine_text(affine: Array, labels: Sequence[str]) -> str:
    """Return an affine function as text, shortened: "-x_0 + 2 u_0 - 1"."""
    terms = [(value, label) for value, label in zip(affine, [*labels, ""], strict=True) if value]
    text = "" if terms else "0"
    for value, label in terms:
        size = "" if label and abs(value) == 1 else f"{abs(value):.4g}"
        sign = (" - " if value < 0 else " + ") if text else ("-" if value < 0 else "")
        text += sign + " ".join(part for part in (size, label) if part)
    return text if len(text) <= LONGEST_MODE_NAME else text[: LONGEST_MODE_NAME - 3] + "..."


def _union(a: _Piece, b: _Piece) -> _Piece | None:
    """Return the union of two pieces if they have the same map and it is a polyhedron; else None.

    The rows of each piece that also hold on the other define the envelope of both. It is their union if no ball of the
    envelope lies outside a dropped row of each (Bemporad, Fukuda and Torrisi, Computational Geometry 18, 2001).
    """
    sizes = np.abs(a.states) + np.abs(b.states)
    if (np.abs(a.states - b.states) > SAME_FUNCTION * sizes).any():
        return None
    units = replace(a, rows=np.vstack([a.rows, b.rows])).sizes
    first, second = a.cell(units), b.cell(units)
    if not first.apart_from(second, SMALLEST_PIECE):
        return None
    of_first, of_second = _rows_that_hold(first, second), _rows_that_hold(second, first)
    envelope = first.take(of_first) & second.take(of_second)
    for i, j in product(np.flatnonzero(~of_first), np.flatnonzero(~of_second)):
        outside = envelope & first.beyond(int(i)) & second.beyond(int(j))
        if outside.inner_point(SMALLEST_PIECE) is not None:
            return None
    choices = {key: choice for key, choice in a.choices.items() if b.choices.get(key) == choice}
    return replace(a, choices=choices, rows=np.vstack([a.rows[of_first], b.rows[of_second]])).irredundant()


def _rows_that_hold(cell: Cell, other: Cell) -> Mask:
    """Return which rows of a cell hold on all of another."""
    return np.array(
        [(other & cell.beyond(row)).inner_point(SMALLEST_PIECE) is None for row in range(len(cell.limits))], dtype=bool
    )
