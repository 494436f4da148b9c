"""Loops over smooth pieces: local optima from the plan before, without a global bound unless one is asked for."""

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.replacing import substitute

HORIZON = 3


@pytest.fixture
def problem():
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(["x_0 + 0.1*sin(x_0) + u_0"], state_dim=1, control_dim=1)
    cost = lfo.QuadraticCost(Q=1.0, R=1.0)
    return lfo.OptimalControlProblem(dynamics, HORIZON, cost, lfo.sets.Box(-1.0, 1.0), initial_state=[1.0])


def test_a_step_asks_for_no_bound(problem, monkeypatch):
    def fail(*arguments, **keywords):
        raise AssertionError("a bound was asked for")

    substitute(monkeypatch, "certificate.hybrid.value_bounds", fail)
    controller = lfo.RecedingHorizon(problem)
    u = controller.step([0.5])
    assert controller.log.statuses == ("locally_optimal",)
    alone = lfo.solve(problem.with_ends([0.5]), global_bound=False)
    np.testing.assert_allclose(u, alone.trajectory.u[0], atol=1e-7)


def test_a_method_with_a_bound_proves_its_steps(problem):
    controller = lfo.RecedingHorizon(problem, lfo.solvers.Nonsmooth(gap=1e-2))
    controller.step([0.5])
    assert controller.log.statuses == ("optimal",)
