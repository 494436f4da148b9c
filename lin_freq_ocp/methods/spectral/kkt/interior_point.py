"""Mehrotra's predictor-corrector for min lam'A lam / 2 + b'lam over 0 <= lam <= u, and a polish on the active rows.

A lam + b = z - y with lam >= 0, z >= 0, lam'z = 0, and, where u is finite, room w = u - lam >= 0, y >= 0, w'y = 0.

On saturated control arcs A has eigenvalues near 0 and 1, and multipliers are not unique: active-set methods cycle.
There A is of low rank, the width of the pass band times the length of the arcs, or diag(unconstrained) - A >= 0 is,
with the width of the stop band: each step is then a small system (docs/spectral.md, 6).

Mehrotra (1992), On the implementation of a primal-dual interior point method.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dsyrk
from scipy.linalg.lapack import dpotrf, dpotrs, dpstrf

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.methods.spectral import tolerances as tol

STEPS = 60  # after which the best iterate is returned; 10 to 25 are usual
LOW_RANK_ROWS = 200  # from which a factor of low rank saves time ...
LARGEST_SHARE = 0.45  # ... and rank over rows up to which it does
TO_BOUNDARY = 0.995  # fraction of the step to the boundary
REFINED = 1e-8  # diagonal added to a thin factor below which solves are refined
WARM = 1e-2  # least weight and slack of a warm start
POLISHES = 3  # refinements of the polish: each squares the relative error of the factor


def interior_point(
    A: Array,
    b: Array,
    unconstrained: Array | None,
    stop: Callable[[], str | None] = lambda: None,
    start: Array | None = None,
    upper: Array | None = None,
) -> tuple[Array, bool]:
    """Return (lam, whether it is accurate); what follows b is as in ``bounded_qp``."""
    system, ridge, count = _thin(A, unconstrained) or _Dense(A), tol.INTERIOR_RIDGE, len(b)
    lam, least = (np.ones(count), 1.0) if start is None or not start.any() else (start, WARM)
    caps = Caps(np.full(count, np.inf) if upper is None else upper)
    weights = caps.inside(lam, least)
    z = caps.slacks(system.times(weights[:count]) + b, weights, least)
    best = np.inf, weights, z
    for _ in range(STEPS):
        lam = weights[:count]
        defect, mu = caps.slope(z) - system.times(lam) - b, float(weights @ z) / len(weights)
        error = max(float(np.abs(defect).max()), mu) / (1 + float(lam.max()))
        if error < best[0]:
            best = error, weights, z
        if error < tol.INTERIOR_SOLVED or not error <= tol.DIVERGED_ERROR * best[0] or stop():
            break
        if not system.factor(caps.diagonal(weights, z) + ridge):
            ridge *= 100
            if ridge > tol.LARGEST_RIDGE:
                break
            continue
        newton = partial(_newton, system, caps, weights, defect)
        _, weights, z, length = predictor_corrector(newton, weights, z, mu, max(TO_BOUNDARY, 1 - mu))
        if length < tol.INTERIOR_ACCURATE:
            break
    error, weights, z = best
    return _polished(system, b, caps, weights, z), error < tol.INTERIOR_ACCURATE


def _newton(system: _Dense | _Thin, caps: Caps, weights: Array, defect: Array, target: Array) -> tuple[Array, Array]:
    """Return the steps of no other unknowns and of (lam, w)."""
    return np.zeros(0), caps.steps(system.solve(defect + caps.slope(target / weights)))


def _polished(system: _Dense | _Thin, b: Array, caps: Caps, weights: Array, z: Array) -> Array:
    """Return lam with zero slope on the active rows, and zeros or upper bounds elsewhere, if that keeps it between."""
    active, lam = caps.split(weights, z)
    if not active.any() or not system.factor(np.where(active, tol.INTERIOR_RIDGE, tol.HOLDING_DIAGONAL)):
        return lam
    polished = lam.copy()
    for _ in range(POLISHES):
        slope = np.where(active, system.times(polished) + b, 0.0)
        polished = polished - np.where(active, system.solve(slope), 0.0)

    def slope_left(v: Array) -> float:
        return float(np.abs((system.times(v) + b)[active]).max())

    better = np.clip(polished, 0.0, caps.upper)
    return better if slope_left(better) < slope_left(lam) else lam


class Caps:
    """Upper bounds u of lam, (count,): pairs (weights, slacks) are (lam, z), then (w, y) of the finite bounds."""

    def __init__(self, upper: Array):
        self.upper, self.capped, self.count = upper, np.flatnonzero(np.isfinite(upper)), len(upper)

    def inside(self, lam: Array, least: float) -> Array:
        """Return (lam, w) from a lam >= 0, moved inside its bounds."""
        lam = np.maximum(lam, least)
        cap = self.upper[self.capped]
        margin = np.minimum(least, cap / 4)
        lam[self.capped] = np.clip(lam[self.capped], margin, cap - margin)
        return np.concatenate([lam, cap - lam[self.capped]])

    def slacks(self, slope: Array, weights: Array, least: float) -> Array:
        """Return (z, y) for a slope z - y: z at least this large, y too, but smaller where the room is wide."""
        smallest = least / np.maximum(1.0, weights[self.count :])
        return np.concatenate([np.maximum(slope, least), np.maximum(-slope[self.capped], smallest)])

    def slope(self, z: Array) -> Array:
        """Return z - y, (count,)."""
        slope = z[: self.count].copy()
        slope[self.capped] -= z[self.count :]
        return slope

    def diagonal(self, weights: Array, z: Array) -> Array:
        """Return z / lam + y / w, (count,)."""
        quotient = z / weights
        diagonal = quotient[: self.count].copy()
        diagonal[self.capped] += quotient[self.count :]
        return diagonal

    def steps(self, change: Array) -> Array:
        """Return the steps of (lam, w) from that of lam."""
        return np.concatenate([change, -change[self.capped]])

    def split(self, weights: Array, z: Array) -> tuple[Mask, Array]:
        """Return which rows are active, between their bounds, and lam with the others at the bounds."""
        lam, saturated = weights[: self.count], np.zeros(self.count, dtype=bool)
        saturated[self.capped] = weights[self.count :] < z[self.count :]
        active = (lam > z[: self.count]) & ~saturated
        return active, np.where(saturated, self.upper, np.where(active, lam, 0.0))


class _Dense:
    """A itself, and factors of A + diag(w)."""

    def __init__(self, A: Array):
        self.A = A

    def times(self, v: Array) -> Array:
        """Return A v."""
        return self.A @ v

    def factor(self, w: Array) -> bool:
        """Factor A + diag(w); False if it is not positive definite."""
        matrix = self.A.copy()
        matrix[np.diag_indices_from(matrix)] += w
        self._lower, failed = dpotrf(matrix.T, lower=1, overwrite_a=1, clean=0)
        return failed == 0

    def solve(self, r: Array) -> Array:
        """Return (A + diag(w))^{-1} r."""
        return dpotrs(self._lower, r, lower=1)[0]


class _Thin:
    """A = diag(base) + sign V V' with a thin V, and factors of A + diag(w)."""

    def __init__(self, base: Array, sign: float, V: Array):
        self._base, self._sign, self._V, self._scaled = base, sign, V, np.empty_like(V)

    def times(self, v: Array) -> Array:
        """Return A v."""
        return self._base * v + self._sign * (self._V @ (self._V.T @ v))

    def factor(self, w: Array) -> bool:
        """Factor A + diag(w); False if it is not positive definite."""
        self._diagonal = self._base + w
        np.divide(self._V, np.sqrt(self._diagonal)[:, None], out=self._scaled)
        inner = dsyrk(self._sign, self._scaled, trans=1, lower=1)
        inner[np.diag_indices_from(inner)] += 1.0
        self._lower, failed = dpotrf(inner, lower=1, overwrite_a=1, clean=0)
        return failed == 0

    def solve(self, r: Array) -> Array:
        """Return (A + diag(w))^{-1} r, refined once where the diagonal is tiny."""
        x = self._once(r)
        tiny = self._diagonal.min() < REFINED
        return x + self._once(r - self.times(x) - (self._diagonal - self._base) * x) if tiny else x

    def _once(self, r: Array) -> Array:
        inner = dpotrs(self._lower, self._V.T @ (r / self._diagonal), lower=1)[0]
        return (r - self._sign * (self._V @ inner)) / self._diagonal


