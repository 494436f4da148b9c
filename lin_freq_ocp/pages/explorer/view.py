"""A problem and a trajectory as plain data for drawing: signals over time, and their spectra, in the axes' units.

The spectrum of a signal v of N samples is |V_k| = |sum_t v_t exp(-2 pi i k t / N)|, k = 0 .. N//2, as limits mean it.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.comparison.signals import Signal, controls_of, outputs_of, states_of
from lin_freq_ocp.comparison.vibrations import ABOVE, frequencies_around, vibration
from lin_freq_ocp.pages.report.units import frequency_scale, time_scale
from lin_freq_ocp.problem.measures import stopped_runs
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.reformulations import everywhere_of
from lin_freq_ocp.problem.terms.semi_infinite import PlantBox
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Trajectory

DIGITS = 4  # significant, of values that are drawn
MOST_SIGNALS = 24  # that are drawn over time; controls come first

Data = dict[str, object]  # as JSON has it


def frame(problem: OptimalControlProblem) -> Data:
    """Return what does not depend on a trajectory: axes, names, bounds, stopped bins and limits."""
    time, frequency = time_scale(problem), frequency_scale(problem)
    return {
        "horizon": problem.horizon,
        "time": {"step": time.factor, "label": time.label},
        "frequency": {"label": frequency.label},
        "signals": [_signal(signal) for signal in _over_time(problem)],
        "spectra": [_spectrum(signal, frequency.factor) for signal in _over_frequency(problem)],
        "vibrations": [_vibration(term, box) for term, box in everywhere_of(problem, PlantBox)],
    }


def drawn(problem: OptimalControlProblem, trajectory: Trajectory) -> Data:
    """Return the values of all signals and spectra of a trajectory, in the order of the frame."""
    spectra = [signal.of(trajectory)[: signal.samples] for signal in _over_frequency(problem)]
    return {
        "signals": [rounded(signal.of(trajectory)) for signal in _over_time(problem)],
        "spectra": [rounded(np.abs(np.fft.rfft(values))) for values in spectra],
        "vibrations": [
            rounded(vibration(box, trajectory, frequencies_around(box))) for _, box in everywhere_of(problem, PlantBox)
        ],
    }


def rounded(values: Array) -> list[float | None]:
    """Return numbers with few digits; None for what is no number."""
    return [float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None for value in map(float, values)]


def _over_time(problem: OptimalControlProblem) -> list[Signal]:
    return [*controls_of(problem), *states_of(problem)][:MOST_SIGNALS]


def _over_frequency(problem: OptimalControlProblem) -> list[Signal]:
    """Return all controls, and the states and outputs with a limit on their spectrum."""
    limited = [state for state in states_of(problem) if state.stop.any()]
    return [*controls_of(problem), *limited, *outputs_of(problem)][:MOST_SIGNALS]


def _signal(signal: Signal) -> Data:
    lower, upper = signal.bounds
    return {"name": signal.name, "state": signal.is_state, "lower": _bound(lower), "upper": _bound(upper)}


def _bound(values: Array) -> list[float | None]:
    """Return a bound over time, as a single value where it is constant."""
    return rounded(values[:1] if (values == values[0]).all() else values)


def _spectrum(signal: Signal, factor: float) -> Data:
    per_bin = 2 * np.pi / signal.samples * factor
    runs = stopped_runs(signal.stop)
    last = signal.samples / 2
    edges: Iterable[tuple[float, float]] = ((max(a - 0.5, 0.0), min(b + 0.5, last)) for a, b in runs)
    return {
        "name": signal.name,
        "step": per_bin,
        "stopped": [[per_bin * low, per_bin * high] for low, high in edges],
        "limits": [{"at": rounded(factor * line.at), "values": rounded(line.values)} for line in signal.levels],
    }


def _vibration(term: Term, box: PlantBox) -> Data:
    """Return the axis of a residual vibration, its box of natural frequencies, and its limit."""
    return {
        "name": term.name,
        "at": rounded(frequencies_around(box)),
        "box": [float(box.low[0]), float(box.high[0])],
        "limit": box.limit,
        "top": ABOVE * box.limit,
    }
