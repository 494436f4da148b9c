"""Tables on narrow terminals: nothing wider than the terminal, no number and no word broken, nothing lost unsaid."""

from __future__ import annotations

import io

import pytest
from rich.console import Console
from rich.table import Table

import lin_freq_ocp as lfo
from helpers.command_line import run
from lin_freq_ocp.cli import fit_table, out, print_terms
from lin_freq_ocp.pages import certificate_table, comparison_table


def printed(renderable, width):
    console = Console(file=io.StringIO(), width=width, color_system=None)
    console.print(renderable)
    return console.file.getvalue()


def words_of(table, left_out=()):
    """Return the words of all cells, but those of columns that may be left out; numbers with their marks."""
    columns = [column for column in table.columns if str(column.header) not in left_out]
    cells = [(column.justify, str(cell)) for column in columns for cell in [column.header, *column.cells]]
    return {word for justify, cell in cells for word in ([cell] if justify == "right" else cell.split())}


@pytest.fixture(scope="module")
def tables():
    problem = lfo.library.pendulum()
    comparison = lfo.compare(problem)
    certificate = comparison.constrained.certificate
    spare = ("scale", "tolerance", "residual", "worst at")
    return [(certificate_table(problem, certificate), spare), (comparison_table(comparison), ())]


@pytest.mark.parametrize("width", [40, 52, 80, 100, 200])
def test_a_table_is_as_wide_as_the_terminal_at_most_and_breaks_no_word(tables, width):
    for table, spare in tables:
        out = printed(fit_table(table, width, spare), width)
        assert max(map(len, out.splitlines())) <= width
        assert "\N{HORIZONTAL ELLIPSIS}" not in out
        gone = spare[: sum(f"{heading}," in out or f"{heading}." in out for heading in spare)]
        headings = {str(column.header) for column in table.columns}
        missing = {word for word in words_of(table, gone) - headings if word not in out}
        assert missing == set()


def test_columns_that_are_left_out_are_named():
    table = Table("name", "long", "short")
    table.add_row("a", "x" * 16, "y")
    assert "No room for: long." in " ".join(printed(fit_table(table, 12, ("long",)), 12).split())
    assert "No room" not in printed(fit_table(table, 60, ("long",)), 60)


def test_what_has_no_spare_columns_is_shown_in_several_tables_that_repeat_the_first_column():
    table = Table("name", *(f"column{i}" for i in range(6)))
    table.add_row("row", *(f"{i}.000000" for i in range(6)))
    out = printed(fit_table(table, 30), 30)
    assert out.count("row") > 1
    assert all(f"column{i}" in out and f"{i}.000000" in out for i in range(6))


def test_terms_stand_above_their_texts_where_it_is_narrow(monkeypatch, capsys):
    rows = [("a_rather_long_name", "what it means, in words"), ("b", "more")]
    for width, line, start in ((40, 1, "  what it means"), (80, 0, "a_rather_long_name  what it means, in words")):
        monkeypatch.setattr(out, "width", width)
        print_terms(rows)
        assert capsys.readouterr().out.splitlines()[line].startswith(start)


@pytest.mark.parametrize(
    "arguments",
    [
        ("list",),
        ("solve", "double_integrator"),
        ("compare", "double_integrator"),
        ("sweep", "double_integrator", "--grid", "cutoff_hz=[3,5]"),
        ("show", "double_integrator"),
    ],
)
def test_tables_of_the_command_line_at_forty_columns(arguments, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    status, out, err = run(*arguments)
    assert (status, err) == (0, "")
    before, rule, table = out.partition("\N{BOX DRAWINGS LIGHT HORIZONTAL}")
    lines = (table if rule else before).splitlines()
    assert max(map(len, lines[1:])) <= 40  # the first line is no table, and the terminal's to break
    assert "\N{HORIZONTAL ELLIPSIS}" not in out
