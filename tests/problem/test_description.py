"""A problem in words: its sets, its ends and the terms of its cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from helpers.compared_pages import case
from helpers.pages import STATES
from lin_freq_ocp import Box, QuadraticCost
from lin_freq_ocp.library import pendulum
from lin_freq_ocp.problem import problem_facts


def test_problem_is_described():
    facts = dict(problem_facts(pendulum()))
    assert facts["horizon"] == "240 steps of 0.01 s (2.4 s)"
    assert facts["control: force [N]"] == "within ±5"
    assert facts["state: position [m]"] == "within ±0.2; starts at -0.15; ends at 0.15"
    assert facts["minimise"] == "the sum of ½ u' R u"
    assert facts["where"] == "R = 2"
    facts = dict(problem_facts(case("state band").problem))
    assert facts[f"state: {STATES[0]}"] == "no bound; starts at 0; ends at 1"
    assert facts[f"state: {STATES[1]}"] == "from -1 to 9; starts at 0; ends at 0"
    reaching = replace(case("no band").problem, terminal_state=Box([None, 0], [2, None]))
    assert dict(problem_facts(reaching))[f"state: {STATES[0]}"] == "no bound; starts at 0; ends at most 2"
    assert dict(problem_facts(reaching))[f"state: {STATES[1]}"] == "no bound; starts at 0; ends at least 0"


def test_costs_are_described_term_by_term():
    problem = case("no band").problem
    everything = QuadraticCost(
        Q=np.diag([1.0, 2.0]), R=3.0, S=np.ones((2, 1)), q=[1, 1], r=[1], P=2.0, p=[0, 1], x_ref=[1, 0], u_ref=[0]
    )
    facts = problem_facts(replace(problem, cost=everything))
    (told,) = (value for term, value in facts if term == "minimise")
    data = " ".join(value for term, value in facts if term == "where")
    for term in (
        "(x - x_ref)' Q (x - x_ref)",
        "u' R u",
        "(x - x_ref)' S u",
        "q' x",
        "r' u",
        "P (x - x_ref) at the end",
    ):
        assert term in told
    for value in ("Q = diag(1, 2)", "R = 3", "S = [1; 1]", "P = 2 I", "p = (0, 1)", "x_ref = (1, 0)"):
        assert value in data
    assert dict(problem_facts(replace(problem, cost=QuadraticCost())))["minimise"].startswith("nothing")
