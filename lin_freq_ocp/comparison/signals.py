"""The controls, states and constrained outputs of a problem, each as one signal with its bounds and references."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.base import OutputSpectrum, entries_of
from lin_freq_ocp.problem.terms.semi_infinite import Frequencies, peaks_above
from lin_freq_ocp.problem.terms.term import Term, TermKind
from lin_freq_ocp.problem.trajectory import Trajectory

REACHED = 1e-6  # of a limit: a spectrum that comes nearer reaches it


@dataclass(frozen=True, eq=False)
class Line:
    """Values, (points,), over times in steps or frequencies in rad/sample; not a number where there are none."""

    at: Array
    values: Array
    soft: bool = False  # a bound that may be violated at a price


@dataclass(frozen=True, eq=False)
class Signal:
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
        box = state_bounds(self.problem) if self.is_state else self.problem.control_tube
        return box.lower[:, self.index], box.upper[:, self.index]

    @property
    def references(self) -> list[Line]:
        """Return the references that a cost weighs its deviation from; none where all are zero."""
        length = self.problem.horizon + self.is_state
        found = list[Line]()
        for reference, weighed in self._weighed_references():
            if reference.any() and weighed.any():
                values = (reference if reference.ndim == 0 else reference[..., self.index]) * np.ones(length)
                values = np.where(weighed, values, np.nan)
                if not any(np.array_equal(values, other.values, equal_nan=True) for other in found):
                    found.append(Line(np.arange(length, dtype=np.float64), values))
        return found

    def _weighed_references(self) -> Iterator[tuple[Array, Mask]]:
        """Yield references, (), (components,) or one per time, and at which times the deviation has a weight."""
        problem, cost = self.problem, self.problem.quadratic
        yield cost.x_ref if self.is_state else cost.u_ref, _weighed(cost, self.index, self.is_state, problem.horizon)
        for norm in problem.cost.norms:
            found = norm.references(self.index, self.is_state, problem.horizon)
            if found is not None:
                yield found

    @property
    def row_bounds(self) -> list[Line]:
        """Return the limits of rows on this signal alone: of polyhedra, soft boxes, stage rows; not costs of levels."""
        levels = any(len(one.levels_of(self.problem.control_dim)) for one in entries_of(self.problem.control_set))
        left_out = TermKind.CONTROL_SET if levels else None
        n, column = self.problem.state_dim, self.index if self.is_state else self.problem.state_dim + self.index
        terms = [term for term in self.problem.terms if term.penalty.polyhedral and not term.kind.is_cost]
        terms = [term for term in terms if term.kind != left_out]
        return [line for term in terms for line in _limits(term, n, self.problem.control_dim, column)]

    @property
    def levels(self) -> list[Line]:
        """Return the limits on the magnitude of its spectrum."""
        return _mask_levels(self.problem, self._kind, *self._rows)

    @property
    def limited_beyond_bins(self) -> bool:
        """Whether it has a limit that is not about bins: on its held spectrum, or on what it leaves ringing."""
        terms = [one for one in self.problem.terms if one.kind == self._kind and one.everywhere is not None]
        return any(not len(one.map.nearest_bins) and one.map.component == self.index for one in terms)

    @property
    def _kind(self) -> TermKind:
        return TermKind.STATE_SPECTRUM if self.is_state else TermKind.CONTROL_SPECTRUM

    def touching(self, trajectory: Trajectory) -> Line:
        """Return where its spectrum reaches the limit of a mask at every frequency, and the limits there."""
        w, levels = list[Array](), list[Array]()
        for term in self.problem.terms:
            if term.everywhere is not None and term.map.spectrum_of(*self._rows):
                peaks, ratios = peaks_above(term.everywhere, trajectory.x, trajectory.u, 1.0 - REACHED)
                w.append(peaks[ratios < 1.0 + REACHED])
                levels.append(term.everywhere.limit_at(w[-1]))
        return Line(np.concatenate([np.zeros(0), *w]), np.concatenate([np.zeros(0), *levels]))

    @property
    def _rows(self) -> tuple[Array | None, Array | None]:
        row = np.eye(self.problem.state_dim if self.is_state else self.problem.control_dim)[self.index]
        return (row, None) if self.is_state else (None, row)

    def of(self, trajectory: Trajectory) -> Array:
        """Return its values over time."""
        return (trajectory.x if self.is_state else trajectory.u)[:, self.index]


@dataclass(frozen=True, eq=False)
class Output(Signal):
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
        for term in self.problem.terms:
            if term.kind == TermKind.OUTPUT_SPECTRUM and term.map.spectrum_of(*self._rows):
                stop[term.map.nearest_bins] = True
        return stop

    @property
    def references(self) -> list[Line]:
        """Return nothing."""
        return []

    @property
    def row_bounds(self) -> list[Line]:
        """Return nothing."""
        return []

    @property
    def levels(self) -> list[Line]:
        """Return the limits on the magnitude of its spectrum."""
        return _mask_levels(self.problem, TermKind.OUTPUT_SPECTRUM, *self._rows)

    def of(self, trajectory: Trajectory) -> Array:
        """Return its values over time."""
        C, D = self._rows
        x, u = trajectory.x, trajectory.u
        parts = ([] if C is None else [x[: len(x) if D is None else len(u)] @ C]) + ([] if D is None else [u @ D])
        return sum(parts, np.zeros(len(parts[0])))

    @property
    def _rows(self) -> tuple[Array | None, Array | None]:
        C, D = self.outputs.C, self.outputs.D
        return None if C is None else C[self.index], None if D is None else D[self.index]


def controls_of(problem: OptimalControlProblem) -> list[Signal]:
    """Return all controls."""
    return [Signal(problem, j, is_state=False) for j in range(problem.control_dim)]


def states_of(problem: OptimalControlProblem) -> list[Signal]:
    """Return all states."""
    return [Signal(problem, i, is_state=True) for i in range(problem.state_dim)]


def outputs_of(problem: OptimalControlProblem) -> list[Signal]:
    """Return the outputs whose spectrum is constrained."""
    families = entries_of(problem.output_spectrum)
    found = [Output(problem, i, True, family) for family in families for i in range(len(family.output_names))]
    return [output for output in found if output.stop.any()]


def state_bounds(problem: OptimalControlProblem) -> Box:
    """Return the state set of each time without the ends, bounds of shape (T+1, n)."""
    return problem.state_boxes


def _weighed(cost: QuadraticCost, index: int, is_state: bool, horizon: int) -> Mask:
    if not is_state:
        weights = np.abs(cost.R[..., index, :]).sum(-1) + np.abs(cost.S[..., :, index]).sum(-1)
        return np.asarray(np.broadcast_to(weights > 0, horizon))
    weights = np.abs(cost.Q[..., index, :]).sum(-1) + np.abs(cost.S[..., index, :]).sum(-1)
    return np.append(np.broadcast_to(weights > 0, horizon), bool(cost.P[index].any()))


def _mask_levels(problem: OptimalControlProblem, kind: TermKind, C: Array | None, D: Array | None) -> list[Line]:
    """Return the limits on the magnitude of the spectrum of C x + D u, of the terms of a kind with these C and D."""
    found = list[Line]()
    for term in problem.terms:
        if term.kind != kind or not len(term.map.frequencies) or not term.map.spectrum_of(C, D):
            continue
        match term.everywhere:
            case Frequencies(limits=given):
                pieces = zip(given.low, given.high, given.at_low, given.at_high, strict=True)
                found += [Line(np.array([low, high]), np.array([first, last])) for low, high, first, last in pieces]
            case _:
                levels = term.penalty.bounds(term.shape)[1][:, 0] / term.per_limit
                found.append(Line(term.map.frequencies, levels, not term.hard))
    return found


def _limits(term: Term, n: int, m: int, column: int) -> Iterator[Line]:
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
