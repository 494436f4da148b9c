"""Saddles are called by their name and left, and where the test of second order does not apply, that is said."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.command_line import run
from helpers.published import clnlbeam, runge_kutta, smooth_problem
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.certificate import judge
from lin_freq_ocp.methods import zero_multipliers


def double_well(horizon=4, **sets):
    """Return x+ = x + u, with the wells x^4/4 - x^2/2 at every time: at rest in between is a saddle."""

    def stage(x, u):
        return x[0] ** 4 / 4 - x[0] ** 2 / 2 + u[0] ** 2 / 20

    return smooth_problem(lambda x, u: [x[0] + u[0]], [0.0], 1, horizon, stage, **sets)


def at_rest(problem):
    """Return the trajectory without controls, and its multipliers: the cost is counted by the last state."""
    trajectory = lfo.simulate(problem, np.zeros((problem.horizon, 1)))
    multipliers = zero_multipliers(problem, 1.0)
    eta = np.zeros_like(multipliers.eta)
    eta[:, -1] = -1.0
    mu = np.zeros_like(multipliers.mu)
    mu[0, -1] = -1.0  # the first state is fixed
    return trajectory, lfo.results.Multipliers(1.0, eta, mu, multipliers.nu, multipliers.rho_u, multipliers.rho_x)


def test_a_saddle_is_extremal_and_its_direction_lowers_the_cost():
    problem = double_well()
    trajectory, multipliers = at_rest(problem)
    certificate = judge(problem, trajectory, multipliers)
    assert certificate.pmp == "satisfied"
    assert certificate.status_within(0.0) == "extremal"
    assert certificate.status_within(0.0).solved
    test = certificate.second_order
    assert test.passed is False
    assert test.curvature < 0
    assert "the cost falls to second order along a direction" in str(certificate)
    after = lfo.simulate(problem, trajectory.u + 1e-2 * test.direction.u)
    assert problem.value(after.x, after.u) < certificate.cost


@pytest.mark.parametrize("bound", [None, 10.0, 1e6, 1e15])
@pytest.mark.parametrize("unit", [1e-4, 1.0, 1e4])
def test_neither_units_nor_far_bounds_decide(unit, bound):
    def stage(x, u):
        return (x[0] / unit) ** 4 / 4 - (x[0] / unit) ** 2 / 2 + (u[0] / unit) ** 2 / 20

    control_set = None if bound is None else lfo.Box(-bound * unit, bound * unit)
    problem = smooth_problem(lambda x, u: [x[0] + u[0]], [0.0], 1, 4, stage, control_set=control_set)
    certificate = judge(problem, *at_rest(problem))
    assert certificate.status_within(0.0) == "extremal"


def test_a_saddle_is_left_by_the_search():
    result = lfo.solve(double_well(), global_bound=False, start=np.zeros((4, 1)))
    assert result.status == "locally_optimal"
    assert result.certificate.second_order.passed
    assert result.cost < -0.5


def test_a_saddle_that_is_not_left_is_an_answer(monkeypatch):
    substitute(monkeypatch, "solving.hybrid.MOST_SADDLES", 0)
    result = lfo.solve(double_well(), global_bound=False, start=np.zeros((4, 1)))
    assert result.status == "extremal"
    assert "the cost falls to second order along a direction" in result.message


def test_a_bound_that_is_active_with_a_multiplier_takes_the_direction_away():
    # u at its upper bound everywhere: no direction is left, though the cost is concave in u
    problem = smooth_problem(
        lambda x, u: [x[0] + u[0]], [0.0], 1, 3, lambda x, u: -(u[0] ** 2) - u[0], control_set=lfo.Box(-1.0, 1.0)
    )
    result = lfo.solve(problem, global_bound=False)
    assert (result.status, result.certificate.second_order.passed) == ("locally_optimal", True)
    np.testing.assert_allclose(result.control, 1.0, atol=1e-6)


def test_a_fixed_control_takes_its_direction_away_without_a_multiplier():
    problem = double_well(control_set=lfo.Box(0.0, 0.0))
    assert judge(problem, *at_rest(problem)).second_order.passed is True


@expensive
def test_the_buckled_beam_is_found_behind_the_straight_one():
    result = lfo.solve(clnlbeam(10), global_bound=False)
    assert result.status == "locally_optimal"
    assert result.cost == pytest.approx(345.03110763, rel=1e-8)  # IPOPT from this answer


@expensive
@pytest.mark.parametrize("part", [1.02, 0.9])
def test_a_good_start_of_the_beam_is_not_lost(part):
    problem = clnlbeam(10)
    known = lfo.solve(problem, global_bound=False)
    start = lfo.Trajectory(part * known.trajectory.x, part * known.trajectory.u)
    assert lfo.solve(problem, global_bound=False, start=start).cost == pytest.approx(known.cost, rel=1e-8)


def flat_top(bound, unit, origin):
    """Return the cost ((x - origin)^2/unit^2 - 1)^2 with bounds, and the start on its top, a saddle."""

    def stage(x, u):
        return (((x[0] - origin) / unit) ** 2 - 1) ** 2

    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[1.0]]),
        12,
        lfo.QuadraticCost(R=0.1 / unit**2) + lfo.costs.SmoothCost(stage=stage),
        control_set=lfo.Box(-bound * unit, bound * unit),
        state_set=lfo.Box(origin - bound * unit, origin + bound * unit),
        initial_state=[origin],
    )
    return problem, lfo.Trajectory(np.full((13, 1), origin), np.zeros((12, 1)))


@pytest.mark.parametrize(
    ("bound", "unit", "origin"),
    seeds([(1e3, 1e6, 0.0), (1e9, 1.0, 0.0), (1e9, 1e-3, 0.0), (1e9, 1e3, 1e7), (1e6, 1e6, 1e7)]),
)
def test_a_saddle_is_left_with_far_bounds_in_all_units_and_from_all_origins(bound, unit, origin):
    problem, start = flat_top(bound, unit, origin)
    result = lfo.solve(problem, start=start, global_bound=False, throw=False)
    assert result.status == "locally_optimal"
    assert result.cost == pytest.approx(1.0493827174769796, rel=1e-8)  # with a unit of 1 and bounds of 3


@expensive
@pytest.mark.parametrize(("bound", "unit", "steps"), [(1e3, 1.0, 6), (1e6, 1e6, 12)])
def test_wells_in_the_dynamics_are_left_with_far_bounds(bound, unit, steps):
    def f(x, u):
        return [x[0] + u[0], x[1] + unit * ((x[0] / unit) ** 4 / 4 - (x[0] / unit) ** 2 / 2)]

    far = lfo.Box([-bound * unit, -np.inf], [bound * unit, np.inf])
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseSmoothDynamics.from_formulas(f, 2, 1),
        steps,
        lfo.QuadraticCost(R=0.05 / unit**2, p=[0.0, 1.0 / unit]),
        lfo.Box(-bound * unit, bound * unit),
        far,
        initial_state=[0.0, 0.0],
    )
    rest = lfo.Trajectory(np.zeros((steps + 1, 2)), np.zeros((steps, 1)))
    assert lfo.certify(problem, rest).second_order.passed is False
    result = lfo.solve(problem, start=rest, global_bound=False)
    assert result.status == "locally_optimal"
    assert result.cost < -0.8


def test_functions_without_a_hessian_leave_it_undecided():
    def rates(x, u):
        return [u[0] - np.sin(x[0])]

    f = lfo.DifferentiableFunction(
        lambda x, u: [x[0] + 0.1 * (u[0] - np.sin(x[0]))], lambda x, u: [[1.0 - 0.1 * np.cos(x[0]), 0.1]], name="drag"
    )
    cost = lfo.QuadraticCost(Q=1.0, R=1.0)
    sets = {"initial_state": [2.0]}
    rough = lfo.OptimalControlProblem(lfo.PiecewiseSmoothDynamics([lfo.dynamics.SmoothMode(f)], 1, 1), 10, cost, **sets)
    result = lfo.solve(rough, global_bound=False)
    assert result.status == "locally_optimal"
    assert str(result.certificate.second_order) == "not decided: drag has no exact second derivatives"
    exact = smooth_problem(runge_kutta(rates, 0.1), [2.0], 1, 10, Q=1.0, R=1.0)
    assert lfo.solve(exact, global_bound=False).certificate.second_order.passed


def test_the_command_certifies_a_saddle(tmp_path):
    problem = double_well()
    files = tmp_path / "wells.toml", tmp_path / "rest.csv"
    lfo.io.write_problem(problem, files[0])
    rows = ["time,x_0,x_1,u_0", *(f"{t},0,0,0" for t in range(4)), "4,0,0,"]
    files[1].write_text("\n".join(rows))
    status, out, _ = run("certify", *map(str, files))
    assert status == 0
    assert "no minimum: the cost falls to second order" in " ".join(out.split())


@pytest.mark.parametrize("bounds", [(0.0, 10.0), (-10.0, 0.0)])
def test_the_direction_keeps_bounds_that_are_active_without_a_multiplier(bounds):
    cost = lfo.QuadraticCost(R=1.0) + lfo.costs.SmoothCost(terminal="-2*x_0**2")
    dynamics = lfo.LinearDynamics([[1.0]], [[1.0]])
    problem = lfo.OptimalControlProblem(dynamics, 3, cost, lfo.Box(*bounds), initial_state=[0.0])
    test = lfo.certify(problem, lfo.Trajectory(np.zeros((4, 1)), np.zeros((3, 1)))).second_order
    assert test.passed is False
    assert (test.direction.u >= bounds[0]).all()
    assert (test.direction.u <= bounds[1]).all()


def test_directions_without_curvature_are_no_descent():
    """Only the sum of both controls moves the state: their difference is free, and its pivot is zero."""
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(["sin(x_0) + u_0 + u_1"], 1, 2)
    cost = lfo.QuadraticCost(Q=1.0, P=1.0)
    problem = lfo.OptimalControlProblem(dynamics, 4, cost, lfo.Box(-1, 1), initial_state=[0.0])
    assert lfo.certify(problem, lfo.Trajectory(np.zeros((5, 1)), np.zeros((4, 2)))).second_order.passed
