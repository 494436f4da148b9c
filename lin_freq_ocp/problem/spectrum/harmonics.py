# ruff: noqa: D102
"""Harmonics of a fundamental frequency, as bins of a record that lasts a whole number of its periods.

``Band`` documents the methods without a docstring.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask, brief
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import number, plural, runs_in_words, runs_of
from lin_freq_ocp.problem.spectrum.bands import BIN_TOLERANCE, Band

MOST_PERIODS = 200  # of a record that the advice proposes, in addition to four times as many as it has


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
        per_sample = self.fundamental_hz * sampling_time
        periods = per_sample * length
        if round(periods) < 1 or not _is_whole(np.asarray(periods)):
            counts = np.arange(1, 4 * int(periods) + MOST_PERIODS)
            counts = counts[_is_whole(counts / per_sample)]
            step = 1 / (self.fundamental_hz * ceil(1 / per_sample))
            advice = f"With a sampling time of {step:.6g} s, a period is a whole number of samples."
            if len(counts):
                count = int(counts[np.argmin(np.abs(counts - periods))])
                fits = round(count / per_sample)
                advice = (
                    f"{fits} samples are {plural(count, 'period')}: horizon={fits} for controls and states that are "
                )
                advice += f"Periodic(), {fits - 1} for other states, which have one sample more."
            got = f"{length} samples of {sampling_time:g} s, {periods:.6g} periods of {self.fundamental_hz:g} Hz"
            raise ProblemError(f"{field}.fundamental_hz", got, "a whole number of periods", advice)
        if self.edges[-1] * round(periods) > length / 2:
            expected = f"orders up to {int(0.5 / per_sample * (1 + BIN_TOLERANCE))}, of the Nyquist frequency"
            raise ProblemError(f"{field}.harmonics", f"order {self.edges[-1]:g}", expected)
        return np.isin(np.arange(length // 2 + 1), np.array(self.orders) * round(periods))

    def __str__(self) -> str:
        return f"harmonics({brief(self.orders, 40)} of {self.fundamental_hz:g} Hz)"


def _is_whole(numbers: Array) -> Mask:
    """Return which numbers are whole, but for rounding."""
    return np.asarray(np.abs(numbers - np.rint(numbers)) <= BIN_TOLERANCE * np.maximum(numbers, 1.0))
