"""The small QP with the border variables kept, for borders that hardly curve: free ends without cost, marginal modes.

Eliminating a border variable of curvature h leaves S with entries 1/h, and what is smaller than 1e-16 of those is
lost. Kept, with a proximal term, nothing large arises: find the step p of (theta, y), weights l and slacks z with

    K p + C (l - l_0) = r,   z = s_0 - C'p + S_W (l - l_0),   l >= 0,  z >= 0,  l'z = 0,

by Mehrotra's predictor-corrector on the symmetric indefinite matrix [[K, C], [C', -(S_W + Z/L)]], then once more with
the active rows as equations (docs/spectral.md, 7: soft borders).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.methods.spectral.kkt.mehrotra import predictor_corrector

STEPS = 60
"""Steps after which what was best is returned; 10 to 30 are usual."""

SOLVED = 1e-12
"""Defects and complementarity, of a problem scaled to order 1, at which it stops."""

COMPLEMENTARY = 1e-14
"""Complementarity of the same problem at which it stops: the cost may be small at that scale. Further steps lose digits
of the equations: at 1e-16, one of 900 random problems ends with residuals of 1e-6."""

ACCURATE_ERROR = 1e-7
"""Error up to which the answer is good."""

RIDGE = 1e-13
"""Regularisation of the scaled matrices: dependent rows and equations then share their multipliers."""

SHORTEST = 1e-8
"""Step length at which it is stuck."""

ACTIVE_SIGN = 1e-11
"""Weight of an active row, relative to the largest, that may be negative by rounding."""

EQUILIBRATIONS = 3
"""Passes of row scaling."""

POLISHED_SLACK = 1e-10
"""Violation of a row at which a polished answer is one."""

IDLE = 1e-9
"""Weight, relative to slacks and weights, that an interior point leaves on rows without one."""

DROPPINGS = 5
"""Passes that drop active rows of the wrong sign."""


@dataclass(frozen=True, eq=False)
class BorderedQp:
    """The data: K (b, b), C (b, count), S_W (count, count), r (b,), s_0 and l_0 (count,); theta comes first."""

    size: int
    K: Array
    C: Array
    S: Array
    r: Array
    slack: Array
    weights: Array

    def solve(self, stop: Callable[[], str | None] = lambda: None) -> tuple[Array, Array, bool]:
        """Return the step p, the weights l, and whether they are accurate; the best there is when asked to stop."""
        scaled, border, rows, size = self._scaled()
        p, weights, z, accurate = _interior_point(scaled, stop)
        polished = None if stop() else _polished(scaled, weights > z)
        if polished is None:
            weights = np.where(weights < IDLE * np.maximum(z, float(weights.max(initial=0.0))), 0.0, weights)
        else:
            p, weights = polished
        return p * border * size, weights * rows * size, accurate

    def _scaled(self) -> tuple[BorderedQp, Array, Array, float]:
        """Return the problem in units of order 1, with the units of p, of l, and of both."""
        matrix, units = np.block([[self.K, self.C], [self.C.T, self.S]]), np.ones(len(self.K) + len(self.S))
        for _ in range(EQUILIBRATIONS):
            largest = np.abs(matrix * units[:, None] * units).max(1)
            units /= np.sqrt(np.where(largest > 0, largest, 1.0))
        border, rows = np.split(units, [len(self.K)])
        parts = self.r * border, self.slack * rows, self.weights / rows
        size = max(1e-300, *(float(np.abs(part).max(initial=0.0)) for part in parts))
        regular = np.where(np.arange(len(self.K)) < self.size, RIDGE, -RIDGE)
        scaled = BorderedQp(
            size=self.size,
            K=self.K * border * border[:, None] + np.diag(regular),
            C=self.C * border[:, None] * rows,
            S=self.S * rows * rows[:, None],
            r=parts[0] / size,
            slack=parts[1] / size,
            weights=parts[2] / size,
        )
        return scaled, border, rows, size


def _interior_point(qp: BorderedQp, stop: Callable[[], str | None]) -> tuple[Array, Array, Array, bool]:
    b, count = qp.C.shape
    p, weights = np.zeros(b), np.ones(count)
    z = np.maximum(qp.slack + qp.S @ (weights - qp.weights), 1.0)
    best = np.inf, p, weights, z
    matrix = np.empty((b + count, b + count), order="F")
    matrix[:b, :b], matrix[:b, b:], matrix[b:, :b] = qp.K, qp.C, qp.C.T
    diagonal = np.arange(b, b + count)
    for _ in range(STEPS):
        change = weights - qp.weights
        r1 = qp.r - qp.C @ change - qp.K @ p
        r2 = z - qp.slack + qp.C.T @ p - qp.S @ change
        mu = float(weights @ z) / count
        error = max(float(np.abs(r1).max()), float(np.abs(r2).max()), mu) / (1 + float(weights.max()))
        if error < best[0]:
            best = error, p, weights, z
        if (error < SOLVED and mu < COMPLEMENTARY) or not np.isfinite(error) or stop():
            break
        matrix[b:, b:] = -qp.S
        matrix[diagonal, diagonal] -= z / weights + RIDGE
        factor = dgetrf(matrix)
        if factor[2]:
            break
        newton = _newton(factor, r1, r2, weights)
        dp, weights, z, length = predictor_corrector(newton, weights, z, mu)
        p = p + dp
        if length < SHORTEST:
            break
    error, p, weights, z = best
    return p, weights, z, error < ACCURATE_ERROR


def _newton(factor: Any, r1: Array, r2: Array, weights: Array) -> Callable[[Array], tuple[Array, Array]]:
    """Return what solves the Newton equations for the steps of p and l."""

    def newton(target: Array) -> tuple[Array, Array]:
        step = dgetrs(factor[0], factor[1], np.concatenate([r1, -r2 - target / weights]))[0]
        return step[: len(r1)], step[len(r1) :]

    return newton


def _polished(qp: BorderedQp, active: Mask) -> tuple[Array, Array] | None:
    """Return the step and weights with the active rows as equations; None where signs or slacks do not allow it."""
    for _ in range(DROPPINGS):
        rows = np.flatnonzero(active)
        matrix = np.block([[qp.K, qp.C[:, rows]], [qp.C[:, rows].T, -qp.S[np.ix_(rows, rows)]]])
        idle = np.where(active, 0.0, qp.weights)
        right = np.concatenate([qp.r + qp.C @ idle, (qp.slack - qp.S @ idle)[rows]])
        factor, pivots, failed = dgetrf(matrix)
        if failed:
            return None
        step = dgetrs(factor, pivots, right)[0]
        step += dgetrs(factor, pivots, right - matrix @ step)[0]
        p, exact = step[: len(qp.r)], np.zeros(len(active))
        exact[rows] = qp.weights[rows] + step[len(qp.r) :]
        if not np.isfinite(step).all():
            return None
        wrong = exact < -ACTIVE_SIGN * max(1.0, float(exact.max(initial=0.0)))
        if not wrong.any():
            slack = qp.slack - qp.C.T @ p + qp.S @ (exact - qp.weights)
            return (p, np.maximum(exact, 0.0)) if slack.min(initial=0.0) > -POLISHED_SLACK else None
        active = active & ~wrong
    return None
