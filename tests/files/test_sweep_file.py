"""Files of a sweep: resumed wherever they were cut, refused where they are of another."""

from __future__ import annotations

import csv
import json
import shutil
from functools import partial
from pathlib import Path

import pytest

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from helpers.seeds import expensive
from helpers.sweeps import GRID, SHORT, assert_same
from lin_freq_ocp.solving import solve_judged


@pytest.fixture
def counted(monkeypatch):
    """Count what is solved in this process."""
    solved = []
    honest = solve_judged
    substitute(monkeypatch, "solving.solve_judged", lambda *a, **b: solved.append(1) or honest(*a, **b))
    return solved


@pytest.fixture
def written(serial, file, tmp_path):
    return Path(shutil.copy(file, tmp_path))


@expensive
@pytest.mark.parametrize("cut", [-1, -30, -600])
def test_a_file_cut_anywhere_is_resumed(serial, written, counted, cut):
    whole = written.read_bytes()
    written.write_bytes(whole[:cut])
    missing = 8 - (whole[:cut].count(b"\n") - 1)
    found = lfo.sweep(SHORT, GRID, path=written)
    assert len(counted) == missing
    assert_same(found, serial)
    assert_same(lfo.load_sweep(written), serial)


@expensive
@pytest.mark.parametrize("left", [0, 1, 20, 100])
def test_a_file_cut_within_its_first_line_is_begun_anew(serial, written, left):
    written.write_bytes(written.read_bytes()[:left])
    assert_same(lfo.sweep(SHORT, GRID, path=written), serial)
    assert len(written.read_text().splitlines()) == 9


def test_nothing_is_solved_twice_and_a_grid_may_grow(written, counted):
    finer = {"cutoff_hz": [None, 0.2, 0.7, 1.0], "control_bound": [1.0]}
    assert lfo.sweep(SHORT, GRID, path=written).complete
    assert counted == []
    found = lfo.sweep(SHORT, finer, path=written)
    assert len(counted) == 1
    assert found.column("cutoff_hz") == finer["cutoff_hz"]
    assert_same(lfo.load_sweep(written), found)


def test_points_with_errors_are_tried_again(tmp_path, monkeypatch):
    path = tmp_path / "sweep.jsonl"
    substitute(monkeypatch, "solving.solve_judged", lambda *a, **b: 1 / 0)
    assert lfo.sweep(SHORT, {"horizon": [60]}, path=path).column("status") == ["error"]
    monkeypatch.undo()
    assert lfo.sweep(SHORT, {"horizon": [60]}, path=path).column("status") == ["optimal"]
    assert lfo.load_sweep(path).column("status") == ["optimal"]


@pytest.mark.parametrize(
    ("problem", "grid", "options", "words"),
    [
        (lfo.library.pendulum, {"control_bound": [1.0]}, {}, "another problem"),
        (partial(SHORT, speed_bound=0.5), GRID, {}, "another problem, also called double_integrator"),
        (SHORT, {"cutoff_hz": [1.0]}, {}, "other parameters"),
        (SHORT, GRID, {"method": "convex"}, "other options"),
    ],
)
def test_the_file_of_another_sweep_is_refused_and_kept(written, problem, grid, options, words):
    before = written.read_bytes()
    with pytest.raises(lfo.errors.ProblemError, match=words):
        lfo.sweep(problem, grid, path=written, **options)
    assert written.read_bytes() == before


@pytest.mark.parametrize("content", ["a,b\n1,2", "no end of line", '{"kind": "something"}\n'])
def test_other_files_are_refused_and_kept(tmp_path, content):
    path = tmp_path / "mine.txt"
    path.write_text(content)
    for call in (lambda: lfo.sweep(SHORT, GRID, path=path), lambda: lfo.load_sweep(path)):
        with pytest.raises(lfo.errors.ProblemError, match=r"mine\.txt"):
            call()
    assert path.read_text() == content


def test_a_damaged_line_is_named(written):
    lines = written.read_text().splitlines()
    written.write_text("\n".join([*lines[:3], "}{", *lines[3:]]) + "\n")
    with pytest.raises(lfo.errors.ProblemError, match="line 4"):
        lfo.load_sweep(written)


@pytest.mark.parametrize(
    ("line", "change", "place"),
    [
        (0, lambda head: head.pop("fingerprint"), "fingerprint: got nothing"),
        (0, lambda head: head.update(options=[]), "options: got"),
        (0, lambda head: head.update(more=1), "more: got an unknown key"),
        (1, lambda row: row.pop("message"), "line 2.message: got nothing"),
        (1, lambda row: row.update(seconds="1"), "line 2.seconds: got '1'"),
    ],
    ids=["no fingerprint", "options of another type", "an unknown key", "no message", "a text for a number"],
)
def test_what_is_wrong_in_a_line_is_named(written, line, change, place):
    tables = [json.loads(text) for text in written.read_text().splitlines()]
    change(tables[line])
    written.write_text("".join(json.dumps(table) + "\n" for table in tables))
    with pytest.raises(lfo.errors.ProblemError, match=place):
        lfo.load_sweep(written)


def test_a_path_that_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(lfo.errors.ProblemError, match="nowhere"):
        lfo.sweep(SHORT, GRID, path=tmp_path / "nowhere" / "sweep.jsonl")


def test_csv_has_every_number_to_the_last_bit(serial, tmp_path):
    serial.to_csv(tmp_path / "sweep.csv")
    with (tmp_path / "sweep.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["cost"]) if row["cost"] else None for row in rows] == serial.column("cost")
    assert [float(row["cutoff_hz"]) if row["cutoff_hz"] else None for row in rows] == serial.column("cutoff_hz")
