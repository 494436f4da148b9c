"""Margins of loads against all of their extreme points, one by one, and tests of these tests."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.checks.margins import check
from helpers.seeds import seeds
from helpers.tubes import excess, simulate, tube


@pytest.mark.parametrize("seed", seeds(range(210), always=range(12)))
def test_margins_are_the_largest_values_over_all_extreme_points(seed):
    found = check(seed)
    assert found.passed, found


@pytest.mark.parametrize("seed", seeds(range(12)))
def test_loads_of_balls_and_ellipsoids_are_attained_and_nothing_of_a_dense_sample_is_larger(seed):
    rng = np.random.default_rng(seed)
    W, centre = rng.standard_normal((2, 2)) + 2 * np.eye(2), rng.standard_normal(2)
    ellipsoid = seed % 2 == 0
    loads = lfo.sets.Ellipsoid(W, 0.7, centre) if ellipsoid else lfo.sets.Ball(0.7, centre)
    problem = tube(4)
    loop = lfo.Disturbance(loads).error_loop(problem)
    angle = np.linspace(0, 2 * np.pi, 2000)
    circle = 0.7 * np.column_stack([np.cos(angle), np.sin(angle)])
    points = centre + (circle @ np.linalg.inv(W).T if ellipsoid else circle)
    c, d = rng.standard_normal(2), rng.standard_normal(1)
    rest = lfo.Trajectory(np.zeros((5, 2)), np.zeros((4, 1)))
    for t in range(1, 4):
        _, worst = loop.worst(c, d, t)
        assert loads.violation(worst).max() < 1e-12
        margin = loop.margins(c[None], d[None])[t, 0]
        x, u = simulate(problem, loop.K, rest, np.eye(2), worst[None])
        assert x[0, t] @ c + u[0, t] @ d == pytest.approx(margin, rel=1e-12)
        best = 0.0  # the loads of different times are independent: the best point of each time alone
        for j in range(t):
            one = np.zeros((len(points), 4, 2))
            one[:, j] = points
            x, u = simulate(problem, loop.K, rest, np.eye(2), one)
            best += (x[:, t] @ c + u[:, t] @ d).max()
        assert margin - 1e-5 <= best <= margin + 1e-12


def test_a_plan_of_the_tightened_problem_costs_as_one_program_with_the_rows_of_all_vertices():
    import cvxpy as cp

    T, W = 5, 0.1
    problem, load = tube(T), lfo.Disturbance(lfo.Box(-W, W))
    K = load.feedback(problem)
    z, v = cp.Variable((T + 1, 2)), cp.Variable((T, 1))
    w = np.array(list(product([-W, W], repeat=2 * T))).reshape(-1, T, 2)
    A, B, _ = problem.dynamics.at(0)
    parts, e = [z[0] == np.array([-7.0, -2.0])] + [z[t + 1] == A @ z[t] + B @ v[t] for t in range(T)], 0 * w[:, 0]
    for t in range(T + 1):
        here = np.unique(np.round(e, 14), axis=0)
        if t:
            x = np.ones((len(here), 1)) @ cp.reshape(z[t], (1, 2), order="C") + here
            parts += [x[:, 0] <= 2, x[:, 1] <= 2, x[:, 0] >= -10, x[:, 1] >= -2]
        if t < T:
            parts += [cp.abs(v[t, 0] * np.ones(len(here)) + here @ K[0]) <= 1]
            e = e @ (A + B @ K).T + w[:, t]
    cost = sum(cp.sum_squares(z[t]) + 0.1 * cp.square(v[t, 0]) for t in range(T)) / 2 + 1.5 * cp.sum_squares(z[T])
    value = cp.Problem(cp.Minimize(cost), parts).solve(solver="CLARABEL", tol_gap_rel=1e-11, tol_feas=1e-11)
    assert lfo.solve(lfo.robust(problem, load)).cost == pytest.approx(value, rel=1e-7)


def test_random_loads_never_violate_a_limit_and_those_of_the_nominal_plan_do():
    problem, load = tube(), lfo.Disturbance(lfo.Box(-0.1, 0.1))
    plan, nominal = lfo.solve(lfo.robust(problem, load)).trajectory, lfo.solve(problem).trajectory
    rng, K = np.random.default_rng(0), load.feedback(problem)
    w = rng.choice([-0.1, 0.1], (100_000, 10, 2)) * np.where(
        rng.random((100_000, 1, 1)) < 0.5, 1, rng.random((100_000, 10, 2))
    )
    assert excess(problem, *simulate(problem, K, plan, np.eye(2), w)) < 1e-9
    assert excess(problem, *simulate(problem, K, nominal, np.eye(2), w)) > 0.2


OWN = [[-0.61669526, -1.27031633]]  # the regulator of the costs of the example


@pytest.mark.parametrize(
    ("start", "T", "gain", "largest"),
    [
        ([-5.0, -2.0], 10, None, 0.727),
        ([-5.0, -2.0], 10, OWN, 2.261),
        ([-5.0, -2.0], 10, "auto", 3.315),
        ([-7.0, -2.0], 10, OWN, 1.544),
        ([-7.0, -2.0], 10, "auto", 1.667),
        ([-8.0, 1.0], 15, OWN, 2.403),
        ([-8.0, 1.0], 15, "auto", 3.605),
    ],
)
def test_the_largest_loads_that_a_plan_bears(start, T, gain, largest):
    """In units of 0.15, as the design measured them; optimised feedback bears 3.333, 1.667 and 5.215."""

    def bears(share):
        size = 0.15 * share
        try:
            plan = lfo.robust(tube(T, initial_state=start), lfo.Disturbance(lfo.Box(-size, size), gain=gain))
        except lfo.errors.ProblemError:  # the margins exceed a range
            return False
        return lfo.solve(plan, throw=False).status == "optimal"

    assert bears(largest - 0.001)
    assert not bears(largest + 0.001)


def test_the_gain_auto_costs_less_than_the_regulator_of_the_costs():
    load = lfo.Disturbance(lfo.Box(-0.15, 0.15), gain=OWN)
    assert lfo.solve(lfo.robust(tube(), load)).cost == pytest.approx(241.14, abs=0.01)


def test_twice_the_loads_are_infeasible_by_a_ray():
    found = lfo.solve(lfo.robust(tube(), lfo.Disturbance(lfo.Box(-0.3, 0.3))), throw=False)
    assert (found.status, found.dual) == ("infeasible", True)
    assert "rigorous ray" in found.message


def test_the_words_of_a_ray_say_what_loads_take_of_each_limit():
    """Where a limit acts; the ends as they were given, and limits that were replaced after that, say nothing."""
    load = lfo.Disturbance(lfo.Box(-0.3, 0.3))
    plan = lfo.robust(tube(), load)
    message = (
        r"initial state, t = 0; state bound on x_0, t = 3 \(less 1.3 for loads\); .* u_0, .* \(less 0.35 for loads\)"
    )
    with pytest.raises(lfo.errors.InfeasibleError, match=message) as info:
        lfo.solve(plan)
    loop, parts = load.error_loop(tube()), {one.block: one for one in info.value.result.conflict}
    of_x, of_u = parts["state bound on x_0"], parts["control bound on u_0"]
    most = loop.margins(-np.eye(2), np.zeros((2, 1)))[list(of_x.times), 0].max()
    assert of_x.margin == pytest.approx(most, rel=1e-12)
    most = loop.margins(np.zeros((1, 2)), np.eye(1))[list(of_u.times), 0].max()
    assert of_u.margin == pytest.approx(most, rel=1e-12)
    wider = lfo.solve(replace(plan, control_set=lfo.Box(-0.1, 0.1)), throw=False)
    assert {one.margin for one in wider.conflict} == {0.0}
    assert "for loads" not in "".join(map(str, lfo.solve(tube(initial_state=[5.0, 5.0]), throw=False).conflict))


@pytest.mark.parametrize(
    ("block", "changes"),
    [
        ("row 0 of sum", {"stage_rows": lfo.StageRows([[1.0, 1.0]], [[0.5]], [-9.2], name="sum")}),
        ("terminal state", {"terminal_state": lfo.Box([1.0, -0.5], [2.0, 0.5]), "horizon": 5}),
        ("mask on u_0", {"control_spectrum": lfo.MagnitudeBound(1.2, bins=[0, 1, 2, 3, 4, 5])}),
        ("state set", {"state_set": lfo.Box(-10, 2) & lfo.sets.Polyhedron([[-1.0, -0.1]], [7.3])}),
    ],
)
def test_the_words_of_a_ray_name_margins_of_rows_ends_masks_and_polyhedra(block, changes):
    load, fields = lfo.Disturbance(lfo.Box(-0.05, 0.05)), {"horizon": 10} | changes
    found = lfo.solve(lfo.robust(tube(**fields), load), throw=False)
    assert found.status == "infeasible"
    (part,) = (one for one in found.conflict if one.block == block)
    assert part.margin > 0.02
    assert "for loads)" in str(part)
    (start,) = (one for one in found.conflict if one.block == "initial state")
    assert start.margin == 0.0


WRONG = {
    "a power too many": lambda loop: replace(loop, E=loop.A @ loop.E),
    "a power too few": lambda loop: replace(loop, E=np.linalg.solve(loop.A, loop.E)),
    "without K'd": lambda loop: replace(loop, K=0 * loop.K),
    "without the first load": lambda loop: replace(
        loop,
        A=np.broadcast_to(loop.A, (4, 2, 2)),
        a=np.broadcast_to(loop.a, (4, 2, 2)),
        E=np.array([0 * loop.E, *[loop.E] * 3]),
    ),
    "without the last load": lambda loop: replace(
        loop,
        A=np.array([loop.A, loop.A, 0 * loop.A, loop.A]),
        a=np.broadcast_to(loop.a, (4, 2, 2)),
        E=np.array([loop.E, loop.E, 0 * loop.E, loop.E]),
    ),
    "a gain of the wrong sign": lambda loop: replace(loop, K=-loop.K),
    "another closed loop": lambda loop: replace(loop, A=loop.A - 0.1 * np.eye(2)),
}


@pytest.mark.parametrize("fault", WRONG)
def test_wrong_margins_are_seen_by_brute_force(fault):
    """The tests above would fail: of a faulty loop, some margin differs by far more than their tolerance."""
    problem = tube(4, initial_state=None)
    loop = lfo.Disturbance(lfo.Box(-0.1, 0.1)).error_loop(problem)
    wrong = WRONG[fault](loop)
    w = np.array(list(product([-0.1, 0.1], repeat=8))).reshape(-1, 4, 2)
    x, u = simulate(problem, loop.K, lfo.Trajectory(np.zeros((5, 2)), np.zeros((4, 1))), np.eye(2), w)
    C, D = np.vstack([np.eye(2), [[0.5, 0.0]]]), np.array([[0.0], [0.0], [1.0]])
    brute = np.array([(x[:, t] @ C.T + u[:, t] @ D.T).max(axis=0) for t in range(4)])
    assert np.abs(loop.margins(C, D)[:4] - brute).max() < 1e-13
    assert np.abs(wrong.margins(C, D)[:4] - brute).max() > 1e-3


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("other", [1e-9, 1e9])
def test_margins_and_the_gain_do_not_depend_on_units(unit, other):
    """States in other units: x' = S x."""
    plain, S = tube(8), np.diag([unit, other])
    A, B, _ = plain.dynamics.at(0)
    cost = lfo.QuadraticCost(Q=np.linalg.inv(S @ S), R=0.1, P=3 * np.linalg.inv(S @ S))
    moved = lfo.OptimalControlProblem(
        lfo.LinearDynamics(S @ A @ np.linalg.inv(S), S @ B),
        8,
        cost,
        lfo.Box(-1, 1),
        lfo.Box(S @ [-10, -2], S @ [2, 2]),
        S @ [-7, -2],
    )
    one, two = lfo.Disturbance(lfo.Box(-0.1, 0.1)), lfo.Disturbance(lfo.Box(-0.1, 0.1), S)
    K = two.feedback(moved)
    np.testing.assert_allclose(K @ S, one.feedback(plain), rtol=1e-6)
    fixed = one.feedback(plain)
    first = lfo.robust(plain, lfo.Disturbance(lfo.Box(-0.1, 0.1), gain=fixed))
    second = lfo.robust(moved, lfo.Disturbance(lfo.Box(-0.1, 0.1), S, gain=fixed @ np.linalg.inv(S)))
    np.testing.assert_allclose(second.state_set.upper, first.state_set.upper @ S, rtol=1e-12)
    assert lfo.solve(second).cost == pytest.approx(lfo.solve(first).cost, rel=1e-7)
    assert lfo.worst_case(
        moved, lfo.Disturbance(lfo.Box(-0.1, 0.1), S, gain=fixed @ np.linalg.inv(S)), lfo.solve(second)
    )


