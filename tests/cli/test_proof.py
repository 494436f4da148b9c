"""lin-freq-ocp solve --proof FILE, and the checker's command."""

import shutil
import subprocess
import sys
from pathlib import Path

import flint
import pytest

from helpers.command_line import run
from helpers.patience import PATIENCE
from helpers.seeds import expensive
from lin_freq_ocp.proof import lfo_check


def test_a_proof_is_written_and_confirmed(tmp_path, monkeypatch, capsys):
    file = tmp_path / "run.proof"
    status, _, err = run("solve", "double_integrator", "--proof", str(file))
    assert (status, err) == (0, "")
    monkeypatch.setattr(sys, "argv", ["lfo-check", str(file)])
    assert lfo_check.main() == 0
    word, lower, upper = capsys.readouterr().out.splitlines()[-1].split()
    assert word == "VERIFIED"
    assert 6.3857623 < float(lower) <= float(upper) < 6.3857624


@expensive
def test_an_infeasible_problem_has_a_proof_too(tmp_path, monkeypatch, capsys):
    file = tmp_path / "run.proof"
    status, _, err = run(
        "solve", "double_integrator", "--set", "cutoff_hz=0.3", "--time-limit", "0.3", "--proof", str(file)
    )
    assert status == 1, err
    monkeypatch.setattr(sys, "argv", ["lfo-check", str(file)])
    assert lfo_check.main() == 0
    assert capsys.readouterr().out.splitlines()[-1] == "INFEASIBLE"


@expensive
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


def test_the_checker_needs_nothing_but_python_and_flint(tmp_path):
    alone = shutil.copy(lfo_check.__file__, tmp_path)
    packages, numbers = Path(flint.__file__).parents[1], tmp_path / "numbers"
    numbers.mkdir()
    for folder in (packages / "flint", *packages.glob("python_flint.libs")):
        (numbers / folder.name).symlink_to(folder)
    program = "import runpy, sys; sys.path.append(sys.argv[1]); sys.argv = sys.argv[2:]; "
    program += "runpy.run_path(sys.argv[0], run_name='__main__')"
    proof = Path(__file__).parents[1] / "proof" / "double_integrator.proof"
    command = [sys.executable, "-I", "-S", "-c", program, str(numbers), str(alone), str(proof)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout.splitlines()[-1].startswith("VERIFIED ")
