"""Rows of the tables are the measures and the conditions, with their units."""

from __future__ import annotations

from io import StringIO

import pytest
from rich.console import Console

from helpers.compared_pages import CASES, case
from helpers.seeds import seeds
from lin_freq_ocp.base import NOTHING, split_unit
from lin_freq_ocp.pages import certificate_table, comparison_rows, comparison_table, worst_location


def test_comparison_rows_are_the_measures():
    comparison = case("pendulum")
    groups = {group.title: group.rows for group in comparison_rows(comparison).groups}
    constrained = comparison.constrained_measures
    assert constrained is not None
    measured = [comparison.classical_measures, *(one.replay.measures for one in comparison.filtered), constrained]
    assert comparison_rows(comparison).columns[:2] == ("classical", "brickwall")
    for column, measures in enumerate(measured):

        def largest(title: str, column: int = column) -> float:
            return max(float(row.cells[column].text) for row in groups[title])

        for title, value in {
            "": measures.cost,
            "Largest magnitude": measures.max_control,
            "Violates the control bounds by": measures.control_violation,
            "Violates the state bounds by": measures.state_violation,
            "Misses the end state by": measures.terminal_error,
        }.items():
            assert largest(title) == pytest.approx(value, rel=0.05 if value and value < 1e-3 else 1e-3)
        energy, peak = groups["Stop band of the controls"]
        assert float(energy.cells[column].text) == pytest.approx(measures.stopband_energy, rel=0.05)
        assert float(peak.cells[column].text) == pytest.approx(measures.stopband_peak, rel=1e-3)


@pytest.mark.parametrize("name", ["pendulum", "state band", "two controls"])
def test_certificate_table_has_the_conditions(name: str):
    problem, certificate = case(name).problem, case(name).constrained.certificate
    assert certificate is not None
    columns = [[str(cell) for cell in column.cells] for column in certificate_table(problem, certificate).columns]
    for *texts, verdict, place, one in zip(*columns, certificate.conditions, strict=True):
        label, named, residual, scale, relative, _ = texts
        assert (label, named, verdict) == (one.label, one.name, "holds" if one.passed else "fails")
        for shown, value in ((residual, one.residual), (scale, one.scale), (relative, one.relative)):
            assert float(shown) == pytest.approx(value, rel=0.06)
        assert place == worst_location(problem, one)
        if one.residual == 0 or one.component is None:
            assert place == NOTHING
        else:
            names = problem.control_names if one.label in ("C-v", "C-vii", "S-u", "N-u") else problem.state_names
            assert place.endswith(split_unit(names[one.component])[0])
            assert str(one.time) in place
            assert ("bin" in place) == (one.label in ("C-vi", "C-vii"))


@pytest.mark.parametrize("name", seeds(CASES))
def test_terminal_tables_show_units_and_rows(name: str):
    comparison = case(name)
    console = Console(file=StringIO(), width=220)
    console.print(comparison_table(comparison))
    shown = console.file.getvalue()
    for group in comparison_rows(comparison).groups:
        for row in group.rows:
            assert (f"{row.label} [{row.unit}]" if row.unit else row.label) in shown
            for cell in row.cells:
                assert cell.text in shown
    certificate = comparison.constrained.certificate
    if certificate is not None:
        console.print(certificate_table(comparison.problem, certificate))
        assert "maximum principle satisfied" in console.file.getvalue()
        assert all(f" {one.name} " in console.file.getvalue() for one in certificate.conditions)