def test_no_loads_are_the_nominal_problem():
    problem = tube()
    plan = lfo.robust(problem, lfo.Disturbance(lfo.Box(0, 0)))
    assert lfo.solve(plan).cost == pytest.approx(lfo.solve(problem).cost, rel=1e-12)


def test_records_bear_themselves_and_their_mixtures_and_cost_less_than_the_hull_of_their_samples():
    problem, rng = tube(), np.random.default_rng(3)
    loads = np.cumsum(0.03 * rng.standard_normal((12, 10, 2)), 1).clip(-0.15, 0.15)
    load = lfo.Disturbance(lfo.uncertainty.Records(loads))
    result = lfo.solve(lfo.robust(problem, load))
    hull = lfo.solve(lfo.robust(problem, lfo.Disturbance(loads.reshape(-1, 2))))
    K, plan = load.feedback(problem), result.trajectory
    mixed = np.einsum("sl,ltk->stk", rng.dirichlet(np.ones(12), 5000), loads)
    assert max(excess(problem, *simulate(problem, K, plan, np.eye(2), w)) for w in (loads, mixed)) < 1e-9
    assert result.cost < hull.cost - 5
    worst = lfo.worst_case(problem, load, result)
    assert worst
    assert all(one.attained == pytest.approx(one.planned + one.sign * one.margin) for one in worst.limits)


