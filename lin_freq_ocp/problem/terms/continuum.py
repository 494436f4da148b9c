"""Masks at every frequency: |V(w)| <= l(w) for all w of some intervals, V(w) = sum_t h_t v_t exp(-iwt).

It is infinitely many constraints. A term of a problem has finitely many of them, at its frequencies; what must hold at
all others stands in its ``everywhere``. By Caratheodory's theorem, an optimum has multipliers at finitely many
frequencies only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.problem.terms.frequency_map import FrequencyMap
from lin_freq_ocp.problem.terms.limits import Limits
from lin_freq_ocp.problem.terms.penalties import NormBall
from lin_freq_ocp.problem.terms.penalty import HARD, Penalty


@dataclass(frozen=True, eq=False)
class Continuum:
    """|V(w)| <= l(w) at every w of the intervals of the limits."""

    map: FrequencyMap  # at no frequency
    limits: Limits

    def at(self, frequencies: Array) -> tuple[FrequencyMap, Penalty]:
        """Return the map to the values at frequencies (groups,) in rad/sample, and their balls."""
        return self.map.placed(frequencies), NormBall(2, self.limits.at(frequencies), HARD)

    def first_frequencies(self) -> Array:
        """Return the bins of the signal's DFT within the intervals, and their ends."""
        bins = 2 * np.pi * np.arange(self.map.samples // 2 + 1) / self.map.samples
        inside = bins[np.isfinite(self.limits.at(bins))]
        return np.unique(np.concatenate([inside, self.limits.low, self.limits.high]))