def _thin(A: Array, unconstrained: Array | None) -> _Thin | None:
    """Return A by a thin factor of itself or of diag(unconstrained) - A; None if neither is known to have a low rank.

    The eigenvalues of A, relative to diag(unconstrained), are near 0 and 1: they add up to its rank.
    """
    if unconstrained is None or len(A) <= LOW_RANK_ROWS or not (unconstrained > 0).all():
        return None
    share = float((np.diagonal(A) / unconstrained).mean())
    if min(share, 1 - share) > LARGEST_SHARE:
        return None
    base, sign = (np.zeros(len(A)), 1.0) if share < 1 - share else (unconstrained, -1.0)
    factored = sign * A  # symmetric: its transpose is in the order that LAPACK overwrites
    factored[np.diag_indices_from(A)] += base
    factor, pivots, rank, _ = dpstrf(factored.T, tol=tol.RANK_TOLERANCE, lower=1, overwrite_a=1)
    V = np.empty((len(A), rank), order="F")
    V[pivots - 1] = np.tril(factor[:, :rank])
    missed = base + sign * (V * V).sum(1) - np.diagonal(A)
    return _Thin(base, sign, V) if np.abs(missed).max() < tol.LOW_RANK_ERROR else None


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

    ``newton`` returns the steps of other unknowns and of l for the target of the equations z dl + l dz = target. The
    step length is 0 where the products l z have vanished: no step makes them smaller.
    """
    other, dw = newton(-weights * z)
    if mu < tol.TINY:
        return Step(np.zeros_like(other), weights, z, 0.0)
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
