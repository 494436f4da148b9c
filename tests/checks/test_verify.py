"""A seeded sample of scripts/verify.py."""

from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.checks import alone, convex, explain, flips, frequencies, mixed, modes, rays, sequences, smooth, structured
from helpers.random.convex import random_problem
from helpers.random.mixed import random_model
from helpers.seeds import expensive, seeds, whole_sample
from lin_freq_ocp.certificate.hybrid import Flip


@pytest.mark.parametrize("seed", seeds(range(16)))
def test_a_random_problem_is_solved_and_proven(seed):
    outcome = convex.check(seed)
    assert outcome.passed, outcome


@expensive
def test_the_sample_has_every_kind_and_both_endings():
    assert {random_problem(seed)[0] for seed in range(16)} == {"stable", "marginal", "unstable", "time-varying"}
    assert convex.check(10).status == "infeasible"


check_structured = cache(structured.check)


@pytest.mark.parametrize("seed", seeds(range(9)))
def test_a_proven_optimum_is_certified_by_its_trajectory_alone(seed):
    assert alone.check(seed).passed, alone.check(seed)


@pytest.mark.parametrize("seed", seeds(range(15)))
def test_the_structured_method_answers_like_the_others(seed):
    assert check_structured(seed).passed, check_structured(seed)


@whole_sample
def test_the_sample_has_answers_of_every_method_and_a_verified_ray():
    outcomes = [check_structured(seed) for seed in range(15)]
    assert {structured.kind_of(one.seed) for one in outcomes} == set(structured.KINDS)
    for method in structured.METHODS:
        assert sum(one.verdicts.get(method) == structured.Verdict.AGREES for one in outcomes) >= 5
    assert any(one.answers and one.answers["structured"].status == "infeasible" for one in outcomes)


def test_wrong_answers_of_a_method_are_found_out():
    Answer, Verdict = structured.Answer, structured.Verdict
    right, near = Answer("optimal", "", 1.0, 1.0, 1e-10), Answer("optimal", "", 1.0 + 1e-7, 1.0, 1e-7)
    wrong = {
        near: Verdict.LESS_ACCURATE,
        Answer("numerical_error", ""): Verdict.NONE,
        Answer("infeasible", ""): Verdict.CONTRADICTS,
        Answer("infeasible", "", verified=False): Verdict.UNVERIFIED,
    }
    for answer, verdict in wrong.items():
        outcome = structured.compared(0, {"structured": right, "plain": answer})
        assert outcome.verdicts["plain"] == verdict
        assert not outcome.passed
    local = Answer("locally_optimal", "", 1.0, 1.0)
    assert structured.compared(0, {"structured": right, "plain": local}).verdicts["plain"] == Verdict.LOCAL


@expensive
@pytest.mark.parametrize("seed", range(3))
def test_an_infeasible_problem_is_explained(seed):
    outcome = explain.check(seed)
    assert outcome.passed, outcome
    assert outcome.family


@expensive
@pytest.mark.parametrize("seed", [2, 7, 12, 15])
def test_infeasible_and_unbounded_are_proven_or_not_said(seed):
    assert rays.check(seed).passed, rays.check(seed)


def test_the_exact_cost_of_a_compact_problem_is_that_of_its_best_controls():
    problem = rays.compact_problem(4)
    (A, B, _), end = problem.linear.at(0), problem.terminal_box.lower
    rng, q = np.random.default_rng(0), problem.quadratic.q.ravel()

    def cost(u):
        states = [end]
        for value in u[::-1]:
            states.append(np.linalg.solve(A, states[-1] - B[:, 0] * value))
        return float(sum(q @ x for x in states[1:]))

    middle = cost(np.zeros(problem.horizon))
    slopes = [cost(row) - middle for row in np.eye(problem.horizon)]
    exact = float(rays.exact_cost(problem))
    assert exact == pytest.approx(middle - 0.5 * np.abs(slopes).sum(), rel=1e-9)
    assert all(cost(u) >= exact for u in rng.choice([-0.5, 0.5], (20, problem.horizon)))


check_mixed = cache(mixed.check)


@pytest.mark.parametrize("seed", seeds(range(6)))
def test_a_problem_of_mixed_features_is_solved_like_by_cvxpy_and_the_judge_refuses_what_is_spoiled(seed):
    assert check_mixed(seed).passed, check_mixed(seed)


@whole_sample
def test_the_sample_of_mixed_features_has_most_of_them():
    assert len({one for seed in range(20) for one in random_model(seed).features}) >= 17


@whole_sample
def test_the_sample_of_mixed_features_spoils_something():
    assert sum(len(check_mixed(seed).tried) for seed in range(6)) >= 6


check_flips = cache(flips.check)


@pytest.mark.parametrize("seed", seeds(range(8)))
def test_flips_at_borders_improve_where_the_judge_says_so_and_nowhere_else(seed):
    assert check_flips(seed).passed, check_flips(seed)


