"""Norms, soft limits and squares that are far from their zero, however bounds and dynamics let a state move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import seeds
from lin_freq_ocp.transform import stated_sizes

STEPS = 14
COSTS = {
    "L1": lambda far, unit: lfo.costs.L1Cost(x=1 / unit, u=0.1, x_ref=far * unit),
    "Linf": lambda far, unit: lfo.costs.LInfCost(x=1 / unit, u=0.1, x_ref=far * unit),
    "squares and a norm": lambda far, unit: (
        lfo.QuadraticCost(Q=unit**-2, R=1.0, x_ref=far * unit) + lfo.costs.L1Cost(x=1 / unit, x_ref=far * unit)
    ),
    "squares": lambda far, unit: lfo.QuadraticCost(Q=unit**-2, R=1.0, x_ref=far * unit),
    "soft rows": lambda far, unit: lfo.QuadraticCost(R=1e-3),
    "soft ball": lambda far, unit: lfo.QuadraticCost(R=1e-3),
}


def problem_of(name, far, unit=1.0, start=0.0):
    """Return a state that should come nearer, as fast as it can, to what is out of reach."""
    sign, limits = np.sign(far - start), {}
    if name == "soft rows":
        limits["stage_rows"] = lfo.StageRows([[-sign]], None, [-sign * far * unit], penalty=1 / unit)
    elif name == "soft ball":
        limits["state_set"] = lfo.sets.Soft(lfo.sets.Ball(unit, [far * unit]), 1 / unit)
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[unit]]),
        STEPS,
        COSTS[name](far, unit),
        lfo.Box(-1.0, 1.0),
        initial_state=[start * unit],
        **limits,
    )


METHODS = {  # and distances: at 1e7, the structured method leaves nearly the gap that is allowed
    (method, far) for method in ("auto", "convex", "structured") for far in (1e3, -1e5, 1e6, -1e7)
} - {("structured", -1e7)}


@pytest.mark.parametrize(("method", "far"), seeds(sorted(METHODS)))
@pytest.mark.parametrize("name", COSTS)
def test_the_state_comes_nearer_as_fast_as_it_can(name, method, far):
    for start, reference in ((0.0, far), (far, 0.0)):
        problem = problem_of(name, reference, start=start)
        result = lfo.solve(problem, method)
        assert result.status == "optimal"
        assert result.certificate.globally_optimal
        # x_T has no cost
        np.testing.assert_allclose(result.control[:-1], np.sign(reference - start), rtol=0, atol=1e-5)


@pytest.mark.parametrize("unit", seeds([1e-9, 1e-3, 1e9]))
@pytest.mark.parametrize("name", COSTS)
def test_the_unit_of_the_state_changes_nothing(name, unit):
    result = lfo.solve(problem_of(name, 1e6, unit))
    assert result.status == "optimal"
    np.testing.assert_allclose(result.control[:-1], 1.0, rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", COSTS)
def test_a_loop_from_afar_does_what_single_solves_do(name):
    problem = problem_of(name, 1e6)
    loop = lfo.RecedingHorizon(problem)
    state = np.zeros(1)
    for _ in range(3):
        control = loop.step(state)
        np.testing.assert_allclose(control, 1.0, rtol=0, atol=1e-5)
        state = state + control
    assert set(loop.log.statuses) == {"optimal"}


@pytest.mark.parametrize("bound", [50.0, None])
@pytest.mark.parametrize("far", [1e4, 1e8, -1e6])
@pytest.mark.parametrize("name", COSTS)
def test_modes_are_searched_from_as_near_as_a_state_can_be(name, far, bound):
    linear, within = problem_of(name, far), lfo.Box(-(bound or np.inf), bound or np.inf)
    modes = [
        lfo.AffineMode([[1.0]], [[1.0]], G=[[-1.0]], h=[0.0]),
        lfo.AffineMode([[-0.5]], [[1.0]], G=[[1.0]], h=[0.0]),
    ]
    problem = replace(
        linear,
        dynamics=lfo.PiecewiseAffineDynamics(modes),
        horizon=6,
        state_set=within if linear.state_set is None else within & linear.state_set,
        initial_state=[0.3],
    )
    result = lfo.solve(problem)
    assert result.status == "optimal"
    assert result.certificate.pmp == "satisfied"
    np.testing.assert_allclose(result.control[:5], np.sign(far), rtol=0, atol=1e-5)


@pytest.mark.parametrize("bound", [1e7, 1e9])
@pytest.mark.parametrize("name", ["L1", "Linf"])
def test_a_state_bound_that_stands_for_none_is_no_unit_of_modes(name, bound):
    """A norm far from zero says nothing of the states, and the bounds, which no mode reaches, do not either."""
    modes = [
        lfo.AffineMode([[0.5, 0.4], [-0.3, 0.6]], [[1.0], [0.5]], G=[[1.0, 0.5]], h=[0.1]),
        lfo.AffineMode([[-0.4, 0.2], [0.5, 0.3]], [[1.0], [0.5]], G=[[-1.0, -0.5]], h=[-0.1]),
    ]
    cost = {"L1": lfo.costs.L1Cost, "Linf": lfo.costs.LInfCost}[name](x=1.0, u=0.1, x_ref=1e3)
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseAffineDynamics(modes),
        4,
        cost,
        lfo.Box(-1.0, 1.0),
        state_set=lfo.Box(-bound, bound),
        initial_state=[0.2, -2.2],
    )
    result = lfo.solve(problem)
    assert result.status == "optimal"
    assert max(stated_sizes(problem)[0]) < 100
    unbounded = lfo.solve(replace(problem, state_set=None))
    assert result.cost == pytest.approx(unbounded.cost, rel=1e-9)


@pytest.mark.parametrize(("n", "steps", "weights"), [(2, 25, [1.9, 2.3]), (3, 10, [1.7, 2.7, 3.0])])
def test_rounding_of_far_slacks_is_no_violation_where_rows_force_rest(n, steps, weights):
    """Slacks near 2e5 are rounded by more than what opposed rows leave of a rest at 1."""
    A, first, last = np.eye(n) + np.eye(n, k=1), np.eye(n)[0], np.eye(n)[-1]
    A[-1, -1] = 0.9
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, last[:, None]),
        steps,
        lfo.QuadraticCost(R=0.1) + lfo.costs.LInfCost(x=weights, x_ref=(1 + 1e5) * first) + lfo.costs.L1Cost(u=4.0),
        lfo.Box(-0.5, 0.5),
        initial_state=first,
        terminal_state=first,
        stage_rows=lfo.StageRows([last, -last], None, [0.0, 0.0]),
    )
    assert lfo.solve(problem).status == "optimal"
