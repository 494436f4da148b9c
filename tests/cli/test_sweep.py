"""The command sweep: one JSON object, a folder, and an exit status."""

from __future__ import annotations

import json
import signal
import threading
from dataclasses import replace

import pytest

import lin_freq_ocp as lfo
from helpers.command_line import parsed, run
from helpers.replacing import substitute
from helpers.schemas import SWEEP, faults
from helpers.seeds import expensive
from helpers.sweeps import SHORT, assert_same, broken_builder
from lin_freq_ocp.files import sweep_summary
from lin_freq_ocp.solving import solve_judged

WORDS = ("double_integrator", "--set", "horizon=60", "--set", "sampling_time=0.1")


@expensive
def test_the_command_prints_one_object_and_writes_the_folder(serial, tmp_path):
    grids = ("--grid", 'cutoff_hz=["none", 0.2, 1.0, 3.0]', "--grid", "control_bound=[0.2, 1.0]")
    status, out, err = run("sweep", *WORDS, *grids, "--workers", "2", "--out", str(tmp_path / "out"), "--json")
    summary = parsed(out)
    assert (status, err) == (0, "")
    assert faults(SWEEP, summary) == []
    assert {file.name for file in (tmp_path / "out").iterdir()} == {
        "index.html",
        "sweep.jsonl",
        "sweep.csv",
        "sweep.png",
        "sweep.svg",
    }
    assert_same(lfo.load_sweep(tmp_path / "out" / "sweep.jsonl"), serial)
    status, out, _ = run("sweep", *WORDS, *grids, "--out", str(tmp_path / "out"))
    assert status == 0
    assert "8 of 8 points" in out
    assert "infeasible" in out


def test_the_summary_of_any_sweep_is_valid():
    found = lfo.sweep(broken_builder, {"horizon": [2, 60]}, time_limit=60)
    assert faults(SWEEP, json.loads(json.dumps(sweep_summary(found)))) == []
    assert faults(SWEEP, {**sweep_summary(found), "schema": 2}) != []


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (("--grid", "cutoff_hz=[1.0, 2.0]"), 0, "2 of 2 points"),
        (("--grid", "cutoff_hz=1:2:2", "--grid", "horizon=60:80:2"), 0, "4 of 4 points"),
        (("--grid", "horizon=[60, -1]"), 3, "horizon: got -1"),
        (("--grid", "cutof=[1.0]"), 2, "Did you mean"),
        (("--grid", "horizon=60"), 2, "horizon=[60]"),
        (("--grid", "horizon"), 2, "KEY=from:to:count"),
        (("--grid", "horizon=[60"), 2, "KEY=from:to:count"),
        (("--grid", "horizon=a:b:3"), 2, "KEY=from:to:count"),
        (("--grid", "horizon=[60]", "--grid", "horizon=[70]"), 2, "this key twice"),
        ((), 2, "--grid"),
    ],
)
def test_exit_status_of_the_command(arguments, status, words):
    ended, out, err = run("sweep", *WORDS, *arguments)
    assert (ended, words in out + err) == (status, True)


@expensive
def test_the_command_says_which_points_are_not_proven(monkeypatch):
    substitute(monkeypatch, "methods.repair_trajectory", lambda *given: None)
    substitute(monkeypatch, "methods.corrections", lambda *given: ())
    status, out, _ = run(
        "sweep", "pendulum", "--grid", "control_bound=[5.0]", "--tolerance", "10", "--method", "spectral"
    )
    assert status == 3
    assert "breaks" in out


@expensive
def test_ctrl_c_ends_the_command_with_130(tmp_path, monkeypatch):
    honest, pressed = solve_judged, threading.Event()

    def interrupted(*given, **named):
        if pressed.is_set():
            signal.raise_signal(signal.SIGINT)
        pressed.set()
        return honest(*given, **named)

    substitute(monkeypatch, "solving.solve_judged", interrupted)
    arguments = ("sweep", *WORDS, "--grid", "horizon=60:80:3", "--out", str(tmp_path), "--json")
    status, out, _ = run(*arguments)
    summary = parsed(out)
    assert (status, summary["interrupted"], len(summary["points"])) == (130, True, 1)
    monkeypatch.undo()
    status, out, _ = run(*arguments)
    assert (status, len(parsed(out)["points"])) == (0, 3)


@expensive
def test_a_problem_file_is_swept_by_its_keys(tmp_path):
    lfo.write_problem(replace(SHORT(), name=""), tmp_path / "cart.toml")
    arguments = ("sweep", str(tmp_path / "cart.toml"), "--set", "horizon=70")
    grids = ("--grid", "control_set.upper=[0.3, 1.0]", "--grid", "cutoff_hz=[1.0]")
    status, out, _ = run(*arguments, *grids, "--json", "--out", str(tmp_path / "out"))
    summary = parsed(out)
    assert (status, summary["problem"]) == (0, "cart")
    for row in summary["points"]:
        upper = row["parameters"]["control_set.upper"]
        problem = replace(SHORT(horizon=70, cutoff_hz=1.0), control_set=lfo.Box(-1.0, upper))
        assert row["cost"] == pytest.approx(lfo.solve(problem).cost, rel=1e-9)
    status, _, err = run(*arguments, "--grid", "contrl_set.upper=[1.0]")
    assert status == 2
    assert "Did you mean 'control_set'" in err


def test_numbers_of_limits_of_a_file_are_set_and_swept(tmp_path):
    path = tmp_path / "move.toml"
    path.write_text(
        "schema = 1\nhorizon = 9\ninitial_state = [0, 0]\nterminal_state = [4, 0]\n"
        "[dynamics]\nA = [[1, 1], [0, 1]]\nB = [[0], [1]]\n"
        "[cost]\nR = 1.0\n[control_set]\nlower = -1\nupper = 1\n"
        "[[control_spectrum]]\nkind = 'magnitude_bound'\nlimit = 2.0\nbins = [3]\n"
    )

    def cost(*settings):
        status, out, err = run("solve", str(path), "--json", *settings)
        assert (status, err) == (0, "")
        return parsed(out)["cost"]

    by_number = cost("--set", "bound.0=0.4", "--set", "level.control_spectrum.0=-20")
    assert by_number == pytest.approx(
        cost(
            *("--set", "control_set.lower=-0.4", "--set", "control_set.upper=0.4"),
            *("--set", "control_spectrum=[{kind='magnitude_bound', limit=0.2, bins=[3]}]"),
        ),
        rel=1e-6,
    )
    assert by_number > cost() + 1e-3
    status, out, _ = run("sweep", str(path), "--grid", "bound.0=[0.4, 1.0]", "--json")
    assert status == 0
    assert parsed(out)["points"][1]["cost"] == pytest.approx(cost(), rel=1e-6)
    for setting, text in (("bound.7=1", "bound.7: got no number of that name"), ("bound.0='x'", "a number")):
        status, _, err = run("solve", str(path), "--set", setting)
        assert status == 2
        assert text in " ".join(err.split())
