"""The command minimum-time: one JSON object, and an exit status."""

from __future__ import annotations

import sys
from dataclasses import replace

import pytest

import lin_freq_ocp as lfo
from helpers.command_line import parsed, run
from helpers.replacing import substitute
from helpers.schemas import MINIMUM_TIME, RESULT, faults
from helpers.seeds import expensive
from lin_freq_ocp.proof import lfo_check
from lin_freq_ocp.solving import solve_judged

MOVER = ("double_integrator", "--set", 'cutoff_hz="none"', "--set", "sampling_time=0.1")


def test_the_command_prints_one_object():
    status, out, err = run("minimum-time", *MOVER, "--horizons", "20", "60", "--json")
    found = parsed(out)
    assert (status, err) == (0, "")
    assert faults(MINIMUM_TIME, found) == []
    assert faults(RESULT, found["result"]) == []
    assert (found["horizon"], found["horizons"], found["monotone"], found["proven"]) == (37, [20, 60], True, True)
    assert found["verdicts"]["36"] == "infeasible"
    assert found["result"]["problem"]["horizon"] == 37


@pytest.mark.parametrize(
    ("words", "expected", "text"),
    [
        ((*MOVER, "--horizons", "20", "60"), 0, "least horizon  37 steps"),
        ((*MOVER, "--horizons", "20", "30"), 1, "none is known to be feasible"),
        ((*MOVER, "--horizons", "60", "20"), 2, "horizons: got (60, 20)"),
        ((*MOVER, "--horizons", "20"), 2, "requires 2 arguments"),
    ],
)
def test_exit_statuses(words, expected, text):
    status, out, err = run("minimum-time", *words)
    assert status == expected
    assert text in out + err


def test_an_undecided_horizon_has_a_status_of_its_own(monkeypatch):
    def stopped(problem, *options, **more):
        found = solve_judged(problem)
        return replace(found, status=lfo.results.Status.LIMIT, certificate=None)

    substitute(monkeypatch, "solving.solve_judged", stopped)
    status, out, _ = run("minimum-time", *MOVER, "--horizons", "40", "42")
    assert status == 3
    assert "nothing is proven of 40 to 42" in out


def test_ctrl_c_prints_what_is_decided(monkeypatch):
    def stopped(problem, *options, **more):
        if problem.horizon < 60:
            raise KeyboardInterrupt
        return solve_judged(problem)

    substitute(monkeypatch, "solving.solve_judged", stopped)
    status, out, _ = run("minimum-time", *MOVER, "--horizons", "20", "60", "--json")
    assert status == 130
    assert (parsed(out)["horizon"], parsed(out)["proven"], parsed(out)["interrupted"]) == (60, False, True)


def test_files_are_stated_at_other_horizons(tmp_path):
    path = tmp_path / "move.toml"
    path.write_text(
        "schema = 1\nhorizon = 9\ninitial_state = [0, 0]\nterminal_state = [4, 0]\n"
        "[dynamics]\nA = [[1, 1], [0, 1]]\nB = [[0], [1]]\n"
        "[cost]\nR = 1.0\n[control_set]\nlower = -1\nupper = 1\n"
    )
    status, out, err = run("minimum-time", str(path), "--horizons", "1", "9", "--json")
    assert (status, err) == (0, "")
    assert parsed(out)["horizon"] == 4


def test_a_search_on_two_processes_is_recorded_and_resumed(tmp_path):
    words = ("minimum-time", *MOVER, "--horizons", "30", "40", "--workers", "2", "--out", str(tmp_path), "--json")
    status, out, err = run(*words)
    assert (status, err) == (0, "")
    assert parsed(out)["horizon"] == 37
    recorded = (tmp_path / "minimum_time.jsonl").read_text()
    again = run(*words)
    assert (tmp_path / "minimum_time.jsonl").read_text() == recorded
    assert parsed(again[1])["proof"] == parsed(out)["proof"]


@expensive
def test_the_files_of_solve_hold_the_answer_at_the_least_horizon(tmp_path, monkeypatch):
    names = {"save": "run.npz", "csv": "run.csv", "plot": "run.png", "proof": "run.proof", "dump": "run.zip"}
    options = [word for option, name in names.items() for word in (f"--{option}", str(tmp_path / name))]
    status, out, err = run("minimum-time", *MOVER, "--horizons", "36", "37", "--json", "--trajectory", *options)
    assert (status, err) == (0, "")
    assert len(parsed(out)["result"]["trajectory"]["u"]) == 37
    assert len((tmp_path / "run.csv").read_text().splitlines()) == 1 + 38
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")
    monkeypatch.setattr(sys, "argv", ["lfo-check", str(tmp_path / "run.proof")])
    assert lfo_check.main() == 0
    assert lfo.load_run(tmp_path / "run.zip").problem.horizon == 37
    assert lfo.load(tmp_path / "run.npz").trajectory.u.shape == (37, 1)


def test_without_a_feasible_horizon_only_proof_and_run_are_written(tmp_path):
    options = [word for name in ("csv", "proof", "dump") for word in (f"--{name}", str(tmp_path / name))]
    status, _, err = run("minimum-time", *MOVER, "--horizons", "30", "31", *options)
    assert status == 1
    assert "nothing saved to" in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dump", "proof"]


def test_outputs_are_checked_before_the_search(tmp_path):
    status, _, err = run("minimum-time", *MOVER, "--horizons", "36", "37", "--plot", str(tmp_path / "run.xyz"))
    assert (status, "a name that ends in .xyz" in err) == (2, True)
    status, _, err = run("minimum-time", *MOVER, "--horizons", "36", "37", "--trajectory")
    assert (status, "--trajectory needs --json" in err) == (2, True)
