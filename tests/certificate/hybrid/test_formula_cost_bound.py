"""The global bound of costs by formulas: below every trajectory, and close to the best."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

import lin_freq_ocp as lfo
from helpers.seeds import expensive

WEIGHTS = [1.0, 0.2, 2.0, 0.5]


def stated(stage, terminal=None, f="0.9*x_0 + u_0", steps=4, **cost):
    """Return a problem of one state over some steps."""
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas([f], 1, 1)
    total = lfo.QuadraticCost(**cost) + lfo.costs.SmoothCost(stage=stage, terminal=terminal)
    sets = {"control_set": lfo.Box(-1, 1), "state_set": lfo.Box(-3, 3), "initial_state": [1.2]}
    return lfo.OptimalControlProblem(dynamics, steps, total, **sets)


def weighted(t, x, u):
    return t.look_up(WEIGHTS) * (x[0] - np.sin(1.0 * t)) ** 2


PROBLEMS = {
    "smooth": lambda: stated(lambda x, u: np.sin(2 * x[0]) ** 2, R=0.2),
    "terminal": lambda: stated("0.1*u_0**2", lambda x: np.cos(3 * x[0]) + 0.2 * x[0] ** 2),
    "time": lambda: stated(weighted, R=0.1),
    "kinks": lambda: stated("abs(x_0 - 0.4) + 0.3*min(u_0, -u_0)", steps=2),
    "concave in u": lambda: stated("x_0**2 - 0.3*u_0**2"),
    "kinks beside kinks": lambda: stated("max(x_0, 2*u_0, 0.1)", f="abs(x_0) - 0.5 + u_0", steps=2, R=0.1),
    "below zero": lambda: stated("-exp(-x_0**2) - 0.2*x_0"),
}


def least_of_many(problem):
    """Return the least cost of trajectories that four local searches from random controls find."""
    start, steps, rng = problem.initial_box.lower, problem.horizon, np.random.default_rng(0)

    def cost(u):
        try:
            trajectory = lfo.simulate(problem, u[:, None], start)
        except lfo.errors.NumericalError:
            return 1e3
        return problem.value(trajectory.x, trajectory.u)

    starts = rng.uniform(-1, 1, (4, steps))
    found = [minimize(cost, u, method="L-BFGS-B", bounds=[(-1, 1)] * steps, options={"maxfun": 60}) for u in starts]
    return min(one.fun for one in found if (np.abs(lfo.simulate(problem, one.x[:, None], start).x) <= 3).all())


@expensive
@pytest.mark.parametrize("name", PROBLEMS)
def test_the_bound_is_below_every_trajectory_and_close(name):
    problem = PROBLEMS[name]()
    result = lfo.solve(problem)
    best = least_of_many(problem)
    assert result.status == "optimal"
    assert result.certificate.bound.kind == "rigorous"
    assert result.certificate.lower_bound <= best + 1e-9
    assert result.cost <= best + 1e-6


@expensive
def test_a_cost_that_no_formula_states_has_no_bound():
    table = lfo.DifferentiableFunction(
        lambda x, u: [x[0] ** 4 + u[0] ** 2], lambda x, u: [[4 * x[0] ** 3, 2 * u[0]]], name="table"
    )
    result = lfo.solve(stated(table))
    assert result.certificate.pmp == "satisfied"
    assert result.certificate.bound is None
    assert "table is no formula" in result.message
    formula = lfo.solve(stated("x_0**4 + u_0**2"))
    assert formula.status == "optimal"
    assert formula.cost == pytest.approx(result.cost, rel=1e-8)


def test_the_bound_is_at_least_what_intervals_of_the_cost_give():
    """A sum of squares, of four states: too many for dynamic programming; with 0.01 more each step, 0.05 in all."""
    floor = np.sin(2.1) ** 2  # of the first step alone
    A, B = np.eye(4) + 0.1 * np.eye(4, k=1), np.eye(4, 1, k=-3)
    for constant in (0.0, 0.01):
        cost = lfo.costs.SmoothCost(stage=f"sin(3*x_0)**2 + u_0**2 + {constant}")
        problem = lfo.OptimalControlProblem(
            lfo.LinearDynamics(A, B), 5, cost, lfo.Box(-1, 1), initial_state=[0.7, 0, 0, 0]
        )
        result = lfo.solve(problem)
        assert result.lower_bound == pytest.approx(floor + 5 * constant, rel=1e-9)
        assert result.gap == pytest.approx(0.8, abs=0.02)
