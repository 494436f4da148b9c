"""What the panels of a figure share: the problem, the trajectories, the units, and how far the axes reach."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lin_freq_ocp.analysis.measures import amplification
from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.phrases import listed
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.outputs import OutputSpectrum
from lin_freq_ocp.problem.terms.term import TermKind
from lin_freq_ocp.report.entries import state_bounds
from lin_freq_ocp.report.figures.marks import Line, bounds_of_rows, mask_levels, references
from lin_freq_ocp.report.figures.scales import Scale, frequency_scale, time_scale
from lin_freq_ocp.report.figures.style import Note, Trace
from lin_freq_ocp.report.modes.spans import STOPPED, Span, spans
from lin_freq_ocp.report.numbers import quantity, rough

GUEST_REACH = 0.6
"""A filtered trajectory may widen an axis by this fraction of what the others span; beyond, it leaves the picture."""

BOUND_REACH = 0.6
"""Likewise for a bound that nothing comes near."""

MARGIN = 0.06
"""Empty fraction at either side of an axis."""


@dataclass(frozen=True)
class View:
    """The range of an axis, and whether a guest leaves it."""

    low: float
    high: float
    outside: bool


@dataclass(frozen=True, eq=False)
class Component:
    """One control or state of a problem."""

    problem: OptimalControlProblem
    index: int
    is_state: bool

    @property
    def name(self) -> str:
        """Return its name with its unit."""
        return (self.problem.state_names if self.is_state else self.problem.control_names)[self.index]

    @property
    def stop(self) -> Mask:
        """Return its stopped bins, (N//2 + 1,)."""
        return (self.problem.state_band if self.is_state else self.problem.control_band)[:, self.index]

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Return its lower and upper bounds over time, the ends apart."""
        box = state_bounds(self.problem) if self.is_state else self.problem.control_tube
        return box.lower[:, self.index], box.upper[:, self.index]

    @property
    def references(self) -> list[Line]:
        """Return what the cost draws it to, over time."""
        return references(self.problem, self.index, self.is_state)

    @property
    def row_bounds(self) -> list[Line]:
        """Return its bounds that stand in rows and soft sets, over time."""
        return bounds_of_rows(self.problem, self.index, self.is_state)

    @property
    def levels(self) -> list[Line]:
        """Return the limits on the magnitude of its spectrum, over frequencies in rad/sample."""
        row = np.eye(self.problem.state_dim if self.is_state else self.problem.control_dim)[self.index]
        if self.is_state:
            return mask_levels(self.problem, TermKind.STATE_SPECTRUM, row)
        return mask_levels(self.problem, TermKind.CONTROL_SPECTRUM, None, row)

    def of(self, trace: Trace) -> Array:
        """Return its values over time."""
        return (trace.trajectory.x if self.is_state else trace.trajectory.u)[:, self.index]


@dataclass(frozen=True, eq=False)
class Output(Component):
    """One output y = C x + D u that a frequency constraint is about: ``index`` of them that are."""

    outputs: OutputSpectrum
    row: int

    @property
    def name(self) -> str:
        """Return its name with its unit."""
        return self.outputs.output_names[self.row]

    @property
    def stop(self) -> Mask:
        """Return its stopped or bounded bins, (N//2 + 1,)."""
        length = self.problem.horizon + (self.outputs.D is None)
        stop = np.zeros(length // 2 + 1, dtype=bool)
        for term in self.problem.terms:
            if term.kind == TermKind.OUTPUT_SPECTRUM and term.map.spectrum_of(*self._rows):
                stop[term.map.nearest_bins] = True
        return stop

    @property
    def references(self) -> list[Line]:
        """Return nothing: no cost is about an output."""
        return []

    @property
    def row_bounds(self) -> list[Line]:
        """Return nothing: outputs have no bounds over time."""
        return []

    @property
    def levels(self) -> list[Line]:
        """Return the limits on the magnitude of its spectrum, over frequencies in rad/sample."""
        return mask_levels(self.problem, TermKind.OUTPUT_SPECTRUM, *self._rows)

    def of(self, trace: Trace) -> Array:
        """Return its values over time."""
        C, D = self._rows
        x, u = trace.trajectory.x, trace.trajectory.u
        parts = ([] if C is None else [x[: len(x) if D is None else len(u)] @ C]) + ([] if D is None else [u @ D])
        return sum(parts, np.zeros(len(parts[0])))

    @property
    def _rows(self) -> tuple[Array | None, Array | None]:
        C, D = self.outputs.C, self.outputs.D
        return None if C is None else C[self.row], None if D is None else D[self.row]


@dataclass(frozen=True, eq=False)
class Scene:
    """A problem and the trajectories to show, at least one of them not a guest."""

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

    @cached_property
    def state_bounds(self) -> Box:
        """Return the state set of each time, without the ends."""
        return state_bounds(self.problem)

    @property
    def host(self) -> Trace:
        """Return the trajectory that the picture is about: the last that is no guest."""
        return [trace for trace in self.traces if not trace.guest][-1]

    def of_host(self) -> Scene:
        """Return the scene of the host alone."""
        return Scene(self.problem, (self.host,))

    @cached_property
    def modes(self) -> tuple[Span, ...]:
        """Return the modes of the host; nothing where there are not at least two."""
        return () if self.host.sequence is None else spans(self.host.sequence)

    def control(self, j: int) -> Component:
        """Return control j."""
        return Component(self.problem, j, is_state=False)

    def state(self, i: int) -> Component:
        """Return state i."""
        return Component(self.problem, i, is_state=True)

    def components(self) -> list[Component]:
        """Return all controls, states and constrained outputs."""
        controls = [self.control(j) for j in range(self.problem.control_dim)]
        return [*controls, *(self.state(i) for i in range(self.problem.state_dim)), *self.outputs()]

    def outputs(self) -> list[Output]:
        """Return the outputs whose spectrum is constrained."""
        given = self.problem.output_spectrum
        families = () if given is None else given if isinstance(given, (list, tuple)) else (given,)
        return [
            output
            for family in families
            for i in range(len(family.output_names))
            if (output := Output(self.problem, i, True, family, i)).stop.any()
        ]

    def showing(self, component: Component) -> tuple[Trace, ...]:
        """Return the traces whose values of this component mean anything."""
        return tuple(trace for trace in self.traces if trace.states_shown or not component.is_state)

    def view(self, component: Component) -> View:
        """Return the range of a component's axis."""
        shown = self.showing(component)
        return view(
            [component.of(trace) for trace in shown if not trace.guest],
            [component.of(trace) for trace in shown if trace.guest],
            np.concatenate([*component.bounds, *(line.values for line in component.row_bounds)]),
            [line.values[np.isfinite(line.values)] for line in component.references],
        )

    def notes(self, components: Sequence[Component]) -> list[Note]:
        """Say which trajectories are missing from a panel of these states, and which leave it."""
        outside = any(self.view(component).outside for component in components)
        notes = list[Note]()
        for trace in self.traces:
            words = ""
            if trace.stopped:
                words = f"not replayed; its states {STOPPED}"
            elif not trace.states_shown:
                growth = amplification(self.problem.dynamics_along(trace.trajectory), self.problem.horizon)
                words = f"not replayed; rounding errors would grow {rough(growth)}-fold"
            elif trace.guest and outside:
                words = f"leaves the picture; {_end_of(trace, components)}"
            if words:
                notes.append(Note(f"{trace.label}: {words}", trace.style.color))
        return notes


def view(hosts: Sequence[Array], guests: Sequence[Array], bounds: Array, references: Sequence[Array] = ()) -> View:
    """Return a range that shows all hosts and references, and guests and bounds as far as they are near."""
    hosts = [*hosts, *references]
    low, high = min(float(host.min()) for host in hosts), max(float(host.max()) for host in hosts)
    span = high - low or max(abs(high), 1.0)
    reach = BOUND_REACH * span
    near = [float(b) for b in np.unique(bounds[np.isfinite(bounds)]) if low - reach <= b <= high + reach]
    low, high = min([low, *near]), max([high, *near])
    slack, outside = GUEST_REACH * span, False
    for guest in guests:
        if guest.min() < low - slack or guest.max() > high + slack:
            outside = True
        else:
            low, high = min(low, float(guest.min())), max(high, float(guest.max()))
    margin = MARGIN * (high - low or span)
    return View(low - margin, high + margin, outside)


def _end_of(trace: Trace, components: Sequence[Component]) -> str:
    """Say how far from the terminal set a trajectory ends, or how far it goes where the end is free."""
    problem = components[0].problem
    terminal, missed = problem.terminal_box, problem.terminal_box.violation(trace.trajectory.x[-1])
    away = [
        quantity(float(missed[one.index]), one.name)
        for one in components
        if np.isfinite(terminal.lower[one.index]) or np.isfinite(terminal.upper[one.index])
    ]
    if away:
        return f"ends {listed(away)} away"
    return f"goes as far as {listed([quantity(float(np.abs(one.of(trace)).max()), one.name) for one in components])}"
