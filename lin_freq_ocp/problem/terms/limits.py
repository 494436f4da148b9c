"""Limits on the magnitude of a spectrum at every frequency: linear between points, on intervals of [0, pi]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array


@dataclass(frozen=True, eq=False)
class Limits:
    """l(w) on intervals low <= w <= high (pieces,), linear from ``at_low`` to ``at_high`` on each, above zero."""

    low: Array
    high: Array
    at_low: Array
    at_high: Array

    def at(self, frequencies: Array) -> Array:
        """Return the least limit at frequencies (k,) in rad/sample; infinity beyond all intervals."""
        w = frequencies[:, None]
        inside = (w >= self.low) & (w <= self.high)
        share = (w - self.low) / np.where(self.high > self.low, self.high - self.low, 1.0)
        found = (1 - share) * self.at_low + share * self.at_high
        return np.where(inside, found, np.inf).min(axis=1)

    def scaled(self, factor: float) -> Limits:
        """Return the limits times a factor."""
        return Limits(self.low, self.high, factor * self.at_low, factor * self.at_high)

    def raised(self, amount: float) -> Limits:
        """Return the limits plus an amount."""
        return Limits(self.low, self.high, self.at_low + amount, self.at_high + amount)


def limits_on(intervals: Sequence[tuple[float, float]], frequencies: Array, limits: Array) -> Limits:
    """Return the limit through points (k,), constant beyond them, on intervals in rad/sample."""
    low, high = list[float](), list[float]()
    for first, last in intervals:
        inner = frequencies[(frequencies > first) & (frequencies < last)]
        ends = [first, *inner.tolist(), last]
        low += ends[:-1]
        high += ends[1:]
    starts, stops = np.array(low), np.array(high)
    return Limits(starts, stops, np.interp(starts, frequencies, limits), np.interp(stops, frequencies, limits))
