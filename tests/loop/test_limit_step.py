"""What a step applies whose problem was not solved: its own point or the plan of the step before, the better one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from lin_freq_ocp.solving import Outcome, Request

A, B = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]])
START = np.array([1.0, 0.0])
T = 15
Point = Callable[[lfo.OptimalControlProblem], lfo.Trajectory | None]


def problem(**fields) -> lfo.OptimalControlProblem:
    cost = lfo.QuadraticCost(Q=np.diag([1.0, 0.1]), R=0.1, P=np.diag([10.0, 5.0]))
    given = {"horizon": T, "cost": cost, "initial_state": START, "control_set": lfo.Box(-1, 1)}
    return lfo.OptimalControlProblem(lfo.LinearDynamics(A, B), **(given | fields))


@dataclass(frozen=True)
class Stopper:
    """What a method of solution becomes that stops at a point as soon as it is told one."""

    points: list[Point] = field(default_factory=list)
    status: lfo.results.Status = lfo.results.Status.LIMIT

    def solve(self, problem: lfo.OptimalControlProblem, request: Request) -> Outcome:
        outcome = super().solve(problem, request)
        if not self.points or outcome.status == "infeasible":
            return outcome
        point, stopped = self.points[0](problem), replace(outcome, status=self.status, message="told to stop")
        if point is None:
            return replace(stopped, trajectory=None, multipliers=None, certificate=None)
        return replace(stopped, trajectory=point, certificate=lfo.certify(problem, point, outcome.multipliers))


@dataclass(frozen=True)
class Stopping(Stopper, lfo.solvers.Structured):
    """The structured method."""


def controls(*values: float) -> Point:
    """Return the trajectory of these controls, the last of them held."""
    return lambda problem: lfo.simulate(problem, np.append(values, [values[-1]] * (T - len(values)))[:, None])


def optimum(problem: lfo.OptimalControlProblem) -> lfo.Trajectory:
    return lfo.solve(problem, "structured").trajectory


def nothing(problem: lfo.OptimalControlProblem) -> None:
    return None


def off_the_dynamics(by: float) -> Point:
    """Return the optimum with its state moved after the first."""

    def moved(problem: lfo.OptimalControlProblem) -> lfo.Trajectory:
        best = optimum(problem)
        return lfo.Trajectory(best.x + by * (np.arange(T + 1) > 0)[:, None], best.u)

    return moved


def second_step(base, point, state=None, status="limit", **given):
    """Return the first plan and the record of two steps, the second of which stops at a point."""
    method = Stopping(status=lfo.results.Status(status))
    controller = lfo.RecedingHorizon(base, method, **given)
    controller.step(START)
    plan = controller.log.steps[-1].plan
    method.points.append(point)
    controller.step(plan.x[1] if state is None else state)
    return plan, controller.log


@pytest.mark.parametrize("point", [controls(-0.53), nothing, off_the_dynamics(0.5)])
def test_the_last_plan_goes_on_where_it_is_better(point):
    plan, log = second_step(problem(), point)
    assert (log.sources[1], log.statuses[1]) == ("previous plan", "limit")
    np.testing.assert_allclose(log.controls[1], plan.u[1])
    later = np.vstack([plan.u[1:], plan.u[-1:]])
    replayed = lfo.simulate(problem(), later, plan.x[1])
    assert log.costs[1] == pytest.approx(problem().value(replayed.x, replayed.u))


def test_a_feasible_point_of_lower_cost_is_applied():
    """The plan was made where there is another state by now."""
    state = np.array([-0.5, 0.3])
    plan, log = second_step(problem(), optimum, state)
    assert log.sources[1] == "best point"
    np.testing.assert_allclose(log.controls[1], lfo.solve(problem().with_ends(state)).control[0], atol=1e-6)
    assert abs(log.controls[1, 0] - plan.u[1, 0]) > 0.1


def test_a_plan_that_goes_on_begins_where_the_state_was_measured():
    state = np.array([0.9, -0.2])
    plan, log = second_step(problem(), nothing, state)
    later = log.steps[1].plan
    np.testing.assert_array_equal(later.x[0], state)
    np.testing.assert_allclose(later.x[1:], later.x[:-1] @ A.T + later.u @ B.T, atol=1e-12)
    np.testing.assert_array_equal(later.u, np.vstack([plan.u[1:], plan.u[-1:]]))


def test_with_a_delay_it_begins_where_the_last_control_leads():
    state = np.array([0.9, -0.2])
    _, log = second_step(problem(), nothing, state, delay=1)
    np.testing.assert_allclose(log.steps[1].plan.x[0], A @ state + B @ log.controls[0])


BOUNDED = problem(state_set=lfo.Box([-5.0, -0.3], [5.0, 0.3]))
TOO_FAST = np.array([0.9, -0.35])  # faster than the bound, which the measured state alone may be


def test_a_feasible_point_comes_before_a_plan_that_is_not():
    slower = controls(1.0, 1.0, 0.0)
    plan, log = second_step(BOUNDED, slower, TOO_FAST)
    replayed = lfo.simulate(BOUNDED, np.vstack([plan.u[1:], plan.u[-1:]]), TOO_FAST)
    assert replayed.x[1:, 1].min() < -0.31
    assert log.sources[1] == "best point"
    assert log.controls[1, 0] == 1.0


def test_a_feasible_plan_comes_before_a_point_that_is_not():
    """The point is cheaper, as it leaves the bounds of the control."""
    eager = controls(-2.0, 0.0)
    plan, log = second_step(problem(), eager)
    assert log.sources[1] == "previous plan"
    assert log.controls[1, 0] == plan.u[1, 0]


@pytest.mark.parametrize(("push", "source"), [(0.0, "best point"), (-1.0, "previous plan")])
def test_of_two_that_are_not_feasible_the_smaller_violation_counts(push, source):
    """A point that is pushed breaks the bound of the speed by more than the plan, which follows it at its bound."""
    _, log = second_step(BOUNDED, controls(push), TOO_FAST)
    assert log.sources[1] == source


def test_constraints_of_the_step_count_and_not_those_of_the_plan():
    """The plan satisfies the bounds that it was made for, and not those of the next step."""
    method = Stopping()
    controller = lfo.RecedingHorizon(problem(), method)
    controller.step(START)
    plan = controller.log.steps[-1].plan
    method.points.append(controls(-0.4))
    bounds = {"control_set": lfo.Box(-0.5, 0.5)}
    assert controller.step(plan.x[1], bounds=bounds) == -0.4
    assert controller.log.sources[1] == "best point"
    assert plan.u[1, 0] == pytest.approx(-1.0)


def test_references_of_the_step_count_too():
    method = Stopping()
    controller = lfo.RecedingHorizon(problem(), method)
    controller.step(START)
    plan = controller.log.steps[-1].plan
    method.points.append(controls(1.0, 1.0, 0.0))
    far = {"x_ref": np.tile([9.0, 0.0], (T + 1, 1))}
    assert controller.step(plan.x[1], references=far) == 1.0
    assert controller.log.sources[1] == "best point"


SOFT = {"state_set": 10.0}


@expensive
@pytest.mark.parametrize(("point", "source"), [(controls(-0.1), "previous plan"), (optimum, "best point")])
def test_prices_count_where_constraints_are_soft(point, source):
    """The state is out of its bounds, and no control leads back in one step."""
    base = problem(state_set=lfo.Box([-0.5, -2.0], [0.5, 2.0]))
    state = np.array([1.0, 0.0])
    method = Stopping()
    controller = lfo.RecedingHorizon(base, method, SOFT)
    controller.step(state)
    plan = controller.log.steps[-1].plan
    method.points.append(point)
    controller.step(plan.x[1] if source == "previous plan" else [2.0, 0.5])
    log = controller.log
    assert log.statuses == ("infeasible", "infeasible")
    assert log.sources[1] == source
    step = log.steps[1]
    soft = 10.0 * np.maximum(np.abs(step.plan.x[1:]) - [0.5, 2.0], 0.0).sum()
    assert step.cost == pytest.approx(base.value(step.plan.x, step.plan.u) + soft)
    assert step.excess["state set"] == pytest.approx(soft / 10.0)


def test_a_tolerance_of_the_method_counts_for_both():
    """The plan breaks the bound by less than the tolerance, as the point does, and costs less."""
    base = problem(control_set=lfo.Box(-1.0, 1.0))
    for tolerance, source in ((1e-3, "best point"), (None, "previous plan")):
        method = Stopping(tolerance=tolerance)
        controller = lfo.RecedingHorizon(base, method)
        controller.step(START)
        method.points.append(lambda given: lfo.simulate(given, 1.0002 * optimum(given).u))
        controller.step([1.5, 0.5])
        assert controller.log.sources[1] == source


@pytest.mark.parametrize("status", ["limit", "numerical_error"])
def test_at_the_first_step_a_feasible_point_is_applied_and_no_other(status):
    error = {"limit": lfo.errors.LimitError, "numerical_error": lfo.errors.NumericalError}[status]
    first = lfo.RecedingHorizon(problem(), Stopping(points=[controls(-0.53)], status=lfo.results.Status(status)))
    assert first.step(START) == -0.53
    assert first.log.sources == ("best point",)
    for point in (controls(-2.0, 0.0), nothing):
        other = lfo.RecedingHorizon(problem(), Stopping(points=[point], status=lfo.results.Status(status)))
        with pytest.raises(error):
            other.step(START)
        assert not other.log.steps


@dataclass(frozen=True)
class StoppingSearch(Stopper, lfo.solvers.BranchAndBound):
    """The search over modes."""


def stones() -> lfo.OptimalControlProblem:
    """Return x_{t+1} = x_t + u_t from 0.6 to 2.5 over [0, 1] and [2, 3], with nothing to stand on between them."""
    modes = [lfo.AffineMode([[1.0]], [[1.0]], G=[[-1.0], [1.0]], h=[-low, low + 1.0]) for low in (0.0, 2.0)]
    ends = {"initial_state": [0.6], "terminal_state": [2.5]}
    sets = {"control_set": lfo.Box(-1.5, 1.5), "state_set": lfo.Box(-1, 4)}
    return lfo.OptimalControlProblem(lfo.PiecewiseAffineDynamics(modes), 4, lfo.QuadraticCost(R=1.0), **sets, **ends)


def stepped(*states: float) -> Point:
    """Return a trajectory through these states."""
    x = np.array(states)[:, None]
    return lambda problem: lfo.Trajectory(x, np.diff(x, axis=0))


@expensive
def test_a_plan_that_leads_where_no_mode_holds_is_none():
    """Its second control leads from the measured state into the gap; a point that misses the end is none, either."""
    for point, applied in ((stepped(0.3, 1.0, 2.0, 2.25, 2.5), 0.7), (stepped(0.3, 1.0, 2.0, 2.0, 2.0), None)):
        method = StoppingSearch()
        controller = lfo.RecedingHorizon(stones(), method)
        controller.step([0.6])
        assert controller.log.steps[0].plan.u[1, 0] > 0.99
        method.points.append(point)
        if applied is None:
            with pytest.raises(lfo.errors.LimitError):
                controller.step([0.3])
        else:
            assert controller.step([0.3]) == pytest.approx(applied)
            assert controller.log.sources[1] == "best point"
