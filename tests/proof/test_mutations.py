"""Proofs with one number changed, and proofs of random problems: a seeded sample of scripts/verify/proofs.py."""

from functools import cache

import numpy as np
import pytest
from flint import arb

from helpers import hand_proofs
from helpers.checks import proofs
from helpers.mutations import mutations, sample
from helpers.seeds import expensive, seeds, whole_sample

EACH = 3  # mutations of each section
SEEDS = 1, 2, 3, 4, 5, 6, 8, 10, 11, 12
proof_of_kind = cache(lambda kind: proofs.KINDS[kind]())
check_random = cache(proofs.check_random)


@pytest.mark.parametrize("kind", seeds(proofs.KINDS))
def test_a_mutation_is_rejected_or_what_is_printed_still_holds(kind, tmp_path):
    proof = proof_of_kind(kind)
    truth, first_hash = proofs.truth_of(kind, proof, tmp_path)
    found = sample(proof.splitlines(keepends=True), EACH, seed=len(proof))
    assert len({mutation.section for mutation in found}) >= 5
    for mutation in found:
        assert not proofs.wrong_of(mutation, truth, first_hash, tmp_path), mutation


@expensive
def test_every_mutation_of_a_dual_by_hand(tmp_path):
    proof = proof_of_kind("by hand")
    truth, first_hash = proofs.truth_of("by hand", proof, tmp_path)
    of_dual = [one for one in mutations(proof.splitlines(keepends=True)) if one.section == "dual"]
    assert len(of_dual) > 80
    assert not [str(one) for one in of_dual if proofs.wrong_of(one, truth, first_hash, tmp_path)]


@expensive
def test_a_checker_that_charges_nothing_is_found_out(tmp_path, monkeypatch):
    proof = proof_of_kind("by hand")
    truth, first_hash = proofs.truth_of("by hand", proof, tmp_path)
    monkeypatch.setattr(hand_proofs.checker(), "charge", lambda *given: arb(0))
    wrong = (proofs.wrong_of(one, truth, first_hash, tmp_path) for one in mutations(proof.splitlines(keepends=True)))
    assert any("but the optimum" in words for words in wrong)


@pytest.mark.parametrize("seed", seeds(SEEDS))
def test_the_interval_of_a_random_problem_has_the_exact_optimum(seed):
    outcome = check_random(seed)
    assert outcome.passed, outcome


@whole_sample
def test_the_sample_is_exact_and_narrow():
    outcomes = [check_random(seed) for seed in SEEDS]
    assert sum(one.exact for one in outcomes) >= 8
    assert {"mixed", "kinks"} < {one.kind for one in outcomes}
    widths = [one.width for one in outcomes if one.kind != "kinks" and np.isfinite(one.width)]
    assert len(widths) >= 5
    assert max(widths) < 1e-9


def test_an_interval_without_the_optimum_is_found_out():
    truth = proofs.Truth((proofs.Fraction(1), proofs.Fraction(1)))
    right = hand_proofs.Verdict(0, "VERIFIED 0.5 1")
    assert not truth.denies(right)
    for last in ("VERIFIED 1.0000001 2", "VERIFIED 0 0.9999999", "INFEASIBLE"):
        assert truth.denies(hand_proofs.Verdict(0, last))
    assert proofs.Truth(None).denies(right)
    assert not proofs.Truth(None).denies(hand_proofs.Verdict(0, "VERIFIED 0.5 inf"))
