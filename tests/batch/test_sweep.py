"""Sweeps: the same answers wherever the points are solved, whatever ends on the way."""

from __future__ import annotations

import os
import signal
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from distributed import Client, LocalCluster

import lin_freq_ocp as lfo
from helpers.patience import wait_until
from helpers.replacing import substitute
from helpers.seeds import expensive
from helpers.sweeps import GRID, SHORT, assert_same, broken_builder
from lin_freq_ocp.batch import MEASURED, RESUBMISSIONS, fingerprint, process_pool
from lin_freq_ocp.solving import solve_judged

TWENTY = {"cutoff_hz": np.linspace(0.3, 4.0, 10), "speed_bound": [0.25, 0.4]}


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    """Two worker processes, as a cluster has them."""
    folder = str(tmp_path_factory.mktemp("cluster"))
    options = {"processes": True, "dashboard_address": ":0", "local_directory": folder}
    with LocalCluster(n_workers=2, threads_per_worker=1, **options) as cluster, Client(cluster) as client:
        yield client


# --- points and rows ------------------------------------------------------------------------------------------------


@expensive
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


def test_where_the_package_defines_a_function_is_no_part_of_its_fingerprint(monkeypatch):
    ours, theirs = fingerprint(lfo.library.double_integrator), fingerprint(broken_builder)
    monkeypatch.setattr(lfo.library.double_integrator, "__module__", "lin_freq_ocp.elsewhere")
    monkeypatch.setattr(broken_builder, "__module__", "elsewhere")
    assert fingerprint(lfo.library.double_integrator) == ours
    assert fingerprint(broken_builder) != theirs


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


@expensive
def test_a_dask_cluster_gives_the_same(serial, client):
    assert_same(lfo.sweep(SHORT, GRID, client.get_executor()), serial)
    assert_same(
        lfo.sweep(SHORT(), {"horizon": [60, 70]}, client.get_executor()), lfo.sweep(SHORT(), {"horizon": [60, 70]})
    )


@expensive
def test_a_worker_killed_on_the_way_loses_nothing(client, tmp_path):
    """Twenty points on two worker processes of a cluster; one is killed once six points are finished."""
    path, workers, killed = tmp_path / "twenty.jsonl", client.run(os.getpid), []

    def progress(done: int, total: int) -> None:
        assert total == 20
        if done >= 6 and not killed:
            killed.append(next(iter(workers.values())))
            os.kill(killed[0], signal.SIGKILL)

    found = lfo.sweep(SHORT, TWENTY, client.get_executor(), path, progress=progress)
    assert killed
    assert found.complete
    assert found.proven
    assert_same(found, lfo.sweep(SHORT, TWENTY))
    assert len(path.read_text().splitlines()) == 21  # no point was written twice
    # the scheduler notices it later
    wait_until(lambda: killed[0] not in client.run(os.getpid, on_error="ignore").values())
    client.wait_for_workers(2)


def held(folder: str, cutoff_hz: float | None, control_bound: float) -> lfo.OptimalControlProblem:
    """Return a point of the grid; all but those of the first cut-off wait until there is a file."""
    wait_until(lambda: cutoff_hz is None or Path(folder, "go on").exists())
    return SHORT(cutoff_hz=cutoff_hz, control_bound=control_bound)


@expensive
def test_two_processes_give_the_same_and_so_does_what_is_left_if_one_is_killed(serial, tmp_path):
    """When two points are done the processes wait, each at one of the others."""
    pool, killed = process_pool(2), []

    def progress(done: int, total: int) -> None:
        if done == 2:
            os.kill(killed[0], signal.SIGKILL)
            (tmp_path / "go on").touch()

    with pool:
        assert_same(lfo.sweep(SHORT, GRID, pool), serial)
        killed.append(pool.submit(os.getpid).result())
        with pytest.warns(RuntimeWarning, match="takes no more work"):
            found = lfo.sweep(partial(held, str(tmp_path)), GRID, pool, tmp_path / "sweep.jsonl", progress=progress)
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


@expensive
def test_a_point_that_kills_its_process_is_the_only_one_lost(monkeypatch):
    substitute(monkeypatch, "batch.RESUBMISSIONS", 0)
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
    assert executor.attempts == list(range(RESUBMISSIONS + 1))


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
    honest = solve_judged

    def pressed(problem, options):
        return replace(honest(problem, options), interrupted=problem.horizon == 61)

    substitute(monkeypatch, "solving.solve_judged", pressed)
    found = lfo.sweep(SHORT, {"horizon": [60, 61, 62]})
    assert found.interrupted
    assert found.column("horizon") == [60]


# --- pictures -------------------------------------------------------------------------------------------------------


@expensive
def test_the_example_of_the_docs_runs(tmp_path, monkeypatch):
    text = (Path(__file__).parents[2] / "docs" / "sweeps.md").read_text(encoding="utf-8")
    code = text.split("```python\n")[1].split("```")[0].replace("ProcessPoolExecutor", "ThreadPoolExecutor")
    monkeypatch.chdir(tmp_path)
    exec(code, {"__name__": "__main__"})
    assert {file.name for file in tmp_path.iterdir()} == {"sweep", "sweep.jsonl", "sweep.csv", "sweep.png"}
    assert set(lfo.load_sweep("sweep.jsonl").column("status")) == {"optimal", "infeasible"}


@expensive
def test_numbers_of_limits_are_swept_by_their_keys():
    mask = lfo.MagnitudeBound(0.2, bins=[3])
    problem = replace(lfo.library.double_integrator(), control_set=lfo.Box(-2, 2), control_spectrum=mask)
    found = lfo.sweep(problem, {"bound.0": [1.5, 3.0], "level.control_spectrum.0": [0.0, 20.0]})
    expected = [
        lfo.solve(replace(problem, control_set=lfo.Box(-bound, bound), control_spectrum=at)).cost
        for bound in (1.5, 3.0)
        for at in (mask, lfo.MagnitudeBound(2.0, bins=[3]))
    ]
    assert found.column("cost") == pytest.approx(expected, rel=1e-6)
    with pytest.raises(lfo.errors.ProblemError, match=r"grid\.bound\.1: .*bound\.0"):
        lfo.sweep(problem, {"bound.1": [1.0]})
