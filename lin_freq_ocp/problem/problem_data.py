"""The fields of a problem, and what follows from them without its terms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Mask
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.problem.costs.quadratic import Cost, QuadraticCost
from lin_freq_ocp.problem.dynamics.base import Dynamics
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.sets.box import Box, SetOrSets, box_of, end_within, stacked
from lin_freq_ocp.problem.spectrum.bands import stopped_bins, time_signal
from lin_freq_ocp.problem.spectrum.base import Constraints
from lin_freq_ocp.problem.spectrum.outputs import OutputSpectrum
from lin_freq_ocp.problem.terms.ends_map import Link
from lin_freq_ocp.problem.terms.stage_rows import StageRows


@dataclass(frozen=True, eq=False, init=False)
class ProblemData:
    """The fields of ``OptimalControlProblem``, with names, dimensions, bounds and stopped bins."""

    dynamics: Dynamics
    horizon: int
    cost: Cost
    control_set: SetOrSets
    state_set: SetOrSets
    initial_state: ConvexSet
    terminal_state: ConvexSet
    control_spectrum: Constraints
    state_spectrum: Constraints
    stage_rows: tuple[StageRows, ...]
    output_spectrum: OutputSpectrum | Sequence[OutputSpectrum] | None
    name: str

    @property
    def origin(self) -> Array | None:
        """Return where zero states lie in the coordinates that they were given in (``translation.py``); None: there."""
        return self.__dict__.get("_origin")

    @property
    def state_dim(self) -> int:
        """Return n."""
        return self.dynamics.state_dim

    @property
    def control_dim(self) -> int:
        """Return m."""
        return self.dynamics.control_dim

    @property
    def sampling_time(self) -> float | None:
        """Return the seconds per step, if given."""
        return self.dynamics.sampling_time

    @property
    def times(self) -> Array:
        """Return the times of the states, (T+1,): in seconds with a sampling time, else in steps."""
        return np.arange(self.horizon + 1, dtype=np.float64) * (self.sampling_time or 1.0)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Return the names of the state components, with units."""
        return self.dynamics.state_names

    @property
    def control_names(self) -> tuple[str, ...]:
        """Return the names of the control components, with units."""
        return self.dynamics.control_names

    @property
    def quadratic(self) -> QuadraticCost:
        """Return the quadratic part of the cost."""
        return self.cost.quadratic

    @property
    def initial_box(self) -> Box:
        """Return the bounds of the initial set."""
        return box_of(self.initial_state).at_dimension(self.state_dim, "initial_state")

    @property
    def terminal_box(self) -> Box:
        """Return the bounds of the terminal set."""
        return box_of(self.terminal_state).at_dimension(self.state_dim, "terminal_state")

    @property
    def fixed_ends(self) -> dict[int, Array]:
        """Return the states at the ends where they are single points."""
        times = (0, self.horizon)
        return {t: end.lower for t, end in zip(times, self.ends, strict=True) if end.fixed.all()}

    @property
    def links(self) -> tuple[Link, ...]:
        """Return the equations on both ends, those that the dynamics imply last."""
        given = self.terminal_state.links(self.state_dim, self.horizon)
        implied = self.dynamics.links(self.horizon)
        if given and any(one.periodic for one in implied):
            advice = "Its outputs are periodic by themselves: x_T = x_0."
            raise ProblemError("terminal_state", given[0].name, "none beside a periodic FrequencyResponse", advice)
        return (*given, *implied)

    @cached_property
    def state_boxes(self) -> Box:
        """The bounds of the state set of each time, (T+1, n), without the initial and the terminal set."""
        return stacked("state_set", self.state_set, self.state_dim, self.horizon + 1)

    @property
    def ends(self) -> tuple[Box, Box]:
        """Return the bounds of X_0 and X_T, (n,): of the initial and the terminal set, within those of their times."""
        return self.met_ends[0][0], self.met_ends[1][0]

    @cached_property
    def met_ends(self) -> tuple[tuple[Box, Mask], tuple[Box, Mask]]:
        """The bounds of both ends, and in which components, (n,), no point of an end is in the state set of its time.

        There the bounds are those of the end, and the bounds of the state set are terms.
        """
        boxes = self.state_boxes
        return end_within(self.initial_box, boxes.at(0)), end_within(self.terminal_box, boxes.at(-1))

    @cached_property
    def state_tube(self) -> Box:
        """X_0 .. X_T, bounds of shape (T+1, n): the state set of each time, with the initial and terminal sets."""
        lower, upper = self.state_boxes.lower.copy(), self.state_boxes.upper.copy()
        for t, end in zip((0, -1), self.ends, strict=True):
            lower[t], upper[t] = end.lower, end.upper
        return Box(lower, upper)

    @cached_property
    def control_tube(self) -> Box:
        """U_0 .. U_{T-1}, bounds of shape (T, m)."""
        return stacked("control_set", self.control_set, self.control_dim, self.horizon)

    @cached_property
    def control_stop(self) -> Mask:
        """Which bins are removed from which control: shape (T//2 + 1, m)."""
        constraints, names = self.control_spectrum, self.control_names
        return stopped_bins("control_spectrum", constraints, self.horizon, names, self.sampling_time)

    @cached_property
    def state_samples(self) -> int:
        """The number N of samples in spectra of states: T with periodic ends, where x_T repeats x_0, else T+1."""
        return self.horizon + 1 - any(one.repeats for one in self.links)

    def in_time(self, rho_x: ComplexArray) -> Array:
        """Return (R' rho_x)_t, (T+1, n), for rho_x (N//2 + 1, n); it is zero where a state is in no spectrum."""
        signal = time_signal(rho_x, self.state_samples)
        return np.pad(signal, ((0, self.horizon + 1 - len(signal)), (0, 0)))

    @cached_property
    def state_stop(self) -> Mask:
        """Which bins are removed from which state: shape (N//2 + 1, n), N = ``state_samples``."""
        constraints, names = self.state_spectrum, self.state_names
        return stopped_bins("state_spectrum", constraints, self.state_samples, names, self.sampling_time)
