"""Rows of ``scripts/published.py`` that take no second: their verdicts, and that a wrong value has none."""

from __future__ import annotations

from dataclasses import replace

import published
import pytest

ROWS = {row.name: row for row in published.ROWS}


@pytest.mark.parametrize(
    ("name", "verdict"),
    [("mpt3", "confirmed"), ("mpt3_u3", "confirmed"), ("hager1_10", "corrected"), ("hager2_10", "corrected")],
)
def test_rows_have_the_verdict_of_the_page(name, verdict):
    ((_, found, said, _),) = published.lines_of([ROWS[name]], None)
    assert said == verdict
    assert found.high - found.low <= 1e-5 * abs(found.high)
    assert f"| {name} |" in published.PAGE.read_text(encoding="utf-8")


def test_a_value_that_is_off_by_one_in_its_last_digit_is_unexplained():
    row = replace(ROWS["mpt3"], printed="32.4897")
    ((_, _, said, _),) = published.lines_of([row], None)
    assert said == "unexplained"


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
