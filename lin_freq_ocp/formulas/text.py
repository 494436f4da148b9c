"""Formulas as text, "norm(x_0, x_1) * u_0", and back: Python's arithmetic with a few functions.

Written texts have a moderate length: parts that are shared, long or deeply nested get names.
"""

from __future__ import annotations

import ast
import keyword
import math
import operator
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from lin_freq_ocp.base.arrays import brief
from lin_freq_ocp.base.errors import LinFreqOCPError, ProblemError, first_line, rename_field, suggestion
from lin_freq_ocp.base.names import argument_order
from lin_freq_ocp.base.phrases import plural
from lin_freq_ocp.formulas import nodes
from lin_freq_ocp.formulas.nodes import Formula, Value, post_order
from lin_freq_ocp.formulas.operations import (
    ANGLE,
    LOOK_UP,
    MAXIMUM,
    MINIMUM,
    OPERATIONS,
    SUM,
    VARIABLE,
    Notation,
    scalar_functions,
)

LONGEST_FORMULA = 100_000  # characters of one formula
MOST_LEVELS = 1500  # of operations within one another, as a sum of so many terms has: each version of Python reads more
# User input for formulas of x and u, such as "x_0 + u_0"; a function is called with signals
Formulas = Formula | str | Sequence[Formula | str | float] | Callable[..., object]
ARITHMETIC: dict[type[ast.operator], Callable[..., float]] = {  # of numbers, and of formulas, with a formula as result
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}


def function_names() -> tuple[str, ...]:
    """Return the names of all functions that a text may call."""
    return ("abs", "max", "min", "norm", *scalar_functions(), ANGLE, LOOK_UP)


def known_signals(dimensions: tuple[int, int]) -> dict[str, Formula]:
    """Return x_0 .., u_0 .. and the time t by name."""
    x, u = nodes.signals(*dimensions)
    names = {f"x_{i}": variable for i, variable in enumerate(x)} | {f"u_{i}": variable for i, variable in enumerate(u)}
    return names | {"t": nodes.time_of(dimensions)}


def listed_formulas(field: str, formulas: object, dimensions: tuple[int, int]) -> tuple[Formula, ...]:
    """Return formulas, texts and numbers, or those that a function of signals returns, as formulas."""
    if callable(formulas):
        try:
            signals = dict(zip("xut", (*nodes.signals(*dimensions), nodes.time_of(dimensions)), strict=True))
            try:
                order = argument_order(formulas, on_request="t")
            except TypeError:  # it may take some of the signals by their names
                order = argument_order(formulas, (), "xut")
            formulas = formulas(*(signals[name] for name in order))
        except LinFreqOCPError:
            raise
        except Exception as error:  # any error of a function that was not made for formulas
            got = f"{first_line(error)}, from the function"
            expected = f"one that makes formulas of x ({dimensions[0]},) and u ({dimensions[1]},)"
            advice = f"It is called once, with lfo.signals. {nodes.FUNCTIONS} lfo.from_casadi takes those of CasADi."
            raise ProblemError(field, got, expected, advice) from error
    if isinstance(formulas, (Formula, str)):
        formulas = [formulas]
    if not isinstance(formulas, (Sequence, np.ndarray)):
        expected = "a list of formulas made of lfo.signals(n, m), or a function of (x, u)"
        raise ProblemError(field, brief(formulas), expected)
    zero, converted = Formula(dimensions, SUM, (), (0.0,)), list[Formula]()
    for i, entry in enumerate(formulas):
        if isinstance(entry, str):
            entry = formula_from_text(f"{field}[{i}]", entry, dimensions)
        formula = entry if isinstance(entry, Formula) else nodes.as_formula(zero, f"{field}[{i}]", entry)
        if formula.dimensions != dimensions:
            expected = f"{plural(dimensions[0], 'state')} and {plural(dimensions[1], 'control')}"
            raise ProblemError(f"{field}[{i}]", f"signals of {formula.dimensions}", expected)
        converted.append(formula)
    return tuple(converted)


def formula_from_text(
    field: str, text: str, dimensions: tuple[int, int], known: Mapping[str, Formula] | None = None
) -> Formula:
    """Return the formula of a text; errors name the field.

    It has numbers, x_0 .. x_{n-1}, u_0 .. u_{m-1}, t or the names in ``known``, + - * / **, and ``function_names``.
    """
    if len(text) > LONGEST_FORMULA:
        raise ProblemError(field, f"{len(text)} characters", f"at most {LONGEST_FORMULA}")
    reader = _Reader(text, known_signals(dimensions) if known is None else known)
    try:
        root = ast.parse(text.strip(), mode="eval").body
        if reader.evaluate(root, lambda _, levels: 1 + max(levels, default=-1)) > MOST_LEVELS:
            raise RecursionError
    except (SyntaxError, ValueError):
        raise ProblemError(field, brief(text), _expected_text()) from None
    except (RecursionError, MemoryError):  # also of the parser
        raise ProblemError(field, f"{brief(text)}, nested too deeply", "fewer terms, factors and brackets") from None
    with np.errstate(all="ignore"), rename_field(lambda _: field):
        zero = Formula(dimensions, SUM, (), (0.0,))
        formula = nodes.as_formula(zero, "formula", reader.evaluate(root, reader.apply_operation))
    if not all(np.isfinite(node.data).all() for node in nodes.nodes_in_order([formula])):
        raise ProblemError(field, brief(text), "coefficients that are finite numbers")
    return formula


