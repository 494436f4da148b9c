"""Random continuous piecewise-affine maps, sums of kinks of rank one, with every quantity of theirs known by itself."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

import lin_freq_ocp as lfo


@dataclass(frozen=True)
class Kinked:
    """x+ = F_t v + c_t + sum_k g_k max(0, h_k'v - d_{t,k}), v = (x, u), in components of the given sizes.

    F (T, n, n + m), c (T, n), g (K, n), h (K, n + m), d (T, K); T is 1 for a map that does not depend on time.
    """

    F: np.ndarray
    c: np.ndarray
    g: np.ndarray
    h: np.ndarray
    d: np.ndarray
    sizes: np.ndarray

    @property
    def n(self):
        return self.c.shape[1]

    def at(self, t):
        return t if len(self.F) > 1 else 0

    def value(self, t, v):
        """Return x+ at time t; v (..., n + m)."""
        t = self.at(t)
        return v @ self.F[t].T + self.c[t] + np.maximum(v @ self.h.T - self.d[t], 0) @ self.g

    def signs(self, t, v):
        """Return which kinks are on, (..., K)."""
        return v @ self.h.T > self.d[self.at(t)]

    def number(self, signs):
        """Return the number of the mode of signs (..., K), as ``dynamics`` counts them."""
        return signs @ (2 ** np.arange(len(self.h))[::-1])

    def dynamics(self, **named):
        """Return the modes of all signs, also of those that are nowhere."""
        n, modes = self.n, []
        for signs in product((0, 1), repeat=len(self.h)):
            on = np.array(signs)
            maps = self.F + (on[:, None, None] * self.g[:, :, None] * self.h[:, None]).sum(0)
            offset = self.c - (on * self.d) @ self.g
            side = np.where(on, -1.0, 1.0)
            rows, limits = side[:, None] * self.h, side * self.d
            if len(self.F) == 1:
                maps, offset, limits = maps[0], offset[0], limits[0]
            modes.append(
                lfo.AffineMode(maps[..., :n], maps[..., n:], offset, rows[:, :n], rows[:, n:], limits, str(signs))
            )
        return lfo.PiecewiseAffineDynamics(modes, **named)

    def boxes(self, reach=3.0):
        """Return state and control sets of ``reach`` sizes around zero."""
        bound = reach * self.sizes
        return {
            "state_set": lfo.Box(-bound[: self.n], bound[: self.n]),
            "control_set": lfo.Box(-bound[self.n :], bound[self.n :]),
        }

    def points(self, rng, count, reach=3.0):
        """Return random points of these sets, (count, n + m)."""
        return rng.uniform(-reach, reach, (count, len(self.sizes))) * self.sizes


def random_kinks(rng, n=2, m=1, kinks=2, times=1, sizes=None):
    """Return a random map; the sizes of components go into all its numbers."""
    sizes = np.ones(n + m) if sizes is None else sizes
    F = rng.normal(size=(times, n, n + m))
    h = rng.normal(size=(kinks, n + m))
    h *= np.maximum(np.abs(h), 0.1) / np.abs(h)  # no facet as good as parallel to an axis
    return Kinked(
        F=0.3 * F * sizes[:n, None] / sizes,
        c=0.2 * rng.normal(size=(times, n)) * sizes[:n],
        g=rng.normal(size=(kinks, n)) * sizes[:n],
        h=h / sizes,
        d=0.7 * rng.normal(size=(times, kinks)),
        sizes=sizes,
    )


def problem_of(dynamics, horizon=5, **given):
    """Return a problem with these dynamics and a plain cost."""
    return lfo.OptimalControlProblem(dynamics=dynamics, horizon=horizon, cost=lfo.QuadraticCost(R=1.0), **given)
