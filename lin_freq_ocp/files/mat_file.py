"""Trajectories in .mat files: x, u and t, one row per time, as MATLAB's lsim and ode45 return them."""

from __future__ import annotations

import struct
import zlib
from io import BytesIO
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lin_freq_ocp.base.arrays import real_array
from lin_freq_ocp.base.atomic import write_bytes
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.files.reading import read_bytes, require_modest
from lin_freq_ocp.files.locations import FileArray, FileValue, naming
from lin_freq_ocp.files.signals import require_clock, trajectory_from_signals
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory

COMPRESSED = 15  # type of a compressed element
PIECE = 2**22  # bytes unpacked at once


def save_mat(path: str | PathLike[str], problem: OptimalControlProblem, trajectory: Trajectory) -> None:
    """Write a trajectory to a .mat file (version 5), which MATLAB loads: one row per time.

    Variables: x (T+1, n), u (T, m), t (T+1, 1) in seconds (in steps, if the problem has no sampling time), and the
    cell arrays state_names (n, 1) and control_names (m, 1).
    """
    problem.require(trajectory)
    variables = {
        "x": trajectory.x,
        "u": trajectory.u,
        "t": problem.times[:, None],
        "state_names": _cells(problem.state_names),
        "control_names": _cells(problem.control_names),
    }
    from scipy.io import savemat  # slow to import

    stream: FileValue = BytesIO()  # stubs of scipy know names of files only
    savemat(stream, variables)
    write_bytes(path, stream.getvalue())


def read_mat(path: str | PathLike[str], problem: OptimalControlProblem) -> Trajectory:
    """Read a trajectory from a .mat file: x (T+1, n) and u (T, m), one row per time, as lsim and ode45 have them.

    Without x, the controls are replayed from the problem's initial state. u may have T+1 rows, as for lsim; its last
    row acts on nothing. t, a vector in seconds, is compared with the sampling time if there are both. Other variables
    are left out.

    Parameters
    ----------
    path : path
        Of version 5 or 7; MATLAB's ``save`` writes 7.3 only if asked to.
    problem : OptimalControlProblem
        Its horizon, dimensions and sampling time.

    Returns
    -------
    Trajectory

    Raises
    ------
    ProblemError
        If it is no such file, or a variable does not fit: the field names file and variable.

    Examples
    --------
    >>> result = lfo.solve(lfo.library.double_integrator())
    >>> result.to_mat("run.mat")
    >>> bool((lfo.read_mat("run.mat", result.problem).x == result.trajectory.x).all())
    True
    """
    from scipy.io import loadmat  # slow to import

    path = Path(path)
    content = read_bytes(path)
    try:
        _require_modest(str(path), content)
        stream: FileValue = BytesIO(content)
        variables = loadmat(stream)
    except ProblemError:
        raise
    except Exception as error:  # loadmat raises errors of many kinds for damaged files
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


def _require_modest(field: str, content: bytes) -> None:
    """Raise ProblemError if compressed variables of a file of version 5 or 7 unpack to too much.

    Unlike a zip archive it does not declare sizes: its variables are unpacked piece by piece, and not kept.
    """
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    offset, entries, unpacked = 128, 0, 0
    while order is not None and offset + 8 <= len(content):
        kind, size = struct.unpack_from(f"{order}II", content, offset)
        offset += 8
        entries, unpacked = entries + 1, unpacked + size
        if kind == COMPRESSED:
            unpacker, rest = zlib.decompressobj(), content[offset : offset + size]
            while rest and not unpacker.eof:
                unpacked += len(unpacker.decompress(rest, PIECE))
                rest = unpacker.unconsumed_tail
                require_modest(field, entries, unpacked, len(content))
        require_modest(field, entries, 0, len(content))
        offset += size


def _matrix(name: str, value: object) -> FileArray:
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "iuf":
        kinds = {"c": "a complex matrix", "U": "text"}
        got = kinds.get(np.asarray(value).dtype.kind, "a sparse matrix or a structure")
        raise ProblemError(name, got, "a matrix of real numbers, full")
    return value


def _require_times(t: FileArray, rows: int, sampling_time: float | None) -> None:
    if t.shape not in ((rows, 1), (1, rows)):
        raise ProblemError("t", f"shape {t.shape}", f"shape ({rows}, 1), one time for each row")
    if sampling_time is not None:
        require_clock("t", real_array("t", t.ravel()), sampling_time)


def _cells(names: tuple[str, ...]) -> NDArray[np.object_]:
    cells = np.empty((len(names), 1), dtype=object)
    cells[:, 0] = names
    return cells
