"""Maxima and minima of affine functions of (x, u), and the polyhedra on which they are affine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem.affine_mode import AffineMode
from lin_freq_ocp.problem.arrays import Array, Mask, brief, names, positive_integer, real_array
from lin_freq_ocp.problem.formulas import MAXIMUM, MINIMUM, Formula, extreme
from lin_freq_ocp.problem.polyhedra import Cell, cell_of, irredundant, natural_sizes

MOST_PIECES = 256
"""Of the combinations of branches that are polyhedra with an interior: finding them, and checking the regions of so
many modes, takes seconds; a search over them takes longer."""

SMALLEST_PIECE = 1e-10
"""Radius of the largest ball of a piece, in natural units, from which it has an interior: the radius is this exact."""

SAME_FUNCTION = 16 * float(np.finfo(np.float64).eps)
"""Affine functions whose coefficients differ by less, relative to their sizes, are the same: rounding."""

LONGEST_TEXT = 40
"""Characters of an affine function in the name of a mode."""


@dataclass(frozen=True, eq=False)
class Branching:
    """The largest (or smallest) of several expressions: a place where the map branches."""

    arguments: tuple[Expression, ...]
    largest: bool
    names: tuple[str, ...] | None


class Expression:
    """An affine function of (x, u) plus multiples of maxima and minima of others; made by ``affine_signals``.

    Sums and differences of expressions, multiples and quotients by numbers, and ``maximum``, ``minimum`` and ``abs`` of
    expressions are expressions.

    Attributes
    ----------
    dimensions : (n, m)
    affine : (n + m + 1,)
        Coefficients of x and of u, and the constant.
    branchings : tuple of (float, Branching)
        What is added, each Branching once.
    """

    __array_ufunc__ = None  # numpy leaves operators to this class

    def __init__(
        self, dimensions: tuple[int, int], affine: Array, branchings: tuple[tuple[float, Branching], ...] = ()
    ):
        self.dimensions, self.affine, self.branchings = dimensions, affine, branchings

    def __add__(self, other: Any) -> Expression:
        if not isinstance(other, Expression):
            constant = np.zeros_like(self.affine)
            constant[-1] = _number("+", other)
            return Expression(self.dimensions, self.affine + constant, self.branchings)
        if other.dimensions != self.dimensions:
            raise ProblemError("expression", f"signals of {other.dimensions} and {self.dimensions}", "the same signals")
        factors: dict[Branching, float] = {}
        for factor, branching in (*self.branchings, *other.branchings):
            factors[branching] = factors.get(branching, 0.0) + factor
        return Expression(self.dimensions, self.affine + other.affine, _listed(factors))

    def __mul__(self, other: Any) -> Expression:
        if isinstance(other, Expression):
            raise ProblemError("expression", "a product of expressions", "sums and multiples by numbers")
        factor = _number("*", other)
        return Expression(
            self.dimensions, factor * self.affine, _listed({one: factor * old for old, one in self.branchings})
        )

    def __truediv__(self, other: Any) -> Expression:
        if isinstance(other, Expression) or not _number("/", other):
            raise ProblemError("expression", f"a quotient by {brief(other)}", "a number other than zero")
        return self * (1 / _number("/", other))

    def __neg__(self) -> Expression:
        return self * -1.0

    def __sub__(self, other: Any) -> Expression:
        return self + (other * -1.0 if isinstance(other, Expression) else -_number("-", other))

    def __rsub__(self, other: Any) -> Expression:
        return -self + other

    def __abs__(self) -> Expression:
        return maximum(self, -self)

    def _compare(self, other: Any) -> bool:
        advice = "Python's max and min, and comparisons, decide here and now."
        raise ProblemError("expression", f"a comparison with {brief(other)}", "lfo.maximum or lfo.minimum", advice)

    __radd__, __rmul__ = __add__, __mul__
    __lt__ = __le__ = __gt__ = __ge__ = _compare

    def __repr__(self) -> str:
        n, m = self.dimensions
        text = _text(self.affine, [*(f"x_{i}" for i in range(n)), *(f"u_{i}" for i in range(m))])
        return f"Expression({text}" + (f", and {len(self.branchings)} maxima or minima)" if self.branchings else ")")


def affine_signals(states: int, controls: int) -> tuple[NDArray[np.object_], NDArray[np.object_]]:
    """Return the components of x and of u as expressions, arrays (n,) and (m,), so that ``A @ x + B @ u`` is one, too.

    Parameters
    ----------
    states, controls : int
        n and m.

    Raises
    ------
    ProblemError
        If they are no whole numbers from 1.
    """
    n, m = positive_integer("states", states), positive_integer("controls", controls)
    signals = np.empty(n + m, dtype=object)
    signals[:] = [Expression((n, m), row) for row in np.eye(n + m, n + m + 1)]
    return signals[:n], signals[n:]


@overload
def maximum(first: Expression, /, *others: Expression | float, names: Sequence[str] | None = None) -> Expression: ...


@overload
def maximum(first: Formula, /, *others: Formula | float, names: Sequence[str] | None = None) -> Formula: ...


@overload
def maximum(first: float, /, *others: Any, names: Sequence[str] | None = None) -> Any: ...


def maximum(*arguments: Any, names: Sequence[str] | None = None) -> Any:
    """Return the largest of several expressions and numbers.

    Parameters
    ----------
    arguments : Expression, Formula or float
        Affine expressions of ``affine_signals``, or formulas of ``signals``; at least one is no number.
    names : sequence of str, optional
        What to call the modes in which each argument is the largest; "" adds nothing to a name.

    Raises
    ------
    ProblemError
        If there is no expression, or not one name each.
    """
    if any(isinstance(one, Formula) for one in arguments):
        return extreme(MAXIMUM, arguments, names)
    return _branching("maximum", arguments, names)


@overload
def minimum(first: Expression, /, *others: Expression | float, names: Sequence[str] | None = None) -> Expression: ...


@overload
def minimum(first: Formula, /, *others: Formula | float, names: Sequence[str] | None = None) -> Formula: ...


@overload
def minimum(first: float, /, *others: Any, names: Sequence[str] | None = None) -> Any: ...


def minimum(*arguments: Any, names: Sequence[str] | None = None) -> Any:
    """Return the smallest of several expressions and numbers; parameters and errors as for ``maximum``."""
    if any(isinstance(one, Formula) for one in arguments):
        return extreme(MINIMUM, arguments, names)
    return _branching("minimum", arguments, names)


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
    found = _unique([piece.name([label.split(" [")[0] for label in labels]) for piece in pieces])
    return [piece.mode(n, n + m, name) for piece, name in zip(pieces, found, strict=True)]


@dataclass(frozen=True, eq=False)
class _Piece:
    """A choice for every branching that was met, and what it comes to.

    Attributes
    ----------
    choices : mapping from Branching to the number of the chosen argument
    values : mapping from Branching to the affine function (n + m + 1,)
    rows : (rows, n + m + 1)
        Affine functions that are zero or below there.
    states : (n, n + m + 1)
        The map; empty until all choices are made.
    """

    choices: dict[Branching, int]
    values: dict[Branching, Array]
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
        cell = self.cell(self.sizes)
        return cell is not None and cell.inner_point(SMALLEST_PIECE) is not None

    def name(self, labels: Sequence[str]) -> str:
        parts: list[str] = []
        for branching, choice in self.choices.items():
            if branching.names is None:
                text = _text(self.values[branching], labels)
                parts.append(f"{'max' if branching.largest else 'min'} is {text}")
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


def _in_order(states: Sequence[Expression]) -> list[Branching]:
    """Return all branchings, those within others first."""
    found: dict[Branching, None] = {}

    def visit(one: Expression) -> None:
        for _, branching in one.branchings:
            if branching not in found:
                for argument in branching.arguments:
                    visit(argument)
                found[branching] = None

    for state in states:
        visit(state)
    return list(found)


def _choices(piece: _Piece, branching: Branching) -> Iterator[_Piece]:
    """Yield the piece with each argument chosen where that leaves an interior."""
    values = np.array([piece.value(argument) for argument in branching.arguments])
    for choice, value in enumerate(values):
        excess = values - value if branching.largest else value - values
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


def _branching(kind: str, arguments: Sequence[Any], given: Sequence[str] | None) -> Expression:
    expressions = [one for one in arguments if isinstance(one, Expression)]
    if len(arguments) < 2 or not expressions:
        raise ProblemError(kind, brief(arguments), "two arguments or more, at least one of them an expression")
    zero = expressions[0] * 0.0
    listed = [zero + one for one in arguments]
    if given is not None:
        wrong = isinstance(given, str) or not all(
            isinstance(name, str) and (name.strip() or not name) and name.isprintable() for name in given
        )
        if wrong or len(given) != len(listed):
            raise ProblemError(f"{kind}.names", brief(given), f"{len(listed)} names, one for each argument")
    branching = Branching(tuple(listed), kind == "maximum", None if given is None else tuple(given))
    return Expression(zero.dimensions, zero.affine, ((1.0, branching),))


def _listed(factors: dict[Branching, float]) -> tuple[tuple[float, Branching], ...]:
    return tuple((factor, branching) for branching, factor in factors.items() if factor)


def _number(operator: str, value: Any) -> float:
    if isinstance(value, (bool, np.bool_)) or np.ndim(value):
        raise ProblemError("expression", f"{operator} {brief(value)}", "a number or an expression")
    return float(real_array("expression", value))


def _text(affine: Array, labels: Sequence[str]) -> str:
    """Return an affine function in words, shortened: "-x_0 + 2 u_0 - 1"."""
    terms = [(value, label) for value, label in zip(affine, [*labels, ""], strict=True) if value]
    text = "" if terms else "0"
    for value, label in terms:
        size = "" if label and abs(value) == 1 else f"{abs(value):.4g}"
        sign = (" - " if value < 0 else " + ") if text else ("-" if value < 0 else "")
        text += sign + " ".join(part for part in (size, label) if part)
    return text if len(text) <= LONGEST_TEXT else text[: LONGEST_TEXT - 3] + "..."


def _unique(texts: Sequence[str]) -> list[str]:
    """Return the names, those that stand several times with a number."""
    seen: dict[str, int] = {}
    for text in texts:
        seen[text] = seen.get(text, 0) + 1
    count: dict[str, int] = {}
    unique: list[str] = []
    for text in texts:
        count[text] = count.get(text, 0) + 1
        unique.append(text if seen[text] == 1 or not text else f"{text} ({count[text]})")
    return unique
