"""The trajectories of a comparison, and their measures: violations, peaks and modes, all per component.

Each control, state and constrained output of a problem is one signal, with its bounds, its references, and the limits
on its spectrum.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.errors import NumericalError
from lin_freq_ocp.base.phrases import split_unit
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.hybrid.smooth import judged_modes
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE, PEAK_TOLERANCE, SCALE_FLOOR
from lin_freq_ocp.problem import measures
from lin_freq_ocp.problem.hybrid.affine_mode import FACET_TOLERANCE
from lin_freq_ocp.problem.measures import Measures, measure, stopband_peak
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.base import OutputSpectrum, entries_of
from lin_freq_ocp.problem.terms.maps import OutputMap
from lin_freq_ocp.problem.terms.quantity import IN_DECIBELS, Quantity, Reading
from lin_freq_ocp.problem.terms.semi_infinite import MagnitudeMask, peaks_above
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.transform.simulation import simulate
from lin_freq_ocp.transform.sizes import stated_sizes

REACHED = 1e-6  # of a limit: a spectrum that comes nearer reaches it

CLASSICAL, CONSTRAINED = "classical", "constrained"
NO_MODE = -1  # in a mode sequence: the trajectory is in no region
SAME_PEAK = 1e-2  # peaks that differ by less than this fraction count as equal

# The measures that depend on the states.
OF_STATES = (
    *("cost", "state_violation", "stage_violation", "terminal_error", "terminal_errors"),
    *("state_stopband_energy", "state_stopband_peak"),
)


@dataclass(frozen=True, eq=False)
class Line:
    """Values, (points,), over times in steps or frequencies in rad/sample; not a number where there are none."""

    at: Array
    values: Array
    soft: bool = False  # a bound that may be violated at a price


@dataclass(frozen=True)
class SpectrumAxis:
    """The unit in which a spectrum is drawn: that of its limits if all are stated in one, else sums of samples."""

    quantity: Quantity
    name: str  # of the signal as it is drawn, with its unit
    at_ends: float = 1.0  # sums of samples of one unit of a level at bins 0 and N/2
    inner: float = 1.0  # the same at all others

    def of_sums(self, w: Array, sums: Array) -> Array:
        """Return sums of samples at frequencies in rad/sample in the unit of the axis."""
        ends = (w == 0) | np.isclose(w, np.pi, rtol=1e-12)
        return self.of_levels(sums / np.where(ends, self.at_ends, self.inner))

    def of_levels(self, levels: Array) -> Array:
        """Return levels in the unit of the axis; decibels are drawn on a logarithmic axis, by their levels."""
        return levels if self.in_decibels else self.quantity.stated(levels)

    @property
    def in_decibels(self) -> bool:
        """Whether the axis shows decibels."""
        return self.quantity.keyword in IN_DECIBELS

    @property
    def label(self) -> str:
        """Return the label of the axis."""
        (short, own), quantity = split_unit(self.name), self.quantity
        words, unit = f"{quantity.kind.words} of {short}", quantity.unit(own)
        if quantity.keyword == "limit":
            words, unit = f"|DFT of {short}|", own
        return f"{words} [{unit}]" if unit else words


@dataclass(frozen=True, eq=False)
class ProblemSignal:
    """One control or state of a problem."""

    problem: OptimalControlProblem
    index: int
    is_state: bool

    @property
    def name(self) -> str:
        """Return its name with its unit."""
        return (self.problem.state_names if self.is_state else self.problem.control_names)[self.index]

    @property
    def samples(self) -> int:
        """Return the number N of samples in its spectrum, from time 0 on."""
        return self.problem.state_samples if self.is_state else self.problem.horizon

    @property
    def stop(self) -> Mask:
        """Return its stopped or bounded bins, (N//2 + 1,)."""
        return (self.problem.state_band if self.is_state else self.problem.control_band)[:, self.index]

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Return its lower and upper bounds over time, without the ends."""
        box = self.problem.state_boxes if self.is_state else self.problem.control_tube
        return box.lower[:, self.index], box.upper[:, self.index]

    @property
    def references(self) -> list[Line]:
        """Return the references in the cost that are not all zero, at the times at which they have a weight."""
        length = self.problem.horizon + self.is_state
        lines = list[Line]()
        for reference, weighed in self._weighed_references():
            if reference.any() and weighed.any():
                values = (reference if reference.ndim == 0 else reference[..., self.index]) * np.ones(length)
                values = np.where(weighed, values, np.nan)
                if not any(np.array_equal(values, line.values, equal_nan=True) for line in lines):
                    lines.append(Line(np.arange(length, dtype=np.float64), values))
        return lines

    def _weighed_references(self) -> Iterator[tuple[Array, Mask]]:
        """Yield references, (), (components,) or one per time, and at which times the deviation has a weight."""
        problem, cost, index = self.problem, self.problem.quadratic, self.index
        own, across = (cost.Q, cost.S[..., index, :]) if self.is_state else (cost.R, cost.S[..., :, index])
        weights = np.abs(own[..., index, :]).sum(-1) + np.abs(across).sum(-1)
        end = [bool(cost.P[index].any())] if self.is_state else []
        reference = cost.x_ref if self.is_state else cost.u_ref
        yield reference, np.append(np.broadcast_to(weights > 0, problem.horizon), end).astype(bool)
        for norm in problem.cost.norms:
            weighed_reference = norm.references(self.index, self.is_state, problem.horizon)
            if weighed_reference is not None:
                yield weighed_reference

    @property
    def row_bounds(self) -> list[Line]:
        """Return the limits of rows on this signal alone: of polyhedra, soft boxes, stage rows; not costs of levels."""
        controls = entries_of(self.problem.control_set)
        left_out = "controls" if any(len(part.levels_of(self.problem.control_dim)) for part in controls) else None
        n, column = self.problem.state_dim, self.index if self.is_state else self.problem.state_dim + self.index
        terms = [term for term in self.problem.terms if term.penalty.polyhedral and not term.kind.is_cost]
        terms = [term for term in terms if term.kind.of != left_out]
        return [line for term in terms for line in _row_limits(term, n, self.problem.control_dim, column)]

    @property
    def axis(self) -> SpectrumAxis:
        """Return the unit in which its spectrum is drawn."""
        own = [term for term in self.problem.terms if term.kind.of == self.kind and term.kind.is_spectrum]
        stated = {term.statement.quantity for term in own if term.statement and term.statement.signal == self.name}
        quantity = stated.pop() if len(stated) == 1 else Quantity("limit")
        if quantity.keyword == "energy" or quantity.of_fundamental:
            quantity = Quantity("limit" if quantity.is_sum else "amplitude")
        at_ends, inner = quantity.sums(self.window, self.problem.sampling_time, self.name)
        between = any(term.semi_infinite is not None for term in own)
        window = "" if (self.window == 1).all() else "windowed "
        return SpectrumAxis(quantity, window + self.name, inner if between else at_ends, inner)

    @cached_property
    def window(self) -> Array:
        """The window of the drawn spectrum, (N,): that of its limits if they share one and no bin is zero; or ones."""
        stop = self.problem.state_stop if self.is_state else self.problem.control_stop
        own = [spectrum.window for term, spectrum in self._spectra if term.kind.of == self.kind]
        shared = own and all(np.array_equal(window, own[0]) for window in own)
        free = self.kind == "outputs" or not stop[:, self.index].any()
        return own[0] if shared and free else np.ones(self.samples)

    def drawn_samples(self, trajectory: Trajectory) -> Array:
        """Return the samples of its drawn spectrum, (N,)."""
        return self.window * self.of(trajectory)[: self.samples]

    def stopband_peak(self, trajectory: Trajectory) -> float | None:
        """Return the largest magnitude of its drawn spectrum, zero-padded, within the stopped bins."""
        return stopband_peak(self.drawn_samples(trajectory)[:, None], self.stop[:, None])

    @property
    def levels(self) -> list[Line]:
        """Return the limits on the magnitude of its spectrum, in the unit of its axis."""
        lines = list[Line]()
        for term, spectrum in self._spectra:
            as_drawn = np.array_equal(spectrum.window, self.window)  # only then are limit and spectrum comparable
            if term.kind.of != self.kind or not len(spectrum.frequencies) or not as_drawn:
                continue
            match term.semi_infinite:
                case MagnitudeMask(limits=mask):
                    for low, high, *ends in zip(mask.low, mask.high, mask.at_low, mask.at_high, strict=True):
                        lines.append(Line(np.array([low, high]), self._on_axis(term, np.array(ends))))
                case _:
                    w, levels = spectrum.frequencies, self._on_axis(term, term.penalty.bounds(term.shape)[1][:, 0])
                    farthest = 1.5 * min(2 * np.pi / self.samples, np.diff(w).min(initial=np.inf))  # of neighbours
                    cuts = np.flatnonzero(np.diff(w) > farthest) + 1
                    runs = zip(np.split(w, cuts), np.split(levels, cuts), strict=True)
                    lines += [Line(*run, not term.hard) for run in runs]
        return lines

    @property
    def _spectra(self) -> list[tuple[Term, OutputMap]]:
        """Return the terms on its spectrum, each with the map."""
        pairs = ((term, term.map.spectrum) for term in self.problem.terms)
        return [(term, spectrum) for term, spectrum in pairs if spectrum is not None and spectrum.is_of(*self._rows)]

    def _on_axis(self, term: Term, sums: Array) -> Array:
        """Return limits of a term, in sums of samples, in the unit of the axis."""
        axis, stated = self.axis, term.statement
        return axis.of_levels(sums / (term.per_limit if stated and stated.quantity == axis.quantity else axis.inner))

    @property
    def limited_beyond_bins(self) -> bool:
        """Whether it has a limit at other frequencies than bins: on its held spectrum, or on a residual vibration."""
        masks = [term.semi_infinite for term in self.problem.terms if term.kind.of == self.kind]
        return any(mask is not None and mask.map.scaled and mask.map.component == self.index for mask in masks)

    @property
    def kind(self) -> str:
        """Return its kind: "states", "controls" or "outputs"."""
        return "states" if self.is_state else "controls"

    def touching(self, trajectory: Trajectory) -> Line:
        """Return where its spectrum reaches the limit of a mask at every frequency, and the limits there."""
        w, levels = list[Array](), list[Array]()
        for term, spectrum in self._spectra:
            if term.semi_infinite is not None and np.array_equal(spectrum.window, self.window):
                peaks, ratios = peaks_above(term.semi_infinite, trajectory.x, trajectory.u, 1.0 - REACHED)
                w.append(peaks[ratios < 1.0 + REACHED])
                levels.append(self._on_axis(term, term.semi_infinite.limit_at(w[-1])))
        return Line(np.concatenate([np.zeros(0), *w]), np.concatenate([np.zeros(0), *levels]))

    @property
    def _rows(self) -> tuple[Array | None, Array | None]:
        row = np.eye(self.problem.state_dim if self.is_state else self.problem.control_dim)[self.index]
        return (row, None) if self.is_state else (None, row)

    def of(self, trajectory: Trajectory) -> Array:
        """Return its values over time."""
        return (trajectory.x if self.is_state else trajectory.u)[:, self.index]


def _row_limits(term: Term, n: int, m: int, column: int) -> Iterator[Line]:
    """Yield the limits of the rows on one column of (x_t, u_t) alone."""
    form = term.map.stage_form(n, m)
    if form is None:
        return
    alone = (np.count_nonzero(form[0], axis=-1) == 1) & (form[0][..., column] != 0)
    slopes = np.broadcast_to(np.where(alone, form[0][..., column], 0.0), term.shape)
    distance = term.penalty.bounds(term.shape)[1] - form[1]
    distance = np.where(np.isfinite(distance), distance, np.nan)
    for row in map(int, np.flatnonzero(slopes.any(axis=0))):
        used = slopes[:, row] != 0
        values = np.divide(distance[:, row], slopes[:, row], out=np.full(len(slopes), np.nan), where=used)
        if np.isfinite(values).any():
            yield Line(term.map.positions.astype(np.float64), values, not term.hard)


@dataclass(frozen=True, eq=False)
class Output(ProblemSignal):
    """Output ``index`` of y = C x + D u, whose spectrum is constrained; it has no bounds over time."""

    outputs: OutputSpectrum

    @property
    def name(self) -> str:
        """Return its name with its unit."""
        return self.outputs.output_names[self.index]

    @property
    def samples(self) -> int:
        """Return the number N of samples in its spectrum, from time 0 on."""
        return self.problem.horizon + (self.outputs.D is None)

    @property
    def stop(self) -> Mask:
        """Return its stopped or bounded bins, (N//2 + 1,)."""
        stop = np.zeros(self.samples // 2 + 1, dtype=bool)
        for term, spectrum in self._spectra:
            if term.kind.of == self.kind:
                stop[spectrum.nearest_bins] = True
        return stop

    @property
    def references(self) -> list[Line]:
        """Return no line: an output has no reference."""
        return []

    @property
    def row_bounds(self) -> list[Line]:
        """Return no line: an output has no bounds over time."""
        return []

    @property
    def kind(self) -> str:
        """Return "outputs"."""
        return "outputs"

    def of(self, trajectory: Trajectory) -> Array:
        """Return its values over time."""
        return self.outputs.values(trajectory.x, trajectory.u)[:, self.index]

    @property
    def _rows(self) -> tuple[Array | None, Array | None]:
        C, D = self.outputs.C, self.outputs.D
        return None if C is None else C[self.index], None if D is None else D[self.index]


def controls_of(problem: OptimalControlProblem) -> list[ProblemSignal]:
    """Return all controls."""
    return [ProblemSignal(problem, j, is_state=False) for j in range(problem.control_dim)]


def states_of(problem: OptimalControlProblem) -> list[ProblemSignal]:
    """Return all states."""
    return [ProblemSignal(problem, i, is_state=True) for i in range(problem.state_dim)]


def outputs_of(problem: OptimalControlProblem) -> list[ProblemSignal]:
    """Return the outputs whose spectrum is constrained."""
    families = entries_of(problem.output_spectrum)
    outputs = [Output(problem, i, True, family) for family in families for i in range(len(family.output_names))]
    return [output for output in outputs if output.stop.any()]


@dataclass(frozen=True, eq=False)
class Violation:
    """By how much a signal violates its bounds, per component; arrays (components,)."""

    values: Array  # largest violation over time
    allowed: Array  # violation that the certificate accepts
    bounded: Mask  # which components have a bound, other than one in ``limited_spectra``

    @property
    def passed(self) -> Mask:
        """Return where the bounds hold, (components,)."""
        return self.values <= self.allowed


@dataclass(frozen=True, eq=False)
class MeasuredTrajectory:
    """A solution, or the simulated trajectory of a filtered control, with its measures."""

    label: str  # "classical", the name of a filter, or "constrained"
    problem: OptimalControlProblem
    trajectory: Trajectory  # without a meaningful simulation: the planned states with the filtered control
    planned: Trajectory | None = None  # of a filtered control: the trajectory before filtering
    meaningful: bool = True  # false if a simulation would only show amplified rounding errors, or ended early
    stopped: str = ""  # why the simulation ended early: the state left the regions of all modes
    sequence: Indices | None = None  # the mode sequence that was solved for, (T,)

    @cached_property
    def measures(self) -> Measures:
        """Return the measures; without a meaningful replay, everything that depends on the states is None."""
        measured = measure(self.problem, self.trajectory)
        return measured if self.meaningful else replace(measured, **dict.fromkeys(OF_STATES))

    @cached_property
    def controls(self) -> Violation:
        """Return the violation of the control bounds."""
        return _box_violation(self.trajectory.u, self.problem.control_tube, self._least[1])

    @cached_property
    def states(self) -> Violation | None:
        """Return the violation of the state bounds, without the ends."""
        if not self.meaningful:
            return None
        return _box_violation(self.trajectory.x, self.problem.state_boxes, self._least[0])

    @cached_property
    def end(self) -> Violation | None:
        """Return the distance of x_T from the terminal set."""
        if not self.meaningful:
            return None
        terminal = self.problem.terminal_box
        bounded = np.isfinite(terminal.lower) | np.isfinite(terminal.upper)
        scale = np.maximum(np.abs(self.trajectory.x).max(0), self._least[0])
        return Violation(terminal.violation(self.trajectory.x[-1]), CONDITION_TOLERANCE * scale, bounded)

    @cached_property
    def terms(self) -> Violation | None:
        """Return the violation of each hard term (rows, sets, masks), at its worst entry."""
        if not self.meaningful:
            return None
        hard = [term for term in self.problem.terms if term.hard]
        pairs = [_term_violation(term, self.trajectory, *self._least) for term in hard]
        values, allowed = np.array(pairs).reshape(-1, 2).T
        return Violation(values, allowed, np.array([term.statement is None for term in hard], dtype=bool))

    @cached_property
    def limited_spectra(self) -> Mapping[str, tuple[Reading, bool | None]]:
        """Return the values of limited spectra by their labels, and whether they are within their limits if hard."""
        plan, found = self.trajectory, dict[str, tuple[Reading, bool | None]]()
        for term in self.problem.terms if self.meaningful else ():
            for reading in term.readings(plan.x, plan.u):
                violation, allowed = _term_violation(term, plan, *self._least)
                passed = violation <= allowed or reading.ratio <= 1.0 if term.hard else None
                label = reading.label if reading.label not in found else f"{reading.label} ({term.name})"
                found[label] = reading, passed
        return found

    @property
    def between_levels(self) -> bool:
        """Whether its controls are not all at levels, where the modes of the problem are levels."""
        sets = entries_of(self.problem.control_set) if self.problem.mode_names else ()
        return any(
            bool((np.abs(u[:, None] - levels).min(axis=1) > CONDITION_TOLERANCE * np.abs(levels).max()).any())
            for controls in sets
            for u, levels in zip(self.trajectory.u.T, controls.levels_of(self.problem.control_dim), strict=False)
            if len(levels)
        )

    @property
    def why_stopped(self) -> str:
        """Return why a replay ended early, as the rest of a sentence that begins with "its" or "the"."""
        return "controls lie between the levels" if self.between_levels else "states leave the regions of all modes"

    @cached_property
    def one_step_residual(self) -> Array:
        """Return the largest |x_{t+1} - f_t(x_t, u_t)| over time, (n,), of the planned states."""
        states = self.trajectory if self.planned is None else self.planned
        return np.abs(measures.one_step_residual(self.problem, Trajectory(states.x, self.trajectory.u))).max(0)

    @cached_property
    def modes(self) -> Indices | None:
        """Return the mode at every time, (T,), NO_MODE outside all regions; None without replay or with one mode."""
        if not self.meaningful or len(self.problem.mode_names) < 2:
            return None
        return mode_sequence(self.problem, self.trajectory) if self.sequence is None else self.sequence

    def largest(self, signal: ProblemSignal) -> float:
        """Return the largest magnitude of a signal over time."""
        return float(np.abs(signal.of(self.trajectory)).max())

    def peak_times(self, signal: ProblemSignal) -> list[int]:
        """Return the times at which the magnitude of a signal is the largest, up to SAME_PEAK."""
        size = np.abs(signal.of(self.trajectory))
        return [int(t) for t in np.flatnonzero(size >= (1 - SAME_PEAK) * size.max())]

    def empties_band(self, of_states: bool) -> bool | None:
        """Return whether the stopped bins of the states, or controls, are zero; None where there are none."""
        stop = self.problem.state_stop if of_states else self.problem.control_stop
        if not stop.any() or (of_states and not self.meaningful):
            return None
        signal = self.trajectory.x[: self.problem.state_samples] if of_states else self.trajectory.u
        scale = np.maximum(np.linalg.norm(signal, axis=0), self._least[0 if of_states else 1])
        magnitude = np.where(stop, np.abs(np.fft.rfft(signal, axis=0)), 0.0)
        return bool((magnitude <= CONDITION_TOLERANCE * scale).all())

    @cached_property
    def _least(self) -> tuple[Array, Array]:
        """Return the least scales of states and controls, as in conditions S-x and S-u of the certificate."""
        x, u = stated_sizes(self.problem)
        return SCALE_FLOOR * x, SCALE_FLOOR * u


def _box_violation(signal: Array, box: Box, least: Array) -> Violation:
    finite = [np.where(np.isfinite(bound), np.abs(bound), 0.0).max(0) for bound in (box.lower, box.upper)]
    scale = np.maximum(np.maximum(np.abs(signal).max(0), least), np.maximum(*finite))
    bounded = np.asarray((np.isfinite(box.lower) | np.isfinite(box.upper)).any(0))
    return Violation(box.violation(signal).max(0), CONDITION_TOLERANCE * scale, bounded)


def _term_violation(term: Term, trajectory: Trajectory, least_x: Array, least_u: Array) -> tuple[float, float]:
    """Return the violation of the entry that is worst relative to its scale, and the violation that is accepted."""
    x, u = trajectory.x, trajectory.u
    if term.semi_infinite is not None:
        w, ratios = peaks_above(term.semi_infinite, x, u, 1.0)
        if not len(w):
            return 0.0, 0.0
        limits, worst = term.semi_infinite.limit_at(w), int(np.argmax(ratios))
        return float((ratios[worst] - 1) * limits[worst]), float(PEAK_TOLERANCE * limits[worst])
    least = term.map.sizes(np.tile(least_x, (len(x), 1)), np.tile(least_u, (len(u), 1))).max(0)
    violation, scale = term.violation(x, u).max(0), np.maximum(term.map.sizes(x, u).max(0), least)
    scale = scale if len(violation) == len(scale) else scale.max(keepdims=True)
    worst = int(np.argmax(violation - CONDITION_TOLERANCE * scale))
    return float(violation[worst]), float(CONDITION_TOLERANCE * scale[worst])


def replay_control(label: str, problem: OptimalControlProblem, u: Array, planned: Trajectory) -> MeasuredTrajectory:
    """Simulate u, (T, m), from the first planned state, unless that only shows amplified rounding errors."""
    stopped = ""
    growth = measures.growth_along(problem, planned)
    follows = problem.response is not None  # x_0 also follows from the controls
    if measures.replay_is_meaningful(growth):
        try:
            return MeasuredTrajectory(label, problem, simulate(problem, u, None if follows else planned.x[0]), planned)
        except NumericalError as error:
            if not problem.mode_names:
                raise
            stopped = str(error)
    return MeasuredTrajectory(label, problem, Trajectory(planned.x, u), planned, meaningful=False, stopped=stopped)


def measured_solution(label: str, problem: OptimalControlProblem, result: Outcome) -> MeasuredTrajectory | None:
    """Return the trajectory of a solution, if it has one, measured on a problem with the same dynamics."""
    if result.trajectory is None:
        return None
    return MeasuredTrajectory(label, problem, result.trajectory, sequence=result.sequence)


def solution_label(result: Outcome) -> str:
    """Return the label of a solution that is shown alone."""
    return result.status.replace("_", " ") if Status(result.status).solved else "best point"


def mode_sequence(problem: OptimalControlProblem, trajectory: Trajectory) -> Indices:
    """Return the mode at every time, (T,), of dynamics with modes; NO_MODE outside all regions."""
    _, _, at, arrays = judged_modes(problem, trajectory)
    x, u = at.x, at.u
    outside = arrays.distance(x, u).min(axis=1) > FACET_TOLERANCE
    return np.where(outside, NO_MODE, arrays.sequence(x, u))
