"""Joint rows in problem and solution files."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.stage_rows import cart
from lin_freq_ocp.certificate import judge


def test_problem_and_solution_survive_their_files(tmp_path, two_families):
    two_families.save(tmp_path / "run.npz")
    lfo.write_problem(two_families.problem, tmp_path / "problem.toml")
    saved, problem = lfo.load(tmp_path / "run.npz"), lfo.read_problem(tmp_path / "problem.toml")
    for one, other in zip(problem.stage_rows, two_families.problem.stage_rows, strict=True):
        assert one.name == other.name
        assert all(np.array_equal(getattr(one, field), getattr(other, field)) for field in "CDe")
    assert np.isinf(problem.stage_rows[0].e).any()
    certificate = judge(problem, saved.trajectory, saved.multipliers)
    assert certificate.pmp == "satisfied"
    assert certificate.lower_bound == two_families.lower_bound
    with np.load(tmp_path / "run.npz") as arrays:
        for name, weights in two_families.multipliers.stage.items():
            assert (arrays[f"stage/{name}"] == weights).all()


@pytest.mark.parametrize(
    ("table", "place"),
    [
        ("[[stage_rows]]\nC = [[1.0, 0.0]]", "stage_rows[0].e: got nothing"),
        ("[[stage_rows]]\nC = [[1.0, 0.0]]\ne = [-inf]", "stage_rows[0].e[0]: got -inf"),
        ("[[stage_rows]]\nC = [[1.0]]\ne = [1.0]", "stage_rows[0].C: got shape (1, 1)"),
        ("[[stage_rows]]\nC = [[1.0, 0.0]]\ne = [1.0]\nF = 1", "stage_rows[0].F: got an unknown key"),
        ("[stage_rows]\ne = [1.0]", "stage_rows: got neither C nor D"),
    ],
)
def test_a_bad_table_is_refused_with_its_place(tmp_path, table, place):
    lfo.write_problem(cart(), tmp_path / "cart.toml")
    good = (tmp_path / "cart.toml").read_text(encoding="utf-8")
    (tmp_path / "cart.toml").write_text(good + table, encoding="utf-8")
    with pytest.raises(lfo.errors.ProblemError) as caught:
        lfo.read_problem(tmp_path / "cart.toml")
    assert f"cart.toml: {place}" in str(caught.value)
