"""Formulas at points: their values, and with them their first and second derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.formulas.nodes import (
    EXTERNAL,
    NORM,
    POWER,
    PRODUCT,
    QUOTIENT,
    SUM,
    VARIABLE,
    External,
    Formula,
    in_order,
)


@dataclass(frozen=True, eq=False)
class Jets:
    """Formulas at points y = (x, u), with derivatives.

    Attributes
    ----------
    values : (points, formulas)
    slopes : (points, formulas, n + m)
    curvatures : (points, formulas, n + m, n + m)
    """

    values: Array
    slopes: Array
    curvatures: Array


def jets(formulas: Sequence[Formula], y: Array, selections: Mapping[Formula, Array] | None = None) -> Jets:
    """Return formulas without maxima and minima at points, with derivatives; what is undefined there is not a number.

    Parameters
    ----------
    y : (points, n + m)
    selections : mapping from norms to (points, components), optional
        Where the rows are numbers, they stand for the derivative of the norm by its arguments, and its curvature is 0.
        At zero without a selection, the derivative is 0.
    """
    points, k = y.shape
    found: dict[Formula, _Jet] = {}
    called: dict[_Call, _Jet] = {}
    with np.errstate(all="ignore"):
        for one in in_order(formulas):
            arguments = [found[argument] for argument in one.arguments]
            if one.kind == EXTERNAL:
                found[one] = _external(one, arguments, called)
            else:
                found[one] = _jet(one, arguments, y, (selections or {}).get(one))
    shape = (points, len(formulas))
    values, slopes = np.empty(shape), np.empty((*shape, k))
    curvatures = np.empty((*shape, k, k))
    for place, one in enumerate(formulas):
        values[:, place], slopes[:, place], curvatures[:, place] = found[one]
    return Jets(values, slopes, curvatures)


def values_of(formulas: Sequence[Formula], y: Array) -> Array:
    """Return the values of formulas without maxima and minima alone, (points, formulas), at y (points, n + m)."""
    found: dict[Formula, Array] = {}
    called: dict[_Call, Array] = {}
    with np.errstate(all="ignore"):
        for one in in_order(formulas):
            arguments = [found[argument] for argument in one.arguments]
            if one.kind == EXTERNAL:
                found[one] = _external_value(one, arguments, called)
            else:
                found[one] = _value(one, arguments, y)
    return np.stack([found[one] for one in formulas], axis=1) if formulas else np.empty((len(y), 0))


def _value(one: Formula, arguments: Sequence[Array], y: Array) -> Array:
    if one.kind == VARIABLE:
        return y[:, int(one.data[0])]
    if one.kind == SUM:
        total = np.full(len(y), one.data[-1])
        for factor, argument in zip(one.data[:-1], arguments, strict=True):
            total += factor * argument
        return total
    if one.kind == PRODUCT:
        return arguments[0] * arguments[1]
    if one.kind == QUOTIENT:
        return arguments[0] / arguments[1]
    if one.kind == NORM:
        return np.linalg.norm(np.stack(arguments, axis=1), axis=1)
    return _smooth(one, arguments[0])[0]


_Jet = tuple[Array, Array, Array]
_Call = tuple[External, tuple[Formula, ...]]
"""An external function of some arguments: evaluated once for all its outputs."""


def _external_value(one: Formula, arguments: Sequence[Array], called: dict[_Call, Array]) -> Array:
    assert one.function is not None  # the kind has one
    output, states = map(int, one.data)
    key = one.function, one.arguments
    if key not in called:
        a = np.stack(arguments, axis=1)
        called[key] = one.function.values_at(a[:, :states], a[:, states:])
    return called[key][:, output]


def _external(one: Formula, arguments: Sequence[_Jet], called: dict[_Call, _Jet]) -> _Jet:
    """Return g(a): D = sum g_i Da_i, D2 = sum g_i D2a_i + sum g_ij Da_i Da_j'."""
    assert one.function is not None  # the kind has one
    output, states = map(int, one.data)
    key = one.function, one.arguments
    if key not in called:
        a, slopes, curvatures = (np.stack([jet[part] for jet in arguments], axis=1) for part in range(3))
        value, first, second = one.function.derivatives_at(a[:, :states], a[:, states:])
        bent = np.einsum("poi,pikl->pokl", first, curvatures)
        bent += np.einsum("poij,pik,pjl->pokl", second, slopes, slopes, optimize=True)
        called[key] = value, np.einsum("poi,pik->pok", first, slopes), bent
    value, slope, curvature = called[key]
    return value[:, output], slope[:, output], curvature[:, output]


