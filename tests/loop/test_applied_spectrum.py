"""What is promised of the spectrum of the applied controls: in Python and in generated C, at every status."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path

import cvxpy as cp
import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.dense_kernel import WindowedDenseKernel
from helpers.generated import SANITIZERS, CompiledController, compile_command
from helpers.seeds import expensive, seeds
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.loop import control_windows, without_windows
from lin_freq_ocp.methods import SOLVED, CondensedSolver, compiler, library

if compiler() is None or library() is None:
    pytest.skip("no C compiler", allow_module_level=True)

STEP, LENGTH, HOP, HORIZON = 0.05, 16, 3, 10
BAND, AMPLITUDE = lfo.spectrum.notch(centre_hz=4, width_hz=3), 0.05
POINTS = 2 * np.pi * np.arange(8, 19) / (4 * LENGTH)  # from the last at or below 2.5 Hz to the first at or above 5.5 Hz
TAPER = np.hanning(LENGTH)
SCALE = AMPLITUDE * TAPER.sum()


def limit(amplitude: float = AMPLITUDE, **options) -> lfo.spectrum.Spectrogram:
    """Return the limit of a signal that was zero before."""
    given = {"length": LENGTH, "hop": HOP} | options
    return lfo.spectrum.closed_loop(BAND, amplitude, STEP, **({"past": np.zeros((given["length"] - 1, 1))} | given))


def drive(**fields) -> lfo.OptimalControlProblem:
    """Return a drive with a limit on the spectrum of its torque."""
    dynamics = lfo.LinearDynamics([[1.0, STEP], [0.0, 0.98]], [[0.0], [0.4]], sampling_time=STEP)
    cost = lfo.QuadraticCost(Q=np.diag([5.0, 0.5]), R=0.02, P=np.diag([100.0, 10.0]))
    given = {"control_set": lfo.Box(-1, 0.8), "initial_state": [0.0, 0.0], "control_spectrum": limit()}
    return lfo.OptimalControlProblem(dynamics, HORIZON, cost, **(given | fields))


def unstable(seed: int) -> lfo.OptimalControlProblem:
    """Return a random plant with two controls, of which both have a limit, and soft bounds of its states."""
    rng = np.random.default_rng(seed)
    plant = lfo.LinearDynamics(1.05 * np.linalg.qr(rng.standard_normal((3, 3)))[0], rng.standard_normal((3, 2)))
    plant = replace(plant, sampling_time=STEP)
    limits = [limit(0.05, length=12, hop=5, past=np.zeros((11, 2))), limit(0.1, hop=2, past=np.zeros((15, 2)))]
    return lfo.OptimalControlProblem(
        plant,
        8,
        lfo.QuadraticCost(Q=np.eye(3), R=0.1 * np.eye(2)),
        lfo.Box([-1.1, -0.7], [1.3, 0.7]),
        lfo.sets.Soft(lfo.Box(-0.5, 0.5), 100.0),
        initial_state=np.zeros(3),
        control_spectrum=[
            one.changed(bound=one.bound.changed(component=j), component=j) for j, one in enumerate(limits)
        ],
    )


def amplitudes(u: np.ndarray, length: int = LENGTH, hop: int = HOP, frequencies: np.ndarray = POINTS) -> np.ndarray:
    """Return the amplitudes of the windows of a signal from its first sample on, (windows, frequencies), by sums."""
    taper = np.hanning(length)
    waves = np.exp(-1j * np.outer(frequencies, np.arange(length))) * taper
    return np.array([2 * np.abs(waves @ u[s : s + length]) for s in range(0, len(u) - length + 1, hop)]) / taper.sum()


def after_rest(u: np.ndarray, length: int = LENGTH) -> np.ndarray:
    """Return a signal with the zeros before it that belong to its first window."""
    return np.append(np.zeros(length - 1), u)


def jumps(count: int, n: int, seed: int, largest: float = 1.0) -> np.ndarray:
    """Return measured states that jump by several orders of magnitude."""
    rng = np.random.default_rng(seed)
    return 10.0 ** rng.uniform(-2, largest, (count, 1)) * rng.standard_normal((count, n))


@pytest.mark.parametrize("options", [{}, {"max_changes": 1}, {"certify": "each"}], ids=["later", "capped", "each"])
@pytest.mark.parametrize("delay", [0, 1])
def test_every_finished_window_keeps_its_level_whatever_is_measured(options, delay):
    loop = lfo.RecedingHorizon(drive(), delay=delay, **({"certify": "later"} | options))
    for x in jumps(8 if "certify" in options else 40, 2, seed=delay):
        loop.step(x)
    log = loop.log
    found = amplitudes(after_rest(np.append(np.zeros(delay), log.controls[:, 0])))
    assert found.max(initial=0.0) <= AMPLITUDE * (1 + 1e-6)
    assert found.max() > 0.9 * AMPLITUDE
    assert set(log.statuses) <= ({"optimal"} if "certify" in options else {None, "limit"})
    assert ("limit" in log.statuses) == ("max_changes" in options)
    np.testing.assert_array_equal(np.clip(log.controls, -1, 0.8), log.controls)


def test_the_whole_plan_of_a_step_without_an_answer_keeps_bounds_rates_and_windows():
    problem = lfo.rate_limited(drive(control_spectrum=limit(0.3)), 0.3, previous=0.0)
    loop, unsettled = lfo.RecedingHorizon(problem, certify="later", max_changes=1), 0
    for x in jumps(40, 2, seed=0):
        before = np.append(0.0, loop.log.controls[:, 0])
        loop.step(x)
        step = loop.log.steps[-1]
        if step.plan is not None:
            unsettled += 1
            u = step.plan.u[:, 0]
            assert np.abs(np.diff(np.append(before[-1], u))).max() <= 0.3 + 1e-12
            assert ((u >= -1 - 1e-12) & (u <= 0.8 + 1e-12)).all()
            whole = after_rest(np.concatenate([before[1:], u, np.full(LENGTH, u[-1])]))
            assert amplitudes(whole).max() <= 0.3 * (1 + 1e-6)
    assert unsettled > 20
    # the change that would be one too many is counted, and nothing follows it
    assert max(step.changes for step in loop.log.steps[1:]) == 2


@pytest.mark.parametrize("seed", seeds(range(6)))
def test_several_controls_with_several_limits_and_soft_states(seed):
    """An unstable plant that is measured anywhere; the second limit begins a window every second sample."""
    loop = lfo.RecedingHorizon(unstable(seed), certify="later", max_changes=None if seed % 2 else 3)
    for x in jumps(30, 3, seed):
        loop.step(x)
    u = loop.log.controls
    points = 2 * np.pi * np.arange(6, 15) / 48
    assert amplitudes(after_rest(u[:, 0], 12), 12, 5, points[(points >= 0.78) & (points <= 1.73)]).max() <= 0.05 * (
        1 + 1e-6
    )
    assert amplitudes(after_rest(u[:, 1]), LENGTH, 2).max() <= 0.1 * (1 + 1e-6)
    assert seed % 2 == 0 or set(loop.certify().statuses) <= {"optimal", "infeasible_claimed"}


@expensive
def test_the_judge_proves_the_plans_of_a_log_for_the_discs():
    loop = lfo.RecedingHorizon(drive(), certify="later")
    log = loop.run([0.3, 0.0], 25, disturbance=[[0.0, 0.05]] * 25)
    plans = [step.pending for step in log.steps]
    log = loop.certify()
    assert set(log.statuses) == {"optimal"}
    assert 1e-6 < log.gaps.max() < 0.02  # polygons
    k = max(range(25), key=lambda k: sum(np.abs(one.duals).sum() for one in plans[k].plan.duals()))
    none = [replace(one, duals=0 * one.duals) for one in plans[k].plan.duals()]
    wrong = replace(plans[k], plan=replace(plans[k].plan, duals=lambda: none))
    assert wrong.certified(None).status != "optimal"
    late = replace(plans[k], spectrum=[one.with_past(np.array([[0.8], [-0.8]]), 0) for one in plans[k].spectrum])
    assert late.certified(None).status != "optimal"
    assert "at most 1.0000 of the limit" in str(log.spectra()[0]) or log.spectra()[0].ratios.max() <= 1 + 1e-6


@pytest.mark.parametrize("case", seeds(["one control", "two controls"]))
def test_both_kernels_plan_the_same_with_windows(case):
    """The NumPy kernel has every facet as a row; controls that others apply raise levels in both."""
    problem = drive() if case == "one control" else unstable(1)
    spectral = lfo.SpectralSolver(without_windows(problem))
    windows = control_windows(problem, spectral.units, 0)
    native = CondensedSolver(spectral.lti, spectral.units, windows).kernel
    dense, active, raised = WindowedDenseKernel(native.tables, windows), 0, 0
    for k, x in enumerate(jumps(24, problem.state_dim, seed=5, largest=0.0)):
        start = x / spectral.units.x
        assert [kernel.step(start) for kernel in (native, dense)] == [SOLVED, SOLVED]
        np.testing.assert_allclose(native.plan_of_controls, dense.controls, rtol=0, atol=1e-9)
        dense.controls = native.plan_of_controls  # so that differences do not add up
        duals = native.window_duals()
        active, raised = active + sum(len(one.duals) for one in duals), raised + (native.raised > 1e-6)
        acting = native.control * (1 if k % 8 else -0.5)
        for kernel in (native, dense):
            kernel.apply(acting)
    assert active > 24
    assert 3 < raised < 24


@pytest.mark.parametrize("band", ["around 4 Hz", "below 1.5 Hz"])
def test_a_plan_is_that_of_the_program_with_the_same_polygons(band):
    """Windows that have begun before the plan ends, on applied samples, its own, and its last one held."""
    hop, amplitude, points, spectrum = HOP, AMPLITUDE, POINTS, limit()
    if band == "below 1.5 Hz":  # where a held control has most of its spectrum; windows begin rarely
        hop, amplitude, points = 12, 0.3, 2 * np.pi * np.arange(6) / (4 * LENGTH)
        low = lfo.spectrum.high_pass(cutoff_hz=1.5)
        spectrum = lfo.spectrum.closed_loop(low, amplitude, STEP, LENGTH, hop, past=np.zeros(LENGTH - 1))
    loop = lfo.RecedingHorizon(drive(control_spectrum=spectrum), certify="later")
    noise = np.random.default_rng(0).normal(scale=[0.01, 0.2], size=(20, 2))
    log = loop.run([0.3, 0.0], 20, disturbance=noise)
    before, x_0 = log.controls[:, 0], np.array([0.2, -0.3] if band == "around 4 Hz" else [2.0, 0.0])
    loop.step(x_0)
    plan = loop.log.steps[-1].planned
    problem, x, u = loop.problem, cp.Variable((HORIZON + 1, 2)), cp.Variable(HORIZON)
    A, B, cost = problem.linear.A, problem.linear.B[:, 0], problem.quadratic
    rows = [x[0] == x_0, u >= -1, u <= 0.8, x[1:].T == A @ x[:-1].T + np.outer(B, np.ones(HORIZON)) @ cp.diag(u)]
    whole, first = cp.hstack([np.zeros(LENGTH - 1), before, u, u[-1] * np.ones(LENGTH)]), LENGTH - 1 + len(before)
    turns = np.exp(-2j * np.pi * np.arange(16) / 16)[:, None]
    for begin in [*range(0, first + HORIZON, hop), first + HORIZON - 1]:
        if begin + LENGTH > first:
            for w in points:
                facets = (turns * TAPER * np.exp(-1j * w * np.arange(LENGTH))).real
                rows.append(facets @ whole[begin : begin + LENGTH] <= amplitude * TAPER.sum() / 2 * np.cos(np.pi / 16))
    stages = cp.sum_squares(x[:-1] @ np.sqrt(cost.Q)) + 0.02 * cp.sum_squares(u)
    stages += cp.sum_squares(np.sqrt(cost.P) @ x[-1])
    cp.Problem(cp.Minimize(stages), rows).solve(cp.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-11, tol_feas=1e-11)
    np.testing.assert_allclose(plan.u[:, 0], u.value, atol=1e-6)
    assert np.abs(plan.u[:, 0] - loop_without_limit(x_0)).max() > 0.01
    if band == "below 1.5 Hz":
        assert abs(plan.u[-1, 0]) == pytest.approx(amplitude / 2 * np.cos(np.pi / 16))  # a constant has twice its value


def loop_without_limit(x_0: np.ndarray) -> np.ndarray:
    return lfo.solve(drive(control_spectrum=None).with_ends(x_0)).control[:, 0]


@expensive
@pytest.mark.parametrize("delay", [0, 1])
def test_a_past_that_broke_its_level_is_reported_and_over_after_a_window(delay):
    loop, rng = lfo.RecedingHorizon(drive(), certify="later", delay=delay), np.random.default_rng(1)
    acted = [0.0] * delay
    for k in range(60):
        applied = [float(np.sign(np.sin(2 * np.pi * 4 * STEP * k)))] if 10 < k <= 18 else None
        u = loop.step(0.2 * rng.standard_normal(2), applied=applied)
        if applied:
            acted[k - 1] = applied[0]
        acted.append(float(u[0]))
    log = loop.certify()
    raised = np.flatnonzero([step.raised for step in log.steps])
    assert raised[0] in (11, 12, 13, 14)
    assert raised[-1] < 19 + LENGTH
    assert set(log.statuses) == {"optimal"}
    assert f"exceeds a level at {len(raised)} steps" in str(log)
    found = amplitudes(after_rest(np.array(acted))).max(axis=1)
    begins = HOP * np.arange(len(found)) - LENGTH + 1
    assert found[begins > 18].max() <= AMPLITUDE * (1 + 1e-6)
    assert found.max() > 2 * AMPLITUDE
    np.testing.assert_array_equal(log.acted[:, 0], acted[:60])


@expensive
def test_a_past_of_the_user_and_previews_count():
    past = 0.04 * np.cos(2 * np.pi * 4 * STEP * np.arange(LENGTH - 1))
    loop = lfo.RecedingHorizon(drive(control_spectrum=limit(past=past)), certify="later")
    ahead = 0.3 * np.sin(0.1 * np.arange(60))[:, None] * [1.0, 0.0]
    log = loop.run([0.0, 0.0], 30, references={"x_ref": ahead})
    assert not log.stopped
    found = amplitudes(np.append(past, log.controls[:, 0]))
    assert 0.9 * AMPLITUDE < found.max() <= AMPLITUDE * (1 + 1e-6)
    assert set(loop.certify().statuses) == {"optimal"}
    tracked = np.abs(log.states[5:30, 0] - ahead[5:30, 0]).mean()
    assert tracked < np.abs(ahead[5:30, 0]).mean()


def test_a_given_past_above_its_level_is_a_warning():
    past = 0.2 * np.cos(2 * np.pi * 4 * STEP * np.arange(LENGTH - 1))
    loop = lfo.RecedingHorizon(drive(control_spectrum=limit(past=past)), certify="later")
    with pytest.warns(lfo.errors.ClosedLoopWarning, match=r"past exceeds the level of a window by 30\d % at step 0"):
        loop.step([0.1, 0.0])
    loop.step([0.1, 0.0])
    assert [step.raised for step in loop.log.steps] == [True, True]


@expensive
@pytest.mark.parametrize("certify", ["later", "each"])
def test_previewed_bounds_that_widen_and_windows_hold_together(certify):
    """The rest of a plan keeps wider bounds, too: a plan exists at every step."""
    loop, steps = lfo.RecedingHorizon(drive(), certify=certify), 40 if certify == "later" else 12
    widths = np.where(np.arange(steps + HORIZON) < steps // 2, 0.1, 1.0)[:, None]
    for k, x in enumerate(jumps(steps, 2, seed=4)):
        ahead = widths[k : k + HORIZON]
        loop.step(x, bounds={"control_set": lfo.Box(-ahead, 0.8 * ahead)})
    u = loop.log.controls[:, 0]
    assert (-widths[:steps, 0] <= u).all()
    assert (u <= 0.8 * widths[:steps, 0]).all()
    assert np.abs(u).max() > 0.1
    assert amplitudes(after_rest(u)).max(initial=0.0) <= AMPLITUDE * (1 + 1e-6)
    assert set(loop.log.statuses) == {"optimal" if certify == "each" else None}
    with pytest.raises(lfo.errors.UnsupportedError, match="bounds: they bound other components"):
        loop.step([0.0, 0.0], bounds={"state_set": lfo.Box(-10, 10)})


def test_previewed_bounds_that_shrink_at_once_prevail_over_windows():
    loop = lfo.RecedingHorizon(drive(), certify="later")
    for k, x in enumerate(jumps(30, 2, seed=4)):
        loop.step(x, bounds={"control_set": lfo.Box(-0.02, 0.02)} if k >= 20 else None)
    assert np.abs(loop.log.controls[20:]).max() <= 0.02
    assert "infeasible_claimed" in loop.log.statuses


def test_a_time_limit_ends_a_step_and_all_windows_keep_their_level():
    loop = lfo.RecedingHorizon(drive(), certify="later", time_limit=1.0)
    with use_clock(Clock(per_look=0.4)):
        for x in jumps(40, 2, seed=0):
            loop.step(x)
    log = loop.log
    assert {None, "limit"} >= set(log.statuses) >= {"limit"}
    assert log.statuses[0] is None  # the first step has no limit
    assert 0.9 * AMPLITUDE < amplitudes(after_rest(log.controls[:, 0])).max() <= AMPLITUDE * (1 + 1e-6)


@expensive
@pytest.mark.parametrize("seed", range(2))
def test_a_loop_costs_no_more_than_with_exact_cones(seed):
    """The same loop by Clarabel, with discs in place of polygons and the same rows on windows of the past."""
    problem, rng = drive(), np.random.default_rng(seed)
    loop, steps = lfo.RecedingHorizon(problem, certify="later"), 40
    noise = rng.normal(scale=[0.003, 0.06], size=(steps, 2))
    A, B, cost = problem.linear.A, problem.linear.B[:, 0], problem.quadratic
    costs, found = {}, {}
    for name in ("kernel", "cones"):
        x, applied, total = np.array([0.3, 0.0]), np.zeros(LENGTH - 1), 0.0
        for k in range(steps):
            if name == "kernel":
                (control,) = loop.step(x)
            else:
                control = exact_control(x, applied, A, B, cost)
            total += 0.5 * (x @ cost.Q @ x + 0.02 * control**2)
            applied, x = np.append(applied, control), A @ x + B * control + noise[k]
        costs[name], found[name] = total + 0.5 * x @ cost.P @ x, amplitudes(applied).max()
    assert found["kernel"] <= AMPLITUDE * (1 + 1e-6)
    assert found["cones"] == pytest.approx(AMPLITUDE, rel=1e-3)
    assert costs["kernel"] <= 1.01 * costs["cones"]


def exact_control(x_0: np.ndarray, applied: np.ndarray, A: np.ndarray, B: np.ndarray, cost) -> float:
    """Return u_0 of the plan whose windows are in discs, after applied controls that begin LENGTH - 1 before time 0."""
    x, u, rows = x_0, cp.Variable(HORIZON), []
    stages = 0.0
    for t in range(HORIZON):
        stages += 0.5 * cp.quad_form(x, cost.Q) + 0.01 * cp.square(u[t]) if t else 0.01 * cp.square(u[0])
        x = A @ x + B * u[t]
    stages += 0.5 * cp.quad_form(x, cost.P)
    whole, first = cp.hstack([applied, u, u[-1] * np.ones(LENGTH)]), len(applied)
    waves = np.exp(-1j * np.outer(POINTS, np.arange(LENGTH))) * TAPER
    for begin in [*range(0, first + HORIZON, HOP), first + HORIZON - 1]:
        if begin + LENGTH > first:
            window = whole[begin : begin + LENGTH]
            rows += [cp.norm(cp.hstack([wave.real @ window, wave.imag @ window])) <= 1 for wave in waves * 2 / SCALE]
    cp.Problem(cp.Minimize(stages), [u >= -1, u <= 0.8, *rows]).solve(cp.CLARABEL)
    return float(u.value[0])


@expensive
@pytest.mark.parametrize("kind", ["frequencies", "windows"])
def test_between_points_and_windows_the_amplitude_is_within_what_is_printed(tmp_path, kind):
    """Signals that are as bad as possible: signs of the wave at a point between others, in a window between others."""
    promise, at_end = lfo.generate(lfo.RecedingHorizon(drive()), tmp_path).promises
    level, at_others, in_others = (float(word) for word in promise.replace(",", "").split() if word[0].isdigit())
    assert level == AMPLITUDE
    held = 2 * np.abs(np.exp(-1j * np.outer(POINTS, np.arange(LENGTH))) @ TAPER).max() / TAPER.sum()  # of a constant 1
    assert at_end.startswith(f"plans end with at most {AMPLITUDE / held:.3g}: only from an amplitude of {held:.3g} on")
    rng, worst = np.random.default_rng(0), 0.0
    for _ in range(100):
        w, shift = rng.uniform(POINTS[0], POINTS[-1]), int(rng.integers(1, HOP))
        u = np.sign(np.cos(w * np.arange(4 * LENGTH) + rng.uniform(0, 6)) + 0.3 * rng.standard_normal(4 * LENGTH))
        known = amplitudes(u)
        if kind == "frequencies":
            worst = max(worst, float((amplitudes(u, frequencies=np.array([w])) - known.max(1)[:, None]).max()))
        else:
            others = amplitudes(u[shift:])[: len(known) - 1]
            worst = max(worst, float((others - np.maximum(known[:-1], known[1:])).max()))
    assert 0 < worst <= (at_others if kind == "frequencies" else in_others)


@cache
def generated(folder: Path, real: str, rate: bool, delay: int) -> CompiledController:
    problem = drive()
    if rate:
        problem = lfo.rate_limited(problem, 0.37, previous=0.0)
    controller = lfo.RecedingHorizon(problem, delay=delay)
    lfo.generate(controller, folder, real, changes=4)
    command = compile_command("-O0", *SANITIZERS, "test_controller.c", "-o", "test_controller")
    subprocess.run([*command, "-lm"], cwd=folder, check=True)
    return CompiledController(folder, real, problem.state_dim, 1, HORIZON)


@expensive
@pytest.mark.parametrize(("real", "rate", "delay"), [("double", False, 1), ("float", True, 0), ("double", True, 0)])
def test_generated_code_keeps_every_window_at_every_status(tmp_path, real, rate, delay):
    """States jump and are none; of what acts, all windows keep their level but those in which another control acted."""
    step = generated(tmp_path, real, rate, delay)
    done = subprocess.run(["./test_controller", "log.csv"], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    rng, acted, statuses = np.random.default_rng(0), [0.0] * delay, set()
    for k, x in enumerate(jumps(80, 2, 3, largest=4.0)):
        x[0] = np.nan if k % 7 == 3 else x[0]
        status, (u,) = step.step(x)
        statuses.add(status)
        assert -1 <= u <= 0.8
        if rate and acted:
            assert abs(u - acted[-1]) <= 0.37 + (1e-7 if real == "float" else 1e-16)
        if k == 30:
            u = step.dtype.type(np.clip(u + rng.choice([-0.05, 0.05]), -1, 0.8))
            step.applied(np.array([u]))
        acted.append(float(u))
    found = amplitudes(after_rest(np.array(acted))).max(axis=1)
    begins = HOP * np.arange(len(found)) - LENGTH + 1
    clear = (begins > 30 + delay) | (begins + LENGTH <= 30 + delay)
    assert found[clear].max() <= AMPLITUDE * (1.001 if real == "float" else 1 + 1e-6)
    assert {2, 4} <= statuses


@expensive
def test_the_log_of_a_generated_controller_has_proofs_and_windows(tmp_path):
    controller = lfo.RecedingHorizon(drive())
    lfo.generate(controller, tmp_path)
    subprocess.run(
        [*compile_command("-O0", "test_controller.c", "-o", "test_controller"), "-lm"], cwd=tmp_path, check=True
    )
    subprocess.run(["./test_controller", "log.csv"], cwd=tmp_path, check=True, capture_output=True)
    lines = (tmp_path / "log.csv").read_text().splitlines()[:31]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    log = lfo.certify_log(controller, tmp_path / "log.csv")
    assert log.proven.all()
    found = amplitudes(after_rest(log.controls[:, 0]))
    assert log.windows[0].ratios.max() == pytest.approx(found.max() / AMPLITUDE)
    assert f"applied windows of torque: at most {found.max() / AMPLITUDE:.3f}" in str(log).replace("u_0", "torque")


REFUSED = {
    "control_spectrum: .*soft": lambda: lfo.RecedingHorizon(drive(), soft={"control_spectrum": 10.0}),
    "control_spectrum: energy": lambda: lfo.RecedingHorizon(
        drive(control_spectrum=lfo.spectrum.Spectrogram(lfo.spectrum.EnergyBound(1.0, band=BAND), 8))
    ),
    "control_spectrum: .*all samples after": lambda: lfo.RecedingHorizon(
        drive(control_spectrum=lfo.spectrum.Spectrogram(lfo.MagnitudeBound(1.0, band=BAND), past=np.zeros(3)))
    ),
    "state_spectrum": lambda: lfo.RecedingHorizon(drive(state_spectrum=limit(past=None, length=8, hop=2))),
    "control_set: bounds without 0": lambda: lfo.RecedingHorizon(drive(control_set=lfo.Box(0.1, 0.8))),
    "control_set: bounds that differ": lambda: lfo.RecedingHorizon(
        drive(control_set=lfo.Box(-np.linspace(1, 0.5, HORIZON)[:, None], np.ones((HORIZON, 1))))
    ),
}


@pytest.mark.parametrize("field", REFUSED)
@pytest.mark.filterwarnings("ignore::lin_freq_ocp.errors.ClosedLoopWarning")
def test_windows_that_generated_code_does_not_keep_are_refused_by_field(tmp_path, field):
    with pytest.raises(lfo.errors.UnsupportedError, match=f"generate: {field}"):
        lfo.generate(REFUSED[field](), tmp_path)


def test_bounds_without_a_first_plan_are_a_warning():
    with pytest.warns(lfo.errors.ClosedLoopWarning, match="control_set: bounds without 0"):
        lfo.RecedingHorizon(drive(control_set=lfo.Box(0.1, 0.8)))


@expensive
def test_without_a_compiler_programs_plan_with_the_same_windows(no_compiler):
    noise = np.random.default_rng(0).normal(scale=[0.01, 0.1], size=(12, 2))
    with no_compiler("kernel.c could not be compiled"):
        log = lfo.RecedingHorizon(drive()).run([0.3, 0.0], 12, disturbance=noise)
    assert not log.stopped
    assert set(log.statuses) == {"optimal"}
    by_kernel = lfo.RecedingHorizon(drive()).run([0.3, 0.0], 12, disturbance=noise)
    np.testing.assert_allclose(log.controls, by_kernel.controls, atol=0.1)


@expensive
@pytest.mark.parametrize("deviation", [1e-6, 1e-12])
def test_plans_near_a_set_point_far_from_zero_are_proven(deviation):
    controller = lfo.RecedingHorizon(drive().with_references({"x_ref": [0.6, 0.0]}), certify="each")
    loop = controller.run([0.6 + deviation, 0.0], steps=12)
    assert [str(status) for status in loop.statuses] == ["optimal"] * 12
