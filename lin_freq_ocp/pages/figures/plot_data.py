"""What the panels of a figure share: the problem with its trajectories, their units, and the ranges of axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.phrases import join_words
from lin_freq_ocp.comparison.trajectories import MeasuredTrajectory, ProblemSignal, controls_of, outputs_of, states_of
from lin_freq_ocp.pages.figures.look import AXIS_MARGIN, Note, Style
from lin_freq_ocp.pages.units import Scale, frequency_scale, quantity, rough, time_scale
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory

OVERLAY_REACH = 0.6  # an overlay may widen an axis by this fraction of what the others span; beyond, it is cut off
BOUND_REACH = 0.6  # likewise for a bound far from all trajectories


@dataclass(frozen=True, eq=False)
class Trace:
    """One trajectory as a figure shows it."""

    label: str
    measured: MeasuredTrajectory
    style: Style
    detail: str = ""  # beside the label in the legend
    overlay: bool = False  # whether the axes may cut it off, so that a filtered trajectory leaves room for the others

    @property
    def trajectory(self) -> Trajectory:
        """Return the trajectory."""
        return self.measured.trajectory

    def of(self, signal: ProblemSignal) -> Array:
        """Return the values of a signal over time."""
        return signal.of(self.trajectory)


@dataclass(frozen=True)
class Span:
    """A mode that holds over the steps start .. end - 1, from time ``start`` to time ``end``."""

    start: int
    end: int
    mode: int


def spans(sequence: Indices) -> tuple[Span, ...]:
    """Return the runs of equal modes of a sequence."""
    edges = [0, *(int(t) + 1 for t in np.flatnonzero(np.diff(sequence))), len(sequence)]
    return tuple(Span(start, end, int(sequence[start])) for start, end in pairwise(edges))


@dataclass(frozen=True)
class View:
    """The range of an axis, and whether an overlay leaves it."""

    low: float
    high: float
    outside: bool


@dataclass(frozen=True, eq=False)
class PlotData:
    """A problem and the trajectories to show, at least one of them not an overlay."""

    problem: OptimalControlProblem
    traces: tuple[Trace, ...]

    @cached_property
    def time(self) -> Scale:
        """Return the scale of the time axes."""
        return time_scale(self.problem)

    @cached_property
    def frequency(self) -> Scale:
        """Return the scale of the frequency axes."""
        return frequency_scale(self.problem)

    @property
    def main(self) -> Trace:
        """Return the trajectory that the figure is about: the last that is not an overlay."""
        return [trace for trace in self.traces if not trace.overlay][-1]

    @cached_property
    def modes(self) -> tuple[Span, ...]:
        """Return the modes of the main trajectory; nothing with fewer than two modes."""
        return () if self.main.measured.modes is None else spans(self.main.measured.modes)

    @cached_property
    def controls(self) -> list[ProblemSignal]:
        """Return all controls."""
        return controls_of(self.problem)

    @cached_property
    def states(self) -> list[ProblemSignal]:
        """Return all states."""
        return states_of(self.problem)

    @cached_property
    def outputs(self) -> list[ProblemSignal]:
        """Return the outputs whose spectrum is constrained."""
        return outputs_of(self.problem)

    def showing(self, signal: ProblemSignal) -> tuple[Trace, ...]:
        """Return the traces that have meaningful values of this signal."""
        return tuple(trace for trace in self.traces if trace.measured.meaningful or not signal.is_state)

    def view(self, signal: ProblemSignal) -> View:
        """Return the range of a signal's axis."""
        shown = self.showing(signal)
        return view(
            [trace.of(signal) for trace in shown if not trace.overlay],
            [trace.of(signal) for trace in shown if trace.overlay],
            np.concatenate([*signal.bounds, *(line.values for line in signal.row_bounds)]),
            [line.values[np.isfinite(line.values)] for line in signal.references],
        )

    def notes(self, signals: Sequence[ProblemSignal]) -> list[Note]:
        """Return which trajectories are missing from a panel of these states, and which leave it."""
        outside = any(self.view(signal).outside for signal in signals)
        notes = list[Note]()
        for trace in self.traces:
            measured, text = trace.measured, ""
            if measured.stopped:
                text = f"not replayed; its {measured.why_stopped}"
            elif not measured.meaningful:
                text = f"not replayed; rounding errors would grow {rough(measured.measures.amplification)}-fold"
            elif trace.overlay and outside:
                text = f"leaves the picture; {_end_text(trace, signals)}"
            if text:
                notes.append(Note(f"{trace.label}: {text}", trace.style.color))
        return notes


def _end_text(trace: Trace, signals: Sequence[ProblemSignal]) -> str:
    """Return how far from the terminal set a trajectory ends, or how far it goes where the end is free."""
    end = trace.measured.end
    bounded = [] if end is None else [one for one in signals if end.bounded[one.index]]
    if end is not None and bounded:
        return f"ends {join_words([quantity(float(end.values[one.index]), one.name) for one in bounded])} away"
    return f"goes as far as {join_words([quantity(trace.measured.largest(one), one.name) for one in signals])}"


def view(mains: Sequence[Array], overlays: Sequence[Array], bounds: Array, references: Sequence[Array] = ()) -> View:
    """Return a range that shows all mains and references, and overlays and bounds as far as they are near."""
    mains = [*mains, *references]
    low, high = min(float(main.min()) for main in mains), max(float(main.max()) for main in mains)
    span = high - low or max(abs(high), 1.0)
    reach = BOUND_REACH * span
    near = [float(b) for b in np.unique(bounds[np.isfinite(bounds)]) if low - reach <= b <= high + reach]
    low, high = min([low, *near]), max([high, *near])
    slack, outside = OVERLAY_REACH * span, False
    for overlay in overlays:
        if overlay.min() < low - slack or overlay.max() > high + slack:
            outside = True
        else:
            low, high = min(low, float(overlay.min())), max(high, float(overlay.max()))
    margin = AXIS_MARGIN * (high - low or span)
    return View(low - margin, high + margin, outside)
