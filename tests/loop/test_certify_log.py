"""Logs of generated controllers: what is proven of each step, and what is no log."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.generated import write_log
from helpers.loops import LOOPS, states
from helpers.seeds import expensive


@pytest.fixture
def log(tmp_path):
    """Return a controller, its log as arrays, and a function that writes them."""
    controller = lfo.RecedingHorizon(LOOPS["low pass"]())
    measured = states(controller.problem, 6)
    controls = np.array([controller.step(x) for x in measured])

    def write(statuses=(0,) * 6, x=measured, u=controls):
        return write_log(tmp_path / "log.csv", x, u, list(statuses))

    return controller, measured, controls, write


def test_a_log_of_optimal_controls_is_proven(log):
    controller, _, controls, write = log
    certified = lfo.certify_log(controller, write())
    assert certified.proven.all()
    assert len(certified) == len(certified.table) == 6
    np.testing.assert_allclose(certified.planned, controls, atol=1e-8)
    np.testing.assert_allclose(certified.costs, controller.log.costs, rtol=1e-8)
    assert np.abs(certified.gaps).max() <= 1e-8
    assert "6 steps: 6 proven" in str(certified)


def test_another_control_deviates(log):
    controller, measured, controls, write = log
    controls[2] += 0.1
    certified = lfo.certify_log(controller, write())
    assert [str(one) for one in certified.findings] == ["proven"] * 2 + ["deviates"] + ["proven"] * 3
    plan = lfo.solve(controller.problem.with_ends(measured[2]))
    assert certified.differences[2] == pytest.approx(0.1 / np.abs(plan.control).max(), rel=1e-6)
    assert lfo.certify_log(controller, write(), tolerance=1.0).proven.all()


def test_the_words_have_the_largest_differences_of_the_steps_that_they_name(log):
    controller, _, controls, write = log
    controls[[1, 3, 4]] += np.array([[1e-5], [0.2], [0.3]])
    text = str(lfo.certify_log(controller, write()))
    assert "controls within 1e-05 of the optimal plans" in text
    assert "steps that deviate, by 3e-01 at most: 3 to 4" in text


def test_a_difference_that_counts_as_rounding_is_said(tmp_path):
    """It moves the first state by no more than the rounding of its terms, and is as large as it is."""
    plant = lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0.005], [0.1]])
    cost = lfo.QuadraticCost(Q=np.diag([1, 0.1]), R=0.1, x_ref=[1e3, 0.0])
    controller = lfo.RecedingHorizon(lfo.OptimalControlProblem(plant, 20, cost, initial_state=[1e3, 0]))
    path = write_log(tmp_path / "log.csv", np.array([[1e3, 0.0]]), np.array([[1e-13]]), [0])
    assert "controls within 1e-13 of the optimal plans" in str(lfo.certify_log(controller, path))


NO_BOUND = {
    "none": None,
    "1e9 for none": lfo.Box(-1e9, 1e9),
    "on one side": lfo.Box(-5.0, 1e4),
    "near": lfo.Box(-5.0, 5.0),
}


@pytest.mark.parametrize("case", NO_BOUND)
def test_controls_of_the_wrong_sign_deviate_whatever_stands_for_no_bound(tmp_path, case):
    plant = lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0.005], [0.1]])
    cost = lfo.QuadraticCost(Q=np.diag([1, 0.1]), R=0.1)
    controller = lfo.RecedingHorizon(
        lfo.OptimalControlProblem(plant, 20, cost, NO_BOUND[case], initial_state=[0, 0]), certify="later"
    )
    loop = controller.run([1.0, 0.0], 6)
    for sign, finding in ((1.0, "proven"), (-1.0, "deviates")):
        states, controls = np.vstack([loop.states[:-1], [[1.0, 0.0]]]), np.vstack([sign * loop.controls, [[1e6]]])
        certified = lfo.certify_log(controller, write_log(tmp_path / "log.csv", states, controls, [0] * 6 + [2]))
        assert set(map(str, certified.findings[:-1])) == {finding}


def test_noise_of_a_plant_at_rest_is_no_deviation(tmp_path):
    plant = lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0.005], [0.1]])
    cost = lfo.QuadraticCost(Q=np.diag([1, 0.1]), R=0.1, x_ref=[1e3, 0.0])
    controller = lfo.RecedingHorizon(lfo.OptimalControlProblem(plant, 20, cost, initial_state=[1e3, 0]))
    path = write_log(tmp_path / "log.csv", np.array([[1e3, 0.0]] * 2), np.array([[0.0], [1e-13]]), [0, 0])
    assert lfo.certify_log(controller, path).proven.all()
    path = write_log(tmp_path / "log.csv", np.array([[1e3, 0.0]]), np.array([[1.0000000001e-9]]), [0])
    assert not lfo.certify_log(controller, path).proven.any()


@pytest.mark.parametrize("case", ["bound", "rate"])
def test_a_control_outside_hard_limits_is_not_proven(tmp_path, case):
    plant = lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0.005], [0.1]])
    problem = lfo.OptimalControlProblem(plant, 20, lfo.QuadraticCost(Q=np.eye(2), R=0.01), lfo.Box(-0.3, 0.3))
    start = np.array([1.0, 0.0])
    if case == "rate":
        problem, start = lfo.rate_limited(problem, 0.3, previous=0.0), np.append(start, 0.0)
    controller = lfo.RecedingHorizon(problem)
    assert controller.step(start)[0] == pytest.approx(-0.3)
    for factor, proven in ((1.0, True), (1 + 1e-6, False)):
        path = write_log(tmp_path / "log.csv", start[None, :2], np.array([[-0.3 * factor]]), [0])
        assert lfo.certify_log(controller, path).proven.all() == proven


def test_the_status_says_whether_soft_rows_are_satisfied(tmp_path):
    controller = lfo.RecedingHorizon(LOOPS["low pass"](), soft={"state_set": 1e3})
    for start, true, false in ([0.0, 0.0, 1.2, 0.0], 1, 0), ([0.01, 0.0, 0.0, 0.0], 0, 1):
        control = controller.step(start)
        for status, finding in ((true, "proven"), (false, "deviates")):
            path = write_log(tmp_path / "log.csv", np.array([start]), control[None], [status])
            assert str(lfo.certify_log(controller, path).findings[0]) == finding


@expensive
@pytest.mark.parametrize("logged", [0.0, 1.0, np.nan])
def test_without_a_state_the_control_returned_last_goes_on(tmp_path, logged):
    controller = lfo.RecedingHorizon(LOOPS["low pass"](), delay=1)
    loop = controller.run([0.02, 0.01, 0.0, 0.0], 5)
    states, controls, statuses = loop.states[:-1].copy(), loop.controls.copy(), [0] * 5
    plant, statuses[2] = controller.problem.dynamics.stepper(1), 4
    later = lfo.RecedingHorizon(LOOPS["low pass"]())
    states[3] = plant(0, loop.states[2], loop.controls[1])
    controls[3] = later.step(plant(0, states[3], loop.controls[1]))
    states[2, 0], controls[2] = np.nan, logged
    states[4] = plant(0, states[3], loop.controls[1])
    controls[4] = later.step(plant(0, states[4], controls[3]))
    path = write_log(tmp_path / "log.csv", states, controls, statuses)
    assert [str(one) for one in lfo.certify_log(controller, path).findings] == ["proven"] * 2 + ["no state"] + [
        "proven"
    ] * 2


def test_each_status_is_compared_with_what_is_proven(log):
    controller, measured, _, write = log
    measured[1] = measured[2] = [0.0, 20.0, 0.0, 0.0]
    measured[4, 0] = np.nan
    certified = lfo.certify_log(controller, write([0, 3, 0, 2, 4, 3]))
    expected = ["proven", "infeasible, proven", "deviates", "plan before", "no state", "has a plan"]
    assert [str(one) for one in certified.findings] == expected


def test_softened_steps_are_those_of_the_softened_problem(tmp_path):
    problem = LOOPS["low pass"]()
    controller = lfo.RecedingHorizon(problem, soft={"state_set": 1e3})
    lost = np.array([[0.0, 0.0, 1.2, 0.0]] * 4)
    controls = np.array([controller.step(x) for x in lost])
    assert controller.log.sources[-1] == "softened problem"
    certified = lfo.certify_log(controller, write_log(tmp_path / "log.csv", lost, controls, [1] * 4))
    assert certified.proven.all()


def test_with_a_delay_the_control_before_counts(tmp_path):
    controller = lfo.RecedingHorizon(LOOPS["low pass"](), delay=1)
    loop = controller.run([0.02, 0.01, 0.0, 0.0], 6)
    path = write_log(tmp_path / "log.csv", loop.states[:-1], loop.controls, [0] * 6)
    assert lfo.certify_log(controller, path).proven.all()
    plain = lfo.RecedingHorizon(LOOPS["low pass"]())
    assert not lfo.certify_log(plain, path, tolerance=1e-6).proven[1:].any()


def test_a_line_that_was_cut_off_is_left_out(log):
    controller, _, _, write = log
    path = write()
    path.write_text(path.read_text()[:-15])
    certified = lfo.certify_log(controller, path)
    assert (len(certified), certified.cut_off) == (5, True)
    assert "last line" in str(certified)


BAD_LOGS = {
    "": "line 1: got ''",
    "x1,u1,status\n0,0,0\n": "line 1: got 'x1,u1,status'; expected \"x1,x2,x3,x4,u1,status\"",
    "x1,x2,x3,x4,u1,status\n": "no steps",
    "x1,x2,x3,x4,u1,status\n0,0,0,0,0,0\n0,0,0,0,0\n": "line 3",
    "x1,x2,x3,x4,u1,status\n0,0,0,a,0,0\n": "line 2",
    "x1,x2,x3,x4,u1,status\n0,0,0,0,0,7\n": "line 2.*a status from 0 to 4",
    "x1,x2,x3,x4,u1,status\n0,0,nan,0,0,0\n": "line 2.*finite",
}


@pytest.mark.parametrize("text", BAD_LOGS)
def test_what_is_no_log_is_named(tmp_path, text):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(lfo.errors.ProblemError, match=BAD_LOGS[text].replace("'", ".")):
        lfo.certify_log(lfo.RecedingHorizon(LOOPS["low pass"]()), path)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        (("no/such.csv",), "no/such.csv"),
        ((3,), "path"),
        (("log.csv", 0.0), "tolerance"),
        (("log.csv", "a"), "tolerance"),
    ],
)
def test_bad_arguments_are_named(arguments, field):
    with pytest.raises(lfo.errors.ProblemError, match=field):
        lfo.certify_log(lfo.RecedingHorizon(LOOPS["low pass"]()), *arguments)