def test_each_row_of_gaussian_loads_has_the_probability_by_itself():
    problem, rng = tube(), np.random.default_rng(2)
    load = lfo.Disturbance(lfo.uncertainty.Gaussian(np.diag([0.03, 0.02]) ** 2, 0.95))
    result = lfo.solve(lfo.robust(problem, load))
    w = rng.standard_normal((100_000, 10, 2)) * [0.03, 0.02]
    x, u = simulate(problem, load.feedback(problem), result.trajectory, np.eye(2), w)
    of_x = np.maximum(x[:, 1:] > 2 + 1e-9, x[:, 1:] < np.array([-10, -2]) - 1e-9).mean(axis=0)
    rates = np.concatenate([of_x.ravel(), (np.abs(u) > 1 + 1e-9).mean(axis=0).ravel()])
    assert 0.048 < rates.max() < 0.052
    assert (rates > 0.045).sum() >= 3
    worst = lfo.worst_case(problem, load, result)
    assert worst
    assert all(one.loads is None and np.isnan(one.attained) for one in worst.limits)


def test_margins_forever_of_systems_whose_invariant_polytopes_did_not_finish():
    """HiroIshida/robust-tube-mpc, issues 14 and 20; the sum of many steps is a bound from below."""
    A = np.array([[1, 0.2, -1], [0, 1, -0.2], [0, 0, 0.6]])
    three = lfo.LinearDynamics(A, [[0], [0], [0.6]]), np.diag([1, 1, 0.1]), 5.0, [33.4659, 152.6822, 44.9355]
    A = [[0, 1, 0, 0], [-60.723, -1.0795, -3.1167, -0.32884], [0, 8, -13.59, -13.35], [0, 0, 8, 0]]
    plant = lfo.LinearDynamics.from_continuous(A, [[0], [0.6577], [0], [0]], 0.01)
    for dynamics, Q, size, known in (three, (plant, np.eye(4), 1e-4, [0.004757, 0.033986, 0.019560, 0.022187])):
        n = dynamics.state_dim
        problem = lfo.OptimalControlProblem(dynamics, 10, lfo.QuadraticCost(Q=Q, R=0.1))
        loop = lfo.Disturbance(lfo.Box(-size, size), forever=True).error_loop(problem)
        margins = loop.margins(np.eye(n), np.zeros((n, 1)))[0]
        np.testing.assert_allclose(margins, known, rtol=2e-4)
        sums, X = np.zeros(n), np.eye(n)
        for _ in range(3000):
            sums, X = sums + size * np.abs(X).sum(axis=1), X @ loop.A
        assert (margins >= sums).all()
        assert (margins <= sums * (1 + 1e-9)).all()


