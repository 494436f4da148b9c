"""The suite of terms: sets, rows, costs and frequency constraints of every class, each in a small problem."""

from __future__ import annotations

from dataclasses import replace

import pytest

import lin_freq_ocp as lfo
from helpers.instances import classes_of
from helpers.instances.statements import OF_A_USER, STATEMENTS, classes_within
from helpers.seeds import seeds
from lin_freq_ocp.problem import AffineMap, ConvexSet, FrequencyConstraint, NonsmoothCost, Penalty, TermKind
from lin_freq_ocp.testing import check_terms

DERIVED = {"PartSet", "AffineNorms"}  # users do not state them
NOT_CONVEX = {"FormulaMap", "SmoothCost"}  # tests of path constraints and of costs by formulas have them


def test_every_class_of_the_package_is_here():
    classes, kinds = set[type](), set[TermKind]()
    for make in STATEMENTS.values():
        problem = make()
        classes |= set(classes_within(problem))
        kinds |= {term.kind for term in problem.terms}
    assert kinds == set(TermKind)
    for protocol in (ConvexSet, NonsmoothCost, FrequencyConstraint, AffineMap, Penalty):
        assert {kind.__name__ for kind in classes_of(protocol) - classes} <= DERIVED | NOT_CONVEX


@pytest.mark.parametrize("name", seeds(STATEMENTS))
def test_terms_keep_their_protocols(name):
    """It is solved, proven, the same with additional states, and each of its limits can be moved."""
    assert check_terms(STATEMENTS[name]()) == []


WORDS = {
    "set of a user": "a rounded simplex",
    "set of a user on states": "a rounded simplex",
    "cost of a user": "the largest weighted thrust",
    "variation of the controls": "the variation of the controls",
    "frequency constraint of a user": "the sum of u_0 is at most 0.5",
}


@pytest.mark.parametrize("name", seeds(OF_A_USER))
def test_a_class_of_a_user_matters_and_is_exported_and_described(name):
    """tests/files/test_cvxpy_terms.py exports each feature of the package."""
    problem = STATEMENTS[name]()
    result, program = lfo.solve(problem), lfo.to_cvxpy(problem)
    program.solve(solver="CLARABEL")
    assert program.value == pytest.approx(result.cost, rel=1e-6)
    assert lfo.certify(problem, result.trajectory).globally_optimal
    without = replace(problem, control_set=None, state_set=None, control_spectrum=None, cost=problem.quadratic)
    assert lfo.solve(without).cost < result.cost - 1e-3
    assert WORDS[name] in problem._repr_html_()
