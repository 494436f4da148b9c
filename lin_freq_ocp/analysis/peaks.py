"""Where a signal's infinitely many constraints have local maxima relative to their limit."""

from __future__ import annotations

from functools import singledispatch

from lin_freq_ocp.analysis.spectral_peaks import spectral_peaks
from lin_freq_ocp.analysis.vibration_peaks import vibration_peaks
from lin_freq_ocp.arrays import Array
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.continua.vibration import PlantBox
from lin_freq_ocp.problem.terms.continuum import Continuum, Frequencies


def peak_points(problem: OptimalControlProblem, x: Array, u: Array, above: float) -> dict[str, Array]:
    """Return the points of all local maxima above a ratio, by name of the terms that have some."""
    sets = {term.name: term.everywhere for term in problem.terms if term.everywhere is not None}
    found = {name: peaks_above(everywhere, x, u, above)[0] for name, everywhere in sets.items()}
    return {name: points for name, points in found.items() if len(points)}


@singledispatch
def peaks_above(everywhere: Continuum, x: Array, u: Array, above: float) -> tuple[Array, Array]:
    """Return the points of the local maxima of |V|/l above a ratio, and these ratios, (peaks,); by kind of set."""
    raise NotImplementedError(type(everywhere).__name__)


peaks_above.register(Frequencies, spectral_peaks)
peaks_above.register(PlantBox, vibration_peaks)
