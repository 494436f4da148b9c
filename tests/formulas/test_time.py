"""Formulas that depend on time: values, enclosures, text, dynamics, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.formulas import exact_text
from lin_freq_ocp.formulas import formula_from_text, interval_jets, jets_of, listed_formulas, values_of

MASSES = [2.0, -1.0, 0.5]


def traced():
    """Return (1 + t) x^2 + masses[t] sin(u) as a formula."""
    return listed_formulas("f", lambda t, x, u: (1 + t) * x[0] ** 2 + t.look_up(MASSES) * np.sin(u[0]), (1, 1))


def test_a_formula_is_that_of_its_time():
    y = np.random.default_rng(0).normal(size=(3, 2))
    expected = [(1 + t) * y[t, 0] ** 2 + MASSES[t] * np.sin(y[t, 1]) for t in range(3)]
    np.testing.assert_allclose(values_of(traced(), y)[:, 0], expected)
    np.testing.assert_allclose(jets_of(traced(), y).slopes[:, 0, 0], [2 * (1 + t) * y[t, 0] for t in range(3)])
    at = np.array([2])
    np.testing.assert_allclose(values_of(traced(), y[:1], at)[:, 0], 3 * y[0, 0] ** 2 + 0.5 * np.sin(y[0, 1]))


def test_an_enclosure_is_that_of_its_time_or_of_all():
    y = np.random.default_rng(1).normal(size=(20, 2))
    for time in range(3):
        values = values_of(traced(), y, np.array([time]))
        for found in (interval_jets(traced(), y, y, time=time), interval_jets(traced(), y, y)):
            assert (found.values[0] <= values + 1e-12).all()
            assert (found.values[1] >= values - 1e-12).all()
    assert np.isinf(interval_jets(traced(), y, y).values[1]).all()  # t has no end of its own


def test_a_formula_of_time_is_text():
    text = exact_text(traced()[0])
    assert "look_up(t, 2.0, -1.0, 0.5)" in text
    y = np.random.default_rng(2).normal(size=(3, 2))
    again = formula_from_text("f", text, (1, 1))
    np.testing.assert_array_equal(values_of([again], y), values_of(traced(), y))


def test_linear_dynamics_per_time_are_formulas_of_time():
    rng = np.random.default_rng(3)
    A, B = rng.normal(size=(8, 2, 2)), rng.normal(size=(8, 2, 1))

    def f(t, x, u):
        return [sum(t.look_up(A[:, i, j]) * x[j] for j in range(2)) + t.look_up(B[:, i, 0]) * u[0] for i in range(2)]

    stated = {"horizon": 8, "cost": lfo.QuadraticCost(Q=1.0, R=0.1, P=2.0), "initial_state": [1.0, -1.0]}
    linear = lfo.solve(lfo.OptimalControlProblem(lfo.LinearDynamics(A, B), **stated))
    smooth = lfo.OptimalControlProblem(lfo.PiecewiseSmoothDynamics.from_formulas(f, 2, 1), **stated)
    found = lfo.solve(smooth, "nonsmooth")
    assert found.certificate.pmp == "satisfied"
    assert found.cost == pytest.approx(linear.cost, rel=1e-9)
    np.testing.assert_allclose(lfo.simulate(smooth, linear.trajectory.u).x, linear.trajectory.x, atol=1e-9)


@pytest.mark.parametrize(
    ("f", "got"),
    [
        (lambda t, x, u: x[0] * t.look_up([1.0, 2.0]), "2 numbers; expected 3"),
        (lambda t, x, u: x[0].look_up([1.0]), "expected the time t"),
        (lambda t, x, u: x[0] * t.look_up([[1.0]]), "numbers in a row"),
        (lambda t, x, u: x[0] * t.look_up([]), "numbers in a row"),
        ("look_up(x_0, 1)", "the time t"),
        ("look_up(t, x_0)", "expected numbers, x_0"),
        ("look_up(t)", "expected numbers, x_0"),
        ("sinn(x_0)", "got the function 'sinn'; expected one of abs, max, .* Did you mean 'sin'"),
        ("x_0^2", r"A power is written x_0\*\*2"),
        ("x0 + t", "got 'x0'; expected one of x_0, u_0, t. Did you mean 'x_0'"),
        ("x_9 + t", "got 'x_9'; expected one of x_0, u_0, t.$"),
    ],
)
def test_what_is_no_table_over_time_is_refused(f, got):
    def state():
        dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(f, 1, 1)
        lfo.OptimalControlProblem(dynamics, 3, lfo.QuadraticCost(R=1.0), initial_state=[0.0])

    with pytest.raises(lfo.errors.ProblemError, match=got):
        state()


@pytest.mark.parametrize(
    "function",
    [
        lambda x, u: x[0] - 2 * u[0],
        lambda u, x: x[0] - 2 * u[0],
        lambda state, control: state[0] - 2 * control[0],
        lambda state, u: state[0] - 2 * u[0],
        lambda u, state: state[0] - 2 * u[0],
        lambda control, x: x[0] - 2 * control[0],
        lambda u, t, x: x[0] - 2 * u[0] + 0 * t,
        lambda state, t, control: state[0] - 2 * control[0] + 0 * t,
        lambda u, x, factor=2: x[0] - factor * u[0],
        lambda *signals: signals[0][0] - 2 * signals[1][0],
        lambda x, *rest: x[0] - 2 * rest[0][0],
    ],
)
def test_a_function_gets_signals_by_the_names_of_its_parameters_and_others_by_position(function):
    np.testing.assert_allclose(values_of(listed_formulas("f", function, (1, 1)), np.array([[5.0, 1.0]])), [[3.0]])


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (lambda x: 3 * x[0], 15.0),
        (lambda u: 3 * u[0], 3.0),
        (lambda t, u: t + u[0], 1.0),
        (lambda x, factor=2: factor * x[0], 10.0),
        (lambda u, factor=2, offset=1: factor * u[0] + offset, 3.0),
    ],
)
def test_a_function_may_take_some_of_the_signals_by_their_names(function, expected):
    np.testing.assert_allclose(values_of(listed_formulas("f", function, (1, 1)), np.array([[5.0, 1.0]])), [[expected]])


@pytest.mark.parametrize(
    ("function", "got"),
    [
        (lambda state: state[0], "missing a required argument: 'state'"),
        (lambda x, u, more: x[0], "missing a required argument: 'more'"),
        (lambda x, u, factor=2, t=0: x[0] * factor + t, "t after a parameter with a default"),
        (lambda x, factor=2, u=0: x[0] * factor + u, "u after a parameter with a default"),
    ],
)
def test_a_function_that_takes_no_signals_is_refused(function, got):
    with pytest.raises(lfo.errors.ProblemError, match=f"f: got TypeError: {got}, from the function"):
        listed_formulas("f", function, (1, 1))
