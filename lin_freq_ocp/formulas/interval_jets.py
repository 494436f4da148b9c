"""Formulas over boxes: enclosures of their values, gradients and Hessians (natural interval extensions).

What a formula is not defined for within a box (a logarithm of numbers below zero, a quotient by zero) is left out of
the enclosure of its values; its derivatives are then unbounded. Over a box in which all arguments of a norm can be
zero, its Hessian is unbounded, and its gradient contains all of Clarke's subdifferential.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.errors import ProblemError, UnsupportedError
from lin_freq_ocp.formulas.intervals import (
    Interval,
    add,
    arc_tangent,
    cosine,
    exponential,
    hyperbolic_tangent,
    inverse,
    logarithm,
    meet,
    multiply,
    outward,
    power,
    scale,
    sine,
    square_root,
)
from lin_freq_ocp.formulas.nodes import NORM, POWER, PRODUCT, QUOTIENT, SUM, VARIABLE, Formula, in_order


@dataclass(frozen=True, eq=False)
class IntervalJets:
    """Enclosures of formulas over boxes of y = (x, u), each a pair (lower, upper).

    Attributes
    ----------
    values : (boxes, formulas)
    slopes : (boxes, formulas, n + m)
    curvatures : (boxes, formulas, n + m, n + m)
    """

    values: Interval
    slopes: Interval
    curvatures: Interval


_Node = tuple[Interval, Interval, Interval | None]
"""Value (p,), gradient (p, k), Hessian (p, k, k) or None where it is zero."""


def interval_jets(formulas: Sequence[Formula], lower: Array, upper: Array, curved: bool = True) -> IntervalJets:
    """Return enclosures of formulas without maxima and minima over boxes lower <= y <= upper, (boxes, n + m).

    Without ``curved`` the Hessians are left out: they are zero, whatever the formulas.

    Raises
    ------
    UnsupportedError
        If they have functions of which nothing is known over boxes.
    """
    boxes, k = lower.shape
    found: dict[Formula, _Node] = {}
    with np.errstate(all="ignore"):
        for one in in_order(formulas):
            found[one] = _node(one, [found[argument] for argument in one.arguments], (lower, upper), curved)
    shape = (boxes, len(formulas))
    values = np.empty((2, *shape))
    slopes, curvatures = np.empty((2, *shape, k)), np.zeros((2, *shape, k, k))
    for place, one in enumerate(formulas):
        value, slope, curvature = found[one]
        for side in range(2):
            values[side, :, place], slopes[side, :, place] = value[side], slope[side]
            if curvature is not None:
                curvatures[side, :, place] = curvature[side]
    return IntervalJets((values[0], values[1]), (slopes[0], slopes[1]), (curvatures[0], curvatures[1]))


def _node(one: Formula, arguments: Sequence[_Node], box: Interval, curved: bool) -> _Node:
    boxes, k = box[0].shape
    if one.kind == VARIABLE:
        i = int(one.data[0])
        slope = np.zeros((boxes, k))
        slope[:, i] = 1.0
        return (box[0][:, i], box[1][:, i]), (slope, slope), None
    if one.kind == SUM:
        return _sum(one, arguments, boxes, k)
    if one.kind == PRODUCT:
        return _product(arguments[0], arguments[1], curved)
    if one.kind == QUOTIENT:
        over, under = arguments
        once = inverse(under[0])
        twice = multiply(once, once)
        parts = once, scale(-1.0, twice), scale(2.0, multiply(twice, once))
        return _product(over, _chained(under, *parts, curved), curved)
    if one.kind == NORM:
        return _norm(arguments, curved)
    if one.function is not None:
        name = one.function.title
        raise UnsupportedError(f"a global bound: {name} is no formula; only formulas have bounds over boxes.")
    (argument,) = arguments
    return _chained(argument, *_smooth(one, argument[0]), curved)


def _sum(one: Formula, arguments: Sequence[_Node], boxes: int, k: int) -> _Node:
    value: Interval = np.full(boxes, one.data[-1]), np.full(boxes, one.data[-1])
    slope: Interval = np.zeros((boxes, k)), np.zeros((boxes, k))
    curvature: Interval | None = None
    for factor, argument in zip(one.data[:-1], arguments, strict=True):
        value = add(value, scale(factor, argument[0]))
        slope = _plus(slope, scale(factor, argument[1]))
        if argument[2] is not None:
            more = scale(factor, argument[2])
            curvature = more if curvature is None else _plus(curvature, more)
    return value, slope, curvature


def _plus(a: Interval, b: Interval) -> Interval:
    """Return a + b, exactly where one of them is zero: so that zeros of derivatives remain zeros."""
    sums = add(a, b)
    zero_a, zero_b = (a[0] == 0) & (a[1] == 0), (b[0] == 0) & (b[1] == 0)
    return (
        np.where(zero_a, b[0], np.where(zero_b, a[0], sums[0])),
        np.where(zero_a, b[1], np.where(zero_b, a[1], sums[1])),
    )


def _smooth(one: Formula, value: Interval) -> tuple[Interval, Interval, Interval]:
    """Return a function of one variable with its first and second derivative."""
    if one.kind == POWER:
        p = int(one.data[0])
        return power(value, p), scale(p, power(value, p - 1)), scale(p * (p - 1), power(value, p - 2))
    if one.kind == "exp":
        result = exponential(value)
        return result, result, result
    if one.kind == "log":
        once = inverse(value)
        first, second = once, scale(-1.0, multiply(once, once))
        return logarithm(value), _where_positive(value, first), _where_positive(value, second)
    if one.kind == "sqrt":
        root = square_root(value)
        first = scale(0.5, inverse(root))
        second = scale(-0.25, inverse(multiply(root, value)))
        return root, _where_positive(value, first), _where_positive(value, second)
    if one.kind == "sin":
        result = sine(value)
        return result, cosine(value), scale(-1.0, result)
    if one.kind == "cos":
        result = cosine(value)
        return result, scale(-1.0, sine(value)), scale(-1.0, result)
    if one.kind == "tanh":
        return hyperbolic_tangent(value)
    if one.kind == "arctan":
        return arc_tangent(value)
    raise ProblemError("formula", f"a {one.kind}", "a formula without maxima and minima: a mode of it")


def _where_positive(value: Interval, derivative: Interval) -> Interval:
    positive = value[0] > 0
    return np.where(positive, derivative[0], -np.inf), np.where(positive, derivative[1], np.inf)


def _outer(a: Interval, b: Interval) -> Interval:
    return multiply((a[0][:, :, None], a[1][:, :, None]), (b[0][:, None, :], b[1][:, None, :]))


def _raised(a: Interval, times: int) -> Interval:
    """Return (p,) as (p, 1) or (p, 1, 1)."""
    shape = (-1, *(1,) * times)
    return a[0].reshape(shape), a[1].reshape(shape)


def _product(one: _Node, other: _Node, curved: bool) -> _Node:
    slope = _plus(multiply(_raised(one[0], 1), other[1]), multiply(_raised(other[0], 1), one[1]))
    if not curved:
        return multiply(one[0], other[0]), slope, None
    cross = _outer(one[1], other[1])
    curvature = _plus(cross, (np.swapaxes(cross[0], 1, 2), np.swapaxes(cross[1], 1, 2)))
    for factor, node in ((one, other), (other, one)):
        if node[2] is not None:
            curvature = _plus(curvature, multiply(_raised(factor[0], 2), node[2]))
    return multiply(one[0], other[0]), slope, curvature


def _chained(one: _Node, value: Interval, first: Interval, second: Interval, curved: bool) -> _Node:
    if not curved:
        return value, multiply(_raised(first, 1), one[1]), None
    curvature = multiply(_raised(second, 2), _squares(one[1]))
    if one[2] is not None:
        curvature = _plus(curvature, multiply(_raised(first, 2), one[2]))
    return value, multiply(_raised(first, 1), one[1]), curvature


def _squares(slope: Interval) -> Interval:
    """Return g g', with its diagonal a square."""
    outer, square = _outer(slope, slope), power(slope, 2)
    diagonal = np.arange(slope[0].shape[1])
    for side in range(2):
        outer[side][:, diagonal, diagonal] = square[side]
    return outer


