"""Rules of differentiation at points: a jet is a value with its gradient and Hessian."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lin_freq_ocp.arrays import Array

# Value (points,), gradient (points, k) and Hessian (points, k, k) by the k components of (x, u).
Jet = tuple[Array, Array, Array]


def constant(value: float, points: int, k: int) -> Jet:
    """Return the jet of a number."""
    return np.full(points, value), np.zeros((points, k)), np.zeros((points, k, k))


def product(a: Jet, b: Jet) -> Jet:
    """Return the jet of a b."""
    cross = _outer(a[1], b[1])
    hessian = a[0][:, None, None] * b[2] + b[0][:, None, None] * a[2] + cross + np.swapaxes(cross, 1, 2)
    return a[0] * b[0], a[0][:, None] * b[1] + b[0][:, None] * a[1], hessian


def chained(a: Jet, value: Array, first: Array, second: Array) -> Jet:
    """Return the jet of f(a), from f and its derivatives at a, (points,) each."""
    hessian = first[:, None, None] * a[2] + second[:, None, None] * _outer(a[1], a[1])
    return value, first[:, None] * a[1], hessian


def norm(arguments: Sequence[Jet], selection: Array | None) -> Jet:
    """Return the jet of |a|; where the selection (points, components) has numbers, they stand for its derivative by a.

    The Hessian is zero there, and where a is zero.
    """
    a, slopes, hessians = stacked(arguments)
    length = np.linalg.norm(a, axis=1)
    at_zero = length == 0
    divisor = np.where(at_zero, 1.0, length)
    unit, flat = a / divisor[:, None], at_zero
    if selection is not None:
        flat = np.isfinite(selection).all(axis=1) | at_zero
        unit = np.where(np.isfinite(selection), selection, unit)
    slope = np.einsum("pc,pck->pk", unit, slopes)
    across = (np.einsum("pck,pcl->pkl", slopes, slopes) - _outer(slope, slope)) / divisor[:, None, None]
    hessian = np.einsum("pc,pckl->pkl", unit, hessians) + np.where(flat[:, None, None], 0.0, across)
    return length, slope, hessian


def stacked(arguments: Sequence[Jet]) -> Jet:
    """Return jets as one, with an axis of components after that of points."""
    values, slopes, hessians = (np.stack(parts, axis=1) for parts in zip(*arguments, strict=True))
    return values, slopes, hessians


def composed(arguments: Jet, value: Array, first: Array, second: Array) -> Jet:
    """Return the jets of the outputs of g(a): D = sum g_i Da_i, D2 = sum g_i D2a_i + sum g_ij Da_i Da_j'.

    Of ``stacked`` arguments; value (points, outputs), first (..., arguments), second (..., arguments, arguments).
    """
    _, slopes, hessians = arguments
    hessian = np.einsum("poi,pikl->pokl", first, hessians)
    hessian += np.einsum("poij,pik,pjl->pokl", second, slopes, slopes, optimize=True)
    return value, np.einsum("poi,pik->pok", first, slopes), hessian


def _outer(a: Array, b: Array) -> Array:
    return a[:, :, None] * b[:, None, :]
