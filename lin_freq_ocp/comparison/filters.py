"""Filters of a classical optimal control, each designed from the stopped bins of its control."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Literal

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.problem.measures import stopped_runs
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box

# Decibels that a Butterworth filter may lose at the last kept bin, and must lose half way into the stop band.
PASS_LOSS, STOP_LOSS = 3.0, 20.0
MAX_ORDER = 10  # digital Butterworth filters of higher orders ring for longer than the horizons that need them

Kind = Literal["lowpass", "highpass", "bandstop"]


@dataclass(frozen=True, eq=False)
class FilteredControl:
    """A filtered control u, shape (T, m), and the description of the filter."""

    u: Array
    description: str


@dataclass(frozen=True, eq=False)
class Design:
    """The design data of a filter: bins to stop (T//2 + 1, m), bounds, and the unit, ``per_radian`` per rad/sample."""

    stop: Mask
    tube: Box
    unit: str
    per_radian: float


def apply_filter(name: str, problem: OptimalControlProblem, u: Array) -> FilteredControl:
    """Apply the named filter to a control u, shape (T, m)."""
    step = problem.sampling_time
    hertz = ("rad/sample", 1.0) if step is None else ("Hz", 1 / (2 * np.pi * step))
    return FILTERS[name](u, Design(filter_stop(problem), problem.control_tube, *hertz))


def filter_stop(problem: OptimalControlProblem) -> Mask:
    """Return the bins that a filter removes from the controls, shape (T//2 + 1, m): those stopped, masked or limited.

    A control without a band is not filtered. Where no control has a band, the filter removes the frequencies of the
    bands on states and outputs from every control, so as not to excite them.
    """
    stop = problem.control_band
    if stop.any():
        return stop
    T = problem.horizon
    k = np.arange(T // 2 + 1) / T
    removed = np.zeros(len(k), dtype=bool)
    for length, band in chain(*_other_bands(problem).values()):
        for first, last in stopped_runs(band):
            removed |= (k >= (first - 0.5) / length) & (k <= (last + 0.5) / length)
    return np.repeat(removed[:, None], problem.control_dim, axis=1)


def has_frequency_constraint(problem: OptimalControlProblem) -> bool:
    """Whether the spectrum of a control, a state or an output is constrained."""
    stopped = bool(problem.control_stop.any() or problem.state_stop.any())
    return stopped or any(term.kind.is_spectrum for term in problem.terms)


def can_be_filtered(problem: OptimalControlProblem) -> bool:
    """Whether there is a bin that a filter of the controls removes."""
    return bool(filter_stop(problem).any())


def filter_limits(problem: OptimalControlProblem) -> str:
    """Return the frequency constraints that filters of the controls cannot keep, in words; empty if there are none."""
    banded = {what: any(band.any() for _, band in bands) for what, bands in _other_bands(problem).items()}
    others = " and ".join(what for what, has_band in banded.items() if has_band)
    limits = list[str]()
    if others and problem.control_band.any():
        limits.append(f"bands on {others} are not filtered")
    elif others:
        limits.append(
            f"the band is on {others}, on which filters of the controls do not act; they remove its frequencies from "
            "every control instead"
        )
    without_bins = [term for term in problem.terms if term.kind.is_spectrum and term.map.spectrum is None]
    if any(term.semi_infinite is None for term in without_bins):
        limits.append("filters do not act on linear equations over all times")
    limits += [f"{term.name} is not about bins" for term in without_bins if term.semi_infinite is not None]
    return "; ".join(limits)


def _other_bands(problem: OptimalControlProblem) -> dict[str, list[tuple[int, Mask]]]:
    """Return the length of the signal and the stopped or bounded bins of every state and output."""
    states = [(problem.state_samples, problem.state_band[:, i]) for i in range(problem.state_dim)]
    outputs = list[tuple[int, Mask]]()
    for term in problem.terms:
        spectrum = term.map.spectrum
        if term.kind.of == "outputs" and spectrum is not None:
            bounded = np.zeros(spectrum.samples // 2 + 1, dtype=bool)
            bounded[spectrum.nearest_bins] = True
            outputs.append((spectrum.samples, bounded))
    return {"states": states, "outputs": outputs}


def brick_wall(u: Array, design: Design) -> FilteredControl:
    """Set the stopped bins to zero; a control without stopped bins stays as it is, without rounding."""
    spectrum = np.where(design.stop, 0.0, np.fft.rfft(u, axis=0))
    result = np.where(design.stop.any(axis=0), np.fft.irfft(spectrum, n=len(u), axis=0), u)
    return FilteredControl(result, "stopped or bounded bins set to zero")


def clip_to_bounds(u: Array, design: Design) -> FilteredControl:
    """Set the stopped bins to zero, then cut the result off at the control bounds."""
    return FilteredControl(
        design.tube.project(brick_wall(u, design).u), "stopped or bounded bins set to zero, then cut at the bounds"
    )


def moving_average(u: Array, design: Design) -> FilteredControl:
    """Average over the last samples, from rest: as many as put the first zero of the response into the stop band."""
    result, stop, descriptions = np.array(u), design.stop, list[str]()
    for j in range(u.shape[1]):
        for first, last in stopped_runs(stop[:, j]):
            reaches_nyquist = last == len(stop) - 1
            bin_of_zero = first if reaches_nyquist else (first + last) / 2
            length = int(np.clip(round(len(u) / max(bin_of_zero, 1.0)), 2, len(u)))
            padded = np.concatenate([np.zeros(length - 1), result[:, j]])
            result[:, j] = np.convolve(padded, np.full(length, 1 / length), mode="valid")
            descriptions.append(f"mean of the last {length} samples")
    return FilteredControl(result, _join_names(descriptions))


def butterworth(u: Array, design: Design, zero_phase: bool = False) -> FilteredControl:
    """Filter causally from rest, or forwards and then backwards, from rest on both sides."""
    from scipy import signal  # here, because it takes a second to import

    result, stop, descriptions = np.array(u), design.stop, list[str]()
    for j in range(u.shape[1]):
        for first, last in stopped_runs(stop[:, j]):
            if last - first + 1 == len(stop):
                result[:, j] = 0.0
                descriptions.append("everything removed")
                continue
            kind, passed, stopped = _design_edges(first, last, len(u))
            order, natural = signal.buttord(passed, stopped, PASS_LOSS, STOP_LOSS)
            sections = signal.butter(min(int(order), MAX_ORDER), natural, kind, output="sos")
            result[:, j] = signal.sosfilt(sections, result[:, j])
            if zero_phase:
                result[:, j] = signal.sosfilt(sections, result[::-1, j])[::-1]
            edges = ", ".join(f"{design.per_radian * np.pi * edge:.3g}" for edge in np.atleast_1d(natural))
            descriptions.append(f"order {min(int(order), MAX_ORDER)} {kind}, edge {edges} {design.unit}")
    causality = "forwards and backwards" if zero_phase else "causal"
    return FilteredControl(result, f"Butterworth, {causality}: {_join_names(descriptions)}")


def _design_edges(first: int, last: int, length: int) -> tuple[Kind, float | list[float], float | list[float]]:
    """Return type, pass edges and stop edges (Nyquist = 1) of a filter for a run of stopped bins."""
    nyquist = length / 2
    below, above = max(first - 1, 0.25), min(last + 1, nyquist - 0.25)
    if first == 0:
        return "highpass", above / nyquist, above / 2 / nyquist
    if last >= nyquist - 0.5:
        return "lowpass", below / nyquist, (below + nyquist) / 2 / nyquist
    quarter = (above - below) / 4
    return ("bandstop", [below / nyquist, above / nyquist], [(below + quarter) / nyquist, (above - quarter) / nyquist])


def _join_names(descriptions: Sequence[str]) -> str:
    return "; ".join(dict.fromkeys(descriptions)) or "nothing to remove"


FILTERS: dict[str, Callable[[Array, Design], FilteredControl]] = {
    "brickwall": brick_wall,
    "butterworth": butterworth,
    "zero_phase": partial(butterworth, zero_phase=True),
    "moving_average": moving_average,
    "clipped": clip_to_bounds,
}
