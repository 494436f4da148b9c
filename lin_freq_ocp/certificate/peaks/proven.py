"""The largest value of a signal's infinitely many constraints relative to their limit, with proof."""

from __future__ import annotations

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.certificate.peaks.cells import Peak
from lin_freq_ocp.certificate.peaks.masks import certified_peak
from lin_freq_ocp.certificate.peaks.vibrations import certified_vibration
from lin_freq_ocp.problem.terms.continuum import Continuum, Frequencies
from lin_freq_ocp.problem.terms.vibration import PlantBox


def proven_peak(samples: Array, everywhere: Continuum) -> Peak:
    """Return the largest |V| / l of windowed samples (N,) over the parameter set."""
    match everywhere:
        case Frequencies():
            return certified_peak(samples, everywhere.limits)
        case PlantBox():
            return certified_vibration(samples, everywhere)
        case _:
            raise NotImplementedError(type(everywhere).__name__)
