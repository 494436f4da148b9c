"""The correction of a point: against dense matrices, in deviations, with the price of what is left."""

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp

import lin_freq_ocp as lfo
from lin_freq_ocp.methods import corrections, deviations_from, solve_convex, zero_multipliers
from lin_freq_ocp.program import Program, solve_active

DYNAMICS = lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]], sampling_time=0.1)


def move(**fields):
    data = {"initial_state": [0.0, 0.0], "terminal_state": [0.3, 0.0]} | fields
    cost = data.pop("cost", lfo.QuadraticCost(R=1.0))
    return lfo.OptimalControlProblem(DYNAMICS, 20, cost, **data)


def rough(problem, error=1e-5):
    """Return a solver's answer with an error."""
    answer, rng = solve_convex(problem, "clarabel"), np.random.default_rng(0)
    x, u = (part + error * rng.standard_normal(part.shape) for part in (answer.trajectory.x, answer.trajectory.u))
    return answer, lfo.Trajectory(x, u)


def correct(problem, trajectory, multipliers):
    """Return the first correction with a price, None without one."""
    return next((one for one in corrections(problem, trajectory, multipliers) if np.isfinite(one.price)), None)


def test_it_is_the_optimum_on_the_active_rows_as_dense_matrices_have_it():
    problem = move(control_set=lfo.Box(-0.38, 0.38))
    answer, start = rough(problem)
    corrected = correct(problem, start, answer.multipliers)
    # minimise |u|^2 / 2 subject to the end, with the controls at bounds held there
    A, B = problem.dynamics.A, problem.dynamics.B
    E = np.hstack([np.linalg.matrix_power(A, 19 - t) @ B for t in range(20)])
    held = np.abs(answer.trajectory.u.ravel()) > 0.38 - 1e-6
    assert 2 <= held.sum() <= 17
    fixed = np.where(held, np.sign(answer.trajectory.u.ravel()) * 0.38, 0.0)
    free = E[:, ~held]
    u = fixed.copy()
    u[~held] = free.T @ np.linalg.solve(free @ free.T, np.array([0.3, 0.0]) - E @ fixed)
    np.testing.assert_allclose(corrected.trajectory.u.ravel(), u, rtol=0, atol=1e-13)
    assert np.abs(corrected.trajectory.u).max() == 0.38
    assert corrected.price < 1e-15


@pytest.mark.parametrize(("start", "gain"), [(1.0, 1e-3), (1.0, 1e-9), (1e8, 1e-3)])
def test_a_small_move_far_from_zero_keeps_its_digits(start, gain):
    """x+ = x + g u from 1 to 1 + d: a point without controls is corrected to the best, all d / (20 g)."""
    end = start + 20 * gain
    dynamics = lfo.LinearDynamics([[1.0]], [[gain]])
    problem = lfo.OptimalControlProblem(
        dynamics, 20, lfo.QuadraticCost(R=1.0), initial_state=[start], terminal_state=[end]
    )
    corrected = correct(
        problem, lfo.Trajectory(np.full((21, 1), start), np.zeros((20, 1))), zero_multipliers(problem, 1.0)
    )
    exact = float(10 * ((Fraction(end) - Fraction(start)) / (20 * Fraction(gain))) ** 2)
    cost = problem.value(corrected.trajectory.x, corrected.trajectory.u)
    assert abs(cost - exact) <= corrected.price + 1e-12 * exact
    assert corrected.price <= 1e-6 * exact


def test_what_rounding_of_the_data_is_worth_grows_as_the_move_shrinks():
    worth = []
    for gain in (1e-3, 1e-6):
        problem = lfo.OptimalControlProblem(
            lfo.LinearDynamics([[1.0]], [[gain]]), 20, lfo.QuadraticCost(R=1.0), None, None, [1.0], [1.0 + 20 * gain]
        )
        answer = solve_convex(problem, "clarabel")
        worth.append(correct(problem, answer.trajectory, answer.multipliers).data_rounding)
    assert 1e-16 < worth[0] < 1e-10
    assert 100 < worth[1] / worth[0] < 1e5


@pytest.mark.parametrize(("distance", "rounding"), [(1e-3, False), (1e-11, False), (1e-14, True)])
def test_no_price_is_known_where_nothing_reaches_the_end(distance, rounding):
    """No control moves x_2, whose end is so far away."""
    ends = [0.0, 1.0], [1.0, 1.0 + distance]
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics(np.eye(2), [[1.0], [0.0]]), 5, lfo.QuadraticCost(R=1.0), None, None, *ends
    )
    point = lfo.Trajectory(np.ones((6, 2)), np.zeros((5, 1)))
    assert (correct(problem, point, zero_multipliers(problem, 1.0)) is not None) == rounding


