"""Units of limits on spectra: the sums of samples that a limit states, and how values and limits are shown.

The DFT is a sum of samples, sum_t w_t v_t exp(-2 pi i k t / N) with a window w, ones by default. A *level* is
proportional to its magnitude: the amplitude of a sinusoid, its RMS value, a percentage, the root of a density. With
W = sum w_t and the sampling time h, one unit of a level is

    an amplitude      W / 2,              at bins 0 and N/2: W
    an RMS value      W / sqrt(2),        at bins 0 and N/2: W
    a root density    sqrt(sum w_t^2 / (2 h)),  at bins 0 and N/2: sqrt(sum w_t^2 / h)

sums of samples, as scipy.signal.periodogram defines them with a window. A percentage and a number of decibels are those
of a reference amplitude.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import pi, sqrt
from typing import NamedTuple

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import number, split_unit

OWN_FUNDAMENTAL = "fundamental"
IN_DECIBELS = "db", "limit_db"
SQUARED = "\N{SUPERSCRIPT TWO}"


class _Kind(NamedTuple):
    """Sums of samples of one unit of a level, relative to those at bins 0 and N/2 (None: a sum itself); words."""

    inner: float | None
    unit: str  # {0} is the unit of the signal, {1} the reference
    words: str = "amplitude"


KINDS = {
    "limit": _Kind(None, "{0}, sum of samples", "|DFT|"),
    "limit_db": _Kind(None, "dB re {1}, sum of samples", "|DFT|"),
    "energy": _Kind(None, "{0}" + SQUARED + ", sum of squares"),
    "amplitude": _Kind(0.5, "{0}"),
    "percent": _Kind(0.5, "% of {1}"),
    "db": _Kind(0.5, "dB re {1}"),
    "rms": _Kind(sqrt(0.5), "{0} RMS", "RMS value"),
    "density": _Kind(sqrt(0.5), "{0}" + SQUARED + "/Hz", "power spectral density"),
}


@dataclass(frozen=True)
class Quantity:
    """The unit in which a limit on a spectrum is stated.

    Attributes
    ----------
    keyword : str
        The argument that states the limit, such as "amplitude", one of ``KINDS``; "energy" for a sum of squares.
    reference : float or "fundamental"
        The amplitude, or the sum, that percentages and decibels refer to.
    phase : float
        Of the fundamental, in radians: it is a cosine with this phase.
    """

    keyword: str
    reference: float | str = 1.0
    phase: float = 0.0

    @property
    def kind(self) -> _Kind:
        """Return the properties that all limits of the keyword share."""
        return KINDS[self.keyword]

    @property
    def is_sum(self) -> bool:
        """Whether the limit is one on sums of samples."""
        return self.kind.inner is None

    @property
    def of_fundamental(self) -> bool:
        """Whether the limit is a part of the signal's own fundamental."""
        return isinstance(self.reference, str)

    def sums(self, window: Array, sampling_time: float | None, field: str) -> tuple[float, float]:
        """Return the sums of samples of one unit of a level: at bins 0 and N/2, and at all others."""
        scale, inner = 1.0 if isinstance(self.reference, str) else self.reference, self.kind.inner
        if inner is None:
            return scale, scale
        total = float(window.sum())
        if self.keyword == "density":
            if sampling_time is None:
                advice = "Give the dynamics a sampling_time in seconds."
                got = "a limit per Hz, and no sampling time"
                raise ProblemError(f"{field}.density", got, "dynamics with one", advice)
            total = sqrt(float((window**2).sum()) / sampling_time)
        elif total <= 0:
            raise ProblemError(f"{field}.window", f"a sum of {total:g}", f"a sum above zero, for {self.keyword}=")
        total *= scale / 100 if self.keyword == "percent" else scale
        return total, inner * total

    def level(self, stated: Array) -> Array:
        """Return the levels of stated limits."""
        if self.keyword in IN_DECIBELS:
            with np.errstate(over="ignore"):  # an infinite limit is none
                return np.asarray(10 ** (stated / 20))
        return np.sqrt(stated) if self.keyword in ("density", "energy") else stated

    def stated(self, level: Array) -> Array:
        """Return levels in the unit in which limits are stated."""
        if self.keyword in IN_DECIBELS:
            with np.errstate(divide="ignore"):  # minus infinity for 0
                return 20 * np.log10(level)
        return level**2 if self.keyword in ("density", "energy") else level

    def unit(self, unit: str) -> str:
        """Return the unit of stated limits of a signal with this unit."""
        reference = self.reference if isinstance(self.reference, str) else f"{number(self.reference)} {unit}".rstrip()
        return self.kind.unit.format(unit, reference).lstrip(" ,")


@dataclass(frozen=True)
class Reading:
    """The value and the limit of a limited spectrum, in the unit in which the limit was stated.

    Attributes
    ----------
    label : str
        Such as "5th harmonic of i".
    value, limit : float
    unit : str
    place : str
        Of a band, the frequency of the value nearest to its limit, such as " at 63.2 Hz"; else empty.
    ratio : float
        The value relative to the limit, in sums of samples; 0 if there is no limit.

    Examples
    --------
    >>> print(lfo.results.Reading("5th harmonic of i", 0.01, 0.02, "A", "", 0.5))
    5th harmonic of i: 0.01 of 0.02 A
    """

    label: str
    value: float
    limit: float
    unit: str
    place: str
    ratio: float

    def __str__(self) -> str:
        return f"{self.label}: {number(self.value, 4)} of {number(self.limit, 4)} {self.unit}".rstrip() + self.place


@dataclass(frozen=True, eq=False)
class Statement:
    """How users stated a limit on the spectrum of a signal: its unit, and labels for its values."""

    quantity: Quantity
    signal: str  # the name of the component, with its unit
    labels: Sequence[str]  # of each group, or one for all
    levels: Array  # limits of the groups, (groups,) or ()
    sampling_time: float | None
    in_band: bool = False  # whether the label is that of a band, so that readings name the frequency
    relative: bool = False  # whether the first value of a group is what the limit refers to

    def readings(self, sizes: Array, levels: Array, frequencies: Array) -> Iterator[Reading]:
        """Yield a reading of each label, that of its group nearest to its limit.

        ``sizes`` and ``levels``, (groups,), are the values and the limits in levels, ``frequencies`` those of the
        groups in rad/sample, or empty.
        """
        unit, ratios = self.quantity.unit(split_unit(self.signal)[1]), np.ones(len(sizes))
        np.divide(sizes, levels, out=ratios, where=levels > 0)
        labels = np.broadcast_to(np.array(self.labels), sizes.shape)
        for label in dict.fromkeys(labels.tolist()):
            groups = np.flatnonzero(labels == label)
            k = int(groups[np.argmax(ratios[groups])])
            value, limit = (float(self.quantity.stated(part[k])) for part in (sizes, levels))
            place = ""
            if self.in_band and len(frequencies):
                scale, axis = (1.0, "rad/sample") if self.sampling_time is None else (2 * pi * self.sampling_time, "Hz")
                place = f" at {number(float(frequencies[k]) / scale, 4)} {axis}"
            yield Reading(label, value, limit, unit, place, float(ratios[k]))
