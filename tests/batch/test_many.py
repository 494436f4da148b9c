"""Many initial states: the answers of ``solve`` one by one, whatever is bad among them or ends on the way."""

from __future__ import annotations

import re
import signal
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from distributed import Client, LocalCluster

import lin_freq_ocp as lfo
from helpers.compilers import needs_kernel
from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp.batch import solve_part, tour
from lin_freq_ocp.solving import Resolver

PENDULUM = lfo.library.pendulum(horizon=60, sampling_time=0.04)
STARTS = PENDULUM.initial_state.lower + 1e-3 * np.random.default_rng(1).standard_normal((12, 4))
BAD = np.array([-0.15, 0.1, -1.5, 0.0])
"""From here, no control reaches the end."""


@pytest.fixture(scope="module")
def serial() -> lfo.results.Solutions:
    return lfo.solve_many(PENDULUM, STARTS)


def assert_same(found, expected):
    assert found.statuses == expected.statuses
    np.testing.assert_allclose(found.costs, expected.costs, rtol=1e-9)
    np.testing.assert_allclose(found.controls, expected.controls, atol=1e-7)


def test_answers_are_those_of_solve(serial):
    assert serial.proven
    assert not serial.interrupted
    assert (len(serial), serial.statuses) == (12, ("optimal",) * 12)
    assert (serial.controls.shape, serial.states.shape) == ((12, 60, 1), (12, 61, 4))
    np.testing.assert_allclose(serial.states[:, 0], STARTS, atol=1e-14)
    assert serial.gaps.max() < 1e-8
    for i in (0, 7):
        alone = lfo.solve(PENDULUM.with_ends(STARTS[i]))
        assert serial.costs[i] == pytest.approx(alone.cost, rel=1e-10)
        np.testing.assert_allclose(serial.controls[i], alone.trajectory.u, atol=1e-9)
        assert serial[i].certificate.globally_optimal
        assert serial[i].certificate.pmp == "satisfied"
        assert serial[i].cost == pytest.approx(serial.costs[i], rel=1e-12)


def test_what_is_bad_is_an_answer_of_its_own(serial):
    given = [*STARTS[:3], [np.nan, 0, 0, 0], [1.0, 2.0], "x", BAD, [1.0, 0, 0, 0], *STARTS[3:]]
    found = lfo.solve_many(PENDULUM, given)
    assert found.statuses == ("optimal",) * 3 + ("error",) * 3 + ("infeasible",) * 2 + ("optimal",) * 9
    good = [i for i, status in enumerate(found.statuses) if status == "optimal"]
    np.testing.assert_allclose(found.costs[good], serial.costs, rtol=1e-9)
    assert np.isnan(found.costs[3:8]).all()
    assert np.isnan(found.controls[3:8]).all()
    assert found.messages[3].startswith("initial_states[3][0]: got nan")
    assert found.messages[4].startswith("initial_states[4]: got shape (2,)")
    with pytest.raises(lfo.errors.ProblemError, match=r"initial_states\[3\]"):
        _ = found[3]
    assert found[6].status == found[7].status == "infeasible"


def test_a_state_just_outside_its_set_is_infeasible():
    problem = lfo.library.double_integrator(horizon=40, sampling_time=0.1, cutoff_hz=2.0, speed_bound=0.5)
    found = lfo.solve_many(problem, [[0, 0.49], [0, 0.5 + 1e-4], [0, 0.5]])
    assert found.statuses == ("optimal", "infeasible", "optimal")
    assert found.proven


def test_where_all_are_infeasible_nothing_is_optimal():
    assert set(lfo.solve_many(PENDULUM, BAD + 1e-3 * np.arange(3)[:, None]).statuses) == {"infeasible"}


def test_an_array_with_a_bad_row_keeps_the_others():
    given = STARTS.copy()
    given[5, 2] = np.inf
    assert lfo.solve_many(PENDULUM, given).statuses.count("error") == 1


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"initial_states": np.zeros((3, 5))}, r"initial_states: got shape \(3, 5\); expected \(N, 4\)"),
        ({"initial_states": 0.0}, "initial_states: got shape"),
        ({"initial_states": []}, "initial_states: got nothing"),
        ({"initial_states": [[1.0], [2.0]]}, r"initial_states\[0\]: got shape"),
        ({}, "initial_states: got None"),
        ({"initial_states": STARTS, "references": [{}]}, "references: got 1 of them; expected 12"),
        ({"initial_states": STARTS, "references": 3}, "references: got 3"),
        ({"initial_states": STARTS, "references": {"Q": 1}}, "references.Q: got an unknown key"),
        ({"initial_states": STARTS, "executor": 3}, "executor: got 3"),
    ],
)
def test_bad_input_as_a_whole_is_refused(given, words):
    with pytest.raises(lfo.errors.ProblemError, match=words):
        lfo.solve_many(PENDULUM, **given)


