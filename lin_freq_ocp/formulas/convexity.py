"""Whether formulas are convex in (x, u): by the rules of convex compositions, else by enclosures of the Hessian."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from functools import partial

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.formulas.jets import interval_jets, values_of
from lin_freq_ocp.formulas.nodes import Formula, evaluate, kinks
from lin_freq_ocp.formulas.operations import MAXIMUM, MINIMUM, NORM, POWER, PRODUCT, SUM, VARIABLE


class Shape(IntEnum):
    """What is known of a function of (x, u) at each time."""

    CONSTANT = 0
    AFFINE = 1
    CONVEX = 2
    UNKNOWN = 3


def is_convex(formula: Formula, lower: Array, upper: Array) -> bool:
    """Whether a formula is proven to be convex on boxes lower <= (x, u) <= upper at the times 0, 1, ..., (T, n + m).

    It has no kinks then but norms of affine functions, whose jets at zero have a subgradient.
    """
    return convex_curvature(formula, lower, upper) is not None


def convex_curvature(formula: Formula, lower: Array, upper: Array) -> Array | None:
    """Return diagonals >= 0 below the Hessian on boxes, (T, n + m); None if it is not proven to be semidefinite.

    Each summand that is convex by the rules adds its own diagonal, zeros where that has a negative entry: a diagonal
    below a semidefinite matrix need not stay below it when only its negative entries become zeros.
    """
    summands = zip(formula.arguments, formula.data[:-1], strict=True) if formula.kind == SUM else [(formula, 1.0)]
    curvature, others = np.zeros(lower.shape), formula * 0.0
    for part in (argument * factor for argument, factor in summands):
        if evaluate([part], partial(_shape, len(lower)))[0] <= Shape.CONVEX:
            own = least_curvature(part, lower, upper)
            curvature += np.where((own >= 0).all(axis=1, keepdims=True), own, 0.0)
        else:
            others = others + part
    if others.constant is None:
        curvature += least_curvature(others, lower, upper)
    whole = least_curvature(formula, lower, upper)
    better = whole.min(axis=1, keepdims=True) > curvature.min(axis=1, keepdims=True)
    curvature = np.where(better, whole, curvature)
    return curvature if (curvature >= 0).all() else None


def least_curvature(formula: Formula, lower: Array, upper: Array) -> Array:
    """Return diagonals below the Hessian on boxes, (T, n + m), by Gershgorin's circles; -inf where none is known."""
    found = np.full(lower.shape, -np.inf)
    if next(kinks([formula], MAXIMUM, MINIMUM, NORM), None) is not None:
        return found
    used = np.zeros(lower.shape[1], dtype=bool)  # enclosures of derivatives by others are not exactly zero
    used[[int(node.data[0]) for node in kinks([formula], VARIABLE)]] = True
    diagonal = np.arange(lower.shape[1])
    try:
        low, high = interval_jets([formula], lower, upper, time=np.arange(len(lower))).curvatures
    except UnsupportedError:
        return found
    sizes = np.where(used, np.maximum(np.abs(low), np.abs(high))[:, 0], 0.0)
    sizes[:, diagonal, diagonal] = 0.0
    found = np.where(used, low[:, 0, diagonal, diagonal] - sizes.sum(axis=2), 0.0)
    return np.nan_to_num(found, nan=-np.inf, posinf=0.0)


def _shape(horizon: int, node: Formula, parts: Sequence[Shape]) -> Shape:
    """Return what follows for a node from its arguments, at the times before the horizon."""
    most = max(parts, default=Shape.CONSTANT)
    if node.kind == VARIABLE:
        return Shape.AFFINE
    if most == Shape.CONSTANT or (node.kind == SUM and most == Shape.AFFINE):
        return most
    if node.kind == SUM and most == Shape.CONVEX:
        falling = (part == Shape.CONVEX and factor < 0 for part, factor in zip(parts, node.data[:-1], strict=True))
        return Shape.UNKNOWN if any(falling) else Shape.CONVEX
    if node.kind == PRODUCT and min(parts) == Shape.CONSTANT and most <= Shape.CONVEX:
        factor = values_of([node.arguments[parts.index(Shape.CONSTANT)]], np.zeros((horizon, sum(node.dimensions))))
        return most if most == Shape.AFFINE or (factor >= 0).all() else Shape.UNKNOWN
    bowl = node.kind in (NORM, "cosh") or (node.kind == POWER and node.data[0] % 2 == 0)
    if (most == Shape.AFFINE and bowl) or (most <= Shape.CONVEX and node.kind == "exp"):
        return Shape.CONVEX
    return Shape.UNKNOWN
