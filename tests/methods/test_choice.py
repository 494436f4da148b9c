"""Which method "auto" takes for linear dynamics, and what it says of it."""

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo


def varying(horizon):
    """A time-varying integrator with a wide stop band: about 0.8 T dense rows."""
    B = 0.1 * (1 + 0.3 * np.sin(np.arange(horizon)))[:, None, None]
    dynamics = lfo.LinearDynamics(np.ones((horizon, 1, 1)), B)
    band = lfo.low_pass(0.2 * np.pi)
    cost = lfo.QuadraticCost(Q=0.1, R=1.0)
    return lfo.OptimalControlProblem(dynamics, horizon, cost, initial_state=[1.0], control_spectrum=band)


@pytest.mark.parametrize(
    ("problem", "method", "reason"),
    [
        (lfo.library.double_integrator(), "spectral", "time-invariant dynamics"),
        (varying(30), "convex", "the Fourier-domain method does not take it (A or B depends on time"),
        (varying(420), "structured", "dense rows"),
    ],
)
def test_auto_takes_the_measured_method_and_says_why(problem, method, reason):
    result = lfo.solve(problem)
    assert result.method == method
    assert reason in result.reason
    assert "Use method" not in result.reason
    assert f"method    {result.solver}: " in str(result)


def test_who_asks_for_a_method_is_told_no_reason():
    assert lfo.solve(lfo.library.double_integrator(), method="structured").reason == ""


def test_stiff_and_soft_rows_of_a_fine_mask_are_solved_apart():
    mask = lfo.MagnitudeBound(0.05218, bins=range(97, 144), oversampling=4, between=True)
    result = lfo.solve(replace(lfo.library.pendulum(), control_spectrum=mask), method="structured")
    assert result.status == "optimal"
    assert abs(result.gap) < 1e-9
    assert result.cost == pytest.approx(3513.6986165, rel=1e-9)
