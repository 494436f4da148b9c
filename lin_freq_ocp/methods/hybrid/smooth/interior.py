"""The logarithmic barrier of a product of cones, sum log s_i + 1/2 sum log s'J s, and points of its interior."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.methods.structured.cones import Cone

MARGIN = 1e-2  # distance of the first point to the boundary, in units in which limits are of order 1


def log_determinant(cone: Cone, s: Array) -> float:
    """Return the logarithm that the barrier is made of; -inf outside of the interior."""
    inside = s[:, cone.orthant][cone.present[:, cone.orthant]]
    if not (inside > 0).all():
        return -np.inf
    total = float(np.log(inside).sum())
    for block in cone.blocks:
        v = s[cone.present[:, block.start], block]
        square = _square(v)
        if not ((square > 0) & (v[:, 0] > 0)).all():
            return -np.inf
        total += 0.5 * float(np.log(square).sum())
    return total


def inverse(cone: Cone, s: Array) -> Array:
    """Return s^-1 of an interior point: the gradient of ``log_determinant``; zero in rows that there are not."""
    result, inside = np.zeros_like(s), cone.present[:, cone.orthant]
    result[:, cone.orthant] = np.where(inside, 1 / np.where(inside, s[:, cone.orthant], 1.0), 0.0)
    for block in cone.blocks:
        present = cone.present[:, block.start]
        v = s[present, block]
        mirrored = v * np.where(np.arange(v.shape[1]) == 0, 1.0, -1.0)
        result[present, block] = mirrored / _square(v)[:, None]
    return result


def moved_inside(cone: Cone, v: Array) -> Array:
    """Return the point with entries, and heads of second-order cones, raised to a margin from the boundary."""
    result = np.where(cone.present, v, 0.0)
    heads = np.zeros_like(v)
    heads[:, cone.orthant] = MARGIN
    for block in cone.blocks:
        heads[:, block.start] = MARGIN + np.linalg.norm(result[:, block][:, 1:], axis=1)
        heads[:, block.start + 1 : block.stop] = -np.inf
    return np.where(cone.present, np.maximum(result, heads), 0.0)


def _square(v: Array) -> Array:
    """Return v'J v, (rows,)."""
    size = np.linalg.norm(v[:, 1:], axis=1)
    return (v[:, 0] - size) * (v[:, 0] + size)
