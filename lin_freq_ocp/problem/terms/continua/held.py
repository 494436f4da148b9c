# ruff: noqa: D102  (a method without a docstring is described by the class that it implements)
"""The spectrum of a signal that is held between its samples: |S(w) V(w)| <= l(w), w = 2 pi f h for any f >= 0 in Hz.

v(t) = v_k for k h <= t < (k + 1) h has the spectrum h S V but for a factor of modulus 1, with S(w) = sin(w/2) / (w/2)
and V(w) = sum_t v_t exp(-iwt), of period 2 pi. Limits that are constant from some w = a on need only be held up to
a + 2 pi: |S V| = 2 |sin(w/2) V(w)| / w, whose numerator has the period 2 pi, so that every later value is below the
value at a frequency of that interval.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, extended
from lin_freq_ocp.problem.terms.continua.scaled_map import ScaledMap
from lin_freq_ocp.problem.terms.continuum import Frequencies

ZERO = 1e-6  # of S, below which an end of an interval is none of the first points: its constraint is hardly any
SERIES = 1e-2  # below it, the logarithm of S is -w^2/24, to w^4/2880


@dataclass(frozen=True, eq=False)
class HeldMap(ScaledMap):
    """(Re, Im) of S(w) V(w)."""

    @property
    def gain(self) -> ComplexArray:
        return extended(sinc(extended(self.at)) + 0j)

    @property
    def additions(self) -> float:
        return super().additions * max(float(self.at.max(initial=0.0)) / np.pi, 1.0)

    @cached_property
    def _factors(self) -> tuple[ComplexArray, ComplexArray]:
        first, second = self.plain_factors
        return self.gain[:, None] * first, second


@dataclass(frozen=True, eq=False)
class HeldFrequencies(Frequencies):
    """|S(w) V(w)| <= l(w) at every w of the intervals of the limits, which may lie beyond pi."""

    highest: ClassVar[float] = np.inf

    def first_points(self) -> Array:
        """Return the bins within the intervals, of those with the same V the one with the least limit, and the ends."""
        N = self.map.samples
        k = np.arange(int(N * self.limits.high.max() / (2 * np.pi)) + 1)
        w = 2 * np.pi * k / N
        limits = self.limits.at(w)
        of_V = np.full(len(k), np.inf)
        np.divide(limits, np.abs(sinc(w)), out=of_V, where=np.isfinite(limits) & (k % N > 0) | (k == 0))
        tightest = np.lexsort((of_V, np.minimum(k % N, -k % N)))
        firsts = tightest[np.unique(np.minimum(k % N, -k % N)[tightest], return_index=True)[1]]
        ends = np.concatenate([self.limits.low, self.limits.high])
        return np.unique(np.concatenate([w[firsts[np.isfinite(of_V[firsts])]], ends[self.factor(ends) > ZERO]]))

    def factor(self, points: Array) -> Array:
        return np.abs(sinc(points))

    def log_slopes(self, points: Array) -> tuple[Array, Array]:
        w = np.where(points < SERIES, SERIES, points)
        half = np.where(np.sin(w / 2) == 0, SERIES, w / 2)
        near = points < SERIES
        first = np.where(near, -points / 12, np.cos(half) / (2 * np.sin(half)) - 1 / w)
        return first, np.where(near, -1 / 12, 1 / w**2 - 1 / (4 * np.sin(half) ** 2))


def sinc(w: Array) -> Array:
    """Return S(w), of any precision."""
    half = np.where(w == 0, 1.0, w / 2)
    return np.where(w == 0, 1.0, np.sin(half) / half)
