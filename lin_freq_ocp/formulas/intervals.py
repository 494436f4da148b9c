"""Interval arithmetic on arrays, rounded outwards, and rules of differentiation over boxes.

Every result contains the results for all real numbers in the operands. An interval is a pair (lower, upper) of arrays.
Infinite bounds stand for unknown ones: the enclosed numbers are finite, so that 0 times an infinite bound is 0. An
interval jet encloses a value, its gradient and its Hessian.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask

Interval = tuple[Array, Array]
# Enclosures of a function of one variable and of its first and second derivative.
WithDerivatives = tuple[Interval, Interval, Interval]
# Bounds are moved outwards by this part of themselves: sums, products, quotients and roots have an error of half an
# eps, the elementary functions of the mathematical library of a few.
SLACK = 8 * float(np.finfo(np.float64).eps)
# Bounds are also moved outwards by this, as results near zero have no relative accuracy.
SMALLEST = float(np.finfo(np.float64).tiny)
# Extrema of sine and cosine this near to an interval (relative to its bounds above 1) count as inside.
TURN = 1e-9


def outward(lower: Array, upper: Array) -> Interval:
    """Return an interval enlarged by the rounding errors of one operation; undefined bounds become infinite."""
    with np.errstate(invalid="ignore"):
        low, high = lower - (SLACK * np.abs(lower) + SMALLEST), upper + (SLACK * np.abs(upper) + SMALLEST)
    return np.fmax(low, -np.inf), np.fmin(high, np.inf)


def add(a: Interval, b: Interval) -> Interval:
    """Return a + b."""
    return outward(a[0] + b[0], a[1] + b[1])


def shift(by: float, a: Interval) -> Interval:
    """Return by + a for a real number."""
    return outward(by + a[0], by + a[1])


def scale(factor: float | Array, a: Interval) -> Interval:
    """Return factor * a for real numbers."""
    first, second = _times(factor, a[0]), _times(factor, a[1])
    return outward(np.minimum(first, second), np.maximum(first, second))


def multiply(a: Interval, b: Interval) -> Interval:
    """Return a * b."""
    products = [_times(one, other) for one in a for other in b]
    lower = np.minimum(np.minimum(products[0], products[1]), np.minimum(products[2], products[3]))
    upper = np.maximum(np.maximum(products[0], products[1]), np.maximum(products[2], products[3]))
    return outward(lower, upper)


def inverse(a: Interval) -> Interval:
    """Return 1 / a; unbounded where a contains 0."""
    apart = (a[0] > 0) | (a[1] < 0)
    with np.errstate(divide="ignore"):
        lower = np.where(apart, 1 / np.where(apart, a[1], 1.0), -np.inf)
        upper = np.where(apart, 1 / np.where(apart, a[0], 1.0), np.inf)
    return outward(lower, upper)


def power(a: Interval, exponent: int) -> Interval:
    """Return a ** exponent for a whole number from 0."""
    if exponent == 0:
        return np.ones_like(a[0]), np.ones_like(a[1])
    if exponent == 1:
        return a
    first, second = a[0] ** float(exponent), a[1] ** float(exponent)
    if exponent % 2:
        return outward(first, second)
    through = (a[0] <= 0) & (a[1] >= 0)
    lower, upper = outward(np.minimum(first, second), np.maximum(first, second))
    return np.where(through, 0.0, np.maximum(lower, 0.0)), upper


def root(a: Interval) -> Interval:
    """Return the root of the part of a above zero; unbounded without one."""
    none = a[1] < 0
    lower, upper = outward(np.sqrt(np.maximum(a[0], 0.0)), np.sqrt(np.maximum(a[1], 0.0)))
    return np.where(none, -np.inf, np.maximum(lower, 0.0)), np.where(none, np.inf, upper)


def square_root(a: Interval) -> WithDerivatives:
    """Return the root as ``root`` does, and its derivatives, unbounded unless a is positive."""
    value = root(a)
    first, second = scale(0.5, inverse(value)), scale(-0.25, inverse(multiply(value, a)))
    return value, _where_positive(a, first), _where_positive(a, second)


def exponential(a: Interval) -> WithDerivatives:
    """Return exp(a), which is its own derivative."""
    lower, upper = outward(np.exp(a[0]), np.exp(a[1]))
    value = np.maximum(lower, 0.0), upper
    return value, value, value


def logarithm(a: Interval) -> WithDerivatives:
    """Return the logarithm of the part of a above zero, unbounded without one; derivatives as of a root."""
    lower = np.where(a[0] > 0, np.log(np.where(a[0] > 0, a[0], 1.0)), -np.inf)
    upper = np.where(a[1] > 0, np.log(np.where(a[1] > 0, a[1], 1.0)), np.inf)
    slope = inverse(a)
    second = scale(-1.0, multiply(slope, slope))
    return outward(lower, upper), _where_positive(a, slope), _where_positive(a, second)


def cosine(a: Interval) -> WithDerivatives:
    """Return cos(a), -sin(a) and -cos(a)."""
    value = _wave(np.cos, a, 0.0)
    return value, scale(-1.0, _wave(np.sin, a, np.pi / 2)), scale(-1.0, value)


def sine(a: Interval) -> WithDerivatives:
    """Return sin(a), cos(a) and -sin(a)."""
    value = _wave(np.sin, a, np.pi / 2)
    return value, _wave(np.cos, a, 0.0), scale(-1.0, value)


def hyperbolic_tangent(a: Interval) -> WithDerivatives:
    """Return v = tanh(a), and its derivatives 1 - v^2 and -2 v (1 - v^2)."""
    value = meet(outward(np.tanh(a[0]), np.tanh(a[1])), _one_around(a))

    def slope(v: Interval) -> Interval:
        square = power(v, 2)
        return meet(outward(1 - square[1], 1 - square[0]), (np.zeros_like(v[0]), np.ones_like(v[0])))

    second = _with_extrema(lambda v: scale(-2.0, multiply(v, slope(v))), value, 4 / np.sqrt(27.0))
    return value, slope(value), second


def arc_tangent(a: Interval) -> WithDerivatives:
    """Return arctan(a), and its derivatives 1/(1 + a^2) and -2 a/(1 + a^2)^2."""
    value = meet(outward(np.arctan(a[0]), np.arctan(a[1])), scale(np.pi / 2, _one_around(a)))

    def slope(b: Interval) -> Interval:
        return inverse(shift(1.0, power(b, 2)))

    second = _with_extrema(lambda b: scale(-2.0, multiply(multiply(b, slope(b)), slope(b))), a, np.sqrt(27.0) / 8)
    return value, slope(a), second


def tangent(a: Interval) -> WithDerivatives:
    """Return v = tan(a), unbounded across a pole, and its derivatives 1 + v^2 and 2 v (1 + v^2)."""
    lower, upper = outward(np.tan(a[0]), np.tan(a[1]))
    branch = [np.floor(bound / np.pi + 0.5 + side) for bound, side in zip(a, (-TURN, TURN), strict=True)]
    within = (branch[0] == branch[1]) & (lower <= upper)
    value = np.where(within, lower, -np.inf), np.where(within, upper, np.inf)
    first = shift(1.0, power(value, 2))
    return value, first, scale(2.0, multiply(value, first))


def hyperbolic_sine(a: Interval) -> WithDerivatives:
    """Return sinh(a), cosh(a) and sinh(a)."""
    value = outward(np.sinh(a[0]), np.sinh(a[1]))
    return value, hyperbolic_cosine(a)[0], value


def hyperbolic_cosine(a: Interval) -> WithDerivatives:
    """Return cosh(a), sinh(a) and cosh(a)."""
    ends, through = (np.cosh(a[0]), np.cosh(a[1])), (a[0] <= 0) & (a[1] >= 0)
    lower, upper = outward(np.minimum(*ends), np.maximum(*ends))
    value = np.where(through, 1.0, np.maximum(lower, 1.0)), upper
    return value, outward(np.sinh(a[0]), np.sinh(a[1])), value


def arc_sine(a: Interval) -> WithDerivatives:
    """Return arcsin of the part of a in [-1, 1], and its derivatives (1 - a^2)^(-1/2) and a (1 - a^2)^(-3/2)."""
    inside = np.clip(a[0], -1.0, 1.0), np.clip(a[1], -1.0, 1.0)
    left = shift(1.0, scale(-1.0, power(a, 2)))  # 1 - a^2
    first = _where_positive(left, inverse(root(left)))
    cube = _where_positive(left, multiply(first, inverse(left)))
    return outward(np.arcsin(inside[0]), np.arcsin(inside[1])), first, _where_positive(left, multiply(a, cube))


def arc_cosine(a: Interval) -> WithDerivatives:
    """Return arccos(a) = pi/2 - arcsin(a)."""
    value, first, second = arc_sine(a)
    return shift(np.pi / 2, scale(-1.0, value)), scale(-1.0, first), scale(-1.0, second)


def area_sine(a: Interval) -> WithDerivatives:
    """Return arcsinh(a), and its derivatives (1 + a^2)^(-1/2) and -a (1 + a^2)^(-3/2)."""
    total = shift(1.0, power(a, 2))
    first = inverse(root(total))
    second = scale(-1.0, multiply(a, multiply(first, inverse(total))))
    return outward(np.arcsinh(a[0]), np.arcsinh(a[1])), first, second


def area_tangent(a: Interval) -> WithDerivatives:
    """Return arctanh of the part of a in (-1, 1), and its derivatives 1/(1 - a^2) and 2 a/(1 - a^2)^2."""
    left = shift(1.0, scale(-1.0, power(a, 2)))
    ends = (np.where(np.abs(end) < 1, np.arctanh(np.clip(end, -1.0, 1.0)), np.sign(end) * np.inf) for end in a)
    first = _where_positive(left, inverse(left))
    return outward(*ends), first, _where_positive(left, scale(2.0, multiply(a, multiply(first, first))))


def meet(a: Interval, b: Interval) -> Interval:
    """Return the intersection; its lower bound is above its upper one if it is empty."""
    return np.maximum(a[0], b[0]), np.minimum(a[1], b[1])


def _times(a: float | Array, b: Array) -> Array:
    product = np.asarray(a * b)
    undefined = np.isnan(product)
    return np.where(undefined & ~(np.isnan(a) | np.isnan(b)), 0.0, product) if undefined.any() else product


def _where_positive(a: Interval, derivative: Interval) -> Interval:
    positive = a[0] > 0
    return np.where(positive, derivative[0], -np.inf), np.where(positive, derivative[1], np.inf)


def _one_around(a: Interval) -> Interval:
    return -np.ones_like(a[0]), np.ones_like(a[0])


def _with_extrema(odd: Callable[[Interval], Interval], a: Interval, extremum: float) -> Interval:
    """Return an odd function that goes to 0, from its values at both ends of a.

    It is ``extremum`` at -1/sqrt(3), the negative of it at 1/sqrt(3), and monotone between and outside these. Rounding
    of an argument across one of them changes the value by less than ``outward`` adds.
    """
    ends: list[Interval] = []
    for end in a:
        known = np.isfinite(end)
        finite = np.where(known, end, 0.0)
        ends.append(odd((finite, finite)))  # of 0 it is 0, as in the limit
    lower, upper = np.minimum(ends[0][0], ends[1][0]), np.maximum(ends[0][1], ends[1][1])
    extreme = 1 / np.sqrt(3.0)
    lowest, highest = outward(np.full_like(lower, -extremum), np.full_like(upper, extremum))
    return (
        np.where((a[0] <= extreme) & (a[1] >= extreme), lowest, lower),
        np.where((a[0] <= -extreme) & (a[1] >= -extreme), highest, upper),
    )


def _wave(function: np.ufunc, a: Interval, peak: float) -> Interval:
    """Return sine or cosine; its maxima are at peak + 2 pi k, its minima half a turn later."""
    known = np.isfinite(a[0]) & np.isfinite(a[1])
    low, high = np.where(known, a[0], 0.0), np.where(known, a[1], 0.0)
    near = TURN * np.maximum(1.0, np.maximum(np.abs(low), np.abs(high)))
    lower, upper = outward(np.minimum(function(low), function(high)), np.maximum(function(low), function(high)))

    def has_turn(turn: float) -> Mask:
        return np.floor((high + near - turn) / (2 * np.pi)) > np.floor((low - near - turn) / (2 * np.pi))

    upper = np.where(~known | has_turn(peak), 1.0, np.minimum(upper, 1.0))
    lower = np.where(~known | has_turn(peak + np.pi), -1.0, np.maximum(lower, -1.0))
    return lower, upper


# Value (boxes,), gradient (boxes, k) and Hessian (boxes, k, k), None where it is zero.
IntervalJet = tuple[Interval, Interval, Interval | None]


def sum_rule(factors: Sequence[float], arguments: Sequence[IntervalJet], constant: float, box: Interval) -> IntervalJet:
    """Return factors a + constant."""
    boxes, k = box[0].shape
    value: Interval = np.full(boxes, constant), np.full(boxes, constant)
    slope: Interval = np.zeros((boxes, k)), np.zeros((boxes, k))
    hessian: Interval | None = None
    for factor, argument in zip(factors, arguments, strict=True):
        value = add(value, scale(factor, argument[0]))
        slope = _plus(slope, scale(factor, argument[1]))
        if argument[2] is not None:
            more = scale(factor, argument[2])
            hessian = more if hessian is None else _plus(hessian, more)
    return value, slope, hessian


def product_rule(a: IntervalJet, b: IntervalJet, curved: bool) -> IntervalJet:
    """Return a b, without its Hessian unless ``curved``."""
    slope = _plus(multiply(_with_axes(a[0], 1), b[1]), multiply(_with_axes(b[0], 1), a[1]))
    if not curved:
        return multiply(a[0], b[0]), slope, None
    cross = _outer(a[1], b[1])
    hessian = _plus(cross, (np.swapaxes(cross[0], 1, 2), np.swapaxes(cross[1], 1, 2)))
    for factor, other in ((a, b), (b, a)):
        if other[2] is not None:
            hessian = _plus(hessian, multiply(_with_axes(factor[0], 2), other[2]))
    return multiply(a[0], b[0]), slope, hessian


def chain_rule(a: IntervalJet, value: Interval, first: Interval, second: Interval, curved: bool) -> IntervalJet:
    """Return f(a), from enclosures of f and its derivatives over the range of a."""
    slope = multiply(_with_axes(first, 1), a[1])
    if not curved:
        return value, slope, None
    hessian = multiply(_with_axes(second, 2), _squares(a[1]))
    if a[2] is not None:
        hessian = _plus(hessian, multiply(_with_axes(first, 2), a[2]))
    return value, slope, hessian


def norm_rule(arguments: Sequence[IntervalJet], curved: bool) -> IntervalJet:
    """Return |a| with unit vector e = a/|a|: D = sum e_i Da_i, D2 = sum e_i D2a_i + sum M_ij Da_i Da_j'.

    M = (I - e e')/|a|: M_ii = sum of the other a_j^2/|a|^3, M_ij = -a_i a_j/|a|^3.
    """
    squares = [power(a[0], 2) for a in arguments]
    total = squares[0]
    for square in squares[1:]:
        total = add(total, square)
    length = root((np.maximum(total[0], 0.0), total[1]))
    once = inverse(length)
    apart = length[0] > 0
    boxes, k = arguments[0][1][0].shape
    slope: Interval = np.zeros((boxes, k)), np.zeros((boxes, k))
    hessian: Interval = np.zeros((boxes, k, k)), np.zeros((boxes, k, k))
    for a in arguments:
        unit = meet(multiply(a[0], once), (-np.ones(boxes), np.ones(boxes)))
        unit = np.where(apart, unit[0], -1.0), np.where(apart, unit[1], 1.0)
        slope = _plus(slope, multiply(_with_axes(unit, 1), a[1]))
        if curved and a[2] is not None:
            hessian = _plus(hessian, multiply(_with_axes(unit, 2), a[2]))
    if not curved:
        return length, slope, None
    cubed = multiply(multiply(once, once), once)
    for i, a in enumerate(arguments):  # and sum M_ij Da_i Da_j'
        others: Interval = np.zeros_like(total[0]), np.zeros_like(total[0])
        for j, square in enumerate(squares):
            if j != i:
                others = add(others, square)
                weight = scale(-1.0, multiply(multiply(a[0], arguments[j][0]), cubed))
                hessian = _plus(hessian, multiply(_with_axes(weight, 2), _outer(a[1], arguments[j][1])))
        diagonal = multiply((np.maximum(others[0], 0.0), others[1]), cubed)
        hessian = _plus(hessian, multiply(_with_axes(diagonal, 2), _squares(a[1])))
    unknown = ~apart[:, None, None]
    return length, slope, (np.where(unknown, -np.inf, hessian[0]), np.where(unknown, np.inf, hessian[1]))


def _plus(a: Interval, b: Interval) -> Interval:
    """Return a + b, without rounding if one of them is zero: zeros of derivatives remain zeros."""
    sums = add(a, b)
    zero_a, zero_b = (a[0] == 0) & (a[1] == 0), (b[0] == 0) & (b[1] == 0)
    return (
        np.where(zero_a, b[0], np.where(zero_b, a[0], sums[0])),
        np.where(zero_a, b[1], np.where(zero_b, a[1], sums[1])),
    )


def _outer(a: Interval, b: Interval) -> Interval:
    return multiply((a[0][:, :, None], a[1][:, :, None]), (b[0][:, None, :], b[1][:, None, :]))


def _with_axes(a: Interval, times: int) -> Interval:
    """Return (p,) as (p, 1) or (p, 1, 1)."""
    shape = (-1, *(1,) * times)
    return a[0].reshape(shape), a[1].reshape(shape)


def _squares(slope: Interval) -> Interval:
    """Return g g', with its diagonal a square."""
    outer, square = _outer(slope, slope), power(slope, 2)
    diagonal = np.arange(slope[0].shape[1])
    for side in range(2):
        outer[side][:, diagonal, diagonal] = square[side]
    return outer
