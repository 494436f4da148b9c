"""A result in words, and that it cannot be changed."""

import copy
import pickle
from dataclasses import replace

import pytest

import lin_freq_ocp as lfo


def test_a_result_in_ten_lines(solved):
    default = solved("paper, constrained")
    for result, solver in (
        (default, "method    spectral"),
        (lfo.solve(default.problem, method="convex"), "method    convex, clarabel"),
    ):
        lines = str(result).splitlines()
        assert len(lines) <= 10
        assert any(line.startswith(solver) for line in lines)
        for word in ("optimal", "3199.186", "rigorous", "satisfied, normal"):
            assert word in "\n".join(lines)


def test_results_in_one_line(solved):
    result = solved("paper, constrained")
    line = repr(result)
    assert line.startswith("Result(optimal by spectral, cost 3199.186")
    assert f"gap {result.gap:.2e}" in line
    assert repr(result.certificate).startswith("Certificate(globally optimal, theorem satisfied, cost 3199.186")
    assert str(result.certificate) in str(result)
    assert repr(result.problem) == f"OptimalControlProblem({result.problem})"
    wrong = lfo.certify(result.problem, lfo.Trajectory(result.trajectory.x + 1, result.control))
    assert repr(wrong).startswith("Certificate(not feasible, theorem violated, cost")
    for one in (result, result.certificate, result.problem, wrong):
        assert len(repr(one)) < 200
        assert "\n" not in repr(one)


def test_results_cannot_be_changed(solved):
    result = solved("paper, constrained")
    for array in (result.trajectory.x, result.control, result.multipliers.eta, result.multipliers.rho_u):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_copies_of_results_are_results_with_the_same_fields_and_methods(solved):
    result = solved("paper, constrained")
    comparison = lfo.compare(lfo.library.double_integrator(), ["clipped"])
    sweep = lfo.sweep(lfo.library.double_integrator, {"horizon": [60]})
    for original in (result, comparison, sweep):
        for again in (copy.copy(original), pickle.loads(pickle.dumps(original)), replace(original)):
            assert type(again) is type(original)
            assert str(again) == str(original)
    assert replace(result, message="other").message == "other"
    assert pickle.loads(pickle.dumps(result)).to_frame().equals(result.to_frame())
    assert copy.copy(comparison).classical.cost == comparison.classical.cost
