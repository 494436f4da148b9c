"""Formulas at points: their values, and with them their first and second derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.formulas.jet_rules import Jet
from lin_freq_ocp.formulas.nodes import Formula, in_order
from lin_freq_ocp.formulas.operations import OPERATIONS, Points


@dataclass(frozen=True, eq=False)
class Jets:
    """Formulas at points y = (x, u), with derivatives.

    Attributes
    ----------
    values : (points, formulas)
    slopes : (points, formulas, n + m)
    curvatures : (points, formulas, n + m, n + m)
    """

    values: Array
    slopes: Array
    curvatures: Array


def jets(formulas: Sequence[Formula], y: Array, selections: Mapping[Formula, Array] | None = None) -> Jets:
    """Return formulas without maxima and minima at points, with derivatives; what is undefined there is not a number.

    Parameters
    ----------
    y : (points, n + m)
    selections : mapping from norms to (points, components), optional
        Where the rows are numbers, they stand for the derivative of the norm by its arguments, and its curvature is 0.
        At zero without a selection, the derivative is 0.
    """
    points, k = y.shape
    at, found = Points(y, selections or {}), dict[Formula, Jet]()
    with np.errstate(all="ignore"):
        for node in in_order(formulas):
            arguments = [found[argument] for argument in node.arguments]
            found[node] = OPERATIONS[node.kind].jet(node, arguments, at)
    shape = (points, len(formulas))
    values, slopes, curvatures = np.empty(shape), np.empty((*shape, k)), np.empty((*shape, k, k))
    for i, formula in enumerate(formulas):
        values[:, i], slopes[:, i], curvatures[:, i] = found[formula]
    return Jets(values, slopes, curvatures)


def values_of(formulas: Sequence[Formula], y: Array) -> Array:
    """Return the values of formulas without maxima and minima alone, (points, formulas), at y (points, n + m)."""
    at, found = Points(y, {}), dict[Formula, Array]()
    with np.errstate(all="ignore"):
        for node in in_order(formulas):
            arguments = [found[argument] for argument in node.arguments]
            found[node] = OPERATIONS[node.kind].value(node, arguments, at)
    return np.stack([found[formula] for formula in formulas], axis=1) if formulas else np.empty((len(y), 0))
