"""Input that fits no uncertainty: the field, what was got, what was expected, what to do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from helpers.tubes import tube


def start(given):
    return lfo.Disturbance(lfo.Box(-0.1, 0.1), start=given)


UNSTABLE = lfo.LinearDynamics([[1.2, 0.0], [0.0, 0.5]], [[0.0], [1.0]])
Box, Disturbance = lfo.Box, lfo.Disturbance
Records, Gaussian = lfo.uncertainty.Records, lfo.uncertainty.Gaussian


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Disturbance(Box(-1, None)), "disturbance.set: got .*without bounds; expected a bounded set"),
        (lambda: Disturbance(Box([-1.0], [1.0])), "disturbance.set: got a set in 1 dimensions; expected 2"),
        (
            lambda: Disturbance(Box(np.zeros((3, 2)), np.ones((3, 2)))),
            "disturbance.set: got bounds that depend on time",
        ),
        (
            lambda: Disturbance(lfo.sets.Polyhedron([[1.0, 0.0]], [1.0])),
            "disturbance.set: got a polyhedron without bounds",
        ),
        (
            lambda: Disturbance(lfo.sets.Ellipsoid([[1.0, 0.0]])),
            r"disturbance.set.W: got shape \(1, 2\); expected a regular",
        ),
        (
            lambda: Disturbance(lfo.sets.SecondOrderCone([[1.0, 0]], [0.0], [0.0, 1])),
            "disturbance.set: got a set of the kind",
        ),
        (lambda: Disturbance([0.1, 0.2]), r"disturbance.set: got shape \(2,\); expected a set such as Box"),
        (lambda: Disturbance([[0.1, np.nan]]), "disturbance.set.*nan; expected a finite number"),
        (lambda: Disturbance([[0.1], [0.2]]), "disturbance.set: got loads of 1 component; expected 2"),
        (lambda: Disturbance(Box(-1, 1), np.zeros((2, 1))), "disturbance.input: got zeros"),
        (lambda: Disturbance(Box(-1, 1), [1.0, 0.0]), r"disturbance.input: got shape \(2,\)"),
        (lambda: Disturbance(Box(-1, 1), np.eye(3)), r"disturbance.input: got shape \(3, 3\); expected shape \(2, 3\)"),
        (lambda: Disturbance(Box(-1, 1), gain="lqr"), "disturbance.gain: got 'lqr'; expected 'auto', a matrix"),
        (
            lambda: Disturbance(Box(-1, 1), gain=[[1.0]]),
            r"disturbance.gain: got shape \(1, 1\); expected shape \(1, 2\)",
        ),
        (
            lambda: Disturbance(Box(-1, 1), gain=[[1.0, 1.0]]),
            r"disturbance.gain: .*spectral radius .*; expected below 1. gain='auto'",
        ),
        (lambda: Disturbance(Box(-1, 1), gain=None, forever=True), "disturbance.gain: .*spectral radius 1;"),
        (
            lambda: Disturbance(Box(-1, 1), start=0.1),
            r"disturbance.start: got 0.1; expected a set such as Box, or None. The error of the start is in lfo.Box",
        ),
        (lambda: start(Box(-1, None)), "disturbance.start: got .*without bounds; expected a bounded set. State both"),
        (lambda: start(Box([-1.0], [1.0])), "disturbance.start: got a set in 1 dimensions; expected 2, one per state"),
        (lambda: start(lfo.sets.Polyhedron([[1.0, 0.0]], [1.0])), "disturbance.start: got a polyhedron without bounds"),
        (
            lambda: start(lfo.sets.Ellipsoid([[1.0, 0.0]])),
            r"disturbance.start.W: got shape \(1, 2\); expected a regular",
        ),
        (
            lambda: start(lfo.Periodic()),
            "disturbance.start: got a set of the kind Periodic; expected a Box.*State a po",
        ),
        (
            lambda: Disturbance(Box(-1, 1), start=Box(-1, 1), forever=True),
            "disturbance.start: .*forever=True has its own",
        ),
        (
            lambda: Disturbance(Records(np.zeros((2, 3, 2)))),
            "Records.loads: got loads of 3 steps; expected one load for each of the 10",
        ),
        (lambda: Disturbance(Records(np.zeros((2, 3)))), r"Records.loads: got shape \(2, 3\)"),
        (lambda: Disturbance(Gaussian([[1.0, 2.0], [2.0, 1.0]], 0.9)), "Gaussian.covariance: .*positive semidefinite"),
        (lambda: Disturbance(Gaussian([[1.0, 0.0], [0.5, 1.0]], 0.9)), "Gaussian.covariance: .*symmetric"),
        (lambda: Disturbance(Gaussian(np.eye(2), 0.5)), "Gaussian.probability: got 0.5; expected one number above 0.5"),
        (lambda: Disturbance(Box(1, -1)), r"lower: got 1(.0)? above upper = -1"),
        (lambda: Disturbance(Box(-np.inf, 1)), "disturbance.set: got .*without bounds"),
        (lambda: Disturbance(Box(np.nan, 1)), "lower: got nan"),
        (lambda: Disturbance(np.zeros((0, 2))), r"disturbance.set: got shape \(0, 2\)"),
        (
            lambda: Disturbance(lfo.sets.Polyhedron(np.vstack([np.eye(2), -np.eye(2)]), [-1.0, -1, -1, -1])),
            "disturbance.set: got .*empty",
        ),
        (lambda: lfo.sets.Ball(0.1), "uncertainty: got Ball.*expected a Disturbance, Plants or Discs"),
    ],
)
def test_what_is_no_disturbance_is_refused_with_the_field(make, message):
    with pytest.raises(lfo.errors.ProblemError, match=message):
        lfo.robust(tube(), make())


@pytest.mark.parametrize(
    ("problem", "message"),
    [
        (lambda: lfo.library.pendulum_with_wall(), "dynamics"),
        (lambda: tube(control_set=lfo.FiniteSet([-1.0, 1.0])), "dynamics|control_set"),
        (lambda: tube(stage_rows=lfo.sets.PathConstraint(lambda t, x, u: x[0] * x[0], upper=200.0)), "stage_rows"),
        (lambda: tube(state_set=lfo.sets.Ball(20.0)), "robust: got a set of the kind Ball.*State a polyhedron"),
        (
            lambda: tube(state_set=lfo.sets.Ellipsoid(0.01 * np.eye(2))),
            "robust: got a set of the kind Ellipsoid.*State a polyhedron",
        ),
        (
            lambda: tube(state_set=lfo.sets.SecondOrderCone([[0.0, 1.0]], [0.0], [-1.0, 0.0], 20.0)),
            "robust: got a set of the kind SecondOrderCone.*State a polyhedron",
        ),
        (
            lambda: lfo.OptimalControlProblem(
                lfo.PiecewiseSmoothDynamics.from_formulas("x_0 + x_0**3 + u_0", 1, 1),
                5,
                lfo.QuadraticCost(R=1.0),
                initial_state=[0.0],
            ),
            "dynamics",
        ),
    ],
)
def test_problems_with_modes_formulas_levels_and_balls_are_unsupported(problem, message):
    with pytest.raises(lfo.errors.UnsupportedError, match=message):
        lfo.robust(problem(), Disturbance(Box(-0.1, 0.1)))


def test_a_load_on_an_unstable_state_out_of_reach_has_no_feedback():
    problem = lfo.OptimalControlProblem(UNSTABLE, 5, lfo.QuadraticCost(R=1.0), initial_state=[0.0, 0.0])
    load = Disturbance(Box(-0.1, 0.1))
    with pytest.raises(lfo.errors.ProblemError, match=r"disturbance.gain: got 'auto'.*gain=None has no feedback"):
        lfo.robust(problem, load)
    alone = Disturbance(Box(-0.1, 0.1), gain=None)
    assert lfo.worst_case(problem, alone, lfo.solve(lfo.robust(problem, alone)))


def test_margins_that_exceed_a_range_say_how_much_of_the_loads_leaves_a_plan():
    problem = tube(state_set=None)
    with pytest.raises(lfo.errors.ProblemError) as info:
        lfo.robust(problem, Disturbance(Box(-0.8, 0.8)))
    assert "of which the loads take" in str(info.value)
    share = float(str(info.value).split("At most ")[1].split()[0])
    K = Disturbance(Box(-0.8, 0.8)).feedback(problem)
    lfo.robust(problem, Disturbance(Box(-0.8 * share * 0.99, 0.8 * share * 0.99), gain=K))
    with pytest.raises(lfo.errors.ProblemError):
        lfo.robust(problem, Disturbance(Box(-0.8 * share * 1.02, 0.8 * share * 1.02), gain=K))


def test_ends_masks_and_options_that_do_not_fit():
    load, free = Disturbance(Box(-0.1, 0.1)), tube(initial_state=None)
    with pytest.raises(lfo.errors.ProblemError, match="end: got 'set'; expected 'invariant' or None"):
        lfo.robust(free, load, end="set")
    with pytest.raises(lfo.errors.ProblemError, match=r"terminal_state: got an end, .*; expected a free end"):
        lfo.robust(replace(free, terminal_state=Box(-1, 1)), load, end="invariant")
    with pytest.raises(lfo.errors.ProblemError, match=r"steady state.*There is one for at most 0.* of these loads"):
        lfo.robust(narrow(), Disturbance(Box(-0.5, 0.5)), end="invariant")
    with pytest.raises(lfo.errors.UnsupportedError, match="end='invariant'"):
        lfo.robust(free, Disturbance(Gaussian(1e-4 * np.eye(2), 0.9)), end="invariant")
    with pytest.raises(lfo.errors.UnsupportedError, match=r"disturbance.forever"):
        lfo.robust(free, Disturbance(Records(np.zeros((1, 10, 2))), forever=True))
    masked = tube(control_spectrum=lfo.MagnitudeBound(1e-3, bins=[4]))
    with pytest.raises(
        lfo.errors.ProblemError, match=r"control_spectrum: got 0.001 at bin 4 of u_0; expected at least"
    ):
        lfo.robust(masked, load)
    with pytest.raises(lfo.errors.UnsupportedError, match="control_spectrum: got a mask of a signal that loads change"):
        lfo.robust(masked, Disturbance(Gaussian(1e-4 * np.eye(2), 0.9)))
    with pytest.raises(lfo.errors.ProblemError, match="plan: got 3; expected a Trajectory"):
        lfo.worst_case(free, load, 3)


def narrow():
    """A stable plant whose steady states leave little room."""
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.9]], [[1.0]]), 3, lfo.QuadraticCost(Q=1.0, R=1.0), Box(-1, 0.25), Box(2.0, None)
    )


def test_fixed_ends_are_for_the_plan_with_one_warning():
    problem = tube(12, terminal_state=[0.0, 0.0])
    load = Disturbance(Box(-0.05, 0.05))
    with pytest.warns(lfo.errors.ClosedLoopWarning, match="robust: terminal_state hold for the plan") as warned:
        plan = lfo.robust(problem, load)
    worst = lfo.worst_case(problem, load, lfo.solve(plan))
    assert len(warned) == 1
    assert worst
    assert worst.end.min() > 0.05
    assert "end of the plan" in str(worst)


@pytest.mark.parametrize("sign", [1, -1])
def test_fixed_ends_are_for_the_plan_whatever_the_sign_of_the_loads(sign):
    load = Disturbance([[sign * 0.01, 0.0], [sign * 0.03, 0.0]], gain=None)
    problem = tube(12, terminal_state=[0.0, 0.0])
    with pytest.warns(lfo.errors.ClosedLoopWarning, match="robust: terminal_state hold for the plan"):
        plan = lfo.robust(problem, load)
    found = lfo.solve(plan)
    assert lfo.worst_case(problem, load, found).end[0] == pytest.approx(12 * 0.03)


def test_equal_bounds_one_step_and_states_without_bounds():
    one = tube(1, initial_state=[0.0, 0.0])
    assert lfo.worst_case(one, Disturbance(Box(-0.1, 0.1)), lfo.solve(lfo.robust(one, Disturbance(Box(-0.1, 0.1)))))
    still = lfo.OptimalControlProblem(  # the second state never moves, and no load acts on it
        lfo.LinearDynamics([[0.9, 1.0], [0.0, 1.0]], [[1.0], [0.0]]),
        6,
        lfo.QuadraticCost(Q=np.diag([1.0, 0.0]), R=0.0),
        Box(-1, 1),
        Box([None, 0.2], [None, 0.2]),
        [1.0, 0.2],
    )
    load = Disturbance(Box(-0.1, 0.1), [[1.0], [0.0]], gain=None)
    tight = lfo.robust(still, load)
    np.testing.assert_array_equal(tight.state_set.upper[:, 1], 0.2)
    assert np.isinf(tight.state_set.upper[:, 0]).all()
    assert lfo.worst_case(still, load, lfo.solve(tight))


@expensive
def test_a_robust_problem_keeps_what_it_is_made_of_and_gets_no_margins_twice():
    problem, load = tube(initial_state=None), Disturbance(Box(-0.1, 0.1))
    plan = replace(lfo.robust(problem, load, end="invariant"), name="renamed", initial_state=[-5.0, 0.0])
    assert (plan.given, plan.uncertainty, plan.end) == (problem, load, "invariant")
    with pytest.raises(lfo.errors.UnsupportedError, match=r"delay: got 1.*State the delay as a state"):
        lfo.RecedingHorizon(plan, delay=1)
    with pytest.raises(lfo.errors.ProblemError, match="problem: got one of robust, with margins; expected one without"):
        lfo.robust(plan, load)
    with pytest.raises(lfo.errors.ProblemError, match=r"problem: got one of robust.*rate_limited first"):
        lfo.rate_limited(plan, 0.5)
    assert lfo.worst_case(plan.given, plan.uncertainty, lfo.solve(plan)).price is not None
    assert problem.uncertainty is None