def _norm(arguments: Sequence[_Node], curved: bool) -> _Node:
    """Return |a| with unit vector e = a/|a|: D = sum e_i Da_i, D2 = sum e_i D2a_i + sum M_ij Da_i Da_j'.

    M = (I - e e')/|a|: M_ii = sum of the other a_j^2/|a|^3, M_ij = -a_i a_j/|a|^3.
    """
    squares = [power(one[0], 2) for one in arguments]
    total = squares[0]
    for square in squares[1:]:
        total = add(total, square)
    length = square_root((np.maximum(total[0], 0.0), total[1]))
    once = inverse(length)
    cubed = multiply(multiply(once, once), once)
    apart = length[0] > 0
    boxes, k = arguments[0][1][0].shape
    slope: Interval = np.zeros((boxes, k)), np.zeros((boxes, k))
    curvature: Interval = np.zeros((boxes, k, k)), np.zeros((boxes, k, k))
    for i, one in enumerate(arguments):
        unit = meet(multiply(one[0], once), (-np.ones(boxes), np.ones(boxes)))
        unit = np.where(apart, unit[0], -1.0), np.where(apart, unit[1], 1.0)
        slope = _plus(slope, multiply(_raised(unit, 1), one[1]))
        if not curved:
            continue
        if one[2] is not None:
            curvature = _plus(curvature, multiply(_raised(unit, 2), one[2]))
        others: Interval = np.zeros(boxes), np.zeros(boxes)
        for j, square in enumerate(squares):
            if j != i:
                others = add(others, square)
                weight = scale(-1.0, multiply(multiply(one[0], arguments[j][0]), cubed))
                curvature = _plus(curvature, multiply(_raised(weight, 2), _outer(one[1], arguments[j][1])))
        within = multiply((np.maximum(others[0], 0.0), others[1]), cubed)
        curvature = _plus(curvature, multiply(_raised(within, 2), _squares(one[1])))
    if not curved:
        return length, slope, None
    unknown = ~apart[:, None, None]
    return length, slope, (np.where(unknown, -np.inf, curvature[0]), np.where(unknown, np.inf, curvature[1]))


def mean_value(at_centre: Interval, slopes: Interval, radii: Array) -> Interval:
    """Return the enclosure f(c) + [Df] [-r, r] of formulas over boxes.

    Parameters
    ----------
    at_centre : (boxes, formulas)
        Enclosures of the values at the centres.
    slopes : (boxes, formulas, n + m)
        Enclosures of the gradients over the boxes.
    radii : (boxes, n + m)
    """
    with np.errstate(invalid="ignore"):
        steepest = np.maximum(np.abs(slopes[0]), np.abs(slopes[1])) * radii[:, None, :]
    reach = np.where(radii[:, None, :] > 0, steepest, 0.0).sum(-1)
    reach = reach * (1 + OUTWARD_SUM)
    return outward(at_centre[0] - reach, at_centre[1] + reach)


OUTWARD_SUM = 64 * float(np.finfo(np.float64).eps)
"""Sums of a few products of numbers that are not negative are widened by this part."""
