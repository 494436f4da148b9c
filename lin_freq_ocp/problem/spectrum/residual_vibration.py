# ruff: noqa: D102  (a method without a docstring is described by ``FrequencyConstraint``)
"""A bound on what a move leaves ringing in a mode that is known up to a box of frequencies and damping ratios."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, assign, brief, positive_number, real_array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import AT_MOST, number
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, Signal, component_words
from lin_freq_ocp.problem.terms.semi_infinite import PlantBox, VibrationMap
from lin_freq_ocp.problem.terms.term import Term


@dataclass(frozen=True, eq=False, init=False)
class ResidualVibration(FrequencyConstraint):
    """The amplitude left ringing after the last sample is at most a limit, for every mode of a box.

    A mode is q'' + 2 zeta w q' + w^2 q = w^2 u, at rest before the first sample, with u held for a sampling time at
    each sample, and zero after the last. Then q rings with the amplitude |V| at its end,
    V = (z - 1) / sqrt(1 - zeta^2) sum_t u_t z^(T-1-t), z = exp(s h), s = w (-zeta + i sqrt(1 - zeta^2)). This is the
    specification of input shapers, for each mode of the box and not for some.

    Parameters
    ----------
    frequency : (lowest, highest)
        Natural frequencies w / (2 pi) in Hz, above zero. The problem must have a sampling time.
    damping : (lowest, highest)
        Damping ratios zeta, from zero to below one.
    limit : float
        In the unit of the signal: a constant signal u moves q by u.
    component : int or str, optional
        Index or name of the component; default all, each with this bound.

    Raises
    ------
    ProblemError
        If a value is not of this kind.

    References
    ----------
    Singer and Seering, "Preshaping command inputs to reduce system vibration", Journal of Dynamic Systems, Measurement,
    and Control 112, 1990. Hettich and Kortanek, "Semi-infinite programming", SIAM Review 35, 1993.

    Examples
    --------
    >>> calm = lfo.ResidualVibration(frequency=(0.9, 1.1), damping=(0.0, 0.05), limit=0.02)
    >>> calm.describe(["force [N]"])
    'residual vibration of force ≤ 0.02 for every mode of 0.9 to 1.1 Hz with a damping ratio of 0 to 0.05'
    """

    label = "residual vibration"
    every_frequency = True
    frequency: Array
    damping: Array
    limit: float
    component: int | str | None

    def __init__(self, frequency: ArrayLike, damping: ArrayLike, limit: float, component: int | str | None = None):
        frequencies, ratios = _pair("frequency", frequency), _pair("damping", damping)
        if frequencies[0] <= 0:
            raise ProblemError("ResidualVibration.frequency", brief(frequency), "frequencies above 0 Hz")
        if ratios[0] < 0 or ratios[1] >= 1:
            raise ProblemError("ResidualVibration.damping", brief(damping), "damping ratios from 0 to below 1")
        level = positive_number("ResidualVibration.limit", limit)
        assign(self, frequency=frequencies, damping=ratios, limit=level, component=component)

    def terms(self, signal: Signal, field: str, source: tuple[str, int]) -> Iterator[Term]:
        h = signal.sampling_time
        if h is None:
            advice = "Give the dynamics a sampling_time in seconds."
            raise ProblemError(f"{field}.frequency", "Hz, and no sampling time", "dynamics with one", advice)
        low, high = np.stack([self.frequency, self.damping], axis=1)
        samples = np.ones(signal.length), np.zeros((0, 2))
        maps = (VibrationMap(C, D, *samples, h) for _, C, D in signal.rows(field, self.component))
        boxes = (PlantBox(values, low, high, self.limit, h) for values in maps)
        yield from self.semi_infinite_terms("residual vibration of", signal, boxes, source)

    def augmented(self, n: int, k: int) -> Sequence[ResidualVibration]:
        return self.on_components(n)

    @property
    def levels(self) -> Array:
        return np.asarray(self.limit)

    def at_levels(self, levels: Array) -> Self:
        return self.changed(limit=float(levels))

    def describe(self, names: Sequence[str]) -> str:
        (low, high), (least, most) = ([number(float(end)) for end in ends] for ends in (self.frequency, self.damping))
        of = component_words(self.component, names)
        modes = f"every mode of {low} to {high} Hz with a damping ratio of {least} to {most}"
        return f"residual vibration of {of} {AT_MOST} {number(self.limit)} for {modes}"


def _pair(name: str, given: ArrayLike) -> Array:
    found = real_array(f"ResidualVibration.{name}", given)
    if found.shape != (2,) or found[0] > found[1]:
        raise ProblemError(f"ResidualVibration.{name}", brief(given), "two numbers, the lowest and the highest")
    return found
