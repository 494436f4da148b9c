"""Functions of (x, u) that are no formulas, with their derivatives: loops, branches, tables, foreign code.

``check_derivatives`` compares given derivatives with central differences.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lin_freq_ocp.base.arrays import Array, Mask, assign, brief, positive_integer, printable, real_array, require_bool
from lin_freq_ocp.base.errors import LinFreqOCPError, ProblemError, first_line
from lin_freq_ocp.base.names import argument_order
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.formulas.operations import EXTERNAL

Arguments = ArrayLike | Formula | Sequence[Formula | float]  # formulas or numbers in place of x, or of u
_UNDEFINED = float("nan")  # stands for values where the function is not defined


# Step of central differences of the Jacobian, relative to the size of an argument: there the error of the formula, of
# the order of the step squared, and that of rounding, eps over the step, are both near 4e-11 of the Jacobian.
DIFFERENCE_STEP = float(np.finfo(np.float64).eps) ** (1 / 3)


@dataclass(frozen=True)
class FlatHessian:
    """A Hessian of zeros in place of one that is not known."""

    shape: tuple[int, int, int]

    def __call__(self, x: Array, u: Array) -> Array:
        """Return zeros."""
        return np.zeros(self.shape)


@dataclass(frozen=True, eq=False, init=False)
class DifferentiableFunction:
    """A smooth function of (x, u) given by Python functions of values and derivatives, where no formula is possible.

    Called with signals, or formulas in their place, it returns one formula for each output, which can be mixed with
    others: ``SmoothMode(f=function)``, ``region=lambda x, u: [table(x[:1], u)[0] - x[1]]``. Called with numbers, it
    returns numbers. Global bounds and problem files need formulas, and refuse it.

    Parameters
    ----------
    call : function
        Of x (n,) and u (m,), float arrays; returns (outputs,), or one number if there is one output, and always the
        same for the same arguments. Not a number (nan), or an ArithmeticError, as from 1/0: it is not defined there,
        and no mode with it applies.
    jacobian : function
        Of the same arguments; returns the derivatives by (x, u), (outputs, n + m).
    hessian : function, optional
        Of the same arguments; returns the second derivatives, (outputs, n + m, n + m). The default is central
        differences of the Jacobian, with an error near 1e-9 of its size: Newton's method then converges superlinearly,
        no longer quadratically, to the same point. Undefined differences count as 0: second derivatives steer the
        search, and no condition of the certificate has any.
    outputs : int
        Number of outputs.
    name : str
        As errors and reports show it; default: that of ``call``.
    vectorized : bool
        Whether the functions take many points at once, x (points, n) and u (points, m), and return
        (points, outputs) and so on; a search evaluates some 10^5.
    sizes : float or (n + m,)
        Typical changes of arguments near zero: steps of differences are relative to the larger of this and the
        argument.
    check_at : sequence of (x, u), optional
        Points at which to compare the derivatives with differences, see ``check_derivatives``.

    Attributes
    ----------
    dimensions : (n, m) or None
        The numbers of states and controls that it takes, if they are known.
    translation : function or None
        The function of formulas that ``from_casadi`` found.

    Raises
    ------
    ProblemError
        Naming the field, its value and the expected value; on use, also if a function raises or returns a wrong value.

    Examples
    --------
    >>> square = lfo.DifferentiableFunction(lambda x, u: x[0] ** 2, lambda x, u: [[2 * x[0], 0.0]], name="square")
    >>> [float(value) for value in square([3.0], [0.0])]
    [9.0]
    """

    call: Callable[[Array, Array], ArrayLike]
    jacobian: Callable[[Array, Array], ArrayLike]
    hessian: Callable[[Array, Array], ArrayLike] | None
    outputs: int
    name: str
    vectorized: bool
    sizes: Array
    dimensions: tuple[int, int] | None = field(repr=False)
    translation: Callable[[Sequence[Formula], int], list[Formula]] | None = field(repr=False, compare=False)
    # The values at the points of the last call: several modes, f and regions evaluate it at the same points
    _recent: dict[str, tuple[Array, Array, tuple[Array, ...]]] = field(repr=False, compare=False)
    _orders: dict[str, tuple[str, ...]] = field(repr=False, compare=False)  # of arguments

    def __init__(
        self,
        call: Callable[[Array, Array], ArrayLike],
        jacobian: Callable[[Array, Array], ArrayLike],
        hessian: Callable[[Array, Array], ArrayLike] | None = None,
        outputs: int = 1,
        name: str = "",
        *,
        vectorized: bool = False,
        sizes: ArrayLike = 1.0,
        check_at: Sequence[tuple[ArrayLike, ArrayLike]] | None = None,
    ):
        given, orders = {"call": call, "jacobian": jacobian}, dict[str, tuple[str, ...]]()
        for label, function in (given if hessian is None else given | {"hessian": hessian}).items():
            try:
                orders[label] = argument_order(function)
            except TypeError:
                advice = "lfo.from_casadi has derivatives by automatic differentiation." if label == "jacobian" else ""
                field = f"DifferentiableFunction.{label}"
                raise ProblemError(field, brief(function), "a function of (x, u)", advice) from None
        printable("DifferentiableFunction.name", name)
        require_bool("DifferentiableFunction.vectorized", vectorized)
        scale = real_array("DifferentiableFunction.sizes", sizes)
        if scale.ndim > 1 or (scale <= 0).any():
            raise ProblemError("DifferentiableFunction.sizes", brief(sizes), "one number above zero, or one each")
        assign(
            self,
            call=call,
            jacobian=jacobian,
            hessian=hessian,
            outputs=positive_integer("DifferentiableFunction.outputs", outputs),
            name=name,
            vectorized=vectorized,
            sizes=scale,
            dimensions=None,
            translation=None,
            _recent={},
            _orders=orders,
        )
        if check_at is not None:
            self.check_derivatives(check_at)

    @property
    def title(self) -> str:
        """Return the name, or that of ``call``."""
        own = str(getattr(self.call, "__name__", "function"))
        return self.name or (own if own.isidentifier() else "function")

    def __call__(self, x: Arguments, u: Arguments = ()) -> NDArray[Any]:
        """Return the outputs, (outputs,): formulas if there is a formula among x and u, else numbers.

        Parameters
        ----------
        x, u : sequences, or one formula or number
            Its n states and its m controls, by its own numbers n and m, not those of the problem.

        Raises
        ------
        ProblemError
            If these are neither formulas nor numbers, or its values have another shape.
        """
        signals = [_components(f"{self.title}.{letter}", signal) for letter, signal in (("x", x), ("u", u))]
        arguments, states = [*signals[0], *signals[1]], len(signals[0])
        self._require(states, len(signals[1]))
        formulas = [argument for argument in arguments if isinstance(argument, Formula)]
        if not formulas:
            y = real_array(f"{self.title}(x, u)", arguments)[None]
            return self.values_at(y[:, :states], y[:, states:])[0]
        zero = formulas[0] * 0.0
        converted = [zero + argument if not isinstance(argument, Formula) else argument for argument in arguments]
        for argument in converted:
            if argument.dimensions != zero.dimensions:
                got = f"signals of {argument.dimensions} and {zero.dimensions}"
                raise ProblemError(self.title, got, "the same signals")
        values = np.empty(self.outputs, dtype=object)
        if self.translation is not None:
            values[:] = self.translation(converted, states)
        else:
            node = zero.node(EXTERNAL, tuple(converted))
            values[:] = [replace(node, data=(i, states), function=self) for i in range(self.outputs)]
        return values

    def check_derivatives(self, at: Sequence[tuple[ArrayLike, ArrayLike]]) -> None:
        """Compare the Jacobian with differences of values, and the Hessian, if there is one, with those of Jacobians.

        Parameters
        ----------
        at : sequence of (x, u)
            Points within the domain, best with no numbers that are special, such as 0.

        Raises
        ------
        ProblemError
            Naming the derivative, the point, the given value and the difference.
        """
        if not isinstance(at, (Sequence, np.ndarray)) or not len(at):
            raise ProblemError("check_at", brief(at), "a list of points (x, u)")
        for i, point in enumerate(at):
            if not isinstance(point, (Sequence, np.ndarray)) or len(point) != 2:
                raise ProblemError(f"check_at[{i}]", brief(point), "a point (x, u)")
            x, u = (np.atleast_1d(real_array(f"check_at[{i}]", part)) for part in point)
            self._require(len(x), len(u))
            self._require_derivative("call", "jacobian", x, u)
            if self.hessian is not None:
                self._require_derivative("jacobian", "hessian", x, u)

    def _require_derivative(self, of: str, what: str, x: Array, u: Array) -> None:
        """Raise ProblemError if the derivative ``what`` at (x, u) differs from central differences of ``of``.

        ``scipy.differentiate`` fails where a function is undefined within its first step, and loses digits on noisy or
        rapidly changing functions unless their scale is known. Here steps of all sizes are compared.
        """
        y, sizes = np.concatenate([x, u]), self._sizes(len(x) + len(u))
        labels, where = [f"x[{i}]" for i in range(len(x))] + [f"u[{i}]" for i in range(len(u))], _place(x, u)
        stated = self._evaluate(what, x[None], u[None])[0]
        if not np.isfinite(self._evaluate(of, x[None], u[None])).all():
            advice = "Choose a point in its domain."
            raise ProblemError(f"{self.title}.{of}", f"no finite number at {where}", "finite numbers", advice)
        for j, label in enumerate(labels):
            size = float(max(abs(y[j]), sizes[j]))
            difference, doubt = _differences(lambda y: self._evaluate(of, y[:, : len(x)], y[:, len(x) :]), y, j, size)
            if not np.isfinite(difference).all():
                got = f"nothing finite on one of the sides of {label} = {y[j]:g}, at {where}"
                advice = "Choose a point inside its domain."
                raise ProblemError(f"{self.title}.{of}", got, "a function that is defined around", advice)
            derivative = stated[..., j]
            allowed = DOUBT * doubt + DERIVATIVE_TOLERANCE * np.maximum(np.abs(derivative), np.abs(difference))
            for index in np.argwhere(~(np.abs(derivative - difference) <= allowed)):  # not a number is also wrong
                at = tuple(map(int, index))
                by = " and ".join([*(labels[i] for i in at[1:]), label])
                expected = f"{difference[at]:.8g}, as differences of {of} say"
                name = "derivative" if what == "jacobian" else "second derivative"
                advice = f"It is the {name} of output {at[0]} by {by}."
                entry = f"{self.title}.{what}[{', '.join(map(str, (*at, j)))}]"
                raise ProblemError(entry, f"{derivative[at]:.8g}, at {where}", expected, advice)

    def _require(self, states: int, controls: int) -> None:
        if self.dimensions not in (None, (states, controls)):
            expected = "x ({},) and u ({},)".format(*self.dimensions)
            raise ProblemError(self.title, f"x ({states},) and u ({controls},)", expected)

    @property
    def exact_curvature(self) -> bool:
        """Whether its second derivatives are those of a Hessian of its own, neither differences nor zeros."""
        return self.hessian is not None and not isinstance(self.hessian, FlatHessian)

    def values_at(self, x: Array, u: Array) -> Array:
        """Return the values at points, (points, outputs); nan at points outside its domain.

        Parameters
        ----------
        x : (points, n), u : (points, m)
        """
        return self._recall("values", x, u, lambda: (self._evaluate("call", x, u),))[0]

    def derivatives_at(self, x: Array, u: Array) -> tuple[Array, Array, Array]:
        """Return values, (points, outputs, n + m) and (points, outputs, n + m, n + m)."""

        def compute() -> tuple[Array, Array, Array]:
            values, slopes = self._evaluate("call", x, u), self._evaluate("jacobian", x, u)
            curvatures = self._differences(x, u, slopes) if self.hessian is None else self._evaluate("hessian", x, u)
            return values, slopes, np.where(np.isfinite(curvatures), curvatures, 0.0)

        values, slopes, curvatures = self._recall("derivatives", x, u, compute)
        return values, slopes, curvatures

    def _recall(self, what: str, x: Array, u: Array, compute: Callable[[], tuple[Array, ...]]) -> tuple[Array, ...]:
        """Return arrays, read-only: those of the last call if its points were the same."""
        last = self._recent.get(what)
        if last is None or not (np.array_equal(last[0], x) and np.array_equal(last[1], u)):
            arrays = compute()
            for array in arrays:
                array.flags.writeable = False
            last = self._recent[what] = x.copy(), u.copy(), arrays
        return last[2]

    def _differences(self, x: Array, u: Array, slopes: Array) -> Array:
        """Return central differences of the Jacobian, one-sided ones where only those are defined."""
        y, states = np.hstack([x, u]), x.shape[1]
        differences = np.empty((*slopes.shape, y.shape[1]))
        steps = DIFFERENCE_STEP * np.maximum(np.abs(y), self._sizes(y.shape[1]))
        for j in range(y.shape[1]):
            sides: list[Array] = []
            points: list[Array] = []
            for sign in (1, -1):
                moved = y.copy()
                moved[:, j] += sign * steps[:, j]
                jacobian = self._evaluate("jacobian", moved[:, :states], moved[:, states:])
                defined: Mask = np.asarray(np.isfinite(jacobian).all(axis=(1, 2)))
                sides.append(np.where(defined[:, None, None], jacobian, slopes))
                points.append(np.where(defined, moved[:, j], y[:, j]))
            with np.errstate(invalid="ignore"):
                differences[..., j] = (sides[0] - sides[1]) / (points[0] - points[1])[:, None, None]
        return 0.5 * (differences + np.swapaxes(differences, 2, 3))

    def _sizes(self, arguments: int) -> Array:
        if self.sizes.ndim and len(self.sizes) != arguments:
            expected = f"{arguments}, one for each argument"
            raise ProblemError(f"{self.title}.sizes", f"{len(self.sizes)} numbers", expected)
        return np.broadcast_to(self.sizes, arguments)

    def _evaluate(self, what: str, x: Array, u: Array) -> Array:
        """Return the values of one of the functions at points, (points, outputs, ...)."""
        count = x.shape[1] + u.shape[1]
        shape = (self.outputs, *(count,) * ("call", "jacobian", "hessian").index(what))
        values = np.full((len(x), *shape), _UNDEFINED)
        defined = np.flatnonzero(np.isfinite(x).all(axis=1) & np.isfinite(u).all(axis=1))
        x, u = x[defined], u[defined]
        x.flags.writeable = u.flags.writeable = False
        with np.errstate(all="ignore"):
            if self.vectorized and len(defined):
                values[defined] = self._check_output(what, self._call_function(what, x, u), (len(x), *shape), (x, u))
                return values
            for i, point in zip(defined, zip(x, u, strict=True), strict=True):
                row = self._call_function(what, *point)
                plain = row is _UNDEFINED or (isinstance(row, float) and shape == (1,))
                values[i] = row if plain else self._check_output(what, row, shape, point)
        return values

    def _call_function(self, what: str, x: Array, u: Array) -> ArrayLike:
        try:
            return getattr(self, what)(*((x, u) if self._orders[what] == ("x", "u") else (u, x)))
        except LinFreqOCPError:
            raise
        except Exception as error:  # any error of a user's function
            if isinstance(error, ArithmeticError) and not self.vectorized:
                return _UNDEFINED
            got = f"{first_line(error)}, at {_place(x, u)}"
            advice = "Return nan where the function is not defined."
            raise ProblemError(f"{self.title}.{what}", got, "numbers", advice) from error

    def _check_output(self, what: str, output: ArrayLike, shape: tuple[int, ...], point: tuple[Array, Array]) -> Array:
        """Return the values of a function in the right shape; the axis of a single output may be missing."""
        if isinstance(output, np.ndarray) and output.dtype == np.float64 and output.shape == shape:
            return output
        try:
            array = np.asarray(output)
        except ValueError:
            array = np.asarray(None)
        if array.dtype.kind not in "iuf":
            raise ProblemError(f"{self.title}.{what}", f"{brief(output)} at {_place(*point)}", "real numbers")
        without_output = (shape[0], *shape[2:]) if self.vectorized else shape[1:]
        if array.shape != shape and (self.outputs != 1 or array.shape != without_output):
            raise ProblemError(f"{self.title}.{what}", f"shape {array.shape} at {_place(*point)}", f"shape {shape}")
        return array.astype(np.float64).reshape(shape)


def _components(field: str, signal: Any) -> list[Formula | float]:
    """Return formulas and numbers as a list, also of a single one."""
    components = [signal] if isinstance(signal, Formula) or np.ndim(signal) == 0 else list(signal)
    for component in components:
        if not isinstance(component, Formula):
            if np.ndim(component):
                raise ProblemError(field, brief(signal), "a list of formulas or numbers")
            real_array(field, component)
    return components


def _place(x: Array, u: Array) -> str:
    return f"x {x.shape}, u {u.shape}" if x.ndim > 1 else f"x = {brief(x.tolist())}, u = {brief(u.tolist())}"


# Steps of central differences, relative to the size of an argument. Of the neighbours that agree best the smaller is
# taken, so that no scale of the function need be known.
COMPARED_STEPS = 10.0 ** -np.arange(1, 11)
# Relative error up to which a derivative is right: tables and iterations in a function cost digits, and a wrong sign,
# index or factor is far larger.
DERIVATIVE_TOLERANCE = 1e-6
# The best difference is off by up to so many times the distance of its neighbour and rounding.
DOUBT = 10.0
ROUNDING = 4 * float(np.finfo(np.float64).eps)  # error of values, relative to their largest


def _differences(evaluate: Callable[[Array], Array], y: Array, j: int, size: float) -> tuple[Array, Array]:
    """Return the derivative by argument j, (...), and how far neighbouring steps are apart; not a number if none is."""
    points = np.tile(y, (2 * len(COMPARED_STEPS), 1))
    points[:, j] += np.concatenate([COMPARED_STEPS, -COMPARED_STEPS]) * size
    above, below = np.split(evaluate(points), 2)
    steps = (points[: len(COMPARED_STEPS), j] - points[len(COMPARED_STEPS) :, j]).reshape(-1, *(1,) * (above.ndim - 1))
    with np.errstate(invalid="ignore"):
        quotients = (above - below) / steps
        rounding = ROUNDING * np.maximum(np.abs(above), np.abs(below)) / np.abs(steps)
        apart = np.abs(np.diff(quotients, axis=0)) + rounding[1:]
    apart = np.where(np.isfinite(apart), apart, np.inf)
    best = np.argmin(apart, axis=0)[None]
    doubt = np.take_along_axis(apart, best, axis=0)[0]
    differences = np.take_along_axis(quotients[1:], best, axis=0)[0]
    return np.where(np.isfinite(doubt), differences, np.nan), doubt
