"""The operations of formulas: values, derivatives, enclosures over boxes, affine form and text of each.

``OPERATIONS`` has all of them. A new function of one variable is a ``ScalarFunction`` in this table. The rules
of differentiation at points are at the end, those over boxes in ``intervals``.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.formulas import intervals
from lin_freq_ocp.formulas.intervals import Interval, IntervalJet, inverse, multiply, power, scale

VARIABLE, SUM, PRODUCT, QUOTIENT, POWER = "variable", "sum", "product", "quotient", "power"
MAXIMUM, MINIMUM, NORM, EXTERNAL = "maximum", "minimum", "norm", "external"
TIME, TABLE, ANGLE = "time", "table", "arctan2"
LOOK_UP = "look_up"  # the name of a table in texts: look_up(t, 1.0, 2.0) is 1 at t = 0 and 2 at t = 1
# Value (points,), gradient (k, points) and Hessian (k, k, points) by the k components of (x, u).
Jet = tuple[Array, Array, Array | None]
Stacked = tuple[Array, Array, Array]


class External(Protocol):
    """A smooth function of (x, u) that is no formula, evaluated at points: x (points, n) and u (points, m)."""

    @property
    def title(self) -> str:
        """Return its name, for messages."""
        ...

    @property
    def exact_curvature(self) -> bool:
        """Return whether its second derivatives are exact."""
        ...

    def values_at(self, x: Array, u: Array) -> Array:
        """Return (points, outputs); nan where it is undefined."""
        ...

    def derivatives_at(self, x: Array, u: Array) -> tuple[Array, Array, Array]:
        """Return values, (points, outputs, n + m) and (points, outputs, n + m, n + m)."""
        ...


@dataclass(frozen=True, eq=False, repr=False)
class Node:
    """A node of an expression graph; see ``Formula``. Its kind is the key of its operation in ``OPERATIONS``."""

    dimensions: tuple[int, int]
    kind: str
    arguments: tuple[Node, ...] = ()
    data: tuple[float, ...] = ()
    names: tuple[str, ...] = ()
    function: External | None = None


@dataclass(frozen=True, eq=False)
class Points:
    """Points y = (x, u), (points, n + m), at which formulas are evaluated, and their times, (points,) or (1,)."""

    y: Array
    times: Indices
    selections: Mapping[Node, Array]  # of norms: derivatives by the arguments, (points, components), where numbers
    # The values of external functions, each evaluated once for all its outputs
    calls: dict[Hashable, tuple[Array, ...]] = field(default_factory=dict[Hashable, tuple[Array, ...]])


class BoxAtTime(NamedTuple):
    """Boxes lower <= (x, u) <= upper, (boxes, n + m), at a time, or one of each, (boxes,); None: at all times."""

    lower: Array
    upper: Array
    time: int | Indices | None = None


@dataclass(frozen=True)
class Notation:
    """How numbers and signals are written; without labels, signals are x_0, ..., u_0, ...."""

    number: Callable[[float], str]
    labels: Sequence[str] | None = None


class Operation:
    """An operation; a method that it does not override raises ProblemError.

    A jet is a value with its gradient and Hessian; None for a Hessian of zeros. Points are the last axis of a jet:
    NumPy is fast along that.
    """

    bracketed = False  # whether its text needs brackets within a product, a quotient or a multiple

    def value(self, node: Node, arguments: Sequence[Array], at: Points) -> Array:
        """Return the values, (points,), from those of the arguments."""
        raise self._refusal(node)

    def jet(self, node: Node, arguments: Sequence[Jet], at: Points) -> Jet:
        """Return the values with first and second derivatives, points along the last axis."""
        raise self._refusal(node)

    def interval_jet(self, node: Node, arguments: Sequence[IntervalJet], box: BoxAtTime, curved: bool) -> IntervalJet:
        """Return enclosures over boxes of (x, u); ``curved``: also of the Hessian."""
        raise self._refusal(node)

    def affine(self, node: Node, rows: Sequence[Array]) -> Array | None:
        """Return coefficients and constant, (n + m + 1,), from those of the arguments; None if it is not affine."""
        return None

    def text(self, node: Node, parts: Sequence[str], notation: Notation, whole: Set[int]) -> str:
        """Return the text from those of the arguments; the ``whole`` ones, by number, need no brackets."""
        return f"{node.kind}({', '.join(parts)})"

    def _refusal(self, node: Node) -> ProblemError:
        return ProblemError("formula", f"a {node.kind}", "a formula without maxima and minima: a mode of it")


class _Variable(Operation):
    """A component of (x, u), whose number is the data."""

    def value(self, node: Node, arguments: Sequence[Array], at: Points) -> Array:
        return at.y[:, int(node.data[0])]

    def jet(self, node: Node, arguments: Sequence[Jet], at: Points) -> Jet:
        slope = np.zeros(at.y.shape[::-1])
        slope[int(node.data[0])] = 1.0
        return self.value(node, (), at), slope, None

    def interval_jet(self, node: Node, arguments: Sequence[IntervalJet], box: BoxAtTime, curved: bool) -> IntervalJet:
        i = int(node.data[0])
        slope = np.zeros(box.lower.shape)
        slope[:, i] = 1.0
        return (box.lower[:, i], box.upper[:, i]), (slope, slope), None

    def affine(self, node: Node, rows: Sequence[Array]) -> Array | None:
        return np.eye(sum(node.dimensions) + 1)[int(node.data[0])]

    def text(self, node: Node, parts: Sequence[str], notation: Notation, whole: Set[int]) -> str:
        n, i = node.dimensions[0], int(node.data[0])
        return notation.labels[i] if notation.labels else f"x_{i}" if i < n else f"u_{i - n}"


class _OfTime(Operation):
    """A number at each time: that of the data, or without data the time itself."""

    def value(self, node: Node, arguments: Sequence[Array], at: Points) -> Array:
        values = np.array(node.data)[at.times] if node.data else at.times.astype(np.float64)
        return np.broadcast_to(values, len(at.y))

    def jet(self, node: Node, arguments: Sequence[Jet], at: Points) -> Jet:
        return self.value(node, (), at), np.zeros(at.y.shape[::-1]), None

    def interval_jet(self, node: Node, arguments: Sequence[IntervalJet], box: BoxAtTime, curved: bool) -> IntervalJet:
        if box.time is None:
            least, largest = (min(node.data), max(node.data)) if node.data else (0.0, np.inf)
        else:
            least = largest = np.array(node.data)[box.time] if node.data else np.asarray(box.time, dtype=np.float64)
        slope = np.zeros(box.lower.shape)
        return (np.full(len(slope), least), np.full(len(slope), largest)), (slope, slope), None

    def text(self, node: Node, parts: Sequence[str], notation: Notation, whole: Set[int]) -> str:
        return f"{LOOK_UP}({', '.join(['t', *map(notation.number, node.data)])})" if node.data else "t"


class _Sum(Operation):
    """A sum of multiples; the data are the factors and the constant."""

    bracketed = True

    def value(self, node: Node, arguments: Sequence[Array], at: Points) -> Array:
        total = np.full(len(at.y), node.data[-1])
        for factor, argument in zip(node.data[:-1], arguments, strict=True):
            total += factor * argument
        return total

    def jet(self, node: Node, arguments: Sequence[Jet], at: Points) -> Jet:
        return sum_rule(node.data[:-1], arguments, node.data[-1], at.y.shape[::-1])

    def interval_jet(self, node: Node, arguments: Sequence[IntervalJet], box: BoxAtTime, curved: bool) -> IntervalJet:
        return intervals.sum_rule(node.data[:-1], arguments, node.data[-1], box[:2])

    def affine(self, node: Node, rows: Sequence[Array]) -> Array | None:
        k = sum(node.dimensions)
        return np.array(node.data[:-1]) @ np.array(rows).reshape(-1, k + 1) + node.data[-1] * np.eye(k + 1)[k]

    def text(self, node: Node, parts: Sequence[str], notation: Notation, whole: Set[int]) -> str:
        text, number, constant = "", notation.number, node.data[-1]
        for i, (factor, part) in enumerate(zip(node.data[:-1], parts, strict=True)):
            size = "" if abs(factor) == 1 else f"{number(abs(factor))} * "
            sign = (" - " if factor < 0 else " + ") if text else ("-" if factor < 0 else "")
            text += sign + size + (part if factor == 1 else _factor(node, parts, i, whole))
        if constant or not text:
            text += f" {'-' if constant < 0 else '+'} {number(abs(constant))}" if text else number(constant)
        return text


class _Product(Operation):
    """A product of two formulas."""

    bracketed = True

    def value(self, node: Node, arguments: Sequence[Array], at: Points) -> Array:
        return arguments[0] * arguments[1]

    def jet(self, node: Node, arguments: Sequence[Jet], at: Points) -> Jet:
        return product_rule(arguments[0], arguments[1])

    def interval_jet(self, node: Node, arguments: Sequence[IntervalJet], box: BoxAtTime, curved: bool) -> IntervalJet:
        return intervals.product_rule(arguments[0], arguments[1], curved)

    def affine(self, node: Node, rows: Sequence[Array]) -> Array | None:
        constant = next((i for i, row in enumerate(rows) if not row[:-1].any()), None)
        return None if constant is None else rows[constant][-1] * rows[1 - constant]

    def text(self, node: Node, parts: Sequence[str], notation: Notation, whole: Set[int]) -> str:
        return f"{_factor(node, parts, 0, whole)} * ({parts[1]})"


class _Quotient(Operation):
    """A quotient of two formulas."""

    bracketed = True

    def value(self, node: Node, arguments: Sequence[Array], at: Points) -> Array:
        return arguments[0] / arguments[1]

    def jet(self, node: Node, arguments: Sequence[Jet], at: Points) -> Jet:
        over, under = arguments
        d = under[0]
        return product_rule(over, chain_rule(under, 1 / d, -(d**-2.0), 2 * d**-3.0))

    def interval_jet(self, node: Node, arguments: Sequence[IntervalJet], box: BoxAtTime, curved: bool) -> IntervalJet:
        over, under = arguments
        once = inverse(under[0])
        twice = multiply(once, once)
        derivatives = scale(-1.0, twice), scale(2.0, multiply(twice, once))
        return intervals.product_rule(over, intervals.chain_rule(under, once, *derivatives, curved), curved)

    def text(self, node: Node, parts: Sequence[str], notation: Notation, whole: Set[int]) -> str:
        return f"{_factor(node, parts, 0, whole)} / ({parts[1]})"


class _Power(Operation):
    """A whole power; the data are the exponent."""

    def value(self, node: Node, arguments: Sequence[Array], at: Points) -> Array:
        return arguments[0] ** node.data[0]

    def jet(self, node: Node, arguments: Sequence[Jet], at: Points) -> Jet:
        p, base = node.data[0], arguments[0][0]
        return chain_rule(arguments[0], base**p, p * base ** (p - 1), p * (p - 1) * base ** (p - 2))

    def interval_jet(self, node: Node, arguments: Sequence[IntervalJet], box: BoxAtTime, curved: bool) -> IntervalJet:
        p, base = int(node.data[0]), arguments[0][0]
        first, second = scale(p, power(base, p - 1)), scale(p * (p - 1), power(base, p - 2))
        return intervals.chain_rule(arguments[0], power(base, p), first, second, curved)

    def text(self, node: Node, parts: Sequence[str], notation: Notation, whole: Set[int]) -> str:
        return f"({parts[0]})**{node.data[0]:g}"


class _Norm(Operation):
    """A Euclidean norm; at zero its derivative is the selected one."""

    def value(self, node: Node, arguments: Sequence[Array], at: Points) -> Array:
        return np.linalg.norm(np.stack(arguments, axis=1), axis=1)

    def jet(self, node: Node, arguments: Sequence[Jet], at: Points) -> Jet:
        return norm_rule(arguments, at.selections.get(node))

    def interval_jet(self, node: Node, arguments: Sequence[IntervalJet], box: BoxAtTime, curved: bool) -> IntervalJet:
        return intervals.norm_rule(arguments, curved)


class _Angle(Operation):
    """The angle arctan2(a, b) of the point (b, a), which jumps where a = 0 and b < 0."""

    def value(self, node: Node, arguments: Sequence[Array], at: Points) -> Array:
        return np.where(np.hypot(*arguments) > 0, np.arctan2(*arguments), np.nan)

    def jet(self, node: Node, arguments: Sequence[Jet], at: Points) -> Jet:
        a, b = (jet[0] for jet in arguments)
        square = a**2 + b**2
        first = np.stack([b, -a], axis=-1) / square[:, None]
        across = np.stack([-2 * a * b, a**2 - b**2, a**2 - b**2, 2 * a * b], axis=-1) / (square**2)[:, None]
        value = self.value(node, [a, b], at)
        stacked = stack_jets(arguments)
        found = compose_jets(stacked, value[:, None], first[:, None], across.reshape(-1, 1, 2, 2))
        return found[0][0], found[1][0], found[2][0]

    def interval_jet(self, node: Node, arguments: Sequence[IntervalJet], box: BoxAtTime, curved: bool) -> IntervalJet:
        raise UnsupportedError("no global bound: arctan2 jumps and has no bounds over boxes; write it with arctan.")


class _Extreme(Operation):
    """A maximum or minimum: only its modes have derivatives."""

    def __init__(self, name: str, largest: np.ufunc):
        self._name, self._largest = name, largest

    def value(self, node: Node, arguments: Sequence[Array], at: Points) -> Array:
        return np.asarray(self._largest.reduce(list(arguments)))

    def text(self, node: Node, parts: Sequence[str], notation: Notation, whole: Set[int]) -> str:
        return f"{self._name}({', '.join(parts)})"


class _ExternalOutput(Operation):
    """An output of an external function; the data are its number, and how many of the arguments are states."""

    def value(self, node: Node, arguments: Sequence[Array], at: Points) -> Array:
        function, key = _call(node)
        output, states = map(int, node.data)
        if key not in at.calls:
            a = np.stack(arguments, axis=1)
            at.calls[key] = (function.values_at(a[:, :states], a[:, states:]),)
        return at.calls[key][0][:, output]

    def jet(self, node: Node, arguments: Sequence[Jet], at: Points) -> Jet:
        function, key = _call(node)
        output, states = map(int, node.data)
        if key not in at.calls:
            stacked = stack_jets(arguments)
            derivatives = function.derivatives_at(stacked[0][:states].T, stacked[0][states:].T)
            at.calls[key] = compose_jets(stacked, *derivatives)
        value, slope, hessian = at.calls[key]
        return value[output], slope[output], hessian[output]

    def interval_jet(self, node: Node, arguments: Sequence[IntervalJet], box: BoxAtTime, curved: bool) -> IntervalJet:
        name = _call(node)[0].title
        raise UnsupportedError(f"no global bound: {name} is no formula; only formulas have bounds over boxes.")

    def text(self, node: Node, parts: Sequence[str], notation: Notation, whole: Set[int]) -> str:
        return f"{_call(node)[0].title}({', '.join(parts)})[{int(node.data[0])}]"


@dataclass(frozen=True)
class ScalarFunction(Operation):
    """A smooth function of one variable, called by its name in the table, in texts and as ``np.name(formula)``."""

    function: Callable[[Array], Array]
    derivatives: Callable[[Array, Array], tuple[Array, Array]]  # first and second, of the argument and the value
    enclosures: Callable[[Interval], tuple[Interval, Interval, Interval]]  # of the values, first and second derivative

    def value(self, node: Node, arguments: Sequence[Array], at: Points) -> Array:
        """Return the values."""
        return self.function(arguments[0])

    def jet(self, node: Node, arguments: Sequence[Jet], at: Points) -> Jet:
        """Return the values with derivatives, by the chain rule."""
        value = self.function(arguments[0][0])
        return chain_rule(arguments[0], value, *self.derivatives(arguments[0][0], value))

    def interval_jet(self, node: Node, arguments: Sequence[IntervalJet], box: BoxAtTime, curved: bool) -> IntervalJet:
        """Return enclosures, by the chain rule."""
        return intervals.chain_rule(arguments[0], *self.enclosures(arguments[0][0]), curved)


def _call(node: Node) -> tuple[External, Hashable]:
    """Return an external function, and the key that its outputs of the same arguments share."""
    assert node.function is not None  # nodes of this kind have one
    return node.function, (node.function, node.arguments)


def _factor(node: Node, parts: Sequence[str], i: int, whole: Set[int]) -> str:
    """Return the text of an argument as a factor."""
    bracketed = i not in whole and OPERATIONS[node.arguments[i].kind].bracketed
    return f"({parts[i]})" if bracketed else parts[i]


def _tanh(a: Array, value: Array) -> tuple[Array, Array]:
    slope = np.cosh(a) ** -2.0
    return slope, -2 * value * slope


def _arcsin(a: Array, _: Array) -> tuple[Array, Array]:
    left = 1 - a**2
    return left**-0.5, a * left**-1.5


def _arctan(a: Array, _: Array) -> tuple[Array, Array]:
    slope = 1 / (1 + a**2)
    return slope, -2 * (a * slope) * slope


# All operations by the kind of their nodes.
OPERATIONS: dict[str, Operation] = {
    VARIABLE: _Variable(),
    SUM: _Sum(),
    PRODUCT: _Product(),
    QUOTIENT: _Quotient(),
    POWER: _Power(),
    NORM: _Norm(),
    MAXIMUM: _Extreme("max", np.maximum),
    MINIMUM: _Extreme("min", np.minimum),
    TIME: _OfTime(),
    TABLE: _OfTime(),
    EXTERNAL: _ExternalOutput(),
    "exp": ScalarFunction(np.exp, lambda _, value: (value, value), intervals.exponential),
    "log": ScalarFunction(np.log, lambda a, _: (1 / a, -(a**-2.0)), intervals.logarithm),
    "sqrt": ScalarFunction(np.sqrt, lambda a, value: (0.5 / value, -0.25 / (value * a)), intervals.square_root),
    "sin": ScalarFunction(np.sin, lambda a, value: (np.cos(a), -value), intervals.sine),
    "cos": ScalarFunction(np.cos, lambda a, value: (-np.sin(a), -value), intervals.cosine),
    "tanh": ScalarFunction(np.tanh, _tanh, intervals.hyperbolic_tangent),
    "arctan": ScalarFunction(np.arctan, _arctan, intervals.arc_tangent),
    "tan": ScalarFunction(np.tan, lambda _, value: (1 + value**2, 2 * value * (1 + value**2)), intervals.tangent),
    "sinh": ScalarFunction(np.sinh, lambda a, value: (np.cosh(a), value), intervals.hyperbolic_sine),
    "cosh": ScalarFunction(np.cosh, lambda a, value: (np.sinh(a), value), intervals.hyperbolic_cosine),
    "arcsin": ScalarFunction(np.arcsin, _arcsin, intervals.arc_sine),
    "arccos": ScalarFunction(np.arccos, lambda a, _: (-_arcsin(a, a)[0], -_arcsin(a, a)[1]), intervals.arc_cosine),
    "arcsinh": ScalarFunction(
        np.arcsinh, lambda a, _: ((1 + a**2) ** -0.5, -a * (1 + a**2) ** -1.5), intervals.area_sine
    ),
    "arctanh": ScalarFunction(
        np.arctanh, lambda a, _: (1 / (1 - a**2), 2 * a * (1 - a**2) ** -2.0), intervals.area_tangent
    ),
    ANGLE: _Angle(),
}


def scalar_functions() -> dict[str, ScalarFunction]:
    """Return the functions of one variable by name."""
    return {name: one for name, one in OPERATIONS.items() if isinstance(one, ScalarFunction)}


def sum_rule(factors: Sequence[float], arguments: Sequence[Jet], constant: float, shape: tuple[int, int]) -> Jet:
    """Return the jet of a sum of multiples and a constant, (k, points) being the shape of its gradient."""
    value, slope, hessian = np.full(shape[1], constant), np.zeros(shape), None
    for factor, argument in zip(factors, arguments, strict=True):
        value += factor * argument[0]
        slope += factor * argument[1]
        if argument[2] is not None:
            more = factor * argument[2]
            hessian = more if hessian is None else hessian + more
    return value, slope, hessian


def product_rule(a: Jet, b: Jet) -> Jet:
    """Return the jet of a b."""
    cross = _outer(a[1], b[1])
    hessian = cross + np.swapaxes(cross, 0, 1)
    for one, other in ((a, b), (b, a)):
        if other[2] is not None:
            hessian += one[0] * other[2]
    return a[0] * b[0], a[0] * b[1] + b[0] * a[1], hessian


def chain_rule(a: Jet, value: Array, first: Array, second: Array) -> Jet:
    """Return the jet of f(a), from f and its derivatives at a, (points,) each."""
    hessian = _outer(second * a[1], a[1])
    if a[2] is not None:
        hessian += first * a[2]
    return value, first * a[1], hessian


def norm_rule(arguments: Sequence[Jet], selection: Array | None) -> Jet:
    """Return the jet of |a|; where the selection (points, components) has numbers, they stand for its derivative by a.

    The Hessian is zero there, and where a is zero.
    """
    a, slopes, hessians = stack_jets(arguments)
    length = np.linalg.norm(a, axis=0)
    at_zero = length == 0
    divisor = np.where(at_zero, 1.0, length)
    unit, flat = a / divisor, at_zero
    if selection is not None:
        flat = np.isfinite(selection).all(axis=1) | at_zero
        unit = np.where(np.isfinite(selection.T), selection.T, unit)
    slope = np.einsum("cp,ckp->kp", unit, slopes)
    across = (np.einsum("ckp,clp->klp", slopes, slopes) - _outer(slope, slope)) / divisor
    hessian = np.einsum("cp,cklp->klp", unit, hessians) + np.where(flat, 0.0, across)
    return length, slope, hessian


def stack_jets(arguments: Sequence[Jet]) -> Stacked:
    """Return jets as one, with a first axis of components."""
    values, slopes = np.stack([jet[0] for jet in arguments]), np.stack([jet[1] for jet in arguments])
    hessians = np.zeros((len(slopes), *slopes.shape[1:2] * 2, slopes.shape[2]))
    for i, (_, _, hessian) in enumerate(arguments):
        if hessian is not None:
            hessians[i] = hessian
    return values, slopes, hessians


def compose_jets(arguments: Stacked, value: Array, first: Array, second: Array) -> Stacked:
    """Return the jets of the outputs of g(a): D = sum g_i Da_i, D2 = sum g_i D2a_i + sum g_ij Da_i Da_j'.

    The arguments are those of ``stack_jets``; value (points, outputs), first (..., arguments), second (..., arguments,
    arguments). The result has a first axis of outputs.
    """
    _, slopes, hessians = arguments
    hessian = np.einsum("poi,iklp->oklp", first, hessians)
    hessian += np.einsum("poij,ikp,jlp->oklp", second, slopes, slopes, optimize=True)
    return value.T, np.einsum("poi,ikp->okp", first, slopes), hessian


def _outer(a: Array, b: Array) -> Array:
    return a[:, None] * b
