"""Measured or simulated signals, one row per time, as trajectories of a problem."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lin_freq_ocp.arrays import Array, real_array
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.simulation import simulate
from lin_freq_ocp.problem.trajectory import Trajectory

CLOCK_TOLERANCE = 0.1
"""Largest error of a clock in periods, counted from its first time: times are rounded; a wrong rate adds up."""


def trajectory_from_signals(problem: OptimalControlProblem, x: Any, u: Any) -> Trajectory:
    """Return states x (T+1, n) and controls u (T, m) or (T+1, m) as a trajectory; without x, u is replayed.

    A control at time T has no effect, and is left out.
    """
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    controls = real_array("u", _fitting("u", u, [(T, m), (T + 1, m)])[:T])
    if x is None:
        return simulate(problem, controls)
    return Trajectory(real_array("x", _fitting("x", x, [(T + 1, n)])), controls)


def require_clock(field: str, times: Array, period: float, locations: Sequence[str] | None = None) -> None:
    """Raise ProblemError unless the times go on by one period each; where they begin does not matter.

    ``locations`` names each time in place of its index.
    """
    off = np.abs(times - times[:1] - period * np.arange(len(times))) > CLOCK_TOLERANCE * period
    if off.any():
        k = int(np.argmax(off))
        location = f"{field}[{k}]" if locations is None else f"{locations[k]}, {field}"
        expected = f"{times[0] + k * period:.12g}, {k} periods of {period:.12g} after {times[0]:.12g}"
        raise ProblemError(
            location, f"{times[k]:.12g}", expected, "Sample the signals with the problem's sampling time."
        )


def _fitting(field: str, given: Any, shapes: list[tuple[int, int]]) -> NDArray[Any]:
    signal = np.asarray(given)
    if signal.shape in shapes:
        return signal
    turned = signal.ndim == 2 and signal.shape[::-1] in shapes
    advice = f"Transpose it: in MATLAB {field} = {field}.', in numpy {field}.T." if turned else ""
    expected = f"shape {' or '.join(map(str, shapes))}, one row per time"
    raise ProblemError(field, f"shape {signal.shape}", expected, advice)
