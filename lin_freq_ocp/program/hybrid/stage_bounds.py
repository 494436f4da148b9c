"""What duals of a relaxation prove, stage by stage: the least Lagrangian of every mode over its box.

With eta of the links, lambda >= 0 of the regions and rho of the rows F over all times, in natural units y = (x, u),

    phi_ti = min over box_ti of  c_t(y) + <eta_{t-1}, x> - <eta_t, maps y + offsets> + <rho, F_t y> + <lambda, G y - h>,
    J within the mask >= sum_t min_i phi_ti + phi_T - <rho, right>,

be the duals those of a solution or not. Mode i at t alone is above this by phi_ti - min_j phi_tj.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.polyhedra import box_minimiser
from lin_freq_ocp.problem.hybrid.mode_reach import Reach
from lin_freq_ocp.program.hybrid.rows import ModeStages


@dataclass(frozen=True, eq=False)
class StageDuals:
    """eta (T, n), rho (q,) and lambda (T, modes, r) in natural units."""

    links: Array
    rows: Array
    regions: Array


@dataclass(frozen=True, eq=False)
class Lagrangian:
    """Hessians (T, k, k) and (n, n), prices (T+1, k), rows over all times (q, T+1, k) and right (q,), natural units."""

    hessians: Array
    last: Array
    price: Array
    rows: Array
    right: Array


class Quadratic:
    """1/2 y'H y for Hessians (..., k, k), to be minimised over boxes with slopes."""

    def __init__(self, hessians: Array):
        self._hessians, self._diagonal = hessians, np.diagonal(hessians, axis1=-2, axis2=-1)
        sizes = np.sqrt(np.where(self._diagonal > 0, self._diagonal, 1.0))
        normed = hessians / (sizes[..., None] * sizes[..., None, :])
        off = hessians - self._diagonal[..., None] * np.eye(hessians.shape[-1])
        convex = np.maximum(np.linalg.eigvalsh(normed)[..., :1], 0.0)
        self._least = convex * self._diagonal  # H - diag(least) is positive semidefinite
        self._coupled = np.asarray(off.any(axis=tuple(range(1, off.ndim)) if off.ndim > 2 else None))  # at which times

    def least(self, slope: Array, low: Array, high: Array) -> Array:
        """Return lower bounds of slope'y + 1/2 y'H y over boxes, (...), times first where H depends on them."""
        at = self._coupled
        if not at.any():
            return _box_minimum(slope, self._diagonal, low, high)
        if at.all():
            return _coupled_minimum(slope, self._hessians, self._least, low, high)
        found = _box_minimum(slope, self._diagonal, low, high)
        found[at] = _coupled_minimum(slope[at], self._hessians[at], self._least[at], low[at], high[at])
        return found


class StageBounds:
    """Bounds of one problem whose only terms beyond boxes are linear equations over all times."""

    def __init__(self, stages: ModeStages, parts: Lagrangian):
        price, rows, self._n = parts.price, parts.rows, len(parts.last)
        self._stages, self._price, self._right = stages, price, parts.right
        self._rows = rows.reshape(len(rows), price.size)
        self._cost, self._last = Quadratic(parts.hessians[:, None]), Quadratic(parts.last)
        finite = np.isfinite(stages.limits)
        self._limits = np.where(finite, stages.limits, 0.0)

    def phi(self, reach: Reach, duals: StageDuals) -> tuple[Array, float]:
        """Return phi (T, modes), inf for modes that are not allowed, and the rest of the bound."""
        stages, n, eta = self._stages, self._n, duals.links
        slope = self._price + (duals.rows @ self._rows).reshape(self._price.shape)
        slope[1:, :n] += eta
        own = slope[:-1, None] - (eta[:, None, None] @ stages.maps)[:, :, 0]
        own += (duals.regions[:, :, None] @ stages.rows)[:, :, 0]
        constant = -(stages.offsets @ eta[..., None])[..., 0] - (duals.regions * self._limits).sum(axis=-1)
        low, high = (stages.scaled(bounds) for bounds in (reach.mode_lower, reach.mode_upper))
        found = np.where(reach.allowed, constant + self._cost.least(own, low, high), np.inf)
        units = stages.units[:n]
        ends = ((bounds[-1] - stages.last_reference) / units for bounds in (reach.lower, reach.upper))
        return found, float(self._last.least(slope[-1, :n], *ends)) - float(duals.rows @ self._right)


def _coupled_minimum(slope: Array, hessians: Array, least: Array, low: Array, high: Array) -> Array:
    """Return lower bounds where H is not diagonal, H - diag(least) being positive semidefinite."""
    y = box_minimiser(slope, hessians, low, high)
    moved = (hessians * y[..., None, :]).sum(axis=-1)
    there = ((slope + 0.5 * moved) * y).sum(axis=-1)
    return there + _box_minimum(slope + moved, least, low - y, high - y)


def _box_minimum(slope: Array, curvature: Array, low: Array, high: Array) -> Array:
    """Return the least slope'v + 1/2 sum_j curvature_j v_j^2 over boxes."""
    curved = curvature > 0
    v = np.where(curved, -slope / np.where(curved, curvature, 1.0), np.where(slope > 0, low, high))
    v = np.clip(v, low, high)
    return ((slope + 0.5 * curvature * v) * v).sum(axis=-1)
