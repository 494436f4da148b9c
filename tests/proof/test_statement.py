"""The section PROBLEM of a proof says what the problem says, to the last bit."""

import json

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.proof import exact, problem_lines, vector
from lin_freq_ocp.transform.hybrid import piecewise_affine


def stated(problem):
    return [json.loads(text) for text in problem_lines(problem)]


def numbers(texts):
    return np.array([numbers(one) if isinstance(one, list) else float.fromhex(one) for one in texts])


def lines_with(lines, key, value=None):
    return [one for one in lines if key in one and value in (None, one[key])]


def test_numbers_are_exact():
    values = np.array([0.1, -0.0, 5e-324, 1.7976931348623157e308, np.inf, -np.inf])
    assert np.array_equal(numbers(json.loads(vector(values))), values)
    assert float.fromhex(exact(-5, -3)) == -0.625


def test_dynamics_costs_and_bounds_are_those_of_the_problem():
    problem = lfo.library.pendulum()
    lines = stated(problem)
    assert (lines[0]["horizon"], lines[0]["states"]) == (240, list(problem.state_names))
    (mode,) = lines_with(lines, "mode")
    assert np.array_equal(numbers(mode["A"]), problem.linear.A)
    assert np.array_equal(numbers(mode["B"]), problem.linear.B)
    (cost,) = lines_with(lines, "cost", "stage")
    assert np.array_equal(numbers(cost["hessian"]), problem.quadratic.stage_hessians[0])
    bounds = lines_with(lines, "bounds", "stage")
    assert [one["from"] for one in bounds] == [0, 1]
    for one in bounds:
        assert np.array_equal(numbers(one["upper"])[:4], problem.state_tube.upper[one["from"]])
        assert numbers(one["lower"])[4] == problem.control_tube.lower[0, 0]
    (end,) = lines_with(lines, "bounds", "end")
    assert np.array_equal(numbers(end["lower"]), problem.state_tube.lower[-1])
    (stop,) = lines_with(lines, "stop", 4)
    removed = [k for first, last in stop["bins"] for k in range(first, last + 1)]
    assert removed == np.flatnonzero(problem.control_stop[:, 0]).tolist()


def test_what_changes_in_time_stands_where_it_changes():
    T = 6
    Q = np.ones((T, 1, 1))
    Q[4:] = 2.0
    x_ref = np.zeros((T + 1, 1))
    x_ref[2:] = 3.0
    cost = lfo.QuadraticCost(Q=Q, R=1.0, x_ref=x_ref, q=[0.5], P=4.0)
    offset = np.zeros((T, 1))
    offset[3] = 1.0
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics([[1.0]], [[1.0]], offset), T, cost, initial_state=[0.0])
    lines = stated(problem)
    stages = lines_with(lines, "cost", "stage")
    assert [one["from"] for one in stages] == [0, 2, 4]
    assert "hessian" not in stages[1]
    assert numbers(stages[1]["center"])[0] == 3.0
    assert "center" not in stages[2]
    assert numbers(stages[2]["hessian"])[0, 0] == 2.0
    assert [one["from"] for one in lines_with(lines, "mode")] == [0, 3, 4]
    (end,) = lines_with(lines, "cost", "end")
    assert numbers(end["hessian"])[0, 0] == 4.0
    assert numbers(end["center"])[0] == 3.0


def test_modes_have_the_rows_of_their_regions():
    problem = lfo.library.switched_rotation()
    lines = stated(problem)
    modes = lines_with(lines, "mode")
    assert lines[0]["modes"] == list(problem.mode_names)
    assert [one["mode"] for one in modes] == [0, 1]
    for one, mode in zip(modes, piecewise_affine(problem).modes, strict=True):
        assert np.array_equal(numbers(one["A"]), mode.linear.A)
        assert np.array_equal(numbers(one["h"]), mode.region.e)


def test_rows_of_terms_are_those_of_their_maps():
    rows = lfo.StageRows(C=[[1.0, 0.25]], D=[[-2.0]], e=[0.5], penalty=3.0)
    cost = lfo.QuadraticCost(R=1.0) + lfo.costs.L1Cost(x=[1.0, 0.0], x_ref=[0.5, 0.0])
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]]), 5, cost, stage_rows=rows
    )
    lines = stated(problem)
    found = lines_with(lines, "name", "stage rows")
    assert (len(found), found[2]["gauge"]) == (5, "max")
    (value,) = found[2]["values"]
    assert [(t, i, float.fromhex(c)) for t, i, c in value["row"]] == [(2, 0, 1.0), (2, 1, 0.25), (2, 2, -2.0)]
    assert (float.fromhex(found[2]["limit"]), float.fromhex(found[2]["weight"])) == (0.5, 3.0)
    norm = lines_with(lines, "name", "L1 cost of states")[0]
    assert norm["gauge"] == "1"
    assert float.fromhex(norm["values"][0]["constant"]) == -0.5


def test_masks_have_their_bins_and_limits():
    bound = lfo.spectrum.MagnitudeBound(0.25, bins=[3, 4], penalty=2.0, window=np.arange(1.0, 9.0))
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[1.0]]), 8, lfo.QuadraticCost(R=1.0), control_spectrum=bound
    )
    lines = stated(problem)
    terms = lines_with(lines, "term")
    assert [(one["term"], one["gauge"]) for one in terms] == [(0, "2"), (1, "2")]
    assert [one["values"][0]["frequency"] for one in terms] == [[3, 8], [4, 8]]
    assert float.fromhex(terms[0]["limit"]) == 0.25
    assert float.fromhex(terms[0]["weight"]) == 2.0
    assert np.array_equal(numbers(terms[0]["values"][0]["window"]), np.arange(1.0, 9.0))
    assert numbers(terms[0]["values"][0]["output"]).tolist() == [0.0, 1.0]


def test_what_the_format_does_not_hold_is_refused_by_its_field():
    problem = lfo.library.norm_dynamics()
    with pytest.raises(lfo.errors.UnsupportedError, match="a proof states linear or piecewise-affine"):
        stated(problem)


def test_a_term_that_the_format_does_not_hold_is_refused_by_its_field():
    with pytest.raises(lfo.errors.UnsupportedError, match="control_spectrum: got 'residual vibration"):
        stated(lfo.library.printer_move())
