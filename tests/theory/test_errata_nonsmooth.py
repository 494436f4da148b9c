"""The slips of the paper in its Examples 2 and 3, each proved; docs/errata.md tells of them."""

from __future__ import annotations

from math import exp

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.known_optima import solved
from helpers.seeds import expensive
from lin_freq_ocp import library
from lin_freq_ocp.formulas import jets_of

R, L, TC, I_REF = 2.0, 1e-3, 2.5e-4, 1.0
POLE, A = I_REF * R, exp(-R * TC / L)


def norm_optimum() -> lfo.results.Result:
    return solved(library.norm_dynamics, {"initial_state": (1.0, 0.0), "horizon": 3})


def buck_optimum(case: str) -> lfo.results.Result:
    given = {
        "usual": {"horizon": 4},
        "as posed": {"horizon": 8, "v_min": None, "v_max": None},
        "wrong sign": {"horizon": 3, "initial_state": [0.8281718171540953], "terminal_state": None},
        "end": {"horizon": 4, "terminal_state": None, "terminal_price": -40.0},
    }
    return solved(library.buck_converter, given[case])


def jacobian_in_x(x: np.ndarray, u: float, entry: float) -> np.ndarray:
    """Return [[entry, 0], [u x1/|x|, u x2/|x|]]."""
    unit = x / np.linalg.norm(x)
    return np.array([[entry, 0.0], [u * unit[0], u * unit[1]]])


# --- Example 2 --------------------------------------------------------------------------------------------------------


def test_the_adjoint_equation_of_the_norm_example():
    """Printed: + 2 eta_C x_t and the entry u of the first row (1 times u); right: - 2 eta_C x_t and 1 - u."""
    result = norm_optimum()
    x, u, eta = result.trajectory.x, result.trajectory.u[:, 0], result.multipliers.eta
    for t in (1, 2):
        right = eta[t - 1] - (-2 * x[t] + jacobian_in_x(x[t], u[t], 1 - u[t]).T @ eta[t])
        printed = eta[t - 1] - (2 * x[t] + jacobian_in_x(x[t], u[t], u[t]).T @ eta[t])
        assert np.abs(right).max() < 1e-10
        assert np.abs(printed).max() > 0.1


def test_the_transversality_of_the_norm_example():
    """Printed is a condition at the fixed x_0, which has none; missing is eta_{T-1} = 0 at the free end."""
    result = norm_optimum()
    x, u, eta = result.trajectory.x, result.trajectory.u[:, 0], result.multipliers.eta
    printed = 2 * x[0] + jacobian_in_x(x[0], u[0], u[0]).T @ eta[0]
    assert np.abs(printed).max() > 0.1
    np.testing.assert_allclose(eta[-1], 0.0, atol=1e-12)


def test_the_maximum_of_the_norm_example():
    """Printed: 2 u = <eta, (-1, |x|)>; right: u = clip(<eta, (-x1, |x|)>/2, 0, 1)."""
    result = norm_optimum()
    x, u, eta = result.trajectory.x, result.trajectory.u[:, 0], result.multipliers.eta
    slopes = np.stack([-x[:-1, 0], np.linalg.norm(x[:-1], axis=1)], axis=1)
    np.testing.assert_allclose(u, np.clip((eta * slopes).sum(axis=1) / 2, 0, 1), atol=1e-10)
    printed = (eta * np.stack([-np.ones(3), slopes[:, 1]], axis=1)).sum(axis=1) / 2
    assert np.abs(u - printed).max() > 0.01


# --- Example 3 --------------------------------------------------------------------------------------------------------


def second_mode(i: float, v: float) -> float:
    return POLE * A * -i / (v - POLE) + I_REF * A * v / (v - POLE)


