"""Implied bounds hold every trajectory they must hold, and no more than a rounding error else."""

import numpy as np
import pytest
from reference import time_varying

import lin_freq_ocp as lfo
from lin_freq_ocp.certificate.reach import OUTWARD, implied_bounds
from lin_freq_ocp.certificate.verdict import judge

T = 30


def problem(kind, **changes):
    if kind == "time-varying":
        A, B = time_varying(T)
    else:
        A, B = [[0.9, 0.5], [-0.5, 0.9]], [[0.0], [1.0]]
    settings = {
        "dynamics": lfo.LinearDynamics(A, B, offset=[0.1, -0.2]),
        "horizon": T,
        "cost": lfo.QuadraticCost(R=1.0),
        "control_set": [lfo.Box(-1.0 - t / T, 0.5) for t in range(T)] if kind == "time-varying" else lfo.Box(-1, 2),
        "initial_state": lfo.Box([0.0, -0.5], [0.3, 0.5]),
    }
    return lfo.OptimalControlProblem(**(settings | changes))


@pytest.mark.parametrize("kind", ["constant", "time-varying"])
def test_forward_reach_is_the_tight_interval(kind):
    """Against the worst controls and start for each component and time, by the adjoint of the map to that component."""
    task = problem(kind)
    enclosure = implied_bounds(task, np.zeros((T, 1)), None)
    assert "forward reach" in enclosure.follows_from
    for t in (1, 7, T):
        for i in range(2):
            normal = np.eye(2)[i]
            worst = np.zeros((T, 1))
            for s in range(t - 1, -1, -1):
                A, B, _ = task.dynamics.at(s)
                worst[s] = np.where(B.T @ normal > 0, task.control_tube.upper[s], task.control_tube.lower[s])
                normal = A.T @ normal
            start = np.where(normal > 0, task.initial_state.upper, task.initial_state.lower)
            highest = lfo.simulate(task, worst, start).x[t, i]
            assert enclosure.x[1][t, i] >= highest
            if kind == "constant":  # one radius for all controls: tight only where their bounds do not vary
                assert enclosure.x[1][t, i] == pytest.approx(highest, rel=1e-7)


@pytest.mark.parametrize("kind", ["constant", "time-varying"])
def test_forward_reach_holds_random_trajectories(kind):
    task, rng = problem(kind), np.random.default_rng(1)
    lower, upper = implied_bounds(task, np.zeros((T, 1)), None).x
    for _ in range(50):
        u = np.where(rng.random((T, 1)) < 0.5, task.control_tube.lower, task.control_tube.upper)
        x = lfo.simulate(task, u, rng.uniform(task.initial_state.lower, task.initial_state.upper)).x
        assert (x >= lower).all()
        assert (x <= upper).all()


def test_the_level_set_is_met_by_one_large_control():
    """All of the cost J in one control: |u - u_ref| = sqrt(2 J / m)."""
    task = problem("constant", control_set=None, cost=lfo.QuadraticCost(R=3.0, u_ref=[0.5]))
    enclosure = implied_bounds(task, np.full((T, 1), 3.0), 6.0)
    u = np.full((T, 1), 0.5)
    u[4] += 2.0
    assert task.cost.value(np.zeros((T + 1, 2)), u) == pytest.approx(6.0)
    assert enclosure.u[1][4, 0] == pytest.approx(u[4, 0])
    assert enclosure.u[1][4, 0] >= u[4, 0]
    assert enclosure.u[0][4, 0] == pytest.approx(0.5 - 2.0)
    assert enclosure.level == OUTWARD * 6.0


def test_no_level_set_with_linear_terms():
    task = problem("constant", control_set=None, cost=lfo.QuadraticCost(R=3.0, r=[1.0]))
    enclosure = implied_bounds(task, np.full((T, 1), 3.0), 6.0)
    assert np.isinf(enclosure.u[1]).all()
    assert enclosure.level == np.inf


def test_a_trajectory_cheaper_than_the_optimum_proves_nothing():
    """u = 0 costs nothing and goes nowhere: its level set is empty, and no bound over it is called rigorous."""
    task = lfo.library.pendulum(state_bounds=(None,) * 4, control_bound=None)
    result = lfo.solve(task)
    nowhere = lfo.simulate(task, np.zeros((240, 1)))
    bound = judge(task, nowhere, result.multipliers).bound
    assert bound.kind == "numerical"
    assert bound.value <= result.cost


def test_over_a_level_set_no_more_than_the_level_is_proven():
    """Half of the optimal control costs a quarter: what costs more than that was not looked at."""
    task = lfo.library.pendulum(state_bounds=(None,) * 4, control_bound=None)
    result = lfo.solve(task)
    half = lfo.simulate(task, result.control / 2)
    certificate = judge(task, half, result.multipliers)
    assert certificate.cost == pytest.approx(result.cost / 4)
    assert certificate.bound.kind == "numerical" or certificate.bound.value <= OUTWARD * certificate.cost
    assert not certificate.globally_optimal


def test_the_bound_depends_on_the_multipliers_only(solved):
    """D at the optimum, at the classical solution (other bins) and at noise (other dynamics) is the same number."""
    result = solved("paper, constrained")
    rng = np.random.default_rng(2)
    noise = lfo.Trajectory(0.1 * rng.standard_normal((241, 4)), 2 * rng.standard_normal((240, 1)))
    optimum = result.certificate.bound
    for other in (solved("paper, classical").trajectory, noise):
        bound = judge(result.problem, other, result.multipliers).bound
        assert abs(bound.frequency_term) > 1
        assert bound.value == pytest.approx(optimum.value, rel=1e-8)
        certificate = judge(result.problem, other, result.multipliers)
        assert certificate.gap < 0
        assert not certificate.globally_optimal  # cheaper than the bound: infeasible, not optimal
    assert abs(bound.dynamics_term) > 1
