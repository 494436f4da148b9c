"""Lower bounds of a quadratic plus <sigma, f> over boxes of y = (x, u), by Taylor's formula with enclosures of f."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lin_freq_ocp.arrays import Array, Indices, Mask
from lin_freq_ocp.formulas.jets import IntervalJets, interval_jets, mean_value
from lin_freq_ocp.problem.dynamics.piecewise_smooth import SmoothMode

ROUNDING = 64 * float(np.finfo(np.float64).eps)
"""Of the sum of absolute terms that a bound is made of, what is subtracted from it; boxes are wider by this part."""


def least_of(
    hessian: Array,
    gradient: Array,
    given: Array,
    sigma: Array,
    at: Array,
    r: Array,
    centre: IntervalJets,
    whole: IntervalJets,
    box: Indices,
) -> Array:
    """Return lower bounds of given + gradient z + 1/2 z' hessian z + sigma (f(y + z) - at) over |z| <= r, (p,).

    Parameters
    ----------
    hessian, gradient, given : (p, k, k), (p, k), (p,)
    sigma, at : (p, n)
    r : (p, k)
    centre, whole : IntervalJets
        Of f at the centres y, and over boxes.
    box : (p,)
        Which of the boxes of the jets is meant.
    """
    value, terms = given.copy(), np.abs(given)
    slope, bend = [gradient.copy(), gradient.copy()], [hessian.copy(), hessian.copy()]
    change = np.einsum("pi,pij->pj", r, np.abs(hessian))
    wide = [gradient - change, gradient + change]
    with np.errstate(invalid="ignore"):
        for j in range(sigma.shape[1]):
            s = sigma[:, j]
            reached = _scaled(s, centre.values[0][box, j], centre.values[1][box, j])
            value = value + reached[0] - s * at[:, j]
            terms += np.abs(reached[0]) + np.abs(s * at[:, j])
            for total, jets in ((slope, centre.slopes), (wide, whole.slopes)):
                more = _scaled(s[:, None], jets[0][box, j], jets[1][box, j])
                total[0], total[1] = total[0] + more[0], total[1] + more[1]
            more = _scaled(s[:, None, None], whole.curvatures[0][box, j], whole.curvatures[1][box, j])
            bend[0], bend[1] = bend[0] + more[0], bend[1] + more[1]
        best = np.fmax(_of_second_order(slope, bend, r), _of_first_order(wide, r))
    nothing = np.isposinf(given)
    terms = np.where(nothing, 0.0, terms - np.where(np.isfinite(best), best, 0.0))
    return np.where(nothing, np.inf, value + best - ROUNDING * terms)


def possible(mode: SmoothMode, lower: Array, upper: Array) -> Mask:
    """Whether a mode can hold somewhere in each box."""
    possible = np.ones(len(lower), dtype=bool)
    middle, radius = 0.5 * (lower + upper), 0.5 * (upper - lower)
    for formulas, sign in ((mode.region, 1.0), (mode.domain, -1.0)):
        if formulas:
            whole, centre = (interval_jets(formulas, *box, curved=False) for box in ((lower, upper), (middle, middle)))
            mean = mean_value(centre.values, whole.slopes, radius)
            low, high = np.fmax(whole.values[0], mean[0]), np.fmin(whole.values[1], mean[1])
            excluded = low > 0 if sign > 0 else high <= 0
            possible &= ~excluded.any(axis=1)
    return possible


def _of_second_order(slope: Sequence[Array], bend: Sequence[Array], r: Array) -> Array:
    """Return the least of slope z + 1/2 z' bend z over |z| <= r, both known to lie between two bounds."""
    at_most = np.maximum(np.abs(slope[0]), np.abs(slope[1]))
    largest = np.maximum(np.abs(bend[0]), np.abs(bend[1]))
    diagonal = np.arange(r.shape[1])
    largest[:, diagonal, diagonal] = 0.0
    across = (largest * r[:, None, :]).sum(axis=2) / np.where(r > 0, r, 1.0)
    curvature = bend[0][:, diagonal, diagonal] - across
    turned = (curvature > 0) & (at_most < curvature * r)
    inner = -(at_most**2) / (2 * np.where(turned, curvature, 1.0))
    found = np.where(r > 0, np.where(turned, inner, -at_most * r + 0.5 * curvature * r * r), 0.0).sum(axis=1)
    return np.where(np.isnan(found), -np.inf, found)


def _of_first_order(slope: Sequence[Array], r: Array) -> Array:
    """Return the least of slope z over |z| <= r, with any slope between two bounds."""
    found = np.where(r > 0, -np.maximum(np.abs(slope[0]), np.abs(slope[1])) * r, 0.0).sum(axis=1)
    return np.where(np.isnan(found), -np.inf, found)


def _scaled(factor: Array, low: Array, high: Array) -> tuple[Array, Array]:
    ends = factor * low, factor * high
    return np.fmin(*ends), np.fmax(*ends)
