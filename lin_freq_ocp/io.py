"""Problems, trajectories, runs and sweeps in files, and other tools."""

from lin_freq_ocp.api.batch import load_sweep
from lin_freq_ocp.api.runs import load_run
from lin_freq_ocp.base.errors import answer_misspelt
from lin_freq_ocp.files.calibration import read_calibration
from lin_freq_ocp.files.conversions import from_time_response, to_cvxpy, to_time_response
from lin_freq_ocp.files.problem_file import read_problem, write_problem
from lin_freq_ocp.files.solution_files import load_solution as load
from lin_freq_ocp.files.solution_files import read_csv, read_mat

# fmt: off
__all__ = [
    "from_time_response", "load", "load_run", "load_sweep", "read_calibration", "read_csv", "read_mat", "read_problem",
    "to_cvxpy", "to_time_response", "write_problem",
]
# fmt: on

answer_misspelt(globals())
