"""Mehrotra's predictor-corrector for z = A lam + b >= 0, lam >= 0, lam'z = 0, and a polish on the rows with lam > z.

On saturated control arcs A has eigenvalues near 0 and 1, and multipliers are not unique: active-set methods cycle.
There diag(unconstrained) - A is positive semidefinite and of low rank, the bandwidth of the stop band times the length
of the arcs: each step is then a small system (docs/spectral.md, 6).

Mehrotra (1992), On the implementation of a primal-dual interior point method.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dsyrk
from scipy.linalg.lapack import dpotrf, dpotrs, dpstrf

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.methods.spectral import tolerances as tol

STEPS = 60  # after which the best iterate is returned; 10 to 25 are usual
LOW_RANK_ROWS = 200  # from which a factor of low rank saves time
TO_BOUNDARY = 0.995  # fraction of the step to the boundary
POLISHES = 3  # refinements of the polish: each squares the relative error of the factor


def interior_point(
    A: Array, b: Array, unconstrained: Array | None, stop: Callable[[], str | None] = lambda: None
) -> tuple[Array, bool]:
    """Return (lam, whether it is accurate); ``unconstrained`` and ``stop`` as in ``nonnegative_qp``."""
    system, ridge, count = _System(A, unconstrained), tol.INTERIOR_RIDGE, len(b)
    lam, z = np.ones(count), np.maximum(A.sum(1) + b, 1.0)
    best = np.inf, lam, z
    for _ in range(STEPS):
        defect, mu = z - A @ lam - b, float(lam @ z) / count
        error = max(float(np.abs(defect).max()), mu) / (1 + float(lam.max()))
        if error < best[0]:
            best = error, lam, z
        if error < tol.INTERIOR_SOLVED or not error <= tol.DIVERGED_ERROR * best[0] or stop():
            break
        if not system.factor(z / lam + ridge):
            ridge *= 100
            if ridge > tol.LARGEST_RIDGE:
                break
            continue
        newton = partial(_newton, system, lam, defect)
        _, lam, z, length = predictor_corrector(newton, lam, z, mu, max(TO_BOUNDARY, 1 - mu))
        if length < tol.INTERIOR_ACCURATE:
            break
    error, lam, z = best
    return _polished(system, b, lam, np.asarray(lam > z)), error < tol.INTERIOR_ACCURATE


def _newton(system: _System, lam: Array, defect: Array, target: Array) -> tuple[Array, Array]:
    """Return the steps of no other unknowns and of lam."""
    return np.zeros(0), system.solve(defect + target / lam)


def _polished(system: _System, b: Array, lam: Array, active: Mask) -> Array:
    """Return lam with zero slope on the active rows and zeros elsewhere, if that keeps it positive."""
    lam = np.where(active, lam, 0.0)
    if not active.any() or not system.factor(np.where(active, tol.INTERIOR_RIDGE, tol.HOLDING_DIAGONAL)):
        return lam
    polished = lam.copy()
    for _ in range(POLISHES):
        slope = np.where(active, system.A @ polished + b, 0.0)
        polished = polished - np.where(active, system.solve(slope), 0.0)

    def slope_left(v: Array) -> float:
        return float(np.abs((system.A @ v + b)[active]).max())

    better = np.maximum(polished, 0.0)
    return better if slope_left(better) < slope_left(lam) else lam


class _System:
    """Factors of A + diag(w): dense, or by a thin V with A = diag(unconstrained) - V V'."""

    def __init__(self, A: Array, unconstrained: Array | None):
        self.A, self.V, self.base = A, None, unconstrained
        if unconstrained is not None and len(A) > LOW_RANK_ROWS and (unconstrained > 0).all():
            factor, pivots, rank, _ = dpstrf(np.diag(unconstrained) - A, tol=tol.RANK_TOLERANCE, lower=1)
            if rank < len(A) / 2:
                V = np.empty((len(A), rank), order="F")
                V[pivots - 1] = np.tril(factor)[:, :rank]
                missed = unconstrained - np.diagonal(A) - (V * V).sum(1)
                self.V = V if np.abs(missed).max() < tol.LOW_RANK_ERROR else None

    def factor(self, w: Array) -> bool:
        """Factor A + diag(w); False if it is not positive definite."""
        self.w = w
        if self.V is None or self.base is None:
            matrix = np.asfortranarray(self.A + np.diag(w))
        else:
            scaled = self.V / np.sqrt(self.base + w)[:, None]
            matrix = np.eye(self.V.shape[1]) - dsyrk(1.0, scaled, trans=1, lower=1)
        self.lower, failed = dpotrf(matrix, lower=1, overwrite_a=1, clean=0)
        return failed == 0

    def solve(self, r: Array) -> Array:
        """Return (A + diag(w))^{-1} r, refined once where it comes from the thin factor."""
        if self.V is None:
            return dpotrs(self.lower, r, lower=1)[0]
        x = self._by_low_rank(r)
        return x + self._by_low_rank(r - self.A @ x - self.w * x)

    def _by_low_rank(self, r: Array) -> Array:
        assert self.V is not None
        assert self.base is not None
        diagonal = self.base + self.w
        return (r + self.V @ dpotrs(self.lower, self.V.T @ (r / diagonal), lower=1)[0]) / diagonal


class Step(NamedTuple):
    """The step of other unknowns, the new weights and slacks, and the step length."""

    other: Array
    weights: Array
    z: Array
    length: float


def predictor_corrector(
    newton: Callable[[Array], tuple[Array, Array]],
    weights: Array,
    z: Array,
    mu: float,
    to_boundary: float = TO_BOUNDARY,
) -> Step:
    """Return the step from weights l > 0 and slacks z > 0 with mu = l'z / count.

    ``newton`` returns the steps of other unknowns and of l for the target of the equations z dl + l dz = target.
    """
    _, dw = newton(-weights * z)
    dz = (-weights * z - z * dw) / weights
    length = min(1.0, _reach(weights, dw), _reach(z, dz))
    after = float((weights + length * dw) @ (z + length * dz)) / float(weights @ z)
    target = after**3 * mu - weights * z - dw * dz
    other, dw = newton(target)
    dz = (target - z * dw) / weights
    length = min(1.0, to_boundary * min(_reach(weights, dw), _reach(z, dz)))
    return Step(length * other, weights + length * dw, z + length * dz, length)


def _reach(v: Array, dv: Array) -> float:
    """Return the step at which the first entry of v + step dv becomes zero."""
    return 1 / max(tol.TINY, float((-dv / v).max()))
