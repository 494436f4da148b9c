"""Rules of differentiation over boxes: an interval jet encloses a value, its gradient and its Hessian."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lin_freq_ocp.formulas.intervals import Interval, add, inverse, meet, multiply, power, root, scale

# Value (boxes,), gradient (boxes, k) and Hessian (boxes, k, k), None where it is zero.
IntervalJet = tuple[Interval, Interval, Interval | None]


def combination(
    factors: Sequence[float], arguments: Sequence[IntervalJet], constant: float, box: Interval
) -> IntervalJet:
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


def product(a: IntervalJet, b: IntervalJet, curved: bool) -> IntervalJet:
    """Return a b, without its Hessian unless ``curved``."""
    slope = _plus(multiply(_raised(a[0], 1), b[1]), multiply(_raised(b[0], 1), a[1]))
    if not curved:
        return multiply(a[0], b[0]), slope, None
    cross = _outer(a[1], b[1])
    hessian = _plus(cross, (np.swapaxes(cross[0], 1, 2), np.swapaxes(cross[1], 1, 2)))
    for factor, other in ((a, b), (b, a)):
        if other[2] is not None:
            hessian = _plus(hessian, multiply(_raised(factor[0], 2), other[2]))
    return multiply(a[0], b[0]), slope, hessian


def chained(a: IntervalJet, value: Interval, first: Interval, second: Interval, curved: bool) -> IntervalJet:
    """Return f(a), from enclosures of f and its derivatives over the range of a."""
    slope = multiply(_raised(first, 1), a[1])
    if not curved:
        return value, slope, None
    hessian = multiply(_raised(second, 2), _squares(a[1]))
    if a[2] is not None:
        hessian = _plus(hessian, multiply(_raised(first, 2), a[2]))
    return value, slope, hessian


def norm(arguments: Sequence[IntervalJet], curved: bool) -> IntervalJet:
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
        slope = _plus(slope, multiply(_raised(unit, 1), a[1]))
        if curved and a[2] is not None:
            hessian = _plus(hessian, multiply(_raised(unit, 2), a[2]))
    if not curved:
        return length, slope, None
    across = _across(arguments, squares, multiply(multiply(once, once), once), hessian)
    unknown = ~apart[:, None, None]
    return length, slope, (np.where(unknown, -np.inf, across[0]), np.where(unknown, np.inf, across[1]))


def _across(
    arguments: Sequence[IntervalJet], squares: Sequence[Interval], inverse_cube: Interval, hessian: Interval
) -> Interval:
    """Add sum M_ij Da_i Da_j' to a Hessian, from a_i^2 and 1/|a|^3; see ``norm``."""
    for i, a in enumerate(arguments):
        others: Interval = np.zeros_like(squares[0][0]), np.zeros_like(squares[0][0])
        for j, square in enumerate(squares):
            if j != i:
                others = add(others, square)
                weight = scale(-1.0, multiply(multiply(a[0], arguments[j][0]), inverse_cube))
                hessian = _plus(hessian, multiply(_raised(weight, 2), _outer(a[1], arguments[j][1])))
        diagonal = multiply((np.maximum(others[0], 0.0), others[1]), inverse_cube)
        hessian = _plus(hessian, multiply(_raised(diagonal, 2), _squares(a[1])))
    return hessian


def _plus(a: Interval, b: Interval) -> Interval:
    """Return a + b, exactly where one of them is zero: so that zeros of derivatives remain zeros."""
    sums = add(a, b)
    zero_a, zero_b = (a[0] == 0) & (a[1] == 0), (b[0] == 0) & (b[1] == 0)
    return (
        np.where(zero_a, b[0], np.where(zero_b, a[0], sums[0])),
        np.where(zero_a, b[1], np.where(zero_b, a[1], sums[1])),
    )


def _outer(a: Interval, b: Interval) -> Interval:
    return multiply((a[0][:, :, None], a[1][:, :, None]), (b[0][:, None, :], b[1][:, None, :]))


def _raised(a: Interval, times: int) -> Interval:
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
