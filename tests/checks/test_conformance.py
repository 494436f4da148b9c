"""The public face of lin_freq_ocp.testing: its examples run, and a wrong answer is found out."""

import doctest

import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from lin_freq_ocp import testing


@expensive
def test_the_examples_run(monkeypatch):
    for slow in ("chain8_m2_diffbands", "dint200_soft"):  # tests of solve have them
        monkeypatch.delitem(testing.INSTANCES, slow)
    runner = doctest.DocTestRunner()
    for example in doctest.DocTestFinder().find(testing, globs=vars(testing)):
        assert runner.run(example).failed == 0


def test_wrong_answers_fail():
    problem = lfo.library.double_integrator(horizon=40, sampling_time=0.1, cutoff_hz=2.0)
    result = lfo.solve(problem)
    case = testing.Case("double integrator", problem, result.cost)
    assert not testing.check(case, lambda problem: None).passed
    spoiled = lfo.Trajectory(result.trajectory.x, result.trajectory.u + 1.0)
    assert "not feasible" in testing.check(case, lambda problem: spoiled).message
    dearer = testing.Case(case.name, case.problem, case.cost * 1.01)
    assert "relative error" in testing.check(dearer, lambda problem: result.trajectory).message
    with_answer = testing.Case(case.name, case.problem, float("inf"))
    assert not testing.check(with_answer, lambda problem: result.trajectory).passed


@expensive
@pytest.mark.parametrize(("kind", "name"), [("piecewise affine", "buck, T = 6"), ("piecewise smooth", "buck, T = 3")])
def test_cases_with_modes(kind, name):
    case = next(case for case in testing.conformance_cases(kind) if case.name == name)
    report = testing.check(case, lambda problem: lfo.solve(problem).trajectory)
    assert report.passed, report
