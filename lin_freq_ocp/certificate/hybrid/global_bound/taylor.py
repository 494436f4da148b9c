"""Lower bounds of a quadratic plus <sigma, f> over boxes of y = (x, u), by Taylor's formula with enclosures of f."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.certificate.hybrid.global_bound.tolerances import ROUNDING
from lin_freq_ocp.formulas.jets import IntervalJets, interval_jets, mean_value
from lin_freq_ocp.problem.hybrid.piecewise_smooth import SmoothMode


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

    hessian (p, k, k), gradient and r (p, k), given (p,), sigma and at (p, n). ``centre`` and ``whole`` enclose f at the
    centres y and over the boxes numbered by ``box`` (p,).
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
            for total, (low, high) in ((slope, centre.slopes), (wide, whole.slopes), (bend, whole.curvatures)):
                factor = s.reshape(-1, *[1] * (low.ndim - 2))
                for side, more in enumerate(_scaled(factor, low[box, j], high[box, j])):
                    total[side] = total[side] + more
        best = np.fmax(_second_order(slope, bend, r), _first_order(wide, r))
    infinite = np.isposinf(given)
    terms = np.where(infinite, 0.0, terms - np.where(np.isfinite(best), best, 0.0))
    return np.where(infinite, np.inf, value + best - ROUNDING * terms)


def enclosed(centre: IntervalJets, whole: IntervalJets, r: Array) -> tuple[Array, Array]:
    """Return bounds of values over |z| <= r: the intersection with those of the mean value theorem."""
    mean = mean_value(centre.values, whole.slopes, r)
    return np.fmax(whole.values[0], mean[0]), np.fmin(whole.values[1], mean[1])


def possible(mode: SmoothMode, lower: Array, upper: Array) -> Mask:
    """Whether a mode can hold somewhere in each box."""
    possible = np.ones(len(lower), dtype=bool)
    middle, radius = 0.5 * (lower + upper), 0.5 * (upper - lower)
    for formulas, sign in ((mode.region, 1.0), (mode.domain, -1.0)):
        if formulas:
            whole, centre = (interval_jets(formulas, *box, curved=False) for box in ((lower, upper), (middle, middle)))
            low, high = enclosed(centre, whole, radius)
            excluded = low > 0 if sign > 0 else high <= 0
            possible &= ~excluded.any(axis=1)
    return possible


def _second_order(slope: Sequence[Array], bend: Sequence[Array], r: Array) -> Array:
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


def _first_order(slope: Sequence[Array], r: Array) -> Array:
    """Return the least of slope z over |z| <= r, with any slope between two bounds."""
    found = np.where(r > 0, -np.maximum(np.abs(slope[0]), np.abs(slope[1])) * r, 0.0).sum(axis=1)
    return np.where(np.isnan(found), -np.inf, found)


def _scaled(factor: Array, low: Array, high: Array) -> tuple[Array, Array]:
    ends = factor * low, factor * high
    return np.fmin(*ends), np.fmax(*ends)
