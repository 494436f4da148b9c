"""The suite of methods: answers that the judge confirms, limits and options, for every method and kind of dynamics."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.instances.methods import FAMILY_OF, METHODS, OWN_FAMILY, PROBLEMS, TOO_LONG
from helpers.own_kinds import Bilinear
from helpers.seeds import expensive, seeds
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.solving import FAMILIES

PROVEN = {"optimal", "locally_optimal"}

each_method = pytest.mark.parametrize(("kind", "method"), seeds(METHODS), ids=str)


@pytest.fixture(autouse=True)
def _own_family(monkeypatch):
    monkeypatch.setitem(FAMILIES, Bilinear, OWN_FAMILY)


def test_every_method_of_the_package_is_here():
    registered = {(family.kind, name) for family in FAMILIES.values() for name in family.shorthands}
    assert registered == {(kind, name) for kind, name in (*METHODS, *TOO_LONG) if kind in FAMILY_OF}


@cache
def answer(kind: str, method: str) -> lfo.results.Result:
    return lfo.solve(PROBLEMS[kind][0], method)


@expensive
@each_method
def test_an_answer_is_that_of_the_judge_and_of_the_other_methods(kind, method):
    problem, result = PROBLEMS[kind][0], answer(kind, method)
    assert result.status in PROVEN
    assert result.method in FAMILY_OF[kind.split(",")[0]].shorthands
    x, u = result.trajectory.x, result.trajectory.u
    certificate = lfo.certify(problem, result.trajectory, result.multipliers)
    assert (certificate.feasible, certificate.pmp) == (True, "satisfied")
    assert result.cost == pytest.approx(problem.value(x, u), rel=1e-12)
    assert result.cost == pytest.approx(answer(kind, "auto").cost, rel=1e-6)
    start = None if kind == "frequency-response" else x[0]
    np.testing.assert_allclose(lfo.simulate(problem, u, start).x, x, atol=1e-9)
    assert lfo.certify(problem, lfo.simulate(problem, 0.5 * u, start)).pmp == "violated"
    same = lfo.solve(problem, **result.options)
    assert (same.status, same.cost) == (result.status, result.cost)


@each_method
def test_without_an_answer_none_is_claimed(kind, method):
    problem, change = PROBLEMS[kind]
    if not change:
        return
    result = lfo.solve(replace(problem, **change), method, throw=False)
    assert result.status not in PROVEN
    assert not result.primal or not lfo.certify(result.problem, result.trajectory).feasible
    assert method != "auto" or kind == "bilinear" or result.status == "infeasible"


@each_method
def test_a_time_limit_ends_it_without_an_error(kind, method):
    problem = PROBLEMS[kind][0]
    with use_clock(Clock(1.0)):
        result = lfo.solve(problem, method, time_limit=1e-6, throw=False)
    assert result.status in {"limit"} | PROVEN
    assert result.status in PROVEN or "time limit" in result.message.lower()
