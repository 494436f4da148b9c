"""The commands generate and certify-log: their files, exit statuses and refusals."""

from __future__ import annotations

import re
import subprocess

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.command_line import run
from helpers.compilers import needs_kernel
from helpers.generated import compile_command, write_log
from helpers.seeds import expensive

WORDS = ("double_integrator", "--set", "horizon=30", "--set", "terminal_state=[0.0, 0.0]")


@needs_kernel
def test_a_controller_is_written_and_its_log_is_judged(tmp_path):
    folder = tmp_path / "controller"
    status, out, err = run("generate", *WORDS, str(folder), "--real", "float", "--memory", "64k", "--delay", "1")
    assert status == 0
    assert err.startswith("warning: control_spectrum: holds for each plan")
    assert "in float" in out
    assert f"next: make -C {folder}" in out
    sources = {"controller.h", "controller.c", "lfo_kernel.h", "lfo_kernel.c", "lfo_settings.h", "test_controller.c"}
    assert {file.name for file in folder.iterdir()} == sources | {"Makefile", "README.md"}
    controller = lfo.RecedingHorizon(lfo.library.double_integrator(horizon=30, terminal_state=[0.0, 0.0]))
    states = np.array([[0.01, 0.0], [0.0, 0.02]])
    controls = np.array([controller.step(x) for x in states])
    log = write_log(tmp_path / "log.csv", states, controls, [0, 0])
    assert run("certify-log", *WORDS, str(log))[:2] == (0, lfo.certify_log(controller, log).__str__() + "\n")
    write_log(log, states, controls + 0.2, [0, 0])
    status, out, _ = run("certify-log", *WORDS, str(log))
    assert status == 3
    assert "2 deviates" in out


@needs_kernel
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--memory", "2k"), "memory: got 2048 bytes; expected at least"),
        (("--real", "half"), "real: got 'half'"),
        (("--changes", "-1"), "changes: got -1"),
        (("--soft", "state_set"), "--soft state_set: got no penalty"),
        (("--soft", "state_set=much"), "--soft state_set=much: got 'much'"),
        (("--soft", "control_set=1"), "soft.control_set"),
        (("--delay", "2"), "delay: got 2"),
    ],
)
def test_bad_options_have_a_message_and_write_nothing(tmp_path, arguments, message):
    status, out, err = run("generate", *WORDS, str(tmp_path / "controller"), *arguments)
    assert (status, out) == (2, "")
    assert message in err
    assert not (tmp_path / "controller").exists()


def test_a_problem_of_another_class_is_refused_by_field(tmp_path):
    status, _, err = run("generate", "cart_pole_with_walls", str(tmp_path / "controller"))
    assert status == 2
    assert "generate: dynamics: got PiecewiseAffineDynamics" in err


def test_a_log_that_does_not_exist(tmp_path):
    status, _, err = run("certify-log", *WORDS, str(tmp_path / "no.csv"))
    assert status == 2
    assert "a log that can be read" in err


DRIVE = """
schema = 2
horizon = 20
initial_state = [0.3, 0.0]
control_set = {kind = "box", lower = -1.0, upper = 1.0}

[dynamics]
A = [[1.0, 0.005], [0.0, 0.9975]]
B = [[1.25e-5], [0.005]]
sampling_time = 0.005
control_names = ["torque [Nm]"]

[cost]
Q = [[40.0, 0.0], [0.0, 1.0]]
R = 0.02
P = [[2000.0, 0.0], [0.0, 100.0]]

[control_spectrum]
kind = "spectrogram"
length = 40
hop = 5
past = 0

[control_spectrum.bound]
kind = "magnitude_bound"
amplitude = 0.03
window = "hann"
oversampling = 4
edges = true
band = {kind = "notch", centre_hz = 12.0, width_hz = 8.0}
"""


@expensive
@needs_kernel
def test_windows_of_a_problem_file_are_kept_in_c_and_measured_from_its_log(tmp_path):
    file, folder = tmp_path / "drive.toml", tmp_path / "controller"
    file.write_text(DRIVE)
    status, out, _ = run("generate", str(file), str(folder))
    assert (status, "applied torque: amplitude at most 0.03 at the points of its windows" in out) == (0, True)
    subprocess.run(
        [*compile_command("-O1", "test_controller.c", "-o", "test_controller"), "-lm"], cwd=folder, check=True
    )
    subprocess.run(["./test_controller", "log.csv"], cwd=folder, check=True, capture_output=True)
    status, out, _ = run("certify-log", str(file), str(folder / "log.csv"))
    assert (status, "100 proven" in out) == (0, True)
    (ratio,) = re.findall(r"applied windows of torque \[Nm\]: at most ([0-9.]+) of the limit", out)
    assert 0.5 < float(ratio) <= 1.001
