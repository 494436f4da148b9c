"""A price or a limit on the part of a control in a band: its filter against scipy's, in solves, loops, C and files."""

from __future__ import annotations

import subprocess
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

import lin_freq_ocp as lfo
from helpers.generated import SANITIZERS, CompiledController, compile_command
from helpers.loops import pendulum
from helpers.seeds import expensive
from lin_freq_ocp.loop import known_states
from lin_freq_ocp.methods import compiler

notch, low_pass = lfo.spectrum.notch, lfo.low_pass
KINDS = {  # a band, and scipy's filter of what it would remove; edges in rad/sample over pi
    "notch": (notch(1.0, 0.4), 2, "bandpass", [0.8 / np.pi, 1.2 / np.pi]),
    "notch in Hz": (notch(centre_hz=2.0, width_hz=1.0), 1, "bandpass", [0.15, 0.25]),
    "low pass": (low_pass(2.0), 3, "highpass", 2.0 / np.pi),
    "high pass": (lfo.spectrum.high_pass(0.3), 1, "lowpass", 0.3 / np.pi),
    "band pass": (lfo.spectrum.band_pass(0.5, 1.5), 2, "bandstop", [0.5 / np.pi, 1.5 / np.pi]),
}
X_0 = np.array([0.05, 0.03, 0.1, 0.1])
BAND = notch(1.2, 0.8)


def problem_of(**fields) -> lfo.OptimalControlProblem:
    """Return a plant with two controls."""
    plant = lfo.LinearDynamics(
        [[1.0, 0.05], [0.0, 0.9]], [[0.0, 0.1], [0.4, 0.0]], sampling_time=0.05, control_names=["force [N]", "heat"]
    )
    cost = lfo.QuadraticCost(Q=np.eye(2), R=0.1 * np.eye(2), u_ref=[0.3, 0.0])
    given = {"control_set": lfo.Box(-1, 1), "initial_state": [1.0, 0.0]} | fields
    return lfo.OptimalControlProblem(plant, 40, cost, **given)


