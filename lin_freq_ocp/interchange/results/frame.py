"""Trajectories as pandas.DataFrame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lin_freq_ocp.errors import MissingExtraError
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory

if TYPE_CHECKING:
    from pandas import DataFrame


def to_frame(problem: OptimalControlProblem, trajectory: Trajectory) -> DataFrame:
    """Return a row per time 0 .. T, with states and controls under their names; see ``Result.to_frame``."""
    try:
        import pandas
    except ImportError:
        message = "to_frame needs pandas, which is not installed: pip install 'lin-freq-ocp[pandas]'."
        raise MissingExtraError(message) from None
    problem.require(trajectory)
    controls = np.vstack([trajectory.u, np.full((1, problem.control_dim), np.nan)])
    label = "t" if problem.sampling_time is None else "time [s]"
    return pandas.DataFrame(
        np.hstack([trajectory.x, controls]),
        index=pandas.Index(problem.times, name=label),
        columns=[*problem.state_names, *problem.control_names],
    )