def test_references_for_each():
    given = [{"u_ref": [0.5 * k]} for k in range(3)]
    found = lfo.solve_many(PENDULUM, references=given)
    expected = [lfo.solve(PENDULUM.with_references(one)).cost for one in given]
    np.testing.assert_allclose(found.costs, expected, rtol=1e-8)
    assert lfo.solve_many(PENDULUM, STARTS[:1], references=given[1]).costs[0] == pytest.approx(expected[1], rel=0.1)


@pytest.mark.parametrize("method", ["structured", "convex"])
def test_other_methods_judge_one_by_one(method, serial):
    found = lfo.solve_many(PENDULUM, STARTS[:2], method=method)
    assert found.statuses == ("optimal", "optimal")
    np.testing.assert_allclose(found.costs, serial.costs[:2], rtol=1e-6)
    assert found[1].method == method


@needs_kernel
def test_joint_rows_are_solved_and_judged_as_a_batch(monkeypatch):
    rows = lfo.StageRows([[0.0, 0.0, 1.0, 0.0]], [[0.0]], [0.9])
    problem = replace(PENDULUM, stage_rows=rows)
    monkeypatch.setattr(Resolver, "solve", lambda *given: pytest.fail("one was left alone"))
    found = lfo.solve_many(problem, STARTS[:2])
    assert found.costs[1] == pytest.approx(lfo.solve(problem.with_ends(STARTS[1])).cost, rel=1e-8)


def test_the_examples_of_the_docs_run(tmp_path, monkeypatch, capsys):
    text = (Path(__file__).parents[2] / "docs" / "repeated.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for block in text.split("```python\n")[1:]:
        code = block.split("```")[0].replace("ProcessPoolExecutor", "ThreadPoolExecutor").replace("(200, 4)", "(8, 4)")
        exec(code, {"__name__": "__main__"})
    assert capsys.readouterr().out.count("optimal") >= 4
    assert len((tmp_path / "many.jsonl").read_text().splitlines()) == 9


# --- executors, files and Ctrl-C ------------------------------------------------------------------------------------


@expensive
def test_executors_find_the_same(serial, monkeypatch):
    substitute(monkeypatch, "batch.PART", 5)
    with ThreadPoolExecutor(2) as pool:
        assert_same(lfo.solve_many(PENDULUM, STARTS, executor=pool), serial)
    with LocalCluster(n_workers=1, processes=False, dashboard_address=":0") as cluster, Client(cluster) as client:
        assert_same(lfo.solve_many(PENDULUM, STARTS, executor=client.get_executor()), serial)


class Lossy(Executor):
    """An executor that loses parts with a certain state every time, as if it killed the worker."""

    def submit(self, function, /, changes, attempt):
        future = Future()
        if any(np.array_equal(change.initial_state, BAD) for change in changes.values()):
            future.set_exception(RuntimeError("the worker is gone"))
        else:
            future.set_result(function(changes, attempt))
        return future


def test_what_kills_its_worker_is_lost_alone(serial):
    found = lfo.solve_many(PENDULUM, [*STARTS, BAD], executor=Lossy())
    assert found.statuses == ("optimal",) * 12 + ("error",)
    assert "the worker is gone" in found.messages[12]
    np.testing.assert_allclose(found.costs[:12], serial.costs, rtol=1e-9)


def test_a_file_is_resumed(serial, tmp_path, monkeypatch):
    path = tmp_path / "many.jsonl"
    first = lfo.solve_many(PENDULUM, STARTS[:6], path=path)
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])  # killed while it wrote
    calls = []
    honest = solve_part
    substitute(monkeypatch, "batch.solve_part", lambda *given: calls.append(len(given[1])) or honest(*given))
    second = lfo.solve_many(PENDULUM, STARTS, path=path)
    assert calls == [7]
    assert_same(second, serial)
    np.testing.assert_array_equal(second.states[:5], first.states[:5])
    assert lfo.solve_many(PENDULUM, STARTS, path=path).costs.tolist() == second.costs.tolist()
    assert calls == [7]


