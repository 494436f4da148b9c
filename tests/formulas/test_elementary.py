"""Elementary functions of formulas: values, derivatives, enclosures, text, and CasADi's."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.formulas import exact_text
from lin_freq_ocp.formulas import formula_from_text, interval_jets, jets_of, scalar_functions, values_of

X, U = lfo.signals(1, 1)
CENTRES = {"log": 1.0, "sqrt": 1.0}  # the others are defined from -0.9 to 0.9


@pytest.mark.parametrize("name", list(scalar_functions()))
def test_a_function_has_its_derivatives_and_enclosures(name):
    function = getattr(np, name)
    formula = function(0.45 * (X[0] + U[0]) + CENTRES.get(name, 0.0))
    rng, h = np.random.default_rng(0), 1e-5
    y = rng.uniform(-0.95, 0.95, (200, 2))
    found = jets_of([formula], y)
    expected = function(0.45 * y[:, 0] + 0.45 * y[:, 1] + CENTRES.get(name, 0.0))
    np.testing.assert_allclose(found.values[:, 0], expected, rtol=1e-12, atol=1e-14)
    for j, step in enumerate(h * np.eye(2)):
        above, below = jets_of([formula], y + step), jets_of([formula], y - step)
        np.testing.assert_allclose((above.values - below.values) / (2 * h), found.slopes[..., j], rtol=1e-6, atol=1e-7)
        differences = (above.slopes - below.slopes) / (2 * h)
        np.testing.assert_allclose(differences, found.curvatures[..., j], rtol=1e-5, atol=1e-6)
    r = rng.choice([0.0, 1e-3, 0.3], (200, 1))
    boxes, inside = interval_jets([formula], y - r, y + r), y + r * rng.uniform(-1, 1, y.shape)
    at = jets_of([formula], inside)
    defined = np.isfinite(at.values[:, 0])
    for part in ("values", "slopes", "curvatures"):
        (lower, upper), values = getattr(boxes, part), getattr(at, part)
        assert (lower <= values)[defined].all()
        assert (upper >= values)[defined].all()
    thin = interval_jets([formula], y, y)
    np.testing.assert_allclose(thin.values[1] - thin.values[0], 0.0, atol=1e-12)


@pytest.mark.parametrize("name", list(scalar_functions()))
def test_boxes_beyond_the_domain_hold_what_is_defined(name):
    formula = getattr(np, name)(X[0])
    rng = np.random.default_rng(1)
    centre, r = rng.uniform(-4, 4, (300, 1)), rng.choice([1e-3, 0.5, 3.0], (300, 1))
    lower, upper = np.hstack([centre - r, 0 * r]), np.hstack([centre + r, 0 * r])
    boxes, at = (
        interval_jets([formula], lower, upper),
        jets_of([formula], lower + rng.random((300, 1)) * (upper - lower)),
    )
    defined = np.isfinite(at.values[:, 0]) & np.isfinite(at.slopes).all(axis=(1, 2))
    for part in ("values", "slopes", "curvatures"):
        low, high = getattr(boxes, part)
        values = getattr(at, part)
        assert (low <= values)[defined].all()
        assert (high >= values)[defined].all()


def test_an_angle_has_its_quadrant():
    formula = np.arctan2(X[0], U[0])
    y, h = np.random.default_rng(2).normal(size=(50, 2)), 1e-5
    found = jets_of([formula], y)
    np.testing.assert_array_equal(found.values[:, 0], np.arctan2(y[:, 0], y[:, 1]))
    for j, step in enumerate(h * np.eye(2)):
        above, below = jets_of([formula], y + step), jets_of([formula], y - step)
        differences = (above.slopes - below.slopes) / (2 * h)
        np.testing.assert_allclose(differences, found.curvatures[..., j], rtol=1e-4, atol=1e-4)
        away = (np.abs(y[:, 0]) > 2 * h) | (y[:, 1] > 0)  # it jumps at the negative half of the axis
        slopes = (above.values - below.values)[away, 0] / (2 * h)
        np.testing.assert_allclose(slopes, found.slopes[away, 0, j], rtol=1e-4, atol=1e-6)
    assert exact_text(formula) == "arctan2(x_0, u_0)"
    again = formula_from_text("f", "arctan2(1, x_0) + arctan2(x_0, 2) + arctan2(1, -1) + arctan2(x_0, u_0)", (1, 1))
    expected = np.arctan2(1, y[:, 0]) + np.arctan2(y[:, 0], 2) + 0.75 * np.pi + found.values[:, 0]
    np.testing.assert_allclose(values_of([again], y)[:, 0], expected)
    assert np.isnan(values_of([formula], np.zeros((1, 2)))).all()
    with pytest.raises(lfo.errors.UnsupportedError, match="write it with arctan"):
        interval_jets([formula], y, y)


def test_hypot_is_a_norm():
    assert np.hypot(X[0], U[0]).kind == "norm"


def test_elementary_functions_of_casadi_are_formulas():
    casadi = pytest.importorskip("casadi")

    def f(x, u):
        a, b = x[0], u[0]
        functions = "tan", "sinh", "cosh", "asin", "acos", "asinh", "atanh"
        return sum(getattr(casadi, name)(0.3 * a) * b for name in functions) + casadi.atan2(a, 2 + b)

    made, y = lfo.from_casadi(f, 1, 1), np.array([[0.7, -0.4]])
    (formula,) = made(X, U)
    assert formula.function is None
    np.testing.assert_allclose(values_of([formula], y)[0], made([0.7], [-0.4]), rtol=1e-14)


def test_maxima_in_the_formulas_of_a_mode_make_modes():
    left = lfo.dynamics.SmoothMode(["max(x_0, u_0) - 1"], region=["x_0"], name="left")
    right = lfo.dynamics.SmoothMode(["x_0 - 1 + max(u_0, 0) - x_0*max(0, 1)"], region=["-x_0"], name="right")
    dynamics = lfo.PiecewiseSmoothDynamics([left, right], 1, 1)
    assert dynamics.mode_names == ("left, max 0", "left, max 1", "right, max 0", "right, max 1")
    problem = lfo.OptimalControlProblem(dynamics, 1, lfo.QuadraticCost(R=1.0), initial_state=[0.0])
    for x, u in np.random.default_rng(3).uniform(-1, 1, (40, 2)):
        expected = max(x, u) - 1 if x <= 0 else max(u, 0) - 1
        assert lfo.simulate(problem, [[u]], [x]).x[1, 0] == pytest.approx(expected, abs=1e-15)
