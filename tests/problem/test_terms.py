"""What the terms of a problem cost, by plain formulas."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo

N, M = 3, 2


def value(T: int = 8, **fields) -> tuple[np.ndarray, np.ndarray, float]:
    """Return a random trajectory of a problem without quadratic cost, and J."""
    rng = np.random.default_rng(3)
    dynamics = lfo.LinearDynamics(np.eye(N), rng.standard_normal((N, M)))
    problem = lfo.OptimalControlProblem(dynamics, T, **({"cost": lfo.QuadraticCost()} | fields))
    x, u = rng.standard_normal((T + 1, N)), rng.standard_normal((T, M))
    return x, u, problem.value(x, u)


def test_costs_of_norms_by_their_formulas():
    weights, reference = np.array([1.0, 0.0, 2.0]), np.linspace(-1, 1, 27).reshape(9, 3)
    x, u, cost = value(cost=lfo.costs.L1Cost(x=weights, u=0.5, terminal=3.0, x_ref=reference, u_ref=[1, 2]))
    stages = (weights * np.abs(x - reference)[:-1]).sum() + 0.5 * np.abs(u - [1, 2]).sum()
    assert cost == pytest.approx(stages + 3 * np.abs(x - reference)[-1].sum())
    x, u, cost = value(cost=lfo.costs.LInfCost(x=weights, u=0.5, terminal=3.0, x_ref=reference, u_ref=[1, 2]))
    stages = (weights * np.abs(x - reference)[:-1]).max(1).sum() + 0.5 * np.abs(u - [1, 2]).max(1).sum()
    assert cost == pytest.approx(stages + 3 * np.abs(x - reference)[-1].max())


def test_the_sum_of_a_list_of_costs_is_a_cost():
    costs = [
        lfo.QuadraticCost(R=2.0),
        lfo.costs.L1Cost(u=0.5),
        lfo.costs.LInfCost(x=3.0),
        lfo.costs.L1Cost(terminal=1.0) + lfo.costs.LInfCost(u=1.0),
    ]
    for some in (costs, costs[::-1], costs[3:], costs[1:2], costs[:1]):
        _, _, together = value(cost=sum(some))
        assert together == pytest.approx(sum(value(cost=one)[2] for one in some), rel=1e-12)


@pytest.mark.parametrize("start", [None, [1.0, 2.0, 0.0]])
def test_soft_sets_count_at_all_times_that_of_a_fixed_state_too(start):
    x, _, cost = value(state_set=lfo.sets.Soft(lfo.sets.Ball(0.5, 1.0), 2.0), initial_state=start)
    assert cost == pytest.approx(2 * np.maximum(np.linalg.norm(x - 1, axis=1) - 0.5, 0).sum())
    _, u, cost = value(control_set=lfo.sets.Soft(lfo.Box([None, -0.3], 0.2), 2.0))
    assert cost == pytest.approx(2 * (np.maximum(u - 0.2, 0).sum() + np.maximum(-0.3 - u[:, 1], 0).sum()))
    x, _, cost = value(terminal_state=lfo.sets.Soft(lfo.sets.Polyhedron([[1, 1, 1]], [-5]), 2.0), initial_state=start)
    assert cost == pytest.approx(2 * max(x[-1].sum() + 5, 0))


def test_the_optimum_where_a_fixed_state_lies_outside_a_soft_set():
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[1.0]]), 3, lfo.QuadraticCost(R=1.0), [lfo.Box(-0.5, 0.5)] * 3,
        state_set=lfo.sets.Soft(lfo.Box(-1, 1), 10.0), initial_state=[3.0],
    )  # fmt: skip
    result = lfo.solve(problem)
    np.testing.assert_allclose(result.control[:, 0], [-0.5, -0.5, -0.5], atol=1e-7)
    assert result.cost == pytest.approx(3 * 0.125 + 10 * (2 + 1.5 + 1 + 0.5))


def test_soft_frequency_constraints_by_their_formulas():
    x, u, cost = value(
        control_spectrum=lfo.MagnitudeBound([0.5, 1.5, np.inf], bins=[0, 2, 4], component=1, penalty=2.0)
    )
    assert cost == pytest.approx(2 * np.maximum(np.abs(np.fft.rfft(u[:, 1]))[[0, 2]] - [0.5, 1.5], 0).sum())
    window = np.hanning(9)
    bound = lfo.spectrum.EnergyBound(0.4, bins=[1, 3], component=0, penalty=2.0, window=window, oversampling=4)
    x, u, cost = value(state_spectrum=bound)
    energy = (np.abs(np.fft.rfft(window * x[:, 0], 36))[[4, 12]] ** 2).sum() / 4
    assert cost == pytest.approx(2 * max(np.sqrt(energy) - np.sqrt(0.4), 0))
