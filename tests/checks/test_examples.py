"""Every example runs and says what it promises."""

import runpy
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.py"))
SAYS = {
    "first_steps": "satisfied, normal",
    "pendulum": "brickwall    peaks at 5.858 N and misses the end by 0.813 m and 16.72 rad",
    "state_frequency_constraint": "maximum principle: satisfied",
    "several_controls": "satisfied, normal",
    "masked_pendulum": "peak in the band 0.05168 N   satisfied",
    "certify_somebody_elses": "maximum principle: satisfied",
    "problem_files": "saved answer: satisfied",
    "long_horizons": "10000 steps by method spectral",
    "minimum_time": "131 is proven infeasible by a ray, and with it all shorter horizons",
    "printer_move": "ZVD       28 samples, 0.14 s",
    "kinks": "maximum principle satisfied",
    "torque_map": "modes meet at t = 4; joint inclusion holds",
    "receding_horizon": "0 of 120 steps softened",
    "wall": "cost      95.820020, no trajectory below 95.82001",
}


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_example(example, capsys):
    runpy.run_path(str(example), run_name="__main__")
    assert SAYS[example.stem] in capsys.readouterr().out
