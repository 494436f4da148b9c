"""Convexity of costs over a frequency response, bin by bin."""

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.transform import bin_curvature


def power_problem(G, **named):
    """Return the problem of least average power sum y_t u_t over a period of 16 samples of 0.5 s."""
    dynamics = lfo.FrequencyResponse(G, 0.5)
    return lfo.OptimalControlProblem(dynamics, 16, lfo.QuadraticCost(S=[[1.0]]), lfo.Box(-1, 1), **named)


def test_bins_that_are_not_passive_are_named():
    G = np.ones(9, dtype=complex)
    G[[3, 5]] = -1e-6 + 1j, -0.5
    with pytest.raises(
        UnsupportedError, match=r"at 2 bins .*: 3 \(0.375 Hz\) and 5 \(0.625 Hz\).*eigenvalue -1 at bin 5"
    ):
        lfo.solve(power_problem(G))


def test_what_the_message_advises_helps():
    G = np.ones(9, dtype=complex)
    G[3] = -1.0
    for problem in (power_problem(np.maximum(G.real, 0)), power_problem(G, control_spectrum=lfo.stop_band(bins=[3]))):
        assert lfo.solve(problem).certificate.globally_optimal


def test_a_cost_of_the_control_makes_up_for_it():
    G = np.full(9, -0.5)
    problem = power_problem(G)
    with pytest.raises(UnsupportedError, match="cost: not convex in the controls at 9 bins"):
        lfo.solve(problem)
    enough = lfo.QuadraticCost(S=[[1.0]], R=1.0)
    assert lfo.solve(lfo.OptimalControlProblem(problem.dynamics, 16, enough)).cost == pytest.approx(0, abs=1e-9)


def test_the_curvature_is_that_of_the_cost():
    rng = np.random.default_rng(0)
    G = np.fft.rfft(rng.standard_normal((9, 2, 2)), axis=0)
    cost = lfo.QuadraticCost(Q=np.diag([1.0, 2.0]), R=np.diag([3.0, 1.0]), S=rng.standard_normal((2, 2)))
    problem = lfo.OptimalControlProblem(lfo.FrequencyResponse(G), 9, cost)
    response = problem.dynamics.response(9)
    found = bin_curvature(problem, response)
    u = rng.standard_normal((9, 2))
    hat = np.fft.rfft(u, axis=0)
    by_bins = np.einsum("k,kab,ka,kb->", response.weight, found.hessians, hat.conj(), hat).real / 18
    assert by_bins == pytest.approx(problem.value(response.linear(u), u), rel=1e-12)


def test_time_varying_costs_must_be_convex_at_each_time():
    S = np.ones((16, 1, 1)) * np.linspace(1, 2, 16)[:, None, None]
    problem = lfo.OptimalControlProblem(lfo.FrequencyResponse(np.ones(9)), 16, lfo.QuadraticCost(S=S))
    with pytest.raises(UnsupportedError, match="depends on time and is not positive semidefinite at all times"):
        lfo.solve(problem)
