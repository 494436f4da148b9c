"""Trajectories for MATLAB and from it: x, u and t in a .mat file, one row per time, as lsim and ode45 give them."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat, savemat

from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.interchange.files import read_bytes, writing
from lin_freq_ocp.interchange.places import naming
from lin_freq_ocp.interchange.signals import require_clock, trajectory_from_signals
from lin_freq_ocp.problem.arrays import real_array
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory


def save_mat(path: str | PathLike[str], problem: OptimalControlProblem, trajectory: Trajectory) -> None:
    """Write a trajectory to a .mat file (version 5), which MATLAB loads: one row per time.

    Variables: x (T+1, n), u (T, m), t (T+1, 1) in seconds (in steps, if the problem has no sampling time), and the
    cell arrays state_names (n, 1) and control_names (m, 1).

    Raises
    ------
    ProblemError
        If the trajectory is not of the problem's shape, or the file cannot be written.
    """
    problem.require(trajectory)
    path = Path(path)
    variables = {
        "x": trajectory.x,
        "u": trajectory.u,
        "t": problem.times[:, None],
        "state_names": _cells(problem.state_names),
        "control_names": _cells(problem.control_names),
    }
    with writing(path):
        savemat(str(path), variables, appendmat=False)


def read_mat(path: str | PathLike[str], problem: OptimalControlProblem) -> Trajectory:
    """Read a trajectory from a .mat file: x (T+1, n) and u (T, m), one row per time, as lsim and ode45 have them.

    Without x, the controls are replayed from the problem's initial state. u may have T+1 rows, as for lsim; its last
    row acts on nothing. t, a vector in seconds, is compared with the sampling time if there are both. Other variables
    are left out.

    Parameters
    ----------
    path : path
        Of version 5 or 7; MATLAB's ``save`` writes 7.3 only if told to.
    problem : OptimalControlProblem
        Its horizon, dimensions and sampling time.

    Raises
    ------
    ProblemError
        If it is no such file, or a variable does not fit: the field names file and variable.
    """
    path = Path(path)
    read_bytes(path)  # for what can be said of a file that is not there
    try:
        variables = loadmat(str(path), appendmat=False)
    except Exception as error:  # whatever it meets in a file that is damaged or of another kind
        advice = "In MATLAB: save(name, 'x', 'u', 't', '-v7')."
        raise ProblemError(str(path), f"{error}", "a .mat file of version 5 or 7", advice) from None
    with naming(path):
        if "u" not in variables:
            there = [name for name in variables if not name.startswith("__")]
            got = f"nothing (there is {', '.join(there) or 'no variable'})"
            raise ProblemError("u", got, "a variable of this name", "Rename it in MATLAB, and save x, u and t.")
        signals = {name: _matrix(name, variables[name]) for name in ("x", "u", "t") if name in variables}
        trajectory = trajectory_from_signals(problem, signals.get("x"), signals["u"])
        if "t" in signals:
            _require_times(signals["t"], len(signals.get("x", signals["u"])), problem.sampling_time)
        return trajectory


def _matrix(name: str, value: Any) -> NDArray[Any]:
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "iuf":
        kind = {"c": "a complex matrix", "U": "text"}.get(
            np.asarray(value).dtype.kind, "a sparse matrix or a structure"
        )
        raise ProblemError(name, kind, "a matrix of real numbers, full")
    return value


def _require_times(t: NDArray[Any], rows: int, sampling_time: float | None) -> None:
    if t.shape not in ((rows, 1), (1, rows)):
        raise ProblemError("t", f"shape {t.shape}", f"shape ({rows}, 1), one time for each row")
    if sampling_time is not None:
        require_clock("t", real_array("t", t.ravel()), sampling_time)


def _cells(names: tuple[str, ...]) -> NDArray[Any]:
    cells = np.empty((len(names), 1), dtype=object)
    cells[:, 0] = names
    return cells
