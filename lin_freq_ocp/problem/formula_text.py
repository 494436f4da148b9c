"""Formulas as text, "norm(x_0, x_1) * u_0", and back: Python's arithmetic, with a few functions, and nothing else."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem.arrays import brief
from lin_freq_ocp.problem.formulas import (
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

EXPECTED = (
    "numbers, x_0, x_1, ..., u_0, ..., with + - * / ** ( ) and abs, max, min, norm, exp, log, sqrt, sin, cos, tanh, "
    "arctan, as in 'norm(x_0, x_1) * u_0'"
)


def formula_from_text(field: str, text: str, dimensions: tuple[int, int]) -> Formula:
    """Return the formula that a text says.

    Parameters
    ----------
    field : str
        What errors call it.
    text : str
        Numbers, x_0 .. x_{n-1}, u_0 .. u_{m-1}, + - * / **, and abs, max, min, norm, exp, log, sqrt, sin, cos, tanh,
        arctan.
    dimensions : (n, m)

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

    def __init__(self, text: str, known: dict[str, Formula]):
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
        if node.function is not None:
            raise ProblemError(field, f"the function {node.function.title}", "formulas, which are text in a file")
    return _text(one, None, repr)


def text_of(one: Formula, labels: Sequence[str] | None = None) -> str:
    """Return a formula for people, with rounded numbers and the given names of states and controls."""
    return _text(one, labels, lambda value: f"{value:.4g}")


def _text(one: Formula, labels: Sequence[str] | None, number: Callable[[float], str]) -> str:
    n = one.dimensions[0]
    if one.kind == VARIABLE:
        i = int(one.data[0])
        return labels[i] if labels else f"x_{i}" if i < n else f"u_{i - n}"
    parts = [_text(argument, labels, number) for argument in one.arguments]
    if one.kind == SUM:
        return _sum(one, parts, number)
    if one.kind in (PRODUCT, QUOTIENT):
        return f"{_bracketed(one.arguments[0], parts[0])} {'*' if one.kind == PRODUCT else '/'} ({parts[1]})"
    if one.kind == POWER:
        return f"({parts[0]})**{one.data[0]:g}"
    if one.function is not None:
        return f"{one.function.title}({', '.join(parts)})[{int(one.data[0])}]"
    name = {MAXIMUM: "max", MINIMUM: "min", NORM: "norm"}.get(one.kind, one.kind)
    return f"{name}({', '.join(parts)})"


def _sum(one: Formula, parts: Sequence[str], number: Callable[[float], str]) -> str:
    text = ""
    for factor, argument, part in zip(one.data[:-1], one.arguments, parts, strict=True):
        size = "" if abs(factor) == 1 else f"{number(abs(factor))} * "
        sign = (" - " if factor < 0 else " + ") if text else ("-" if factor < 0 else "")
        text += sign + size + (_bracketed(argument, part) if factor != 1 else part)
    if one.data[-1] or not text:
        value = one.data[-1]
        text += f" {'-' if value < 0 else '+'} {number(abs(value))}" if text else number(value)
    return text


def _bracketed(one: Formula, text: str) -> str:
    return f"({text})" if one.kind in (SUM, PRODUCT, QUOTIENT) else text
