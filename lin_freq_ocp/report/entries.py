"""The trajectories of a comparison side by side, and by how much each breaks what, per component."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.analysis.measures import Measures, one_step_residual, stated_sizes
from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.certificate.conditions import CONDITION_TOLERANCE, SCALE_FLOOR
from lin_freq_ocp.comparison.compare import ComparisonOutcome, Filtered
from lin_freq_ocp.comparison.filters import filter_stop
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box, stacked
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.outcome import Outcome

CLASSICAL, CONSTRAINED = "classical", "constrained"
PREFERRED_FILTER = "brickwall"


@dataclass(frozen=True, eq=False)
class Excess:
    """By how much a signal breaks its bounds, per component, and how much of that is rounding.

    Attributes
    ----------
    values, allowed : (components,)
        Largest distance outside over time, and what the certificate lets pass.
    bounded : (components,)
        Where there is any bound to break.
    """

    values: Array
    allowed: Array
    bounded: Mask

    @property
    def passed(self) -> Mask:
        """Return where the bounds hold, (components,)."""
        return self.values <= self.allowed


@dataclass(frozen=True, eq=False)
class Entry:
    """One trajectory of a comparison.

    Attributes
    ----------
    label : str
        "classical", the name of a filter, or "constrained".
    trajectory, measures : or None
        None if there is none.
    replayed : bool
        Whether its states mean anything.
    """

    label: str
    problem: OptimalControlProblem
    trajectory: Trajectory | None
    measures: Measures | None
    replayed: bool = True

    @property
    def controls(self) -> Excess | None:
        """Return how far the controls leave their bounds."""
        if self.trajectory is None:
            return None
        return _excess(self.trajectory.u, self.problem.control_tube, self._least[1])

    @property
    def states(self) -> Excess | None:
        """Return how far the states leave their bounds, the ends apart."""
        if self.trajectory is None or not self.replayed:
            return None
        return _excess(self.trajectory.x, state_bounds(self.problem), self._least[0])

    @property
    def end(self) -> Excess | None:
        """Return how far x_T is from the terminal set."""
        if self.trajectory is None or not self.replayed:
            return None
        terminal = self.problem.terminal_box
        bounded = np.isfinite(terminal.lower) | np.isfinite(terminal.upper)
        scale = np.maximum(np.abs(self.trajectory.x).max(0), self._least[0])
        return Excess(terminal.violation(self.trajectory.x[-1]), CONDITION_TOLERANCE * scale, bounded)

    @property
    def rows(self) -> Excess | None:
        """Return how far joint rows, sets, masks and the like are violated, at the worst entry of each."""
        if self.trajectory is None or not self.replayed:
            return None
        found = [_excess_of_term(one, self.trajectory, *self._least) for one in self.problem.terms if one.hard]
        values, allowed = np.array(found).reshape(-1, 2).T
        return Excess(values, allowed, np.ones(len(found), dtype=bool))

    @property
    def one_step(self) -> Array | None:
        """Return the largest |x_{t+1} - f_t(x_t, u_t)| over time, (n,)."""
        return None if self.trajectory is None else np.abs(one_step_residual(self.problem, self.trajectory)).max(0)

    def leaves_band_empty(self, of_states: bool) -> bool | None:
        """Return whether the stopped bins of the states, or controls, are zero; None where there are none."""
        stop = self.problem.state_stop if of_states else self.problem.control_stop
        if self.trajectory is None or not stop.any() or (of_states and not self.replayed):
            return None
        signal = self.trajectory.x if of_states else self.trajectory.u
        scale = np.maximum(np.linalg.norm(signal, axis=0), self._least[0 if of_states else 1])
        magnitude = np.where(stop, np.abs(np.fft.rfft(signal, axis=0)), 0.0)
        return bool((magnitude <= CONDITION_TOLERANCE * scale).all())

    @property
    def _least(self) -> tuple[Array, Array]:
        """Return the least scales of states and controls, as the certificate's S-x and S-u have them."""
        x, u = stated_sizes(self.problem)
        return SCALE_FLOOR * x, SCALE_FLOOR * u