def outputs(problem: lfo.OptimalControlProblem, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return what the rows of filters limit, (T, filters)."""
    return np.stack([x[:-1] @ rows.C[0] + u @ rows.D[0] for rows in problem.stage_rows], axis=1)


@pytest.mark.parametrize("kind", KINDS)
def test_the_filter_is_scipys(kind):
    band, order, name, edges = KINDS[kind]
    if kind == "notch in Hz":
        edges = [0.15, 0.25]  # 1.5 and 2.5 Hz of 10 Hz
    filtered = lfo.filtered_control(problem_of(), band, order, limit=0.1)
    u = np.random.default_rng(0).uniform(-1, 1, (40, 2))
    x = lfo.simulate(filtered, u).x
    expected = signal.lfilter(*signal.butter(order, edges, name), u, axis=0)
    np.testing.assert_allclose(outputs(filtered, x, u), expected, atol=1e-9)
    assert [rows.e.tolist() for rows in filtered.stage_rows] == [[0.1, 0.1]] * 2
    white = np.random.default_rng(1).standard_normal((4000, 2))
    z = [filtered.initial_box.lower]
    for sample in white:
        z.append(filtered.dynamics.stepper(1)(0, z[-1], sample))
    assert 0.5 < np.array(z)[500:, 2:].std(axis=0).min() < 2  # states of unit size


@pytest.mark.parametrize("u_ref", [0.0, [0.3, -0.2], np.linspace(0, 1, 80).reshape(40, 2)], ids=["0", "1", "per time"])
def test_a_price_is_that_of_the_filtered_control(u_ref):
    base = problem_of()
    base = replace(base, cost=replace(base.quadratic, u_ref=u_ref))
    priced = lfo.filtered_control(base, KINDS["notch"][0], price=7.0)
    values, expected = [], []
    for seed in range(3):
        u = np.random.default_rng(seed).uniform(-1, 1, (40, 2))
        x = lfo.simulate(priced, u).x
        y = signal.lfilter(*signal.butter(2, KINDS["notch"][3], "bandpass"), u, axis=0)
        values.append(priced.value(x, u) - base.value(x[:, :2], u))
        expected.append(3.5 * (y**2).sum())
    if np.any(u_ref):  # less a constant
        values, expected = np.diff(values), np.diff(expected)
    np.testing.assert_allclose(values, expected, atol=1e-9)


def test_a_band_names_its_control_and_several_bands_add_up():
    one = lfo.filtered_control(problem_of(), lfo.spectrum.notch(1.0, 0.4, component="heat"), 1, price=2.0)
    assert one.state_names[2:] == ("heat, notch(0.8 .. 1.2 rad/sample), 1", "heat, notch(0.8 .. 1.2 rad/sample), 2")
    assert not one.linear.B[2:, 0].any()
    both = lfo.filtered_control(one, lfo.low_pass(cutoff_hz=8.0, component=0), 1, price=1.0, limit=0.2)
    assert both.state_names[-1] == "force, low_pass(0 .. 8 Hz), 1 [N]"
    assert known_states(lfo.rate_limited(both, 0.5).linear).tolist() == [False] * 2 + [True] * 5
    assert both.linear.known_states == both.state_names[2:]
    assert lfo.solve(both).status == "optimal"


def test_a_solve_keeps_the_limit_and_a_price_lowers_the_filtered_control():
    free = lfo.filtered_control(problem_of(), BAND, limit=1e3)
    plan = lfo.solve(free).trajectory
    largest = np.abs(outputs(free, plan.x, plan.u)).max(axis=0)
    limited = lfo.filtered_control(problem_of(), BAND, limit=float(largest.max() / 4))
    result = lfo.solve(limited)
    assert result.status == "optimal"
    assert np.abs(outputs(limited, result.trajectory.x, result.trajectory.u)).max() == pytest.approx(
        largest.max() / 4, rel=1e-6
    )
    priced = lfo.filtered_control(limited, lfo.spectrum.notch(1.2, 0.8001), price=50.0)
    assert lfo.solve(priced).cost > result.cost


@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("certify", ["each", "later"])
def test_a_loop_computes_the_states_of_the_filter(certify, delay):
    problem, rng = lfo.filtered_control(pendulum(20, None), BAND, price=30.0), np.random.default_rng(0)
    whole, short = (lfo.RecedingHorizon(problem, certify=certify, delay=delay) for _ in range(2))
    x, acting = np.append(X_0, np.zeros(4)), np.zeros(1)
    for k in range(6):
        u = whole.step(x)
        np.testing.assert_array_equal(short.step(x[:4]), u)
        x = problem.dynamics.stepper(1)(0, x, acting if delay else u) + np.append(
            1e-3 * rng.standard_normal(4), np.zeros(4)
        )
        acting = u
        assert short.log.steps[k].state.tolist() == whole.log.steps[k].state.tolist()
    assert np.abs(x[4:]).max() > 1e-3
    assert short.certify().satisfied.all()


def test_a_soft_limit_is_exceeded_by_the_plan_and_not_clipped():
    limited = lfo.filtered_control(pendulum(20, None), BAND, limit=1e-3)
    loop = lfo.RecedingHorizon(limited, soft={"stage_rows": 1.0})
    loop.step(X_0)
    loop.step(X_0, applied=[1.0])  # another control than that of the plan: y is beyond its limit
    step = loop.log.steps[-1]
    assert [name for name in step.excess if "notch" in name]
    np.testing.assert_array_equal(step.control, step.plan.u[0])


@expensive
@pytest.mark.skipif(compiler() is None, reason="no C compiler")
@pytest.mark.parametrize(("real", "way"), [("double", "price"), ("float", "price"), ("double", "limit")])
def test_generated_code_keeps_the_states_of_the_filter(tmp_path, real, way):
    given = {"price": 30.0} if way == "price" else {"limit": 0.05}
    problem = lfo.filtered_control(pendulum(20, None), BAND, **given)
    soft = None if way == "price" else {"stage_rows": 50.0}
    controller = lfo.RecedingHorizon(problem, soft=soft, certify="later")
    lfo.generate(controller, tmp_path, real)
    command = compile_command("-O0", *SANITIZERS, "test_controller.c", "-o", "test_controller")
    subprocess.run([*command, "-lm"], cwd=tmp_path, check=True)
    done = subprocess.run(["./test_controller", "log.csv"], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert lfo.certify_log(controller, tmp_path / "log.csv").proven.mean() > 0.9
    step, x, rng = CompiledController(tmp_path, real, 8, 1, 20), X_0, np.random.default_rng(0)
    assert step.measured == 4
    for _ in range(10):
        status, u = step.step(x)
        assert status <= 1
        np.testing.assert_allclose(u, controller.step(x), atol=1e-6 if real == "double" else 5e-3)
        step.applied(controller.log.controls[-1])
        x = pendulum(20).linear.A @ x + pendulum(20).linear.B @ u + 1e-3 * rng.standard_normal(4)
    if way == "limit":
        pushes = (0.3, 0.5, 0.7, 1.0, 1.4, 2.0, -0.5, -1.0)
        assert {0, 1} <= {step.step([0.0, 0.0, speed, speed])[0] for speed in pushes}


def test_a_problem_file_keeps_which_states_are_known(tmp_path):
    limited = lfo.filtered_control(problem_of(), BAND, limit=0.1)
    lfo.write_problem(limited, tmp_path / "filtered.toml")
    read = lfo.read_problem(tmp_path / "filtered.toml")
    assert read.linear.known_states == limited.linear.known_states
    assert lfo.solve(read).cost == lfo.solve(limited).cost
    text = (tmp_path / "filtered.toml").read_text().replace("[dynamics]", "[dynamics]\ncontinuous = true")
    (tmp_path / "continuous.toml").write_text(text)
    with pytest.raises(lfo.errors.ProblemError, match="known_states: got names; expected none of a continuous model"):
        lfo.read_problem(tmp_path / "continuous.toml")


BAD = {
    "price, limit: got neither": {},
    "price: got -1.0; expected one number above zero": {"price": -1.0},
    "limit: got 0; expected one number above zero": {"limit": 0},
    "order: got 0": {"price": 1.0, "order": 0},
    r"band: got .*stop_band.* expected a band of freq": {"price": 1.0, "band": lfo.stop_band(bins=[3])},
    r"band: got notch\(0 .. 1 rad/sample\); expected edges above zero": {"price": 1.0, "band": notch(0.5, 1.0)},
    "band.low_pass: got 11 Hz; expected at most the Nyquist": {"price": 1.0, "band": low_pass(cutoff_hz=11.0)},
    "band: got low_pass.* below half of the sampling rate": {"price": 1.0, "band": low_pass(np.pi)},
    "band.component: got 'wind'": {"price": 1.0, "band": notch(1.0, 0.4, component="wind")},
}


@pytest.mark.parametrize("message", BAD)
def test_bad_input_names_the_argument(message):
    with pytest.raises(lfo.errors.ProblemError, match=message):
        lfo.filtered_control(problem_of(), **({"band": BAND} | BAD[message]))


def test_known_states_depend_on_no_other_state():
    A, B = [[0.5, 0.0], [1.0, 0.5]], [[1.0], [0.0]]
    assert lfo.LinearDynamics(A, B, known_states=["x_0"]).known_states == ("x_0",)
    with pytest.raises(lfo.errors.ProblemError, match=r"dynamics\.known_states: got .* depend on controls"):
        lfo.LinearDynamics(A, B, known_states="x_1")
    with pytest.raises(lfo.errors.ProblemError, match=r"dynamics\.known_states: got 'z'"):
        lfo.LinearDynamics(A, B, known_states=["z"])
