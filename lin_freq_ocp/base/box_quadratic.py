"""The minimiser of a convex quadratic over a box, for many boxes side by side.

Coordinate descent alone takes as many sweeps as the Hessian is ill-conditioned, and the weights of a Riccati equation
are. Between sweeps there is therefore a Newton step of the components that no bound holds, cut at the bounds or at the
first of them, whichever is lower: with the right bounds it ends the search.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array

ROUNDS = 6  # of a Newton step and a sweep; two or three are usual
REGULAR = 1e-13  # of a diagonal entry, added to it: a Hessian may be singular


def box_minimiser(slope: Array, hessian: Array, low: Array, high: Array) -> Array:
    """Return v near the minimum of slope v + 1/2 v'H v over low <= v <= high, (..., k), H (..., k, k) semidefinite.

    A component whose diagonal entry is zero stays at the point of its bounds nearest to zero.
    """
    shape = np.broadcast_shapes(slope.shape, low.shape, high.shape, hessian.shape[:-1])
    v = np.clip(np.zeros(shape), low, high)
    diagonal = np.diagonal(hessian, axis1=-2, axis2=-1)
    curved, sizes = diagonal > 0, np.where(diagonal > 0, diagonal, 1.0)
    for _ in range(ROUNDS):
        before = v.copy()
        v = _newton_step(slope, hessian, low, high, v)
        for j in range(shape[-1]):
            gradient = slope[..., j] + (hessian[..., j, :] * v).sum(axis=-1)
            step = np.where(curved[..., j], gradient / sizes[..., j], 0.0)
            v[..., j] = np.clip(v[..., j] - step, low[..., j], high[..., j])
        if (v == before).all():
            break
    return v


def _newton_step(slope: Array, hessian: Array, low: Array, high: Array, v: Array) -> Array:
    """Return the better of two points on the way to the minimum of the components that no bound holds, or v."""
    diagonal = np.diagonal(hessian, axis1=-2, axis2=-1)
    gradient = slope + (hessian * v[..., None, :]).sum(axis=-1)
    free = (diagonal > 0) & ~((v <= low) & (gradient >= 0)) & ~((v >= high) & (gradient <= 0))
    sizes = np.where(diagonal > 0, diagonal, 1.0)[..., None] * np.eye(v.shape[-1])
    system = np.where(free[..., None] & free[..., None, :], hessian + REGULAR * sizes, sizes)
    step = -np.linalg.solve(system, np.where(free, gradient, 0.0)[..., None])[..., 0]
    moving = step != 0
    room = np.where(step > 0, high - v, v - low) / np.where(moving, np.abs(step), 1.0)
    length = np.minimum(np.where(moving, room, np.inf).min(axis=-1, keepdims=True), 1.0)
    best, least = v, _value(slope, hessian, v)
    for point in (np.clip(v + length * step, low, high), np.clip(v + step, low, high)):
        value = _value(slope, hessian, point)
        best = np.where((value < least)[..., None], point, best)
        least = np.minimum(value, least)
    return best


def _value(slope: Array, hessian: Array, v: Array) -> Array:
    return ((slope + 0.5 * (hessian * v[..., None, :]).sum(axis=-1)) * v).sum(axis=-1)
