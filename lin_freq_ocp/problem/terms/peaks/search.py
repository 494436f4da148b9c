"""Where a signal's infinitely many constraints have local maxima relative to their limit."""

from __future__ import annotations

from functools import singledispatch

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.problem.terms.continua.vibration import PlantBox
from lin_freq_ocp.problem.terms.continuum import Continuum, Frequencies
from lin_freq_ocp.problem.terms.peaks.spectral_peaks import spectral_peaks
from lin_freq_ocp.problem.terms.peaks.vibration_peaks import vibration_peaks


@singledispatch
def peaks_above(everywhere: Continuum, x: Array, u: Array, above: float) -> tuple[Array, Array]:
    """Return the points of the local maxima of |V|/l above a ratio, and these ratios, (peaks,); by kind of set."""
    raise NotImplementedError(type(everywhere).__name__)


peaks_above.register(Frequencies, spectral_peaks)
peaks_above.register(PlantBox, vibration_peaks)
