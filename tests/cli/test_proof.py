"""lin-freq-ocp solve --proof FILE, and the checker's command."""

import sys

import lfo_check
import pytest

from helpers.command_line import run


def test_a_proof_is_written_and_confirmed(tmp_path, monkeypatch, capsys):
    file = tmp_path / "run.proof"
    status, _, err = run("solve", "double_integrator", "--proof", str(file))
    assert (status, err) == (0, "")
    monkeypatch.setattr(sys, "argv", ["lfo-check", str(file)])
    assert lfo_check.main() == 0
    word, lower, upper = capsys.readouterr().out.splitlines()[-1].split()
    assert word == "VERIFIED"
    assert 6.3857623 < float(lower) <= float(upper) < 6.3857624


def test_an_infeasible_problem_has_a_proof_too(tmp_path, monkeypatch, capsys):
    file = tmp_path / "run.proof"
    status, _, err = run(
        "solve", "double_integrator", "--set", "cutoff_hz=0.3", "--time-limit", "1", "--proof", str(file)
    )
    assert status == 1, err
    monkeypatch.setattr(sys, "argv", ["lfo-check", str(file)])
    assert lfo_check.main() == 0
    assert capsys.readouterr().out.splitlines()[-1] == "INFEASIBLE"


def test_what_cannot_be_proven_is_said(tmp_path):
    file = tmp_path / "run.proof"
    status, _, err = run("solve", "printer_move", "--proof", str(file))
    assert status == 2
    assert "residual vibration" in err
    assert not file.exists()


@pytest.mark.parametrize(("arguments", "status"), [([], 2), (["--help"], 0), (["one", "two"], 2)])
def test_without_a_file_the_checker_says_how_it_is_used(arguments, status, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["lfo-check", *arguments])
    assert lfo_check.main() == status
    assert "lfo_check.py FILE" in capsys.readouterr().out
