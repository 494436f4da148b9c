"""Rules of differentiation at points: a jet is a value with its gradient and Hessian; None for a Hessian of zeros.

Points are the last axis here: NumPy is fast along that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lin_freq_ocp.base.arrays import Array

# Value (points,), gradient (k, points) and Hessian (k, k, points) by the k components of (x, u).
Jet = tuple[Array, Array, Array | None]
Stacked = tuple[Array, Array, Array]


def combination(factors: Sequence[float], arguments: Sequence[Jet], constant: float, shape: tuple[int, int]) -> Jet:
    """Return the jet of a sum of multiples and a constant, (k, points) being the shape of its gradient."""
    value, slope, hessian = np.full(shape[1], constant), np.zeros(shape), None
    for factor, argument in zip(factors, arguments, strict=True):
        value += factor * argument[0]
        slope += factor * argument[1]
        if argument[2] is not None:
            hessian = _added(hessian, factor * argument[2])
    return value, slope, hessian


def product(a: Jet, b: Jet) -> Jet:
    """Return the jet of a b."""
    cross = _outer(a[1], b[1])
    hessian = cross + np.swapaxes(cross, 0, 1)
    for one, other in ((a, b), (b, a)):
        if other[2] is not None:
            hessian += one[0] * other[2]
    return a[0] * b[0], a[0] * b[1] + b[0] * a[1], hessian


def chained(a: Jet, value: Array, first: Array, second: Array) -> Jet:
    """Return the jet of f(a), from f and its derivatives at a, (points,) each."""
    hessian = _outer(second * a[1], a[1])
    if a[2] is not None:
        hessian += first * a[2]
    return value, first * a[1], hessian


def norm(arguments: Sequence[Jet], selection: Array | None) -> Jet:
    """Return the jet of |a|; where the selection (points, components) has numbers, they stand for its derivative by a.

    The Hessian is zero there, and where a is zero.
    """
    a, slopes, hessians = stacked(arguments)
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


def stacked(arguments: Sequence[Jet]) -> Stacked:
    """Return jets as one, with a first axis of components."""
    values, slopes = np.stack([jet[0] for jet in arguments]), np.stack([jet[1] for jet in arguments])
    hessians = np.zeros((len(slopes), *slopes.shape[1:2] * 2, slopes.shape[2]))
    for i, (_, _, hessian) in enumerate(arguments):
        if hessian is not None:
            hessians[i] = hessian
    return values, slopes, hessians


def composed(arguments: Stacked, value: Array, first: Array, second: Array) -> Stacked:
    """Return the jets of the outputs of g(a): D = sum g_i Da_i, D2 = sum g_i D2a_i + sum g_ij Da_i Da_j'.

    Of ``stacked`` arguments; value (points, outputs), first (..., arguments), second (..., arguments, arguments). The
    result has a first axis of outputs.
    """
    _, slopes, hessians = arguments
    hessian = np.einsum("poi,iklp->oklp", first, hessians)
    hessian += np.einsum("poij,ikp,jlp->oklp", second, slopes, slopes, optimize=True)
    return value.T, np.einsum("poi,ikp->okp", first, slopes), hessian


def _added(total: Array | None, more: Array) -> Array:
    if total is None:
        return more
    total += more
    return total


def _outer(a: Array, b: Array) -> Array:
    return a[:, None] * b
