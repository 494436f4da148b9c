"""The start of a search over modes: a given trajectory, controls, or mode sequence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Indices, brief
from lin_freq_ocp.base.errors import NumericalError, ProblemError, UnsupportedError, located_at
from lin_freq_ocp.problem.dynamics.base import mode_sequence
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transform.simulation import simulate


@dataclass(frozen=True, eq=False)
class Start:
    """A start of a search over modes."""

    sequence: Indices  # (T,): the modes of the trajectory, or those given
    trajectory: Trajectory | None  # None if only modes are given

    @property
    def saved(self) -> object:
        """Return the start as file content, which ``start_of`` reads: modes, or a table of x and u."""
        if self.trajectory is None:
            return self.sequence.tolist()
        return {"x": self.trajectory.x.tolist(), "u": self.trajectory.u.tolist()}


def start_of(problem: OptimalControlProblem, start: object) -> Start:
    """Return the start of a search.

    ``given`` is a trajectory (also of a result, or a table of x and u), controls (T, m), which are simulated from the
    initial state, or the mode at every time, (T,) integers.
    """
    if not problem.mode_names:
        raise UnsupportedError("start: got one for linear dynamics, which have no modes to search; leave it out.")
    start = start if isinstance(start, Trajectory) else getattr(start, "trajectory", start)
    T, m = problem.horizon, problem.control_dim
    if isinstance(start, Mapping):
        if set(start) != {"x", "u"}:
            expected = f"x {(T + 1, problem.state_dim)} and u {(T, m)}"
            raise ProblemError("start", f"a table of {', '.join(map(str, start)) or 'nothing'}", expected)
        with located_at("start", "mode"):
            start = Trajectory(start["x"], start["u"])
    if isinstance(start, Trajectory):
        with located_at("start", "trajectory"):
            problem.require(start)
        return Start(problem.form.sequence_of(start.x, start.u), start)
    expected = f"a Trajectory, controls of shape {(T, m)}, or {T} mode numbers"
    try:
        array = np.asarray(start)
    except ValueError:
        raise ProblemError("start", brief(start), expected) from None
    whole = array.shape == (T,) and array.dtype.kind in "iu"
    if not whole and (array.shape != (T, m) or array.dtype.kind not in "iuf"):
        got = brief(start) if array.dtype.kind not in "iuf" or not array.ndim else f"shape {array.shape}"
        advice = "Mode numbers are integers." if array.shape == (T,) and array.dtype.kind == "f" else ""
        raise ProblemError("start", got, expected, advice)
    if whole:
        return Start(mode_sequence("start", array, T, len(problem.mode_names)), None)
    try:
        with located_at("start", "mode"):
            trajectory = simulate(problem, array)
    except NumericalError as error:
        got = f"controls that cannot be simulated ({error})"
        raise ProblemError("start", got, "controls that lead through regions of modes") from None
    return Start(problem.form.sequence_of(trajectory.x, trajectory.u), trajectory)
