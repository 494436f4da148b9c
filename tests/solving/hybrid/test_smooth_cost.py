"""Costs by formulas: optima, the maximum principle with their gradients, kinks, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.formula_costs import PUBLISHED, clnlbeam
from helpers.seeds import expensive, seeds
from lin_freq_ocp.certificate import judge
from lin_freq_ocp.certificate.hybrid import kinks
from lin_freq_ocp.comparison import mode_sequence

SmoothCost = lfo.costs.SmoothCost
A, B = [[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]]


def cart(cost, horizon=10, dynamics=None, **fields):
    """Return a double integrator with a cost, from a metre off."""
    fields = {"control_set": lfo.Box(-3, 3), "initial_state": [1.0, 0.0]} | fields
    return lfo.OptimalControlProblem(dynamics or lfo.LinearDynamics(A, B), horizon, cost, **fields)


def by_hand(problem, trajectory):
    """Return the normal multipliers of the wave cost along a trajectory without active bounds, by the adjoint."""
    x, T = trajectory.x, problem.horizon
    eta = np.zeros((T, 2))
    eta[-1] = -np.array([4 * x[-1, 0] ** 3, x[-1, 1]])
    slopes = np.column_stack([np.sin(2 * x[:, 0]), x[:, 1]])
    for t in range(T - 1, 0, -1):
        eta[t - 1] = np.transpose(A) @ eta[t] - slopes[t]
    mu = np.zeros_like(x)
    mu[0] = np.transpose(A) @ eta[0] - slopes[0]
    empty = np.zeros((T // 2 + 1, 1)), np.zeros(((T + 1) // 2 + 1, 2))
    return lfo.results.Multipliers(1.0, eta, mu, np.zeros((T, 1)), *empty)


@pytest.fixture(scope="module")
def wave():
    quadratic = lfo.QuadraticCost(Q=np.diag([0.0, 1.0]), R=0.1, P=np.diag([0.0, 1.0]))
    return cart(quadratic + SmoothCost(stage=lambda x, u: np.sin(x[0]) ** 2, terminal=lambda x: x[0] ** 4))


@pytest.fixture(scope="module")
def waved(wave):
    return lfo.solve(wave, "nonsmooth")


@pytest.mark.parametrize("name", seeds(name for name in PUBLISHED if "CLNLBEAM" not in name and "N = 100" not in name))
def test_published_problems_with_their_cost_as_a_cost(name):
    build, best = PUBLISHED[name]
    result = lfo.solve(build(), "nonsmooth")
    assert result.certificate.pmp == "satisfied"
    assert result.cost <= best + 1e-8 * abs(best)
    x, u = result.trajectory.x, result.trajectory.u
    np.testing.assert_allclose(lfo.simulate(result.problem, u, x[0]).x, x, rtol=1e-9, atol=1e-9)
    assert result.problem.value(x, u) == result.cost


def test_the_beam_from_a_bent_start():
    problem = clnlbeam(10)
    x = np.column_stack([0.05 * np.sin(np.arange(11)), np.zeros((11, 2))])
    result = lfo.solve(problem, start=lfo.Trajectory(x, np.zeros((10, 1))), global_bound=False)
    assert result.certificate.pmp == "satisfied"
    assert result.cost < 345.04  # the straight beam costs 350


def test_the_value_is_the_sum_of_its_formulas(wave):
    rng = np.random.default_rng(0)
    x, u = rng.normal(size=(11, 2)), rng.normal(size=(10, 1))
    by_formulas = (np.sin(x[:-1, 0]) ** 2).sum() + x[-1, 0] ** 4
    quadratic = 0.5 * (x[:, 1] ** 2).sum() + 0.05 * (u**2).sum()
    assert wave.value(x, u) == pytest.approx(by_formulas + quadratic, rel=1e-13)


@expensive
def test_the_principle_has_the_gradient_of_the_cost(wave, waved):
    result = waved
    multipliers = by_hand(wave, result.trajectory)
    np.testing.assert_allclose(result.multipliers.eta, multipliers.eta, atol=1e-8)
    certificate = lfo.certify(wave, result.trajectory, multipliers)
    assert certificate.pmp == "satisfied"
    assert certificate.bound is None
    assert certificate.cost == result.cost
    assert lfo.certify(wave, result.trajectory).pmp == "satisfied"  # with fitted multipliers


@expensive
@pytest.mark.parametrize("part", ["stage", "terminal"])
def test_a_trajectory_of_another_cost_is_refuted(wave, waved, part):
    """The optimum of one cost violates the principle of another: a gradient that is left out is noticed."""
    result = waved
    given = {"stage": lambda x, u: 1.01 * np.sin(x[0]) ** 2, "terminal": lambda x: 1.01 * x[0] ** 4}
    quadratic, (smooth,) = wave.cost.quadratic, wave.cost.norms
    stated = {"stage": smooth.stage, "terminal": smooth.terminal} | {part: given[part]}
    other = replace(wave, cost=quadratic + SmoothCost(**stated))
    assert judge(other, result.trajectory, result.multipliers).pmp == "violated"
    certificate = lfo.certify(other, result.trajectory)
    assert certificate.pmp == "violated"
    assert certificate.descent is not None
    assert certificate.descent.x.shape == result.trajectory.x.shape


@pytest.mark.parametrize(
    ("norm", "formula"),
    seeds(
        [
            (lfo.costs.L1Cost(u=0.3), "0.3 * abs(u_0)"),
            (lfo.costs.L1Cost(x=[0.0, 2.0]), lambda x, u: 2 * abs(x[1])),
            (lfo.costs.LInfCost(x=[1.0, 2.0]), lambda x, u: lfo.maximum(x[0], -x[0], 2 * x[1], -2 * x[1])),
        ]
    ),
)
def test_kinks_of_a_cost_are_those_of_the_convex_norm(norm, formula):
    quadratic = lfo.QuadraticCost(Q=1.0, R=0.1, P=5.0)
    convex = lfo.solve(cart(quadratic + norm, 3))
    kinked = lfo.solve(cart(quadratic + SmoothCost(stage=formula), 3), "nonsmooth")
    assert kinked.certificate.pmp == "satisfied"
    assert kinked.cost == pytest.approx(convex.cost, rel=1e-8)
    np.testing.assert_allclose(kinked.trajectory.u, convex.trajectory.u, atol=1e-4)


def test_controls_that_rest_on_a_kink_within_rounding_satisfy_the_maximum_principle():
    cost = lfo.QuadraticCost(Q=1.0, R=0.1, P=5.0) + SmoothCost(stage="0.3 * abs(u_0)")
    certificate = lfo.certify(cart(cost, 4), np.full((4, 1), 6e-10))
    assert certificate.pmp == "satisfied"
    assert certificate.borders.times == (0, 1, 2, 3)


@expensive
def test_a_norm_at_its_zero_has_a_selection():
    cost = lfo.QuadraticCost(Q=1.0, R=0.1) + SmoothCost(stage=lambda x, u: lfo.norm([x[0], x[1]]))
    result = lfo.solve(cart(cost, 30, terminal_state=[0.0, 0.0]), "nonsmooth")
    assert result.certificate.pmp == "satisfied"
    assert result.certificate.borders.norms  # it rests at zero before the end
    cp = pytest.importorskip("cvxpy")
    x, u = cp.Variable((31, 2)), cp.Variable((30, 1))
    total = sum(cp.sum_squares(x[t]) / 2 + cp.sum_squares(u[t]) / 20 + cp.norm(x[t]) for t in range(30))
    rows = [x[t + 1] == np.array(A) @ x[t] + np.array(B) @ u[t] for t in range(30)]
    expected = cp.Problem(cp.Minimize(total), [x[0] == [1.0, 0.0], x[30] == 0, cp.abs(u) <= 3, *rows]).solve()
    assert result.cost == pytest.approx(expected, rel=1e-6)


def test_a_smooth_cost_is_that_of_the_quadratic_one():
    """With dynamics and costs per time and a frequency constraint, the optimum is that of the linear method."""
    rng = np.random.default_rng(1)
    dynamics = lfo.LinearDynamics(np.array(A) + 0.02 * rng.normal(size=(20, 2, 2)), B)
    weights = rng.uniform(1.0, 2.0, 20)
    quadratic = lfo.QuadraticCost(Q=weights[:, None, None] * np.eye(2), R=0.1, P=1.0)
    smooth = lfo.QuadraticCost(R=0.1) + SmoothCost(
        stage=lambda t, x, u: t.look_up(weights) * (x[0] ** 2 + x[1] ** 2) / 2,
        terminal=lambda x: (x[0] ** 2 + x[1] ** 2) / 2,
    )
    stated = {"horizon": 20, "dynamics": dynamics, "control_spectrum": lfo.low_pass(1.5)}
    linear, found = lfo.solve(cart(quadratic, **stated)), lfo.solve(cart(smooth, **stated), "nonsmooth")
    assert found.certificate.pmp == "satisfied"
    assert found.cost == pytest.approx(linear.cost, rel=1e-9)
    np.testing.assert_allclose(found.multipliers.eta, linear.multipliers.eta, atol=1e-6)
    np.testing.assert_allclose(found.multipliers.rho_u, linear.multipliers.rho_u, atol=1e-6)


@expensive
def test_the_cost_stays_through_changes_of_the_problem(wave):
    rng = np.random.default_rng(2)
    x, u = rng.normal(size=(11, 2)), rng.normal(size=(10, 1))
    cost = wave.value(x, u)
    assert wave.with_ends(initial_state=[2.0, 0.0]).value(x, u) == cost
    limited = lfo.rate_limited(wave, 0.5, previous=0.0)
    before = np.append(0.0, u[:, 0])[:, None]
    assert limited.value(np.hstack([x, before]), u) == pytest.approx(cost)
    assert lfo.solve(limited, "nonsmooth").certificate.pmp == "satisfied"
    far = cart(lfo.QuadraticCost(R=0.1) + SmoothCost(stage=lambda x, u: (x[0] - 1e6) ** 4), initial_state=[1e6 + 1, 0])
    near = cart(lfo.QuadraticCost(R=0.1) + SmoothCost(stage=lambda x, u: x[0] ** 4))
    assert lfo.solve(far, "nonsmooth").cost == pytest.approx(lfo.solve(near, "nonsmooth").cost, rel=1e-6)


@expensive
def test_reports_name_the_states_of_the_problem_alone(wave, waved):
    """The cost is a state for the judge only: no condition, kink or multiplier is about it."""
    result = waved
    off = lfo.Trajectory(result.trajectory.x, result.trajectory.u + 1e-3)
    for certificate in (result.certificate, lfo.certify(wave, off, result.multipliers), lfo.certify(wave, off)):
        states = [one.component for one in certificate.conditions if one.label in ("C-iii", "C-iv", "S-x", "N-x")]
        assert all(component is None or component < 2 for component in states)
    cost = lfo.QuadraticCost(Q=1.0, R=0.1, P=5.0) + SmoothCost(stage="2*abs(x_1)")
    kinked = lfo.solve(cart(cost, 8), "nonsmooth")
    found = kinks(kinked.problem, kinked.trajectory, kinked.multipliers, kinked.certificate.borders)
    assert found
    assert all(kink.required.shape == (2,) for kink in found)
    assert str(kinked.uniqueness)
    assert mode_sequence(kinked.problem, kinked.trajectory).shape == (8,)


def test_a_certificate_of_a_convex_cost_needs_no_multipliers():
    problem = cart(lfo.QuadraticCost(Q=0.01, R=0.1) + SmoothCost(stage="(x_0 - 0.3*x_1)**4"))
    result = lfo.solve(problem)
    assert lfo.certify(problem, result.trajectory).globally_optimal


def test_no_linear_method_takes_a_cost_by_formulas(wave):
    for method in ("spectral", "structured", "convex"):
        with pytest.raises(lfo.errors.UnsupportedError, match="piecewise-smooth"):
            lfo.solve(wave, method)
    with pytest.raises(lfo.errors.UnsupportedError, match="cost: got a cost by formulas"):
        _ = wave.linear


@pytest.mark.parametrize(
    ("stated", "got"),
    [
        ({}, "no formula"),
        ({"stage": lambda x, u: [x[0], u[0]]}, r"cost.norms\[0\].stage: got 2 formulas; expected one"),
        ({"stage": lambda x, u: x[5]}, r"cost.norms\[0\].stage: got IndexError"),
        ({"stage": "x_7"}, r"cost.norms\[0\].stage.*x_7"),
        ({"stage": lambda t, x, u: t.look_up([1.0]) * x[0]}, r"cost.norms\[0\].stage.look_up: got 1 numbers"),
        ({"terminal": lambda x: abs(x[0])}, r"cost.norms\[0\].terminal: got a kink"),
        ({"terminal": "u_0**2"}, r"cost.norms\[0\].terminal: got u_0; expected a formula of the last state"),
        ({"terminal": "t * x_0"}, r"cost.norms\[0\].terminal: got t; expected a formula of the last state"),
        ({"stage": 3 + 2j}, r"cost.norms\[0\].stage"),
    ],
)
def test_what_is_no_cost_is_refused(stated, got):
    with pytest.raises(lfo.errors.ProblemError, match=got):
        cart(lfo.QuadraticCost(R=1.0) + SmoothCost(**stated))


def test_dynamics_that_take_no_cost_by_formulas_are_refused():
    affine = lfo.PiecewiseAffineDynamics.from_formulas(["abs(x_0) + u_0"], 1, 1)
    with pytest.raises(lfo.errors.UnsupportedError, match="expected one of LinearDynamics, PiecewiseSmoothDynamics"):
        lfo.OptimalControlProblem(affine, 3, SmoothCost(stage="x_0**4"), initial_state=[1.0])


def test_a_cost_that_is_not_defined_where_all_starts_are():
    problem = cart(lfo.QuadraticCost(R=1.0) + SmoothCost(stage="log(x_0 - 2)"))
    with pytest.raises(lfo.errors.SolveError, match="not defined"):
        lfo.solve(problem, "nonsmooth")
    with pytest.raises(lfo.errors.ProblemError, match="SmoothCost: got nan at t = 0"):
        lfo.certify(problem, np.zeros((10, 1)))


@expensive
def test_a_terminal_formula_beside_kinks_leads_to_the_optimum_of_cvxpy():
    problem = cart(SmoothCost(stage="abs(x_0) + u_0**2", terminal="x_0**4"))
    model = lfo.to_cvxpy(cart(lfo.QuadraticCost()))
    x, u = model.var_dict["x"], model.var_dict["u"]
    objective = cp.sum(cp.abs(x[:-1, 0])) + cp.sum_squares(u) + cp.power(x[-1, 0], 4)
    theirs = cp.Problem(cp.Minimize(objective), model.constraints).solve(solver=cp.CLARABEL)
    result = lfo.solve(problem, lfo.solvers.Nonsmooth(global_bound=False))
    assert result.certificate.pmp == "satisfied"
    assert result.cost == pytest.approx(theirs, rel=1e-6)


def test_a_norm_with_a_constant_component_has_no_kink():
    problem = cart(SmoothCost(stage="norm(x_0, 0.3) + u_0**2", terminal="cosh(x_0)"), 3)
    assert lfo.solve(problem, lfo.solvers.Nonsmooth(global_bound=False)).status == "optimal"


@expensive
@pytest.mark.parametrize(("terminal", "least"), [("-2*x_0**2", -1650.0), ("cos(3*x_0)", -0.8237636916)])
def test_the_curvature_of_a_terminal_cost_counts_at_a_saddle(terminal, least):
    """At rest the cost is stationary, and falls along a direction: that of the last state alone says so."""
    cost = lfo.QuadraticCost(R=1.0) + SmoothCost(terminal=terminal)
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[1.0]]), 3, cost, lfo.Box(-10, 10), initial_state=[0.0]
    )
    rest = lfo.Trajectory(np.zeros((4, 1)), np.zeros((3, 1)))
    test = lfo.certify(problem, rest).second_order
    assert test.passed is False
    assert (test.direction.x.shape, test.direction.u.shape) == ((4, 1), (3, 1))
    result = lfo.solve(problem, lfo.solvers.Nonsmooth(global_bound=False), start=rest)
    assert result.status == "locally_optimal"
    assert result.cost == pytest.approx(least, rel=1e-6)


def test_a_concave_terminal_cost_that_controls_outweigh_is_no_saddle():
    cost = lfo.QuadraticCost(R=1.0) + SmoothCost(terminal="-0.1*x_0**2")
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[1.0]]), 3, cost, lfo.Box(-10, 10), initial_state=[0.0]
    )
    rest = lfo.Trajectory(np.zeros((4, 1)), np.zeros((3, 1)))
    assert lfo.certify(problem, rest).second_order.passed


def test_what_takes_no_cost_by_formulas_names_the_cost(wave, tmp_path):
    for refused in (lambda: wave.linear, lambda: lfo.generate(lfo.RecedingHorizon(wave), tmp_path / "c")):
        with pytest.raises(lfo.errors.UnsupportedError, match="cost: got a cost by formulas"):
            refused()


@expensive
def test_an_unreachable_end_is_proven_and_explained_whatever_the_cost():
    cost = lfo.QuadraticCost(R=1.0) + lfo.costs.SmoothCost(stage="sin(x_0)**2")
    ends = {"initial_state": [0.0], "terminal_state": [4.0]}
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics([[1.0]], [[1.0]]), 2, cost, lfo.Box(-1, 1), **ends)
    result = lfo.solve(problem, throw=False)
    assert (result.status, result.bound) == ("infeasible", "rigorous")
    assert "proven without formulas" in result.message
    explanation = lfo.explain(problem)
    assert explanation.family == ("initial state", "terminal state", "control bound on u_0")
    assert "[-1, 1] -> [-2, 2]" in str(explanation)


@expensive
@pytest.mark.parametrize(("stage", "cost"), [("cosh(x_0 - 1)", 4.0), ("abs(x_0 - 1)", 0.0)])
def test_periodic_ends_keep_their_name_with_a_cost_by_formulas(stage, cost):
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[1.0]]), 4, lfo.QuadraticCost(R=1.0) + lfo.costs.SmoothCost(stage=stage),
        lfo.Box(-1, 1), state_set=lfo.Box(-3, 3), terminal_state=lfo.Periodic(),
    )  # fmt: skip
    result = lfo.solve(problem, global_bound=False)
    assert result.cost == pytest.approx(cost, abs=1e-9)
    assert set(result.multipliers.stage) == {"periodic ends"}
    assert lfo.certify(problem, lfo.results.Trajectory(np.ones((5, 1)), np.zeros((4, 1)))).pmp == "satisfied"


@pytest.mark.parametrize("bounds", [None, lfo.Box(1e-6, None)])
def test_a_logarithm_needs_no_upper_bound_on_its_argument(bounds):
    """Consumption of 100 within 10 steps; by hand, c_k is constant without interest and discount."""
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[-1.0]]), 10, SmoothCost(stage=lambda x, u: -np.log(u[0])), bounds,
        initial_state=[100.0], terminal_state=[0.0],
    )  # fmt: skip
    assert lfo.solve(problem, global_bound=False).cost == pytest.approx(-10 * np.log(10.0), rel=1e-9)
