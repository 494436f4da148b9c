"""Problems over a frequency response in files: to the last bit, with a CSV beside, and results of them."""

import re

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.errors import ProblemError

FILE = """
schema = 1
horizon = 8
[dynamics]
table = {csv = "plant.csv"}
samples = 8
sampling_time = 1.0
disturbance = [[1.0], [2.0], [0.0], [0.0], [1.0], [0.0], [0.0], [0.0]]
[cost]
Q = 1.0
R = 1.0
"""


def test_to_the_last_bit(tmp_path):
    for force in (2000.0, None):
        problem = lfo.library.wave_energy(force=force)
        lfo.write_problem(problem, tmp_path / "wave.toml")
        again = lfo.read_problem(tmp_path / "wave.toml")
        assert np.array_equal(again.dynamics.G, problem.dynamics.G)
        assert np.array_equal(again.dynamics.offset, problem.dynamics.offset)
        assert (again.dynamics.mode, again.dynamics.state_names) == ("periodic", ("velocity [m/s]",))
    assert lfo.solve(again).cost == lfo.solve(problem).cost


@pytest.mark.parametrize("mode", ["periodic", "zero-padded"])
def test_disturbances_and_modes_are_kept(tmp_path, mode):
    samples = 8 if mode == "periodic" else 9
    dynamics = lfo.FrequencyResponse(np.ones(5 if samples == 8 else 9), disturbance=np.arange(samples), mode=mode)
    lfo.write_problem(lfo.OptimalControlProblem(dynamics, 8, lfo.QuadraticCost(R=1.0)), tmp_path / "p.toml")
    again = lfo.read_problem(tmp_path / "p.toml").dynamics
    assert (again.mode, again.disturbance[:, 0].tolist()) == (mode, list(range(samples)))


def test_a_table_beside_the_file(tmp_path):
    (tmp_path / "plant.csv").write_text("f,re,im\n0,1,0\n0.5,0.5,0\n")
    (tmp_path / "p.toml").write_text(FILE)
    problem = lfo.read_problem(tmp_path / "p.toml")
    assert problem.dynamics.G[:, 0, 0].tolist() == [1, 0.875, 0.75, 0.625, 0.5]
    assert lfo.solve(problem).certificate.globally_optimal
    (tmp_path / "p.toml").write_text(FILE.replace("plant.csv", "missing.csv"))
    with pytest.raises(ProblemError, match=r"p.toml: dynamics.table.csv: got no such file"):
        lfo.read_problem(tmp_path / "p.toml")
    (tmp_path / "p.toml").write_text(FILE.replace("plant.csv", "../plant.csv"))
    with pytest.raises(ProblemError, match=re.escape("p.toml: dynamics.table.csv: got '../plant.csv'")):
        lfo.read_problem(tmp_path / "p.toml")


def test_parts_of_different_shapes_are_named(tmp_path):
    text = FILE.replace('table = {csv = "plant.csv"}\nsamples = 8', "G_real = [1.0, 1.0]\nG_imag = [0.0]")
    (tmp_path / "p.toml").write_text(text)
    with pytest.raises(ProblemError, match=re.escape("dynamics.G_imag: got shape (1,); expected that of G_real, (2,)")):
        lfo.read_problem(tmp_path / "p.toml")


def test_results_are_loaded_with_their_multipliers(tmp_path):
    result = lfo.solve(lfo.library.wave_energy())
    result.save(tmp_path / "wave.npz")
    saved = lfo.load(tmp_path / "wave.npz")
    certificate = lfo.certify(result.problem, saved)
    assert certificate.globally_optimal
    assert certificate.pmp == "satisfied"