def test_files_of_something_else_are_left_alone(tmp_path):
    path = tmp_path / "many.jsonl"
    lfo.solve_many(PENDULUM, STARTS[:2], path=path)
    before = path.read_bytes()
    for problem, given in ((lfo.library.pendulum(horizon=50), {}), (PENDULUM, {"time_limit": 5.0})):
        with pytest.raises(lfo.errors.ProblemError, match=r"a file of (another problem|other options)"):
            lfo.solve_many(problem, STARTS[:2], path=path, **given)
    assert path.read_bytes() == before
    for text in ("something", '{"kind": "lin-freq-ocp sweep"}\n'):
        path.write_text(text)
        with pytest.raises(lfo.errors.ProblemError, match="a file of solve_many"):
            lfo.solve_many(PENDULUM, STARTS[:2], path=path)
        assert path.read_text() == text


DAMAGE = {
    "cut": lambda line: line[:-9],
    "no table": lambda line: "7",
    "a key of another type": lambda line: line.replace('"key": "', '"key": ["').replace('", "status"', '"], "status"'),
    "a text for a truth": lambda line: line.replace('"proven": true', '"proven": "yes"'),
    "a truth for a number": lambda line: re.sub('"cost": [^,]*', '"cost": true', line),
    "a text for a signal": lambda line: re.sub(r'"x": \[\[[^,]*', '"x": [["much"', line),
    "another shape": lambda line: re.sub(r'"u": \[\[[^,]*, ', '"u": [', line),
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("many") / "many.jsonl"
    lfo.solve_many(PENDULUM, STARTS[:2], path=path)
    return path.read_text()


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_line_is_named(damage, recorded, tmp_path):
    lines = recorded.splitlines(keepends=True)
    changed = damage(lines[1].rstrip("\n")) + "\n"
    assert changed != lines[1]
    path = tmp_path / "many.jsonl"
    path.write_text("".join([lines[0], changed, *lines[2:]]))
    with pytest.raises(lfo.errors.ProblemError, match=r"many\.jsonl, line 2"):
        lfo.solve_many(PENDULUM, STARTS[:2], path=path)


def test_ctrl_c_keeps_what_is_found(serial, tmp_path, monkeypatch):
    substitute(monkeypatch, "batch.PART", 4)

    def pressed(done: int, count: int) -> None:
        if done == 8:
            signal.raise_signal(signal.SIGINT)

    path = tmp_path / "many.jsonl"
    found = lfo.solve_many(PENDULUM, STARTS, path=path, progress=pressed)
    assert found.interrupted
    assert not found.proven
    assert found.statuses.count("optimal") == 8
    assert found.statuses.count("unsolved") == 4
    assert_same(lfo.solve_many(PENDULUM, STARTS, path=path), serial)


def test_progress_counts():
    seen = []
    lfo.solve_many(PENDULUM, [*STARTS[:2], [np.nan] * 4], progress=lambda done, count: seen.append((done, count)))
    assert seen == [(0, 2), (2, 2)]


def test_a_tour_goes_from_each_to_one_near_it():
    states = np.random.default_rng(0).standard_normal((2500, 3)) * [1.0, 1e3, 1e-3]
    order = tour(states)
    assert sorted(order) == list(range(2500))
    steps = np.linalg.norm(np.diff(states[order] / [1.0, 1e3, 1e-3], axis=0), axis=1)
    assert np.median(steps) < 0.3
    assert tour(np.ones((3, 2))).tolist() == [0, 1, 2]


@expensive
def test_a_numerical_ray_proves_nothing_of_an_item():
    """Nothing bounds two equal controls: the ray of a stop band excludes trajectories up to a size alone."""
    h = 0.1
    dynamics = lfo.LinearDynamics([[1.0, h], [0.0, 1.0]], [[h * h / 2] * 2, [h] * 2], sampling_time=h)
    band = lfo.stop_band(bins=range(1, 11))
    cost = lfo.QuadraticCost(R=1.0)
    problem = lfo.OptimalControlProblem(dynamics, 20, cost, None, None, [0, 0], [1, 0], control_spectrum=band)
    found = lfo.solve_many(problem, initial_states=[[0, 0], [0.1, 0]])
    assert [item.status for item in found] == ["infeasible_claimed"] * 2
    assert not found.proven
    assert not lfo.solve(problem, throw=False).dual
