"""The table of operations: a function that is added to it is read, written, differentiated, enclosed and solved."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.formulas import exact_text
from lin_freq_ocp.formulas import (
    OPERATIONS,
    Formula,
    ScalarFunction,
    add,
    exponential,
    formula_from_text,
    interval_jets,
    inverse,
    jets_of,
    multiply,
    outward,
    read_definitions,
    scale,
    text_of,
    values_of,
)

X, U = lfo.signals(1, 1)


def slopes(a, value):
    """Return the derivatives of log(1 + e^a)."""
    slope = 1 / (1 + np.exp(-a))
    return slope, slope * (1 - slope)


def enclosures(a):
    """Return log(1 + e^a) and its derivatives s = 1/(1 + e^-a) and s^2 e^-a over an interval."""
    one = np.ones_like(a[0]), np.ones_like(a[0])
    value = outward(np.logaddexp(0, a[0]), np.logaddexp(0, a[1]))
    decay = exponential(scale(-1.0, a))[0]
    slope = inverse(add(one, decay))
    return value, slope, multiply(multiply(slope, slope), decay)


@pytest.fixture
def softplus(monkeypatch):
    function = ScalarFunction(lambda a: np.logaddexp(0, a), slopes, enclosures)
    monkeypatch.setitem(OPERATIONS, "softplus", function)
    return X[0] * 2 + X[0].softplus() * U[0]


def test_an_added_function_is_text(softplus):
    assert exact_text(softplus) == "2.0 * x_0 + softplus(x_0) * (u_0)"
    assert text_of(softplus) == "2 * x_0 + softplus(x_0) * (u_0)"
    y = np.random.default_rng(0).normal(size=(5, 2))
    again = formula_from_text("f", exact_text(softplus), (1, 1))
    np.testing.assert_array_equal(values_of([again], y), values_of([softplus], y))
    assert formula_from_text("f", "softplus(0)", (1, 1)).constant == np.log(2)
    with pytest.raises(lfo.errors.ProblemError, match="a signal or a function"):
        read_definitions("let", {"softplus": "x_0"}, (1, 1))


def test_an_added_function_has_derivatives_and_enclosures(softplus):
    y, h = np.random.default_rng(1).normal(size=(20, 2)), 1e-5
    found, boxes = jets_of([softplus], y), interval_jets([softplus], y - 0.1, y + 0.1)
    np.testing.assert_allclose(found.values[:, 0], 2 * y[:, 0] + np.log1p(np.exp(y[:, 0])) * y[:, 1], rtol=1e-12)
    for j, step in enumerate(h * np.eye(2)):
        above, below = jets_of([softplus], y + step), jets_of([softplus], y - step)
        np.testing.assert_allclose((above.values - below.values) / (2 * h), found.slopes[..., j], atol=1e-8)
        np.testing.assert_allclose((above.slopes - below.slopes) / (2 * h), found.curvatures[..., j], atol=1e-8)
    for inside, (lower, upper) in (
        (found.values, boxes.values),
        (found.slopes, boxes.slopes),
        (found.curvatures, boxes.curvatures),
    ):
        assert ((lower <= inside) & (inside <= upper)).all()


def test_a_problem_with_an_added_function_is_solved_and_saved(softplus, tmp_path):
    """To be at 0 after a step, u_0 = -0.5 softplus(1)."""
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(["0.5*softplus(x_0) + u_0"], 1, 1)
    ends = {"initial_state": [1.0], "terminal_state": [0.0]}
    problem = lfo.OptimalControlProblem(dynamics, 1, lfo.QuadraticCost(R=1.0), **ends)
    result = lfo.solve(problem, throw=False)
    assert result.cost == pytest.approx(0.5 * (0.5 * np.log1p(np.e)) ** 2, rel=1e-9)
    lfo.write_problem(problem, tmp_path / "problem.toml")
    assert "softplus(x_0)" in (tmp_path / "problem.toml").read_text()
    (mode,) = lfo.read_problem(tmp_path / "problem.toml").dynamics.modes
    assert exact_text(mode.f[0]) == exact_text(dynamics.modes[0].f[0])


def test_functions_that_are_not_in_the_table_are_refused():
    with pytest.raises(AttributeError, match="softplus"):
        X[0].softplus()
    with pytest.raises(TypeError):
        np.cbrt(X[0])
    assert isinstance(np.tanh(X)[0], Formula)