def test_a_wrong_active_row_is_found_out():
    """Some rows of the solver's point are active by its error alone: they lead to a worse point with a price."""
    A, B, wave = [[1.0, 1.0], [0.0, 1.0]], [[0.5], [1.0]], np.sin(1.3 * np.arange(7))
    cost = lfo.QuadraticCost(Q=0.5, R=0.2, P=1.0, x_ref=np.outer(wave, [1.0, 0.0]))
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, B),
        6,
        cost + lfo.costs.LInfCost(x=0.3, u=0.4, terminal=1.0),
        lfo.Box(-1, 1),
        lfo.Box(-5, 5),
        [1.5, 0.0],
        lfo.sets.LinkedEnds([[0.5, 0.0]], [[1.0, 0.0]], [0.2]),
    )
    result = lfo.solve(problem, "convex")
    assert (result.status, round(result.cost, 9)) == ("optimal", round(lfo.solve(problem, "structured").cost, 9))


@pytest.mark.parametrize("miss", [1e-7, 3e-7])
def test_a_row_too_far_to_play_a_part_has_no_price_where_the_answer_violates_it(miss):
    """u >= -1 is beyond FAR_ROW in the unit of what dynamics miss, and u = -2 would cost least."""
    cost, row = lfo.QuadraticCost(R=0.5, r=[1.0]), lfo.StageRows(D=[[-1.0]], e=[1.0])
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[1.0]]), 4, cost, initial_state=[0.0], stage_rows=row
    )
    point = lfo.Trajectory(np.append(0.0, np.full(4, miss))[:, None], np.zeros((4, 1)))
    deviations, z, _ = next(iter(deviations_from(problem, point, zero_multipliers(problem, 1.0))))
    refined = list(deviations.refinements(z))
    assert refined
    for one in refined:
        np.testing.assert_allclose(one.trajectory.u, -2.0, atol=1e-3)
        assert one.price == np.inf


@pytest.mark.parametrize("band", [None, 1.0])
def test_rounding_far_larger_than_what_is_left_is_the_unit_of_the_solve_that_allows_for_it(band):
    """Two rows leave rest alone: position 1.0 has rounding errors far larger than what controls at rest move."""
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0, 1.0], [0.0, 0.9]], [[0.0], [1.0]]),
        10,
        lfo.QuadraticCost(R=0.1) + lfo.costs.LInfCost(x=[2.3, 1.5], x_ref=[2.2, 0.0]) + lfo.costs.L1Cost(u=4.0),
        lfo.Box(-0.5, 0.5),
        initial_state=[1.0, 0.0],
        terminal_state=[1.0, 0.0],
        control_spectrum=None if band is None else lfo.low_pass(band),
        stage_rows=lfo.StageRows(C=[[0.0, 1.0], [0.0, -1.0]], e=[0.0, 0.0]),
    )
    assert lfo.solve(problem).status == "optimal"


TERMS = {
    "free start": {"initial_state": lfo.Box([0.0, -0.1], [0.0, 0.1])},
    "soft bounds": {"state_set": lfo.sets.Soft(lfo.Box([-1.0, -0.2], [1.0, 0.2]), 3.0)},
    "joint rows": {"stage_rows": lfo.StageRows(C=[[0.0, 1.0]], D=[[0.1]], e=[0.2])},
    "a mask": {"control_spectrum": lfo.MagnitudeBound(0.8, band=lfo.low_pass(cutoff_hz=1.0))},
    "a stop band": {"control_spectrum": lfo.low_pass(cutoff_hz=2.0)},
    "periodic ends": {
        "initial_state": None,
        "terminal_state": lfo.Periodic(),
        "cost": lfo.QuadraticCost(Q=1.0, R=1.0, x_ref=[1.0, 0.1]),
    },
    "absolute values": {"cost": lfo.QuadraticCost(R=1e-2) + lfo.costs.L1Cost(u=1.0)},
}


@pytest.mark.parametrize("fields", TERMS.values(), ids=TERMS)
def test_points_of_every_kind_of_constraint_are_corrected(fields):
    problem = move(**fields)
    answer, start = rough(problem, 1e-7)
    corrected = correct(problem, start, answer.multipliers)
    exact = problem.value(answer.trajectory.x, answer.trajectory.u)
    cost = problem.value(corrected.trajectory.x, corrected.trajectory.u)
    assert cost == pytest.approx(exact, rel=1e-6, abs=1e-12)
    assert corrected.price <= 1e-9 * max(cost, 1e-6)
    residual = corrected.trajectory.x[1:] - problem.linear.successors(corrected.trajectory.x, corrected.trajectory.u)
    assert np.abs(residual).max() < 1e-15


