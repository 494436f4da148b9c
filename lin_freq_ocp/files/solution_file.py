"""Solutions as .npz files, with multipliers and summary, and trajectories in files of any kind, by their suffix."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import brief
from lin_freq_ocp.base.atomic import write_bytes
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.files.reading import npz_bytes, opened_npz, parsed_json
from lin_freq_ocp.files.locations import FileArray, FileTable, FileValue, naming, require_schema
from lin_freq_ocp.files.csv_file import read_csv, save_csv
from lin_freq_ocp.files.mat_file import read_mat, save_mat
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

SCHEMA = 2  # version of the layout of the .npz; earlier ones are read
# Fields of Multipliers that are one array, with the dimensions of each.
DIMENSIONS_OF_MULTIPLIERS = {"eta_C": 0, "eta": 2, "mu": 2, "nu": 2, "rho_u": 2, "rho_x": 2}
WEIGHTS = "weights"  # field of Multipliers of piecewise-affine dynamics, an array of two dimensions
FREQUENCIES = "frequencies/"  # the same, of where the multipliers of a mask at every frequency stand
STAGE = "stage/"  # prefix of the name of a family of joint rows: its multipliers are an array of their own
TABLE, MATLAB, ARCHIVE = ".csv", ".mat", ".npz"


@dataclass(frozen=True, eq=False)
class SavedSolution:
    """What a solution file holds.

    Attributes
    ----------
    trajectory : Trajectory
        States and controls.
    multipliers : Multipliers or None
        None if the file has none.
    summary : dict
        Status, cost, method and so on, as they were saved; empty if the file has none.

    Examples
    --------
    >>> lfo.solve(lfo.library.double_integrator()).save("run.npz")
    >>> lfo.load("run.npz").summary["status"]
    'optimal'
    """

    trajectory: Trajectory
    multipliers: Multipliers | None
    summary: FileTable


def save_solution(
    path: str | PathLike[str], trajectory: Trajectory, multipliers: Multipliers | None, summary: Mapping[str, object]
) -> None:
    """Write a solution to an .npz: the fields of Trajectory and Multipliers under their names, summary and schema."""
    write_bytes(path, solution_bytes(trajectory, multipliers, summary))


def solution_bytes(trajectory: Trajectory, multipliers: Multipliers | None, summary: Mapping[str, object]) -> bytes:
    """Return the content of the file of ``save_solution``."""
    fields: dict[str, ArrayLike] = {"x": trajectory.x, "u": trajectory.u}
    if multipliers is not None:
        fields |= {name: getattr(multipliers, name) for name in DIMENSIONS_OF_MULTIPLIERS}
        fields |= {STAGE + name: weights for name, weights in multipliers.stage.items()}
        fields |= {FREQUENCIES + name: found for name, found in multipliers.frequencies.items()}
        fields |= {} if multipliers.weights is None else {WEIGHTS: multipliers.weights}
    return npz_bytes(fields | {"schema": SCHEMA, "summary": json.dumps(dict(summary))})


def load_solution(path: str | PathLike[str]) -> SavedSolution:
    """Read a solution from an .npz that has at least x (T+1, n) and u (T, m).

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    SavedSolution

    Raises
    ------
    ProblemError
        If it is no such file, lacks x or u or some of the multipliers, or shapes do not match.

    Examples
    --------
    >>> lfo.solve(lfo.library.double_integrator()).save("run.npz")
    >>> lfo.load("run.npz").trajectory.x.shape[1]
    2
    """
    path = Path(path)
    with opened_npz(str(path), path) as archive:
        arrays: dict[str, FileArray] = {name: archive[name] for name in archive.files}
    with naming(path):
        require_schema(arrays["schema"].tolist() if "schema" in arrays else SCHEMA, SCHEMA)
        trajectory = Trajectory(*(_numbers(arrays, name, 2) for name in ("x", "u")))
        multipliers = _multipliers(arrays)
        if multipliers is not None:
            _require_same_size(trajectory, multipliers)
        return SavedSolution(trajectory, multipliers, _summary(arrays.get("summary")))


def load_trajectory(path: str | PathLike[str], problem: OptimalControlProblem) -> tuple[Trajectory, Multipliers | None]:
    """Read a .csv, a .mat, or, with any other suffix, an .npz; only an .npz can have multipliers."""
    suffix = Path(path).suffix.lower()
    if suffix == TABLE:
        return read_csv(path, problem), None
    if suffix == MATLAB:
        return read_mat(path, problem), None
    saved = load_solution(path)
    return saved.trajectory, saved.multipliers


def save_trajectory(
    path: str | PathLike[str],
    problem: OptimalControlProblem,
    trajectory: Trajectory,
    multipliers: Multipliers | None,
    summary: Mapping[str, object],
) -> None:
    """Write the trajectory to a .csv or a .mat, or all to an .npz, also without a suffix."""
    suffix = kind_of_file(path)
    if suffix == TABLE:
        save_csv(path, problem, trajectory)
    elif suffix == MATLAB:
        save_mat(path, problem, trajectory)
    else:
        save_solution(path, trajectory, multipliers, summary)


def kind_of_file(path: str | PathLike[str], field: str = "") -> str:
    """Return the suffix that says how a trajectory is written to this file; a name without a suffix is an .npz."""
    suffix = Path(path).suffix.lower() or ARCHIVE
    if suffix not in (ARCHIVE, TABLE, MATLAB):
        expected = f"one that ends in {ARCHIVE}, {TABLE} or {MATLAB}"
        advice = "Only an .npz holds the multipliers, too."
        raise ProblemError(field or str(path), f"a name that ends in {suffix}", expected, advice)
    return suffix


def _numbers(arrays: Mapping[str, FileArray], name: str, *dimensions: int) -> FileArray:
    if name not in arrays:
        raise ProblemError(name, f"nothing (there is {', '.join(arrays) or 'no array'})", "an array of this name")
    array = arrays[name]
    if array.dtype.kind not in "biufc" or array.ndim not in dimensions:
        expected = f"numbers in {' or '.join(map(str, dimensions))} dimensions"
        raise ProblemError(name, f"{array.dtype} of shape {array.shape}", expected)
    return array


def _multipliers(arrays: Mapping[str, FileArray]) -> Multipliers | None:
    if not any(name in arrays for name in DIMENSIONS_OF_MULTIPLIERS):
        return None
    fields = {name: _numbers(arrays, name, count) for name, count in DIMENSIONS_OF_MULTIPLIERS.items()}
    stage = {name.removeprefix(STAGE): _numbers(arrays, name, 2) for name in arrays if name.startswith(STAGE)}
    placed = {name: _numbers(arrays, name, 1, 2) for name in arrays if name.startswith(FREQUENCIES)}
    frequencies = {name.removeprefix(FREQUENCIES): found for name, found in placed.items()}
    weights = _numbers(arrays, WEIGHTS, 2) if WEIGHTS in arrays else None
    eta_C = float(fields.pop("eta_C"))
    return Multipliers(eta_C, **fields, stage=stage, weights=weights, frequencies=frequencies)


def _require_same_size(trajectory: Trajectory, multipliers: Multipliers) -> None:
    got, expected = (multipliers.eta.shape, multipliers.nu.shape), (trajectory.x[1:].shape, trajectory.u.shape)
    if got != expected:
        wanted = f"eta {expected[0]}, nu {expected[1]}, as the trajectory has it"
        raise ProblemError("multipliers", f"eta {got[0]}, nu {got[1]}", wanted)


def _summary(text: FileValue) -> FileTable:
    if text is None:
        return {}
    summary = parsed_json("summary", str(text))
    if not isinstance(summary, dict):
        raise ProblemError("summary", brief(summary), "a JSON object")
    return summary
