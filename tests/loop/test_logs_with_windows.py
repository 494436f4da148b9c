"""Logs of generated controllers with windows: in float, rounding decides the last samples of a window."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.generated import CompiledController, write_log
from helpers.seeds import expensive
from lin_freq_ocp.loop import known_states
from lin_freq_ocp.methods import compiler, library

if compiler() is None or library() is None:
    pytest.skip("no C compiler", allow_module_level=True)

STEP, STEPS = 0.005, 60


def drive(x_unit: float = 1.0, u_unit: float = 1.0, cost_unit: float = 1.0, **fields) -> lfo.OptimalControlProblem:
    """Return a rigid drive at 200 Hz whose torque is limited at 12 to 37 Hz in windows of 40 samples."""
    dynamics = lfo.LinearDynamics.from_continuous([[0, 1], [0, -0.5]], [[0], [x_unit / u_unit]], STEP)
    Q, P = (cost_unit / x_unit**2 * np.diag(weights) for weights in ([40.0, 1.0], [2000.0, 100.0]))
    limit = lfo.spectrum.closed_loop(
        lfo.spectrum.notch(centre_hz=25, width_hz=25), 0.03 * u_unit, STEP, length=40, hop=5, past=0
    )
    given = {"control_set": lfo.Box(-u_unit, u_unit), "initial_state": [0, 0], "control_spectrum": limit} | fields
    return lfo.OptimalControlProblem(dynamics, 20, lfo.QuadraticCost(Q=Q, R=0.02 * cost_unit / u_unit**2, P=P), **given)


def two_controls() -> lfo.OptimalControlProblem:
    """Return the drive with two torques, each with its limit."""
    one = drive()
    dynamics = lfo.LinearDynamics(one.linear.A, one.linear.B * [0.7, 0.3], sampling_time=STEP)
    cost = lfo.QuadraticCost(Q=one.quadratic.Q, R=0.02 * np.eye(2), P=one.quadratic.P)
    return replace(one, dynamics=dynamics, cost=cost, control_set=lfo.Box(-1, 1))


CASES = {
    "bounds": lambda: lfo.RecedingHorizon(drive()),
    "no bounds": lambda: lfo.RecedingHorizon(drive(control_set=None)),
    "delay": lambda: lfo.RecedingHorizon(drive(), delay=1),
    "rate limit": lambda: lfo.RecedingHorizon(lfo.rate_limited(drive(), 0.5, previous=0.0)),
    "soft bounds": lambda: lfo.RecedingHorizon(drive(state_set=lfo.Box([-2, -0.4], [2, 0.4])), soft={"state_set": 1e3}),
    "hard bounds": lambda: lfo.RecedingHorizon(drive(state_set=lfo.Box([-2, -0.06], [2, 0.06]))),
    "tight rate limit": lambda: lfo.RecedingHorizon(lfo.rate_limited(drive(), 0.05, previous=0.0)),
    "two controls": lambda: lfo.RecedingHorizon(two_controls()),
    "small and large units": lambda: lfo.RecedingHorizon(drive(1e9, 1e-9, 1e-6)),
    "references": lambda: lfo.RecedingHorizon(drive()),
}
HALF_RANGE = {"two controls": 1.0, "small and large units": 1e-9}


def test_noise_of_a_float_state_far_from_zero_is_no_deviation(tmp_path):
    """A state of 1000 in float is rounded by 3e-5: near its set point, the control is rounding alone."""
    controller = lfo.RecedingHorizon(drive().with_references({"x_ref": [1e3, 0.0]}))
    states = np.array([[1e3 + 6.1e-5 * (k % 3 - 1), 0.0] for k in range(12)])
    loop = lfo.RecedingHorizon(drive().with_references({"x_ref": [1e3, 0.0]}), certify="later")
    controls = np.array([loop.step(x + np.array([2e-5, 0.0])) for x in states])
    path = write_log(tmp_path / "log.csv", states, controls, [0] * 12, digits=8)
    assert lfo.certify_log(controller, path, tolerance=1e-3).proven.all()
    path = write_log(tmp_path / "log.csv", states[:1], controls[:1] + 0.1, [0], digits=8)
    assert not lfo.certify_log(controller, path, tolerance=1e-3).proven.any()


def log_in_float(controller: lfo.RecedingHorizon, folder: Path, references: bool, unit: float = 1.0) -> dict:
    """Return states, controls, statuses and references of a loop with a controller that is generated in float."""
    problem, rng, rows = controller.problem, np.random.default_rng(0), []
    lfo.generate(controller, folder, "float", references=references)
    known, (n, m) = known_states(problem.linear), (problem.state_dim, problem.control_dim)
    step, acting = CompiledController(folder, "float", n, m, problem.horizon, references), np.zeros(m)
    x = np.where(known, 0.0, unit * np.resize([0.3, 0.0], n))
    for k in range(STEPS):
        noise = unit * np.resize([2e-4, 5e-3], n) * rng.standard_normal(n)
        measured = (x + noise)[~known].astype(np.float32).astype(float)
        reference = np.array([0.1 * (k > 30), 0.0]) if references else None
        status, u = step.step(measured, reference)
        rows.append((measured, u, status, [] if reference is None else reference.astype(np.float32)))
        x = problem.linear.A @ x + problem.linear.B @ (acting if controller.delay else u)
        acting = u
    states, controls, statuses, given = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    return {"states": states, "controls": controls, "statuses": statuses, "references": given if references else None}


@expensive
@pytest.mark.parametrize("case", CASES)
def test_a_float_log_is_proven_and_a_control_that_is_wrong_by_a_thousandth_is_not(tmp_path, case):
    controller, half = CASES[case](), HALF_RANGE.get(case, 1.0)
    log = log_in_float(controller, tmp_path, case == "references", 1e9 if "units" in case else 1.0)
    path = write_log(tmp_path / "log.csv", **log, digits=9)
    certified, planned = lfo.certify_log(controller, path, tolerance=1e-3), log["statuses"] <= 1
    np.testing.assert_array_equal(certified.proven, planned)
    assert certified.differences[planned].max() <= 1e-3
    assert planned.all() == (case != "hard bounds")  # which contradict each other after some steps
    for k in np.flatnonzero(planned)[[3, 15, -1]]:
        wrong = {name: None if part is None else part[: k + 1].copy() for name, part in log.items()}
        wrong["controls"][k] *= 1 - 2e-3 * half / np.abs(wrong["controls"][k]).max()
        certified = lfo.certify_log(controller, write_log(path, **wrong, digits=9), tolerance=1e-3)
        np.testing.assert_array_equal(certified.proven, planned[: k + 1] & (np.arange(k + 1) < k))


def test_a_control_without_a_plan_that_keeps_the_levels_is_not_proven_whatever_the_tolerance(tmp_path):
    controller = lfo.RecedingHorizon(drive(), certify="later")
    loop = controller.run([0.3, 0.0], 12)
    controls = loop.controls.copy()
    controls[8:10] = [[1.0], [-1.0]]
    path = write_log(tmp_path / "log.csv", loop.states[:-1], controls, [0] * 12)
    certified = lfo.certify_log(controller, path, tolerance=10.0)
    assert certified.proven[:8].all()
    assert not certified.proven[8:10].all()
    assert np.isinf(certified.differences[8:10]).any()


def test_after_another_control_the_levels_are_those_that_the_controller_raises(tmp_path):
    controller = lfo.RecedingHorizon(drive(), certify="later")
    x, states, controls, statuses = np.array([0.3, 0.0]), [], [], []
    for k in range(50):
        u = controller.step(x, applied=controls[-1] if k == 9 else None)
        statuses.append(int(controller.log.steps[-1].raised))
        states.append(x)
        controls.append(u + 0.2 if k == 8 else u)
        x = controller.problem.linear.A @ x + controller.problem.linear.B @ controls[-1]
    certified = lfo.certify_log(
        controller, write_log(tmp_path / "log.csv", np.array(states), np.array(controls), statuses)
    )
    assert 0 < sum(statuses) <= 40
    np.testing.assert_array_equal(certified.proven, np.arange(50) != 8)
