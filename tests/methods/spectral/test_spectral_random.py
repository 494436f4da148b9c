"""A seeded sample of scripts/verify/spectral.py, and what it says of answers that are wrong on purpose."""

import signal
from dataclasses import replace
from threading import Event

import pytest

import lin_freq_ocp as lfo
from helpers.checks import spectral
from helpers.checks.spectral import Reference, Verdict
from helpers.random.lti import with_witness
from helpers.seeds import expensive, seeds
from lin_freq_ocp.methods import SolveOptions, solve_convex

ACCURATE = SolveOptions(tolerance=1e-11)

BOUNDED = 4
"""A problem with active bounds, a stop band and a witness."""


HARD = 474, 595, 600, 696, 765, 847, 898
"""Soft borders: optima far away, flat directions, and infeasible problems whose forces must not depend on the cost."""

STALLED = 3017
"""An infeasible problem with inaccurate small QPs: rows leave the working set and return at once."""

TINY_REFERENCE = 338
"""A problem whose references of controls are a ten-thousandth of their bounds; no reference solver solves it."""


@pytest.mark.parametrize("seed", seeds(range(8), HARD))
def test_a_random_problem_is_solved_like_by_the_reference_or_proven_infeasible(seed):
    outcome = spectral.check(seed)
    assert outcome.passed, str(outcome)


@expensive
def test_an_exchange_whose_rows_return_at_once_ends_with_a_ray():
    solution = lfo.SpectralSolver(with_witness(STALLED)[0]).solve()
    assert solution.status == "infeasible"
    assert solution.rounds < 20


@expensive
def test_a_tiny_reference_is_no_measure_of_a_control():
    problem, witness = with_witness(TINY_REFERENCE)
    result = lfo.solve(problem, method="spectral")
    assert result.certificate.pmp == "satisfied"
    assert result.certificate.globally_optimal
    assert result.cost <= problem.cost.value(witness.x, witness.u)


@pytest.fixture(scope="module")
def both():
    """A problem, its witness, our result and the reference's."""
    problem, witness = with_witness(BOUNDED)
    return problem, witness, lfo.solve(problem, method="spectral"), solve_convex(problem, "clarabel", ACCURATE)


def test_a_feasible_point_that_is_not_optimal_is_not_explained(both):
    problem, witness, result, reference = both
    ours = replace(result, trajectory=witness, certificate=lfo.certify(problem, witness, result.multipliers))
    assert spectral.compare_costs(problem, ours, reference)[0] is Verdict.UNEXPLAINED


def test_a_reference_above_a_certified_optimum_is_proven_wrong(both):
    problem, witness, result, reference = both
    verdict, why, _ = spectral.compare_costs(problem, result, replace(reference, trajectory=witness))
    assert verdict is Verdict.PROVEN
    assert "above, its duality gap" in why


def test_a_reference_that_breaks_the_dynamics_is_explained_by_its_residuals(both):
    problem, _, result, reference = both
    dynamics = problem.dynamics
    moved = replace(dynamics, offset=dynamics.offset + 1e-3)
    cheating = solve_convex(replace(problem, dynamics=moved), "clarabel", ACCURATE)
    verdict, why, difference = spectral.compare_costs(problem, result, cheating)
    assert verdict is Verdict.PROVEN
    assert "its dynamics residual" in why
    assert difference > 1e-7
    unproven = replace(result, certificate=replace(result.certificate, bound=None))
    assert spectral.compare_costs(problem, unproven, cheating)[0] is Verdict.EXPLAINED
    errors = spectral.cost_errors(problem, reference.trajectory, reference.multipliers, result.trajectory)
    assert sum(errors.values()) < 1e-8 * max(1, abs(result.cost))


@pytest.mark.parametrize(
    ("ours", "reference", "feasible", "verdict"),
    [
        ("infeasible", "infeasible", False, Verdict.RAY),
        ("optimal", "infeasible", False, Verdict.NO_RAY),
        ("limit", "infeasible", False, Verdict.NO_RAY),
        ("optimal", "unsure", True, Verdict.ALONE),
        ("infeasible", "unsure", False, Verdict.RAY_ALONE),
        ("infeasible", "unsure", True, Verdict.CONTRADICTED),
        ("infeasible", "solved", False, Verdict.CONTRADICTED),
        ("limit", "solved", False, Verdict.UNSOLVED),
        ("limit", "unsure", True, Verdict.UNSOLVED),
        ("limit", "unsure", False, Verdict.UNDECIDED),
    ],
)
def test_statuses_are_compared(ours, reference, feasible, verdict):
    assert spectral.compare_statuses(ours, reference, feasible) is verdict


def test_a_witness_is_not_contradicted_by_the_reference(monkeypatch):
    problem, witness = with_witness(BOUNDED)
    answers = {
        "clarabel": replace(solve_convex(problem, "clarabel", ACCURATE), message="PrimalInfeasible"),
        "qpsolvers:piqp": solve_convex(problem, "qpsolvers:piqp", ACCURATE),
    }
    monkeypatch.setattr(spectral, "solve_convex", lambda problem, name, *_: answers[name])
    reference = spectral.reference_answer(problem, witness)
    assert reference.status == "solved"
    assert reference.point is answers["qpsolvers:piqp"]
    assert spectral.reference_answer(problem, None).status == "infeasible"


def test_exceptions_and_refusals_fail_without_ending_the_run(monkeypatch):
    def raising(error):
        def solve(*_, **__):
            raise error

        return solve

    monkeypatch.setattr(spectral, "reference_answer", lambda *_: Reference("unsure", "none"))
    for error, verdict in (
        (lfo.errors.UnsupportedError("time-varying"), Verdict.REFUSED),
        (ZeroDivisionError("1 / 0"), Verdict.BROKEN),
    ):
        monkeypatch.setattr(spectral.lfo, "solve", raising(error))
        outcome = spectral.check(BOUNDED)
        assert outcome.verdict is verdict
        assert not outcome.passed


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no such clock on this system")
def test_no_problem_takes_too_long(monkeypatch):
    monkeypatch.setattr(spectral.lfo, "solve", lambda *given, **named: Event().wait())  # for ever
    monkeypatch.setattr(spectral, "PROBLEM_SECONDS", 1e-3)
    outcome = spectral.check(BOUNDED)
    assert outcome.verdict is Verdict.BROKEN
    assert not outcome.passed


def test_a_gap_that_proves_nothing_fails(both):
    _, _, result, _ = both
    loose = replace(result.certificate, bound=replace(result.certificate.bound, value=result.cost - 1.0))
    outcome = spectral.Outcome(BOUNDED, "optimal", "", Verdict.AGREES, certificate=loose)
    assert not outcome.passed
    assert replace(outcome, certificate=result.certificate).passed
