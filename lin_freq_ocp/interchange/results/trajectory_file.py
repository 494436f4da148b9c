"""Trajectories in files of any kind, told by the suffix."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.interchange.results.csv_file import read_csv, save_csv
from lin_freq_ocp.interchange.results.mat_file import read_mat, save_mat
from lin_freq_ocp.interchange.results.solution_file import load_solution, save_solution
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

TABLE, MATLAB, ARCHIVE = ".csv", ".mat", ".npz"


def load_trajectory(path: str | PathLike[str], problem: OptimalControlProblem) -> tuple[Trajectory, Multipliers | None]:
    """Read a .csv, a .mat, or, with any other suffix, an .npz; only the last can have multipliers."""
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
    summary: Mapping[str, Any],
) -> None:
    """Write a .csv or a .mat, which hold the trajectory, or an .npz, also without a suffix, which holds all."""
    suffix = kind_of_file(path)
    if suffix == TABLE:
        save_csv(path, problem, trajectory)
    elif suffix == MATLAB:
        save_mat(path, problem, trajectory)
    else:
        save_solution(path, trajectory, multipliers, summary)


def kind_of_file(path: str | PathLike[str], field: str = "") -> str:
    """Return the suffix that says how a trajectory is written to this file; a name without one is an .npz."""
    suffix = Path(path).suffix.lower() or ARCHIVE
    if suffix not in (ARCHIVE, TABLE, MATLAB):
        expected = f"one that ends in {ARCHIVE}, {TABLE} or {MATLAB}"
        advice = "Only an .npz holds the multipliers, too."
        raise ProblemError(field or str(path), f"a name that ends in {suffix}", expected, advice)
    return suffix
