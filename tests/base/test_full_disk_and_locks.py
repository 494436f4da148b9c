"""Files that cannot be written do not keep the others from being tried; a file that grows is one process's alone."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import lin_freq_ocp as lfo
from helpers.command_line import run
from helpers.compared_pages import blanks
from helpers.replacing import substitute
from helpers.seeds import expensive
from helpers.sweeps import SHORT

FULL = Path("/dev/full")  # a disk without room: it can be opened, and refuses every byte
needs_full = pytest.mark.skipif(not FULL.exists(), reason="a full disk as Linux has it")
GRID = {"cutoff_hz": [1.0]}
POINT = ("double_integrator", "--set", "horizon=60", "--set", "sampling_time=0.1", "--grid", "cutoff_hz=[1.0]")


def full(folder, *names):
    """Let some files of a folder lie on a full disk."""
    folder.mkdir(exist_ok=True)
    for name in names:
        (folder / name).symlink_to(FULL)
    return folder


@expensive
@needs_full
@pytest.mark.parametrize(("lost", "written"), [("sweep.csv", "sweep.png"), ("sweep.png", "sweep.csv")])
def test_a_sweep_tries_all_files(lost, written, tmp_path):
    folder = full(tmp_path / "out", lost)
    status, out, err = run("sweep", *POINT, "--out", str(folder))
    assert status == 2
    assert "1 of 1 point" in out
    assert str(folder / lost) in err
    assert (folder / written).stat().st_size > 0


@expensive
@needs_full
@pytest.mark.parametrize("lost", [["comparison.svg", "index.html"], ["states.png"]], ids=len)
def test_a_comparison_tries_all_files_and_names_those_that_fail(lost, tmp_path, monkeypatch):
    substitute(monkeypatch, "pages.draw_figures", lambda _: blanks())
    folder = full(tmp_path / "out", *lost)
    with pytest.raises(lfo.errors.ProblemError, match="No space left") as raised:
        lfo.compare(SHORT(), ["brickwall"]).save(folder)
    assert raised.value.field == ", ".join(str(folder / name) for name in lost)
    names = {"index.html", "comparison.svg", "comparison.png", "states.svg", "states.png"}
    assert all((folder / name).stat().st_size > 0 for name in names - set(lost))


@needs_full
def test_solve_tries_all_files(tmp_path):
    full(tmp_path, "a.npz")
    first, *others = (tmp_path / name for name in ("a.npz", "b.csv", "c.zip"))
    files = ("--save", str(first), "--csv", str(others[0]), "--dump", str(others[1]))
    status, _, err = run("solve", *POINT[:-2], *files)
    assert (status, err.count("error:")) == (2, 1)
    assert all(file.stat().st_size > 0 for file in others)


HOLDER = (
    "import fcntl, sys; file = open(sys.argv[1], 'ab'); fcntl.flock(file, fcntl.LOCK_EX); print(flush=True); input()"
)


@pytest.mark.skipif(sys.platform == "win32", reason="files are locked on POSIX only")
def test_two_sweeps_into_one_file_are_refused_until_the_first_has_ended(tmp_path):
    path = tmp_path / "sweep.jsonl"
    with subprocess.Popen([sys.executable, "-c", HOLDER, path], stdin=-1, stdout=-1) as other:
        try:
            other.stdout.readline()
            with pytest.raises(lfo.errors.ProblemError, match="Wait until it ends, or choose another folder") as raised:
                lfo.sweep(SHORT, GRID, path=path)
            assert raised.value.field == str(path)
            with pytest.raises(lfo.errors.ProblemError, match="another run is writing"):
                lfo.solve_many(SHORT(), [[0.0, 0.0]], path=path)
            status, _, err = run("sweep", *POINT, "--out", str(tmp_path))
            assert status == 2
            assert str(tmp_path) in err
            assert path.read_bytes() == b""
        finally:
            other.kill()  # without a word: the lock goes with the process
    assert lfo.sweep(SHORT, GRID, path=path).complete
    assert lfo.sweep(SHORT, GRID, path=path).complete


def test_a_sweep_whose_file_is_another_leaves_it_free(tmp_path):
    path = tmp_path / "sweep.jsonl"
    path.write_text("something else\n")
    for _ in range(2):
        with pytest.raises(lfo.errors.ProblemError, match="something else"):
            lfo.sweep(SHORT, GRID, path=path)
    assert path.read_text() == "something else\n"


@pytest.mark.parametrize("line", ["# comment\n", "x = [1.0, 2.0]\n", "[[[["])
def test_a_problem_file_of_many_bytes_is_refused_before_it_is_parsed(line, tmp_path):
    path = tmp_path / "large.toml"
    path.write_text(line * (2**23 // len(line)))
    with pytest.raises(
        lfo.errors.ProblemError, match=r"large.toml: got 83\d* bytes; expected .* at most .*npz"
    ) as raised:
        lfo.read_problem(path)
    assert raised.value.field == str(path)
    status, _, err = run("solve", str(path))
    assert (status, "npz" in err) == (2, True)