def _expected_text() -> str:
    names = ", ".join(function_names())
    return f"numbers, x_0, x_1, ..., u_0, ..., t, with + - * / ** ( ) and {names}, as in 'norm(x_0, x_1) * u_0'"


class _Reader:
    """Reads one text; errors are about "formula", which the caller replaces by the field."""

    def __init__(self, text: str, known: Mapping[str, Formula]):
        self._text, self._known = text, known

    def evaluate(self, root: ast.expr, rule: Callable[[ast.expr, list[Value]], Value]) -> Value:
        """Return the value of a syntax tree by a rule, which takes a node and the values of its operands."""
        values: dict[ast.expr, Value] = {}
        for node in post_order([root], self._operands):
            values[node] = rule(node, [values[part] for part in self._operands(node)])
        return values[root]

    def _operands(self, node: ast.expr) -> list[ast.expr]:
        if isinstance(node, ast.BinOp):
            return [node.left, node.right]
        if isinstance(node, ast.UnaryOp):
            return [node.operand]
        return node.args if isinstance(node, ast.Call) else []

    def apply_operation(self, node: ast.expr, parts: list[Formula | float]) -> Formula | float:
        """Return the formula or number of a node."""
        value = node.value if isinstance(node, ast.Constant) else None
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            return self._number(partial(float, value))
        if isinstance(node, ast.Name):
            if node.id in self._known:
                return self._known[node.id]
            advice = "" if "_" in node.id else suggestion(node.id, self._known)  # x1 for x_1
            raise ProblemError("formula", repr(node.id), f"one of {', '.join(self._known)}", advice)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.UAdd)):
            return -parts[0] if isinstance(node.op, ast.USub) else parts[0]
        if isinstance(node, ast.BinOp):
            return self._operation(node.op, *parts)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
            return self._call(node.func.id, parts)
        raise self._other()

    def _number(self, compute: Callable[[], float]) -> float:
        """Return a finite number; ProblemError if Python raises an error or returns a complex or infinite number."""
        try:
            value = compute()
        except (ArithmeticError, ValueError):
            value = math.nan
        if isinstance(value, complex) or not math.isfinite(value):
            raise ProblemError("formula", brief(self._text), "finite real numbers in all its parts")
        return value

    def _other(self, advice: str = "") -> ProblemError:
        return ProblemError("formula", brief(self._text), _expected_text(), advice)

    def _operation(self, sign: ast.operator, left: Formula | float, right: Formula | float) -> Formula | float:
        compute = ARITHMETIC.get(type(sign))
        if compute is None or (isinstance(sign, ast.Pow) and isinstance(right, Formula)):
            raise self._other("A power is written x_0**2." if isinstance(sign, ast.BitXor) else "")
        if isinstance(left, float) and isinstance(right, float):
            return self._number(lambda: compute(left, right))
        if isinstance(sign, ast.Pow) and isinstance(right, float) and right.is_integer():
            right = int(right)
        return compute(left, right)

    def _call(self, name: str, arguments: Sequence[Formula | float]) -> Formula | float:
        numbers = [argument for argument in arguments if isinstance(argument, float)]
        constant, functions = len(numbers) == len(arguments), scalar_functions()
        if name in ("max", "min") and len(arguments) > 1:
            if constant:
                return max(numbers) if name == "max" else min(numbers)
            return nodes.extreme(MAXIMUM if name == "max" else MINIMUM, arguments, None)
        if name == ANGLE and len(arguments) == 2:
            if constant:
                return self._number(lambda: math.atan2(*numbers))
            like = next(one for one in arguments if isinstance(one, Formula))
            return nodes.as_formula(like, name, arguments[0]).arctan2(arguments[1])
        if name == LOOK_UP and len(arguments) > 1 and isinstance(arguments[0], Formula):
            if len(numbers) < len(arguments) - 1:
                raise self._other()
            return arguments[0].look_up(numbers)
        if name == "norm" and not constant:
            return nodes.norm(list(arguments))
        if len(arguments) == 1 and name == "abs":
            return abs(arguments[0])
        if len(arguments) == 1 and name in functions:
            (argument,) = arguments
            if isinstance(argument, Formula):
                return argument.node(name, (argument,))
            return self._number(lambda: float(functions[name].function(np.array(argument))))
        if name not in function_names():
            expected = f"one of {', '.join(function_names())}"
            raise ProblemError("formula", f"the function {name!r}", expected, suggestion(name, function_names()))
        raise self._other()


