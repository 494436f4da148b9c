"""Functions of CasADi, as formulas if these have all operations; with CasADi's derivatives otherwise."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, partial
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from lin_freq_ocp.base.arrays import Array, assign, brief, positive_integer, require_bool
from lin_freq_ocp.base.errors import ProblemError, first_line, missing_extra
from lin_freq_ocp.base.names import argument_order
from lin_freq_ocp.formulas.differentiable import DifferentiableFunction
from lin_freq_ocp.formulas.nodes import LARGEST_POWER, Formula, extreme, norm, signals
from lin_freq_ocp.formulas.operations import MAXIMUM, MINIMUM, POWER, SUM

if TYPE_CHECKING:
    from casadi import Function

# Operations of CasADi with kinks or jumps, which their derivatives do not show.
KINKED = ("FABS", "FMAX", "FMIN", "MMAX", "MMIN", "SIGN", "COPYSIGN", "FLOOR", "CEIL", "FMOD", "REMAINDER",
          "IF_ELSE_ZERO", "NORM1", "NORMINF")  # fmt: skip
FUNCTIONS = ("SIN", "COS", "TAN", "SINH", "COSH", "TANH")  # each with its inverse
# Operations of CasADi that formulas have; constants among them are folded by CasADi.
OPERATIONS: dict[str, Callable[..., Formula]] = {
    "ASSIGN": lambda a: a,
    "ADD": lambda a, b: a + b,
    "SUB": lambda a, b: a - b,
    "MUL": lambda a, b: a * b,
    "DIV": lambda a, b: a / b,
    "NEG": lambda a: -a,
    "TWICE": lambda a: 2.0 * a,
    "SQ": lambda a: a**2,
    "INV": lambda a: 1.0 / a,
    "SQRT": lambda a: _root(a),
    **{name: getattr(np, name.lower()) for name in ("EXP", "LOG", *FUNCTIONS)},
    **{f"A{name}": getattr(np, f"arc{name.lower()}") for name in FUNCTIONS},
    "ATAN2": Formula.arctan2,
    "POW": lambda a, b: _power(a, b),
    "CONSTPOW": lambda a, b: _power(a, b),
    "FABS": Formula.__abs__,
    "HYPOT": lambda a, b: norm([a, b]),
    "FMAX": lambda a, b: extreme(MAXIMUM, (a, b), None),
    "FMIN": lambda a, b: extreme(MINIMUM, (a, b), None),
}


def from_casadi(
    function: Function | Callable[..., object],
    states: int | None = None,
    controls: int | None = None,
    name: str = "",
    smooth: bool = False,
) -> DifferentiableFunction:
    """Return a function of CasADi as one that makes formulas, with exact derivatives.

    If formulas have all its operations, the function becomes formulas: maxima, minima and absolute values then make
    modes in ``PiecewiseSmoothDynamics.from_formulas``, and global bounds and problem files are possible. CasADi
    differentiates any other function twice.

    Parameters
    ----------
    function : casadi.Function, or Python function
        A casadi.Function of columns x and u that returns one column; or a Python function that is called with
        casadi.SX columns x and u and returns an expression, or a list of them.
    states, controls : int
        n and m; a casadi.Function knows them.
    name : str
        As errors and reports show it; default: that of the function.
    smooth : bool
        Whether the function is twice differentiable in spite of its maxima, absolute values or branches, as fabs(x)**3.
        Functions that it calls, such as interpolants, are assumed to be.

    Returns
    -------
    DifferentiableFunction

    Raises
    ------
    MissingExtraError
        If casadi is not installed.
    ProblemError
        If it is no such function, or has kinks that its derivatives do not show.

    Examples
    --------
    >>> import casadi
    >>> square = lfo.from_casadi(lambda x, u: x[0] ** 2 + u[0], 1, 1)
    >>> [float(value) for value in square([2.0], [1.0])]
    [5.0]
    """
    casadi = _casadi()
    require_bool("from_casadi.smooth", smooth)
    native: type[Function] = casadi.Function
    if isinstance(function, native):
        swapped = function.name_in() == ["u", "x"]
        compiled = function.factory(function.name(), ["x", "u"], function.name_out()) if swapped else function
    elif callable(function):
        n, m = positive_integer("from_casadi.states", states), positive_integer("from_casadi.controls", controls)
        x, u = casadi.SX.sym("x", n), casadi.SX.sym("u", m)
        try:
            outputs = function(*((x, u) if argument_order(function) == ("x", "u") else (u, x)))
            column = casadi.vertcat(*outputs) if isinstance(outputs, (Sequence, np.ndarray)) else casadi.SX(outputs)
        except Exception as error:  # any error of a function that was not made for symbols
            got = f"{first_line(error)}, from the function"
            raise ProblemError("from_casadi", got, "an expression of casadi.SX columns x and u, or a list") from error
        compiled = casadi.Function("f", [x, u], [column])
    else:
        raise ProblemError("from_casadi", brief(function), "a casadi.Function of (x, u), or a Python function")
    if (compiled.n_in(), compiled.n_out()) != (2, 1):
        got = f"{compiled.n_in()} inputs and {compiled.n_out()} outputs"
        raise ProblemError(f"from_casadi: {compiled.name()}", got, "columns x and u, and one output")
    for size in (compiled.size_in(0), compiled.size_in(1), compiled.size_out(0)):
        if size[1] != 1 or not size[0]:
            raise ProblemError(f"from_casadi: {compiled.name()}", f"a matrix {size[0]} x {size[1]}", "columns")
    for i, (label, stated) in enumerate((("states", states), ("controls", controls))):
        if stated is not None and stated != compiled.size1_in(i):
            raise ProblemError(f"from_casadi.{label}", brief(stated), f"{compiled.size1_in(i)}, as the function has")
    own_name = str(compiled.name() if isinstance(function, native) else getattr(function, "__name__", ""))
    title = name or (own_name if own_name.isidentifier() else "")  # a lambda has none
    with_derivatives = _Compiled(compiled, _serialize_function(compiled))
    value, jacobian, hessian = (partial(with_derivatives, what) for what in ("value", "jacobian", "hessian"))
    result = DifferentiableFunction(value, jacobian, hessian, compiled.size1_out(0), title, vectorized=True)
    assign(result, dimensions=(compiled.size1_in(0), compiled.size1_in(1)))
    _translate(casadi, compiled, result, smooth)
    return result


def _translate(casadi: ModuleType, compiled: Function, result: DifferentiableFunction, smooth: bool) -> None:
    """Let a function make formulas where these have all its operations; else it must not have kinks."""
    program = compiled
    if not compiled.is_a("SXFunction"):
        with suppress(RuntimeError):  # it calls a function that has no scalar operations
            program = compiled.expand()
    codes = {program.instruction_id(k) for k in range(program.n_instructions())}
    kinked = [operation for operation in KINKED if getattr(casadi, f"OP_{operation}") in codes]
    known = {casadi.OP_CONST, casadi.OP_INPUT, casadi.OP_OUTPUT, *_operations(casadi)}
    if program.is_a("SXFunction") and codes <= known and not (smooth and kinked):
        translation, n = _Translation(program, _serialize_function(program)), program.size1_in(0)
        with suppress(ProblemError):  # a power that formulas do not have
            translation([variable for part in signals(n, program.size1_in(1)) for variable in part], n)
            assign(result, translation=translation)
            return
    if kinked and not smooth:
        advice = "Write a mode for each side of a kink, or say smooth=True if there is none."
        got = f"{', '.join(kinked).lower()}, with operations that formulas do not have"
        raise ProblemError(f"from_casadi: {result.title}", got, "a smooth function", advice)


def _operations(casadi: ModuleType) -> dict[int, Callable[..., Formula]]:
    """Return ``OPERATIONS`` by the codes of CasADi."""
    return {getattr(casadi, f"OP_{name}"): operation for name, operation in OPERATIONS.items()}


def _casadi() -> ModuleType:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of the types that its binding makes
            return import_module("casadi")
    except ImportError:
        raise missing_extra("from_casadi", "casadi", "casadi") from None


def _serialize_function(compiled: Function) -> str:
    try:
        return str(compiled.serialize())
    except RuntimeError:  # it calls a function that has no text
        return str(compiled)


@dataclass(frozen=True)
class _Compiled:
    """Values and derivatives of a function at points, x (points, n) and u (points, m)."""

    function: Function = field(compare=False)
    text: str  # by which functions differ, also in other processes

    def __call__(self, what: str, x: Array, u: Array) -> Array:
        function = self._functions[what]
        columns = function(x.T, u.T).full()
        outputs, points, count = columns.shape[0], len(x), x.shape[1] + u.shape[1]
        if what == "value":
            return np.ascontiguousarray(columns.T)
        rows = columns.reshape(outputs, points, -1).swapaxes(0, 1)
        return rows if what == "jacobian" else rows.reshape(points, -1, count, count)

    @cached_property
    def _functions(self) -> dict[str, Function]:
        """Functions of (x, u): values (k, 1), Jacobian (k, n + m), Hessians (k (n + m), n + m)."""
        casadi, compiled = _casadi(), self.function
        kind = casadi.SX if compiled.is_a("SXFunction") else casadi.MX
        x, u = kind.sym("x", compiled.size1_in(0)), kind.sym("u", compiled.size1_in(1))
        y, value = casadi.vertcat(x, u), compiled(x, u)
        jacobian = casadi.jacobian(value, y)
        hessian = casadi.jacobian(casadi.vec(jacobian.T), y)  # row after row: output 0 by all arguments, output 1 ...
        outputs = {"value": value, "jacobian": jacobian, "hessian": hessian}
        return {what: casadi.Function(what, [x, u], [casadi.densify(output)]) for what, output in outputs.items()}


@dataclass(frozen=True)
class _Translation:
    """A function in scalar operations that formulas have."""

    function: Function = field(compare=False)
    text: str

    def __call__(self, arguments: Sequence[Formula], states: int) -> list[Formula]:
        """Return its outputs, with formulas for the components of x and u."""
        casadi, program = _casadi(), self.function
        inputs = arguments[:states], arguments[states:]
        zero = arguments[0] * 0.0
        operations = _operations(casadi)
        rows = program.sparsity_out(0).row()
        values, work = [zero] * program.size1_out(0), [zero] * program.sz_w()
        for k in range(program.n_instructions()):
            code, used, to = program.instruction_id(k), program.instruction_input(k), program.instruction_output(k)
            if code == casadi.OP_CONST:
                work[to[0]] = zero + program.instruction_constant(k)
            elif code == casadi.OP_INPUT:
                work[to[0]] = inputs[used[0]][program.sparsity_in(used[0]).row()[used[1]]]
            elif code == casadi.OP_OUTPUT:
                values[rows[to[1]]] = work[used[0]]
            else:
                work[to[0]] = operations[code](*(work[i] for i in used))
        return values


def _power(base: Formula, exponent: Formula) -> Formula:
    """Return base**exponent, which only some constants may be."""
    value = exponent.constant
    if value in (0.0, 1.0):
        return base if value else base * 0.0 + 1.0
    if value == 0.5:
        return _root(base)
    if value is not None and value in range(-LARGEST_POWER, 0):
        return 1.0 / _power(base, -exponent)
    return base ** (exponent if value is None else value)


def _root(a: Formula) -> Formula:
    """Return the square root; of a sum of squares as a norm, whose kink is known."""
    squares = a.kind == SUM and a.data[-1] == 0 and all(factor > 0 for factor in a.data[:-1])
    if squares and all(square.kind == POWER and square.data == (2.0,) for square in a.arguments):
        weighted = zip(a.arguments, a.data[:-1], strict=True)
        return norm([square.arguments[0] * factor**0.5 for square, factor in weighted])
    return a.sqrt()
