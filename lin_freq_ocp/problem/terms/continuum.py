# ruff: noqa: D102  (a method without a docstring is described by the class that it implements)
"""Infinitely many constraints |V(p)| <= l(p), one for each point p of a parameter set, on a signal of the trajectory.

A term of a problem has finitely many of them, at its points; what must hold at all others stands in its ``everywhere``.
By Caratheodory's theorem, an optimum has multipliers at finitely many points only. A new parameter set is a subclass of
``Continuum``, registered in ``peaks/search`` (its maxima) and in ``certificate/peaks/proven`` (their proof).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from lin_freq_ocp.base.arrays import Array, brief
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.problem.terms.frequency_map import FrequencyMap
from lin_freq_ocp.problem.terms.largest_excess import LargestExcess
from lin_freq_ocp.problem.terms.limits import Limits
from lin_freq_ocp.problem.terms.penalties import NormBall
from lin_freq_ocp.problem.terms.penalty import HARD, Penalty


@dataclass(frozen=True, eq=False)
class Continuum(ABC):
    """|V(p)| <= l(p) at every point of a parameter set; points are arrays (k,) or (k, parameters)."""

    map: FrequencyMap  # at no point
    price: float = field(default=np.inf, kw_only=True)  # of the largest |V|/l - 1, if that is above 0; inf: never is

    @abstractmethod
    def limit_at(self, points: Array) -> Array:
        """Return l at points, (k,); infinity outside the set."""

    @abstractmethod
    def first_points(self) -> Array:
        """Return the points to begin with."""

    @abstractmethod
    def distances(self, some: Array, others: Array) -> Array:
        """Return the distances of k points and l others, in DFT bins of the signal, (k, l)."""

    def at(self, points: Array) -> tuple[FrequencyMap, Penalty]:
        """Return the map to the values at points, and their balls."""
        if points.shape[1:] != self.map.at.shape[1:]:
            expected = "shape " + str(("atoms", *self.map.at.shape[1:])).replace("'", "")
            raise ProblemError("multipliers.frequencies", f"{brief(points.tolist())}", expected)
        limits = self.limit_at(points)
        soft = np.isfinite(self.price)
        ball = LargestExcess(limits, np.asarray(self.price)) if soft else NormBall(2, limits, HARD)
        return self.map.placed(points), ball


@dataclass(frozen=True, eq=False)
class Frequencies(Continuum):
    """|V(w)| <= l(w) at every frequency w in rad/sample of the intervals of the limits."""

    limits: Limits
    highest: ClassVar[float] = np.pi  # beyond it, there are no points

    def limit_at(self, points: Array) -> Array:
        return self.limits.at(points)

    def first_points(self) -> Array:
        """Return the bins of the signal's DFT within the intervals, and their ends."""
        bins = 2 * np.pi * np.arange(self.map.samples // 2 + 1) / self.map.samples
        inside = bins[np.isfinite(self.limits.at(bins))]
        return np.unique(np.concatenate([inside, self.limits.low, self.limits.high]))

    def at(self, points: Array) -> tuple[FrequencyMap, Penalty]:
        if points.ndim == 1 and (points > self.highest).any():
            raise ProblemError("multipliers.frequencies", brief(points.tolist()), "frequencies from 0 to pi rad/sample")
        return super().at(points)

    def factor(self, points: Array) -> Array:
        """Return the modulus of what V is multiplied by, (k,)."""
        return np.ones(len(points))

    def log_slopes(self, points: Array) -> tuple[Array, Array]:
        """Return the first and second derivative by w of the logarithm of the factor, both (k,)."""
        return np.zeros(len(points)), np.zeros(len(points))

    def distances(self, some: Array, others: Array) -> Array:
        return np.abs(some[:, None] - others) * self.map.samples / (2 * np.pi)