@whole_sample
def test_the_sample_of_flips_has_every_outcome():
    counts = sum((check_flips(seed).counts for seed in range(8)), start=Counter())
    assert min(counts[what] for what in ("flip", "stay", "inside", "flip-stationary")) >= 1
    assert counts["flip"] >= 5


def test_a_judge_that_knows_no_flips_or_too_many_is_found_out(monkeypatch):
    honest, what = flips.judge, {}

    def spoiled(problem, trajectory, multipliers):
        certificate = honest(problem, trajectory, multipliers)
        meeting = problem.dynamics.arrays(problem.horizon).active_modes(trajectory.x, trajectory.u)
        every = [Flip(int(t), int(j), 1.0) for t, j in np.argwhere(meeting)] if what["all"] else []
        return replace(certificate, borders=replace(certificate.borders, flips=tuple(every)))

    monkeypatch.setattr(flips, "judge", spoiled)
    monkeypatch.setattr(flips, "followed", lambda *given: ())
    for every, words in ((False, "that would gain"), (True, "that gains")):
        what["all"] = every
        assert any(words in one for seed in range(8) for one in flips.check(seed).wrong)


@pytest.mark.parametrize(
    "name", seeds(["rotation, T = 6, freq", "pendulum, T = 6", "network, T = 4, freq"], always=["buck, T = 6"])
)
def test_four_methods_find_the_same_mode_sequences(name):
    outcome = modes.check(name)
    assert outcome.passed, outcome


def test_methods_that_disagree_or_prove_nothing_are_found_out(monkeypatch):
    system, arguments, known = modes.INSTANCES["buck, T = 6"]
    monkeypatch.setitem(modes.INSTANCES, "buck, T = 6", (system, arguments, known * (1 + 2e-6)))
    assert not modes.check("buck, T = 6").passed


WRONG_ONCE = 70002, 70005, 70007, 70021, 70057, 70100
"""Feasible trajectories were missed, and sequences without one were called the best."""


@expensive
@pytest.mark.parametrize("seed", WRONG_ONCE)
def test_small_random_problems_have_the_optimum_of_all_mode_sequences(seed):
    outcome = sequences.check(seed)
    assert outcome.passed, outcome


@expensive
def test_an_optimum_of_sequences_that_is_missed_or_refuted_is_found_out(monkeypatch):
    honest = cache(sequences.enumerated)
    for change, words in ((-0.1, "called optimal, above"), (0.1, "below"), (np.inf, "not infeasible")):
        monkeypatch.setattr(sequences, "enumerated", lambda problem, change=change: (honest(problem)[0] + change, None))
        assert any(words in one for one in sequences.check(70021).wrong)


@expensive
@pytest.mark.parametrize("seed", [0, 1, 2, 3, 4, 7, 17])
def test_a_mask_at_every_frequency_is_between_the_bounds_of_grids(seed):
    found = frequencies.check(seed)
    assert found.passed, found
    assert found.kind == frequencies.KINDS[seed % len(frequencies.KINDS)]


def test_findings_outside_the_bounds_fail():
    right = frequencies.Findings(0, "notch", "optimal", 1.0, 0.9999, 1.0001, 1e-9, "optimal")
    assert right.passed
    for wrong in ({"cost": 0.999}, {"cost": 1.001}, {"excess": 1e-6}, {"status": "infeasible"}, {"excess": np.nan}):
        assert not replace(right, **wrong).passed


@pytest.mark.parametrize("seed", [2, 3])
def test_the_proven_maximum_of_a_signal_is_attained(seed):
    below, above = frequencies.peak_errors(seed)
    assert below == 0
    assert above < 2e-9  # the frequency is the first of equal ones to 1e-9


@pytest.mark.parametrize("seed", seeds(range(12)))
def test_a_random_smooth_problem_is_answered_and_no_saddle_is_called_a_minimum(seed):
    pytest.importorskip("casadi")
    outcome = smooth.check(seed)
    assert outcome.verdict == "right", outcome
    assert not outcome.worse, outcome


def test_wrong_words_for_smooth_answers_are_found_out():
    claim = ("Solve_Succeeded", 1.0)
    verdicts = {
        ("locally_optimal", 1.0, 0.1): "right",
        ("locally_optimal", 1.0, -0.1): "a saddle is called a minimum",
        ("extremal", 1.0, 0.1): "a minimum is called a saddle",
        ("extremal", 1.0, -0.1): "right",
        ("numerical_error", np.inf, np.nan): "no answer",
    }
    for (status, cost, eigenvalue), verdict in verdicts.items():
        outcome = smooth.Outcome(0, "wells", status, cost, *claim, eigenvalue)
        assert outcome.verdict == verdict
        assert outcome.worse == (cost == np.inf)


def test_eigenvalues_of_the_dense_hessian_know_a_saddle():
    pytest.importorskip("casadi")
    problem = smooth.random_problem(9)
    rest = lfo.simulate(problem, np.zeros((problem.horizon, problem.control_dim)))
    assert smooth.least_eigenvalue(problem, rest) < -0.1
