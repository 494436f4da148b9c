"""Formulas with first and second derivatives, at points and over boxes (natural interval extensions).

Points of a box at which a formula is undefined (a logarithm of numbers below zero, a quotient by zero) are left out of
the enclosure of its values; its derivatives are then unbounded. Over a box in which all arguments of a norm can be
zero, its Hessian is unbounded, and its gradient contains all of Clarke's subdifferential.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.formulas.intervals import Interval, outward
from lin_freq_ocp.formulas.nodes import Formula, evaluate
from lin_freq_ocp.formulas.operations import OPERATIONS, BoxAtTime, Points

# Sums of a few products of numbers that are not negative are widened by this part.
OUTWARD_SUM = 64 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class Jets:
    """Formulas at points y = (x, u): values (points, formulas), slopes (..., n + m), curvatures (..., n + m, n + m)."""

    values: Array
    slopes: Array
    curvatures: Array


@dataclass(frozen=True, eq=False)
class IntervalJets:
    """Enclosures (lower, upper) of formulas over boxes of y = (x, u), each array as in ``Jets``."""

    values: Interval
    slopes: Interval
    curvatures: Interval


def jets_of(
    formulas: Sequence[Formula],
    y: Array,
    selections: Mapping[Formula, Array] | None = None,
    times: Indices | None = None,
) -> Jets:
    """Return formulas without maxima and minima at points y (points, n + m); nan where they are undefined.

    ``times`` are those of the points, (points,), or (1,) for all; None: 0, 1, 2, ..., those of a trajectory.
    Where the selection of a norm, (points, components), is a number, it is the derivative of the norm by its arguments,
    and its curvature is 0. At zero without a selection, the derivative is 0.
    """
    points, k = y.shape
    shape = points, len(formulas)
    at = Points(y, np.arange(points) if times is None else times, {} if selections is None else {**selections})
    with np.errstate(all="ignore"):
        results = evaluate(formulas, lambda node, arguments: OPERATIONS[node.kind].jet(node, arguments, at))
    values, slopes, curvatures = np.empty(shape), np.empty((*shape, k)), np.zeros((*shape, k, k))
    for i, (value, slope, curvature) in enumerate(results):
        values[:, i], slopes[:, i] = value, slope.T
        if curvature is not None:
            curvatures[:, i] = curvature.transpose(2, 0, 1)
    return Jets(values, slopes, curvatures)


def values_of(formulas: Sequence[Formula], y: Array, times: Indices | None = None) -> Array:
    """Return the values of formulas alone, (points, formulas), at y (points, n + m) and times as for ``jets_of``."""
    at = Points(y, np.arange(len(y)) if times is None else times, {})
    with np.errstate(all="ignore"):
        results = evaluate(formulas, lambda node, arguments: OPERATIONS[node.kind].value(node, arguments, at))
    return np.stack(results, axis=1) if results else np.empty((len(y), 0))


def interval_jets(
    formulas: Sequence[Formula], lower: Array, upper: Array, curved: bool = True, time: int | Indices | None = None
) -> IntervalJets:
    """Return enclosures of formulas without maxima and minima over boxes lower <= y <= upper, (boxes, n + m).

    They are those at a time, or at a time for each box; None: at all times.
    Without ``curved`` the Hessians are not computed: they are zeros. UnsupportedError: a function has no enclosures.
    """
    boxes, k = lower.shape
    shape, box = (boxes, len(formulas)), BoxAtTime(lower, upper, time)
    with np.errstate(all="ignore"):
        results = evaluate(
            formulas, lambda node, arguments: OPERATIONS[node.kind].interval_jet(node, arguments, box, curved)
        )
    values, slopes, curvatures = np.empty((2, *shape)), np.empty((2, *shape, k)), np.zeros((2, *shape, k, k))
    for i, (value, slope, curvature) in enumerate(results):
        values[:, :, i], slopes[:, :, i] = value, slope
        if curvature is not None:
            curvatures[:, :, i] = curvature
    return IntervalJets((values[0], values[1]), (slopes[0], slopes[1]), (curvatures[0], curvatures[1]))


def mean_value(at_centre: Interval, slopes: Interval, radii: Array) -> Interval:
    """Return the enclosure f(c) + [Df] [-r, r], (boxes, formulas), over boxes of radii r (boxes, n + m)."""
    with np.errstate(invalid="ignore"):
        steepest = np.maximum(np.abs(slopes[0]), np.abs(slopes[1])) * radii[:, None, :]
    reach = np.where(radii[:, None, :] > 0, steepest, 0.0).sum(-1) * (1 + OUTWARD_SUM)
    return outward(at_centre[0] - reach, at_centre[1] + reach)
