"""Neither the unit of a cost by a formula, nor a constant in it, nor a large weight changes a verdict."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive, seeds

ONE = lfo.LinearDynamics([[1.0]], [[1.0]])


def stated(stage, horizon, cost, **fields):
    fields = {"control_set": lfo.Box(-1, 1), "state_set": lfo.Box(-3, 3), "initial_state": [0.0]} | fields
    return lfo.OptimalControlProblem(ONE, horizon, cost + lfo.costs.SmoothCost(stage=stage), **fields)


@pytest.mark.parametrize("unit", seeds([1e-9, 1.0, 1e9]))
def test_a_minimum_of_no_cost_is_one_in_every_unit(unit):
    """Of u - u^2/5 over 0 <= u <= 1, u = 0 is the least, and the Hessian is negative there."""
    problem = stated(f"{unit!r}*(u_0 - 0.2*u_0**2)", 1, lfo.QuadraticCost(), control_set=lfo.Box(0, 1))
    certificate = lfo.certify(problem, np.zeros((1, 1)))
    assert certificate.pmp == "satisfied"
    assert certificate.second_order.passed
    assert lfo.solve(problem, global_bound=False).status == "locally_optimal"
    assert lfo.certify(problem, np.ones((1, 1)) / 2).pmp == "violated"


@pytest.mark.parametrize("unit", seeds([1e-9, 1.0, 1e9]))
def test_rest_at_a_bound_is_stationary_in_every_unit(unit):
    cost = f"{unit!r}*(x_0**2 + 0.37*u_0 + 0.2*u_0**2 + 0.3*x_0*u_0)"
    problem = stated(cost, 3, lfo.QuadraticCost(), control_set=lfo.Box(0, 5), state_set=None)
    assert lfo.certify(problem, np.zeros((3, 1))).pmp == "satisfied"
    assert lfo.solve(problem, global_bound=False).certificate.pmp == "satisfied"


@expensive
def test_a_constant_in_the_cost_is_no_part_of_its_scale():
    scales = list[float]()
    for constant in (0.0, 1e6):
        problem = stated(f"cosh(x_0 - 1) + {constant!r}", 4, lfo.QuadraticCost(R=1.0))
        result = lfo.solve(problem, global_bound=False)
        assert result.status == "optimal"
        off = lfo.certify(problem, result.trajectory.u + 0.01)
        assert off.pmp == "violated"
        assert not off.globally_optimal
        scales.append(result.certificate.cost_scale)
    assert scales[1] <= 3 * scales[0]


@pytest.mark.parametrize("weight", seeds([2e4, 2e7, 2e10]))
def test_a_large_weight_at_the_end_loosens_nothing_before(weight):
    """The cost falls with slope -1.6 a along (1, -1) at (a, -a), and to second order at 0."""
    problem = stated("-x_0**2", 2, lfo.QuadraticCost(R=0.2, P=weight))
    assert lfo.certify(problem, np.zeros((2, 1))).second_order.passed is False
    for part in (0.1, 0.9):
        assert lfo.certify(problem, [[part], [-part]]).pmp == "violated"
    assert lfo.certify(problem, [[1.0], [-weight / (weight + 0.2)]]).pmp == "satisfied"


def test_a_large_weight_on_one_component_loosens_no_other():
    dynamics, free = lfo.LinearDynamics(np.eye(2), np.eye(2)), lfo.Box([-1, -1], [1, 1])
    cost = lfo.QuadraticCost(R=0.2 * np.eye(2)) + lfo.costs.SmoothCost(stage="-x_0**2 + 1e9*x_1**2")
    problem = lfo.OptimalControlProblem(dynamics, 3, cost, free, initial_state=[0, 0], terminal_state=[0, 0])
    assert lfo.certify(problem, [[0.5, 0], [0, 0], [-0.5, 0]]).pmp == "violated"
    least = lfo.certify(problem, [[1.0, 0], [0, 0], [-1, 0]])
    assert (least.pmp, least.second_order.passed) == ("satisfied", True)  # with the multipliers of both bounds of u_0


@pytest.mark.parametrize("weight", [2e5, 2e7])
def test_the_accuracy_of_a_solve_does_not_fall_with_a_large_weight(weight):
    """From the saddle 0, where the cost falls to second order."""
    result = lfo.solve(stated("-x_0**2", 2, lfo.QuadraticCost(R=0.2, P=weight)), global_bound=False)
    assert result.status == "locally_optimal"
    assert result.cost == pytest.approx(-0.8, rel=1e-5)


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_rows_are_violated_at_rest_far_from_zero_in_every_unit(unit):
    """The state stays at its start, which is the origin of the translated problem."""
    for limit, kept in ((1 - 1e-5, False), (1 + 1e-5, True)):
        rows = lfo.sets.StageRows([[1.0]], [[0.0]], [[2 * unit], [limit * unit]])
        problem = lfo.OptimalControlProblem(
            ONE, 2, lfo.QuadraticCost(R=1.0), lfo.Box(-unit, unit), initial_state=[unit], stage_rows=[rows]
        )
        assert lfo.certify(problem, np.zeros((2, 1))).feasible is kept


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize(("third", "zero"), [("", [2, 3, 4, 5]), (", {}", [])], ids=["a kink", "smoothed"])
def test_a_norm_is_zero_at_the_same_times_in_every_unit(unit, third, zero):
    """The first step leaves a twelfth of it, and the second nothing; a constant in it, in this unit, leaves no kink."""
    cost = lfo.costs.SmoothCost(stage=f"norm(x_0, x_1{third.format(0.01 * unit)})/{unit!r}")
    cost = cost + lfo.QuadraticCost(R=1.2 / unit**2 * np.eye(2))
    dynamics = lfo.LinearDynamics(np.eye(2), np.eye(2))
    result = lfo.solve(lfo.OptimalControlProblem(dynamics, 6, cost, initial_state=[unit, 0.0]))
    assert (result.status, result.certificate.pmp) == ("optimal", "satisfied")
    assert [kink.time for kink in result.certificate.borders.norms] == zero
    if zero:
        assert result.trajectory.x[1] == pytest.approx([unit / 12, 0.0])


@pytest.mark.parametrize("unit", [1e-9, 1e-6, 1.0, 1e6])
def test_a_norm_in_the_dynamics_is_far_from_zero_in_every_unit(unit):
    """Steer (x_0 (1 - u), |x| u): nothing of it depends on the unit of x."""
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(["x_0*(1 - u_0)", "norm(x_0, x_1)*u_0"], 2, 1)
    cost = lfo.QuadraticCost(Q=2 / unit**2, R=2.0)
    problem = lfo.OptimalControlProblem(dynamics, 3, cost, lfo.Box(0, 1), initial_state=[unit, 0.0])
    result = lfo.solve(problem, global_bound=False)
    assert (result.status, result.certificate.borders.norms) == ("locally_optimal", ())
    assert result.cost == pytest.approx(1.9590236928, rel=1e-9)
