"""Proofs of infeasibility: multipliers of rows and equations that no trajectory can satisfy (docs/spectral.md, 10).

A ray (l >= 0, y), with l = 0 on soft rows, proves it if forces G'l + E'y move nothing (N^* ghat = 0, and no slope in
theta) and the constraints, weighted by it, ask for the impossible: l'(limit - F c) + y'(e - E c) < 0 at any point c
that satisfies the dynamics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.methods.spectral import tolerances as tol
from lin_freq_ocp.methods.spectral.algorithm.structure import (
    Data,
    Signals,
    Structure,
    equation_residual,
    forces,
    signals,
)
from lin_freq_ocp.methods.spectral.kkt.dual_qp import bounded_qp
from lin_freq_ocp.methods.spectral.rows.working_set import WorkingSet


@dataclass(frozen=True, eq=False)
class Ray:
    """A Farkas ray, verified within this method: weights of the working rows, and multipliers of the equations."""

    working: WorkingSet
    multipliers: Array


def equation_ray(structure: Structure, data: Data, residual: Array) -> Ray | None:
    """Return a ray of the dependent equations."""
    dependent = structure.border.dependent
    y = -dependent @ (dependent.T @ residual)
    largest = float(np.abs(y).max(initial=0.0))
    return None if largest == 0 else verified(structure, data, WorkingSet(structure.border), y / largest)


def row_ray(
    structure: Structure,
    data: Data,
    working: WorkingSet,
    S: Array,
    d: Array,
    Z: Array,
    ask: bool,
    stop: Callable[[], str | None] = lambda: None,
) -> Ray | None:
    """Return a ray of working rows: a row that the equations decide, or (``ask``) a combination of many.

    The homogeneous dual min 1/2 l'S l + d'l + rho/2 (d'l)^2 is bounded; tau = 1 + rho d'l vanishes where rows conflict.
    """
    prices, free = working.prices(data.lti), working.free_response()
    hard = np.ones(len(working), dtype=bool) if prices is None else np.isinf(prices)
    decided = (np.diagonal(S) < tol.DECIDED_RESPONSE * free) & (
        d < -tol.DECIDED_VIOLATION * (1 + np.abs(working.limits(data.lti)))
    )
    decided &= hard
    weights = np.zeros(len(d))
    if decided.any():
        weights[np.argmin(np.where(decided, d, np.inf))] = 1.0
    elif ask and hard.any():
        S, b = S[np.ix_(hard, hard)], d[hard]
        size = np.abs(b) / np.sqrt(np.maximum(np.diagonal(S), tol.TINY_SQUARED))
        rho = max(float(size.max()), tol.TINY_SQUARED) ** -2
        weights[hard], _ = bounded_qp(S + rho * np.outer(b, b), b, np.zeros(len(b)), stop=stop)
        if not weights.any() or 1 + rho * float(d @ weights) >= tol.CONFLICT_TAU:
            return None
    else:
        return None
    weights /= weights.max()
    return verified(structure, data, working.weighted(weights), -(Z @ weights)[structure.border.size :])


def regularised_ray(
    structure: Structure, data: Data, working: WorkingSet, stop: Callable[[], str | None] = lambda: None
) -> Ray | None:
    """Return a ray of working rows from a unit Hessian of the border: feasibility does not depend on the cost."""
    border, (c, residual) = structure.border, _unforced(structure, data)
    step = border.regularised @ np.concatenate([np.zeros(border.size), residual])
    Z, S = working.eliminated(border.regularised)
    d = working.limits(data.lti) - working.values(c.y, c.last) - working.coupling.T @ step
    return row_ray(structure, data, working, S, d, Z, ask=True, stop=stop)


def verified(structure: Structure, data: Data, working: WorkingSet, y: Array) -> Ray | None:
    """Return the ray if it proves that these data are infeasible."""
    border, lti = structure.border, data.lti
    force, _ = forces(structure, lti, y, working)
    size = float(working.weights @ np.abs(lti.F[working.f]).sum(1) + np.abs(y).sum()) + 1e-300
    moved = sum(np.conj(structure.spaces.N[i]) * force[i] for i in range(len(lti.M)))
    stationarity = float(np.abs(moved).max()) / (max(float(np.abs(structure.spaces.N).max()), tol.TINY_SQUARED) * size)
    slope = np.abs(border.E.T @ y + working.coupling[: border.size] @ working.weights).max(initial=0.0)
    stationarity = max(stationarity, float(slope) / size)
    c, residual = _unforced(structure, data)
    limits = working.limits(lti)
    value = float(working.weights @ (limits - working.values(c.y, c.last)) + y @ residual)
    terms = float(working.weights @ np.abs(limits) + np.abs(y) @ np.abs(data.e)) + 1e-300
    proven = stationarity < tol.RAY_TOLERANCE * min(1.0, -tol.RAY_VALUE * value / terms)
    return Ray(working, y) if proven else None


def _unforced(structure: Structure, data: Data) -> tuple[Signals, Array]:
    """Return the point c without forces, and the residual of the equations there."""
    theta = np.zeros(structure.border.size)
    c, _ = signals(structure, data, theta, np.zeros(len(data.e)), WorkingSet(structure.border))
    return c, equation_residual(structure, data, theta, c)
