"""What duals of a path relaxation prove: the shortest path, the least Lagrangian over its box being an edge's length.

With eta_tj of the vertex of mode j at t + 1, in natural units y = (x, u), and lambda >= 0, nu, rho as below,

    phi_tij = min over box_ti of  c_t(y) + <eta_{t-1,i}, x> - <eta_tj + nu_tij, f_ti(y)> + <lambda_tij, G_ti y - h_ti>
                                  + <rho, F_t y>  +  min over box_{t+1,j} of <nu_tij, x>,
    J within the mask >= min over paths of sum_t phi_{t, i_t, i_{t+1}} + phi_T - <rho, right>,

be the duals those of a solution or not: along a trajectory, what is added is at most zero or cancels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.program.hybrid.paths import PathModel
from lin_freq_ocp.program.hybrid.stage_bounds import Quadratic


@dataclass(frozen=True, eq=False)
class PathDuals:
    """Duals in natural units; eta_C = 0 for a proof that there is no trajectory.

    vertices (T, modes, n): eta_tj, those of T - 1 in mode 0; regions (T, modes, modes, r): lambda; images (T, modes,
    modes, n): nu; coupled (q,): rho; adjoint (T, n): eta_tj averaged by weights.
    """

    vertices: Array
    regions: Array
    images: Array
    coupled: Array
    adjoint: Array
    eta_C: float

    def times(self, factor: float) -> PathDuals:
        """Return the duals of the same relaxation with its cost in other units."""
        if not self.eta_C:
            return self
        vertices, regions, images = (factor * part for part in (self.vertices, self.regions, self.images))
        return PathDuals(vertices, regions, images, factor * self.coupled, factor * self.adjoint, self.eta_C)


class PathBounds:
    """Bounds of one problem; Hessians (T+1, k, k) in natural units."""

    def __init__(self, model: PathModel, hessians: Array):
        self._model, self._cost = model, Quadratic(hessians[:, None, None])
        self._feasible = Quadratic(np.zeros_like(hessians[:, None, None]))
        self._limits = np.where(np.isfinite(model.limits), model.limits, 0.0)

    def bound(self, pairs: Mask, low: Array, high: Array, duals: PathDuals) -> float:
        """Return what duals prove of edges (T, modes, modes) and boxes (T+1, modes, k): inf where there is no path."""
        value = np.zeros(pairs.shape[1])
        for length in self.lengths(pairs, low, high, duals)[::-1]:
            value = (length + value).min(axis=1)
        return float(value.min()) - float(duals.coupled @ self._model.right)

    def lengths(self, pairs: Mask, low: Array, high: Array, duals: PathDuals) -> Array:
        """Return phi (T+1, modes, modes), inf where an edge is missing; at T, of mode 0 to mode 0."""
        model, eta = self._model, duals.vertices
        T, modes, n = eta.shape
        slope = duals.eta_C * model.price + np.tensordot(duals.coupled, model.coupled, axes=1)
        own = np.zeros((T + 1, modes, modes, slope.shape[1]))
        own += slope[:, None, None]
        own[1:, ..., :n] += eta[:, :, None]
        ahead = eta[:, None] + duals.images
        own[:-1] -= ahead @ model.maps[:-1]
        own[:-1] += duals.regions @ model.rows[:-1]
        constant = np.zeros((T + 1, modes, modes))
        constant[:-1] -= (ahead @ model.offsets[:-1, :, :, None])[..., 0]
        constant[:-1] -= (duals.regions @ self._limits[:-1, :, :, None])[..., 0]
        ends = low[1:, None, :, :n], high[1:, None, :, :n]
        constant[:-1] += np.where(duals.images > 0, *(duals.images * end for end in ends)).sum(axis=-1)
        cost = self._cost if duals.eta_C else self._feasible
        found = constant + cost.least(own, low[:, :, None], high[:, :, None])
        present = np.zeros(found.shape, dtype=bool)
        present[:-1], present[-1, 0, 0] = pairs, True
        return np.where(present, found, np.inf)

    def later(self, duals: PathDuals) -> PathDuals:
        """Return duals moved to the time before, for a problem that begins one time later.

        What comes in at the end has the adjoint of the end before, and no other multipliers. Rows over all times keep
        what is nearest to their sum, shifted in a circle.
        """
        T = len(duals.vertices)
        vertices, regions, images = (
            np.concatenate([part[1:], np.zeros_like(part[:1])])
            for part in (duals.vertices, duals.regions, duals.images)
        )
        vertices[T - 2 :] = duals.vertices[-1, 0]  # of x_T: at T - 1 there are now modes
        for part in (regions, images):
            part[T - 2] = part[T - 2, :, :1]
        adjoint = np.concatenate([duals.adjoint[1:], duals.adjoint[-1:]])
        if not len(duals.coupled):
            return PathDuals(vertices, regions, images, duals.coupled, adjoint, duals.eta_C)
        total = np.tensordot(duals.coupled, self._model.coupled, axes=1)
        total[:-1] = np.roll(total[:-1], -1, axis=0)
        rows = self._model.coupled.reshape(len(duals.coupled), -1)
        coupled = np.linalg.lstsq(rows.T, total.ravel(), rcond=None)[0].astype(np.float64)
        return PathDuals(vertices, regions, images, coupled, adjoint, duals.eta_C)
