"""A seeded sample of scripts/verify.py."""

import pytest
import verify
import verify_explain


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