def read_definitions(field: str, table: object, dimensions: tuple[int, int]) -> dict[str, Formula]:
    """Return signals and named formulas, each of which may use the earlier ones; errors name the field of the table."""
    if not isinstance(table, Mapping):
        raise ProblemError(field, brief(table), 'a table of formulas by name, as let = {drag = "x_1 * abs(x_1)"}')
    known = known_signals(dimensions)
    for name, text in table.items():
        entry = f"{field}.{name}"
        if not isinstance(name, str) or not name.isidentifier() or not name.isascii() or keyword.iskeyword(name):
            raise ProblemError(field, brief(name), "names of letters, digits and _, which begin with no digit")
        if (name in known and name != "t") or name in function_names():  # files older than the time may define t
            raise ProblemError(entry, "the name of a signal or a function", "another name")
        if isinstance(text, bool) or not isinstance(text, (str, int, float)):
            raise ProblemError(entry, brief(text), "a formula in quotes, or a number")
        known[name] = formula_from_text(entry, str(text), dimensions, known)
    return known


def require_formula(node: Formula, field: str = "formula") -> None:
    """Raise ProblemError if a node is an external function."""
    if node.function is not None:
        raise ProblemError(field, f"the function {node.function.title}", "formulas, which are text in a file")


LONGEST_TEXT = 1000  # characters of a formula that is written in full, even if parts of it repeat
SHORTEST_NAMED = 12  # characters of a shared part from which a name makes the text shorter
DEEPEST = 20  # depth of brackets in one text: parsers accept some hundred
MOST_TERMS = 50  # terms of a sum in one text: parsers nest sums
EXACT = Notation(repr)  # numbers to the last bit


def with_definitions(formulas: Sequence[Formula]) -> tuple[list[str], dict[str, str]]:
    """Return the texts of formulas, and the named formulas that they use, each after those that it uses.

    If no formula has more than ``LONGEST_TEXT`` characters, all are written in full. Otherwise a part of several
    formulas gets a name, so that the length of all texts is proportional to the number of nodes.

    The formulas have no external functions.
    """
    order = nodes.nodes_in_order(formulas)
    uses = Counter(argument for node in order for argument in node.arguments) + Counter(formulas)

    def length(node: Formula, arguments: list[int]) -> int:
        """Return the approximate number of characters of a formula in full."""
        numbers = 0 if node.kind == VARIABLE else sum(len(f"{value!r}") + 3 for value in node.data)
        return 4 + numbers + sum(arguments) + 2 * len(arguments)

    long = max(nodes.evaluate(formulas, length), default=0) > LONGEST_TEXT
    shared = {node for node, count in uses.items() if count > 1} if long else set()
    writer = _Writer(shared)
    for node in order:
        writer.add(node)
    return [writer.part(node)[0] for node in formulas], writer.definitions


class _Writer:
    """Writes nodes, arguments first."""

    def __init__(self, shared: set[Formula]):
        self.definitions: dict[str, str] = {}
        self._shared = shared
        self._written: dict[Formula, tuple[str, int]] = {}

    def add(self, node: Formula) -> None:
        """Write one node."""
        parts = [self.part(argument) for argument in node.arguments]
        texts = [text for text, _ in parts]
        if node.kind == SUM and len(texts) > MOST_TERMS:
            self._written[node] = self._long_sum(node, texts), 1
            return
        whole = {i for i, (_, depth) in enumerate(parts) if depth == 0}
        depth = 0 if node.kind == VARIABLE else 1 + max((depth for _, depth in parts), default=0)
        self._written[node] = OPERATIONS[node.kind].text(node, texts, EXACT, whole), depth

    def part(self, node: Formula) -> tuple[str, int]:
        """Return the text of a node within another one, and its depth of nesting: 0 for a name."""
        text, depth = self._written[node]
        large = len(text) > LONGEST_TEXT or depth > DEEPEST
        if depth and (large or (node in self._shared and len(text) >= SHORTEST_NAMED)):
            self._written[node] = self._short(text), 0
        return self._written[node]

    def _long_sum(self, node: Formula, texts: Sequence[str]) -> str:
        """Return the sum of the names of its parts, from which reading makes one sum again."""
        names: list[str] = []
        for first in range(0, len(texts), MOST_TERMS):
            terms = slice(first, first + MOST_TERMS)
            last = first + MOST_TERMS >= len(texts)
            factors = (*node.data[:-1][terms], node.data[-1] if last else 0.0)
            partial_sum = Formula(node.dimensions, SUM, node.arguments[terms], factors)
            whole = {i for i, argument in enumerate(partial_sum.arguments) if not self._written[argument][1]}
            names.append(self._short(OPERATIONS[SUM].text(partial_sum, texts[terms], EXACT, whole)))
        while len(names) > MOST_TERMS:
            names = [
                self._short(" + ".join(names[first : first + MOST_TERMS])) for first in range(0, len(names), MOST_TERMS)
            ]
        return " + ".join(names)

    def _short(self, text: str) -> str:
        name = f"w_{len(self.definitions)}"
        self.definitions[name] = text
        return name
