"""Every example runs, says what it promises, and saves its picture in the current folder."""

import runpy
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import pytest

from helpers.seeds import expensive
from lin_freq_ocp.methods.structured import can_compile

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*/*.py"))
SAYS = {
    "first_steps": "satisfied, normal",
    "pendulum": "brickwall    peaks at 5.858 N and misses the end by 0.813 m and 16.72 rad",
    "state_frequency_constraint": "maximum principle: satisfied",
    "several_controls": "optimal: cost 56.6402; satisfied",
    "masked_pendulum": "peak in the band 0.05168 N   satisfied",
    "certify_another_tool": "maximum principle: satisfied",
    "both_sides_of_a_kink": "exists: False; control set, t = 0, component 0, lower",
    "co_design": "stiffness 100.8 Nm/rad, inertia 0.3",
    "problem_files": "saved answer: satisfied",
    "long_horizons": "10000 steps by method spectral",
    "stimulation": "stimulation 0.5: 173 is feasible; 172 is proven infeasible, and with it all shorter horizons",
    "minimum_time": "114 is proven infeasible, and with it all shorter horizons",
    "oscillating_mass_in_c": "25 unknowns in float",
    "printer_move": "optimal   40 samples, 0.16 s",
    "kinks": "maximum principle satisfied",
    "torque_map": "modes meet at t = 4; joint inclusion holds",
    "receding_horizon": "with bounded windows             6.120 deg       0.114 N       5.000 N",
    "oscillating_mass": "at most 1 of the limit, 0 above it",
    "two_mass_drive": f"limit, in Python    {'0.0299' if can_compile() else '0.0300'} Nm at 8 to 16 Hz",
    "satellite": "largest torque 0.725 N m",
    "rendezvous": f"solved by method {'structured' if can_compile() else 'convex'}",
    "inverter": "10 of 96 samples between levels; no more than 10 are needed",
    "wave_energy": "force  1000 N: mean power 58.75533 W",
    "learned_cost": "load 4.96 (5), load speed 0.496 (0.5), target 0.400 m (0.4)",
    "which_hull": "20 N/m softer: 0.06506 W by the derivative",
    "measured_buoy": "position of the worst plant 145.0 of 145 mm",
    "stepping_stones": "cost 0.774167, no trajectory below 0.77416",
    "price_of_bandwidth": "cutoff_hz = 48  optimal, cost 2881.05",
    "infeasible": "with 5.54 N instead of 5 N",
    "many_initial_states": "all proven: True",
    "suspension": "with the stop band: cost 6.85887",
    "scanner": "largest error 28 nm of 8000 nm",
    "gantry": "no shorter one exists: True",
    "three_axes": "122 is feasible; each of 100 to 121 is proven infeasible",
    "patterns": " 0.5  16          1.78075     1.78075   5.0e-07",
    "shaper_from_a_test": "no shaper shorter than 26.5 ms keeps 5 %",
    "input_shaper": "no shaper shorter than 21.7 ms keeps 5 %",
    "switching_angles": "angles [deg] [24.655 29.975 40.054 48.274 55.639]",
    "swing_up": "locally_optimal: cost 42.591339; satisfied",
    "obstacles": "constrained  within a disc by 0.0000 m^2, ends 0.000 m away",
    "gusts": "for all gusts   500 winds reach 104.0 cm, the worst gusts 104.0 cm of 104.0",
    "wall": "cost      95.820020, no trajectory below 95.82001",
}


SHORTER = {
    "gantry": {"(12.3, 31.0)": "(12.3,)", "0.001,": "0.005,", "horizon=450": "horizon=90", "jerk = 2.0": "jerk = 10.0"},
    "infeasible": {"period, horizon = 0.01, 240": "period, horizon = 0.03, 80"},
    "inverter": {"node_limit=50": "node_limit=1"},
    "kinks": {"tolerance=1e-3": "tolerance=0.1"},
    "minimum_time": {"horizons=(20, 120)": "horizons=(113, 115)"},
    "oscillating_mass": {"STEPS, SEED, SAMPLING = 300, ": "STEPS, SEED, SAMPLING = 30, ", "LATE = 100": "LATE = 25"},
    "two_mass_drive": {"SAMPLING, STEPS, LENGTH = 0.005, 600, 100": "SAMPLING, STEPS, LENGTH = 0.005, 150, 100"},
    "receding_horizon": {"STEPS, LATE, SEED = 120, 80, ": "STEPS, LATE, SEED = 30, 25, "},
}
"""What a test runs in place of texts: fewer steps, and less accuracy, take the same way."""


@pytest.fixture
def written(tmp_path):
    """Return a function that returns the path of an example, or of its shorter version."""
    folder = tmp_path / "examples"
    folder.mkdir()

    def write(example):
        if example.stem not in SHORTER:
            return example
        text, path = example.read_text(encoding="utf-8"), folder / example.name
        for long, short in SHORTER[example.stem].items():
            assert long in text
            text = text.replace(long, short)
        path.write_text(text, encoding="utf-8")
        return path

    return write


@expensive
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)  # the site runs all
def test_example(example, written, tmp_path, monkeypatch, capsys):
    (tmp_path / "run").mkdir()
    monkeypatch.chdir(tmp_path / "run")
    matplotlib.use("agg")
    runpy.run_path(str(written(example)), run_name="__main__")
    plt.close("all")
    said = capsys.readouterr().out
    assert SAYS[example.stem] in said
    if example.stem != "oscillating_mass_in_c" or can_compile():
        assert said.splitlines()[-1].startswith(f"picture: {example.stem}.png")
        assert [path.name for path in Path().iterdir()] == [f"{example.stem}.png"]
