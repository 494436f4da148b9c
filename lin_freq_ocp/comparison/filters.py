"""What people do today: solve without the frequency constraint and filter the control afterwards.

Every filter is designed from the stopped bins of its control, and says in words what it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem.arrays import Array, Mask
from lin_freq_ocp.problem.measures import stopped_runs
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets import Box

PASS_LOSS, STOP_LOSS = 3.0, 20.0
"""Decibels a Butterworth filter may lose at the last kept bin, and must lose half way into the stop band."""

MAX_ORDER = 10
"""Higher orders of a digital Butterworth filter ring for longer than the horizons that need them."""


@dataclass(frozen=True, eq=False)
class FilteredControl:
    """A filtered control u, shape (T, m), and the filter in words."""

    u: Array
    description: str


def filtered(name: str, problem: OptimalControlProblem, u: Array) -> FilteredControl:
    """Apply the named filter to a control u, shape (T, m).

    Raises
    ------
    ProblemError
        If there is no filter of that name.
    """
    require_filters([name])
    return FILTERS[name](u, filter_stop(problem), problem.control_tube)


def require_filters(names: Sequence[str]) -> None:
    """Raise ProblemError unless all names are filters."""
    for name in names:
        if name not in FILTERS:
            raise ProblemError("filters", repr(name), f"some of {', '.join(FILTERS)}")


def filter_stop(problem: OptimalControlProblem) -> Mask:
    """Return the bins that a filter removes from the controls, shape (T//2 + 1, m): those stopped, masked or limited.

    Where no control has a stop band, the filter removes the frequencies of the states' stop bands from every control,
    as one does who must not excite them.
    """
    stop = problem.control_band
    if stop.any() or not problem.state_band.any():
        return stop
    T = problem.horizon
    k = np.arange(T // 2 + 1) / T
    removed = np.zeros(len(k), dtype=bool)
    for i in range(problem.state_dim):
        for first, last in stopped_runs(problem.state_band[:, i]):
            removed |= (k >= (first - 0.5) / (T + 1)) & (k <= (last + 0.5) / (T + 1))
    return np.repeat(removed[:, None], problem.control_dim, axis=1)


def brick_wall(u: Array, stop: Mask, tube: Box) -> FilteredControl:
    """Set the stopped bins to zero."""
    spectrum = np.where(stop, 0.0, np.fft.rfft(u, axis=0))
    return FilteredControl(np.fft.irfft(spectrum, n=len(u), axis=0), "stopped bins set to zero")


def clipped(u: Array, stop: Mask, tube: Box) -> FilteredControl:
    """Set the stopped bins to zero, then cut the result off at the control bounds."""
    return FilteredControl(
        tube.project(brick_wall(u, stop, tube).u), "stopped bins set to zero, then cut at the bounds"
    )


def butterworth(u: Array, stop: Mask, tube: Box) -> FilteredControl:
    """Filter causally, from rest."""
    return _with_sections(u, stop, zero_phase=False)


def zero_phase(u: Array, stop: Mask, tube: Box) -> FilteredControl:
    """Filter forwards and then backwards, from rest on both sides."""
    return _with_sections(u, stop, zero_phase=True)


def moving_average(u: Array, stop: Mask, tube: Box) -> FilteredControl:
    """Average over the last samples, from rest: as many as put the first zero of the response into the stop band."""
    result, words = np.array(u), list[str]()
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

FILTERS: dict[str, Callable[[Array, Mask, Box], FilteredControl]] = {
    "brickwall": brick_wall,
    "butterworth": butterworth,
    "zero_phase": zero_phase,
    "moving_average": moving_average,
    "clipped": clipped,
}


def _with_sections(u: Array, stop: Mask, zero_phase: bool) -> FilteredControl:
    from scipy import signal  # here, because it takes a second to import

    result, words = np.array(u), list[str]()
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
            edges = ", ".join(f"{np.pi * edge:.3g}" for edge in np.atleast_1d(natural))
            words.append(f"order {min(int(order), MAX_ORDER)} {kind}, edge {edges} rad/sample")
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
