"""Local optima of smooth dynamics: costs of IPOPT, bad starts, limits, and what is said where there is no answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.checks.pairs import problem_of
from helpers.clocks import Clock
from helpers.random.smooth import random_problem
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp import OptimalControlProblem, library
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.methods.hybrid import (
    Barrier,
    BarrierPoint,
    End,
    LocalSearch,
    SmoothModel,
    SmoothProgress,
    smooth_optimum,
)
from lin_freq_ocp.methods.structured import loops

KNOWN = [
    (library.pendulum_swing_up, {}, 42.59133929494813),
    (library.pendulum_swing_up, {"cutoff_hz": 3.0}, 42.87866289168880),
    (library.cart_pole, {}, 29.04954319688315),
    (library.cart_pole, {"cutoff_hz": 8.0}, 29.05153674115086),
    (library.planar_quadrotor, {}, 17.23373467304576),
    (library.planar_quadrotor, {"cutoff_hz": 5.0}, 17.38156473398363),
]
"""Costs that IPOPT finds from constant controls, by scripts/benchmark.py nonlinear."""


def pendulum(horizon=40, **changes):
    """Return a pendulum that is lifted a little, with other sets and costs."""
    plain = library.pendulum_swing_up(horizon=horizon, sampling_time=0.1)
    given = {"control_set": lfo.Box(-5, 5), "initial_state": [0.0, 0.0], "terminal_state": [0.4, 0.0], **changes}
    return OptimalControlProblem(plain.dynamics, horizon, given.pop("cost", plain.cost), **given)


def logarithmic(initial, terminal):
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(
        lambda x, u: [x[0] + 0.1 * np.log(x[0]) + 0.1 * u[0]], state_dim=1, control_dim=1
    )
    box = lfo.Box(-5, 5)
    return OptimalControlProblem(
        dynamics, 20, lfo.QuadraticCost(Q=1.0, R=1.0), box, initial_state=[initial], terminal_state=[terminal]
    )


@expensive
@pytest.mark.parametrize(("build", "arguments", "cost"), KNOWN)
def test_the_local_optimum_of_ipopt_is_found_and_certified(build, arguments, cost):
    result = lfo.solve(build(**arguments), global_bound=False)
    assert (result.status, result.message) == ("locally_optimal", "no global bound was asked for, and 2 starts tried")
    assert result.cost == pytest.approx(cost, rel=1e-9)
    assert result.certificate.worst.relative <= 1e-9
    assert result.options["global_bound"] is False


@pytest.mark.parametrize(
    "changes",
    seeds(
        [
            {"terminal_state": None},
            {"initial_state": lfo.Box([-0.1, -0.1], [0.1, 0.1])},
            {"terminal_state": lfo.sets.Ball(0.1, [0.4, 0.0])},
            {"state_set": lfo.sets.Soft(lfo.Box([-1.0, -0.2], [1.0, 0.2]), 3.0)},
            {"control_spectrum": lfo.MagnitudeBound(1.0, band=lfo.low_pass(cutoff_hz=2.0))},
            {"control_spectrum": lfo.MagnitudeBound(1.0, band=lfo.low_pass(cutoff_hz=2.0), oversampling=4)},
            {"cost": lfo.costs.L1Cost(u=1.0) + lfo.QuadraticCost(Q=1.0, R=0.1)},
        ]
    ),
)
def test_all_sets_costs_and_spectra_are_taken(changes):
    result = lfo.solve(pendulum(**changes), global_bound=False)
    assert result.status == "locally_optimal"
    assert result.certificate.worst.relative <= 1e-6


def test_loops_that_are_not_compiled_lead_to_the_same_answer():
    problem = pendulum(control_spectrum=lfo.low_pass(cutoff_hz=2.0))
    start = lfo.simulate(problem, np.zeros((40, 1)))
    model = SmoothModel.at(problem, start)
    answer = Barrier(model, loops(False)).run(model.assembly.point(start))
    assert answer.end is End.OPTIMAL
    expected = lfo.solve(problem, global_bound=False).control
    np.testing.assert_allclose(model.trajectory(answer.point.y).u, expected, atol=1e-8)


@expensive
def test_wide_bands_take_the_side_that_keeps_coefficients(monkeypatch):
    problem = pendulum(control_spectrum=lfo.low_pass(cutoff_hz=2.0))
    expected = lfo.solve(problem, global_bound=False).control
    substitute(monkeypatch, "methods.hybrid.FEW_ROWS", -1)
    np.testing.assert_allclose(lfo.solve(problem, global_bound=False).control, expected, atol=1e-8)


@expensive
def test_a_start_alone_is_followed_and_near_an_optimum_takes_few_steps(monkeypatch):
    problem = library.cart_pole(horizon=40, sampling_time=0.05)
    result = lfo.solve(problem, global_bound=False)
    search = LocalSearch(problem, start=None).run()
    assert search.tried >= 2
    steps: list[int] = []
    run = Barrier.run

    def counted(self, y):
        answer = run(self, y)
        steps.append(answer.steps)
        return answer

    monkeypatch.setattr(Barrier, "run", counted)
    again = lfo.solve(problem, start=result, global_bound=False)
    assert again.cost == pytest.approx(result.cost, rel=1e-9)
    assert len(steps) == 1
    assert steps[0] <= 20


@expensive
def test_where_no_trajectory_exists_the_nearest_is_measured():
    result = lfo.solve(library.pendulum_swing_up(horizon=5), global_bound=False, throw=False)
    assert (result.status, result.trajectory) == ("numerical_error", None)
    assert "no trajectory was found from" in result.message
    assert "the nearest violates dynamics by" in result.message


def test_steps_to_where_the_map_is_not_defined_are_shortened():
    result = lfo.solve(logarithmic(2.0, 0.3), global_bound=False)
    assert result.status == "locally_optimal"
    assert result.trajectory.x[:-1].min() > 0


def test_a_map_that_is_not_defined_at_any_start_is_said():
    result = lfo.solve(logarithmic(-2.0, 0.5), global_bound=False, throw=False)
    assert result.status == "numerical_error"
    assert "where the dynamics are not defined" in result.message


def test_a_time_limit_ends_the_iteration():
    with use_clock(Clock(1.0)):
        result = lfo.solve(library.cart_pole(), global_bound=False, time_limit=10.0, throw=False)
    assert (result.status, result.message) == ("limit", "time limit of 10 s")


@expensive
def test_ctrl_c_keeps_the_best_trajectory(monkeypatch):
    problem, calls = pendulum(), []
    best = smooth_optimum(problem, lfo.simulate(problem, np.zeros((40, 1))), warm=False)[0]
    derivatives = SmoothModel.derivatives

    def interrupted(self, y):
        calls.append(y)
        if len(calls) == 40:  # of a later start
            raise KeyboardInterrupt
        return derivatives(self, y)

    monkeypatch.setattr(SmoothModel, "derivatives", interrupted)
    substitute(monkeypatch, "methods.hybrid.SMOOTH_STARTS", 5)
    result = lfo.solve(problem, global_bound=False, throw=False)
    assert len(calls) == 40
    assert (result.status, result.interrupted, result.message) == ("limit", True, "interrupted")
    assert result.cost == pytest.approx(best.cost, rel=1e-9)


@expensive
@pytest.mark.parametrize("kind", ["casadi", "function"])
def test_functions_are_as_good_as_formulas(kind):
    if kind == "casadi":
        casadi = pytest.importorskip("casadi")
        f = lfo.from_casadi(lambda x, u: [x[0] + 0.1 * x[1], x[1] + 0.1 * (u[0] - casadi.sin(x[0]))], 2, 1)
    else:

        def jacobian(x, u):
            return [[1.0, 0.1, 0.0], [-0.1 * np.cos(x[0]), 1.0, 0.1]]

        f = lfo.DifferentiableFunction(
            lambda x, u: [x[0] + 0.1 * x[1], x[1] + 0.1 * (u[0] - np.sin(x[0]))], jacobian, outputs=2
        )
    formulas = lfo.PiecewiseSmoothDynamics.from_formulas(
        lambda x, u: [x[0] + 0.1 * x[1], x[1] + 0.1 * (u[0] - np.sin(x[0]))], 2, 1
    )
    others = lfo.PiecewiseSmoothDynamics([lfo.dynamics.SmoothMode(f)], 2, 1)
    costs = []
    for dynamics in (formulas, others):
        problem = OptimalControlProblem(
            dynamics, 30, lfo.QuadraticCost(Q=0.1, R=1.0), initial_state=[0, 0], terminal_state=[2.0, 0]
        )
        costs.append(lfo.solve(problem, global_bound=False).cost)
    assert costs[1] == pytest.approx(costs[0], rel=1e-9)


@expensive
def test_a_long_horizon_begins_on_a_straight_line(monkeypatch):
    substitute(monkeypatch, "methods.hybrid.LONGEST_REPLAY", 10)
    search, problem = LocalSearch(pendulum()), pendulum()
    substitute(monkeypatch, "simulate", lambda *given: pytest.fail("replayed"))
    found = search.run().best
    assert found is not None
    monkeypatch.undo()
    assert found.cost == pytest.approx(lfo.solve(problem, global_bound=False).cost, rel=1e-9)


def test_a_cost_that_is_not_defined_at_the_start_gives_no_answer_and_no_bound():
    """inf - inf in the enclosures is no warning, and no proof of infeasibility."""
    cost = lfo.costs.SmoothCost(stage="log(x_0)") + lfo.QuadraticCost(R=1.0)
    problem = OptimalControlProblem(lfo.LinearDynamics([[1.0]], [[1.0]]), 4, cost, lfo.Box(-1, 1), initial_state=[0.0])
    result = lfo.solve(problem, throw=False, time_limit=0.05)  # 25 looks at the clock
    assert (result.status, result.lower_bound) == ("numerical_error", None)


def test_without_bounds_starts_are_spread_over_the_controls():
    """v' = u^3: u = 0 is a strict local minimum of cost 8.08, and no start moves from there but others."""
    h = 0.08
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(
        lambda x, u: [x[0] + h * x[1] + h * h / 2 * u[0] ** 3, x[1] + h * u[0] ** 3], 2, 1, sampling_time=h
    )
    cost = lfo.QuadraticCost(Q=2 * h, R=2 * h, P=2 * h)
    problem = lfo.OptimalControlProblem(dynamics, 100, cost, initial_state=[1.0, 0.0])
    result = lfo.solve(problem, global_bound=False)
    assert result.cost <= 2.5
    assert result.message.endswith("4 starts tried")


