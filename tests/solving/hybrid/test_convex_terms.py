"""Costs by formulas with kinks that are convex terms: solved as a convex program, with its proof."""

import cvxpy as cp
import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive, seeds
from lin_freq_ocp.transform.hybrid import with_convex_terms

A, B = np.array([[1.0, 0.3], [-0.1, 0.9]]), np.array([[0.0], [0.4]])
STAGES = {  # a formula, and the same convex function in NumPy
    "norm": (
        lambda x, u: 2.0 * lfo.norm([x[0] - 0.2, x[1]]) - 0.1 * u[0] + 3.0,
        lambda x, u: 2.0 * np.hypot(x[:, 0] - 0.2, x[:, 1]) - 0.1 * u[:, 0] + 3.0,
    ),
    "absolute value and square": (
        lambda x, u: abs(x[0] - u[0]) + 0.5 * (x[1] + 2 * u[0] - 1) ** 2,
        lambda x, u: np.abs(x[:, 0] - u[:, 0]) + 0.5 * (x[:, 1] + 2 * u[:, 0] - 1) ** 2,
    ),
    "maximum less a minimum": (
        lambda x, u: 0.7 * lfo.maximum(x[0], 2 * x[1] - 1) - 0.4 * lfo.minimum(x[1], 0.3),
        lambda x, u: 0.7 * np.maximum(x[:, 0], 2 * x[:, 1] - 1) - 0.4 * np.minimum(x[:, 1], 0.3),
    ),
}


def problem_of(stage, horizon=30, **changes) -> lfo.OptimalControlProblem:
    cost = lfo.QuadraticCost(Q=0.1, R=0.2, S=[[0.05], [0.0]], x_ref=[0.5, -0.3], u_ref=[0.1], P=1.0)
    sets = {"control_set": lfo.Box(-1.5, 1.5), "initial_state": [1.0, -0.5]} | changes
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, B), horizon, cost + lfo.costs.SmoothCost(stage=stage), **sets
    )


@pytest.mark.parametrize("name", STAGES)
def test_the_cost_differs_by_a_constant(name):
    formula, function = STAGES[name]
    problem = problem_of(formula)
    convex, rng = with_convex_terms(problem), np.random.default_rng(0)
    differences = []
    for _ in range(5):
        x, u = rng.standard_normal((31, 2)), rng.standard_normal((30, 1))
        assert problem.value(x, u) == pytest.approx(problem.quadratic.value(x, u) + function(x[:-1], u).sum())
        differences.append(problem.value(x, u) - convex.value(x, u))
    assert differences == pytest.approx([differences[0]] * 5, abs=1e-11)


@pytest.mark.parametrize("name", seeds(STAGES))
def test_the_global_optimum_is_proven_over_thirty_steps(name):
    formula, function = STAGES[name]
    problem = problem_of(formula, control_spectrum=lfo.stop_band(bins=[3, 4]), state_set=lfo.Box(-3.0, 3.0))
    result = lfo.solve(problem)
    assert (result.status, result.certificate.pmp) == ("optimal", "satisfied")
    assert result.certificate.globally_optimal
    rng, best = np.random.default_rng(0), result.trajectory
    for size in (1e-3, 1e-2, 0.1):  # no trajectory nearby costs less than the bound
        spectrum = np.fft.rfft(size * rng.standard_normal((30, 1)), axis=0)
        spectrum[[3, 4]] = 0.0
        u = best.u + np.fft.irfft(spectrum, 30, axis=0)
        x = lfo.simulate(problem, u).x
        assert problem.quadratic.value(x, u) + function(x[:-1], u).sum() >= result.lower_bound


@expensive
def test_a_norm_in_several_modes_has_one_selection():
    """The absolute value makes two modes, each with a copy of the norm, which is zero over the last steps."""
    stage = lfo.costs.SmoothCost(stage=lambda x, u: lfo.norm([x[0], x[1]]) + 0.1 * abs(u[0]))
    dynamics = lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]])
    problem = lfo.OptimalControlProblem(
        dynamics, 26, lfo.QuadraticCost(R=0.01) + stage, lfo.Box(-5, 5), initial_state=[0.3, -0.3]
    )
    result = lfo.solve(problem)
    assert (result.status, result.certificate.pmp) == ("optimal", "satisfied")
    kinks = [kink.time for kink in result.certificate.borders.norms]
    assert kinks
    assert len(kinks) == len(set(kinks))


def test_a_convex_cost_with_bounded_changes_is_proven():
    problem = lfo.rate_limited(problem_of(STAGES["norm"][0], horizon=12), 0.3, previous=0.0)
    assert lfo.solve(problem).certificate.globally_optimal


