"""What can be moved of frequency constraints: edges of bands, and levels of masks, energies and vibrations.

One bin of the DFT is a notch of an edge. The one low pass of the controls has the key "cutoff"; its last notch, at or
above Nyquist, stands for none. A level of a dB multiplies limits of magnitudes by 10^(a/20), those of energies by its
square.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import ceil, floor, isfinite, pi

import numpy as np

from lin_freq_ocp.pages.explorer.movable import NOTCHES, Movable, Slider, Values, notches
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.bands import Band, low_pass
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, OutputSpectrum, component_words, entries_of
from lin_freq_ocp.problem.spectrum.bounds import EnergyBound, MagnitudeBound

CUTOFF, GROUP = "cutoff", "frequency"
MOST_NOTCHES = 200  # of an edge: one bin each up to horizons of 400
LEVELS = -40.0, 20.0, 0.5  # dB: lowest, highest, and a notch
WIDEST = 3.0  # notches, of their own width
PART_OF_WIDTH = 0.1  # of a notch at every frequency, where bins mean nothing, that its edges are moved by

# Of every kind of band the edges that can be moved, by their index.
EDGES = {
    "low_pass": {1: "cut-off"},
    "high_pass": {0: "cut-off"},
    "band_pass": {0: "lower edge", 1: "upper edge"},
    "notch": {0: "centre", 1: "width"},
}


@dataclass(frozen=True)
class Axis:
    """Frequencies of sliders: their unit, the Nyquist frequency, and a notch."""

    unit: str
    nyquist: float
    notch: float

    @classmethod
    def of(cls, problem: OptimalControlProblem) -> Axis:
        """Return that of a problem: in Hz with a sampling time."""
        step = problem.sampling_time
        nyquist, unit = (pi, "rad/sample") if step is None else (0.5 / step, "Hz")
        return cls(unit, nyquist, max(2 * nyquist / problem.horizon, nyquist / MOST_NOTCHES))

    def per_unit(self, band: Band) -> float:
        """Return the factor from the unit of a band to that of the sliders."""
        return 1.0 if band.unit == self.unit else self.nyquist / pi


def _sliders(problem: OptimalControlProblem) -> Iterator[Slider]:
    """Yield the cut-off of the controls, then of every constraint its edges and its level, under different labels."""
    axis, labels = Axis.of(problem), list[str]()
    cutoff = _cutoff(problem, axis)
    yield from cutoff
    for key, one, names in _entries(problem):
        of = f"of the {_name(one)} of {component_words(one.component, names)}"
        edges = () if cutoff and key == "control_spectrum.0" else _edges(key, one, of, axis)
        low, high, notch = LEVELS  # in dB of the problem's own limit
        level = Slider(f"level.{key}", GROUP, f"level {of}", "dB", low, high, notch, 0.0, high)
        for slider in (*edges, *([] if one.scaled(1.0) is None else [level])):
            labels.append(slider.label)
            count = labels.count(slider.label)
            yield replace(slider, label=f"{slider.label} ({count})") if count > 1 else slider


def _fields(problem: OptimalControlProblem, moved: Values) -> dict[str, object]:
    """Return the spectra of which a constraint is moved."""
    axis = Axis.of(problem)
    found = {key: changed for key, one, _ in _entries(problem) if (changed := _move(key, one, moved, axis)) is not one}
    fields = dict[str, object]()
    for field in ("control_spectrum", "state_spectrum"):
        given = entries_of(getattr(problem, field))
        if any(key.startswith(field) for key in found):
            fields[field] = [found.get(f"{field}.{i}", one) for i, one in enumerate(given)]
    if any(key.startswith("output_spectrum") for key in found):
        outputs: Sequence[OutputSpectrum] = entries_of(problem.output_spectrum)
        fields["output_spectrum"] = [
            OutputSpectrum(
                output.C,
                output.D,
                [found.get(f"output_spectrum.{i}.{j}", one) for j, one in enumerate(output.constraints)],
                output.output_names,
            )
            for i, output in enumerate(outputs)
        ]
    if CUTOFF in moved:
        fields["control_spectrum"] = _low_pass(problem, moved[CUTOFF], axis)
    return fields


FREQUENCIES = Movable(_sliders, _fields)


def _entries(problem: OptimalControlProblem) -> Iterator[tuple[str, FrequencyConstraint, Sequence[str]]]:
    """Yield of every frequency constraint where it stands, itself, and the names of its signal's components."""
    for field, names in (("control_spectrum", problem.control_names), ("state_spectrum", problem.state_names)):
        for i, one in enumerate(entries_of(getattr(problem, field))):
            yield f"{field}.{i}", one, names
    outputs: Sequence[OutputSpectrum] = entries_of(problem.output_spectrum)
    for i, output in enumerate(outputs):
        for j, one in enumerate(output.constraints):
            yield f"output_spectrum.{i}.{j}", one, output.output_names


