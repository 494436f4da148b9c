"""Contenders of the benchmark agree on small problems, and rows contain their residuals. No times.

Run by .ci/run: python -m pytest scripts/benchmark/test_benchmark.py
"""

import csv
import os
import sys
from dataclasses import replace

import numpy as np
import pytest
from rich.table import Table

import lin_freq_ocp as lfo
from benchmark import loop, measures, modes, solvers
from benchmark.cases import FAMILIES, small
from benchmark.contenders import CONTENDERS, CvxpyModel, OurResolver
from benchmark.loop_cases import elastic_wall
from benchmark.measures import Row
from benchmark.record import Record
from benchmark.solvers import draw, label_shifts, summary

RESIDUALS = ("error", "gap", "dynamics", "stop_band", "bounds", "adjoint")
LIMIT = 20.0


@pytest.mark.parametrize("problem", [small(), FAMILIES["chain"].problem(200)], ids=["small", "chain"])
def test_all_contenders_agree_and_their_rows_hold_all_residuals(problem):
    runs = solvers.race(problem, list(CONTENDERS), repeats=1, limit=LIMIT)
    rows, reference = measures.measured("some family", problem, runs)
    assert [row.contender for row in rows] == list(CONTENDERS)
    assert reference is not None
    assert "NOT" not in str(reference)
    for row in rows:
        assert row.status == "optimal", row
        assert all(abs(getattr(row, name)) < 1e-6 for name in RESIDUALS), row
        assert row.seconds > 0


def test_residuals_see_what_is_wrong():
    problem = small()
    good = CONTENDERS["clarabel"](problem, LIMIT)
    fine = measures.residuals(problem, good)
    u = good.trajectory.u + 0.1 * np.cos(np.pi * np.arange(problem.horizon))[:, None]
    eta = good.multipliers.eta * np.linspace(1, 1.1, problem.horizon)[:, None]
    parts = {name: getattr(good.multipliers, name) for name in ("eta_C", "mu", "nu", "rho_u", "rho_x")}
    bad = measures.Answer(
        "optimal", "", lfo.Trajectory(1.1 * good.trajectory.x, u), lfo.results.Multipliers(eta=eta, **parts)
    )
    wrong = measures.residuals(problem, bad)
    assert max(fine.values()) < 1e-8
    assert min(wrong.values()) > 1e-3


def test_the_cvxpy_model_has_the_multipliers_of_the_theorem():
    problem = FAMILIES["chain"].problem(200)
    answer = CvxpyModel(problem, problem.initial_state.lower).solve(LIMIT)
    certificate = lfo.certify(problem, answer.trajectory, answer.multipliers)
    assert certificate.pmp == "satisfied", certificate.failed


def test_who_was_slow_is_skipped():
    assert solvers.skip_reason("clarabel", 480, None, LIMIT) == ""
    assert solvers.skip_reason("clarabel", 480, (240, 0.1), LIMIT) == ""
    assert "> 20 s expected" in solvers.skip_reason("clarabel", 2400, (240, 0.1), LIMIT)
    assert "> 20 s at T = 960" in solvers.skip_reason("osqp", 1000, (960, 21.0), LIMIT)
    assert "no smaller" in solvers.skip_reason("clarabel", 100_000, None, LIMIT)
    assert solvers.skip_reason("ours", 1_000_000, None, LIMIT) == ""
    assert solvers.skip_reason("ours", 100_000, (10_000, 0.1), LIMIT) == ""


def test_a_skipped_contender_has_a_row_that_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(solvers, "skip_reason", lambda name, *_: "" if name == "ours" else "skipped: for a test")
    rows, notes = solvers.family_rows("bang-bang", [200], repeats=2, limit=LIMIT)
    assert [row.status for row in rows] == ["optimal"] + ["skipped"] * (len(CONTENDERS) - 1)
    assert (rows[0].runs, rows[0].ratio, len(notes)) == (2, 1.0, 1)
    assert solvers.table_of("title", rows, notes).row_count == len(rows)
    solvers.save_csv(rows, tmp_path / "rows.csv")
    with (tmp_path / "rows.csv").open(newline="") as file:
        saved = list(csv.DictReader(file))
    assert saved[0]["remark"] == ""
    assert saved[1]["remark"] == "skipped: for a test"
    assert float(saved[0]["dynamics"]) == rows[0].dynamics


def test_failures_are_told_and_not_repeated(monkeypatch):
    def fail(problem, limit):
        raise lfo.errors.UnsupportedError("not this one")

    monkeypatch.setitem(CONTENDERS, "piqp", fail)
    runs = solvers.race(small(), ["clarabel", "piqp"], repeats=2, limit=LIMIT)
    rows, _ = measures.measured("some family", small(), runs)
    assert [(row.runs, row.status) for row in rows] == [(2, "optimal"), (1, "failed")]
    assert rows[1].remark == "UnsupportedError"


