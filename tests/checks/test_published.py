"""Rows of ``scripts/published.py`` that take no second: their verdicts, and that a wrong value has none."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import published
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive

ROWS = {row.name: row for row in published.ROWS}


@pytest.mark.parametrize(
    ("name", "verdict"),
    [
        ("mpt3", "confirmed"),
        ("mpt3_u3", "confirmed"),
        ("hager1_10", "corrected"),
        ("hager2_10", "corrected"),
        ("hager3_10", "corrected"),
        ("hager4_10", "corrected"),
        ("ubh1_10", "corrected"),
        ("dtoc5_10", "corrected"),
        ("dtoc6_11", "corrected"),
        ("dtoc1l_10_2_4", "corrected"),
        ("bryson_10", "confirmed"),
        ("cart", "confirmed"),
        ("bryson_ho_154", "confirmed"),
        ("bryson_ho_166", "confirmed"),
        ("lqr_transfer", "confirmed"),
        ("anderson_moore", "confirmed"),
        ("ubh1_continuous", "confirmed"),
        ("liswet7", "confirmed"),
        ("fossee_liswet10_10", "corrected"),
        ("fossee_hager4_50", "corrected"),
        ("fossee_dtoc1l_6_minos", "confirmed"),
        ("mzv", "corrected"),
    ],
)
def test_rows_have_the_verdict_of_the_page(name, verdict):
    ((_, found, said, _),) = published.lines_of([ROWS[name]], None)
    assert said == verdict
    assert found.high - found.low <= 1e-5 * abs(found.high)
    if name != "mzv":  # a wrong statement would not be this near, and its reason would hide it
        assert float(ROWS[name].printed) == pytest.approx(found.high, rel=1e-3)
    assert f"| {name} |" in published.PAGE.read_text(encoding="utf-8")


def test_a_value_that_is_off_by_one_in_its_last_digit_is_unexplained():
    row = replace(ROWS["mpt3"], printed="32.4897")
    ((_, _, said, _),) = published.lines_of([row], None)
    assert said == "unexplained"


@pytest.mark.parametrize(
    ("side", "printed"), [("below", ("1.99", "2.00", "2.02")), ("above", ("2.51", "2.50", "2.48"))]
)
def test_a_printed_bound_has_to_hold_for_all_of_the_interval(side, printed):
    found = published.Found(2.0, 2.5, None, "judge")
    rows = [replace(ROWS["mpt3"], printed=value, side=side) for value in printed]
    assert [published.verdict(row, found) for row in rows] == ["confirmed", "confirmed", "unexplained"]


@expensive
@pytest.mark.parametrize(("T", "excluded"), [(1.999, True), (2.001, False)])
def test_a_multiplier_excludes_the_times_below_the_least_one(T, excluded):
    A, B = published.DOUBLE  # from 0 to 1 at rest with |u| <= 1: 2 s
    assert published.unreachable(A, B, np.zeros(2), np.array([1.0, 0.0]), [], 1.0, T) == excluded


def test_the_bound_of_a_convex_sequence_is_that_of_all_its_points_as_controls():
    N = 10
    t = np.arange(N + 2) / (N + 1)
    x_ref = np.column_stack([np.cos(3.1415 * t) + 0.1 * np.sin(np.arange(1, N + 3)), np.zeros(N + 2)])
    square = np.diag([1.0, 0.0])
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1, 1], [0, 1]], [[0], [1]]),  # the value, the difference to the next one
        N + 1,
        lfo.QuadraticCost(Q=square, P=square, x_ref=x_ref),
        lfo.Box([0], [None]),
    )
    interval = lfo.solve(problem).enclosure
    found = ROWS["fossee_liswet10_10"].find(None, "")
    assert found.high - found.low <= 1e-8
    assert found.low <= interval.upper
    assert interval.lower <= found.high


def test_sixty_rows_count_when_ten_of_a_source_and_five_of_a_problem_do():
    counts = {"CUTEst": Counter(), "": Counter()}
    for row in ROWS.values():
        project, problem = row.source.partition(",")[0], row.statement.partition(":")[0]
        counts[project if project in counts else ""][problem] += 1
    assert max(counts[""].values()) <= 5
    projects = Counter(row.source.partition(",")[0] for row in ROWS.values())
    assert len(projects) >= 8
    assert max(count for project, count in projects.items() if project != "CUTEst") <= 10
    left = sum(min(count, 5 - counts[""][problem]) for problem, count in counts["CUTEst"].items())
    assert counts[""].total() + min(10, left) >= 60


def test_an_objective_that_two_formulas_value_differently_is_unexplained():
    found = published.Found(1.0, 1.0, 1.0 + 1e-9, "judge")
    row = replace(ROWS["mpt3"], printed="1.0", find=lambda folder, name: found)
    assert [said for _, _, said, _ in published.lines_of([row], None)] == ["unexplained"]


def test_the_page_has_every_row_and_proofs_are_verified(tmp_path):
    text = published.PAGE.read_text(encoding="utf-8")
    assert [name for name in ROWS if f"| {name} |" not in text] == []
    assert "0 unexplained" in text
    assert published.main(["hager1_10", "--proofs", str(tmp_path)]) == 0
    assert (tmp_path / "hager1_10.proof").stat().st_size > 0
