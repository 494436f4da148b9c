"""The pieces of formulas with maxima and minima: a piece for each choice of arguments that can hold."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.polyhedra import SAME_FUNCTION, SMALLEST_PIECE, has_interior
from lin_freq_ocp.formulas.jets import interval_jets, values_of
from lin_freq_ocp.formulas.nodes import Formula, evaluated, kinks, rebuilt
from lin_freq_ocp.formulas.operations import EXTERNAL, MAXIMUM, MINIMUM, OPERATIONS
from lin_freq_ocp.problem.dynamics.base import unique_names

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
        arguments = rebuilt(branching.arguments, self.arguments)
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
            chosen = self._restricted(differences)
            if chosen is not None:
                choices, taken = {**self.choices, branching: choice}, {**self.arguments, branching: argument}
                yield replace(chosen, choices=choices, arguments=taken, labels=(*self.labels, label))

    def _restricted(self, differences: Sequence[tuple[Formula, Array | None]]) -> FormulaPiece | None:
        """Return the choice where further switching functions are zero or below; None if they never are."""
        further = [row for _, row in differences if row is not None]
        flat = [row for row in further if not row[:-1].any()]
        rows = np.array([*self.rows, *(row for row in further if row[:-1].any())]).reshape(-1, self.rows.shape[1])
        if any(row[-1] > 0 for row in flat) or not has_interior(rows[:, :-1], -rows[:, -1], SMALLEST_PIECE):
            return None
        if _above_zero([one for one, row in differences if row is None]):
            return None
        region = (*self.region, *(one for one, row in differences if row is None or row[:-1].any()))
        return replace(self, region=region, rows=rows)


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
        replace(piece, formulas=tuple(rebuilt(given, piece.arguments)), name=name)
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

    return evaluated([formula], row_of)[0]


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
