"""Steps with a limit on the changes of the working set, or on time: what they apply, and what they do not claim."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.compilers import needs_kernel
from helpers.dense_kernel import DenseKernel
from helpers.loops import LOOPS, pendulum, states
from helpers.seeds import expensive
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.methods import LIMIT, SOLVED, Budget, CondensedSolver

QUEUE = 4  # rows that the C kernel counts as tried after the last change
SOFT = {"state_set": 1e3}
PUSHED = np.array([0.3, 0.15, 0.9, 1.3])  # no plan from here keeps the bounds


def limited(limit: int | None, problem=None, **fields) -> lfo.RecedingHorizon:
    return lfo.RecedingHorizon(problem or pendulum(60), certify="later", soft=SOFT, max_changes=limit, **fields)


def driven(loop: lfo.RecedingHorizon, steps: int = 12) -> lfo.results.ClosedLoop:
    """Return the record of a loop that is pushed at its second step."""
    x, plant = np.zeros(4), loop.problem.dynamics.stepper(1)
    for k in range(steps):
        x = plant(0, PUSHED if k == 1 else x, loop.step(PUSHED if k == 1 else x))
    return loop.log


@expensive
@needs_kernel
@pytest.mark.parametrize("limit", [1, 3, 10, 40])
def test_a_limited_step_claims_nothing_and_the_loop_goes_on(limit):
    loop = limited(limit)
    driven(loop)
    log = loop.certify()
    ended = [step for step in log.steps if step.status == "limit"]
    assert ended
    assert {step.source for step in ended} <= {"best point", "previous plan"}
    assert not any(step.satisfied for step in ended)
    assert all(np.isnan(step.gap) and step.pending is None for step in ended)
    assert np.abs(log.controls).max() <= loop.problem.control_tube.upper.max() + 1e-9
    assert log.changes[1:].max() <= 2 * (limit + QUEUE)  # the hard problem and the softened one
    assert log.table[1]["changes"] == log.changes[1]
    assert np.abs(log.states).max() < 3


@needs_kernel
def test_limits_that_are_never_reached_change_nothing():
    np.testing.assert_array_equal(driven(limited(10_000)).controls, driven(limited(None)).controls)


@needs_kernel
def test_the_loop_finds_its_plans_again():
    """The multipliers of a step that has ended early are the start of the next."""
    sources = driven(limited(10), 60).sources
    assert "best point" in sources[:10]
    assert set(sources[-5:]) <= {"plan", "softened problem"}


@needs_kernel
@pytest.mark.parametrize("limit", [3, 20])
def test_the_better_of_both_plans_is_applied(limit):
    loop, same = limited(limit), limited(limit)
    driven(loop, 2)
    driven(same, 1)
    own = same._controller._soft._cache.plan(PUSHED, Budget(changes=limit))
    rest = own.following(same.log.steps[0].planned)
    better, source = (rest, "previous plan") if rest.rank < own.rank else (own, "best point")
    assert not own.settled
    assert loop.log.sources[1] == source
    np.testing.assert_allclose(loop.log.controls[1], np.clip(better.control, -5.0, 5.0))
    np.testing.assert_allclose(loop.log.steps[1].plan.u, better.trajectory.u)


@needs_kernel
@pytest.mark.parametrize("limit", [1, 3])
def test_a_limited_step_keeps_rate_limits_exactly(limit):
    plant = lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0.005], [0.1]])
    cost = lfo.QuadraticCost(Q=np.diag([10.0, 1.0]), R=0.01)
    problem = lfo.OptimalControlProblem(plant, 20, cost, lfo.Box(-5, 5), initial_state=[0, 0])
    loop = lfo.RecedingHorizon(lfo.rate_limited(problem, 0.3, previous=0.0), certify="later", max_changes=limit)
    x, before, rng = np.array([0.1, 0.0]), 0.0, np.random.default_rng(0)
    for k in range(25):
        u = loop.step(x)
        assert abs(Fraction(u[0]) - Fraction(before)) <= Fraction(0.3)
        x, before = plant.A @ x + plant.B @ u + (rng.standard_normal(2) if k % 10 == 5 else 0), u[0]
    assert "limit" in loop.log.statuses


@needs_kernel
def test_a_preview_before_the_first_plain_step_hinders_none():
    loop, plain = limited(20), limited(20)
    x = states(loop.problem, 1)[0]
    loop.step(x, references={"x_ref": np.full((61, 4), 0.01)})
    np.testing.assert_allclose(loop.step(x), plain.step(x), atol=1e-9)


@needs_kernel
@pytest.mark.parametrize("name", LOOPS)
def test_the_worth_of_a_plan_is_its_cost_and_its_violation(name):
    problem = LOOPS[name]()
    spectral = lfo.SpectralSolver(problem)
    solver = CondensedSolver(spectral.lti, spectral.units)
    plans = [plan for plan in (solver.plan(x, spectral.lti) for x in states(problem, 6)) if plan and plan.eta_C]
    first = plans[0]
    for plan in plans:
        violation, cost = plan.tables.worth(plan.start / plan.units.x, plan.v)
        assert violation < 1e-6
        assert plan.rank == (False, cost)
        apart = problem.value(plan.trajectory.x, plan.trajectory.u)
        apart -= problem.value(first.trajectory.x, first.trajectory.u)
        assert (cost - first.rank[1]) * plan.units.cost == pytest.approx(apart, abs=1e-7 * (1 + abs(apart)))
    far = first.following(lfo.Trajectory(first.trajectory.x, first.trajectory.u + 100.0))
    assert far.rank[0]
    assert not far.settled


@needs_kernel
def test_the_rest_of_a_plan_is_followed_where_nothing_disturbs_it():
    problem = pendulum(30, None)
    spectral = lfo.SpectralSolver(problem)
    solver = CondensedSolver(spectral.lti, spectral.units)
    plan = solver.plan(np.array([0.04, 0.0, 0.0, 0.0]), spectral.lti)
    last = plan.trajectory
    rest = solver.plan(last.x[1], spectral.lti).following(last)
    np.testing.assert_allclose(rest.trajectory.u[:-1], last.u[1:], atol=1e-12)
    np.testing.assert_allclose(rest.control, last.u[1], atol=1e-12)


@needs_kernel
def test_both_kernels_end_where_they_are_told():
    problem = pendulum(30, state_set=lfo.sets.Soft(lfo.Box(-0.05, 0.05), 5.0))
    spectral = lfo.SpectralSolver(problem)
    solver = CondensedSolver(spectral.lti, spectral.units)
    x = PUSHED / spectral.units.x
    for kernel in (solver.kernel, DenseKernel(solver.kernel.tables)):
        assert kernel.step(x, 2) == LIMIT
        assert np.isfinite(kernel.unknowns).all()
        assert kernel.step(x) == SOLVED  # from there on, without a limit
        np.testing.assert_allclose(
            kernel.plan, kernel.tables.W @ np.append(x, 1.0) + kernel.tables.V @ kernel.unknowns, atol=1e-9
        )


@needs_kernel
def test_time_is_a_limit_too():
    """The clock stands still in the first step; after it, each look at it takes longer than the limit."""
    clock = Clock()
    with use_clock(clock):
        loop = limited(None, time_limit=1.0)
        loop.step(np.zeros(4))
        clock.per_look = 2.0
        loop.step(PUSHED)
    assert loop.log.statuses == (None, "limit")
    assert loop.log.sources[1] in ("best point", "previous plan")


BAD = {
    "each": ({"certify": "each"}, "max_changes"),
    "none": ({"max_changes": 0}, "max_changes"),
    "a word": ({"max_changes": "few"}, "max_changes"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_limit_that_does_not_fit_is_refused(case):
    given, field = BAD[case]
    with pytest.raises(lfo.errors.ProblemError) as caught:
        lfo.RecedingHorizon(pendulum(10), **({"certify": "later", "max_changes": 5} | given))
    assert caught.value.field == field


REFUSED = {
    "the past": lambda: pendulum(
        20, None, state_spectrum=lfo.spectrum.closed_loop(lfo.spectrum.notch(1.5, 1.0), 0.1, length=8)
    ),
    "601 controls": lambda: pendulum(601, None),
    "another method": lambda: lfo.library.double_integrator(),
}


@needs_kernel
def test_softened_problems_without_such_plans_are_refused_too():
    rows = lfo.sets.Polyhedron([[1.0, 1.0, 0.0, 0.0]], [0.5])
    loop = lfo.RecedingHorizon(
        pendulum(20, None, terminal_state=rows), certify="later", max_changes=5, soft={"terminal_state": 1e3}
    )
    with pytest.raises(lfo.errors.UnsupportedError, match=r"max_changes: .*reduced problem"):
        loop.step(np.zeros(4))


@pytest.mark.parametrize("case", REFUSED)
def test_problems_without_such_plans_are_refused_with_the_reason(case):
    method = "structured" if case == "another method" else "auto"
    loop = lfo.RecedingHorizon(REFUSED[case](), method, certify="later", max_changes=5)
    with pytest.raises(lfo.errors.UnsupportedError, match=r"max_changes: .*(windows|601 controls|'auto')"):
        loop.step(loop.problem.initial_box.lower)
