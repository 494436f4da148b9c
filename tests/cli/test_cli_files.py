"""Problem files on the command line: what --set changes, and what solve writes beside its answer."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

import lin_freq_ocp as lfo
from helpers.command_line import run
from helpers.compilers import needs_kernel
from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp.proof import lfo_check


@pytest.fixture(scope="module")
def cart(tmp_path_factory):
    """Return the path of the template: a cart with a low pass of 20 Hz, sampled at 100 Hz."""
    path = tmp_path_factory.mktemp("cart") / "cart.toml"
    assert run("init", str(path))[0] == 0
    return path


# --- settings -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", ["cutoff_hz", "cutoff"])
def test_a_cut_off_is_set_in_a_file_as_it_is_in_a_sweep(cart, key):
    value = 3.0 if key == "cutoff_hz" else 2 * np.pi * 3.0 * 0.01
    expected = lfo.sweep(lfo.read_problem(cart), {key: [value]}).rows[0]["cost"]
    for command in ("solve", "compare"):
        status, out, _ = run(command, str(cart), "--set", f"{key}={value}", "--json")
        assert status == 0
        assert json.loads(out)["cost"] == pytest.approx(expected, rel=1e-9)
    assert json.loads(run("solve", str(cart), "--json")[1])["cost"] < 0.999 * expected


def test_without_a_cut_off_the_file_has_no_frequency_constraint(cart):
    status, out, _ = run("solve", str(cart), "--json", "--set", 'cutoff_hz="none"')
    assert status == 0
    assert json.loads(out)["cost"] == pytest.approx(12 / 2 / 0.01**4 / (199 * 200 * 201), rel=1e-6)  # rest to rest


def test_certify_judges_under_the_cut_off_that_is_set(cart, tmp_path):
    saved = str(tmp_path / "run.npz")
    assert run("solve", str(cart), "--set", "cutoff_hz=3", "--save", saved)[0] == 0
    assert run("certify", str(cart), saved, "--set", "cutoff_hz=3")[0] == 0
    status, out, _ = run("certify", str(cart), saved, "--set", "cutoff_hz=2", "--json")
    failed = {one["label"] for one in json.loads(out)["certificate"]["conditions"] if not one["passed"]}
    assert (status, failed & {"C-vii"}) == (3, {"C-vii"})


def test_a_grid_takes_precedence_over_a_cut_off_that_is_set(cart):
    status, out, _ = run("sweep", str(cart), "--set", "cutoff=0.3", "--grid", "cutoff_hz=[3.0]", "--json")
    assert status == 0
    alone = json.loads(run("solve", str(cart), "--set", "cutoff_hz=3", "--json")[1])
    assert json.loads(out)["points"][0]["cost"] == pytest.approx(alone["cost"], rel=1e-9)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("bogus=1",), ("cart.toml: bogus: got an unknown key", "horizon", "cutoff, cutoff_hz", "control_set.upper")),
        (("cutof_hz=1",), ("Did you mean 'cutoff_hz'?",)),
        (("cost.RR=1",), ("cost.RR", "one of Q, R, S", "Did you mean 'R'?")),
        (("cutoff=1", "cutoff_hz=5"), ("cutoff_hz: got cutoff, too", "Both set the same")),
        (("control_spectrum=[]", "cutoff=1"), ("cutoff: got control_spectrum, too",)),
        (("cutoff_hz='fast'",), ("cart.toml: control_spectrum[0].cutoff",)),
    ],
)
def test_a_setting_that_a_file_does_not_know_is_refused(cart, settings, words):
    given = [word for one in settings for word in ("--set", one)]
    for arguments in (("solve", str(cart)), ("compare", str(cart)), ("sweep", str(cart), "--grid", "horizon=[100]")):
        status, out, err = run(*arguments, *given)
        assert (status, out) == (2, "")
        for word in words:
            assert word in err


def test_two_cut_offs_are_no_grid(cart):
    status, _, err = run("sweep", str(cart), "--grid", "cutoff=[0.3]", "--grid", "cutoff_hz=[2.0]")
    assert (status, "--grid cutoff_hz: got cutoff, too" in err) == (2, True)


# --- what solve writes ----------------------------------------------------------------------------------------------

PNG = b"\x89PNG"


@expensive
def test_the_end_of_the_name_says_how_a_trajectory_is_saved(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    problem = lfo.library.pendulum()
    expected = lfo.solve(problem).trajectory
    for name, read in (
        ("run.csv", lambda: lfo.read_csv("run.csv", problem)),
        ("run.MAT", lambda: lfo.read_mat("run.MAT", problem)),
        ("run.npz", lambda: lfo.load("run.npz").trajectory),
        ("run", lambda: lfo.load("run").trajectory),
    ):
        assert run("solve", "pendulum", "--save", name)[0] == 0
        np.testing.assert_allclose(read().x, expected.x, atol=1e-9)
        np.testing.assert_allclose(read().u, expected.u, atol=1e-9)
    assert run("certify", "pendulum", "run.csv")[0] == 0


def test_the_library_saves_by_the_same_names(tmp_path):
    problem = lfo.library.pendulum()
    result = lfo.solve(problem)
    result.save(tmp_path / "run.csv")
    np.testing.assert_array_equal(lfo.read_csv(tmp_path / "run.csv", problem).x, result.trajectory.x)
    with pytest.raises(lfo.errors.ProblemError, match=r"run\.txt.*\.npz, \.csv or \.mat"):
        result.save(tmp_path / "run.txt")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--save", "run.txt"), ("--save run.txt", ".npz, .csv or .mat")),
        (("--plot", "run.doc"), ("--plot run.doc", ".png", ".svg", ".pdf")),
        (("--plot", "run"), ("--plot run", "without a suffix")),
        (("--csv", "a.csv", "--save", "a.csv"), ("--csv a.csv", "the file of --save", "another file")),
        (("--csv", "nowhere/a.csv"), ("--csv nowhere/a.csv", "existing folder")),
        (("--trajectory",), ("--trajectory needs --json", "--csv")),
    ],
)
def test_what_cannot_be_written_is_refused_before_solving(arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    substitute(monkeypatch, "solve", lambda *given, **named: pytest.fail("it was solved"))
    status, out, err = run("solve", "pendulum", *arguments)
    assert (status, out, list(tmp_path.iterdir())) == (2, "", [])
    for word in words:
        assert word in " ".join(err.split())


@expensive
def test_picture_and_table_of_an_answer(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, _, err = run("solve", "pendulum", "--plot", "a.png", "--csv", "a.txt", "--save", "a.npz", "--json")
    assert (status, err) == (0, "")
    assert Path("a.png").read_bytes().startswith(PNG)
    rows = Path("a.txt").read_text(encoding="utf-8").splitlines()
    assert (rows[0].split(",")[:3], len(rows)) == (["t", "time [s]", "position [m]"], 242)
    np.testing.assert_allclose([float(cell) for cell in rows[1].split(",")[2:6]], [-0.15, 0.1, 0.0, 0.0], atol=1e-9)


def test_without_a_trajectory_there_is_no_picture(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    settings = ("--set", "horizon=60", "--set", "control_bound=1")
    status, out, err = run(
        "solve", "pendulum", *settings, "--plot", "a.png", "--csv", "a.csv", "--json", "--trajectory"
    )
    assert (status, list(tmp_path.iterdir())) == (1, [])
    assert "nothing drawn to a.png" in err
    assert "nothing saved to a.csv" in err
    assert json.loads(out)["trajectory"] is None


def test_a_file_that_fails_keeps_nothing_back(tmp_path, monkeypatch):
    """The answer is printed and the other files are written."""
    monkeypatch.chdir(tmp_path)

    def full(result, path):
        raise lfo.errors.ProblemError(str(path), "no space left on device", "a file that can be written")

    monkeypatch.setattr(lfo.results.Result, "save", full)
    status, out, err = run("solve", "pendulum", "--save", "a.npz", "--csv", "a.csv", "--json")
    assert (status, json.loads(out)["status"], Path("a.csv").exists()) == (2, "optimal", True)
    assert "error: a.npz: got no space left on device" in err


def test_the_trajectory_as_json():
    status, out, _ = run("solve", "pendulum", "--json", "--trajectory")
    found, expected = json.loads(out)["trajectory"], lfo.solve(lfo.library.pendulum())
    assert status == 0
    np.testing.assert_allclose(found["x"], expected.trajectory.x, atol=1e-9)
    np.testing.assert_allclose(found["u"], expected.control, atol=1e-9)
    np.testing.assert_allclose(found["time"], 0.01 * np.arange(241))
    assert (found["state_names"][1], found["control_names"]) == ("angle [rad]", ["force [N]"])
    assert "trajectory" not in json.loads(run("solve", "pendulum", "--json")[1])


# --- the pages a reader begins with ----------------------------------------------------------------------------------


@expensive
@needs_kernel
def test_the_commands_of_the_first_pages_run(tmp_path, monkeypatch):
    """All but the slow ones and the one that runs until Ctrl-C, in their order: each ends with its proof."""
    monkeypatch.chdir(tmp_path)
    savemat("axis.mat", {"A": [[0.0, 1.0], [0.0, 0.0]], "B": [[0.0], [1.0]], "Ts": 0.0})
    Path("frf.csv").write_text("frequency [Hz],re,im\n1,0.5,0\n10,0.1,-0.3\n")
    root = Path(__file__).parents[2]
    first = (root / "README.md").read_text(encoding="utf-8").split("## From the command line")[1]
    second = (root / "docs" / "command_line.md").read_text(encoding="utf-8")
    blocks = [text.split("```sh\n")[1].split("```")[0] for text in (first, second)]
    lines = [shlex.split(line, comments=True) for block in blocks for line in block.splitlines()]
    assert {"list", "show", "solve", "certify", "rerun", "init"} <= {line[1] for line in lines}
    for command, *line in lines:
        if command == "lfo-check":
            monkeypatch.setattr(sys, "argv", [command, *line])
            assert lfo_check.main() == 0
        elif line[0] not in ("compare", "sweep", "explore"):
            assert (line, run(*line)[0]) == (line, 0)
    assert {"run.png", "run.csv", "run.npz", "run.zip", "my_problem.toml"} <= {one.name for one in tmp_path.iterdir()}