@pytest.mark.parametrize("cones", [False, True])
def test_of_two_limits_that_cannot_both_be_reached_the_nearer_one_holds(cones):
    """The least 500 (z - 2)^2 with |z| <= 1 and |z| <= 1 + 4e-12, from prices on both: the farther limit has none."""
    limits = np.array([1.0, 1.0 + 4e-12])
    if cones:  # s = (limit, z) in a cone each
        A, lower = [[0.0], [1.0], [0.0], [1.0]], [-limits[0], 0.0, -limits[1], 0.0]
        prices, shape = np.array([-500.0, 500.0, -500.0, 500.0]), (slice(0, 2), slice(2, 4))
    else:
        A, lower, prices, shape = [[1.0], [1.0]], -limits, np.array([500.0, 500.0]), ()
    upper = np.full(4, np.inf) if cones else limits
    program = Program(sp.csc_array([[1e3]]), np.array([-2e3]), sp.csc_array(A), np.array(lower), upper, cones=shape)
    z, y, _ = solve_active(program, np.array([1.0]), prices)
    assert z[0] == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(y, [-1e3, 1e3, 0.0, 0.0] if cones else [1e3, 0.0], atol=1e-9)


@pytest.mark.parametrize("cones", [False, True])
def test_of_rows_that_depend_on_each_other_one_leaves_at_a_time(cones):
    """The point nearest to (1, 2) with four rows, of which three end at the optimum, zero. All at once, they return."""
    A, limits = np.array([[3.0, 2.0], [3.0, 1.0], [-3.0, -1.0], [-2.0, 0.0]]), np.array([0.0, 0.0, 1e-6, 0.0])
    lower, prices, shape = np.full(4, -np.inf), np.ones(4), ()
    if cones:  # limit + 1 - a'z >= |(1)|
        A, lower, limits = np.kron(-A, [[1.0], [0.0]]), -np.ravel([limits + 1.0, np.ones(4)], "F"), np.full(8, np.inf)
        prices, shape = np.tile([-1.0, 1.0], 4), tuple(slice(i, i + 2) for i in range(0, 8, 2))
    program = Program(sp.csc_array(np.eye(2)), np.array([-1.0, -2.0]), sp.csc_array(A), lower, limits, cones=shape)
    z, y, _ = solve_active(program, np.zeros(2), prices)
    np.testing.assert_allclose(z, 0.0, atol=1e-11)
    np.testing.assert_allclose(program.A.T @ y, [1.0, 2.0], rtol=0, atol=1e-6)
    assert (y[::2] <= 0).all() if cones else (y >= 0).all()


def nearest_in_cone(wish):
    """Return the program of the point of z_0 >= |z_1| that is nearest to a wish."""
    identity, none = sp.eye_array(2, format="csc"), np.full(2, np.inf)
    return Program(identity, -np.array(wish), identity, np.zeros(2), none, cones=(slice(0, 2),))


@pytest.mark.parametrize("wish", [(-1.0, 0.3), (-1.0, 0.0), (-0.5, -0.4), (0.0, 0.0)])
@pytest.mark.parametrize("error", [0.0, 1e-6])
def test_at_the_apex_of_a_cone_all_its_rows_hold(wish, error):
    """The point nearest to a wish in the polar cone is zero, and the wish is the multiplier."""
    z, y = error * np.array([1.0, 0.5]), np.array(wish) + error * np.array([0.3, -0.2])
    z, y, _ = solve_active(nearest_in_cone(wish), z, y)
    np.testing.assert_allclose(z, 0.0, atol=1e-12)
    np.testing.assert_allclose(y, wish, atol=1e-11)


@pytest.mark.parametrize("wish", [(1.0, 0.2), (0.2, 1.0), (-0.2, 1.0)])
def test_a_point_that_leaves_the_apex_finds_the_edge_or_the_inside(wish):
    z, _, _ = solve_active(nearest_in_cone(wish), np.array([1e-9, 0.0]), np.array([-1.0, 0.1]))
    inside = wish[0] >= abs(wish[1])
    np.testing.assert_allclose(z, wish if inside else [sum(wish) / 2] * 2, atol=1e-10)


def test_curved_edges_of_rows_over_all_variables_leave_the_factor_sparse():
    """The point of |G z| <= 1 nearest to w, G'G = 1 on two directions of 400: their part of w shrinks to size 1."""
    G, w = np.linalg.qr(np.random.default_rng(0).standard_normal((400, 2)))[0].T, np.linspace(-3.0, 3.0, 400)
    A, lower = sp.csc_array(np.vstack([np.zeros(400), G])), np.array([-1.0, 0.0, 0.0])
    program = Program(sp.eye_array(400, format="csc"), -w, A, lower, np.full(3, np.inf), cones=(slice(0, 3),))
    part = G @ w
    size = float(np.linalg.norm(part))
    assert size > 1.0
    nearest, price = w - G.T @ (part - part / size), (size - 1.0) * np.append(-1.0, part / size)
    z, y, system = solve_active(program, nearest + 1e-4 * (G[0] - G[1]), price)
    np.testing.assert_allclose(z, nearest, rtol=0, atol=1e-13)
    np.testing.assert_allclose(y, price, rtol=0, atol=1e-12)
    assert system.factor.nnz < 20 * 400  # 400^2 with the curvature of the edge in H
