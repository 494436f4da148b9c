"""Problem files name what formulas share, and what is long or deep: they grow with the number of nodes.

Values are compared with those of the formulas before, to the last bit, and with plain Python.
"""

import json
import tomllib

import numpy as np
import pytest
from jsonschema import Draft202012Validator

import lin_freq_ocp as lfo
from helpers.schemas import PROBLEM
from helpers.seeds import seeds
from lin_freq_ocp.formulas import nodes_in_order, values_of
from lin_freq_ocp.transform.hybrid import piecewise_smooth

SCHEMA = Draft202012Validator(PROBLEM)
POINTS = np.random.default_rng(0).uniform(-1, 1, (20, 3))


def problem_of(dynamics):
    return lfo.OptimalControlProblem(dynamics, 2, lfo.QuadraticCost(R=1.0), initial_state=np.zeros(dynamics.state_dim))


def written(dynamics, folder):
    """Return the dynamics read back, and the tables of the file, which the schema allows."""
    path = folder / "problem.toml"
    lfo.write_problem(problem_of(dynamics), path)
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    assert list(SCHEMA.iter_errors(tables)) == []
    return piecewise_smooth(lfo.read_problem(path)), tables["dynamics"]


def nodes(dynamics):
    return len(nodes_in_order([one for mode in dynamics.modes for one in (*mode.f, *mode.region)]))


def shared(levels, branched=False):
    """Return a formula in which every level stands twice in the next: 2^levels terms, levels nodes."""

    def f(x, u):
        one = x[0] + 0.5 * u[0]
        for _ in range(levels):
            one = np.sin(one) * 0.5 + np.tanh(one) * 0.25 + 0.1 * x[1]
        return [lfo.maximum(one, 0.0) + x[1] if branched else one, x[0] * one]

    return f


@pytest.mark.parametrize("branched", [False, True])
def test_what_formulas_share_is_written_once(tmp_path, branched):
    sizes = []
    for levels in (20, 40):
        dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(shared(levels, branched), 2, 1)
        again, table = written(dynamics, tmp_path)
        sizes.append(len(json.dumps(table)))
        assert nodes(dynamics) <= nodes(again) <= nodes(dynamics) + 8  # constants and short sums may stand twice
        assert "let" in table
        for mine, theirs in zip(dynamics.modes, again.modes, strict=True):
            np.testing.assert_array_equal(values_of(mine.f, POINTS), values_of(theirs.f, POINTS))
            np.testing.assert_array_equal(values_of(mine.region, POINTS), values_of(theirs.region, POINTS))
    assert sizes[1] < 2.2 * sizes[0]


def test_a_run_of_shared_formulas_is_dumped_and_loaded(tmp_path):
    problem = problem_of(lfo.PiecewiseSmoothDynamics.from_formulas(shared(25), 2, 1))
    lfo.solve(problem, method="nonsmooth", throw=False).dump(tmp_path / "run.zip")
    again = piecewise_smooth(lfo.load_run(tmp_path / "run.zip").problem)
    assert nodes(again) == nodes(piecewise_smooth(problem))


def deep(x, u):
    one = x[0]
    for k in range(1500):
        one = np.sin(one) if k % 2 else 1.001 * one + 0.001
    return [one + u[0], x[1]]


def product(x, u):
    one = x[0]
    for k in range(300):
        one = one * (1 + 0.001 * k * x[1] * u[0])
    return [one, x[1]]


def long(x, u):
    return [sum(np.sin((k + 1) * x[0]) / (k + 1) for k in range(1200)) + 0.5, x[1]]


def wide(x, u):
    return [lfo.norm([x[0] + k * 0.01 + 1 for k in range(300)]), x[1]]


@pytest.mark.parametrize("f", seeds([deep, product, long, wide]))
def test_deep_and_long_formulas_are_written_and_read(tmp_path, f):
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(f, 2, 1)
    again, table = written(dynamics, tmp_path)
    assert nodes(again) == nodes(dynamics)
    np.testing.assert_array_equal(values_of(again.modes[0].f, POINTS), values_of(dynamics.modes[0].f, POINTS))
    assert max(map(len, [*table.get("let", {}).values(), *table["modes"][0]["f"]])) < 10_000
    assert len(repr(dynamics.modes[0].f[0])) < 3000


def test_short_formulas_stand_as_they_are(tmp_path):
    f = ["abs(x_0) + sin(x_0 * u_0)", "(x_0 + u_0) * sin(x_0 + u_0) + (x_0 + u_0) / (2 + x_1**2)"]
    _, table = written(lfo.PiecewiseSmoothDynamics.from_formulas(f, 2, 1), tmp_path)
    assert "let" not in table


def dynamics_with(**table):
    head = {"schema": 1, "horizon": 2, "cost": {}}
    from lin_freq_ocp.files import problem_from_tables

    return piecewise_smooth(problem_from_tables({**head, "dynamics": {"control_dim": 1, **table}}))


def test_named_formulas_may_use_those_before_them():
    let = {"drag": 0.5, "speed": "x_1 + 0.1 * u_0", "force": "drag * speed * abs(speed)"}
    dynamics = dynamics_with(let=let, f=["x_0 + 0.1 * speed", "speed - force"])
    assert len(dynamics.modes) == 2
    for x, u in ((np.array([0.3, -1.0]), np.array([2.0])), (np.array([0.3, 1.5]), np.array([-1.0]))):
        speed = x[1] + 0.1 * u[0]
        expected = [x[0] + 0.1 * speed, speed - 0.5 * speed * abs(speed)]
        np.testing.assert_allclose(dynamics.stepper(1)(0, x, u), expected, rtol=1e-14)


def test_modes_share_named_formulas():
    modes = [{"f": ["w"], "region": ["w"]}, {"f": ["0.5 * w"], "region": ["-w"]}]
    first, second = dynamics_with(let={"w": "sin(x_0) * u_0"}, modes=modes).modes
    assert first.f[0] is first.region[0] is second.f[0].arguments[0] is second.region[0].arguments[0]


@pytest.mark.parametrize(
    ("let", "field", "words"),
    [
        ({"a": "b + x_0", "b": "x_0"}, "dynamics.let.a", "'b'"),
        ({"x_0": "u_0"}, "dynamics.let.x_0", "the name of a signal"),
        ({"sin": "u_0"}, "dynamics.let.sin", "the name of a signal or a function"),
        ({"1a": "u_0"}, "dynamics.let", "names of letters"),
        ({"lambda": "u_0"}, "dynamics.let", "names of letters"),
        ({"a": ["u_0"]}, "dynamics.let.a", "a formula in quotes, or a number"),
        ({"a": True}, "dynamics.let.a", "a formula in quotes, or a number"),
        ({"a": "import os"}, "dynamics.let.a", "numbers, x_0"),
        (["u_0"], "dynamics.let", "a table of formulas by name"),
    ],
)
def test_bad_named_formulas_are_refused_by_name(let, field, words):
    with pytest.raises(lfo.errors.ProblemError, match=words) as caught:
        dynamics_with(let=let, f=["a"])
    assert caught.value.field == field


def test_linear_dynamics_have_no_named_formulas():
    with pytest.raises(lfo.errors.ProblemError, match="an unknown key"):
        dynamics_with(let={}, A=[[1.0]], B=[[1.0]])