@pytest.mark.parametrize("family", ["resolve", "resolve-slow"])
def test_resolving_shows_the_worst_of_all_initial_states(family):
    rows, note = solvers.resolve_rows(family, 240, 3, LIMIT)
    assert {row.contender for row in rows} == {"ours", "cvxpy+clarabel", "clarabel"}
    assert all(row.family == family and row.runs == 3 for row in rows), rows
    assert all(abs(getattr(row, name)) < 1e-6 for row in rows for name in RESIDUALS), rows
    assert "3 initial states" in note


def test_a_resolve_answers_for_its_own_initial_state():
    problem = small()
    moved = replace(small(), initial_state=(0.01, 0.0))
    answer = OurResolver(problem)(moved, LIMIT)
    assert lfo.certify(moved, answer.trajectory, answer.multipliers).globally_optimal


def test_families_of_several_horizons_and_contenders_are_drawn(tmp_path):
    rows = [Row("chain", T, name, "optimal", seconds=T / 1e4) for T in (200, 400) for name in ("ours", "osqp")]
    assert draw(rows, tmp_path / "drawn.png")
    assert (tmp_path / "drawn.png").stat().st_size > 0
    assert not draw(rows[:2], tmp_path / "one_horizon.png")
    assert not draw(rows[::2], tmp_path / "ours_alone.png")


def test_labels_are_spread():
    shifted = np.array([0.0, 1.0, 50.0]) + label_shifts(np.array([0.0, 1.0, 50.0]))
    assert np.diff(shifted).min() >= 10


def test_tables_are_written_with_machine_date_and_command(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["scripts/benchmark.py", "some", "--write"])
    table = Table("|V| [ms]", "gap", "empty", title="some title")
    table.columns[1].justify = "right"
    table.add_row("one", "1e-9", "")
    with Record("some", tmp_path) as record:
        record.show(table)
        record.show("A sentence.")
    text = (tmp_path / "some.md").read_text()
    assert "python scripts/benchmark.py some --write\n" in text
    assert "**some title**\n\n| \\|V\\| [ms] | gap |\n| --- | ---: |\n| one | 1e-9 |\n\nA sentence." in text
    assert f"lin_freq_ocp {lfo.__version__}" in text.splitlines()[-1]
    assert f"{os.cpu_count()} cores" in text.splitlines()[-1]


def test_a_run_that_fails_writes_no_table(tmp_path):
    with pytest.raises(KeyError), Record("some", tmp_path):
        raise KeyError
    assert not list(tmp_path.iterdir())


def test_the_summary_has_a_line_for_each_horizon():
    ours = Row("chain", 100, "ours", "optimal", seconds=0.01, ratio=1.0, gap=1e-9)
    rows = [ours, Row("chain", 100, "osqp", "limit", ratio=20.3), Row("chain", 200, "ours", "optimal")]
    first, second = zip(*(column.cells for column in summary(rows).columns), strict=True)
    assert first[1:] == ("100", "10 ms", "-", "-", "-", "(20 x)", "1e-09", "")
    assert (first[0], *second[:2]) == (FAMILIES["chain"].words, "", "200")


def test_contenders_of_the_benchmark_agree():
    problem = lfo.library.pendulum_with_wall(horizon=5, control_spectrum="freq")
    rows = [modes.row_of("small", name, problem, 20.0, 1e-6) for name in modes.CONTENDERS]
    assert [row.status for row in rows] == ["optimal"] * len(rows)
    assert all(row.words == "" for row in modes.judged(rows, 1e-6))
    wrong = [*rows, replace(rows[0], cost=2 * rows[0].cost), replace(rows[0], bound=2 * rows[0].cost)]
    assert [row.words for row in modes.judged(wrong, 1e-6)][-2:] == [
        "WRONG: not optimal",
        "WRONG: bound above the best cost",
    ]
    assert modes.table_of("small", rows).row_count == len(rows)


@pytest.mark.filterwarnings("ignore")  # those of the other packages
@pytest.mark.parametrize("name", loop.CASES)
def test_contenders_of_the_loop_agree(name):
    problem = loop.CASES[name](20)
    steps = loop.contenders(problem)
    state = 0.3 * problem.initial_box.lower
    expected = steps.pop("auto")(state)
    for contender, step in steps.items():
        np.testing.assert_allclose(step(state), expected, atol=2e-3, err_msg=contender)


def test_the_pendulum_at_an_elastic_wall_is_that_of_pympc():
    """Its notebook prints 28 facets of the terminal set; the optimum is that of the repository, 211.10986."""
    problem = elastic_wall()
    assert len(problem.terminal_state.g) == 28
    assert lfo.solve(problem).cost == pytest.approx(211.10986, rel=1e-7)
