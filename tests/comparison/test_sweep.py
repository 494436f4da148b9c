"""Sweeps: the same answers wherever the points are solved, and none of them lost."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import threading
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from distributed import Client, LocalCluster

import lin_freq_ocp as lfo
from helpers.command_line import parsed, run
from helpers.schemas import SWEEP, faults
from lin_freq_ocp.comparison.sweep import point as sweep_point
from lin_freq_ocp.comparison.sweep import tasks as sweep_tasks
from lin_freq_ocp.comparison.sweep.grid import fingerprint
from lin_freq_ocp.comparison.sweep.sweep import MEASURED
from lin_freq_ocp.comparison.sweep.tasks import process_pool
from lin_freq_ocp.interchange.runs.sweep_file import sweep_summary

SHORT = partial(lfo.library.double_integrator, horizon=60, sampling_time=0.1, cutoff_hz=1.0)
GRID = {"cutoff_hz": [None, 0.2, 1.0, 3.0], "control_bound": [0.2, 1.0]}
"""Eight points, two of them infeasible."""

FORTY = {"cutoff_hz": np.linspace(0.3, 4.0, 20), "speed_bound": [0.25, 0.4]}


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return tmp_path_factory.mktemp("sweep") / "sweep.jsonl"


@pytest.fixture(scope="module")
def serial(file):
    return lfo.sweep(SHORT, GRID, path=file)


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    """Two worker processes, as a cluster has them."""
    folder = str(tmp_path_factory.mktemp("cluster"))
    options = {"processes": True, "dashboard_address": None, "local_directory": folder}
    with LocalCluster(n_workers=2, threads_per_worker=1, **options) as cluster, Client(cluster) as client:
        yield client


def assert_same(one: lfo.results.Sweep, other: lfo.results.Sweep) -> None:
    """The same points in the same order, with the same answers to 1e-9."""
    assert [row["parameters"] for row in one.rows] == [row["parameters"] for row in other.rows]
    assert one.column("status") == other.column("status")
    assert one.column("proven") == other.column("proven")
    for mine, yours in zip(one.column("cost"), other.column("cost"), strict=True):
        assert mine == yours if mine is None or yours is None else mine == pytest.approx(yours, rel=1e-9, abs=1e-12)


# --- points and rows ------------------------------------------------------------------------------------------------


def test_rows_are_those_of_solve_in_the_order_of_the_grid(serial):
    points = [(cutoff, bound) for cutoff in GRID["cutoff_hz"] for bound in GRID["control_bound"]]
    assert [tuple(row["parameters"].values()) for row in serial.rows] == points
    for row in serial.rows:
        result = lfo.solve(SHORT(**row["parameters"]), throw=False)
        assert (row["status"], row["cost"]) == (result.status, result.cost)
        assert row["proven"]
        if result.certificate is not None:
            assert (row["pmp"], row["global"]) == (result.certificate.pmp, result.certificate.globally_optimal)
            assert (row["lower_bound"], row["gap"]) == (result.lower_bound, result.gap)
    assert {"optimal", "infeasible"} == set(serial.column("status"))
    assert serial.complete
    assert serial.proven
    assert serial.table()[0] == {**serial.rows[0]["parameters"], **{key: serial.rows[0][key] for key in MEASURED}}


def test_more_bandwidth_never_costs_more(serial):
    for bound in GRID["control_bound"]:
        costs = [row["cost"] for row in serial.rows if row["parameters"]["control_bound"] == bound]
        known = [cost for cost in [*costs[1:], costs[0]] if cost is not None]  # None last: the widest band
        assert known == sorted(known, reverse=True) or np.allclose(known, sorted(known, reverse=True))


def test_fields_of_a_problem_are_swept():
    problem = SHORT(cutoff_hz=None)
    grid = {"cutoff": [None, 0.6], "horizon": [60, 70], "terminal_state": [[1.0, 0.0], (0.5, 0.0)]}
    found = lfo.sweep(problem, grid)
    for row in found.rows:
        at = row["parameters"]
        spectrum = None if at["cutoff"] is None else lfo.low_pass(at["cutoff"])
        changed = replace(
            problem, horizon=at["horizon"], terminal_state=at["terminal_state"], control_spectrum=spectrum
        )
        assert row["cost"] == lfo.solve(changed, throw=False).cost
    assert found.problem == "double_integrator"


def test_objects_are_swept_and_told_apart(tmp_path):
    boxes = [lfo.Box(-1, 1), lfo.Box(-0.5, 0.5)]
    first = lfo.sweep(SHORT(), {"control_set": boxes}, path=tmp_path / "boxes.jsonl")
    assert len(set(first.grid["control_set"])) == 2
    again = lfo.sweep(SHORT(), {"control_set": [lfo.Box(-0.5, 0.5), lfo.Box(-1, 1)]}, path=tmp_path / "boxes.jsonl")
    assert again.rows == first.rows[::-1]


def test_a_fingerprint_tells_problems_apart():
    assert fingerprint(SHORT()) == fingerprint(SHORT())
    others = [SHORT(horizon=61), SHORT(speed_bound=0.31), SHORT(cutoff_hz=None), replace(SHORT(), name="mine"), SHORT]
    assert len({fingerprint(one) for one in (SHORT(), *others)}) == 6
    assert fingerprint(SHORT) == fingerprint(
        partial(lfo.library.double_integrator, cutoff_hz=1.0, sampling_time=0.1, horizon=60)
    )


def broken_builder(horizon: int) -> lfo.OptimalControlProblem:
    if horizon == 2:
        raise ZeroDivisionError("no such horizon")
    return SHORT(horizon=60 if horizon > 2 else horizon)


def test_a_point_that_is_no_problem_does_not_end_the_sweep():
    found = lfo.sweep(broken_builder, {"horizon": [-1, 2, 60]})
    assert found.column("status") == ["error", "error", "optimal"]
    assert found.column("message")[0].startswith("horizon: got -1")
    assert found.column("message")[1] == "ZeroDivisionError: no such horizon"
    assert found.complete
    assert not found.proven


def test_what_is_said_of_bands_stands_in_the_row():
    (row,) = lfo.sweep(SHORT(), {"cutoff": [np.pi]}).rows
    assert "removes no bin" in row["message"]
    assert row["proven"]


@pytest.mark.parametrize(
    ("problem", "grid", "words"),
    [
        (SHORT, {"cutof_hz": [1.0]}, r"grid\.cutof_hz: .* Did you mean 'cutoff_hz'"),
        (SHORT(), {"horizn": [1]}, r"grid\.horizn: .* Did you mean 'horizon'"),
        (SHORT(), {"cutoff": [1.0], "cutoff_hz": [1.0]}, r"grid\.cutoff_hz: .* Both set the same"),
        (SHORT, {}, "grid: "),
        (SHORT, {"horizon": 60}, r"grid\.horizon: .*\[value\]"),
        (SHORT, {"horizon": []}, r"grid\.horizon: got nothing"),
        (SHORT, {"horizon": [60, 60]}, r"grid\.horizon: got 60 twice"),
        ("pendulum", {"horizon": [60]}, "problem: "),
    ],
)
def test_bad_grids_are_refused_before_anything_is_solved(problem, grid, words):
    with pytest.raises(lfo.errors.ProblemError, match=words):
        lfo.sweep(problem, grid)


def test_bad_options_are_refused_before_anything_is_solved():
    with pytest.raises(lfo.errors.UnsupportedError, match="method"):
        lfo.sweep(SHORT, GRID, method="guess")
    with pytest.raises(lfo.errors.UnsupportedError, match="backend"):
        lfo.sweep(SHORT, GRID, backend="guess")
    with pytest.raises(lfo.errors.ProblemError, match="get_executor"):
        lfo.sweep(SHORT, GRID, executor=2)
    with ThreadPoolExecutor(1) as pool, pytest.raises(lfo.errors.ProblemError, match="top level of a module"):
        lfo.sweep(lambda horizon: SHORT(horizon=horizon), {"horizon": [60]}, pool)


def test_columns_have_names(serial):
    assert serial.column("cutoff_hz")[:3] == [None, None, 0.2]
    with pytest.raises(lfo.errors.ProblemError, match="Did you mean 'cost'"):
        serial.column("costs")


# --- executors ------------------------------------------------------------------------------------------------------


def test_threads_give_the_same(serial):
    with ThreadPoolExecutor(2) as pool:
        assert_same(lfo.sweep(SHORT, GRID, pool), serial)


def test_a_dask_cluster_gives_the_same(serial, client):
    assert_same(lfo.sweep(SHORT, GRID, client.get_executor()), serial)
    assert_same(
        lfo.sweep(SHORT(), {"horizon": [60, 70]}, client.get_executor()), lfo.sweep(SHORT(), {"horizon": [60, 70]})
    )


def test_a_worker_killed_on_the_way_loses_nothing(client, tmp_path):
    """Forty points on two worker processes of a cluster; one is killed once six points are finished."""
    path, workers, killed = tmp_path / "forty.jsonl", client.run(os.getpid), []

    def progress(done: int, total: int) -> None:
        assert total == 40
        if done >= 6 and not killed:
            killed.append(next(iter(workers.values())))
            os.kill(killed[0], signal.SIGKILL)

    found = lfo.sweep(SHORT, FORTY, client.get_executor(), path, progress=progress)
    assert killed
    assert found.complete
    assert found.proven
    assert_same(found, lfo.sweep(SHORT, FORTY))
    assert len(path.read_text().splitlines()) == 41  # no point was written twice
    client.wait_for_workers(2)
    assert killed[0] not in client.run(os.getpid).values()


def test_two_processes_give_the_same_and_so_does_what_is_left_if_one_is_killed(serial, tmp_path):
    pool, killed = process_pool(2), []

    def progress(done: int, total: int) -> None:
        if done == 2:
            killed.append(next(iter(pool._processes)))
            os.kill(killed[0], signal.SIGKILL)

    with pool:
        assert_same(lfo.sweep(SHORT, GRID, pool), serial)
        with pytest.warns(RuntimeWarning, match="takes no more work"):
            found = lfo.sweep(SHORT, GRID, pool, tmp_path / "sweep.jsonl", progress=progress)
    assert killed
    assert_same(found, serial)
    assert_same(lfo.load_sweep(tmp_path / "sweep.jsonl"), serial)


def deadly(horizon: int) -> lfo.OptimalControlProblem:
    if horizon == 61:
        os.kill(os.getpid(), signal.SIGKILL)
    return SHORT(horizon=horizon)


class Closed(Executor):
    """An executor that takes no work."""

    def submit(self, function, *arguments):
        raise RuntimeError("cannot schedule new futures after shutdown")


def test_a_point_that_kills_its_process_is_the_only_one_lost(monkeypatch):
    monkeypatch.setattr(sweep_tasks, "RESUBMISSIONS", 0)
    with pytest.warns(RuntimeWarning, match="takes no more work: 3 points"):
        found = lfo.sweep(deadly, {"horizon": [60, 61, 62]}, Closed())
    assert found.column("status") == ["optimal", "error", "optimal"]
    assert "at last with BrokenProcessPool" in found.column("message")[1]


class Lossy(Executor):
    """An executor that loses each point as often as it is told to."""

    def __init__(self, losses: int):
        self.losses, self.attempts = losses, []

    def submit(self, function, parameters, attempt):
        future = Future()
        self.attempts.append(attempt)
        if attempt < self.losses:
            future.set_exception(RuntimeError("the worker is gone"))
        else:
            future.set_result(function(parameters, attempt))
        return future


@pytest.mark.parametrize(("losses", "status"), [(2, "optimal"), (3, "error")])
def test_lost_points_are_given_out_again_but_not_for_ever(losses, status):
    executor = Lossy(losses)
    found = lfo.sweep(SHORT, {"horizon": [60]}, executor)
    assert found.column("status") == [status]
    assert executor.attempts == list(range(sweep_tasks.RESUBMISSIONS + 1))


# --- files ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def counted(monkeypatch):
    """Count what is solved in this process."""
    solved = []
    honest = sweep_point.solve_judged
    monkeypatch.setattr(sweep_point, "solve_judged", lambda *a, **b: solved.append(1) or honest(*a, **b))
    return solved


@pytest.fixture
def written(serial, file, tmp_path):
    return Path(shutil.copy(file, tmp_path))


@pytest.mark.parametrize("cut", [-1, -30, -600])
def test_a_file_cut_anywhere_is_resumed(serial, written, counted, cut):
    whole = written.read_bytes()
    written.write_bytes(whole[:cut])
    missing = 8 - (whole[:cut].count(b"\n") - 1)
    found = lfo.sweep(SHORT, GRID, path=written)
    assert len(counted) == missing
    assert_same(found, serial)
    assert_same(lfo.load_sweep(written), serial)


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
    monkeypatch.setattr(sweep_point, "solve_judged", lambda *a, **b: 1 / 0)
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


def test_a_path_that_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(lfo.errors.ProblemError, match="nowhere"):
        lfo.sweep(SHORT, GRID, path=tmp_path / "nowhere" / "sweep.jsonl")


def test_csv_has_every_number_to_the_last_bit(serial, tmp_path):
    serial.to_csv(tmp_path / "sweep.csv")
    with (tmp_path / "sweep.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["cost"]) if row["cost"] else None for row in rows] == serial.column("cost")
    assert [float(row["cutoff_hz"]) if row["cutoff_hz"] else None for row in rows] == serial.column("cutoff_hz")


# --- Ctrl-C ---------------------------------------------------------------------------------------------------------


def interrupt_at(done: int):
    def progress(now: int, total: int) -> None:
        if now == done:
            signal.raise_signal(signal.SIGINT)

    return progress


def test_ctrl_c_keeps_what_is_finished(serial, tmp_path):
    path = tmp_path / "sweep.jsonl"
    found = lfo.sweep(SHORT, GRID, path=path, progress=interrupt_at(3))
    assert found.interrupted
    assert (len(found.rows), found.complete) == (3, False)
    assert lfo.load_sweep(path).rows == found.rows
    with ThreadPoolExecutor(1) as pool:
        second = lfo.sweep(SHORT, GRID, pool, path, progress=interrupt_at(5))
        assert second.interrupted
        assert 5 <= len(second.rows) <= 8
    third = lfo.sweep(SHORT, GRID, path=path)
    assert not third.interrupted
    assert_same(third, serial)


def test_ctrl_c_within_a_solve_ends_the_sweep_without_that_point(monkeypatch):
    honest = sweep_point.solve_judged

    def pressed(problem, **options):
        return replace(honest(problem, **options), interrupted=problem.horizon == 61)

    monkeypatch.setattr(sweep_point, "solve_judged", pressed)
    found = lfo.sweep(SHORT, {"horizon": [60, 61, 62]})
    assert found.interrupted
    assert found.column("horizon") == [60]


# --- pictures -------------------------------------------------------------------------------------------------------


def test_the_figure_shows_costs_relative_to_none_and_what_is_infeasible(serial):
    (ax,) = serial.plot().axes
    costs = {
        row["parameters"]["cutoff_hz"]: row["cost"] for row in serial.rows if row["parameters"]["control_bound"] == 1
    }
    drawn = [line.get_ydata() for line in ax.lines if line.get_label() == "control_bound = 1"]
    np.testing.assert_allclose(drawn[0], [np.nan, *(costs[x] / costs[None] for x in (1.0, 3.0))])
    assert "relative" in ax.get_ylabel()
    assert ax.get_title(loc="left") == "double_integrator: the price of bandwidth"
    crosses = [list(line.get_xdata()) for line in ax.lines if line.get_marker() == "x"]
    infeasible = [row["parameters"]["cutoff_hz"] for row in serial.rows if row["status"] == "infeasible"]
    assert sorted(x for one in crosses for x in one) == sorted(x for x in infeasible if x is not None)
    for line in ax.lines:
        if line.get_marker() == "x" and len(line.get_xdata()):  # above every cost, and not among the cheapest
            marks = ax.transAxes.inverted().transform(ax.get_xaxis_transform().transform(line.get_xydata()))[:, 1]
            highest = ax.transAxes.inverted().transform(ax.transData.transform([(1, np.nanmax(drawn[0]))]))[0, 1]
            assert (marks > highest).all()


def test_figures_of_other_sweeps_are_drawn(tmp_path):
    found = lfo.sweep(
        SHORT, {"horizon": [-1, 40, 60, 2000], "speed_bound": [0.3, None]}, tolerance=10, method="spectral"
    )
    figure = found.plot()
    (ax,) = figure.axes
    assert ax.get_xscale() == "log" or found.column("status")[0] == "error"
    figure.savefig(tmp_path / "sweep.svg")
    with pytest.raises(lfo.errors.ProblemError, match="no parameter with numbers"):
        lfo.sweep(SHORT, {"terminal_state": [[1.0, 0.0]]}).plot()


def test_a_point_that_breaks_constraints_has_no_cost():
    found = lfo.sweep(SHORT, {"horizon": [30, 60]}, tolerance=10, method="spectral")
    broken, good = found.rows
    assert broken["status"] == "numerical_error"
    assert (broken["cost"], broken["gap"]) == (None, None)
    assert "breaks constraints" in broken["message"]
    assert good["cost"] is not None
    (ax,) = found.plot().axes
    assert [line.get_label() for line in ax.lines if line.get_marker() == "$?$" and not len(line.get_xdata())]
    assert np.isnan(ax.lines[0].get_ydata()[0])


def test_the_example_of_the_docs_runs(tmp_path, monkeypatch):
    text = (Path(__file__).parents[2] / "docs" / "sweeps.md").read_text(encoding="utf-8")
    code = text.split("```python\n")[1].split("```")[0].replace("ProcessPoolExecutor", "ThreadPoolExecutor")
    monkeypatch.chdir(tmp_path)
    exec(code, {"__name__": "__main__"})
    assert {file.name for file in tmp_path.iterdir()} == {"sweep.jsonl", "sweep.csv", "sweep.png"}
    assert set(lfo.load_sweep("sweep.jsonl").column("status")) == {"optimal", "infeasible"}


# --- the command ----------------------------------------------------------------------------------------------------

WORDS = ("double_integrator", "--set", "horizon=60", "--set", "sampling_time=0.1")


def test_the_command_prints_one_object_and_writes_the_folder(serial, tmp_path):
    grids = ("--grid", 'cutoff_hz=["none", 0.2, 1.0, 3.0]', "--grid", "control_bound=[0.2, 1.0]")
    status, out, err = run("sweep", *WORDS, *grids, "--workers", "2", "--out", str(tmp_path / "out"), "--json")
    summary = parsed(out)
    assert (status, err) == (0, "")
    assert faults(SWEEP, summary) == []
    assert {file.name for file in (tmp_path / "out").iterdir()} == {"sweep.jsonl", "sweep.csv", "sweep.png"}
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


def test_the_command_says_which_points_are_not_proven():
    status, out, _ = run(
        "sweep", "pendulum", "--grid", "control_bound=[5.0]", "--tolerance", "10", "--method", "spectral"
    )
    assert status == 3
    assert "breaks" in out


def test_ctrl_c_ends_the_command_with_130(tmp_path, monkeypatch):
    honest, pressed = sweep_point.solve_judged, threading.Event()

    def interrupted(*given, **named):
        if pressed.is_set():
            signal.raise_signal(signal.SIGINT)
        pressed.set()
        return honest(*given, **named)

    monkeypatch.setattr(sweep_point, "solve_judged", interrupted)
    arguments = ("sweep", *WORDS, "--grid", "horizon=60:80:3", "--out", str(tmp_path), "--json")
    status, out, _ = run(*arguments)
    summary = parsed(out)
    assert (status, summary["interrupted"], len(summary["points"])) == (130, True, 1)
    monkeypatch.undo()
    status, out, _ = run(*arguments)
    assert (status, len(parsed(out)["points"])) == (0, 3)


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
