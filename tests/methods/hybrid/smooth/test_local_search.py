"""The order of local optima and of starts, with a method in place of the barrier that answers what a test wants."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.path_constraints import mass
from helpers.random.smooth import random_problem
from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp import library
from lin_freq_ocp.methods import zero_multipliers
from lin_freq_ocp.methods.hybrid import FAR_REACHES, SMOOTH_STARTS, End, LocalOptimum, LocalSearch, states_of_controls
from lin_freq_ocp.results import Reason
from lin_freq_ocp.transform import start_of

PROBLEM = replace(library.pendulum_swing_up(horizon=4, sampling_time=0.1), control_set=lfo.Box(-5, 5))
REST = lfo.simulate(PROBLEM, np.zeros((4, 1)))
ALONE = np.zeros(4, dtype=np.intp)
TRIED_ALL = 6  # five constant controls and a straight line


def optimum(cost=1.0, violation=0.0, converged=True, eta=0.0, far=False):
    """Return an answer of a local search, at rest or far away."""
    multipliers = replace(zero_multipliers(PROBLEM, 1.0), eta=np.full((4, 2), eta))
    trajectory = replace(REST, x=REST.x + 1e9) if far else REST
    return LocalOptimum(ALONE, trajectory, multipliers, cost, violation, converged)


def script(monkeypatch, answers):
    """Let the barrier give these answers in turn, the last one for ever; return the list of its starts."""
    starts = []

    def answer(problem, start, sequence, end, warm, below):
        starts.append(warm)
        return answers[min(len(starts), len(answers)) - 1], End.OPTIMAL

    substitute(monkeypatch, "methods.hybrid.smooth_optimum", answer)
    return starts


ASCENDING = {
    "far from the dynamics": optimum(violation=1e-2),
    "nearer": optimum(cost=2.0, violation=1e-3),
    "not converged": optimum(cost=3.0, converged=False),
    "not converged, and cheaper": optimum(cost=2.0, converged=False),
    "converged": optimum(cost=4.0),
    "converged, and cheaper": optimum(cost=3.0),
}


@expensive
@pytest.mark.parametrize(("worse", "better"), list(zip(ASCENDING, list(ASCENDING)[1:], strict=False)))
def test_of_two_optima_the_preferred_one_stays(worse, better, monkeypatch):
    for names in ((worse, better), (better, worse)):
        script(monkeypatch, [ASCENDING[name] for name in names])
        search = LocalSearch(PROBLEM)
        for shift in range(2):
            search.look_near(replace(REST, x=REST.x + shift), ALONE)
        assert search.best is ASCENDING[better]
        assert search.attempts[-1].reason is ASCENDING[better].reason


@pytest.mark.parametrize(
    "no_gain",
    [optimum(cost=1.0 - 1e-12), optimum(cost=1.0 - 1e-3, violation=1e-9, eta=1e9)],
    ids=["rounding", "violation"],
)
def test_what_rounding_or_violation_saves_is_no_gain(no_gain, monkeypatch):
    first = optimum()
    script(monkeypatch, [first, no_gain])
    search = LocalSearch(PROBLEM)
    assert search.look_near(REST, ALONE)
    assert not search.look_near(replace(REST, x=REST.x + 1), ALONE)
    assert search.best is first


def test_a_start_is_tried_once(monkeypatch):
    starts, search = script(monkeypatch, [optimum()]), LocalSearch(PROBLEM)
    for _ in range(2):
        search.look_near(REST, ALONE)
    assert starts == [True]


@expensive
@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (optimum(), [False] * SMOOTH_STARTS),
        (optimum(converged=False), [False] * SMOOTH_STARTS),
        (optimum(violation=1.0), [False] * TRIED_ALL + [True]),
        (optimum(converged=False, far=True), [False]),
    ],
    ids=["converged", "feasible", "violated: all, then near the best", "growing without a bound"],
)
def test_how_many_starts_are_tried(answer, expected, monkeypatch):
    starts = script(monkeypatch, [answer])
    search = LocalSearch(PROBLEM).run()
    assert starts == expected
    assert search.tried == len(search.attempts) == len(expected)


def test_a_proven_optimum_ends_the_search(monkeypatch):
    starts = script(monkeypatch, [optimum()])
    search = LocalSearch(PROBLEM, is_proven=lambda _: True).run()
    assert (starts, search.attempts[-1].reason) == ([False], Reason.PROVEN)


@pytest.mark.parametrize(("costs", "expected"), [((3.0, 3.0), 2), ((3.0, 4.0, 5.0, 6.0), 4)])
def test_without_bounds_four_starts_are_enough_or_two_with_one_answer(costs, expected, monkeypatch):
    starts = script(monkeypatch, [optimum(cost) for cost in costs])
    LocalSearch(replace(PROBLEM, control_set=None)).run()
    assert len(starts) == expected


def test_without_bounds_far_starts_follow_where_none_leads_to_a_trajectory(monkeypatch):
    starts = script(monkeypatch, [optimum(violation=1.0)])
    LocalSearch(replace(PROBLEM, control_set=None)).run()
    assert starts == [False] * (TRIED_ALL + len(FAR_REACHES)) + [True]


@expensive
@pytest.mark.parametrize("seed", [71, 179, 403, 703])
def test_ends_that_no_near_start_reaches_are_reached_from_far_ones(seed):
    search = LocalSearch(random_problem(seed)).run()
    assert search.best.reason is Reason.LOCALLY_OPTIMAL
    assert search.tried > TRIED_ALL


@expensive
@pytest.mark.parametrize(
    ("answers", "expected"),
    [
        ([optimum()], [True]),
        ([optimum(converged=False), optimum()], [True, False]),
        ([optimum(violation=1.0)], [True, False] + [False] * TRIED_ALL + [True]),
    ],
    ids=["near", "not near", "no answer near"],
)
def test_a_given_start_is_near_an_optimum_then_any_start_then_one_of_many(answers, expected, monkeypatch):
    starts = script(monkeypatch, answers)
    given = lfo.simulate(PROBLEM, np.full((4, 1), 0.123))
    LocalSearch(PROBLEM, start=start_of(PROBLEM, given)).run()
    assert starts == expected


KINK = ["x_0 + 0.1*x_1", "x_1 + 0.1*u_0 - 0.1*abs(x_1)"]


@pytest.mark.parametrize("formulas", [None, KINK], ids=["one map", "a kink"])
def test_an_answer_of_modes_is_of_use_if_it_costs_less_than_the_best_local_optimum(formulas, monkeypatch):
    """Of one map, optima that repeat are what ends the search: all are of use."""
    problem, limits = PROBLEM, list[float]()
    if formulas is not None:
        kinked = lfo.PiecewiseSmoothDynamics.from_formulas(formulas, 2, 1, sampling_time=0.1)
        problem = replace(PROBLEM, dynamics=kinked)

    def answer(problem, start, sequence, end, warm, below):
        limits.append(below)
        return answers[min(len(limits), len(answers)) - 1], End.OPTIMAL

    answers = [optimum(violation=1.0), optimum(cost=3.0, converged=False), optimum(cost=4.0)]
    substitute(monkeypatch, "methods.hybrid.smooth_optimum", answer)
    search = LocalSearch(problem)
    for shift in range(4):
        search.look_near(replace(REST, x=REST.x + shift), ALONE)
    assert limits[:3] == [np.inf, np.inf, np.inf]
    assert len(limits) > 3
    expected = np.inf if formulas is None else 4.0
    assert limits[3:] == pytest.approx([expected] * len(limits[3:]), rel=1e-6)


@expensive
@pytest.mark.parametrize(("curved", "again"), [("", False), (" + 0.01*x_1**2", True)], ids=["affine", "curved"])
@pytest.mark.parametrize("ended", [End.OPTIMAL, End.DEARER, End.STALLED])
def test_a_sequence_of_affine_modes_is_decided_by_one_start(curved, again, ended, monkeypatch):
    """It is a convex problem: an optimum, and a bound above a known cost, hold whatever the start is."""
    kinked = lfo.PiecewiseSmoothDynamics.from_formulas([KINK[0], KINK[1] + curved], 2, 1, sampling_time=0.1)
    sequences = list[bytes]()

    def answer(problem, start, sequence, end, warm, below):
        sequences.append(sequence.tobytes())
        return optimum(), ended

    substitute(monkeypatch, "methods.hybrid.smooth_optimum", answer)
    LocalSearch(replace(PROBLEM, dynamics=kinked)).run()
    assert (len(set(sequences)) < len(sequences)) is (again or ended is End.STALLED)


@expensive
@pytest.mark.parametrize(("least", "ends"), [(1.0, True), (0.9, False)])
def test_an_optimum_that_costs_no_more_than_any_trajectory_ends_the_search(least, ends, monkeypatch):
    kinked = lfo.PiecewiseSmoothDynamics.from_formulas(KINK, 2, 1, sampling_time=0.1)
    starts = script(monkeypatch, [optimum()])
    search = LocalSearch(replace(PROBLEM, dynamics=kinked), least=least).run()
    assert (len(starts) == 1) is ends
    assert (search.attempts[-1].reason is Reason.PROVEN) is ends


@pytest.mark.parametrize("horizon", [8, 20])
def test_around_an_obstacle_lines_to_either_side_are_the_first_starts(horizon):
    """Bent far along its own direction, a line jumps over the disc from one time to the next: it is no start."""
    problem = mass(horizon=horizon)
    search = LocalSearch(problem)
    first, second, third = (start for start, _ in itertools.islice(search.starts(), 3))
    straight = np.linspace(-1, 1, horizon + 1)
    for line in (first, second):
        np.testing.assert_allclose(line.x[:, 0], straight)
        assert (line.x[1:-1, :2] ** 2).sum(axis=1).min() >= 0.25
    assert (np.sign(first.x[horizon // 2, 1]), np.sign(second.x[horizon // 2, 1])) == (1, -1)
    np.testing.assert_allclose(third.x[-1], lfo.simulate(problem, third.u).x[-1])  # of constant controls
    assert search.enough_starts == 2


def test_an_obstacle_that_can_only_be_jumped_over_leaves_the_straight_line():
    line = lfo.LinearDynamics([[1.0]], [[1.0]])
    problem = lfo.OptimalControlProblem(
        line, 6, lfo.QuadraticCost(R=1.0), control_set=lfo.Box(-2, 2),
        initial_state=[-1.1], terminal_state=[1.1], stage_rows=lfo.sets.PathConstraint("0.25 - x_0**2"),
    )  # fmt: skip
    start = next(LocalSearch(problem).starts())[0]
    np.testing.assert_allclose(start.x[:, 0], np.linspace(-1.1, 1.1, 7))


def test_states_of_several_controls_are_those_of_each():
    pushes = [0.5, -0.2, 0.3]
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(
        lambda t, x, u: [x[0] + 0.1 * x[1], x[1] + t.look_up(pushes) * np.sin(u[0]), 1 / x[2]], 3, 1
    )
    problem = lfo.OptimalControlProblem(dynamics, 3, lfo.QuadraticCost(), initial_state=[0.0, 1.0, 2.0])
    u = np.array([[[0.1], [0.2], [0.3]], [[-1.0], [0.0], [1.0]]])
    first = np.array([[0.0, 1.0, 2.0], [0.5, 0.0, 0.0]])
    states = states_of_controls(problem, first, u)
    np.testing.assert_allclose(states[0], lfo.simulate(problem, u[0]).x, rtol=1e-15)
    assert np.isnan(states[1, 1:]).all()  # the map is not defined there


@expensive
@pytest.mark.parametrize("constant", [0.0, 1e3, 1e6])
@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_a_constant_in_the_cost_does_not_hide_the_grid_from_the_search(constant, unit):
    """Values outside of the grid had a size of their own: with a constant, all values were that."""
    formulas = ["x_0 + x_1 + 0.5*u_0", "x_1 + u_0 - 0.0913*abs(x_1)"]
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseSmoothDynamics.from_formulas(formulas, 2, 1),
        6,
        lfo.QuadraticCost(Q=0.5 * unit, R=0.2 * unit, P=unit, x_ref=[0.6, 0.0])
        + lfo.costs.SmoothCost(stage=f"{unit}*({constant} + 0.591*(1 - cos(u_0)))"),
        control_set=lfo.Box(-1, 1),
        state_set=lfo.Box(-5, 5),
        initial_state=[1.5, 0.0],
        state_spectrum=lfo.stop_band(bins=[2], component=1),
    )
    result = lfo.solve(problem, "nonsmooth", throw=False)
    assert result.status == "locally_optimal"
    assert result.cost / unit - 6 * constant == pytest.approx(0.5471359871549387, abs=1e-8)