def entries(comparison: ComparisonOutcome) -> tuple[Entry, ...]:
    """Return the classical trajectory, what every filter makes of it, and the constrained one, which is the last.

    Without any frequency constraint all of these are one trajectory, which is returned alone.
    """
    problem, result = comparison.problem, comparison.constrained
    if not has_frequency_constraint(problem):
        return (Entry(solution_label(result), problem, result.trajectory, comparison.constrained_measures),)
    filtered = comparison.filtered if can_be_filtered(problem) else ()
    return (
        Entry(CLASSICAL, problem, comparison.classical.trajectory, comparison.classical_measures),
        *(filtered_entry(problem, one) for one in filtered),
        Entry(CONSTRAINED, problem, result.trajectory, comparison.constrained_measures),
    )


def filtered_entry(problem: OptimalControlProblem, one: Filtered) -> Entry:
    """Return one filter's replay."""
    return Entry(one.name.replace("_", " "), problem, one.replay.trajectory, one.replay.measures, one.replay.meaningful)


def shown_filter(comparison: ComparisonOutcome, name: str | None = None) -> Filtered | None:
    """Return the filter of that name; by default the brick wall, or the first; None if there is nothing to filter.

    Raises
    ------
    ProblemError
        If the comparison has no filter of that name.
    """
    if not can_be_filtered(comparison.problem) or (name is None and not comparison.filtered):
        return None
    by_name = {one.name: one for one in comparison.filtered}
    if name is None:
        return by_name.get(PREFERRED_FILTER, comparison.filtered[0])
    if name not in by_name:
        raise ProblemError("filter_name", repr(name), f"one of {', '.join(by_name) or 'none: nothing was filtered'}")
    return by_name[name]


def has_frequency_constraint(problem: OptimalControlProblem) -> bool:
    """Whether anything is asked of the spectrum of a control, a state or an output."""
    stopped = bool(problem.control_stop.any() or problem.state_stop.any())
    return stopped or any(term.kind.is_spectrum for term in problem.terms)


def can_be_filtered(problem: OptimalControlProblem) -> bool:
    """Whether there is any bin that a filter of the controls could remove."""
    return bool(filter_stop(problem).any())


def solution_label(result: Outcome) -> str:
    """Return what the solution of a problem is called where it stands alone."""
    return {"optimal": "optimal", "locally_optimal": "locally optimal"}.get(result.status, "best point")


def state_bounds(problem: OptimalControlProblem) -> Box:
    """Return the state set of each time without the ends, bounds of shape (T+1, n)."""
    return stacked("state_set", problem.state_set, problem.state_dim, problem.horizon + 1)


def _excess_of_term(term: Term, trajectory: Trajectory, least_x: Array, least_u: Array) -> tuple[float, float]:
    """Return the largest violation of the entry that is worst for its size, and what the certificate lets pass."""
    x, u = trajectory.x, trajectory.u
    least = term.map.sizes(np.tile(least_x, (len(x), 1)), np.tile(least_u, (len(u), 1))).max(0)
    violation, scale = term.violation(x, u).max(0), np.maximum(term.map.sizes(x, u).max(0), least)
    scale = scale if len(violation) == len(scale) else scale.max(keepdims=True)
    worst = int(np.argmax(violation - CONDITION_TOLERANCE * scale))
    return float(violation[worst]), float(CONDITION_TOLERANCE * scale[worst])


def _excess(signal: Array, box: Box, least: Array) -> Excess:
    finite = [np.where(np.isfinite(bound), np.abs(bound), 0.0).max(0) for bound in (box.lower, box.upper)]
    scale = np.maximum(np.maximum(np.abs(signal).max(0), least), np.maximum(*finite))
    bounded = np.asarray((np.isfinite(box.lower) | np.isfinite(box.upper)).any(0))
    return Excess(box.violation(signal).max(0), CONDITION_TOLERANCE * scale, bounded)
