"""What people do today: solve without the frequency constraint and filter the control afterwards.

Every filter is designed from the stopped bins of its control, and says in words what it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from lin_freq_ocp.analysis.measures import stopped_runs
from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.terms.term import TermKind

PASS_LOSS, STOP_LOSS = 3.0, 20.0
"""Decibels a Butterworth filter may lose at the last kept bin, and must lose half way into the stop band."""

MAX_ORDER = 10
"""Higher orders of a digital Butterworth filter ring for longer than the horizons that need them."""


@dataclass(frozen=True, eq=False)
class FilteredControl:
    """A filtered control u, shape (T, m), and the description of the filter."""

    u: Array
    description: str


@dataclass(frozen=True, eq=False)
class Wanted:
    """The design data of a filter: bins to stop (T//2 + 1, m), bounds, and the unit, ``per_radian`` per rad/sample."""

    stop: Mask
    tube: Box
    unit: str
    per_radian: float


def filtered(name: str, problem: OptimalControlProblem, u: Array) -> FilteredControl:
    """Apply the named filter to a control u, shape (T, m)."""
    require_filters([name])
    step = problem.sampling_time
    hertz = ("rad/sample", 1.0) if step is None else ("Hz", 1 / (2 * np.pi * step))
    return FILTERS[name](u, Wanted(filter_stop(problem), problem.control_tube, *hertz))


def require_filters(names: Sequence[str]) -> None:
    """Raise ProblemError unless all names are filters."""
    for name in names:
        if name not in FILTERS:
            raise ProblemError("filters", repr(name), f"some of {', '.join(FILTERS)}")


def filter_stop(problem: OptimalControlProblem) -> Mask:
    """Return the bins that a filter removes from the controls, shape (T//2 + 1, m): those stopped, masked or limited.

    A control without a band is not filtered. Where no control has one, the filter removes the frequencies of the bands
    on states and outputs from every control, as one does who must not excite them.
    """
    stop = problem.control_band
    if stop.any():
        return stop
    T = problem.horizon
    k = np.arange(T // 2 + 1) / T
    removed = np.zeros(len(k), dtype=bool)
    for length, band in _other_bands(problem):
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
    """Say which frequency constraints filters of the controls do not act on; nothing where they act on all."""
    kinds = {"state": "states", "output": "outputs"}
    others = [
        what for kind, what in kinds.items() if any(band.any() for _, band in _other_bands(problem, f"{kind} spectrum"))
    ]
    words = list[str]()
    if others and problem.control_band.any():
        words.append(f"bands on {' and '.join(others)} are not filtered")
    elif others:
        words.append(
            f"the band is on {' and '.join(others)}, on which filters of the controls do not act; they remove its "
            "frequencies from every control instead"
        )
    if any(term.kind.is_spectrum and not len(term.map.nearest_bins) for term in problem.terms):
        words.append("linear equations over all times are nothing that a filter acts on")
    return "; ".join(words)


def _other_bands(problem: OptimalControlProblem, kind: str = "") -> Iterator[tuple[int, Mask]]:
    """Yield the length of the signal and the stopped or bounded bins of every state and output, or of one kind."""
    if kind != "output spectrum":
        yield from ((problem.horizon + 1, problem.state_band[:, i]) for i in range(problem.state_dim))
    for term in problem.terms:
        if kind != "state spectrum" and term.kind == TermKind.OUTPUT_SPECTRUM:
            length = term.map.samples
            bounded = np.zeros(length // 2 + 1, dtype=bool)
            bounded[term.map.nearest_bins] = True
            yield length, bounded


def brick_wall(u: Array, wanted: Wanted) -> FilteredControl:
    """Set the stopped bins to zero."""
    spectrum = np.where(wanted.stop, 0.0, np.fft.rfft(u, axis=0))
    return FilteredControl(np.fft.irfft(spectrum, n=len(u), axis=0), "stopped or bounded bins set to zero")


def clipped(u: Array, wanted: Wanted) -> FilteredControl:
    """Set the stopped bins to zero, then cut the result off at the control bounds."""
    return FilteredControl(
        wanted.tube.project(brick_wall(u, wanted).u), "stopped or bounded bins set to zero, then cut at the bounds"
    )


def butterworth(u: Array, wanted: Wanted) -> FilteredControl:
    """Filter causally, from rest."""
    return _with_sections(u, wanted, zero_phase=False)


def zero_phase(u: Array, wanted: Wanted) -> FilteredControl:
    """Filter forwards and then backwards, from rest on both sides."""
    return _with_sections(u, wanted, zero_phase=True)


def moving_average(u: Array, wanted: Wanted) -> FilteredControl:
    """Average over the last samples, from rest: as many as put the first zero of the response into the stop band."""
    result, stop, words = np.array(u), wanted.stop, list[str]()
    for j in range(u.shape[1]):
        for first, last in stopped_runs(stop[:, j]):
            reaches_nyquist = last == len(stop) - 1
            bin_of_zero = first if reaches_nyquist else (first + last) / 2
            length = int(np.clip(round(len(u) / max(bin_of_zero, 1.0)), 2, len(u)))
            padded = np.concatenate([np.zeros(length - 1), result[:, j]])
            result[:, j] = np.convolve(padded, np.full(length, 1 / length), mode="valid")
            words.append(f"mean of the last {length} samples")
    return FilteredControl(result, _joined(words))


Kind = Literal["lowpass", "highpass", "bandstop"]

FILTERS: dict[str, Callable[[Array, Wanted], FilteredControl]] = {
    "brickwall": brick_wall,
    "butterworth": butterworth,
    "zero_phase": zero_phase,
    "moving_average": moving_average,
    "clipped": clipped,
}


def _with_sections(u: Array, wanted: Wanted, zero_phase: bool) -> FilteredControl:
    from scipy import signal  # here, because it takes a second to import

    result, stop, words = np.array(u), wanted.stop, list[str]()
    for j in range(u.shape[1]):
        for first, last in stopped_runs(stop[:, j]):
            if last - first + 1 == len(stop):
                result[:, j] = 0.0
                words.append("everything removed")
                continue
            kind, passed, stopped = _edges(first, last, len(u))
            order, natural = signal.buttord(passed, stopped, PASS_LOSS, STOP_LOSS)
            sections = signal.butter(min(int(order), MAX_ORDER), natural, kind, output="sos")
            result[:, j] = signal.sosfilt(sections, result[:, j])
            if zero_phase:
                result[:, j] = signal.sosfilt(sections, result[::-1, j])[::-1]
            edges = ", ".join(f"{wanted.per_radian * np.pi * edge:.3g}" for edge in np.atleast_1d(natural))
            words.append(f"order {min(int(order), MAX_ORDER)} {kind}, edge {edges} {wanted.unit}")
    causality = "forwards and backwards" if zero_phase else "causal"
    return FilteredControl(result, f"Butterworth, {causality}: {_joined(words)}")


def _edges(first: int, last: int, length: int) -> tuple[Kind, float | list[float], float | list[float]]:
    """Return type, pass edges and stop edges (Nyquist = 1) of a filter for a run of stopped bins."""
    nyquist = length / 2
    below, above = max(first - 1, 0.25), min(last + 1, nyquist - 0.25)
    if first == 0:
        return "highpass", above / nyquist, above / 2 / nyquist
    if last >= nyquist - 0.5:
        return "lowpass", below / nyquist, (below + nyquist) / 2 / nyquist
    quarter = (above - below) / 4
    return ("bandstop", [below / nyquist, above / nyquist], [(below + quarter) / nyquist, (above - quarter) / nyquist])


def _joined(words: Sequence[str]) -> str:
    return "; ".join(dict.fromkeys(words)) or "nothing to remove"
