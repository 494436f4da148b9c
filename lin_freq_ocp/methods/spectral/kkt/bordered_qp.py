"""The small QP with the border variables kept, for borders of little curvature: free ends without cost, marginal modes.

Eliminating a border variable of curvature h leaves S with entries 1/h, and entries below 1e-16 of those are lost.
Here they are kept, with a proximal term: find the step p of (theta, y), weights l and slacks z with

    K p + C (l - l_0) = r,   z - y = s_0 - C'p + S_W (l - l_0),   l >= 0,  z >= 0,  l'z = 0,

and y >= 0 with y'(u - l) = 0 at upper bounds l <= u, by Mehrotra's predictor-corrector on the symmetric indefinite
matrix [[K, C], [C', -(S_W + Z/L + Y/(U - L))]], then once more with the active rows as equations (docs/spectral.md, 7:
soft borders).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.methods.spectral import tolerances as tol
from lin_freq_ocp.methods.spectral.kkt.bordered_system import equilibration
from lin_freq_ocp.methods.spectral.kkt.interior_point import Caps, predictor_corrector

STEPS = 60  # after which the best iterate is returned; 10 to 30 are usual
DROPPINGS = 5  # passes that drop active rows of the wrong sign


@dataclass(frozen=True, eq=False)
class BorderedQp:
    """The data: K (b, b), C (b, count), S_W (count, count), r (b,), s_0, l_0 and u (count,); theta comes first."""

    size: int
    K: Array
    C: Array
    S: Array
    r: Array
    slack: Array
    weights: Array
    upper: Array

    def solve(self, stop: Callable[[], str | None] = lambda: None) -> tuple[Array, Array, bool]:
        """Return the step p, the weights l, and whether they are accurate; the best iterate when asked to stop.

        First without upper bounds, which are often far above the weights: they cost digits.
        """
        if np.isfinite(self.upper).any():
            step, weights, accurate = replace(self, upper=np.full(len(self.upper), np.inf)).solve(stop)
            if accurate and (weights <= self.upper).all():
                return step, weights, True
        scaled, border, rows, size = self._scaled()
        p, weights, z, accurate = _interior_point(scaled, stop)
        active, held = Caps(scaled.upper).split(weights, z)
        polished = None if stop() else _polished(scaled, active, held)
        weights, z = weights[: len(held)], z[: len(held)]
        if polished is None:
            idle = tol.IDLE_WEIGHT * np.maximum(z, float(weights.max(initial=0.0)))
            weights = np.where(weights < idle, 0.0, weights)
        else:
            p, weights = polished
        found = np.where(weights >= scaled.upper, self.upper, weights * rows * size)
        return p * border * size, found, accurate

    def _scaled(self) -> tuple[BorderedQp, Array, Array, float]:
        """Return the problem in units of order 1, with the units of p, of l, and of both."""
        units = equilibration(np.block([[self.K, self.C], [self.C.T, self.S]]))
        border, rows = np.split(units, [len(self.K)])
        parts = self.r * border, self.slack * rows, self.weights / rows
        size = max(1e-300, *(float(np.abs(part).max(initial=0.0)) for part in parts))
        regular = np.where(np.arange(len(self.K)) < self.size, tol.QP_RIDGE, -tol.QP_RIDGE)
        scaled = BorderedQp(
            size=self.size,
            K=self.K * border * border[:, None] + np.diag(regular),
            C=self.C * border[:, None] * rows,
            S=self.S * rows * rows[:, None],
            r=parts[0] / size,
            slack=parts[1] / size,
            weights=parts[2] / size,
            upper=self.upper / rows / size,
        )
        return scaled, border, rows, size


def _interior_point(qp: BorderedQp, stop: Callable[[], str | None]) -> tuple[Array, Array, Array, bool]:
    b, count = qp.C.shape
    caps, p = Caps(qp.upper), np.zeros(b)
    weights = caps.inside(np.ones(count), 1.0)
    z = caps.slacks(qp.slack + qp.S @ (weights[:count] - qp.weights), weights, 1.0)
    best = np.inf, p, weights, z
    matrix = np.empty((b + count, b + count), order="F")
    matrix[:b, :b], matrix[:b, b:], matrix[b:, :b] = qp.K, qp.C, qp.C.T
    diagonal = np.arange(b, b + count)
    for _ in range(STEPS):
        change = weights[:count] - qp.weights
        r1 = qp.r - qp.C @ change - qp.K @ p
        r2 = caps.slope(z) - qp.slack + qp.C.T @ p - qp.S @ change
        mu = float(weights @ z) / len(weights)
        error = max(float(np.abs(r1).max()), float(np.abs(r2).max()), mu) / (1 + float(weights[:count].max()))
        if error < best[0]:
            best = error, p, weights, z
        if (error < tol.BORDERED_SOLVED and mu < tol.BORDERED_COMPLEMENTARY) or not np.isfinite(error) or stop():
            break
        matrix[b:, b:] = -qp.S
        matrix[diagonal, diagonal] -= caps.diagonal(weights, z) + tol.QP_RIDGE
        factor, pivots, failed = dgetrf(matrix)
        if failed:
            break
        newton = partial(_newton, (factor, pivots), r1, r2, caps, weights)
        dp, weights, z, length = predictor_corrector(newton, weights, z, mu)
        p = p + dp
        if length < tol.SHORTEST_STEP:
            break
    error, p, weights, z = best
    return p, weights, z, error < tol.BORDERED_ACCURATE


def _newton(
    factor: tuple[Array, Array], r1: Array, r2: Array, caps: Caps, weights: Array, target: Array
) -> tuple[Array, Array]:
    """Return the Newton steps of p and of (l, u - l)."""
    step = dgetrs(*factor, np.concatenate([r1, -r2 - caps.slope(target / weights)]))[0]
    return step[: len(r1)], caps.steps(step[len(r1) :])


def _polished(qp: BorderedQp, active: Mask, held: Array) -> tuple[Array, Array] | None:
    """Return the step and weights with the active rows as equations; None if signs or slacks are wrong.

    The others keep their weights in ``held``, (count,): 0 or their upper bounds.
    """
    for _ in range(DROPPINGS):
        rows = np.flatnonzero(active)
        matrix = np.block([[qp.K, qp.C[:, rows]], [qp.C[:, rows].T, -qp.S[np.ix_(rows, rows)]]])
        idle = np.where(active, 0.0, qp.weights - held)
        right = np.concatenate([qp.r + qp.C @ idle, (qp.slack - qp.S @ idle)[rows]])
        factor, pivots, failed = dgetrf(matrix)
        if failed:
            return None
        step = dgetrs(factor, pivots, right)[0]
        step += dgetrs(factor, pivots, right - matrix @ step)[0]
        p, exact = step[: len(qp.r)], np.where(active, 0.0, held)
        exact[rows] = qp.weights[rows] + step[len(qp.r) :]
        if not np.isfinite(step).all():
            return None
        sign = tol.ACTIVE_SIGN * max(1.0, float(exact.max(initial=0.0)))
        below, above = exact < -sign, exact > qp.upper + sign
        if not (below | above).any():
            slack = qp.slack - qp.C.T @ p + qp.S @ (exact - qp.weights)
            wrong = np.where(exact >= qp.upper, slack > tol.POLISHED_SLACK, slack < -tol.POLISHED_SLACK)
            return None if wrong.any() else (p, np.clip(exact, 0.0, qp.upper))
        active, held = active & ~(below | above), np.where(above, qp.upper, held * ~active)
    return None
