"""A share of the pairs of ``scripts/verify.py --part pairs``, and those that were once wrong."""

import inspect
from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.checks import formulas_together, pairs
from helpers.combinations import PAGE, page, words_of_page
from helpers.seeds import expensive, seeds

SHARE = 20  # of so many pairs one is solved here, and a twelfth of these on one day
SAID = words_of_page(PAGE.read_text(encoding="utf-8"))
ONCE_WRONG = [
    ("free initial state", '"structured"'),  # at its references it costs nothing, as some of the next ones
    ("piecewise-affine dynamics", "free initial state"),
    ("piecewise-smooth dynamics", "initial box"),
    ("levels", "initial box"),
    ("free initial state", "path constraint"),
    ("soft path constraint", "mask on a held control"),  # multipliers at the frequencies of the answer
    ("L1 cost", "cost by formulas"),  # a state without a weight
    ("linked ends", "generate"),  # its field
    ("zero-padded frequency response", "periodic ends"),  # equations that are stated, not implied by the dynamics
    ("zero-padded frequency response", "linked ends"),
    ("terminal ball", "linked ends"),  # rows that contradict each other by rounding
]


TOGETHER_ONCE_WRONG = [
    ("periodic frequency response", "linear cost", "ball"),  # the bound did not see that a ball bounds the controls
    ("zero-padded frequency response", "linked ends", "spectrogram"),  # a traceback: links that are stated, not implied
    ("terminal point", "soft path constraint", "mask of states"),  # infeasible, with no name to say
    ("L1 cost", "periodic ends", "soft box", "soft mask"),  # at rest; ends that are equal up to rounding of the motion
]


def test_a_share_has_uses_and_pairs_of_features():
    share = pairs.pairs()[::SHARE]
    assert 15 < sum(other in pairs.USES for _, other in share) < len(share) - 15


@pytest.mark.parametrize("pair", seeds(pairs.pairs()[::SHARE], ONCE_WRONG))
def test_a_pair_is_as_the_page_says(pair):
    if pairs.is_long(pair):
        pytest.skip("a global bound takes seconds")
    outcome = pairs.check(pair)
    assert (outcome.verdict == "wrong") == (pair in pairs.KNOWN), outcome
    assert " ".join(outcome.words.split()) == SAID[pair]


@pytest.mark.parametrize("names", [*map(pairs.triple, seeds(range(12))), *TOGETHER_ONCE_WRONG])
def test_features_work_together_or_are_refused(names):
    if any("formulas" in name for name in names):
        pytest.skip("a bound of formulas with a mask takes a minute")
    outcome = pairs.outcome_of(names, lambda: pairs.solved_wrongly(names))
    assert outcome.passed, outcome.words


def test_limited_changes_of_the_size_of_rounding_have_an_answer():
    """Errors of rows from 1e-16 to 1e5, relative to their units, are no weights of one factorisation."""
    problem = lfo.rate_limited(pairs.problem_of("zero-padded frequency response"), limit=1e-12)
    assert lfo.solve(problem, throw=False).certificate.feasible


@expensive
@pytest.mark.parametrize("seed", [20, 36, 130, 246, 281, 358, 398])
def test_random_formulas_work_beside_other_features(seed):
    """The last four once had no answer: a constant, norms beside other formulas, and a ball at whose edge it rests."""
    outcome = formulas_together.check(seed)
    assert outcome.passed, outcome.wrong


def test_formulas_that_are_read_otherwise_are_found_out(monkeypatch):
    drawn = replace(formulas_together.draw(36), stage="0.5*exp(u_0)")
    assert formulas_together.faults(drawn, []) == []
    shifted = formulas_together.NUMBERS | {"exp": lambda a: np.exp(a) + 1e-3}
    monkeypatch.setattr(formulas_together, "NUMBERS", shifted)
    assert ["by NumPy" in one for one in formulas_together.faults(drawn, [])] == [True]
    monkeypatch.setattr(formulas_together, "twin", lambda given: None)
    tight = replace(drawn, stage="", path="exp(u_0) - 1.1", soft=False, convex=False)
    assert any("violated" in one for one in formulas_together.faults(tight, []))


TOUCHING = (
    "ellipsoid",
    "second-order cone",
    "soft box",
    "soft terminal ball",
    "soft mask",
    "spectrogram",
    "residual vibration",
)


@pytest.mark.parametrize("name", TOUCHING)
def test_ends_that_touch_in_a_point_have_a_proven_optimum(name):
    """The linked end is on the edge of the terminal ball: a change of 1e-7 along the edge violates it by 1e-14."""
    names = sorted(["terminal ball", "linked ends", name], key=list(pairs.FEATURES).index)
    assert pairs.solved_wrongly(names) == ""


@expensive
@pytest.mark.parametrize("ends", [("terminal point", "terminal polyhedron"), ("terminal point", "linked ends")])
def test_ends_that_contradict_each_other_are_infeasible_whatever_the_dynamics_are(ends):
    for dynamics in ("linear dynamics", "smooth dynamics", "piecewise-smooth dynamics", "dynamics by functions"):
        problem = pairs.problem_of(dynamics, *ends)
        assert pairs.solve_quickly(problem).status == "infeasible"


def test_names_of_terms_stay_where_a_fixed_end_satisfies_a_hard_set_beside_a_soft_one():
    """The hard ball has no term at the fixed end, nor where the cost by formulas is a state that is free there."""
    cost = {"cost": lfo.costs.SmoothCost(stage="norm(x_1, 0.388*u_0)")}
    path = {"stage_rows": [lfo.sets.PathConstraint("x_0 - 0.388*cos(x_1) - 1.4", "drawn path")]}
    ends = map(pairs.fields_of, ("soft terminal ball", "terminal ball", "terminal point"))
    assert pairs.solve_quickly(pairs.problem_with([*ends, cost, path], "")).status in pairs.ANSWERS


def test_the_page_has_every_pair():
    every = pairs.pairs()
    assert SAID.keys() == set(every)
    assert page(pairs.Outcome(pair, "", SAID[pair]) for pair in every) == PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize("space", [lfo.dynamics, lfo.costs, lfo.sets, lfo.spectrum])
def test_every_kind_is_a_feature(space):
    text = inspect.getsource(pairs)
    kinds = [name for name in space.__all__ if inspect.isclass(getattr(space, name)) and name not in pairs.LEFT_OUT]
    assert [name for name in kinds if f".{name}" not in text] == []


def test_answers_that_are_wrong_are_found_out(monkeypatch):
    pair, honest = ("ball", "joint rows"), pairs.independent
    monkeypatch.setattr(pairs, "independent", lambda *given: cp_plus(honest(*given), 1e-3))
    assert pairs.check(pair).verdict == "wrong"
    cheap = pairs.outcome_of(pair, lambda: {}["missing"])
    assert cheap.verdict == "wrong"
    assert cheap.words.endswith("KeyError: 'missing'")
    assert "in test_answers_that_are_wrong_are_found_out" in cheap.words or "in <lambda>" in cheap.words
    assert pairs.outcome_of(pair, refuse("no")).verdict == "wrong"
    assert pairs.outcome_of(pair, refuse("control_set: got a ball; expected a box.")).verdict == "refused"


def cp_plus(model, constant):
    """Return a problem in CVXPY with a constant added to its cost."""
    return pairs.cp.Problem(pairs.cp.Minimize(model.objective.expr + constant), model.constraints)


def refuse(words):
    """Return a trial that is refused with these words."""

    def trial():
        raise lfo.errors.UnsupportedError(words)

    return trial