def _jet(one: Formula, arguments: Sequence[_Jet], y: Array, selection: Array | None) -> _Jet:
    points, k = y.shape
    if one.kind == VARIABLE:
        slope = np.zeros((points, k))
        slope[:, int(one.data[0])] = 1.0
        return y[:, int(one.data[0])], slope, np.zeros((points, k, k))
    if one.kind == SUM:
        parts = [np.full(points, one.data[-1]), np.zeros((points, k)), np.zeros((points, k, k))]
        for factor, argument in zip(one.data[:-1], arguments, strict=True):
            parts = [part + factor * more for part, more in zip(parts, argument, strict=True)]
        return parts[0], parts[1], parts[2]
    if one.kind == PRODUCT:
        return _product(*arguments)
    if one.kind == QUOTIENT:
        over, (value, slope, curvature) = arguments
        inverse = _chained((value, slope, curvature), 1 / value, -(value**-2.0), 2 * value**-3.0)
        return _product(over, inverse)
    if one.kind == NORM:
        return _norm(arguments, selection)
    (argument,) = arguments
    return _chained(argument, *_smooth(one, argument[0]))


def _smooth(one: Formula, value: Array) -> tuple[Array, Array, Array]:
    """Return a function of one variable with its first and second derivative."""
    if one.kind == POWER:
        p = one.data[0]
        return value**p, p * value ** (p - 1), p * (p - 1) * value ** (p - 2)
    if one.kind == "exp":
        result = np.exp(value)
        return result, result, result
    if one.kind == "log":
        return np.log(value), 1 / value, -(value**-2.0)
    if one.kind == "sqrt":
        root = np.sqrt(value)
        return root, 0.5 / root, -0.25 / (root * value)
    if one.kind == "sin":
        return np.sin(value), np.cos(value), -np.sin(value)
    if one.kind == "cos":
        return np.cos(value), -np.sin(value), -np.cos(value)
    if one.kind == "tanh":
        result, slope = np.tanh(value), np.cosh(value) ** -2.0
        return result, slope, -2 * result * slope
    if one.kind == "arctan":
        slope = 1 / (1 + value**2)
        return np.arctan(value), slope, -2 * (value * slope) * slope
    raise ProblemError("formula", f"a {one.kind}", "a formula without maxima and minima: a mode of it")


def _outer(a: Array, b: Array) -> Array:
    return a[:, :, None] * b[:, None, :]


def _product(one: _Jet, other: _Jet) -> _Jet:
    cross = _outer(one[1], other[1])
    curvature = one[0][:, None, None] * other[2] + other[0][:, None, None] * one[2] + cross + np.swapaxes(cross, 1, 2)
    return one[0] * other[0], one[0][:, None] * other[1] + other[0][:, None] * one[1], curvature


def _chained(one: _Jet, value: Array, first: Array, second: Array) -> _Jet:
    curvature = first[:, None, None] * one[2] + second[:, None, None] * _outer(one[1], one[1])
    return value, first[:, None] * one[1], curvature


def _norm(arguments: Sequence[_Jet], selection: Array | None) -> _Jet:
    a, slopes, curvatures = (np.stack([one[part] for one in arguments], axis=1) for part in range(3))
    length = np.linalg.norm(a, axis=1)
    at_zero = length == 0
    selected = np.isfinite(selection).all(axis=1) if selection is not None else at_zero
    selected = selected | at_zero
    unit = a / np.where(at_zero, 1.0, length)[:, None]
    if selection is not None:
        unit = np.where(np.isfinite(selection), selection, unit)
    slope = np.einsum("pc,pck->pk", unit, slopes)
    curvature = np.einsum("pc,pckl->pkl", unit, curvatures)
    within = np.einsum("pck,pcl->pkl", slopes, slopes) - _outer(slope, slope)
    curvature = curvature + np.where(
        selected[:, None, None], 0.0, within / np.where(at_zero, 1.0, length)[:, None, None]
    )
    return length, slope, curvature
