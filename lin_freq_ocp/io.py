"""Problems, trajectories, runs and sweeps in files, and other tools."""

from lin_freq_ocp.api.runs import load_run
from lin_freq_ocp.api.sweep import load_sweep
from lin_freq_ocp.files.cvxpy_problem import to_cvxpy
from lin_freq_ocp.files.problem_file import read_problem, write_problem
from lin_freq_ocp.files.conversions import from_time_response, to_time_response
from lin_freq_ocp.files.csv_file import read_csv
from lin_freq_ocp.files.mat_file import read_mat
from lin_freq_ocp.files.solution_file import load_solution as load

__all__ = [
    "from_time_response",
    "load",
    "load_run",
    "load_sweep",
    "read_csv",
    "read_mat",
    "read_problem",
    "to_cvxpy",
    "to_time_response",
    "write_problem",
]
