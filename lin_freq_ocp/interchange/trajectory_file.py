"""A trajectory from any kind of file that holds one; the end of its name says which kind."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from lin_freq_ocp.interchange.csv_file import read_csv
from lin_freq_ocp.interchange.mat_file import read_mat
from lin_freq_ocp.interchange.results import load_solution
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory


def load_trajectory(path: str | PathLike[str], problem: OptimalControlProblem) -> tuple[Trajectory, Multipliers | None]:
    """Read a .csv, a .mat, or, whatever else it is called, an .npz; only the last can have multipliers.

    Raises
    ------
    ProblemError
        If it is no such file, or does not fit the problem; the field names file and place.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".csv":
        return read_csv(path, problem), None
    if suffix == ".mat":
        return read_mat(path, problem), None
    saved = load_solution(path)
    return saved.trajectory, saved.multipliers
