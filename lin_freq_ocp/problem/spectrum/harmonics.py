# ruff: noqa: D102
"""Harmonics of a fundamental frequency, as bins of a record that lasts a whole number of its periods.

``Band`` documents the methods without a docstring.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import ceil

import numpy as np

from lin_freq_ocp.base.arrays import Mask, brief
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import number, plural, runs_in_words, runs_of
from lin_freq_ocp.problem.spectrum.bands import BIN_TOLERANCE, Band

LONGEST_PERIOD = 100_000  # samples of the shortest record that lasts a whole number of periods


@dataclass(frozen=True)
class Harmonics(Band):
    """The bins at the orders ``edges`` of a fundamental."""

    fundamental_hz: float = 0.0

    @property
    def orders(self) -> list[int]:
        """Return the orders in increasing order."""
        return [int(order) for order in self.edges]

    @property
    def removed(self) -> str:
        noun = "harmonics" if len(self.edges) > 1 else "harmonic"
        return f"{noun} {runs_in_words(runs_of(np.array(self.orders)))} of {number(self.fundamental_hz)} Hz"

    def at(self, length: int, sampling_time: float | None, field: str) -> Mask:
        if sampling_time is None:
            raise ProblemError(field, str(self), "a sampling time", "Give dynamics.sampling_time, in seconds.")
        exact = self.fundamental_hz * sampling_time
        turns = Fraction(exact).limit_denominator(LONGEST_PERIOD)  # periods of a sample
        known = abs(turns / exact - 1) <= BIN_TOLERANCE
        if not known or length % turns.denominator:
            step = 1 / (self.fundamental_hz * ceil(1 / exact))
            advice = f"With a sampling time of {step:.6g} s, a period is a whole number of samples."
            if known:
                fits = max(round(length / turns.denominator), 1) * turns.denominator
                advice = f"{fits} samples are {plural(int(turns * fits), 'period')}: horizon={fits} for controls and "
                advice += f"states that are Periodic(), {fits - 1} for other states, which have one sample more."
            got = f"{length} samples of {sampling_time:g} s, {exact * length:.6g} periods of {self.fundamental_hz:g} Hz"
            raise ProblemError(f"{field}.fundamental_hz", got, "a whole number of periods", advice)
        bins = np.array(self.orders) * int(turns * length)
        if bins[-1] > length / 2:
            expected = f"orders up to {int(1 / (2 * turns))}, of the Nyquist frequency"
            raise ProblemError(f"{field}.harmonics", f"order {self.orders[-1]}", expected)
        return np.isin(np.arange(length // 2 + 1), bins)

    def __str__(self) -> str:
        return f"harmonics({brief(self.orders, 40)} of {self.fundamental_hz:g} Hz)"
