"""Linear problems in any units, bounds that stand for none, ends outside the state set, and loose tolerances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.checks import linear
from helpers.clocks import Clock
from helpers.random.linear import random_linear
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from helpers.sweeps import SHORT
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.methods import SolveOptions, convex_candidates, solve_convex, zero_rounding
from lin_freq_ocp.results import Status

BRAKING = lfo.OptimalControlProblem(
    lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0.005], [0.1]], sampling_time=0.1),
    50,
    lfo.QuadraticCost(R=1.0),
    control_set=lfo.Box(-5, 5),
    initial_state=[0, 0],
    terminal_state=[1, 0],
    control_spectrum=lfo.low_pass(cutoff_hz=2.0),
)
LOWEST = 0.5050507855147837
"""Its optimum, by Clarabel on a program written elsewhere, with the bounds +-5 and without any."""


WRONG_ONCE = 130, 368, 282, 723


@pytest.mark.parametrize("seed", seeds(range(20), WRONG_ONCE))
def test_random_problems_in_any_units_cost_what_plain_clarabel_says(seed):
    outcome = linear.check(seed)
    assert not outcome.unanswered, outcome
    assert not outcome.wrong, outcome


@expensive
@pytest.mark.parametrize("seed", [409, 1139, 2212, 2275, 2348, 2858, 3175, 3757, 4045, 4366, 4575])
def test_problems_that_need_a_further_answer(seed):
    """Zeros that were rounding, bounds far away that alone bound the cost, points without a slope."""
    outcome = linear.check(seed)
    assert outcome.theirs == "Solved"
    assert not outcome.unanswered, outcome
    assert not outcome.wrong, outcome


@pytest.mark.parametrize("method", ["spectral", "convex"])
def test_a_feasible_problem_with_a_numerical_ray_is_solved(method):
    """Its first attempt as a sparse program ends with a ray; two controls differ far in what they cost."""
    assert lfo.solve(random_linear(3632).problem, method).status == "optimal"


def test_rounding_becomes_zero_in_its_units():
    values, units = np.array([1e-15, -1e-3, 0.0, 2e-9]), np.array([1.0, 1e-3, 1.0, 1e4])
    np.testing.assert_array_equal(zero_rounding(values, units, 1e-12), [0.0, -1e-3, 0.0, 0.0])


def test_further_answers_end_with_the_time_limit():
    candidates = convex_candidates(BRAKING, "clarabel", SolveOptions(time_limit=1e-6))
    assert next(candidates).status == "limit"
    assert list(candidates) == []


def test_further_answers_to_a_solved_problem_are_the_same_optimum():
    first, *others = convex_candidates(BRAKING, "clarabel")
    assert first.status == "optimal"
    assert others
    for one in others:
        assert BRAKING.value(one.trajectory.x, one.trajectory.u) == pytest.approx(LOWEST, rel=1e-6)


def test_the_first_answer_that_is_proven_counts_and_no_more_are_asked_for(monkeypatch):
    """One without multipliers is not; a result of Ctrl-C says so."""
    exact = solve_convex(BRAKING, "clarabel")
    wrong = replace(exact, multipliers=None, status=Status.NUMERICAL_ERROR)
    asked = []

    def given(*candidates):
        def all_of_them(*_):
            for one in candidates:
                asked.append(one)
                yield one

        return all_of_them

    substitute(monkeypatch, "methods.convex_candidates", given(wrong, wrong, exact, wrong))
    assert lfo.solve(BRAKING, method="convex").status == "optimal"
    assert len(asked) == 3
    substitute(monkeypatch, "methods.convex_candidates", given(wrong, replace(wrong, interrupted=True), exact))
    assert lfo.solve(BRAKING, method="convex", throw=False).interrupted


@pytest.mark.parametrize("method", ["auto", "convex"])
@pytest.mark.parametrize("bound", [1e6, 1e9, 1e11, 1e20, 1e30, np.inf])
def test_a_bound_that_stands_for_none_changes_nothing(bound, method):
    """+-5 but ``bound`` at the last sample: scales that come from it made errors of 0.15 m/s look like rounding."""
    upper = np.full((50, 1), 5.0)
    upper[-1] = bound
    result = lfo.solve(replace(BRAKING, control_set=lfo.Box(-upper, upper)), method=method, throw=False)
    assert result.trajectory is not None
    assert result.cost == pytest.approx(LOWEST, rel=1e-7)
    A, B = np.array([[1, 0.1], [0, 1]]), np.array([[0.005], [0.1]])
    x, u = result.trajectory.x, result.trajectory.u
    np.testing.assert_allclose(x[1:], x[:-1] @ A.T + u @ B.T, atol=1e-8)
    np.testing.assert_allclose(x[[0, -1]], [[0, 0], [1, 0]], atol=1e-8)


def test_bounds_of_1e20_and_more_are_none():
    box = lfo.Box([-1e20, -1.0, -2e25], [3.0, 1e21, np.inf])
    np.testing.assert_array_equal(box.lower, [-np.inf, -1.0, -np.inf])
    np.testing.assert_array_equal(box.upper, [3.0, np.inf, np.inf])
    np.testing.assert_array_equal(lfo.Box([3e21], [3e21]).lower, [3e21])  # a point, however small the unit
    assert lfo.StageRows([[1.0]], None, [1e20]).e[0] == np.inf
    assert lfo.sets.Polyhedron([[1.0]], [1e20]).g[0] == np.inf
    with pytest.raises(lfo.errors.ProblemError, match=r"Box\.lower"):
        lfo.Box([1e20], [2e20])


@expensive
@pytest.mark.parametrize(
    ("changed", "family", "moved"),
    [
        ({"state_set": lfo.Box([-1, None], [2, None]), "initial_state": [-1.001, 0]}, {"initial state"}, "t = 0"),
        ({"state_set": lfo.Box(None, [0.999, None])}, {"terminal state"}, "t = 50"),
    ],
)
def test_an_end_outside_the_state_set_is_an_infeasible_problem_with_cures(changed, family, moved):
    problem = replace(BRAKING, **changed)
    with pytest.raises(lfo.errors.InfeasibleError) as caught, use_clock(Clock()):  # the explanation looks often
        lfo.solve(problem)
    result = caught.value.result
    assert result.status == "infeasible"
    assert "rigorous" in result.message
    assert any(moved in str(one) for one in result.conflict)
    cures = {cure.block: cure.amount for cure in result.explanation.cures}
    assert set(result.explanation.family) == family | {"state bound on x_0"}
    assert cures["state bound on x_0"] == pytest.approx(1e-3, rel=1e-2)
    assert family <= set(cures)


@pytest.mark.parametrize("outside", [lfo.sets.Ball(1.0, [0, 0]), lfo.sets.Polyhedron([[1, 1]], [1.0])])
def test_a_point_outside_a_set_that_is_no_box_is_infeasible_too(outside):
    """The initial state is 1e-3 outside; the terminal one, which is free here, could be inside."""
    result = lfo.solve(replace(BRAKING, state_set=outside, initial_state=[1.001, 0], terminal_state=None), throw=False)
    assert result.status == "infeasible"
    assert "rigorous" in result.message


def test_a_measured_state_may_be_outside_by_rounding():
    at_bound = replace(BRAKING, state_set=lfo.Box([-0.3, None], None), initial_state=[-(0.1 + 0.2), 0])
    assert at_bound.initial_box.lower[0] < -0.3
    assert lfo.solve(at_bound, throw=False).status == "optimal"


def test_with_ends_moves_an_end_out_of_the_state_set_and_back():
    problem = replace(BRAKING, state_set=lfo.Box([-1, None], [2, None]))
    outside = problem.with_ends(initial_state=[-1.5, 0])
    assert lfo.solve(outside, throw=False).status == "infeasible"
    again = outside.with_ends(initial_state=[0, 0])
    assert again.terms == ()
    assert lfo.solve(again).cost == pytest.approx(LOWEST, rel=1e-7)


@pytest.mark.parametrize("method", ["auto", "convex"])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6, 1e-9])
def test_a_looser_tolerance_never_makes_a_worse_status(tolerance, method):
    problem = SHORT()
    strict = lfo.solve(problem, method=method)
    result = lfo.solve(problem, method=method, tolerance=tolerance, throw=False)
    assert result.status == "optimal"
    assert result.cost == pytest.approx(strict.cost, rel=10 * tolerance)


def test_a_free_start_whose_best_place_is_far_away():
    """x_T = -0.9 costs least, and needs no control from -0.9 * 2^31 on."""
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.5]], [[1.0]]),
        31,
        lfo.QuadraticCost(R=1.0, p=[1.0]),
        control_set=lfo.Box(-1, 1),
        terminal_state=lfo.Box(-0.9, -0.7),
    )
    candidate = solve_convex(problem, "clarabel")
    assert candidate.status == "optimal"
    assert problem.value(candidate.trajectory.x, candidate.trajectory.u) == pytest.approx(-0.9, rel=1e-7)
    assert candidate.trajectory.x[0, 0] == pytest.approx(-0.9 * 2**31, rel=1e-3)


@expensive
def test_unbounded_needs_a_verified_direction(monkeypatch):
    free = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[1.0]]), 3, lfo.QuadraticCost(r=[1.0]), initial_state=[0.0]
    )
    assert lfo.solve(free, method="convex", throw=False).status == "unbounded"
    substitute(monkeypatch, "certificate.unbounded_direction", lambda *given: None)
    refused = lfo.solve(free, method="convex", throw=False)
    assert refused.status == "numerical_error"
    assert not refused.dual


def test_multipliers_that_fail_at_a_proven_optimum_are_looked_for_again(monkeypatch):
    """A bound loses the square of what multipliers are wrong by: it proves the optimum, and conditions fail."""
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.9]], [[1.0]]),
        6,
        lfo.QuadraticCost(Q=1.0, R=1.0, P=1.0),
        control_set=lfo.Box(-0.5, 0.5),
        state_set=lfo.Box(-5.0, 5.0),
        initial_state=[2.0],
    )
    right = next(convex_candidates(problem, "clarabel", SolveOptions(), None))
    wrong = replace(right, multipliers=replace(right.multipliers, eta=right.multipliers.eta * (1 + 1e-5)))
    outcomes = []
    for candidates in ([wrong], [wrong, right]):
        substitute(monkeypatch, "methods.convex_candidates", lambda *given, each=candidates: iter(each))
        result = lfo.solve(problem, method="convex")
        outcomes.append((result.status, result.certificate.pmp))
    assert outcomes == [("optimal", "violated"), ("optimal", "satisfied")]


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("method", ["auto", "structured", "convex"])
def test_a_problem_without_a_cost_has_no_multipliers(method, unit):
    """An interior-point method leaves some of 1e-43, whose conditions fail relative to themselves."""
    plant = lfo.LinearDynamics([[1.0, 0.2], [0.0, 0.9]], [[0.0], [0.2 * unit]])
    ends = {"initial_state": [1.0, 0.0], "terminal_state": [0.0, 0.0]}
    result = lfo.solve(
        lfo.OptimalControlProblem(plant, 20, lfo.QuadraticCost(), lfo.Box(-1 / unit, 1 / unit), **ends), method
    )
    assert (result.status, result.certificate.pmp) == ("optimal", "satisfied")
    assert not result.multipliers.eta.any()


@pytest.mark.parametrize("method", ["auto", "structured", "convex", "spectral"])
def test_rest_is_found_where_the_initial_state_is_free_and_costs_in_part(method):
    """The other component of x_0 is 1e-15 after a solve, and so is what it causes: rest needs a zero."""
    A, B = [[0.5, 0.3], [-0.2, 0.4]], [[0.7, -0.4], [0.3, 0.9]]
    cost = lfo.QuadraticCost(Q=np.diag([0.4, 0.0]), R=np.diag([0.1, 0.3]))
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics(A, B), 4, cost, lfo.Box(-1, 1.5), lfo.Box(-3, 3))
    result = lfo.solve(problem, method, throw=False)
    assert (result.status, result.cost) == ("optimal", 0.0)
