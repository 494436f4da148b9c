"""Formulas over boxes: enclosures of their values, gradients and Hessians (natural interval extensions).

Points of a box at which a formula is undefined (a logarithm of numbers below zero, a quotient by zero) are left out of
the enclosure of its values; its derivatives are then unbounded. Over a box in which all arguments of a norm can be
zero, its Hessian is unbounded, and its gradient contains all of Clarke's subdifferential.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.formulas.interval_jet_rules import IntervalJet
from lin_freq_ocp.formulas.intervals import Interval, outward
from lin_freq_ocp.formulas.nodes import Formula, in_order
from lin_freq_ocp.formulas.operations import OPERATIONS

# Sums of a few products of numbers that are not negative are widened by this part.
OUTWARD_SUM = 64 * float(np.finfo(np.float64).eps)


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


def interval_jets(formulas: Sequence[Formula], lower: Array, upper: Array, curved: bool = True) -> IntervalJets:
    """Return enclosures of formulas without maxima and minima over boxes lower <= y <= upper, (boxes, n + m).

    Without ``curved`` the Hessians are left out: they are zero for all formulas.
    """
    boxes, k = lower.shape
    found: dict[Formula, IntervalJet] = {}
    with np.errstate(all="ignore"):
        for node in in_order(formulas):
            arguments = [found[argument] for argument in node.arguments]
            found[node] = OPERATIONS[node.kind].interval_jet(node, arguments, (lower, upper), curved)
    shape = (boxes, len(formulas))
    values = np.empty((2, *shape))
    slopes, curvatures = np.empty((2, *shape, k)), np.zeros((2, *shape, k, k))
    for i, formula in enumerate(formulas):
        value, slope, curvature = found[formula]
        values[:, :, i], slopes[:, :, i] = value, slope
        if curvature is not None:
            curvatures[:, :, i] = curvature
    return IntervalJets((values[0], values[1]), (slopes[0], slopes[1]), (curvatures[0], curvatures[1]))


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