def test_a_periodic_plan_that_repeats_forever_never_violates_a_limit():
    T, W = 24, 0.05
    t = np.arange(T + 1)
    cost = lfo.QuadraticCost(Q=np.diag([1, 0]), R=0.01, x_ref=np.column_stack([1.9 * np.sin(2 * np.pi * t / T), 0 * t]))
    problem = tube(T, initial_state=None, terminal_state=lfo.Periodic(), state_set=lfo.Box(-1.5, 1.5))
    problem = replace(problem, cost=cost)
    load = lfo.Disturbance(lfo.Box(-W, W), forever=True)
    with pytest.warns(lfo.errors.ClosedLoopWarning, match="terminal_state"):
        plan = lfo.solve(lfo.robust(problem, load)).trajectory
    worst = lfo.worst_case(problem, load, plan)
    assert worst
    assert "end of the plan: loads move it by up to" in str(worst)
    for one in worst.limits:
        assert one.attained == pytest.approx(one.planned + one.sign * one.margin, rel=1e-9)
    K, rng, over = load.feedback(problem), np.random.default_rng(1), []
    x = np.tile(plan.x[0], (3, 1))
    for k in range(200 * T):
        u = plan.u[k % T] + (x - plan.x[k % T]) @ K.T
        over.append(max(np.abs(u).max() - 1, np.abs(x).max() - 1.5))
        w = [rng.choice([-W, W], 2), [W, W], W * np.sign(np.sin(0.1 * k + np.arange(2)))]
        x = x @ problem.dynamics.A.T + u @ problem.dynamics.B.T + np.array(w)
    assert max(over) < 1e-9


def test_an_uncertain_start_adds_its_own_margin():
    problem = tube(6)
    load = lfo.Disturbance(lfo.Box(-0.05, 0.05), start=lfo.Box([-0.1, 0.0], [0.1, 0.0]))
    loop = load.error_loop(problem)
    plain = replace(loop, start=None)
    C, D = np.eye(2), np.zeros((2, 1))
    added = (loop.margins(C, D) - plain.margins(C, D)).T
    powers = [np.linalg.matrix_power(loop.A, t) for t in range(7)]
    np.testing.assert_allclose(added, np.array([0.1 * np.abs(X[:, 0]) for X in powers]).T, atol=1e-13)
    worst = lfo.worst_case(problem, load, lfo.solve(lfo.robust(problem, load)))
    assert worst
    assert any(one.start.any() for one in worst.limits)
    assert all(one.attained == pytest.approx(one.planned + one.sign * one.margin) for one in worst.limits)
