# ruff: noqa: D102
"""A bound on the residual vibration of all modes in a box of natural frequencies and damping ratios.

``FrequencyConstraint`` documents the methods without a docstring.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, assign, brief, freeze, positive_number, real_array, require_bool
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import AT_MOST, low_to_high, number
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, Signal, component_words
from lin_freq_ocp.problem.terms.semi_infinite import VibrationLimit, VibrationMap
from lin_freq_ocp.problem.terms.term import Term


@dataclass(frozen=True, eq=False, init=False)
class ResidualVibration(FrequencyConstraint):
    """A limit on the amplitude of the residual vibration after the last sample, for every mode of a box.

    A mode is q'' + 2 zeta w q' + w^2 q = w^2 u, at rest before the first sample, with a zero-order hold of u and u = 0
    after the last sample. Its residual amplitude is |V|,
    V = (z - 1) / sqrt(1 - zeta^2) sum_t u_t z^(T-1-t), z = exp(s h), s = w (-zeta + i sqrt(1 - zeta^2)). Input shapers
    have the same specification, for a few modes of the box.

    If u is the acceleration of a base that carries a load on a spring, q = -w^2 e for the displacement e of the load
    relative to the base: |V| in m/s^2 is a displacement of |V| / (2 pi f)^2 in m.

    Parameters
    ----------
    frequency : (lowest, highest)
        Natural frequencies w / (2 pi) in Hz, above zero. The problem must have a sampling time.
    damping : float, or (lowest, highest)
        Damping ratios zeta, from zero to below one.
    limit : float
        In the unit of the signal: a constant signal u moves q by u.
    relative : bool
        Limit |sum_t u_t z^(T-1-t)| instead of |V|: a last sample of size 1 then counts 1 for every mode, as motion
        controllers and 3D printers state it. The limit is also in the unit of the signal.
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
    relative: bool

    def __init__(
        self,
        frequency: ArrayLike,
        damping: ArrayLike,
        limit: float,
        component: int | str | None = None,
        relative: bool = False,
    ):
        frequencies = _pair("frequency", frequency)
        ratios = _pair("damping", damping, single=True)
        require_bool("ResidualVibration.relative", relative)
        if frequencies[0] <= 0:
            raise ProblemError("ResidualVibration.frequency", brief(frequency), "frequencies above 0 Hz")
        if ratios[0] < 0 or ratios[1] >= 1:
            raise ProblemError("ResidualVibration.damping", brief(damping), "damping ratios from 0 to below 1")
        level = positive_number("ResidualVibration.limit", limit)
        assign(self, frequency=frequencies, damping=ratios, limit=level, component=component, relative=relative)

    def terms(self, signal: Signal, field: str, source: tuple[str, int]) -> Iterator[Term]:
        h = signal.sampling_time
        if h is None:
            advice = "Give the dynamics a sampling_time in seconds."
            raise ProblemError(f"{field}.frequency", "Hz, and no sampling time", "dynamics with one", advice)
        low, high = np.stack([self.frequency, self.damping], axis=1)
        samples = np.ones(signal.length), np.zeros((0, 2))
        maps = (VibrationMap(C, D, *samples, h, self.relative) for _, C, D in signal.rows(field, self.component))
        boxes = (VibrationLimit(values, low, high, self.limit, h) for values in maps)
        for term in self.semi_infinite_terms("residual vibration of", signal, boxes, source):
            yield replace(term, band=f"{low_to_high(*self.frequency)} Hz")

    def augmented(self, n: int, k: int) -> Sequence[ResidualVibration]:
        return self.on_components(n)

    @property
    def levels(self) -> Array:
        return np.asarray(self.limit)

    def at_levels(self, levels: Array) -> Self:
        return self.changed(limit=float(levels))

    def describe(self, names: Sequence[str]) -> str:
        of = component_words(self.component, names)
        relative = ", relative to a single sample," if self.relative else ""
        modes = f"every mode of {low_to_high(*self.frequency)} Hz with a damping ratio of {low_to_high(*self.damping)}"
        return f"residual vibration of {of}{relative} {AT_MOST} {number(self.limit)} for {modes}"


def _pair(name: str, ends: ArrayLike, single: bool = False) -> Array:
    low_high = real_array(f"ResidualVibration.{name}", ends)
    if single and low_high.ndim == 0:
        return freeze(np.full(2, low_high))
    if low_high.shape != (2,) or low_high[0] > low_high[1]:
        raise ProblemError(f"ResidualVibration.{name}", brief(ends), "two numbers, the lowest and the highest")
    return low_high
