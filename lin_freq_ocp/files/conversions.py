"""Trajectories as pandas' DataFrame, and as python-control's TimeResponseData, and back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, real_array
from lin_freq_ocp.base.errors import MissingExtraError, ProblemError
from lin_freq_ocp.files.locations import located
from lin_freq_ocp.files.signals import require_clock, trajectory_from_signals
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory

Signals = tuple[str, Array | None, Sequence[str] | None]  # their kind, values and labels

if TYPE_CHECKING:
    from control import TimeResponseData
    from pandas import DataFrame


def to_frame(problem: OptimalControlProblem, trajectory: Trajectory) -> DataFrame:
    """Return a row per time 0 .. T, with states and controls under their names; see ``Result.to_frame``."""
    try:
        import pandas
    except ImportError:
        message = "to_frame needs pandas, which is not installed: pip install 'lin-freq-ocp[pandas]'."
        raise MissingExtraError(message) from None
    problem.require(trajectory)
    label = "t" if problem.sampling_time is None else "time [s]"
    return pandas.DataFrame(
        np.hstack([trajectory.x, _until_end(trajectory)]),
        index=pandas.Index(problem.times, name=label),
        columns=[*problem.state_names, *problem.control_names],
    )


def to_time_response(problem: OptimalControlProblem, trajectory: Trajectory) -> TimeResponseData:
    """Return a trajectory as a ``control.TimeResponseData``, whose last axis is time, with the problem's names.

    Its time (T+1,) is in seconds (in steps, without sampling time); states and outputs both are x', (n, T+1); inputs
    are u', (m, T+1), NaN at time T, where there is no control.

    Parameters
    ----------
    problem : OptimalControlProblem
    trajectory : Trajectory
        Of its horizon and dimensions.

    Returns
    -------
    control.TimeResponseData

    Raises
    ------
    ProblemError
        If the trajectory is not of the problem's shape.

    Examples
    --------
    >>> result = lfo.solve(lfo.library.double_integrator())
    >>> lfo.io.to_time_response(result.problem, result.trajectory).states.shape
    (2, 201)
    """
    import control  # here, because it takes seconds to import and only its users need it

    problem.require(trajectory)
    return control.TimeResponseData(
        problem.times,
        outputs=trajectory.x.T,
        states=trajectory.x.T,
        inputs=_until_end(trajectory).T,
        output_labels=list(problem.state_names),
        state_labels=list(problem.state_names),
        input_labels=list(problem.control_names),
        title=problem.name or None,
        sysname=problem.name or None,
    )


def from_time_response(response: TimeResponseData, problem: OptimalControlProblem) -> Trajectory:
    """Return a response of python-control, such as of ``forced_response``, as a trajectory of the problem.

    Signals are found by the problem's names if the labels have them all, else by their order if there are as many. The
    states of the problem are looked for among the states of the response, then among its outputs. Inputs at time T act
    on nothing, and are left out. python-control draws straight lines between the inputs of a continuous system; the
    problem holds them.

    Parameters
    ----------
    response : control.TimeResponseData
        One response (one trace) at T+1 times, with inputs.
    problem : OptimalControlProblem
        Its names, dimensions, horizon and sampling time.

    Returns
    -------
    Trajectory

    Raises
    ------
    ProblemError
        If the response has other times or signals, or more than one trace.

    Examples
    --------
    >>> result = lfo.solve(lfo.library.double_integrator())
    >>> lfo.from_time_response(result.to_time_response(), result.problem).u.shape == result.trajectory.u.shape
    True
    """
    import control  # here, because it takes seconds to import and only its users need it

    if not isinstance(response, control.TimeResponseData):
        raise ProblemError("response", type(response).__name__, "a control.TimeResponseData")
    if response.ntraces > 1:
        advice = "Take the response to one input: of step_response, with input=0."
        raise ProblemError("response", f"{response.ntraces} traces", "one", advice)
    T = problem.horizon
    times = real_array("response.time", response.t)
    if times.shape != (T + 1,):
        raise ProblemError("response.time", f"{len(times)} times", f"{T + 1}, one per state")
    if problem.sampling_time is not None:
        require_clock("response.time", times, problem.sampling_time)
    sources = [("states", response.x, response.state_labels), ("outputs", response.y, response.output_labels)]
    found = [x for _, signals, labels in sources if (x := _rows(signals, labels, problem.state_names)) is not None]
    controls = _rows(response.u, response.input_labels, problem.control_names)
    if not found:
        raise _unfit("states, outputs", sources, problem.state_names)
    if controls is None:
        raise _unfit("inputs", [("inputs", response.u, response.input_labels)], problem.control_names)
    with located("response"):
        return trajectory_from_signals(problem, found[0].T, controls.T[:T])


def _until_end(trajectory: Trajectory) -> Array:
    """Return the controls with not-a-number at time T, (T+1, m)."""
    return np.vstack([trajectory.u, np.full((1, trajectory.u.shape[1]), np.nan)])


def _rows(signals: ArrayLike | None, labels: Sequence[str] | None, names: Sequence[str]) -> Array | None:
    """Return the signals of these names, or all of them, in their order, if there are as many; else None."""
    if signals is None:
        return None
    rows = np.asarray(signals)
    rows = rows.reshape(len(rows), -1)  # the axis of a single trace may be between signal and time
    if labels is not None and set(names) <= set(labels):
        return rows[[list(labels).index(name) for name in names]]
    return rows if len(rows) == len(names) else None


def _unfit(
    field: str, sources: Sequence[tuple[str, Array | None, Sequence[str] | None]], names: Sequence[str]
) -> ProblemError:
    got = "; ".join(
        f"{'no' if signals is None else len(signals)} {kind}" + (f" ({', '.join(labels)})" if labels else "")
        for kind, signals, labels in sources
    )
    return ProblemError(f"response.{field}", got, f"{len(names)}: {', '.join(names)}")