def _name(one: FrequencyConstraint) -> str:
    match one:
        case Band():
            return one.kind.replace("_", " ")
        case _:
            return one.label


def _cutoff(problem: OptimalControlProblem, axis: Axis) -> tuple[Slider, ...]:
    """Return the cut-off of the one low pass on the controls, or of none."""
    match entries_of(problem.control_spectrum):
        case []:
            value = axis.nyquist
        case [Band(kind="low_pass") as band]:
            value = band.edges[1] * axis.per_unit(band)
        case _:
            return ()
    notch = axis.notch
    low, high = value - floor(value / notch - 1) * notch, value + ceil((axis.nyquist - value) / notch) * notch
    slider = Slider(CUTOFF, GROUP, "cut-off of the controls", axis.unit, low, high, notch, value, high)
    return (slider,) if low < high else ()


def _low_pass(problem: OptimalControlProblem, value: float, axis: Axis) -> Band | None:
    """Return the low pass of the problem with another cut-off, or none."""
    if value >= _cutoff(problem, axis)[0].high:
        return None
    entries = entries_of(problem.control_spectrum)
    component = entries[0].component if entries else None
    return low_pass(**{"cutoff" if problem.sampling_time is None else "cutoff_hz": value}, component=component)


def _band(one: FrequencyConstraint) -> Band | None:
    """Return the band whose edges can be moved: not of bins, and not with a limit for each bin or frequency."""
    match one:
        case Band():
            band = one
        case MagnitudeBound() | EnergyBound() if np.ndim(one.limit) == 0:
            band = one.band
        case _:
            return None
    return band if band.kind in EDGES else None


def _replace_band(one: FrequencyConstraint, band: Band) -> FrequencyConstraint:
    """Return a constraint with another band."""
    match one:
        case MagnitudeBound() | EnergyBound():
            return one.within(band)
        case _:
            return band


def _edges(key: str, one: FrequencyConstraint, of: str, axis: Axis) -> Iterator[Slider]:
    """Yield the edges of the band of a constraint within Nyquist."""
    band = _band(one)
    if band is None or max(edge for edge in band.limits if isfinite(edge)) * axis.per_unit(band) > axis.nyquist:
        return
    own = [edge * axis.per_unit(band) for edge in band.edges]
    step = min(axis.notch, PART_OF_WIDTH * own[1]) if band.kind == "notch" and one.every_frequency else axis.notch
    for i, name in EDGES[band.kind].items():
        low, high, easier = _range(band.kind, i, own, step, axis)
        first, last, notch = notches(min(low, own[i]), own[i], max(high, own[i]), step)
        relaxed = {-1: first, 0: own[i], 1: last}[easier]
        if first < last:
            yield Slider(f"edge.{key}.{i}", GROUP, f"{name} {of}", axis.unit, first, last, notch, own[i], relaxed)


def _range(kind: str, i: int, own: Sequence[float], step: float, axis: Axis) -> tuple[float, float, int]:
    """Return between which limits an edge is moved, and to which side (-1, 0, 1) the problem gets easier."""
    match kind, i:
        case "band_pass", 0:
            return 0.0, sum(own) / 2, -1
        case "band_pass", _:
            return sum(own) / 2, axis.nyquist, 1
        case "notch", 1:
            return step, min(WIDEST * max(own[1], step), axis.nyquist), -1
        case "notch", _:
            return max(step, own[0] - NOTCHES * step), min(axis.nyquist - step, own[0] + NOTCHES * step), 0
        case _:
            return step, axis.nyquist - step, 1 if kind == "low_pass" else -1


def _move(key: str, one: FrequencyConstraint, moved: Values, axis: Axis) -> FrequencyConstraint:
    """Return a constraint with its moved edges and level."""
    band, level = _band(one), moved.get(f"level.{key}")
    if band is not None:
        values = {i: moved.get(f"edge.{key}.{i}") for i in EDGES[band.kind]}
        new = {i: value / axis.per_unit(band) for i, value in values.items() if value is not None}
        if new:
            band = replace(band, edges=tuple(new.get(i, edge) for i, edge in enumerate(band.edges)))
            one = _replace_band(one, band)
    return one if level is None else one.scaled(10 ** (level / 20)) or one