@expensive
@pytest.mark.parametrize(
    ("stage", "starts"),
    [("x_0**4 + u_0**2", 1), ("u_0**2 - x_0**4", 1), ("sin(x_0)**2 + u_0**2", 2)],
    ids=["proven by a convex bound", "without a lower bound", "the same answer twice"],
)
def test_starts_end_where_another_one_gains_nothing(stage, starts):
    cost, reports = lfo.costs.SmoothCost(stage=stage), list[SmoothProgress]()
    problem = OptimalControlProblem(lfo.LinearDynamics([[1.0]], [[0.1]]), 5, cost, initial_state=[1.0])
    lfo.solve(problem, global_bound=False, throw=False, progress=reports.append)
    assert reports[-1].tried == starts


def test_an_answer_that_costs_less_by_its_violation_is_no_better_one():
    """Rest costs nothing; from other starts, the dynamics are violated by 1e-11, which the cost falls by."""
    result = lfo.solve(random_problem(57), global_bound=False)
    assert (result.status, result.cost) == ("locally_optimal", 0.0)


def qubit(end, horizon=20, step=0.25):
    """Return a qubit that turns about (u, 0, 1) from its north pole, on the unit sphere."""

    def rotate(x, u):
        rate = np.sqrt(u[0] ** 2 + 1)
        c, s, n, m = np.cos(rate * step), np.sin(rate * step), u[0] / rate, 1 / rate
        d = (1 - c) * (n * x[0] + m * x[2])
        return [c * x[0] + n * d - s * m * x[1], c * x[1] + s * (m * x[0] - n * x[2]), c * x[2] + m * d + s * n * x[1]]

    return lfo.OptimalControlProblem(
        lfo.PiecewiseSmoothDynamics.from_formulas(rotate, 3, 1),
        horizon,
        lfo.QuadraticCost(R=2 * step),
        lfo.Box(0, 2.5),
        initial_state=[0, 0, 1],
        terminal_state=end,
        control_spectrum=lfo.low_pass(0.8),
    )