@pytest.mark.parametrize(
    "stage",
    [
        lambda x, u: -abs(x[0]),
        lambda x, u: lfo.minimum(x[0], x[1]),
        lambda x, u: abs(x[0] * u[0]),
        lambda x, u: abs(x[0]) - x[1] ** 2,
        lambda x, u: abs(x[0]) + np.sin(u[0]),
        lambda x, u: x[0] ** 2 + u[0],
        lambda t, x, u: t.look_up([1.0, 2.0, 3.0]) * abs(x[0]),
    ],
)
def test_other_costs_stay_formulas(stage):
    assert with_convex_terms(problem_of(stage, horizon=3)) is None


def test_terminal_formulas_stay_formulas():
    cost = lfo.costs.SmoothCost(stage=STAGES["norm"][0]) + lfo.costs.SmoothCost(terminal="x_0**4")
    linear = lfo.OptimalControlProblem(lfo.LinearDynamics(A, B), 3, cost, initial_state=[1.0, 0.0])
    assert with_convex_terms(linear) is None


@expensive
@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("horizon", [40, 80])
def test_smooth_dynamics_rest_where_the_norm_of_the_cost_is_zero(unit, horizon):
    """The local method has multipliers of the norm where it has no slope; the rest costs nothing, however long."""

    def step(x, u):
        force = u[0] + 0.2 * unit * (x[0] / unit).sin()
        return [x[0] + 0.1 * x[1] + 0.005 * u[0], x[1] + 0.1 * force]

    def stage(x, u):
        return lfo.norm([x[0] / unit, x[1] / unit]) + 0.5 * (u[0] / unit) ** 2

    dynamics, cost = lfo.PiecewiseSmoothDynamics.from_formulas(step, 2, 1), lfo.costs.SmoothCost(stage=stage)
    bounds = lfo.Box(-5 * unit, 5 * unit)
    problem = lfo.OptimalControlProblem(dynamics, horizon, cost, bounds, None, [unit, 0], [0, 0])
    result = lfo.solve(problem, global_bound=False)
    assert (result.status, result.certificate.pmp) == ("locally_optimal", "satisfied")
    assert result.cost == pytest.approx(21.2682376173, rel=1e-9)
    assert np.abs(result.trajectory.x[35:]).max() < 1e-6 * unit


@pytest.mark.parametrize("terminal", [None, "x_0**2 + 0.5*x_1**4"])
@pytest.mark.parametrize("path", [None, "norm(x_0, x_1) - 2"])
@pytest.mark.parametrize("others", ["", " + 0.2*exp(u_0) + 0.1*abs(x_0 - 0.7)"])
def test_norms_beside_other_formulas_have_multipliers_where_they_are_zero(terminal, path, others):
    """The references rest at the zero of the norm for a part of the time; CVXPY finds the same optimum."""
    stage = "norm(x_0, x_1 - u_0)"
    x_ref = np.outer(np.sin(1.3 * np.arange(7)), [1.0, 0.0])
    cost = lfo.QuadraticCost(Q=0.5, R=0.2, P=1.0, x_ref=x_ref) + lfo.costs.SmoothCost(stage + others, terminal)
    A, B = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.5], [1.0]])
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, B),
        6,
        cost,
        control_set=lfo.Box(-1.0, 1.0),
        initial_state=[1.5, 0.0],
        stage_rows=[] if path is None else [lfo.sets.PathConstraint(path)],
    )
    x, u = cp.Variable((7, 2)), cp.Variable((6, 1))
    total = 0.5 * (0.5 * cp.sum_squares(x[:6] - x_ref[:6]) + 0.2 * cp.sum_squares(u) + cp.sum_squares(x[6] - x_ref[6]))
    total += sum(cp.norm(cp.hstack([x[t, 0], x[t, 1] - u[t, 0]])) for t in range(6))
    total += 0 if terminal is None else x[6, 0] ** 2 + 0.5 * x[6, 1] ** 4
    total += 0 if not others else 0.2 * cp.sum(cp.exp(u)) + 0.1 * cp.sum(cp.abs(x[:6, 0] - 0.7))
    rows = [x[0] == [1.5, 0.0], cp.abs(u) <= 1, *(x[t + 1] == A @ x[t] + B @ u[t] for t in range(6))]
    rows += [] if path is None else [cp.norm(x[t]) <= 2 for t in range(7)]
    best = cp.Problem(cp.Minimize(total), rows).solve(solver=cp.CLARABEL)
    result = lfo.solve(problem, "nonsmooth")
    assert result.certificate.pmp == "satisfied"
    assert result.cost == pytest.approx(best, rel=1e-7)