def test_the_derivative_of_the_second_mode_by_the_voltage():
    """Printed: (c i + d r)/(v - r)^2, above zero; right: (c i - d r)/(v - r)^2, below zero."""
    c, d, h = POLE * A, I_REF * A, 1e-6
    for i, v in ((0.95, 2.4), (0.9, 3.0)):
        slope = (second_mode(i, v + h) - second_mode(i, v - h)) / (2 * h)
        assert slope == pytest.approx((c * i - d * POLE) / (v - POLE) ** 2, rel=1e-6)
        assert slope < 0 < (c * i + d * POLE) / (v - POLE) ** 2
        mode = library.buck_converter().dynamics.modes[1]
        assert jets_of(mode.f, np.array([[i, v]])).slopes[0, 0, 1] == pytest.approx(slope, rel=1e-6)


def test_the_cases_of_the_maximum_are_swapped():
    """The first mode holds for v <= v_b(i); the printed condition takes the second mode's derivative there."""
    result = buck_optimum("usual")
    x, u, eta = result.trajectory.x[:, 0], result.trajectory.u[:, 0], result.multipliers.eta[:, 0]
    border = R / (1 - 1 / A) * (x[:-1] - I_REF / A)
    np.testing.assert_array_equal(u > border, result.sequence == 1)
    free = (u > 2.2 + 1e-6) & (u < 6 - 1e-6)
    assert free.any()
    b, c, d = (1 - A) / R, POLE * A, I_REF * A
    for t in np.flatnonzero(free):
        first, second = b * eta[t] / 2, (c * x[t] - d * POLE) / (u[t] - POLE) ** 2 * eta[t] / 2
        right, swapped = (first, second) if u[t] < border[t] else (second, first)
        assert u[t] == pytest.approx(right, rel=1e-8)
        assert abs(u[t] - swapped) > 0.1


def test_the_intervals_at_the_border_need_an_adjoint_above_zero():
    """With eta_t < 0 the printed interval at i = i_b(v) is empty, at a global optimum."""
    result = buck_optimum("wrong sign")
    facts, t = result.certificate.borders, 1
    eta, v = result.multipliers.eta[t, 0], result.control[t, 0]
    assert t in facts.times
    assert eta < -1
    assert -POLE * eta / (v - POLE) > eta  # lower end above upper end
    assert facts.joint


def test_c_is_a_r_without_losses_only():
    for diode in (0.0, 0.2):
        c = R * I_REF * exp(-(R + diode) * TC / L)
        assert (c == pytest.approx(A * POLE, rel=1e-12)) == (diode == 0)


@expensive
def test_the_last_adjoint_has_the_index_of_the_last_control():
    """Printed: eta_T = -mu_T; there is no eta_T, and eta_{T-1} = -mu_T (with a cost p i_T: -p - mu_T)."""
    result = buck_optimum("usual")
    assert result.multipliers.eta.shape == (4, 1)
    assert result.multipliers.eta[-1] == pytest.approx(-result.multipliers.mu[-1], rel=1e-10)
    free = buck_optimum("end")
    assert free.multipliers.eta[-1] == pytest.approx(40 - free.multipliers.mu[-1], rel=1e-8)


@expensive
def test_as_posed_the_second_mode_is_never_used():
    """Without a lower bound on v it is a quadratic program: the first mode makes the same i+ of a smaller v."""
    result = buck_optimum("as posed")
    assert (result.sequence == 0).all()
    linear = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[A]], [[(1 - A) / R]]),
        8,
        lfo.QuadraticCost(Q=2.0, R=2.0),
        state_set=lfo.Box(0, I_REF),
        initial_state=[0.65],
        terminal_state=[0.8],
    )
    assert lfo.solve(linear).cost == pytest.approx(result.cost, rel=1e-9)
    rng = np.random.default_rng(0)
    for i, v in zip(rng.uniform(0, 1, 200), rng.uniform(2.05, 8, 200), strict=True):
        if i > (I_REF - v / R) / A + v / R:
            reached = second_mode(i, v)
            assert (reached - A * i) * R / (1 - A) < v
