"""For what a bound or a proof of infeasibility holds is a field of the outcome; no decision reads a message."""

import ast
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from lin_freq_ocp.batch import Search
from lin_freq_ocp.files import result_summary
from lin_freq_ocp.pages import answer_data

H = 0.1
DOUBLE = lfo.LinearDynamics([[1.0, H], [0.0, 1.0]], [[H * H / 2] * 2, [H] * 2], sampling_time=H)


def constant(bound=None):
    """Return a move that its stop band excludes, as both controls are constant: provably with bounded controls."""
    band = lfo.stop_band(bins=range(1, 11))
    control = None if bound is None else lfo.Box(-bound, bound)
    cost = lfo.QuadraticCost(R=1.0)
    return lfo.OptimalControlProblem(DOUBLE, 20, cost, control, None, [0, 0], [1, 0], control_spectrum=band)


def absolute(target, control_bound=1.0):
    """Return x+ = |x| + u from 0 to ``target`` in three steps."""
    modes = [lfo.AffineMode([[s]], [[1.0]], G=[[-s]], h=[0.0], name=name) for s, name in ((1.0, "up"), (-1.0, "down"))]
    dynamics = lfo.PiecewiseAffineDynamics(modes)
    bounds = lfo.Box(-control_bound, control_bound)
    return lfo.OptimalControlProblem(dynamics, 3, lfo.QuadraticCost(R=1.0), bounds, lfo.Box(-9, 9), [0.0], [target])


@cache
def outcome(case):
    problem = {"ray": constant(9), "claim": constant(), "tree": absolute(5.0), "optimum": absolute(2.0)}[case]
    return lfo.solve(problem, throw=False)


CASES = {
    "ray": ("infeasible", "rigorous", True),
    "claim": ("infeasible_claimed", "numerical", False),
    "tree": ("infeasible", "rigorous", True),
    "optimum": ("optimal", "rigorous", True),
}


@pytest.mark.parametrize("case", CASES)
def test_results_and_their_json_say_for_what_the_bound_holds(case):
    result = outcome(case)
    assert (result.status, result.bound, result.dual) == CASES[case]
    summary = result_summary(result)
    assert (summary["status"], summary["bound"], summary["dual"]) == CASES[case]
    assert (result.ray is not None) == (result.conflict is not None) == (case in ("ray", "claim"))


def test_the_rows_of_a_sweep_do_too():
    found = lfo.sweep(constant(9), {"terminal_state": [[1, 0], [0, 0]]})
    assert [(row["status"], row["bound"]) for row in found.rows] == [
        ("infeasible", "rigorous"),
        ("optimal", "rigorous"),
    ]
    free = lfo.sweep(constant(), {"terminal_state": [[1, 0]]})
    assert [(row["bound"], row["proven"]) for row in free.rows] == [("numerical", False)]


@pytest.mark.parametrize("case", ["ray", "claim"])
def test_another_message_changes_no_decision(case):
    result, others = outcome(case), [outcome(other).message for other in ("ray", "claim")]
    for message in others:
        told = replace(result, message=message)
        assert told.dual == result.dual
        assert answer_data(told)["status"] == CASES[case][0]
        search = Search(20, 20)
        search.keep(20, told)
        assert search.proven == ([20] if case == "ray" else [])


@expensive
def test_no_code_compares_a_message():
    """A message is for people: it may be put together and shown, and nothing branches on its text."""
    for path in Path(lfo.__file__).parent.rglob("*.py"):
        text = path.read_text()
        for node in ast.walk(ast.parse(text)) if ".message" in text else ():
            read = [part for part in ast.walk(node) if isinstance(part, ast.Attribute) and part.attr == "message"]
            if isinstance(node, ast.Compare) and read:
                literal = [one for one in (node.left, *node.comparators) if not isinstance(one, ast.Attribute)]
                assert all(isinstance(one, ast.Constant) and one.value in (None, "") for one in literal), (
                    path,
                    node.lineno,
                )
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                of = node.func.value
                assert not (isinstance(of, ast.Attribute) and of.attr == "message"), (path, node.lineno)
