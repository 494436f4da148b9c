"""A seeded sample of scripts/verify.py."""

import pytest
import verify
import verify_explain
import verify_mixed


@pytest.mark.parametrize("seed", range(16))
def test_a_random_problem_is_solved_and_proven(seed):
    outcome = verify.check(seed)
    assert outcome.passed, outcome


def test_the_sample_has_every_kind_and_both_endings():
    assert {verify.random_problem(seed)[0] for seed in range(16)} == {"stable", "marginal", "unstable", "time-varying"}
    assert verify.check(10).status == "infeasible"


@pytest.mark.parametrize("seed", range(6))
def test_an_infeasible_problem_is_explained(seed):
    outcome = verify_explain.check(seed)
    assert outcome.passed, outcome
    assert outcome.family


@pytest.mark.parametrize("seed", range(20))
def test_a_problem_of_mixed_features_is_solved_like_by_cvxpy_and_the_judge_refuses_what_is_spoiled(seed):
    outcome = verify_mixed.check(seed)
    assert outcome.passed, outcome


def test_the_sample_of_mixed_features_has_most_of_them_and_spoils_something():
    outcomes = [verify_mixed.check(seed) for seed in range(6)]
    assert len({one for seed in range(20) for one in verify_mixed.random_model(seed).features}) >= 17
    assert sum(len(outcome.tried) for outcome in outcomes) >= 6
