"""Rate limits against CVXPY programs written by hand, and everything of a problem that must survive the extension."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.random.mixed import problem_of as problem_of_model
from helpers.random.mixed import random_model

T, N, M = 30, 3, 2
A = np.array([[0.9, 0.3, 0.0], [-0.2, 0.8, 0.1], [0.0, 0.2, 0.7]])
B = np.array([[0.5, 0.0], [0.2, 0.6], [0.3, -0.4]])
Q, R = np.diag([0.3, 0.1, 0.2]), np.diag([1.0, 2.0])
START, END = np.array([1.0, -0.5, 0.3]), np.array([-0.4, 0.6, 0.2])
BINS = [5, 6, 7]


def problem_of(**changes: Any) -> lfo.OptimalControlProblem:
    fields = {
        "dynamics": lfo.LinearDynamics(A, B, control_names=["force [N]", "torque [N m]"]),
        "horizon": T,
        "cost": lfo.QuadraticCost(Q=Q, R=R, u_ref=[0.2, 0.0]),
        "control_set": lfo.Box(-0.7, 0.7),
        "initial_state": START,
        "terminal_state": END,
        "control_spectrum": lfo.stop_band(bins=BINS, component=0),
    }
    return lfo.OptimalControlProblem(**(fields | changes))


def by_hand(limit: np.ndarray, previous: np.ndarray | None, plants: list[np.ndarray] | None = None) -> float:
    """Return the optimal cost of a program that knows nothing of further states."""
    x, u = cp.Variable((T + 1, N)), cp.Variable((T, M))
    plants = plants or [A] * T
    constraints = [x[0] == START, x[T] == END, cp.abs(u) <= 0.7]
    constraints += [x[t + 1] == plants[t] @ x[t] + B @ u[t] for t in range(T)]
    t = np.arange(T)
    for k in BINS:
        constraints += [np.cos(2 * np.pi * k * t / T) @ u[:, 0] == 0, np.sin(2 * np.pi * k * t / T) @ u[:, 0] == 0]
    for j in np.flatnonzero(np.isfinite(limit)):
        constraints.append(cp.abs(u[1:, j] - u[:-1, j]) <= limit[j])
        if previous is not None:
            constraints.append(cp.abs(u[0, j] - previous[j]) <= limit[j])
    deviation = u - np.tile([0.2, 0.0], (T, 1))
    cost = sum(0.5 * cp.quad_form(x[s], Q) + 0.5 * cp.quad_form(deviation[s], R) for s in range(T))
    program = cp.Problem(cp.Minimize(cost), constraints)
    program.solve(solver="CLARABEL")
    assert program.status == "optimal"
    return float(program.value)


LIMITS = {  # name: limit as given, as numbers, previous control
    "one for all": (0.25, [0.25, 0.25], None),
    "each its own": ([0.3, 0.2], [0.3, 0.2], None),
    "one control free": ([0.2, None], [0.2, np.inf], None),
    "from a given control": (0.25, [0.25, 0.25], [0.0, 0.1]),
    "one control free, from a given one": ([np.inf, 0.04], [np.inf, 0.04], [9.0, 0.0]),
}


@pytest.mark.parametrize("method", ["auto", "convex"])
@pytest.mark.parametrize("name", LIMITS)
def test_the_optimum_is_that_of_a_program_written_by_hand(name, method):
    given, numbers, previous = LIMITS[name]
    problem = problem_of()
    limited = lfo.rate_limited(problem, given, previous)
    result = lfo.solve(limited, method=method)
    before = None if previous is None else np.array(previous)
    assert result.cost == pytest.approx(by_hand(np.array(numbers), before), rel=1e-6)
    assert result.certificate.pmp == "satisfied"
    assert result.certificate.globally_optimal
    assert result.cost > lfo.solve(problem).cost * (1 + 1e-3)
    changes = np.abs(np.diff(result.control, axis=0)).max(0)
    assert (changes <= np.array(numbers) + 1e-8).all()
    if previous is not None:
        assert (np.abs(result.control[0] - previous) <= np.array(numbers) + 1e-8).all()
    assert result.method == ("spectral" if method == "auto" else "convex")


def test_further_states_are_the_controls_before_and_the_others_as_they_were():
    limited = lfo.rate_limited(problem_of(), [None, 0.2])
    assert limited.state_names == ("x_0", "x_1", "x_2", "torque before [N m]")
    result = lfo.solve(limited)
    x, u = result.trajectory.x, result.control
    np.testing.assert_allclose(x[1:, N], u[:, 1], atol=1e-12)
    np.testing.assert_allclose(x[1:, :N], x[:-1, :N] @ A.T + u @ B.T, atol=1e-12)
    np.testing.assert_allclose(x[[0, -1], :N], [START, END], atol=1e-12)


def test_time_varying_dynamics_keep_their_times():
    plants = [A * (1 - 0.005 * t) for t in range(T)]
    limited = lfo.rate_limited(problem_of(dynamics=lfo.LinearDynamics(np.array(plants), B)), 0.25)
    assert lfo.solve(limited).cost == pytest.approx(by_hand(np.full(M, 0.25), None, plants), rel=1e-6)


def test_all_that_constrains_and_costs_survives():
    """Without its limit being active, the limited problem has the optimum of the problem, whatever that consists of."""
    rng = np.random.default_rng(0)
    varying = {"x_ref": 0.1 * rng.standard_normal((T + 1, N)), "u_ref": 0.1 * rng.standard_normal((T, M))}
    problem = problem_of(
        dynamics=lfo.LinearDynamics(A, B, offset=0.02 * rng.standard_normal((T, N)), sampling_time=0.1),
        cost=lfo.QuadraticCost(
            Q=Q, R=R, S=0.05 * np.ones((N, M)), q=[0.1, 0, 0], r=[0.1, 0], P=np.eye(N), p=[0.2, 0, 0], **varying
        ),
        state_set=lfo.Box(-1.6, 1.6),
        terminal_state=lfo.Box(END - 0.1, END + 0.1),
        state_spectrum=lfo.stop_band(bins=[9], component=1),
        stage_rows=lfo.StageRows([[1.0, 0, 0]], [[0.5, 0]], [1.3]),
    )
    loose = lfo.rate_limited(problem, 50.0)
    assert lfo.solve(loose).cost == pytest.approx(lfo.solve(problem).cost, rel=1e-8)
    assert loose.sampling_time == 0.1
    np.testing.assert_array_equal(loose.state_stop[:, :N], problem.state_stop)
    assert not loose.state_stop[:, N:].any()


@pytest.mark.parametrize("seed", range(12))
def test_a_limit_that_is_not_active_changes_nothing_of_mixed_features(seed):
    """Convex sets, soft rows, L1 and Linf costs, masks and energies of states and of outputs, in larger states."""
    problem = problem_of_model(random_model(seed))
    result = lfo.solve(problem)
    limit = 10 * np.abs(np.diff(result.control, axis=0)).max() + 1e-3
    limited = lfo.rate_limited(problem, limit)
    again = lfo.solve(limited)
    assert again.status == result.status == "optimal"
    assert again.cost == pytest.approx(result.cost, rel=1e-8, abs=1e-8)
    assert again.certificate.pmp == "satisfied"
    assert again.certificate.globally_optimal
    assert len(limited.terms) == len(problem.terms) + 1
    n, m = problem.state_dim, problem.control_dim
    rng = np.random.default_rng(seed)
    x, u = rng.standard_normal((problem.horizon + 1, n)), rng.standard_normal((problem.horizon, m))
    for t, end in zip((0, -1), problem.ends, strict=True):
        x[t] = np.where(end.fixed, end.lower, x[t])
    before = np.vstack([np.zeros(m), u])
    assert limited.value(np.hstack([x, before]), u) == pytest.approx(problem.value(x, u), rel=1e-12)
    own = {term.name: term for term in limited.terms}
    for term in problem.terms:  # at any point, every constraint is violated as much as it was
        there = own[term.name].violation(np.hstack([x, before]), u)
        assert there.max() == pytest.approx(term.violation(x, u).max(), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("seed", [1, 3, 5, 7, 20])
def test_an_active_limit_of_mixed_features_costs_what_a_model_by_hand_does(seed):
    model = random_model(seed)
    problem = problem_of_model(model)
    free = lfo.solve(problem)
    limit = 0.8 * np.abs(np.diff(free.control, axis=0)).max()
    by_hand = cp.Problem(cp.Minimize(model.cost), [*model.constraints, cp.abs(cp.diff(model.u, axis=0)) <= limit])
    by_hand.solve(solver="CLARABEL")
    result = lfo.solve(lfo.rate_limited(problem, limit), throw=False)
    assert result.status == by_hand.status
    if result.status == "optimal":
        assert result.cost == pytest.approx(by_hand.value, rel=1e-6, abs=1e-6)
        assert result.cost > free.cost + 1e-6 * max(1.0, abs(free.cost))
        assert np.abs(np.diff(result.control, axis=0)).max() <= limit + 1e-7
        assert result.certificate.pmp == "satisfied"


@pytest.mark.parametrize(
    ("limit", "previous", "field"),
    [
        (-0.1, None, "rate_limit"),
        ([0.1], None, "rate_limit"),
        (None, None, "rate_limit"),
        ([None, None], None, "rate_limit"),
        ("fast", None, "rate_limit"),
        (np.nan, None, "rate_limit"),
        (0.1, [0.0], "previous"),
        (0.1, [0.0, np.inf], "previous[1]"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(limit, previous, field):
    with pytest.raises(lfo.errors.ProblemError) as caught:
        lfo.rate_limited(problem_of(), limit, previous)
    assert caught.value.field == field


def test_a_problem_is_limited_once():
    with pytest.raises(lfo.errors.ProblemError, match="a problem without stage rows named 'rate limit'"):
        lfo.rate_limited(lfo.rate_limited(problem_of(), 0.3), 0.2)


def test_the_change_to_the_following_control_is_limited():
    """``following`` bounds u_{T-1}: the optimum is that of a bound on the last sample, written by hand."""
    limit, following = np.array([0.25, 0.2]), np.array([0.1, -0.1])
    limited = lfo.rate_limited(problem_of(), limit.tolist(), [0.0, 0.1], following)
    upper, lower = np.full((T, M), 0.7), np.full((T, M), -0.7)
    upper[-1], lower[-1] = np.minimum(0.7, following + limit), np.maximum(-0.7, following - limit)
    by_bounds = lfo.rate_limited(problem_of(control_set=lfo.Box(lower, upper)), limit.tolist(), [0.0, 0.1])
    result, expected = lfo.solve(limited), lfo.solve(by_bounds)
    assert result.cost == pytest.approx(expected.cost, rel=1e-7)
    assert result.certificate.globally_optimal
    assert (np.abs(result.control[-1] - following) <= limit + 1e-8).all()
    assert result.cost > lfo.solve(lfo.rate_limited(problem_of(), limit.tolist(), [0.0, 0.1])).cost * (1 + 1e-6)


def test_a_rate_limited_problem_of_constant_data_is_stated_at_every_horizon():
    limited = lfo.rate_limited(problem_of(control_spectrum=None), 0.25, previous=0, following=0)
    assert replace(limited, horizon=T + 10).state_boxes.lower.shape == (T + 11, N + M)


@pytest.mark.parametrize("following", [[0.0], [0.0, np.inf], "rest"])
def test_a_following_control_that_does_not_fit_is_refused(following):
    with pytest.raises(lfo.errors.ProblemError, match="following"):
        lfo.rate_limited(problem_of(), 0.1, following=following)
