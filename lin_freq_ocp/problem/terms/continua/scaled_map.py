# ruff: noqa: D102  (a method without a docstring is described by the class that it implements)
"""Sums over the samples of a signal that are no plain spectrum of it: each value has a factor of its own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices
from lin_freq_ocp.problem.terms.frequency_map import FrequencyMap
from lin_freq_ocp.problem.terms.maps import Shapes


@dataclass(frozen=True, eq=False)
class ScaledMap(FrequencyMap, ABC):
    """A factor times a sum of which no term is larger than its sample; the values are about no bins."""

    @property
    @abstractmethod
    def gain(self) -> ComplexArray:
        """Return the factor of each value, (groups,)."""

    @property
    def nearest_bins(self) -> Indices:
        return np.arange(0)

    @property
    def frequencies(self) -> Array:
        return np.zeros(0)

    def spectrum_of(self, C: Array | None, D: Array | None) -> bool:
        return False

    def sizes(self, x: Array, u: Array) -> Array:
        return super().sizes(x, u) * np.abs(self.gain.astype(complex))[:, None]

    def pulled_sizes(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        return super().pulled_sizes(weights * np.abs(self.gain.astype(complex))[:, None], shapes)
