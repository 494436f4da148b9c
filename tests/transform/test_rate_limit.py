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
from helpers.seeds import expensive, seeds

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


def by_hand(
    limit: np.ndarray,
    previous: np.ndarray | None,
    plants: list[np.ndarray] | None = None,
    prices: np.ndarray | None = None,
) -> float:
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
    for j, price in enumerate([] if prices is None else prices):
        cost += price / 2 * cp.sum_squares(u[1:, j] - u[:-1, j])
        cost += 0 if previous is None else price / 2 * cp.square(u[0, j] - previous[j])
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
@pytest.mark.parametrize("name", seeds(LIMITS))
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


PRICES = {  # name: limit, previous control, price as given, as numbers
    "one price": (None, [0.0, 0.1], 5.0, [5.0, 5.0]),
    "each its own": (None, None, [0.0, 8.0], [0.0, 8.0]),
    "beside a limit": ([0.15, None], [0.0, 0.1], [2.0, 3.0], [2.0, 3.0]),
}


@expensive
@pytest.mark.parametrize("name", PRICES)
def test_a_price_on_changes_is_that_of_a_program_written_by_hand(name):
    given, previous, price, prices = PRICES[name]
    limited = lfo.rate_limited(problem_of(), given, previous, price=price)
    result = lfo.solve(limited)
    limits = np.array([np.inf, np.inf] if given is None else [np.inf if one is None else one for one in given])
    before = None if previous is None else np.array(previous)
    assert result.cost == pytest.approx(by_hand(limits, before, prices=np.array(prices)), rel=1e-6)
    assert result.certificate.globally_optimal
    u, first = result.control, result.trajectory.x[0, N:]  # a first control without one before costs nothing
    chosen = np.isfinite(limits) | (np.array(prices) > 0)
    changes = np.diff(np.vstack([first, u[:, chosen]]), axis=0)
    plain = problem_of().value(result.trajectory.x[:, :N], u)
    assert result.cost == pytest.approx(plain + 0.5 * (np.array(prices)[chosen] * changes**2).sum(), rel=1e-9)


def test_a_price_on_changes_of_references_per_time():
    """A control that follows its reference pays for the steps of the reference."""
    u_ref = np.random.default_rng(0).standard_normal((T, M))
    problem = problem_of(cost=lfo.QuadraticCost(R=1.0, u_ref=u_ref, x_ref=np.ones((T + 1, N))))
    x, u = np.zeros((T + 1, N)), u_ref
    limited = lfo.rate_limited(problem, None, u_ref[0], price=[2.0, 3.0])
    before = np.vstack([u_ref[0], u])
    steps = 0.5 * (np.diff(u, axis=0) ** 2 * [2.0, 3.0]).sum()
    assert limited.value(np.hstack([x, before]), u) == pytest.approx(steps)


def test_a_loop_pays_for_changes_from_the_control_before():
    """Each step of a receding horizon begins with the control that was applied: a high price makes it slow."""
    plain = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[1.0]]), 10, lfo.QuadraticCost(Q=1.0, R=0.1), initial_state=[1.0]
    )
    priced = lfo.rate_limited(plain, None, previous=0.0, price=50.0)
    fast = float(lfo.RecedingHorizon(plain).step([1.0])[0])
    controller, state, before = lfo.RecedingHorizon(priced), 1.0, 0.0
    for _ in range(8):
        u = float(controller.step([state, before])[0])
        expected = lfo.solve(lfo.rate_limited(plain.with_ends(initial_state=[state]), None, before, price=50.0))
        assert u == pytest.approx(expected.control[0, 0], abs=1e-8)
        assert abs(u - before) < 0.3 * abs(fast)
        state, before = state + u, u


def test_smooth_dynamics_have_prices_on_changes():
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(["x_0 + sin(u_0)"], 1, 1)
    problem = lfo.OptimalControlProblem(dynamics, 10, lfo.QuadraticCost(Q=1.0), initial_state=[1.0])
    result = lfo.solve(lfo.rate_limited(problem, 0.3, previous=0.0, price=1.0), "nonsmooth")
    assert result.certificate.pmp == "satisfied"
    assert np.abs(np.diff(result.control[:, 0], prepend=0.0)).max() <= 0.3 + 1e-8


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


@pytest.mark.parametrize("seed", seeds(range(12)))
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


@pytest.mark.parametrize("seed", seeds([1, 3, 5, 7, 20]))
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


@pytest.mark.parametrize("price", [-1.0, [1.0], [1.0, np.nan], "dear", [0.0, -2.0]])
def test_a_bad_price_is_refused_by_name(price):
    with pytest.raises(lfo.errors.ProblemError) as caught:
        lfo.rate_limited(problem_of(), 0.1, price=price)
    assert caught.value.field.startswith("price")


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
