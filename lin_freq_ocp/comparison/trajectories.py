"""The trajectories of a comparison, and what is measured of each: violations, peaks, modes, all per component."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.errors import NumericalError
from lin_freq_ocp.certificate.sizes import measured_modes
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE, PEAK_TOLERANCE, SCALE_FLOOR
from lin_freq_ocp.comparison.signals import Signal, state_bounds
from lin_freq_ocp.problem import measures
from lin_freq_ocp.problem.hybrid.mode_arrays import FACET_TOLERANCE
from lin_freq_ocp.problem.measures import Measures, measure, stopband_peak
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.simulation import simulate
from lin_freq_ocp.problem.sizes import stated_sizes
from lin_freq_ocp.problem.spectrum.base import entries_of
from lin_freq_ocp.problem.terms.semi_infinite import peaks_above
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.outcome import Outcome

CLASSICAL, CONSTRAINED = "classical", "constrained"
NO_MODE = -1  # in a mode sequence: the trajectory is in no region
SAME_PEAK = 1e-2  # peaks that differ by less than this fraction count as equal

# The measures that depend on the states.
OF_STATES = (
    *("cost", "state_violation", "stage_violation", "terminal_error", "terminal_errors"),
    *("state_stopband_energy", "state_stopband_peak"),
)


@dataclass(frozen=True, eq=False)
class Violation:
    """By how much a signal violates its bounds, per component; arrays (components,)."""

    values: Array  # largest violation over time
    allowed: Array  # what the certificate accepts
    bounded: Mask  # which components have a bound

    @property
    def passed(self) -> Mask:
        """Return where the bounds hold, (components,)."""
        return self.values <= self.allowed


@dataclass(frozen=True, eq=False)
class MeasuredTrajectory:
    """A solution, or the replay of a filtered control, with what is measured of it."""

    label: str  # "classical", the name of a filter, or "constrained"
    problem: OptimalControlProblem
    trajectory: Trajectory  # without a meaningful replay: the planned states with the filtered control
    planned: Trajectory | None = None  # of a filtered control: the trajectory before filtering
    meaningful: bool = True  # false where a replay would only show amplified rounding errors, or ended early
    stopped: str = ""  # why the replay ended early, where the dynamics have modes and none holds any more
    sequence: Indices | None = None  # the mode sequence that was solved for, (T,)

    @cached_property
    def measures(self) -> Measures:
        """Return the measures; without a meaningful replay, everything that depends on the states is None."""
        measured = measure(self.problem, self.trajectory)
        return measured if self.meaningful else replace(measured, **dict.fromkeys(OF_STATES))

    @cached_property
    def controls(self) -> Violation:
        """Return the violation of the control bounds."""
        return _violation(self.trajectory.u, self.problem.control_tube, self._least[1])

    @cached_property
    def states(self) -> Violation | None:
        """Return the violation of the state bounds, without the ends."""
        if not self.meaningful:
            return None
        return _violation(self.trajectory.x, state_bounds(self.problem), self._least[0])

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
        found = [_violation_of_term(term, self.trajectory, *self._least) for term in self.problem.terms if term.hard]
        values, allowed = np.array(found).reshape(-1, 2).T
        return Violation(values, allowed, np.ones(len(found), dtype=bool))

    @property
    def between_levels(self) -> bool:
        """Whether its controls are not all at levels, where the modes of the problem are levels."""
        sets = entries_of(self.problem.control_set) if self.problem.dynamics.mode_names else ()
        return any(
            bool((np.abs(u[:, None] - levels).min(axis=1) > CONDITION_TOLERANCE * np.abs(levels).max()).any())
            for one in sets
            for u, levels in zip(self.trajectory.u.T, one.levels_of(self.problem.control_dim), strict=False)
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
        if not self.meaningful or len(self.problem.dynamics.mode_names) < 2:
            return None
        return mode_sequence(self.problem, self.trajectory) if self.sequence is None else self.sequence

    def largest(self, signal: Signal) -> float:
        """Return the largest magnitude of a signal over time."""
        return float(np.abs(signal.of(self.trajectory)).max())

    def peak_times(self, signal: Signal) -> list[int]:
        """Return the times at which the magnitude of a signal is the largest, up to SAME_PEAK."""
        size = np.abs(signal.of(self.trajectory))
        return [int(t) for t in np.flatnonzero(size >= (1 - SAME_PEAK) * size.max())]

    def stopband_peak(self, signal: Signal) -> float | None:
        """Return the largest magnitude of the zero-padded spectrum within the stopped bins of a signal."""
        return stopband_peak(signal.of(self.trajectory)[: signal.samples, None], signal.stop[:, None])

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


def replayed(label: str, problem: OptimalControlProblem, u: Array, planned: Trajectory) -> MeasuredTrajectory:
    """Replay u, shape (T, m), from the first state of the planned trajectory, where that means anything."""
    stopped = ""
    growth = measures.growth_along(problem, planned)
    follows = problem.dynamics.response(problem.horizon) is not None  # x_0, too, from the controls
    if measures.replay_is_meaningful(growth):
        try:
            return MeasuredTrajectory(label, problem, simulate(problem, u, None if follows else planned.x[0]), planned)
        except NumericalError as error:
            if not problem.dynamics.mode_names:
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
    return {"optimal": "optimal", "locally_optimal": "locally optimal"}.get(result.status, "best point")


def mode_sequence(problem: OptimalControlProblem, trajectory: Trajectory) -> Indices:
    """Return the mode at every time, (T,), of dynamics with modes; NO_MODE outside all regions."""
    arrays = measured_modes(problem.affine_at(trajectory), trajectory)
    x, u = trajectory.x, trajectory.u
    outside = arrays.distance(x, u).min(axis=1) > FACET_TOLERANCE
    return np.where(outside, NO_MODE, arrays.sequence(x, u))


def _violation_of_term(term: Term, trajectory: Trajectory, least_x: Array, least_u: Array) -> tuple[float, float]:
    """Return the violation of the entry that is worst relative to its scale, and what the certificate accepts."""
    x, u = trajectory.x, trajectory.u
    if term.everywhere is not None:
        w, ratios = peaks_above(term.everywhere, x, u, 1.0)
        if not len(w):
            return 0.0, 0.0
        limits, worst = term.everywhere.limit_at(w), int(np.argmax(ratios))
        return float((ratios[worst] - 1) * limits[worst]), float(PEAK_TOLERANCE * limits[worst])
    least = term.map.sizes(np.tile(least_x, (len(x), 1)), np.tile(least_u, (len(u), 1))).max(0)
    violation, scale = term.violation(x, u).max(0), np.maximum(term.map.sizes(x, u).max(0), least)
    scale = scale if len(violation) == len(scale) else scale.max(keepdims=True)
    worst = int(np.argmax(violation - CONDITION_TOLERANCE * scale))
    return float(violation[worst]), float(CONDITION_TOLERANCE * scale[worst])


def _violation(signal: Array, box: Box, least: Array) -> Violation:
    finite = [np.where(np.isfinite(bound), np.abs(bound), 0.0).max(0) for bound in (box.lower, box.upper)]
    scale = np.maximum(np.maximum(np.abs(signal).max(0), least), np.maximum(*finite))
    bounded = np.asarray((np.isfinite(box.lower) | np.isfinite(box.upper)).any(0))
    return Violation(box.violation(signal).max(0), CONDITION_TOLERANCE * scale, bounded)
