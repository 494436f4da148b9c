"""Frequency constraints as tables: bands, magnitude and energy bounds, linear constraints, and those of outputs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lin_freq_ocp.interchange.problem_file.codec import Kinds, Record, Tables, checked
from lin_freq_ocp.problem.spectrum.bands import Band, band_pass, high_pass, low_pass, notch, stop_band
from lin_freq_ocp.problem.spectrum.bounds import NO_LOWER_MASK, EnergyBound, LinearConstraint, MagnitudeBound
from lin_freq_ocp.problem.spectrum.outputs import OutputSpectrum

BINS = checked(lambda given: isinstance(given, (list, np.ndarray)), "a list of whole numbers")


class _Band(Record):
    """A kind of band: its edges from ``first`` on are these arguments, in rad/sample or, with _hz, in Hz."""

    def __init__(self, make: Callable[..., Band], *edges: str, first: int = 0):
        super().__init__(make, values=self._keys, bins=BINS)
        self._kind, self._edges, self._first = make.__name__, edges, first

    def holds(self, value: Any) -> bool:
        """Whether an object is a band of this kind."""
        return isinstance(value, Band) and value.kind == self._kind

    def _keys(self, band: Band) -> dict[str, Any]:
        if band.unit == "bins":
            return {"bins": np.array(band.edges, dtype=np.int64), "component": band.component}
        keys = [f"{name}_hz" if band.unit == "Hz" else name for name in self._edges]
        edges = zip(keys, band.edges[self._first :], strict=False)
        return {key: float(edge) for key, edge in edges} | {"component": band.component}


BANDS = Kinds("band")
BANDS.records |= {
    "low_pass": _Band(low_pass, "cutoff", first=1),  # its first edge is 0
    "high_pass": _Band(high_pass, "cutoff"),  # its second edge is inf
    "band_pass": _Band(band_pass, "lower", "upper"),
    "notch": _Band(notch, "centre", "width"),
    "stop_band": _Band(stop_band),
}


def _bound(one: MagnitudeBound | EnergyBound) -> dict[str, Any]:
    """Return the keys of a bound: bins as a stop band, and a component only where the band does not have it."""
    return {
        "limit": one.limit,
        "band": one.band,
        "component": one.component if one.band.component is None else None,
        "oversampling": one.oversampling if one.oversampling != 1 else None,
        "between": getattr(one, "between", False) or None,
        "penalty": one.penalty,
        "window": one.window,
    }


SPECTRUM = Kinds("frequency constraint")
SPECTRUM.records |= BANDS.records
SPECTRUM.records |= {
    "magnitude_bound": Record(
        MagnitudeBound,
        own="stop_band",
        values=_bound,
        bins=BINS,
        band=BANDS,
        at_least=checked(lambda given: False, "an upper limit", NO_LOWER_MASK),
    ),
    "energy_bound": Record(EnergyBound, own="stop_band", values=_bound, bins=BINS, band=BANDS),
    "linear_constraint": Record(LinearConstraint),
}

OUTPUTS = Record(OutputSpectrum, own="output_spectrum", required=["constraints"], constraints=Tables(SPECTRUM))
