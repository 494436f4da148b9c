"""Logs of generated controllers: what is proven of each step, and what is no log."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.generated import write_log
from helpers.loops import LOOPS, states


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
    controller, _, controls, write = log
    controls[2] += 0.1
    certified = lfo.certify_log(controller, write())
    assert [str(one) for one in certified.findings] == ["proven"] * 2 + ["deviates"] + ["proven"] * 3
    assert certified.differences[2] == pytest.approx(0.1 / controller.problem.control_tube.upper[0, 0], rel=1e-6)
    assert lfo.certify_log(controller, write(), tolerance=1.0).proven.all()


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
