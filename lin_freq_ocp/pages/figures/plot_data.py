"""What the panels of a figure share: the problem with its trajectories, their units, and the ranges of axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.phrases import combination, join_words, short_name, split_unit
from lin_freq_ocp.comparison.trajectories import MeasuredTrajectory, ProblemSignal, controls_of, outputs_of, states_of
from lin_freq_ocp.formulas.jets import values_of
from lin_freq_ocp.pages.figures.look import AXIS_MARGIN, Note, Style
from lin_freq_ocp.pages.units import Scale, frequency_scale, quantity, rough, time_scale
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.path_constraint import PathConstraint
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.spectrum.base import entries_of
from lin_freq_ocp.problem.trajectory import Trajectory

OVERLAY_REACH = 0.6  # an overlay may extend an axis by this fraction of the others' span, and is cut off there
MOST_JOINT_ROWS, MOST_LEVELS = 6, 16  # in one figure; in one panel
BOUND_REACH = 0.6  # the same for a bound far from all trajectories


@dataclass(frozen=True, eq=False)
class Trace:
    """A trajectory in a figure."""

    label: str
    measured: MeasuredTrajectory
    style: Style
    detail: str = ""  # in the legend, after the label
    overlay: bool = False  # whether the axes may cut it off: a filtered trajectory may run away

    @property
    def trajectory(self) -> Trajectory:
        """Return the trajectory."""
        return self.measured.trajectory

    def of(self, signal: ProblemSignal) -> Array:
        """Return the values of a signal over time."""
        return signal.of(self.trajectory)


@dataclass(frozen=True)
class Span:
    """A mode over the steps start .. end - 1, from time ``start`` to time ``end``."""

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

    @property
    def length(self) -> float:
        """Return the length of the range."""
        return self.high - self.low

    def with_length(self, length: float) -> View:
        """Return a range of this length about the same centre."""
        more = (length - self.length) / 2
        return View(self.low - more, self.high + more, self.outside)


@dataclass(frozen=True, eq=False)
class PlotData:
    """A problem and its trajectories; at least one of them is no overlay."""

    problem: OptimalControlProblem
    traces: tuple[Trace, ...]
    tightened: OptimalControlProblem | None = None  # with the limits of the problem less their margins
    largest: Array | None = None  # (bins, m): magnitudes of the controls over all loads

    @cached_property
    def time(self) -> Scale:
        """Return the scale of the time axes."""
        return time_scale(self.problem)

    @cached_property
    def frequency(self) -> Scale:
        """Return the scale of the frequency axes."""
        return frequency_scale(self.problem)

    @cached_property
    def joint_rows(self) -> list[JointRow]:
        """Return the joint rows of the problem that the main trajectory brings nearest to their limits."""
        return sorted(joint_rows(self.problem), key=lambda row: row.margin(self.main.trajectory))[:MOST_JOINT_ROWS]

    @cached_property
    def obstacles(self) -> list[Obstacle]:
        """Return the path constraints on two states alone that are the same at all times."""
        obstacles = list[Obstacle]()
        for family in self.problem.stage_rows:
            if isinstance(family, PathConstraint) and family.is_steady:
                planes = dict[tuple[int, int], list[int]]()
                for i, used in enumerate(family.used):
                    if used.sum() == 2 and not used[self.problem.state_dim :].any():
                        first, second = (int(k) for k in np.flatnonzero(used))
                        planes.setdefault((first, second), []).append(i)
                obstacles += [Obstacle(pair, family, components) for pair, components in planes.items()]
        return obstacles

    def control_levels(self, signal: ProblemSignal) -> Array:
        """Return the levels of a control, (levels,); none if it has no or too many levels, and none of a state."""
        if signal.is_state:
            return np.zeros(0)
        levels = [entry.levels_of(self.problem.control_dim) for entry in entries_of(self.problem.control_set)]
        values = np.unique(np.concatenate([np.zeros(0), *(entry[signal.index] for entry in levels if len(entry))]))
        return values if len(values) <= MOST_LEVELS else np.zeros(0)

    @property
    def main(self) -> Trace:
        """Return the trajectory that the figure is about: the last that is not an overlay."""
        return [trace for trace in self.traces if not trace.overlay][-1]

    @cached_property
    def modes(self) -> tuple[Span, ...]:
        """Return the modes of the main trajectory; none with fewer than two modes."""
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
        """Return notes on the trajectories that are missing from a panel of these states, or leave it."""
        outside = any(self.view(signal).outside for signal in signals)
        notes = list[Note]()
        for trace in self.traces:
            measured, text = trace.measured, ""
            if measured.stopped:
                text = f"not simulated; its {measured.why_stopped}"
            elif not measured.meaningful:
                text = f"not simulated; rounding errors would grow {rough(measured.measures.amplification)}-fold"
            elif trace.overlay and outside:
                end = measured.end  # its distance from the terminal set; with a free end, the largest values
                missed = [] if end is None else [signal for signal in signals if end.bounded[signal.index]]
                if end is not None and missed:
                    sizes = [quantity(float(end.values[signal.index]), signal.name) for signal in missed]
                    text = f"leaves the picture; ends {join_words(sizes)} away"
                else:
                    sizes = [quantity(measured.largest(signal), signal.name) for signal in signals]
                    text = f"leaves the picture; goes as far as {join_words(sizes)}"
            if text:
                notes.append(Note(f"{trace.label}: {text}", trace.style.color))
        return notes


@dataclass(frozen=True, eq=False)
class JointRow:
    """A stage row on several components, such as the rate of a control, with its values and bounds over time, (T,)."""

    words: str  # its combination of components
    unit: str
    family: StageRows
    index: int
    lower: Array
    upper: Array

    def values(self, trajectory: Trajectory) -> Array:
        """Return its values along a trajectory, (T,)."""
        return self.family.values(trajectory.x, trajectory.u)[: len(trajectory.u), self.index]

    def margin(self, trajectory: Trajectory) -> float:
        """Return the least distance of its values from its bounds, relative to the largest value."""
        values = self.values(trajectory)
        distance = min(float((values - self.lower).min()), float((self.upper - values).min()))
        return distance / (float(np.abs(values).max()) or 1.0)


@dataclass(frozen=True, eq=False)
class Obstacle:
    """The points of a plane of two states that a path constraint excludes at all times, by one component or more."""

    pair: tuple[int, int]
    constraint: PathConstraint
    components: list[int]

    def excess(self, points: Array) -> Array:
        """Return h - upper at points of the plane, (points, 2), the largest of all components: above 0 inside."""
        y = np.zeros((len(points), self.constraint.used.shape[1]))
        y[:, self.pair] = points
        return (values_of(self.constraint.formulas, y) - self.constraint.limits()[0])[:, self.components].max(axis=1)


def joint_rows(problem: OptimalControlProblem) -> list[JointRow]:
    """Return the stage rows on several components; a row and its negative are one row with two bounds."""
    rows, T, names = list[JointRow](), problem.horizon, [*problem.control_names, *problem.state_names]
    for family in problem.stage_rows:
        if isinstance(family, PathConstraint):
            words, none, limits = (
                f"component {{}} of {family.rows}" if family.rows > 1 else "",
                np.full(T, -np.inf),
                family.limits(),
            )
            rows += [JointRow(words.format(i), "", family, i, none, limits[:T, i]) for i in range(family.rows)]
            continue
        matrices = [np.broadcast_to(part, (T, *part.shape[-2:])) for part in (family.D, family.C)]
        weights, upper = np.concatenate(matrices, axis=2), np.broadcast_to(family.e, (T, family.rows))
        pending = [i for i in range(family.rows) if (np.count_nonzero(weights[:, i], axis=1) > 1).any()]
        while pending:
            i = pending.pop(0)
            opposite = [k for k in pending if np.array_equal(weights[:, k], -weights[:, i])]
            pending = [k for k in pending if k not in opposite]
            lower = np.max([np.full(T, -np.inf), *(-upper[:, k] for k in opposite)], axis=0)
            components = [names[k] for k in np.flatnonzero(weights[:, i].any(axis=0))]
            units = {split_unit(name)[1] for name in components}
            words = combination(weights[0, i], names)
            if (weights[:, i] != weights[0, i]).any():
                words = f"row {i + 1}, of {', '.join(map(short_name, components))}"
            rows.append(JointRow(words, units.pop() if len(units) == 1 else "", family, i, lower, upper[:, i]))
    return rows


def view(mains: Sequence[Array], overlays: Sequence[Array], bounds: Array, references: Sequence[Array] = ()) -> View:
    """Return a range with all mains and references, and with the overlays and bounds that are near."""
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
