"""The optimal control problem (paper, eq. (DTOCPNSD)) with linear dynamics, boxes, joint rows and stop bands."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lin_freq_ocp.errors import NumericalError, ProblemError
from lin_freq_ocp.problem.arrays import Mask, assign, brief, positive_integer, real_array
from lin_freq_ocp.problem.costs import QuadraticCost
from lin_freq_ocp.problem.dynamics import LinearDynamics
from lin_freq_ocp.problem.sets import Box, end_set, stacked
from lin_freq_ocp.problem.spectrum import Band, stopped_bins
from lin_freq_ocp.problem.stage_rows import row_families
from lin_freq_ocp.problem.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class OptimalControlProblem:
    """Minimise a cost over x_{t+1} = f_t(x_t, u_t), with x_t in X_t, u_t in U_t, and DFT bins of x and u set to zero.

    Parameters
    ----------
    dynamics : LinearDynamics
        The map f_t, with names, units and sampling time.
    horizon : int
        T: number of controls u_0 .. u_{T-1}; there are T+1 states.
    cost : QuadraticCost
        Its 1/2 is part of the definition.
    control_set, state_set : Box, sequence of Box, or None
        One set for all times, or one per time (T for controls, T+1 for states).
    initial_state, terminal_state : (n,), Box, or None
        A point, a set, or free; taken together with the state set of that time.
    control_spectrum, state_spectrum : Band, sequence of Band, or None
        Stop bands, on the DFT of length T for controls and T+1 for states.
    stage_rows : StageRows, sequence of StageRows, or None
        Joint rows C x_t + D u_t <= e_t for t < T, under different names; once constructed, a tuple of them.
    name : str
        For tables and pictures.

    Raises
    ------
    ProblemError
        Saying which field, what was got and what was expected.
    """

    dynamics: LinearDynamics
    horizon: int
    cost: QuadraticCost
    control_set: Box | Sequence[Box] | None = None
    state_set: Box | Sequence[Box] | None = None
    initial_state: Any = None
    terminal_state: Any = None
    control_spectrum: Band | Sequence[Band] | None = None
    state_spectrum: Band | Sequence[Band] | None = None
    stage_rows: Any = None
    name: str = ""

    def __post_init__(self):
        set_field = object.__setattr__
        if not isinstance(self.dynamics, LinearDynamics):
            raise ProblemError(
                "dynamics",
                brief(self.dynamics),
                "LinearDynamics",
                "From python-control: LinearDynamics.from_statespace.",
            )
        if not isinstance(self.cost, QuadraticCost):
            raise ProblemError("cost", brief(self.cost), "QuadraticCost")
        set_field(self, "horizon", positive_integer("horizon", self.horizon))
        self.dynamics.require_horizon(self.horizon)
        n, m, T = self.state_dim, self.control_dim, self.horizon
        set_field(self, "cost", self.cost.at_dimensions(n, m, T))
        set_field(self, "initial_state", end_set("initial_state", self.initial_state, n))
        set_field(self, "terminal_state", end_set("terminal_state", self.terminal_state, n))
        set_field(self, "stage_rows", row_families(self.stage_rows, n, m, T))
        _ = self.ends, self.control_tube, self.control_stop, self.state_stop  # validated here, kept for later

    def with_ends(self, initial_state: Any = None, terminal_state: Any = None) -> OptimalControlProblem:
        """Return the same problem with other ends; nothing else is looked at again.

        Parameters
        ----------
        initial_state, terminal_state : (n,) or Box, optional
            None keeps what the problem has; a free end is Everything().

        Raises
        ------
        ProblemError
            If an end does not fit the problem.
        """
        problem, ends = copy(self), list(self.ends)
        for t, field, given in ((0, "initial_state", initial_state), (-1, "terminal_state", terminal_state)):
            if given is not None:
                assign(problem, **{field: end_set(field, given, self.state_dim)})
                ends[t] = getattr(problem, field).intersection(self.state_boxes.at(t), field)
        problem.__dict__["ends"] = tuple(ends)
        problem.__dict__.pop("state_tube", None)
        return problem

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
    def state_names(self) -> tuple[str, ...]:
        """Return the names of the state components, with units."""
        return tuple(self.dynamics.state_names or ())

    @property
    def control_names(self) -> tuple[str, ...]:
        """Return the names of the control components, with units."""
        return tuple(self.dynamics.control_names or ())

    @cached_property
    def state_boxes(self) -> Box:
        """The state set of each time, bounds of shape (T+1, n), without the initial and the terminal set."""
        return stacked("state_set", self.state_set, self.state_dim, self.horizon + 1)

    @cached_property
    def ends(self) -> tuple[Box, Box]:
        """X_0 and X_T, bounds of shape (n,): the initial and the terminal set, within the state sets of their times."""
        boxes = self.state_boxes
        return (
            self.initial_state.intersection(boxes.at(0), "initial_state"),
            self.terminal_state.intersection(boxes.at(-1), "terminal_state"),
        )

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
        return stopped_bins(
            "control_spectrum", self.control_spectrum, self.horizon, self.control_names, self.sampling_time
        )

    @cached_property
    def state_stop(self) -> Mask:
        """Which bins are removed from which state: shape ((T+1)//2 + 1, n)."""
        return stopped_bins(
            "state_spectrum", self.state_spectrum, self.horizon + 1, self.state_names, self.sampling_time
        )

    def require(self, trajectory: Trajectory) -> None:
        """Raise ProblemError unless the trajectory has this problem's shape."""
        expected = (self.horizon + 1, self.state_dim), (self.horizon, self.control_dim)
        if (trajectory.x.shape, trajectory.u.shape) != expected:
            raise ProblemError(
                "trajectory",
                f"x {trajectory.x.shape}, u {trajectory.u.shape}",
                f"x {expected[0]}, u {expected[1]}",
                "Time is axis 0.",
            )

    def __str__(self) -> str:
        stops = int(self.control_stop.sum()), int(self.state_stop.sum())
        joint = sum(family.rows for family in self.stage_rows)
        return (
            f"{self.name or 'optimal control problem'}: horizon {self.horizon}, "
            f"{self.state_dim} states, {self.control_dim} controls, "
            f"{stops[0]} control and {stops[1]} state bins removed (0 .. Nyquist)"
            + (f", {joint} joint rows per step" if joint else "")
        )


def simulate(problem: OptimalControlProblem, u: Any, initial_state: Any = None) -> Trajectory:
    """Return the trajectory of the controls u from the initial state, by the dynamics alone.

    Parameters
    ----------
    problem : OptimalControlProblem
        Its sets and bands are not looked at.
    u : (T, m)
        Controls.
    initial_state : (n,), optional
        Default: the problem's, which must then be a point.

    Raises
    ------
    ProblemError
        If a shape is wrong or there is no single initial state.
    NumericalError
        If the state overflows.
    """
    u = real_array("u", u)
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    if u.shape != (T, m):
        raise ProblemError("u", f"shape {u.shape}", f"shape {(T, m)}", "Time is axis 0.")
    if initial_state is None:
        if not problem.initial_state.fixed.all():
            raise ProblemError(
                "initial_state", "None, for a problem whose initial state is not one point", "a state to start from"
            )
        initial_state = problem.initial_state.lower
    start = real_array("initial_state", initial_state)
    if start.shape != (n,):
        raise ProblemError("initial_state", f"shape {start.shape}", f"shape {(n,)}")
    x = np.empty((T + 1, n))
    x[0] = start
    with np.errstate(over="ignore", invalid="ignore"):
        for t in range(T):
            A, B, d = problem.dynamics.at(t)
            x[t + 1] = A @ x[t] + B @ u[t] + d
    if not np.isfinite(x).all():
        t = int(np.argmin(np.isfinite(x).all(axis=1)))
        raise NumericalError(
            f"The open-loop state overflows at t = {t}: these dynamics cannot be replayed over {T} steps."
        )
    return Trajectory(x, u)
