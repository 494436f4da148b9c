"""Answers of a reduced problem, recovered, are judged on the given one: one test for all reductions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.instances import classes_of
from helpers.reductions import INFEASIBLE, REDUCTIONS, UNBOUNDED, Entry, random_problem
from helpers.seeds import expensive, seeds
from lin_freq_ocp.methods import Candidate
from lin_freq_ocp.results import Status
from lin_freq_ocp.solving import candidate_of, judge_candidate, solve_judged
from lin_freq_ocp.transform import Reduced, reduce_problem

CASES = [(name, case) for name, entry in REDUCTIONS.items() for case in entry.problems]


def recovered(entry: Entry, reduced: Reduced) -> lfo.results.Outcome:
    """Solve the reduced problem, and judge what is recovered on the given one."""
    given = entry.stated(reduced.given)
    candidate = reduced.recover(candidate_of(solve_judged(reduced.problem)))
    if candidate.trajectory is not None and given is reduced.given:
        given, at = reduced.judged_at(candidate.trajectory)
        candidate = replace(candidate, trajectory=at)

    def shaped(found):
        """Return multipliers in the shapes of the terms that state them."""
        terms = [term for term in given.terms if term.name in found.stage and term.semi_infinite is None]
        return replace(
            found, stage={**found.stage, **{one.name: found.stage[one.name].reshape(one.shape) for one in terms}}
        )

    ray, multipliers = candidate.ray and shaped(candidate.ray), candidate.multipliers and shaped(candidate.multipliers)
    return judge_candidate(given, replace(candidate, ray=ray, multipliers=multipliers), "", None, None)


@pytest.mark.parametrize(("name", "case"), seeds(CASES), ids=str)
def test_recovered_answers_satisfy_the_judge_on_the_given_problem(name, case):
    entry = REDUCTIONS[name]
    given = entry.problems[case]()
    reduced = entry.reduction(given)
    assert reduced.given is given
    outcome = recovered(entry, reduced)
    if INFEASIBLE in case:
        assert outcome.status == ("infeasible" if outcome.bound == "rigorous" else "infeasible_claimed")
        assert outcome.ray is not None
    elif UNBOUNDED in case:
        assert outcome.status == "unbounded"
        assert outcome.direction is not None
    else:
        assert not outcome.certificate.failed
        assert outcome.cost == pytest.approx(lfo.solve(entry.stated(given)).cost, rel=1e-7, abs=1e-9)
        if not given.mode_names:  # whose bound is that of a search
            assert outcome.status == "optimal"
            assert outcome.certificate.pmp == "satisfied"
            assert outcome.certificate.globally_optimal


@expensive
def test_every_way_back_of_the_package_has_its_cases():
    assert all(entry.problems for entry in REDUCTIONS.values())
    tested = {type(entry.reduction(next(iter(entry.problems.values()))())) for entry in REDUCTIONS.values()}
    assert tested == classes_of(Reduced)


def test_a_problem_without_what_is_reduced_stays_as_it_is():
    given, candidate = random_problem(0), Candidate(Status.OPTIMAL)
    for name in ("soft bins", "joint rows", "soft sets", "absorbed cost", "far origin", "few samples between levels"):
        reduced = reduce_problem(given, (REDUCTIONS[name].reduction,))
        assert reduced.problem is given, name
        assert reduced.recover(candidate) == candidate, name


def test_a_chain_applies_from_left_to_right_and_recovers_from_right_to_left():
    calls = []

    class Step(Reduced):
        def __init__(self, problem, number):
            super().__init__(problem, replace(problem, name=problem.name + str(number)))
            object.__setattr__(self, "number", number)

        def trajectory(self, reduced):
            calls.append(self.number)
            return lfo.Trajectory(10 * reduced.x + self.number, reduced.u)

    def step(number):
        return lambda problem: Step(problem, number)

    chain = reduce_problem(random_problem(0), (step(1), lambda problem: None, step(2)))
    assert chain.problem.name.endswith("12")
    assert len(chain.links) == 2
    point = lfo.Trajectory(np.zeros((17, 2)), np.zeros((16, 1)))
    assert chain.recover(Candidate(Status.OPTIMAL, point)).trajectory.x[0, 0] == 21
    assert calls == [2, 1]
