"""The smooth pieces of formulas with maxima and minima: one for each choice of arguments that can hold."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.errors import ProblemError, UnsupportedError
from lin_freq_ocp.formulas.interval_jets import interval_jets
from lin_freq_ocp.formulas.jets import values_of
from lin_freq_ocp.formulas.nodes import (
    EXTERNAL,
    MAXIMUM,
    MINIMUM,
    PRODUCT,
    SUM,
    VARIABLE,
    Formula,
    in_order,
    kinks,
    rebuilt,
)
from lin_freq_ocp.geometry.polyhedra import SAME_FUNCTION, SMALLEST_PIECE, has_interior
from lin_freq_ocp.problem.dynamics.labels import unique_names

MOST_MODES = 64
"""Choices of the arguments of maxima and minima that are told apart."""


@dataclass(frozen=True, eq=False)
class FormulaPiece:
    """A choice of arguments, and what the formulas are where it holds.

    Attributes
    ----------
    formulas : tuple of Formula
        Without maxima and minima.
    region : tuple of Formula
        Zero or below where the choice holds.
    name : str
    """

    formulas: tuple[Formula, ...]
    region: tuple[Formula, ...]
    name: str


def formula_pieces(formulas: Sequence[Formula]) -> list[FormulaPiece]:
    """Return one piece for each choice of arguments, without those that never hold.

    Left out are choices whose affine switching functions leave no interior, or whose other ones are above zero
    everywhere, as intervals tell: pieces are closed, so that the rest covers everything. Of arguments that are the same
    function the first one is taken.

    Raises
    ------
    ProblemError
        If there are more than ``MOST_MODES``.
    """
    chosen = [_Choice({}, (), np.zeros((0, sum(formulas[0].dimensions) + 1)), ())] if formulas else []
    for branching in kinks(formulas, MAXIMUM, MINIMUM):
        chosen = [further for one in chosen for further in one.split(branching)]
        if len(chosen) > MOST_MODES:
            got = f"more than {MOST_MODES} combinations of arguments of maxima and minima that can hold"
            raise ProblemError("f", got, f"at most {MOST_MODES}")
    short, long = [one.short_name for one in chosen], [", ".join(one.labels) for one in chosen]
    names = unique_names(short if len({*short}) == len(short) else long)
    return [
        FormulaPiece(tuple(rebuilt(formulas, one.changed)), one.region, name)
        for one, name in zip(chosen, names, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class _Choice:
    """The arguments chosen so far.

    Attributes
    ----------
    changed : mapping from a maximum or minimum to the chosen argument
    region : tuple of Formula
    rows : (rows, n + m + 1)
        The switching functions that are affine: coefficients and constant.
    labels : tuple of str
    """

    changed: Mapping[Formula, Formula]
    region: tuple[Formula, ...]
    rows: Array
    labels: tuple[str, ...]

    @property
    def short_name(self) -> str:
        return ", ".join(dict.fromkeys(label for label in self.labels if label))

    def split(self, branching: Formula) -> Iterator[_Choice]:
        """Yield the choice with each argument chosen that can be."""
        arguments = rebuilt(branching.arguments, self.changed)
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
            chosen = self._with(branching, argument, differences, label)
            if chosen is not None:
                yield chosen

    def _with(
        self, branching: Formula, argument: Formula, differences: Sequence[tuple[Formula, Array | None]], label: str
    ) -> _Choice | None:
        """Return the choice with one more; None if it never holds."""
        further = [row for _, row in differences if row is not None]
        flat = [row for row in further if not row[:-1].any()]
        rows = np.array([*self.rows, *(row for row in further if row[:-1].any())]).reshape(-1, self.rows.shape[1])
        if any(row[-1] > 0 for row in flat) or not has_interior(rows[:, :-1], -rows[:, -1], SMALLEST_PIECE):
            return None
        if _above_zero([one for one, row in differences if row is None]):
            return None
        region = (*self.region, *(one for one, row in differences if row is None or row[:-1].any()))
        return _Choice({**self.changed, branching: argument}, region, rows, (*self.labels, label))


def affine_row(formula: Formula) -> Array | None:
    """Return coefficients and constant (n + m + 1,) of a formula that is affine as it stands; None of another."""
    k = sum(formula.dimensions)
    found: dict[Formula, Array | None] = {}
    for one in in_order([formula]):
        parts = [found[argument] for argument in one.arguments]
        found[one] = None
        if one.kind == VARIABLE:
            found[one] = np.eye(k + 1)[int(one.data[0])]
            continue
        rows = [part for part in parts if part is not None]
        if len(rows) < len(parts):
            continue
        if one.kind == SUM:
            found[one] = np.array(one.data[:-1]) @ np.array(rows).reshape(-1, k + 1) + one.data[-1] * np.eye(k + 1)[k]
        elif all(not row[:-1].any() for row in rows) and one.kind != EXTERNAL:
            value = float(values_of([one], np.zeros((1, k)))[0, 0])
            found[one] = value * np.eye(k + 1)[k] if np.isfinite(value) else None
        elif one.kind == PRODUCT:
            constant = next((i for i, row in enumerate(rows) if not row[:-1].any()), None)
            found[one] = None if constant is None else rows[constant][-1] * rows[1 - constant]
    return found[formula]


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