def test_an_end_that_the_dynamics_make_redundant_is_reached_from_the_first_start():
    """As |x| = 1, two components of the south pole imply the third but for its sign."""
    problem = qubit([0, 0, -1])
    optimum, ended = smooth_optimum(problem, next(LocalSearch(problem).starts())[0], warm=False)
    assert ended is End.OPTIMAL
    assert optimum.cost == pytest.approx(13.844711544, rel=1e-9)  # that of the problem with x_2 < 0 at the end


@expensive
@pytest.mark.parametrize("spectrum", ["mask of states", "harmonics in amplitudes"])
def test_cones_at_their_limits_leave_no_iteration_without_a_step(spectrum):
    """Steps that ended within mu of the boundary of a cone left a system that had no solution."""
    problem = problem_of("piecewise-smooth dynamics", spectrum)
    start = lfo.simulate(problem, np.zeros((6, 1)))
    optimum, ended = smooth_optimum(problem, start, np.array([0, 1, 1, 1, 1, 0]), warm=False)
    assert ended is End.OPTIMAL
    assert optimum.converged


@expensive
def test_multipliers_that_overflow_are_those_of_no_optimum(monkeypatch):
    problem, honest = qubit([0, 0, -1]), Barrier.run

    def run(self, y):
        answer = honest(self, y)
        return replace(answer, point=replace(answer.point, z=[np.full_like(part, np.inf) for part in answer.point.z]))

    monkeypatch.setattr(Barrier, "run", run)
    optimum, _ = smooth_optimum(problem, next(LocalSearch(problem).starts())[0])
    assert optimum.reason is lfo.results.Reason.FAILED
    result = lfo.solve(problem, lfo.solvers.Nonsmooth(global_bound=False), throw=False)
    assert result.status == "numerical_error"


def test_a_factorisation_that_overflows_ends_the_iteration(monkeypatch):
    """A map linearised far away may grow by 1e300 within the horizon; the last point is the answer."""
    problem, honest, factored = qubit([0, 0, -1]), BarrierPoint.factor, list[float]()

    def factor(self, *given):
        factored.append(self.theta)
        if len(factored) > 2:
            raise np.linalg.LinAlgError("Singular matrix")
        return honest(self, *given)

    monkeypatch.setattr(BarrierPoint, "factor", factor)
    optimum, ended = smooth_optimum(problem, next(LocalSearch(problem).starts())[0])
    assert ended is End.STALLED
    assert not optimum.converged
    assert np.isfinite(optimum.trajectory.x).all()
