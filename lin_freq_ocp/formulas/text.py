"""Formulas as text, "norm(x_0, x_1) * u_0", and back: Python's arithmetic, with a few functions, and nothing else."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping, Sequence, Set
from functools import partial

import numpy as np

from lin_freq_ocp.arrays import brief
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.formulas.nodes import (
    MAXIMUM,
    MINIMUM,
    NORM,
    POWER,
    PRODUCT,
    QUOTIENT,
    SMOOTH,
    SUM,
    VARIABLE,
    Formula,
    extreme,
    in_order,
    norm,
    signals,
)

LONGEST = 100_000
"""Characters of one formula."""

ARITHMETIC: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
"""Of numbers alone."""

FUNCTION_NAMES = ("abs", "max", "min", "norm", *SMOOTH)

LONGEST_SHOWN = 300
"""Characters of a part of a formula that people are shown; instead of a longer one stand three points."""

EXPECTED = (
    "numbers, x_0, x_1, ..., u_0, ..., with + - * / ** ( ) and abs, max, min, norm, exp, log, sqrt, sin, cos, tanh, "
    "arctan, as in 'norm(x_0, x_1) * u_0'"
)


def formula_from_text(
    field: str, text: str, dimensions: tuple[int, int], known: Mapping[str, Formula] | None = None
) -> Formula:
    """Return the formula that a text says.

    Parameters
    ----------
    field : str
        What errors call it.
    text : str
        Numbers, x_0 .. x_{n-1}, u_0 .. u_{m-1}, + - * / **, and abs, max, min, norm, exp, log, sqrt, sin, cos, tanh,
        arctan.
    dimensions : (n, m)
    known : mapping from str to Formula, optional
        What names stand for; default: the signals.

    Raises
    ------
    ProblemError
        If it says anything else.
    """
    if len(text) > LONGEST:
        raise ProblemError(field, f"{len(text)} characters", f"at most {LONGEST}")
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError):
        raise ProblemError(field, brief(text), EXPECTED) from None
    except (RecursionError, MemoryError):  # the parser's words for it
        raise ProblemError(field, f"{brief(text)}, nested too deeply", "fewer terms, factors and brackets") from None
    x, u = signals(*dimensions)
    if known is None:
        known = {f"x_{i}": one for i, one in enumerate(x)} | {f"u_{i}": one for i, one in enumerate(u)}
    try:
        with np.errstate(all="ignore"):
            made = _Reader(text, known).read(tree.body)
            formula = made if isinstance(made, Formula) else x[0] * 0.0 + made
    except ProblemError as error:
        raise ProblemError(field, error.got, error.expected, error.advice) from None
    if not all(np.isfinite(one.data).all() for one in in_order([formula])):
        raise ProblemError(field, brief(text), "coefficients that are finite numbers")
    return formula


class _Reader:
    """Reads one text; errors are about "formula", which the caller replaces by the field."""

    def __init__(self, text: str, known: Mapping[str, Formula]):
        self._text, self._known = text, known

    def read(self, root: ast.expr) -> Formula | float:
        """Return what a node says, from the innermost outwards: a long sum is nested as deeply as it is long."""
        made: dict[ast.expr, Formula | float] = {}
        stack = [(root, False)]
        while stack:
            node, ready = stack.pop()
            parts = self._parts(node)
            if ready or not parts:
                made[node] = self._made(node, [made[part] for part in parts])
            else:
                stack += [(node, True), *((part, False) for part in reversed(parts))]
        return made[root]

    def _parts(self, node: ast.expr) -> list[ast.expr]:
        if isinstance(node, ast.UnaryOp):
            return [node.operand]
        if isinstance(node, ast.BinOp):
            return [node.left, node.right]
        return node.args if isinstance(node, ast.Call) else []

    def _made(self, node: ast.expr, parts: Sequence[Formula | float]) -> Formula | float:
        value = node.value if isinstance(node, ast.Constant) else None
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            return self._number(partial(float, value))
        if isinstance(node, ast.Name):
            if node.id in self._known:
                return self._known[node.id]
            raise ProblemError("formula", repr(node.id), f"one of {', '.join(self._known)}")
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.UAdd)):
            return -parts[0] if isinstance(node.op, ast.USub) else parts[0]
        if isinstance(node, ast.BinOp):
            return self._operation(node.op, *parts)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
            return self._call(node.func.id, parts)
        raise self._other()

    def _number(self, compute: Callable[[], float]) -> float:
        """Return a finite number; Python has errors of several kinds, and complex numbers, where there is none."""
        try:
            value = compute()
        except (ArithmeticError, ValueError):
            value = math.nan
        if isinstance(value, complex) or not math.isfinite(value):
            raise ProblemError("formula", brief(self._text), "finite real numbers in all its parts")
        return value

    def _other(self) -> ProblemError:
        return ProblemError("formula", brief(self._text), EXPECTED)

    def _operation(self, sign: ast.operator, left: Formula | float, right: Formula | float) -> Formula | float:
        if isinstance(left, float) and isinstance(right, float) and type(sign) in ARITHMETIC:
            return self._number(lambda: ARITHMETIC[type(sign)](left, right))
        if isinstance(sign, ast.Add):
            return left + right
        if isinstance(sign, ast.Sub):
            return left - right
        if isinstance(sign, ast.Mult):
            return left * right
        if isinstance(sign, ast.Div):
            return left / right
        if isinstance(sign, ast.Pow) and isinstance(right, float):
            return left ** (int(right) if right.is_integer() else right)
        raise self._other()

    def _call(self, name: str, arguments: Sequence[Formula | float]) -> Formula | float:
        formulas = [one for one in arguments if isinstance(one, Formula)]
        if name in ("max", "min") and len(arguments) > 1 and formulas:
            return extreme(MAXIMUM if name == "max" else MINIMUM, arguments, None)
        if name == "norm" and formulas:
            return norm(list(arguments))
        if len(arguments) == 1 and formulas and name in ("abs", *SMOOTH):
            (one,) = formulas
            return abs(one) if name == "abs" else getattr(one, name)()
        numbers = [one for one in arguments if isinstance(one, float)]
        if len(numbers) == len(arguments) > 1 and name in ("max", "min"):
            return max(numbers) if name == "max" else min(numbers)
        if len(arguments) == 1 and numbers and name in ("abs", *SMOOTH):
            return self._number(lambda: float(abs(numbers[0]) if name == "abs" else getattr(np, name)(numbers[0])))
        raise self._other()


def source_of(one: Formula, field: str = "formula") -> str:
    """Return the text from which ``formula_from_text`` makes the same formula, to the last bit.

    Raises
    ------
    ProblemError
        If it has functions that are no formulas.
    """
    for node in in_order([one]):
        require_formula(node, field)
    return _text(one, None, repr)


def require_formula(one: Formula, field: str = "formula") -> None:
    """Raise ProblemError if a node is a function that is no formula."""
    if one.function is not None:
        raise ProblemError(field, f"the function {one.function.title}", "formulas, which are text in a file")


def text_of(one: Formula, labels: Sequence[str] | None = None) -> str:
    """Return a formula for people, with rounded numbers and the given names of states and controls, shortened."""
    return _text(one, labels, lambda value: f"{value:.4g}", LONGEST_SHOWN)


def _text(
    one: Formula, labels: Sequence[str] | None, number: Callable[[float], str], longest: float = float("inf")
) -> str:
    made: dict[Formula, str] = {}
    for node in in_order([one]):
        if node.kind == VARIABLE:
            made[node] = text_of_variable(node, labels)
            continue
        parts = [made[argument] for argument in node.arguments]
        cut = {i for i, part in enumerate(parts) if len(part) > longest}
        if len(parts) > longest / 2:
            made[node] = "..."
        else:
            made[node] = composed(node, ["..." if i in cut else part for i, part in enumerate(parts)], number, cut)
    return made[one]


def text_of_variable(one: Formula, labels: Sequence[str] | None) -> str:
    """Return the label of a signal, or x_i or u_i."""
    n, i = one.dimensions[0], int(one.data[0])
    return labels[i] if labels else f"x_{i}" if i < n else f"u_{i - n}"


def composed(one: Formula, parts: Sequence[str], number: Callable[[float], str], whole: Set[int]) -> str:
    """Return the text of a node from those of its arguments, of which some are ``whole``: names without brackets."""
    if one.kind == SUM:
        return _sum(one, parts, number, whole)
    if one.kind in (PRODUCT, QUOTIENT):
        first = parts[0] if 0 in whole else _bracketed(one.arguments[0], parts[0])
        return f"{first} {'*' if one.kind == PRODUCT else '/'} ({parts[1]})"
    if one.kind == POWER:
        return f"({parts[0]})**{one.data[0]:g}"
    if one.function is not None:
        return f"{one.function.title}({', '.join(parts)})[{int(one.data[0])}]"
    name = {MAXIMUM: "max", MINIMUM: "min", NORM: "norm"}.get(one.kind, one.kind)
    return f"{name}({', '.join(parts)})"


def _sum(one: Formula, parts: Sequence[str], number: Callable[[float], str], whole: Set[int]) -> str:
    text = ""
    for i, (factor, argument, part) in enumerate(zip(one.data[:-1], one.arguments, parts, strict=True)):
        size = "" if abs(factor) == 1 else f"{number(abs(factor))} * "
        sign = (" - " if factor < 0 else " + ") if text else ("-" if factor < 0 else "")
        text += sign + size + (part if factor == 1 or i in whole else _bracketed(argument, part))
    if one.data[-1] or not text:
        value = one.data[-1]
        text += f" {'-' if value < 0 else '+'} {number(abs(value))}" if text else number(value)
    return text


def _bracketed(one: Formula, text: str) -> str:
    return f"({text})" if one.kind in (SUM, PRODUCT, QUOTIENT) else text
