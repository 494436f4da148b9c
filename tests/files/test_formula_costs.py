"""Problem files with costs by formulas and time: round trips, scripts, and bad tables."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.every_table import GOOD
from helpers.formula_costs import PUBLISHED
from lin_freq_ocp.files import problem_from_tables


def require_equal(one, other):
    """Assert that two problems have the same costs and the same successors."""
    rng = np.random.default_rng(0)
    x, u = rng.normal(size=(one.horizon + 1, one.state_dim)), rng.normal(size=(one.horizon, one.control_dim))
    assert one.value(x, u) == other.value(x, u)
    np.testing.assert_array_equal(lfo.simulate(one, u, x[0]).x, lfo.simulate(other, u, x[0]).x)


@pytest.mark.parametrize("name", list(PUBLISHED))
def test_a_file_states_costs_and_time_as_text(tmp_path, name):
    problem = PUBLISHED[name][0]()
    lfo.write_problem(problem, tmp_path / "problem.toml")
    assert 'kind = "formula"' in (tmp_path / "problem.toml").read_text()
    require_equal(problem, lfo.read_problem(tmp_path / "problem.toml"))


def test_long_formulas_share_their_parts(tmp_path):
    def stage(x, u):
        part = np.sin(x[0] * u[0] + 0.123456789) ** 2
        for _ in range(9):
            part = part * part + np.cos(part)
        return part

    cost = lfo.costs.SmoothCost(stage=stage, terminal=lambda x: np.cos(x[1]))
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics(np.eye(2), [[0.0], [1.0]]), 3, cost, initial_state=[1, 0])
    lfo.write_problem(problem, tmp_path / "problem.toml")
    text = (tmp_path / "problem.toml").read_text()
    assert "let" in text
    assert len(text) < 3000
    require_equal(problem, lfo.read_problem(tmp_path / "problem.toml"))


def stated(cost):
    return problem_from_tables(GOOD | {"cost": {"R": 1.0, "norms": cost}})


def test_a_table_may_name_parts():
    table = {"kind": "formula", "stage": "drag * t", "terminal": "drag", "let": {"v": "x_1 - 1", "drag": "v**2"}}
    problem = stated([{"kind": "L1", "u": 0.1}, table])
    x, u = np.arange(27.0).reshape(9, 3), np.zeros((8, 1))
    speed = (x[:, 1] - 1) ** 2
    assert problem.cost.formula_values(x, u).sum() == pytest.approx(speed[:-1] @ np.arange(8) + speed[-1])


@pytest.mark.parametrize(
    ("table", "field", "got"),
    [
        ({}, "cost.norms", "no formula"),
        ({"stage": "x_0 +"}, "cost.norms[0].stage", "x_0 +"),
        ({"stage": "x_9"}, "cost.norms[0].stage", "'x_9'"),
        ({"stage": 3}, "cost.norms[0].stage", "3"),
        ({"stage": ["x_0", "x_1"]}, "cost.norms[0].stage", "2 formulas"),
        ({"terminal": "abs(x_0)"}, "cost.norms[0].terminal", "a kink"),
        ({"terminal": "u_0"}, "cost.norms[0].terminal", "u_0"),
        ({"stage": "look_up(t, 1, 2)"}, "cost.norms[0].stage.look_up", "2 numbers"),
        ({"stage": "a", "let": {"a": "b"}}, "cost.norms[0].let.a", "'b'"),
        ({"stage": "x_0", "let": {"x_0": "1"}}, "cost.norms[0].let.x_0", "the name of a signal"),
        ({"stages": "x_0"}, "cost.norms.stages", "an unknown key"),
    ],
)
def test_a_bad_table_is_refused_by_its_key(table, field, got):
    with pytest.raises(lfo.errors.ProblemError) as caught:
        stated({"kind": "formula"} | table)
    assert field in caught.value.field
    assert got in caught.value.got


def test_a_function_without_a_formula_is_in_no_file():
    table = lfo.DifferentiableFunction(lambda x, u: [x[0] ** 2], lambda x, u: [[2 * x[0], 0, 0]], name="table")
    cost = lfo.costs.SmoothCost(stage=table)
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics(np.eye(2), [[0.0], [1.0]]), 3, cost, initial_state=[1, 0])
    with pytest.raises(lfo.errors.ProblemError, match="the function table"):
        lfo.write_problem(problem, "nowhere.toml")
