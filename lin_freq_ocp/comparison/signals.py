"""The controls, states and constrained outputs of a problem, each as one signal with its bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.comparison.limits import Line, bounds_of_rows, mask_levels, references
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box, stacked
from lin_freq_ocp.problem.spectrum.base import entries_of
from lin_freq_ocp.problem.spectrum.outputs import OutputSpectrum
from lin_freq_ocp.problem.terms.term import TermKind
from lin_freq_ocp.problem.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Signal:
    """One control or state of a problem.

    Lines of references and limits are over times (in steps) or frequencies (in rad/sample).
    """

    problem: OptimalControlProblem
    index: int
    is_state: bool

    @property
    def name(self) -> str:
        """Return its name with its unit."""
        return (self.problem.state_names if self.is_state else self.problem.control_names)[self.index]

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
        """Return its references in the cost."""
        return references(self.problem, self.index, self.is_state)

    @property
    def row_bounds(self) -> list[Line]:
        """Return its bounds that are given by rows and soft sets."""
        return bounds_of_rows(self.problem, self.index, self.is_state)

    @property
    def levels(self) -> list[Line]:
        """Return the limits on the magnitude of its spectrum."""
        row = np.eye(self.problem.state_dim if self.is_state else self.problem.control_dim)[self.index]
        if self.is_state:
            return mask_levels(self.problem, TermKind.STATE_SPECTRUM, row)
        return mask_levels(self.problem, TermKind.CONTROL_SPECTRUM, None, row)

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
        """Return nothing."""
        return []

    @property
    def row_bounds(self) -> list[Line]:
        """Return nothing."""
        return []

    @property
    def levels(self) -> list[Line]:
        """Return the limits on the magnitude of its spectrum."""
        return mask_levels(self.problem, TermKind.OUTPUT_SPECTRUM, *self._rows)

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


def outputs_of(problem: OptimalControlProblem) -> list[Output]:
    """Return the outputs whose spectrum is constrained."""
    families = entries_of(problem.output_spectrum)
    found = [Output(problem, i, True, family) for family in families for i in range(len(family.output_names))]
    return [output for output in found if output.stop.any()]


def state_bounds(problem: OptimalControlProblem) -> Box:
    """Return the state set of each time without the ends, bounds of shape (T+1, n)."""
    return stacked("state_set", problem.state_set, problem.state_dim, problem.horizon + 1)
