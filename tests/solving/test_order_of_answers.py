"""Which of several answers is taken, when no other one is asked for, and what ``result.attempts`` says of each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp.certificate import RIGOROUS, Bound, judge
from lin_freq_ocp.methods import Candidate, solve_convex, steepest_recession, zero_multipliers
from lin_freq_ocp.results import Attempt, Reason, Status, Trajectory
from lin_freq_ocp.solving import Options, judge_candidate, solve_judged, take_best

PROBLEM = lfo.OptimalControlProblem(
    lfo.LinearDynamics([[0.9]], [[1.0]]),
    6,
    lfo.QuadraticCost(Q=1.0, R=1.0, P=1.0),
    control_set=lfo.Box(-0.5, 0.5),
    state_set=lfo.Box(-5.0, 5.0),
    initial_state=[2.0],
)
BEST = replace(solve_judged(PROBLEM, Options("convex")), attempts=())
FALLING = lfo.OptimalControlProblem(
    lfo.LinearDynamics([[1.0]], [[1.0, 0.0]]),
    3,
    lfo.QuadraticCost(r=[0.0, 1.0]),
    control_set=lfo.Box([0.0, None], [1.0, None]),
    initial_state=[0.0],
)
"""The second control moves nothing, and its cost falls for ever; the first moves the state by 3 at most."""


def moved(distance):
    """Return the optimum with states that miss the dynamics by a distance."""
    at = Trajectory(BEST.trajectory.x + distance, BEST.trajectory.u)
    judged = judge(PROBLEM, at, BEST.multipliers)
    return replace(BEST, status=Status.NUMERICAL_ERROR, trajectory=at, certificate=judged)


def infeasible(status, bound):
    """Return an outcome with the ray of an infeasible problem, of which its bound says how far it holds."""
    outcome = solve_judged(replace(PROBLEM, terminal_state=[5.0]), Options("convex"))
    return replace(outcome, attempts=(), status=status, infeasibility=replace(outcome.infeasibility, bound=bound))


def violated(outcome):
    """Return an optimum whose multipliers fail a condition."""
    wrong = replace(outcome.multipliers, eta=outcome.multipliers.eta * (1 + 1e-5))
    return replace(outcome, certificate=judge(PROBLEM, outcome.trajectory, wrong))


def without_point(status):
    return replace(BEST, status=status, trajectory=None, multipliers=None, certificate=None)


ASCENDING = {
    "no point": (without_point(Status.NUMERICAL_ERROR), Reason.FAILED),
    "far from the dynamics": (moved(0.2), Reason.FAILED),
    "near the dynamics": (moved(0.1), Reason.FAILED),
    "claim": (infeasible(Status.INFEASIBLE_CLAIMED, Bound(1.0, "numerical", multiple=1e2)), Reason.CLAIMED),
    "larger claim": (infeasible(Status.INFEASIBLE_CLAIMED, Bound(1.0, "numerical", multiple=1e3)), Reason.CLAIMED),
    "feasible": (replace(BEST, status=Status.NUMERICAL_ERROR), Reason.FEASIBLE),
    "local optimum": (replace(BEST, status=Status.LOCALLY_OPTIMAL), Reason.LOCALLY_OPTIMAL),
    "unbounded": (without_point(Status.UNBOUNDED), Reason.UNBOUNDED),
    "multipliers": (violated(BEST), Reason.MULTIPLIERS),
    "optimum": (BEST, Reason.PROVEN),
}


@pytest.mark.parametrize(("worse", "better"), list(zip(ASCENDING, list(ASCENDING)[1:], strict=False)))
def test_the_better_of_two_answers_is_taken_in_either_order(worse, better):
    answers = [replace(ASCENDING[name][0], message=name) for name in (worse, better)]
    assert take_best(answers).message == better
    assert take_best(answers[::-1]).message == better


@pytest.mark.parametrize("name", ASCENDING)
def test_attempts_name_the_reason(name):
    outcome, reason = ASCENDING[name]
    (attempt,) = take_best([replace(outcome, method="mine", message="so")]).attempts
    assert attempt == Attempt("mine", outcome.status, reason, "so")
    assert str(attempt) == f"mine: {outcome.status} ({reason.name.lower()}), so"


def test_a_proof_of_infeasibility_within_rounding_is_no_last_word():
    """Full control misses the end by 1e-7 or by 1. A point within the tolerance of the judge may answer the first."""
    missed = [replace(FALLING, cost=lfo.QuadraticCost(R=1.0), terminal_state=[3.0 + by]) for by in (1e-7, 1.0)]
    reasons = [solve_judged(problem, Options("convex")).attempt.reason for problem in missed]
    assert reasons == [Reason.NEARLY_FEASIBLE, Reason.PROVEN]


@pytest.mark.parametrize(("method", "outside"), [("convex", 1e-8), ("structured", 1e-9)])
def test_an_end_outside_its_set_is_rejected_before_a_solver_takes_it_for_rounding(method, outside):
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0.005], [0.1]]),
        50,
        lfo.QuadraticCost(R=1.0),
        control_set=lfo.Box(-5, 5),
        state_set=lfo.Box([1.0 + outside, None], None),
        initial_state=[2.0, 0.0],
        terminal_state=[1.0, 0.0],
    )
    assert lfo.solve(problem, method=method, throw=False).status == "infeasible"


def test_the_later_one_of_equals_is_taken():
    answers = [replace(BEST, status=Status.LOCALLY_OPTIMAL, message=text) for text in ("first", "later")]
    assert take_best(answers).message == "later"


@pytest.mark.parametrize("last", ["optimum", "local optimum", "limit", "interrupted"])
def test_no_answer_is_asked_for_after_the_last_one(last):
    limit = without_point(Status.LIMIT)
    given = {"limit": limit, "interrupted": replace(moved(0.1), interrupted=True)}

    def answers():
        yield moved(0.2)
        yield given[last] if last in given else ASCENDING[last][0]
        pytest.fail("asked for another answer")

    best = take_best(answers(), enough=(Reason.LOCALLY_OPTIMAL,))
    assert len(best.attempts) == 2
    assert best.interrupted == (last == "interrupted")
    assert best.primal == ("optimum" in last)


def test_methods_that_do_not_take_a_problem_are_named_and_without_any_the_last_says_why():
    refused = [Attempt(name, None, Reason.REFUSED, f"{name}: no.") for name in ("one", "other", "one")]
    best = take_best([*refused, BEST])
    assert [str(attempt) for attempt in best.attempts[1:]] == [
        "other: refused, other: no.",
        "one: refused, one: no.",
        "convex: optimal (proven)",
    ]
    with pytest.raises(lfo.errors.UnsupportedError, match=r"^other: no\. Before that: one: no\.$"):
        take_best(refused)


def test_attempts_of_auto_say_why_the_next_method_follows():
    varying = replace(
        PROBLEM, dynamics=lfo.LinearDynamics(np.full((6, 1, 1), 0.9), np.linspace(1, 2, 6)[:, None, None])
    )
    spectral, convex = lfo.solve(varying).attempts
    assert (spectral.method, spectral.status, spectral.reason) == ("spectral", None, Reason.REFUSED)
    assert (convex.method, convex.status, convex.reason) == ("convex", "optimal", Reason.PROVEN)


def test_auto_asks_the_next_method_where_no_bound_proves_an_answer(monkeypatch):
    """The judge confirms of the convex method no more than local optimality; the structured method follows."""

    def distrust(problem, candidate, method, *options):
        outcome = judge_candidate(problem, candidate, method, *options)
        return replace(outcome, status=Status.LOCALLY_OPTIMAL) if method == "convex" else outcome

    substitute(monkeypatch, "solving.judge_candidate", distrust)
    result = lfo.solve(replace(PROBLEM, terminal_state=lfo.sets.Ball(0.3, [0.1])))
    assert result.status == "optimal"
    assert [one.reason for one in result.attempts][-2:] == [Reason.LOCALLY_OPTIMAL, Reason.PROVEN]


def test_an_interrupted_solve_returns_the_best_answer_with_its_verdict(monkeypatch):
    """A solver may call a point solved that the judge refutes; Ctrl-C while others are tried does not confirm it."""
    right = solve_convex(PROBLEM, "clarabel")
    wrong = replace(
        right, multipliers=replace(right.multipliers, eta=-right.multipliers.eta), trajectory=moved(0.1).trajectory
    )
    claimed = [wrong, replace(wrong, interrupted=True)]
    substitute(monkeypatch, "methods.convex_candidates", lambda *given: iter(claimed))
    substitute(monkeypatch, "methods.corrections", lambda *given: iter(()))
    result = lfo.solve(PROBLEM, method="convex", throw=False)
    assert result.interrupted
    assert result.status == "numerical_error"


def stop(problem, options):
    """Return a point where a solver stopped, far along a direction of descent, and outside of the constraints."""
    far = Trajectory(np.full((4, 1), 9.0), np.full((3, 2), -1e6))
    return Candidate(Status.NUMERICAL_ERROR, far, zero_multipliers(problem, 1.0), message="stalled")


def test_infeasibility_comes_before_a_direction_of_descent(monkeypatch):
    substitute(monkeypatch, "solving.solve_spectral", stop)
    assert lfo.solve(FALLING, method="spectral", throw=False).status == "unbounded"
    contradiction = lfo.solve(replace(FALLING, terminal_state=[4.0]), method="spectral", throw=False)
    assert contradiction.status == "infeasible"
    assert contradiction.bound == RIGOROUS


def test_a_point_far_along_a_direction_is_no_local_optimum(monkeypatch):
    """Relative to its size, such a point may satisfy every condition."""

    def confirm(problem, candidate, *options):
        outcome = judge_candidate(problem, candidate, *options)
        return replace(outcome, status=Status.LOCALLY_OPTIMAL) if candidate.message == "stalled" else outcome

    substitute(monkeypatch, "solving.solve_spectral", stop)
    substitute(monkeypatch, "solving.judge_candidate", confirm)
    assert lfo.solve(FALLING, method="spectral", throw=False).status == "unbounded"


def test_a_direction_whose_program_is_too_large_is_not_looked_for(monkeypatch):
    def refuse(problem):
        raise lfo.errors.UnsupportedError("too large")

    substitute(monkeypatch, "solving.solve_spectral", stop)
    substitute(monkeypatch, "methods.steepest_recession", refuse)
    assert lfo.solve(FALLING, method="spectral", throw=False).status == "numerical_error"


def test_a_direction_is_looked_for_once_for_all_candidates(monkeypatch):
    searches, claimed = [], solve_convex(PROBLEM, "clarabel")

    def count(problem):
        searches.append(problem)
        return steepest_recession(problem)

    def refute(problem, candidate, *options):
        return replace(judge_candidate(problem, candidate, *options), status=Status.NUMERICAL_ERROR)

    substitute(monkeypatch, "methods.convex_candidates", lambda *given: iter([claimed] * 3))
    substitute(monkeypatch, "methods.steepest_recession", count)
    substitute(monkeypatch, "solving.judge_candidate", refute)
    attempts = lfo.solve(PROBLEM, method="convex", throw=False).attempts
    assert [one.reason for one in attempts] == [Reason.FEASIBLE] * 3
    assert len(searches) == 1


NEARLY = replace(FALLING, cost=lfo.QuadraticCost(R=1.0), terminal_state=[3.0 + 1e-7])


@expensive
@pytest.mark.parametrize(
    ("problem", "reason"),
    [(PROBLEM, Reason.LOCALLY_OPTIMAL), (NEARLY, Reason.NEARLY_FEASIBLE)],
    ids=["local optimum", "nearly feasible"],
)
def test_other_units_do_not_follow_an_answer_of_the_sparse_program_but_the_next_method_does(
    problem, reason, monkeypatch
):
    def doubt(problem, candidate, *options):
        outcome = judge_candidate(problem, candidate, *options)
        return replace(outcome, status=Status.LOCALLY_OPTIMAL) if outcome.status == "optimal" else outcome

    substitute(monkeypatch, "solving.judge_candidate", doubt)
    for method, last in (("convex", ["convex"]), ("auto", ["convex", "structured"])):
        attempts = lfo.solve(problem, method=method, throw=False).attempts
        assert [one.method for one in attempts if one.method in last and one.reason == reason] == last
        assert attempts[-1].method == last[-1]


def test_a_direction_of_descent_ends_auto_where_a_trajectory_is_known(monkeypatch):
    def forget(problem, *options):
        found = solve_convex(problem, *options)
        return replace(found, status=Status.LIMIT, trajectory=None) if found.status == "optimal" else found

    known = lfo.solve(FALLING, throw=False).attempts
    substitute(monkeypatch, "methods.solve_convex", forget)
    unknown = lfo.solve(FALLING, throw=False).attempts
    for attempts, reason, methods in (known, Reason.PROVEN, 1), (unknown, Reason.UNBOUNDED, 2):
        assert [(one.status, one.reason) for one in attempts if one.status] == [("unbounded", reason)] * methods


def test_the_answer_of_a_warm_start_counts_only_if_it_is_proven(monkeypatch):
    """The method itself may prove what pivoting from a trajectory nearby does not."""
    guess = replace(solve_convex(PROBLEM, "clarabel"), message="guess")

    def doubt(problem, candidate, *options):
        outcome = judge_candidate(problem, candidate, *options)
        return replace(outcome, status=Status.LOCALLY_OPTIMAL) if candidate.message == "guess" else outcome

    substitute(monkeypatch, "methods.structured.solve_from_warm_start", lambda *given: guess)
    substitute(monkeypatch, "solving.judge_candidate", doubt)
    result = lfo.solve(PROBLEM, method="structured")
    assert [attempt.status for attempt in result.attempts] == ["locally_optimal", "optimal"]
    assert result.status == "optimal"


def test_the_trajectory_at_rest_is_tried_where_nothing_else_is_proven(monkeypatch):
    """A solver comes to the root of its tolerance from an optimum that costs nothing."""
    resting = replace(PROBLEM, initial_state=None, cost=lfo.QuadraticCost(R=1.0, P=0.0))
    near = Trajectory(np.zeros((7, 1)), np.full((6, 1), 1e-5))
    zero = solve_convex(resting, "clarabel").multipliers
    substitute(monkeypatch, "methods.corrections", lambda *given: iter(()))
    outcome = judge_candidate(resting, Candidate(Status.OPTIMAL, near, zero), "mine", None, None)
    assert (outcome.status, outcome.cost) == ("optimal", 0.0)
