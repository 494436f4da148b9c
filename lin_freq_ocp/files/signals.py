"""Measured or simulated signals, one row per time, as trajectories of a problem."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, real_array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.files.locations import FileArray
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.simulation import simulate
from lin_freq_ocp.problem.trajectory import Trajectory

CLOCK_TOLERANCE = 0.1  # error of a clock in periods since its first time: times are rounded, a wrong rate adds up


def trajectory_from_signals(problem: OptimalControlProblem, x: ArrayLike | None, u: ArrayLike) -> Trajectory:
    """Return states x (T+1, n) and controls u (T, m), or (T+1, m), as a trajectory; without x, u is replayed."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    controls = real_array("u", _fitting("u", u, [(T, m), (T + 1, m)])[:T])  # u_T has no effect
    if x is None:
        return simulate(problem, controls)
    return Trajectory(real_array("x", _fitting("x", x, [(T + 1, n)])), controls)


def require_clock(field: str, times: Array, period: float, locations: Sequence[str] | None = None) -> None:
    """Raise ProblemError unless the times increase by one period each; ``locations`` replace indices in errors."""
    off = np.abs(times - times[:1] - period * np.arange(len(times))) > CLOCK_TOLERANCE * period
    if off.any():
        k = int(np.argmax(off))
        location = f"{field}[{k}]" if locations is None else f"{locations[k]}, {field}"
        expected = f"{times[0] + k * period:.12g}, {k} periods of {period:.12g} after {times[0]:.12g}"
        advice = "Sample the signals with the problem's sampling time."
        raise ProblemError(location, f"{times[k]:.12g}", expected, advice)


def _fitting(field: str, given: ArrayLike, shapes: list[tuple[int, int]]) -> FileArray:
    signal = np.asarray(given)
    if signal.shape in shapes:
        return signal
    turned = signal.ndim == 2 and signal.shape[::-1] in shapes
    advice = f"Transpose it: in MATLAB {field} = {field}.', in numpy {field}.T." if turned else ""
    expected = f"shape {' or '.join(map(str, shapes))}, one row per time"
    raise ProblemError(field, f"shape {signal.shape}", expected, advice)
