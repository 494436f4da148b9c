"""Formulas of states and controls: written with operators, evaluated with their first and second derivatives.

``signals(n, m)`` makes the components of x and u. Sums, products, quotients, whole powers, ``abs``, ``maximum``,
``minimum``, ``norm``, and NumPy's ``exp``, ``log``, ``sqrt``, ``sin``, ``cos``, ``tanh`` and ``arctan`` of formulas are
formulas. A Python function of (x, u) that is made of these can be traced: it is called once, with signals.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, Self, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from lin_freq_ocp.arrays import Array, brief, positive_integer, real_array
from lin_freq_ocp.errors import LinFreqOCPError, ProblemError, first_line

LARGEST_POWER = 16

VARIABLE, SUM, PRODUCT, QUOTIENT, POWER = "variable", "sum", "product", "quotient", "power"
MAXIMUM, MINIMUM, NORM, EXTERNAL = "maximum", "minimum", "norm", "external"
SMOOTH = ("exp", "log", "sqrt", "sin", "cos", "tanh", "arctan")

FUNCTIONS = "lfo.DifferentiableFunction takes functions that compute with numbers and have derivatives."
"""What to do with a Python function that no formula can be made of."""


class External(Protocol):
    """A smooth function of (x, u) that is no formula, evaluated at points: x (points, n) and u (points, m)."""

    @property
    def title(self) -> str:
        """Return its name, or what stands for one."""
        ...

    def values_at(self, x: Array, u: Array) -> Array:
        """Return (points, outputs); not a number where it is undefined."""
        ...

    def derivatives_at(self, x: Array, u: Array) -> tuple[Array, Array, Array]:
        """Return values, (points, outputs, n + m) and (points, outputs, n + m, n + m)."""
        ...


@dataclass(frozen=True, eq=False, repr=False)
class Formula:
    """One node of a formula; made by ``signals`` and operators.

    Attributes
    ----------
    dimensions : (n, m)
    kind : str
    arguments : tuple of Formula
    data : tuple of float
        Of a variable its number in (x, u); of a sum the factors and the constant; of a power the exponent; of an
        external function which of its outputs it is, and how many of its arguments are its x.
    names : tuple of str
        Of a maximum or minimum, what to call the modes in which each argument is the one.
    function : External, optional
        Of an external function.
    """

    dimensions: tuple[int, int]
    kind: str
    arguments: tuple[Formula, ...] = ()
    data: tuple[float, ...] = ()
    names: tuple[str, ...] = ()
    function: External | None = None

    word: ClassVar[str] = "formula"
    """What errors call it."""

    @property
    def constant(self) -> float | None:
        """Return the value of a formula without variables, else None."""
        return self.data[-1] if self.kind == SUM and not self.arguments else None

    def node(self, kind: str, arguments: tuple[Formula, ...], data: tuple[float, ...] = ()) -> Self:
        """Return what an operator makes: a formula of the same signals."""
        return type(self)(self.dimensions, kind, arguments, data)

    def __add__(self, other: Any) -> Self:
        if not isinstance(other, Formula):
            return _sum(self, {self: 1.0}, _number(self, "+", other))
        _require_same(self, other)
        return _sum(self, {self: 2.0} if other is self else {self: 1.0, other: 1.0}, 0.0)

    def __mul__(self, other: Any) -> Self:
        if not isinstance(other, Formula):
            return _sum(self, {self: _number(self, "*", other)}, 0.0)
        _require_same(self, other)
        for one, factor in ((self, other), (other, self)):
            if one.constant is not None:
                return _sum(self, {factor: one.constant}, 0.0)
        if other is self:
            return self**2
        return self.node(PRODUCT, (self, other))

    def __truediv__(self, other: Any) -> Self:
        if isinstance(other, Formula) and other.constant is None:
            _require_same(self, other)
            return self.node(QUOTIENT, (self, other))
        value = _number(self, "/", other.constant if isinstance(other, Formula) else other)
        if not value:
            raise ProblemError(self.word, "a quotient by 0", "a number other than zero")
        return self * (1 / value)

    def __rtruediv__(self, other: Any) -> Self:
        return self.node(QUOTIENT, (_sum(self, {}, _number(self, "/", other)), self))

    def __pow__(self, exponent: Any) -> Self:
        if isinstance(exponent, Formula) or exponent not in range(2, LARGEST_POWER + 1):
            expected = f"a whole number from 2 to {LARGEST_POWER}"
            raise ProblemError(self.word, f"the power {brief(exponent)}", expected, "np.sqrt is the square root.")
        return self.node(POWER, (self,), (float(exponent),))

    def __neg__(self) -> Self:
        return self * -1.0

    def __sub__(self, other: Any) -> Self:
        return self + (other * -1.0 if isinstance(other, Formula) else -_number(self, "-", other))

    def __rsub__(self, other: Any) -> Self:
        return -self + other

    def __abs__(self) -> Self:
        return self.node(MAXIMUM, (self, -self))

    def _compare(self, other: Any) -> bool:
        advice = f"Python's max and min, and comparisons, decide here and now. {FUNCTIONS}"
        raise ProblemError(self.word, f"a comparison with {brief(other)}", "lfo.maximum or lfo.minimum", advice)

    def __eq__(self, other: object) -> bool:
        """Return whether it is the same node, as collections ask; a comparison with anything else is refused."""
        return self is other if isinstance(other, Formula) else self._compare(other)

    def __bool__(self) -> bool:
        raise ProblemError(self.word, "an if or while", "lfo.maximum or lfo.minimum", FUNCTIONS)

    def __float__(self) -> float:
        expected = f"+ - * /, whole powers, abs, lfo.norm, and NumPy's {', '.join(SMOOTH)}"
        raise ProblemError(self.word, "what takes numbers only, as math.sin", expected, FUNCTIONS)

    __radd__, __rmul__, __hash__ = __add__, __mul__, object.__hash__
    __lt__ = __le__ = __gt__ = __ge__ = _compare

    def exp(self) -> Self:
        """Return the exponential; np.exp of an array of formulas calls it, and so on."""
        return self.node("exp", (self,))

    def log(self) -> Self:
        """Return the natural logarithm."""
        return self.node("log", (self,))

    def sqrt(self) -> Self:
        """Return the square root; of a sum of squares, ``norm`` is known to have a kink at zero."""
        return self.node("sqrt", (self,))

    def sin(self) -> Self:
        """Return the sine."""
        return self.node("sin", (self,))

    def cos(self) -> Self:
        """Return the cosine."""
        return self.node("cos", (self,))

    def tanh(self) -> Self:
        """Return the hyperbolic tangent."""
        return self.node("tanh", (self,))

    def arctan(self) -> Self:
        """Return the angle whose tangent it is, between -pi/2 and pi/2."""
        return self.node("arctan", (self,))

    def __repr__(self) -> str:
        from lin_freq_ocp.formulas.text import text_of

        return f"Formula({text_of(self)})"


F = TypeVar("F", bound=Formula)


def signals(states: int, controls: int) -> tuple[NDArray[np.object_], NDArray[np.object_]]:
    """Return the components of x and of u as formulas, arrays (n,) and (m,).

    Parameters
    ----------
    states, controls : int
        n and m.

    Raises
    ------
    ProblemError
        If they are no whole numbers from 1.
    """
    return variables(Formula, states, controls)


def variables(kind: type[Formula], states: int, controls: int) -> tuple[NDArray[np.object_], NDArray[np.object_]]:
    """Return the components of x and of u as formulas of some class; see ``signals``."""
    n, m = positive_integer("states", states), positive_integer("controls", controls)
    made = np.empty(n + m, dtype=object)
    made[:] = [kind((n, m), VARIABLE, (), (float(i),)) for i in range(n + m)]
    return made[:n], made[n:]


def norm(components: Any) -> Formula:
    """Return the Euclidean norm of formulas, which has a kink where all of them are zero.

    Raises
    ------
    ProblemError
        If they are not formulas.
    """
    listed = list(components) if isinstance(components, (Sequence, np.ndarray)) else [components]
    given = [one for one in listed if isinstance(one, Formula)]
    if not given:
        raise ProblemError("norm", brief(components), "formulas made of lfo.signals(n, m)")
    zero = given[0] * 0.0
    return given[0].node(NORM, tuple(one if isinstance(one, Formula) else zero + one for one in listed))


@overload
def maximum(first: F, /, *others: F | float, names: Sequence[str] | None = None) -> F: ...


@overload
def maximum(first: float, /, *others: Any, names: Sequence[str] | None = None) -> Any: ...


def maximum(*arguments: Any, names: Sequence[str] | None = None) -> Any:
    """Return the largest of several formulas and numbers.

    Parameters
    ----------
    arguments : Expression, Formula or float
        Affine expressions of ``affine_signals``, or formulas of ``signals``; at least one is no number.
    names : sequence of str, optional
        What to call the modes in which each argument is the largest; "" adds nothing to a name.

    Raises
    ------
    ProblemError
        If there is no formula, or not one name each.
    """
    return extreme(MAXIMUM, arguments, names)


@overload
def minimum(first: F, /, *others: F | float, names: Sequence[str] | None = None) -> F: ...


@overload
def minimum(first: float, /, *others: Any, names: Sequence[str] | None = None) -> Any: ...


def minimum(*arguments: Any, names: Sequence[str] | None = None) -> Any:
    """Return the smallest of several formulas and numbers; parameters and errors as for ``maximum``."""
    return extreme(MINIMUM, arguments, names)


def extreme(kind: str, arguments: Sequence[Any], given: Sequence[str] | None) -> Formula:
    """Return the maximum or minimum of formulas and numbers; see ``maximum`` and ``minimum``."""
    first = next((one for one in arguments if isinstance(one, Formula)), None)
    if len(arguments) < 2 or first is None:
        expected = "two arguments or more, at least one of them an expression or a formula"
        raise ProblemError(kind, brief(arguments), expected)
    listed: list[Formula] = []
    for one in arguments:
        made = one if isinstance(one, Formula) else _sum(first, {}, _number(first, kind, one))
        _require_same(first, made)
        listed.append(made)
    if given is not None:
        wrong = isinstance(given, str) or not all(
            isinstance(name, str) and (name.strip() or not name) and name.isprintable() for name in given
        )
        if wrong or len(given) != len(listed):
            raise ProblemError(f"{kind}.names", brief(given), f"{len(listed)} names, one for each argument")
    return replace(first.node(kind, tuple(listed)), names=tuple(given or ()))


def in_order(formulas: Sequence[Formula]) -> list[Formula]:
    """Return all nodes, each once, arguments before what is made of them."""
    found: dict[Formula, None] = {}
    stack = [(one, False) for one in reversed(formulas)]
    while stack:
        one, done = stack.pop()
        if one in found:
            continue
        if done:
            found[one] = None
        else:
            stack += [(one, True), *((argument, False) for argument in reversed(one.arguments))]
    return list(found)


def rebuilt(formulas: Sequence[Formula], changed: Mapping[Formula, Formula]) -> list[Formula]:
    """Return the formulas with some nodes replaced, as operators make them; what has none stays the same object."""
    made: dict[Formula, Formula] = {}
    for one in in_order(formulas):
        if one in changed:
            made[one] = made.get(changed[one], changed[one])
            continue
        arguments = tuple(made[argument] for argument in one.arguments)
        same = all(new is old for new, old in zip(arguments, one.arguments, strict=True))
        made[one] = one if same else _made_anew(one, arguments)
    return [made[one] for one in formulas]


def _made_anew(one: Formula, arguments: tuple[Formula, ...]) -> Formula:
    """Return the node of other arguments: sums within sums are taken up, products by numbers are sums."""
    if one.kind == SUM:
        total = one.node(SUM, (), (one.data[-1],))
        for factor, argument in zip(one.data[:-1], arguments, strict=True):
            total = total + argument * factor
        return total
    if one.kind == PRODUCT:
        return arguments[0] * arguments[1]
    if one.kind == QUOTIENT and arguments[1].constant != 0:
        return arguments[0] / arguments[1]
    return replace(one, arguments=arguments)


def listed_formulas(field: str, given: Any, dimensions: tuple[int, int]) -> tuple[Formula, ...]:
    """Return formulas, texts and numbers, or what a function of (x, u) makes of signals, as formulas.

    Raises
    ------
    ProblemError
        If they are none, or have other signals, or if the function cannot be called with formulas.
    """
    if callable(given):
        given = _traced(field, given, dimensions)
    if isinstance(given, (Formula, str)):
        given = [given]
    if not isinstance(given, (Sequence, np.ndarray)):
        raise ProblemError(field, brief(given), "a list of formulas made of lfo.signals(n, m), or a function of (x, u)")
    zero, made = Formula(dimensions, SUM, (), (0.0,)), list[Formula]()
    for i, one in enumerate(given):
        if isinstance(one, str):
            from lin_freq_ocp.formulas.text import formula_from_text

            one = formula_from_text(f"{field}[{i}]", one, dimensions)
        formula = one if isinstance(one, Formula) else _sum(zero, {}, _number(zero, f"{field}[{i}]", one))
        if formula.dimensions != dimensions:
            expected = f"{dimensions[0]} states and {dimensions[1]} controls"
            raise ProblemError(f"{field}[{i}]", f"signals of {formula.dimensions}", expected)
        if formula.word != zero.word:
            advice = "Those of lfo.affine_signals are for PiecewiseAffineDynamics.from_max_min."
            raise ProblemError(f"{field}[{i}]", brief(formula), "a formula made of lfo.signals", advice)
        made.append(formula)
    return tuple(made)


def _traced(field: str, function: Callable[..., Any], dimensions: tuple[int, int]) -> Any:
    """Return what a function makes of signals."""
    x, u = signals(*dimensions)
    try:
        return function(x, u)
    except LinFreqOCPError:
        raise
    except Exception as error:  # whatever a function does that was not made for formulas
        got = f"{first_line(error)}, from the function"
        expected = f"one that makes formulas of x ({dimensions[0]},) and u ({dimensions[1]},)"
        advice = f"It is called once, with lfo.signals. {FUNCTIONS} lfo.from_casadi takes those of CasADi."
        raise ProblemError(field, got, expected, advice) from error


def kinks(formulas: Sequence[Formula], *kinds: str) -> Iterator[Formula]:
    """Yield the nodes of some kinds, those within others first."""
    return (one for one in in_order(formulas) if one.kind in kinds)


def _sum(like: F, factors: Mapping[Formula, float], constant: float) -> F:
    """Return sum factor * formula + constant, of the class of ``like``; sums within it are taken up."""
    flat: dict[Any, float] = {}
    for one, factor in factors.items():
        inner = zip(one.arguments, one.data[:-1], strict=True) if one.kind == SUM else [(one, 1.0)]
        constant += factor * one.data[-1] if one.kind == SUM else 0.0
        for part, weight in inner:
            flat[part] = flat.get(part, 0.0) + factor * weight
    kept = {one: factor for one, factor in flat.items() if factor}
    if list(kept.values()) == [1.0] and not constant:
        return next(iter(kept))
    return like.node(SUM, tuple(kept), (*kept.values(), constant))


def _require_same(one: Formula, other: Formula) -> None:
    if one.dimensions != other.dimensions:
        raise ProblemError(one.word, f"signals of {other.dimensions} and {one.dimensions}", "the same signals")
    if one.word != other.word:
        got = f"the {other.word} {brief(other)}"
        raise ProblemError(one.word, got, "all made of lfo.signals, or all of lfo.affine_signals")


def _number(formula: Formula, operator: str, value: Any) -> float:
    if isinstance(value, (bool, np.bool_)) or np.ndim(value):
        article = "an" if formula.word[0] in "aeiou" else "a"
        raise ProblemError(formula.word, f"{operator} {brief(value)}", f"a number or {article} {formula.word}")
    return float(real_array(formula.word, value))
