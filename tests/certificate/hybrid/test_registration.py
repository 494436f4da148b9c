"""Kinds of dynamics with modes register their judges when a table lacks an entry; no caller needs to import them."""

import subprocess
import sys

from helpers.seeds import expensive

ASKED = """
import sys
from lin_freq_ocp import library
from lin_freq_ocp.certificate import JUDGES
from lin_freq_ocp.problem.dynamics.base import entry_for

dynamics = library.pendulum_with_wall(horizon=4).dynamics
assert "lin_freq_ocp.solving.hybrid" not in sys.modules
print(entry_for(JUDGES, dynamics).__name__)
"""


@expensive
def test_the_judge_of_modes_is_found_before_anything_imports_it():
    asked = subprocess.run([sys.executable, "-c", ASKED], capture_output=True, text=True, check=True)
    assert asked.stdout.strip() == "judge_modes"
