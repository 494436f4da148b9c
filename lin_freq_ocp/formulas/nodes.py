"""Formulas of states and controls: a graph of operations, written with operators.

``signals(n, m)`` makes the components of x and u. Sums, products, quotients, whole powers, ``abs``, ``maximum``,
``minimum``, ``norm``, and NumPy's elementary functions (``exp``, ``tan``, ``arctan2`` ...) of formulas are formulas. A
Python function of (x, u) that is made of these can be traced: it is called once, with signals.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lin_freq_ocp.base.arrays import Array, brief, positive_integer, real_array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.formulas import operations
from lin_freq_ocp.formulas.operations import Node, Notation

LARGEST_POWER = 16  # a larger exponent is usually an error; a product of powers allows it
LONGEST_SHOWN = 300  # characters of a part of a formula in texts for people; a longer one is cut to three dots
# Advice for a Python function that cannot be traced
FUNCTIONS = "lfo.DifferentiableFunction takes functions that compute with numbers and have derivatives."


Value = TypeVar("Value")


@dataclass(frozen=True, eq=False, repr=False)
class Formula(Node):
    """A node of an expression graph, made by ``signals`` and operators.

    Attributes
    ----------
    dimensions : (n, m)
    kind : str
        The name of its operation: "variable", "sum", "product", "quotient", "power", "norm", "maximum", "minimum",
        "time", "table", "external", or that of a function of one variable.
    arguments : tuple of Formula
    data : tuple of float
        Of a variable its number in (x, u); of a sum the factors and the constant; of a power the exponent; of an
        external function the number of the output, and how many of the arguments are its x; of a table a number for
        each time.
    names : tuple of str
        Of a maximum or minimum, the names of the modes in which each argument is the largest or smallest.
    function : DifferentiableFunction, optional
        The external function that the node calls.

    Examples
    --------
    >>> x, u = lfo.signals(1, 1)
    >>> abs(x[0]) * u[0]
    Formula(max(x_0, -x_0) * (u_0))
    """

    arguments: tuple[Formula, ...] = ()

    @property
    def constant(self) -> float | None:
        """Return the value of a formula without variables, else None."""
        return self.data[-1] if self.kind == operations.SUM and not self.arguments else None

    def node(self, kind: str, arguments: tuple[Formula, ...], data: tuple[float, ...] = ()) -> Formula:
        """Return a formula of the same signals."""
        return Formula(self.dimensions, kind, arguments, data)

    def __add__(self, other: Formula | float) -> Formula:
        if not isinstance(other, Formula):
            return _sum(self, {self: 1.0}, _number("+", other))
        _require_same(self, other)
        return _sum(self, {self: 2.0} if other is self else {self: 1.0, other: 1.0}, 0.0)

    def __mul__(self, other: Formula | float) -> Formula:
        if not isinstance(other, Formula):
            return _sum(self, {self: _number("*", other)}, 0.0)
        _require_same(self, other)
        for a, b in ((self, other), (other, self)):
            if a.constant is not None:
                return _sum(self, {b: a.constant}, 0.0)
        if other is self:
            return self**2
        return self.node(operations.PRODUCT, (self, other))

    def __truediv__(self, other: Formula | float) -> Formula:
        divisor = other.constant if isinstance(other, Formula) else _number("/", other)
        if isinstance(other, Formula) and divisor is None:
            _require_same(self, other)
            return self.node(operations.QUOTIENT, (self, other))
        if not divisor:
            raise ProblemError("formula", "a quotient by 0", "a number other than zero")
        return self * (1 / divisor)

    def __rtruediv__(self, other: float) -> Formula:
        return self.node(operations.QUOTIENT, (_sum(self, {}, _number("/", other)), self))

    def __pow__(self, exponent: Formula | float) -> Formula:
        if isinstance(exponent, Formula) or exponent not in range(2, LARGEST_POWER + 1):
            expected = f"a whole number from 2 to {LARGEST_POWER}"
            raise ProblemError("formula", f"the power {brief(exponent)}", expected, "np.sqrt is the square root.")
        return self.node(operations.POWER, (self,), (float(exponent),))

    def __neg__(self) -> Formula:
        return self * -1.0

    def __sub__(self, other: Formula | float) -> Formula:
        return self + (other * -1.0 if isinstance(other, Formula) else -_number("-", other))

    def __rsub__(self, other: Formula | float) -> Formula:
        return -self + other

    def __abs__(self) -> Formula:
        return self.node(operations.MAXIMUM, (self, -self))

    def _compare(self, other: object) -> bool:
        advice = f"Python's max and min, and comparisons, decide here and now. {FUNCTIONS}"
        raise ProblemError("formula", f"a comparison with {brief(other)}", "lfo.maximum or lfo.minimum", advice)

    def __eq__(self, other: object) -> bool:
        """Return whether it is the same node, as collections ask; a comparison with anything else is refused."""
        return self is other if isinstance(other, Formula) else self._compare(other)

    def __bool__(self) -> bool:
        raise ProblemError("formula", "an if or while", "lfo.maximum or lfo.minimum", FUNCTIONS)

    def __float__(self) -> float:
        functions = ", ".join([*operations.scalar_functions(), operations.ANGLE])
        expected = f"+ - * /, whole powers, abs, lfo.norm, and NumPy's {functions}"
        raise ProblemError("formula", "a function of numbers only, as math.sin", expected, FUNCTIONS)

    __radd__, __rmul__, __hash__ = __add__, __mul__, object.__hash__
    __lt__ = __le__ = __gt__ = __ge__ = _compare

    def __getattr__(self, name: str) -> Callable[[], Formula]:
        """Return the method of a scalar function: np.exp of a formula or an array of formulas calls its ``exp``."""
        if name in operations.scalar_functions():
            return lambda: self.node(name, (self,))
        raise AttributeError(f"a formula has no attribute {name!r}")

    def arctan2(self, other: Formula | float) -> Formula:
        """Return the angle of the point (other, self), as np.arctan2; it jumps at the negative half of the axis."""
        return self.node(operations.ANGLE, (self, as_formula(self, "arctan2", other)))

    def hypot(self, other: Formula | float) -> Formula:
        """Return the norm of both, as np.hypot."""
        return norm([self, as_formula(self, "hypot", other)])

    def look_up(self, values: ArrayLike) -> Formula:
        """Return the number at each time: values[t] where t is the time.

        Parameters
        ----------
        values : (T,)
            One for each step of the horizon.

        Raises
        ------
        ProblemError
            If the formula is not the time, or these are not numbers in a row.

        Examples
        --------
        >>> def f(t, x, u):
        ...     return [x[0] + t.look_up([1.0, 0.9, 0.8]) * u[0]]
        >>> print(lfo.PiecewiseSmoothDynamics.from_formulas(f, 1, 1).modes[0].f[0])
        Formula(x_0 + look_up(t, 1, 0.9, 0.8) * (u_0))
        """
        numbers = real_array("look_up", values)
        if self.kind != operations.TIME:
            raise ProblemError("look_up", text_of(self), "the time t: t.look_up(values)")
        if numbers.ndim != 1 or not len(numbers):
            raise ProblemError("look_up", f"shape {numbers.shape}", "numbers in a row, one for each time")
        return self.node(operations.TABLE, (), tuple(numbers.tolist()))

    def __repr__(self) -> str:
        return f"Formula({text_of(self)})"


def signals(states: int, controls: int) -> tuple[NDArray[np.object_], NDArray[np.object_]]:
    """Return the components of x and of u as formulas, arrays (n,) and (m,).

    Parameters
    ----------
    states, controls : int
        n and m.

    Returns
    -------
    x : (n,) array of Formula
    u : (m,) array of Formula

    Raises
    ------
    ProblemError
        If they are no whole numbers from 1.

    Examples
    --------
    >>> x, u = lfo.signals(2, 1)
    >>> print(x[0] + u[0])
    Formula(x_0 + u_0)
    """
    n, m = positive_integer("states", states), positive_integer("controls", controls)
    variables = np.empty(n + m, dtype=object)
    variables[:] = [Formula((n, m), operations.VARIABLE, (), (float(i),)) for i in range(n + m)]
    return variables[:n], variables[n:]


def time_of(dimensions: tuple[int, int]) -> Formula:
    """Return the time t = 0, 1, ..., T-1 as a formula, for use with ``signals``.

    Functions of (t, x, u) get it, and texts have it as t.

    Parameters
    ----------
    dimensions : (n, m)
        The numbers of states and controls.

    Returns
    -------
    Formula

    Raises
    ------
    ProblemError
        If a number is not a positive integer.

    Examples
    --------
    >>> x, u = lfo.signals(1, 1)
    >>> print(lfo.formulas.time_of((1, 1)) * x[0])
    Formula(t * (x_0))
    """
    n, m = (positive_integer("dimensions", count) for count in dimensions)
    return Formula((n, m), operations.TIME)


def norm(components: Formula | Sequence[Formula | float] | NDArray[np.object_]) -> Formula:
    """Return the Euclidean norm of formulas, which has a kink where all of them are zero.

    Parameters
    ----------
    components : sequence of Formula

    Returns
    -------
    Formula

    Raises
    ------
    ProblemError
        If they are not formulas.

    Examples
    --------
    >>> x, u = lfo.signals(2, 1)
    >>> print(lfo.norm(x))
    Formula(norm(x_0, x_1))
    """
    formulas = [components] if isinstance(components, Formula) or not np.iterable(components) else list(components)
    like = next((component for component in formulas if isinstance(component, Formula)), None)
    if like is None:
        raise ProblemError("norm", brief(components), "formulas made of lfo.signals(n, m)")
    return like.node(operations.NORM, tuple(as_formula(like, "norm", component) for component in formulas))


def maximum(*arguments: Formula | float, names: Sequence[str] | None = None) -> Formula:
    """Return the largest of several formulas and numbers.

    Parameters
    ----------
    arguments : Formula or float
        At least one is a formula.
    names : sequence of str, optional
        The names of the modes in which each argument is the largest; "" adds nothing to a name.

    Returns
    -------
    Formula

    Raises
    ------
    ProblemError
        If there is no formula, or not one name each.

    Examples
    --------
    >>> x, u = lfo.signals(1, 1)
    >>> print(lfo.maximum(x[0], u[0]))
    Formula(max(x_0, u_0))
    """
    return extreme(operations.MAXIMUM, arguments, names)


def minimum(*arguments: Formula | float, names: Sequence[str] | None = None) -> Formula:
    """Return the smallest of several formulas and numbers.

    Parameters
    ----------
    arguments, names
        As for ``maximum``.

    Returns
    -------
    Formula

    Raises
    ------
    ProblemError
        If there is no formula, or not one name each.

    Examples
    --------
    >>> x, u = lfo.signals(1, 1)
    >>> print(lfo.minimum(x[0], u[0]))
    Formula(min(x_0, u_0))
    """
    return extreme(operations.MINIMUM, arguments, names)


def extreme(kind: str, arguments: Sequence[Formula | float], mode_names: Sequence[str] | None) -> Formula:
    """Return the maximum or minimum of formulas and numbers; see ``maximum`` and ``minimum``."""
    like = next((argument for argument in arguments if isinstance(argument, Formula)), None)
    if len(arguments) < 2 or like is None:
        raise ProblemError(kind, brief(arguments), "two arguments or more, at least one of them a formula")
    formulas = tuple(as_formula(like, kind, argument) for argument in arguments)
    if mode_names is not None:
        wrong = isinstance(mode_names, str) or not all(
            isinstance(name, str) and (name.strip() or not name) and name.isprintable() for name in mode_names
        )
        if wrong or len(mode_names) != len(formulas):
            raise ProblemError(f"{kind}.names", brief(mode_names), f"{len(formulas)} names, one for each argument")
    return replace(like.node(kind, formulas), names=tuple(mode_names or ()))


def nodes_in_order(formulas: Sequence[Formula]) -> tuple[Formula, ...]:
    """Return all nodes, each once and after its arguments."""
    return _in_order(tuple(formulas))


@lru_cache(maxsize=256)  # a search evaluates the same formulas some thousand times
def _in_order(formulas: tuple[Formula, ...]) -> tuple[Formula, ...]:
    return tuple(post_order(formulas, lambda node: node.arguments))


def post_order(roots: Sequence[Value], parts: Callable[[Value], Sequence[Value]]) -> dict[Value, None]:
    """Return all nodes of a graph, each after its parts; without recursion, as long sums are deeply nested."""
    order: dict[Value, None] = {}
    stack = [(node, False) for node in reversed(roots)]
    while stack:
        node, done = stack.pop()
        if node in order:
            continue
        if done:
            order[node] = None
        else:
            stack += [(node, True), *((part, False) for part in reversed(parts(node)))]
    return order


def evaluate(formulas: Sequence[Formula], rule: Callable[[Formula, list[Value]], Value]) -> list[Value]:
    """Return the values of formulas by a rule, which takes a node and the values of its arguments."""
    values: dict[Formula, Value] = {}
    for node in nodes_in_order(formulas):
        values[node] = rule(node, [values[argument] for argument in node.arguments])
    return [values[formula] for formula in formulas]


def rebuild(formulas: Sequence[Formula], changed: Mapping[Formula, Formula]) -> list[Formula]:
    """Return the formulas with some nodes replaced by operators; one without such nodes stays the same object."""
    rebuilt: dict[Formula, Formula] = {}
    for formula in nodes_in_order(formulas):
        if formula in changed:
            rebuilt[formula] = rebuilt.get(changed[formula], changed[formula])
            continue
        arguments = tuple(rebuilt[argument] for argument in formula.arguments)
        if all(new is old for new, old in zip(arguments, formula.arguments, strict=True)):
            rebuilt[formula] = formula
        elif formula.kind == operations.SUM:  # sums within sums are taken up, products by numbers are sums
            total = formula.node(operations.SUM, (), (formula.data[-1],))
            for factor, argument in zip(formula.data[:-1], arguments, strict=True):
                total = total + argument * factor
            rebuilt[formula] = total
        elif formula.kind == operations.PRODUCT:
            rebuilt[formula] = arguments[0] * arguments[1]
        elif formula.kind == operations.QUOTIENT and arguments[1].constant != 0:
            rebuilt[formula] = arguments[0] / arguments[1]
        else:
            rebuilt[formula] = replace(formula, arguments=arguments)
    return [rebuilt[formula] for formula in formulas]


def translate_formulas(formulas: Sequence[Formula], origin: Array) -> list[Formula]:
    """Return the formulas as functions of x - origin, origin (n,), and u."""
    variables = [
        one for one in nodes_in_order(formulas) if one.kind == operations.VARIABLE and one.data[0] < len(origin)
    ]
    return rebuild(formulas, {one: one + float(origin[int(one.data[0])]) for one in variables})


def with_states(formulas: Sequence[Formula], added: int) -> list[Formula]:
    """Return formulas of (x, u) as formulas of (x, w, u), w (added,)."""
    if not formulas:
        return []
    n, m = formulas[0].dimensions

    def renumber(node: Formula, arguments: list[Formula]) -> Formula:
        i = node.data[0] if node.kind == operations.VARIABLE else -1.0
        data = (i + added,) if i >= n else node.data
        return replace(node, dimensions=(n + added, m), arguments=tuple(arguments), data=data)

    return evaluate(formulas, renumber)


def require_times(field: str, formulas: Sequence[Formula], horizon: int) -> None:
    """Raise ProblemError unless tables over time have ``horizon`` numbers."""
    for node in kinks(formulas, operations.TABLE):
        if len(node.data) != horizon:
            advice = "t.look_up(values) takes values[t] at each time."
            raise ProblemError(f"{field}.look_up", f"{len(node.data)} numbers", f"{horizon}, one for each step", advice)


def kinks(formulas: Sequence[Formula], *kinds: str) -> Iterator[Formula]:
    """Yield the nodes of some kinds, inner ones first."""
    return (one for one in nodes_in_order(formulas) if one.kind in kinds)


def text_of(
    formula: Formula,
    labels: Sequence[str] | None = None,
    number: Callable[[float], str] = "{:.4g}".format,
    longest: float = LONGEST_SHOWN,
) -> str:
    """Return the text of a formula, by default for people, with the given names of states and controls.

    Parts that are longer than ``longest`` are cut to three dots.
    """
    notation = Notation(number, labels)

    def text(node: Formula, parts: list[str]) -> str:
        cut = {i for i, part in enumerate(parts) if len(part) > longest}
        parts = ["..." if i in cut else part for i, part in enumerate(parts)]
        return "..." if len(parts) > longest / 2 else operations.OPERATIONS[node.kind].text(node, parts, notation, cut)

    return evaluate([formula], text)[0]


def _sum(like: Formula, factors: Mapping[Formula, float], constant: float) -> Formula:
    """Return sum factor * node + constant; sums within it are taken up."""
    weights: dict[Formula, float] = {}
    for node, factor in factors.items():
        summands = zip(node.arguments, node.data[:-1], strict=True) if node.kind == operations.SUM else [(node, 1.0)]
        constant += factor * node.data[-1] if node.kind == operations.SUM else 0.0
        for part, weight in summands:
            weights[part] = weights.get(part, 0.0) + factor * weight
    nonzero = {node: factor for node, factor in weights.items() if factor}
    if list(nonzero.values()) == [1.0] and not constant:
        return next(iter(nonzero))
    return like.node(operations.SUM, tuple(nonzero), (*nonzero.values(), constant))


def as_formula(like: Formula, operator: str, value: Formula | float) -> Formula:
    """Return a formula, or a number as one, of the same signals as ``like``."""
    if not isinstance(value, Formula):
        return _sum(like, {}, _number(operator, value))
    _require_same(like, value)
    return value


def _require_same(first: Formula, second: Formula) -> None:
    if first.dimensions != second.dimensions:
        raise ProblemError("formula", f"signals of {second.dimensions} and {first.dimensions}", "the same signals")


def _number(operator: str, value: float) -> float:
    if isinstance(value, (bool, np.bool_)) or np.ndim(value):
        raise ProblemError("formula", f"{operator} {brief(value)}", "a number or a formula")
    return float(real_array("formula", value))
