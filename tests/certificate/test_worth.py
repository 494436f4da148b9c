"""Residuals of stationarity as the cost that they explain."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.borders import changed
from lin_freq_ocp.certificate import judge

T = 12
STATIONARITY = "adjoint equation", "transversality at 0", "transversality at T", "Hamiltonian stationary in u"
PLANT = lfo.LinearDynamics([[1.0, 0.2], [0.0, 0.9]], [[0.0], [0.2]])


def problem_of(unit: float = 1.0, **changes) -> lfo.OptimalControlProblem:
    cost = lfo.QuadraticCost(Q=np.diag([1.0, 0.5]) * unit, R=0.3 * unit, P=2.0 * unit)
    return lfo.OptimalControlProblem(PLANT, T, **({"cost": cost, "initial_state": [1.0, 0.0]} | changes))


def disturbed(result: lfo.Result, size: float) -> lfo.Trajectory:
    """Return the trajectory of the optimal controls with noise."""
    noise = size * np.random.default_rng(3).standard_normal((T, 1))
    return lfo.simulate(result.problem, result.control + noise)


def worth(certificate: lfo.results.Certificate) -> float:
    return sum(one.residual for one in certificate.conditions if one.name in STATIONARITY)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("size", [1e-4, 1e-2])
def test_it_is_the_difference_from_the_optimal_cost_where_the_hessian_is_diagonal(unit, size):
    problem = problem_of(unit)
    result = lfo.solve(problem)
    trajectory = disturbed(result, size)
    certificate = judge(problem, trajectory, result.multipliers)
    more = problem.value(trajectory.x, trajectory.u) - result.cost
    assert worth(certificate) == pytest.approx(more, rel=1e-6)
    assert all(one.scale == certificate.cost_scale for one in certificate.conditions if one.name in STATIONARITY[::3])
    assert (certificate.pmp == "satisfied") == (more < 1e-6 * certificate.cost_scale)


def test_without_curvature_it_is_the_distance_to_the_far_bound():
    cost, bounds, start = lfo.QuadraticCost(Q=np.eye(2), r=[0.3]), lfo.Box(-1e-3, 2e-3), lfo.Box([0.5, 0.0], [1.0, 0.0])
    problem = problem_of(cost=cost, control_set=bounds, initial_state=start)
    result = lfo.solve(problem)
    nu = result.multipliers.nu + 1e-7
    slope = 1e-7 * np.maximum(2e-3 - result.control, result.control + 1e-3)
    certificate = judge(problem, result.trajectory, changed(result.multipliers, nu=nu))
    (condition,) = (one for one in certificate.conditions if one.name == "Hamiltonian stationary in u")
    assert condition.residual == pytest.approx(slope.sum(), rel=1e-5)


def test_a_wrong_multiplier_of_a_fixed_state_is_not_excused():
    result = lfo.solve(problem_of())
    mu = result.multipliers.mu.copy()
    mu[0] *= 1.1
    certificate = judge(result.problem, result.trajectory, changed(result.multipliers, mu=mu))
    assert [one.name for one in certificate.failed] == ["transversality at 0"]


def test_abnormal_multipliers_are_judged_by_residuals():
    result = lfo.solve(problem_of())
    zero = {name: 0 * getattr(result.multipliers, name) for name in ("mu", "nu", "rho_u", "rho_x")}
    eta = 1e-5 * result.multipliers.eta
    certificate = judge(result.problem, result.trajectory, changed(result.multipliers, eta_C=0.0, eta=eta, **zero))
    assert "Hamiltonian stationary in u" in {one.name for one in certificate.failed}


@pytest.mark.parametrize("wrong", [0.0, 1e-3])
def test_a_component_without_a_price_leaves_the_worth_of_others(wrong):
    """The second state has no weight and no bounds: its residual counts by its scale alone."""
    result = lfo.solve(problem_of(cost=lfo.QuadraticCost(Q=np.diag([1.0, 0.0]), R=0.3, P=np.diag([2.0, 0.0]))))
    eta = result.multipliers.eta.copy()
    eta[-1] += [1e-5, 1e-15 + wrong * np.abs(eta[:, 1]).max()]
    certificate = judge(result.problem, result.trajectory, changed(result.multipliers, eta=eta))
    (at_end,) = (one for one in certificate.conditions if one.name == "transversality at T")
    if wrong:
        assert 0.1 * wrong < at_end.relative < wrong
    else:
        assert at_end.residual == pytest.approx(1e-10 / 4, rel=1e-3)
