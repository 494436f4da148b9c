"""A loop whose plans are judged afterwards applies the same controls, and claims nothing before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.compilers import needs_kernel
from helpers.loops import LOOPS, pendulum, states
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.solving import PlannedStart, proven_in_batch


@needs_kernel
@pytest.mark.parametrize("name", seeds(LOOPS))
def test_the_same_controls_and_every_plan_proven(name):
    problem = LOOPS[name]()
    each, later = (lfo.RecedingHorizon(problem, certify=when, soft=None) for when in ("each", "later"))
    compared = 0
    for start in 0.5 * states(problem, 10):
        try:
            expected = each.step(start)
        except lfo.errors.InfeasibleError:
            continue
        np.testing.assert_allclose(later.step(start), expected, atol=1e-7 * max(1.0, float(np.abs(expected).max())))
        compared += 1
    assert compared >= 8
    before = later.log
    assert all(status is None for status in before.statuses)
    assert not before.satisfied.any()
    assert np.isnan(before.gaps).all()
    assert before.table[-1]["status"] == "not judged"
    after = later.certify()
    assert set(after.statuses) == {"optimal"}
    assert after.satisfied.all()
    np.testing.assert_allclose(after.costs, each.log.costs, rtol=1e-7)
    assert (after.certify_seconds > 0).all()


@needs_kernel
def test_a_step_without_a_solution_applies_the_softened_plan():
    problem = pendulum(30)
    loop = lfo.RecedingHorizon(problem, certify="later", soft={"state_set": 1e3})
    outside = np.array([0.9, 0.3, 1.5, 1.5])
    for start in (*0.5 * states(problem, 5), *[outside] * 5):
        loop.step(start)
    assert loop.log.sources[-1] == "softened problem"
    log = loop.certify()
    assert log.statuses[-1] == "infeasible_claimed"
    assert log.steps[-1].excess
    exact = lfo.RecedingHorizon(problem, soft={"state_set": 1e3})
    np.testing.assert_allclose(exact.step(outside), log.controls[-1], atol=1e-6)


@needs_kernel
def test_the_first_step_without_a_solution_is_planned_like_any_other():
    loop = lfo.RecedingHorizon(pendulum(30), certify="later", soft={"state_set": 1e3})
    for start in ([0.0, 0.0, 0.0, 0.0], [0.9, 0.3, 1.5, 1.5]):
        loop.step(start)
    assert loop.log.sources == ("plan", "softened problem")
    assert {step.method for step in loop.log.steps} == {"condensed"}
    assert loop.log.statuses == (None, None)


def test_softened_plans_wait_until_the_hard_problem_was_tried():
    """A polyhedron is solved as rows of another problem, of which there are no plans before their judgement."""
    problem = pendulum(20, None, state_set=lfo.sets.Polyhedron(np.vstack([np.eye(4), -np.eye(4)]), np.ones(8)))
    loop = lfo.RecedingHorizon(problem, certify="later", soft={"state_set": 1e3})
    for start in 0.1 * states(problem, 3):
        loop.step(start)
    assert set(loop.log.sources) == {"plan"}
    assert set(loop.log.statuses) == {"optimal"}


@needs_kernel
def test_a_preview_is_solved_and_judged_at_once():
    problem = pendulum(20)
    loop = lfo.RecedingHorizon(problem, certify="later")
    for start in states(problem, 6):
        loop.step(start)
    loop.step(states(problem, 1)[0], references={"x_ref": np.zeros(4)})
    assert loop.log.statuses[-1] == "optimal"
    assert loop.log.statuses[-2] is None


@needs_kernel
def test_states_far_from_zero_are_counted_from_where_they_are():
    dynamics = lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]], sampling_time=0.1)
    far = np.array([5.4e6, 0.0])
    cost = lfo.QuadraticCost(Q=np.diag([1.0, 0.1]), R=0.1, P=np.diag([10.0, 5.0]), x_ref=far)
    problem = lfo.OptimalControlProblem(dynamics, 20, cost, lfo.Box(-1, 1), initial_state=far)
    loop = lfo.RecedingHorizon(problem, certify="later")
    near = lfo.RecedingHorizon(problem.with_references({"x_ref": np.zeros(2)}), certify="later")
    for k in range(8):
        start = np.array([0.5 - 0.05 * k, 0.0])
        np.testing.assert_allclose(loop.step(far + start), near.step(start), atol=1e-7)
    assert set(loop.certify().statuses) == {"optimal"}
    assert {step.method for step in loop.log.steps} == {"condensed"}


def test_a_word_that_is_no_time_is_refused():
    with pytest.raises(lfo.errors.ProblemError, match="certify"):
        lfo.RecedingHorizon(pendulum(10), certify="never")


@expensive
@needs_kernel
@pytest.mark.parametrize("name", ["soft", "rows"])
def test_plans_with_soft_and_joint_rows_are_judged_as_a_batch(name, monkeypatch):
    """The batch judge says of every plan what the single judge does, violations of soft bounds included."""
    rows = lfo.StageRows([[1.0, 0.5, 0.0, 0.0]], [[0.02]], [0.3])
    problem, soft = pendulum(30), {"state_set": 1e3}
    if name == "rows":
        problem, soft = replace(problem, stage_rows=rows), soft | {"stage_rows": 1e2}
    logs = list[lfo.results.ClosedLoop]()
    for alone in (False, True):
        loop = lfo.RecedingHorizon(problem, certify="later", soft=soft)
        for start in (*0.5 * states(problem, 5), *[np.array([0.9, 0.3, 1.5, 1.5])] * 3):
            loop.step(start)
        substitute(monkeypatch, "solving.proven_in_batch", (lambda _: {}) if alone else never_alone(monkeypatch))
        logs.append(loop.certify())
        monkeypatch.undo()
    batch, single = logs
    assert batch.statuses == single.statuses
    assert {"optimal", "infeasible_claimed"} == set(batch.statuses)
    np.testing.assert_allclose(batch.costs, single.costs, rtol=1e-12)
    for one, other in zip(batch.steps, single.steps, strict=True):
        assert one.excess.keys() == other.excess.keys()
        assert all(value == pytest.approx(other.excess[key], rel=1e-6) for key, value in one.excess.items())


def never_alone(monkeypatch):
    """Return the batch judge, after which no plan is left to the single one."""

    def fail(*given):
        raise AssertionError("a plan was left to the single judge")

    monkeypatch.setattr(PlannedStart, "certified", fail)
    return proven_in_batch
