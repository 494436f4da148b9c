"""The largest value of a signal's infinitely many constraints relative to their limit, with proof."""

from __future__ import annotations

from functools import singledispatch

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.certificate.peaks.cells import Peak
from lin_freq_ocp.certificate.peaks.held import HeldSeries
from lin_freq_ocp.certificate.peaks.masks import certified_peak
from lin_freq_ocp.certificate.peaks.vibrations import certified_vibration
from lin_freq_ocp.problem.terms.semi_infinite import Continuum, Frequencies, HeldFrequencies, PlantBox


@singledispatch
def proven_peak(everywhere: Continuum, samples: Array) -> Peak:
    """Return the largest |V| / l of windowed samples (N,) over a parameter set; by kind of set."""
    raise NotImplementedError(type(everywhere).__name__)


@proven_peak.register
def _(everywhere: Frequencies, samples: Array) -> Peak:
    return certified_peak(samples, everywhere.limits)


@proven_peak.register
def _(everywhere: HeldFrequencies, samples: Array) -> Peak:
    return certified_peak(samples, everywhere.limits, HeldSeries)


@proven_peak.register
def _(everywhere: PlantBox, samples: Array) -> Peak:
    return certified_vibration(samples, everywhere)
