"""The global bound of convex problems with costs by formulas, from any multipliers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive, seeds

A = np.array([[1.0, 0.1, 0.0, 0.0], [0.0, 1.0, 0.1, 0.0], [0.0, 0.0, 0.9, 0.1], [0.0, 0.0, 0.0, 0.8]])
B = np.array([[0.0], [0.0], [0.1], [1.0]])


def stated(cost, **fields):
    """Return a convex problem of four states: too many for dynamic programming."""
    fields = {"control_set": lfo.Box(-2, 2), "initial_state": [1.0, -0.5, 0.2, 0.0]} | fields
    return lfo.OptimalControlProblem(lfo.LinearDynamics(A, B), 15, cost, **fields)


PROBLEMS = {
    "quartic": stated(lfo.QuadraticCost(R=0.1, Q=0.01) + lfo.costs.SmoothCost(stage="(x_0 - 0.3*x_1)**4")),
    "exponentials": stated(lfo.costs.SmoothCost(stage="exp(x_0) + exp(-x_1) + cosh(u_0)", terminal="exp(x_0)")),
    "beside a norm": stated(
        lfo.QuadraticCost(R=0.1) + lfo.costs.L1Cost(x=0.2) + lfo.costs.SmoothCost(stage="exp(x_0 + x_1)")
    ),
    "low pass": stated(
        lfo.QuadraticCost(R=0.1, u_ref=0.1, x_ref=[0.1, 0.0, 0.0, 0.0], Q=0.1)
        + lfo.costs.SmoothCost(stage="(x_0 - sin(t))**2 + 0.1*t*x_1**2", terminal="x_0**2 + x_2**4"),
        control_spectrum=lfo.low_pass(1.5),
    ),
}


@expensive
@pytest.mark.parametrize("name", list(PROBLEMS))
def test_a_convex_problem_is_proven_to_be_optimal(name):
    result = lfo.solve(PROBLEMS[name])
    assert result.status == "optimal"
    assert result.certificate.bound.kind == "rigorous"
    assert abs(result.gap) <= 1e-8
    again = lfo.certify(result.problem, result.trajectory, result.multipliers)
    assert again.globally_optimal


@pytest.mark.at_tolerance("random multipliers: only the bound counts")
@pytest.mark.parametrize("name", list(PROBLEMS))
@pytest.mark.parametrize("seed", seeds(range(4)))
def test_the_bound_of_any_multipliers_and_trajectory_is_below_the_optimum(name, seed):
    problem, rng = PROBLEMS[name], np.random.default_rng(seed)
    result = lfo.solve(problem)
    y, size = result.multipliers, 10.0 ** rng.uniform(-4, 0)
    moved = lfo.simulate(problem, result.trajectory.u + size * rng.normal(size=result.trajectory.u.shape))
    other = replace(y, eta=y.eta + size * rng.normal(size=y.eta.shape))
    for trajectory, multipliers in ((result.trajectory, other), (moved, y), (moved, other)):
        certificate = lfo.certify(problem, trajectory, multipliers)
        if certificate.bound is not None and certificate.bound.kind == "rigorous":
            assert certificate.bound.value <= result.cost + 1e-12 * certificate.cost_scale


@expensive
@pytest.mark.parametrize("control", [[-2.0, 0.0], [-1.5, -0.2], [-1.5, 1.3]])
@pytest.mark.parametrize("constrained", [False, True])
def test_tangents_at_a_trajectory_outside_of_the_sets_give_no_bound_above_the_optimum(control, constrained):
    """x^3 is convex where x >= 0 only: its tangent at -1.5 is above it within the sets."""
    cost, rows = lfo.QuadraticCost(R=0.01), []
    if constrained:
        cost, rows = lfo.QuadraticCost(R=1.0, Q=1.0, x_ref=3.0), [lfo.sets.PathConstraint("x_0**3", upper=0.5)]
    else:
        cost = cost + lfo.costs.SmoothCost(stage="x_0**3", terminal="x_0**3")
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[1.0]]),
        2,
        cost,
        initial_state=[0.5],
        state_set=lfo.Box(0.1, 5),
        control_set=lfo.Box(-2, 2),
        stage_rows=rows,
    )
    result = lfo.solve(problem)
    assert result.status == "optimal"
    outside = lfo.simulate(problem, np.reshape(control, (-1, 1)))
    bound = lfo.certify(problem, outside, result.multipliers).bound
    assert bound is None or bound.value <= result.cost + 1e-9


@expensive
def test_a_problem_that_is_not_convex_has_no_such_bound():
    for cost in ("cos(x_0)", "x_0*u_0", "x_0**4 - x_0**2"):
        result = lfo.solve(stated(lfo.QuadraticCost(R=0.1, Q=0.01) + lfo.costs.SmoothCost(stage=cost)), "nonsmooth")
        assert result.certificate.bound is None
        assert result.status == "locally_optimal"
    message = lfo.solve(stated(lfo.QuadraticCost(R=0.1) + lfo.costs.SmoothCost(stage="cos(x_0)"))).message
    assert "got 4 states; expected at most 3" in message


def test_a_direction_without_curvature_stays_without():
    """Of (x_0 + 2 x_1)^2/2 along (2, -1): a parabola of the curvature of x_1 alone would lie above it."""
    cost = lfo.QuadraticCost(r=[-0.2, 0.1]) + lfo.costs.SmoothCost(terminal="0.5*(x_0 + 2*x_1)**2")
    sets = {"control_set": lfo.Box(-5, 5), "state_set": lfo.Box(-5, 5), "initial_state": [0.0, 0.0]}
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics(np.eye(2), np.eye(2)), 1, cost, **sets)
    result = lfo.solve(problem)
    other = replace(result.multipliers, eta=np.array([[0.0, 0.1]]))
    certificate = lfo.certify(problem, lfo.simulate(problem, [[0.0, 0.0]]), other)
    assert certificate.bound.kind == "rigorous"
    assert certificate.bound.value <= result.cost


@expensive
@pytest.mark.parametrize("origin", [0.0, 10.0, 1e3])
def test_it_does_not_depend_on_where_zero_is(origin):
    stage, terminal = f"(x_0 - {origin})**4 + (x_1 - {origin})**2 + u_0**2", f"cosh(x_0 - {origin})"
    A = np.array([[1.0, 0.2], [0.0, 1.1]])
    dynamics = lfo.LinearDynamics(A, [[0.1], [0.3]], offset=(np.eye(2) - A) @ np.full(2, origin))
    cost, start = lfo.costs.SmoothCost(stage=stage, terminal=terminal), [origin + 1.0, origin + 0.5]
    result = lfo.solve(lfo.OptimalControlProblem(dynamics, 12, cost, lfo.Box(-0.8, 0.8), initial_state=start))
    assert result.status == "optimal"
    assert result.certificate.bound.kind == "rigorous"


ONE = lfo.LinearDynamics([[1.0]], [[1.0]])


def test_cancellation_in_a_cost_raises_no_bound_above_the_optimum():
    """1 - cos(x) of x = 3e-7 has two digits, 2 sin(x/2)^2 all."""
    costs = {}
    for text in ("1 - cos(x_0)", "2*sin(x_0/2)**2"):
        cost, sets = lfo.QuadraticCost(R=1.0) + lfo.costs.SmoothCost(stage=text), lfo.Box(-0.5, 0.5)
        problem = lfo.OptimalControlProblem(ONE, 3, cost, sets, state_set=sets, initial_state=[3.21e-7])
        costs[text] = lfo.solve(problem, global_bound=False)
    rounded, exact = costs.values()
    assert exact.status == "optimal"
    assert rounded.certificate.bound.kind == "rigorous"
    assert 0.8 * exact.cost <= rounded.lower_bound <= exact.cost
    assert not rounded.certificate.globally_optimal


def test_cancellation_in_a_path_constraint_proves_no_infeasibility():
    """log(cosh(1e-6)) is 5e-13 - 8e-26, and as computed 5.0004e-13: neither x_0 nor tangents exclude a trajectory."""
    rows, sides = lfo.sets.PathConstraint("log(cosh(x_0))", upper=5.00005e-13), lfo.Box(-0.5, 0.5)
    narrow = lfo.Box(-1e-9, 1e-9)
    problem = lfo.OptimalControlProblem(
        ONE, 1, lfo.QuadraticCost(R=1.0), narrow, sides, initial_state=[1e-6], stage_rows=rows
    )
    assert lfo.solve(problem, global_bound=False, throw=False).status != "infeasible"
    assert rows.at_dimensions(1, 1, 1, "").excludes(0, np.array([1.02e-6]))  # by more than rounding
