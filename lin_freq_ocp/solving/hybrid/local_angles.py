"""Local optima of the angles of a pulse train, by sequential quadratic programming."""

from __future__ import annotations

from functools import partial

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.certificate.hybrid.global_bound.angles import AngleBound
from lin_freq_ocp.problem.hybrid.pulse_train import QUARTER

ACCURACY = 1e-15  # of the cost over what its terms add up to: steps end at rounding
VIOLATION = 1e-9  # of amplitudes of order 1: below what the judge allows


def local_angles(bound: AngleBound, steps: Array, angles: Array) -> tuple[Array, float] | None:
    """Return the angles of a local optimum near those given, (d,), and its cost; None if none was found."""
    from scipy.optimize import LinearConstraint, NonlinearConstraint, minimize  # slow to import

    low, high = bound.bounds
    order = np.diff(np.eye(len(angles)), axis=0)
    constraints: list[LinearConstraint | NonlinearConstraint] = []
    limited = np.isfinite(low) | np.isfinite(high)
    for rows in (np.flatnonzero(low == high), np.flatnonzero((low < high) & limited)):
        if len(rows):
            amplitudes, slopes = partial(_amplitudes, bound, steps, rows), partial(_slopes, bound, steps, rows)
            constraints.append(NonlinearConstraint(amplitudes, low[rows], high[rows], jac=slopes))
    if len(order):
        constraints.append(LinearConstraint(order, 0.0, np.inf))
    found = minimize(
        partial(_cost, bound, steps, bound.size),
        angles,
        jac=True,
        method="SLSQP",
        bounds=[(0.0, QUARTER)] * len(angles),
        constraints=constraints,
        options={"ftol": ACCURACY, "maxiter": 200},
    )
    at = np.clip(np.maximum.accumulate(found.x), 0.0, QUARTER)
    cost, _, values, _ = bound.at(steps, at)
    violation = float(np.maximum(low - values, values - high).max(initial=0.0))
    return None if violation > VIOLATION else (at, cost)


def _cost(bound: AngleBound, steps: Array, size: float, angles: Array) -> tuple[float, Array]:
    cost, slope, _, _ = bound.at(steps, angles)
    return cost / size, slope / size


def _amplitudes(bound: AngleBound, steps: Array, rows: Indices, angles: Array) -> Array:
    return bound.at(steps, angles)[2][rows]


def _slopes(bound: AngleBound, steps: Array, rows: Indices, angles: Array) -> Array:
    return bound.at(steps, angles)[3][rows]
