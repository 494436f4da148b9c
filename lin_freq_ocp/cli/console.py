"""Consoles, exit statuses, printed text and tables, and the arguments and options that several commands have.

A table that is too wide for the terminal loses columns or is split into several tables. Lines are broken between words.
"""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, TypeVar

import click
from click.shell_completion import CompletionItem
from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleDimensions, Group, RenderableType
from rich.measure import Measurement
from rich.padding import Padding
from rich.table import Column, Table
from rich.text import Text

from lin_freq_ocp.base.errors import LinFreqOCPError, first_line
from lin_freq_ocp.base.interrupts import INTERRUPTED
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.tolerances import GAP_TOLERANCE

if TYPE_CHECKING:
    from lin_freq_ocp.api.result import Result
    from lin_freq_ocp.certificate.verdict import Certificate
    from lin_freq_ocp.problem.ocp import OptimalControlProblem

Command = TypeVar("Command", bound=Callable[..., object])
LONGEST_WORD = 16  # longer words, such as names of files, may be broken
ROOMY = 60  # columns: in a narrower terminal a term is above its text, not next to it
FIRST = 16  # least width of the first column, which names the row, in a table split into several
BETWEEN, INDENT = 1, 2  # blank columns between the columns of a narrow table, and before a text below its term

PROVEN, NO_SOLUTION, BAD_INPUT, NOT_PROVEN, FAULT = 0, 1, 2, 3, 70
PAGE = ConsoleDimensions(width=200, height=100)  # of a file or a pipe: wide enough for every table


class PatientConsole(Console):
    """A console whose reader may close the pipe early, as ``head`` does; this does not change the exit status."""

    def on_broken_pipe(self) -> None:
        """Discard further output."""
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


out, err = PatientConsole(emoji=False), Console(stderr=True, emoji=False)


def write_files(status: int, *writes: Callable[[], object]) -> int:
    """Write files after the answer is printed; report a failure, with the exit status of bad input."""
    for write in writes:
        try:
            write()
        except (LinFreqOCPError, OSError) as error:
            complain(error)
            status = BAD_INPUT
    return status


def complain(error: Exception | str) -> None:
    """Print an error on stderr."""
    err.print(f"error: {error}", markup=False, highlight=False, soft_wrap=True)


def error_status(error: BaseException) -> int:
    """Return the exit status of an error that has no result."""
    if isinstance(error, click.Abort):
        return INTERRUPTED
    cause: BaseException | None = error
    while cause is not None:  # compiled code turns Ctrl-C into other errors
        if isinstance(cause, KeyboardInterrupt):
            return INTERRUPTED
        cause = cause.__cause__ or cause.__context__
    if isinstance(error, MemoryError):
        return NOT_PROVEN
    return BAD_INPUT if isinstance(error, (LinFreqOCPError, OSError, click.ClickException)) else FAULT


def error_message(error: Exception) -> str:
    """Return the message of an error; that of a fault of this program asks for a report."""
    if isinstance(error, MemoryError):
        return f"not enough memory for a problem of this size ({error})."
    if error_status(error) != FAULT:
        return str(error)
    from lin_freq_ocp.files.run_file import describe_error

    cause = "nested too deeply for Python" if isinstance(error, RecursionError) else first_line(error)
    location = next(iter(describe_error(error)["places"][::-1]), "an unknown place")
    return (
        f"a fault of lin-freq-ocp, not of its input: {cause} (at {location}). "
        "Please report it, with the file that 'lin-freq-ocp solve ... --dump FILE.zip' writes."
    )


def exit_status(result: Result) -> int:
    """Return the exit status of a result."""
    if result.interrupted:
        return INTERRUPTED
    if result.status in (Status.INFEASIBLE, Status.UNBOUNDED):
        return NO_SOLUTION
    if result.tree is not None:  # with modes, an extremal need not be optimal: only the gap proves optimality
        return PROVEN if result.status == Status.OPTIMAL else NOT_PROVEN
    return NOT_PROVEN if result.certificate is None else certificate_status(result.certificate)


def certificate_status(certificate: Certificate) -> int:
    """Return the exit status of a certificate."""
    return PROVEN if certificate.status_within(GAP_TOLERANCE).solved else NOT_PROVEN


def say(text: str) -> None:
    """Print a line on stdout; discard it if the reader has closed the pipe, for which click would exit with 1."""
    try:
        click.echo(text)
    except BrokenPipeError:
        out.on_broken_pipe()


def print_lines(text: str) -> None:
    """Print lines on stdout; only a terminal breaks long ones."""
    out.print(text, markup=False, highlight=False, soft_wrap=not out.is_terminal)


def print_json(summary: Mapping[str, object]) -> None:
    """Print one JSON object on stdout."""
    from lin_freq_ocp.files.summary import to_json

    say(to_json(summary))


def print_table(table: Table, spare: Sequence[str] = ()) -> None:
    """Print a table on stdout; if it is too wide, the ``spare`` columns are dropped first."""
    out.print(fit_table(table, out.width, spare))


def print_conflict(result: Result) -> None:
    """Print the constraints that the ray uses, the conflict, and the smallest relaxations that restore feasibility."""
    for part in result.conflict or ():
        print_lines(f"ray       {part}")
    if result.explanation is not None:
        print_lines(str(result.explanation))


def print_certificate(problem: OptimalControlProblem, certificate: Certificate | None) -> None:
    """Print the conditions and the bound, if there is a certificate."""
    if certificate is not None:
        from lin_freq_ocp.pages.report.tables import certificate_table

        print_table(certificate_table(problem, certificate), ("scale", "tolerance", "residual", "worst at"))


def fit_console() -> None:
    """Set the width: from COLUMNS; otherwise a file or a pipe has room for whole tables."""
    columns = os.environ.get("COLUMNS", "")
    if columns.isdigit() and int(columns):
        out.width = int(columns)
    elif not out.is_terminal:
        out.size = PAGE


def complete_problem(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Return the completions of a problem: names of the library with their first lines, and files."""
    from lin_freq_ocp import library

    names = [name for name in library.PROBLEMS if name.startswith(incomplete)]
    shown = [CompletionItem(name, help=first_line_of(library.PROBLEMS[name])) for name in names]
    return [CompletionItem(incomplete, type="file"), *shown]


def first_line_of(function: Callable[..., object]) -> str:
    """Return the first line of a docstring."""
    return (inspect.getdoc(function) or "").partition("\n")[0]


problem_argument = click.argument("problem", metavar="NAME|FILE.toml", shell_complete=complete_problem)
settings_option = click.option(
    "--set", "settings", multiple=True, metavar="KEY=VALUE", help="Set a parameter; the value is TOML."
)
backend_option = click.option(
    "--backend", default="auto", show_default=True, help="clarabel, osqp, qpsolvers:NAME; scip, daqp."
)
METHOD_HELP = "auto; spectral, structured, convex; with modes branch_and_bound, enumerate, miqp; smooth: nonsmooth."
method_option = click.option("--method", default="auto", show_default=True, help=METHOD_HELP)
tolerance_option = click.option("--tolerance", type=float, help="Relative residuals; with modes, the gap to prove.")
time_limit_option = click.option("--time-limit", type=float, help="Seconds for the solver.")
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout and nothing else.")


def solve_options(command: Command) -> Command:
    """Add the options of solve that every method takes, and the settings of the problem."""
    for option in (tolerance_option, time_limit_option, backend_option, method_option, settings_option):
        command = option(command)
    return command


def fit_table(table: Table, width: int, spare: Sequence[str] = ()) -> RenderableType:
    """Return a table of texts in at most ``width`` columns; right-justified columns are not wrapped.

    Columns with ``spare`` headings are omitted, in this order. If that is not enough, the remaining columns are split
    into several tables, each with the first column.
    """
    widths = [_measure_column(column) for column in table.columns]
    if sum(column.maximum for column in widths) + 3 * len(widths) + 1 <= width:
        return table
    shown, left_out = list(range(len(widths))), list[str]()
    headings = [_plain(column.header) for column in table.columns]
    for heading in spare:
        if _least_width(widths, shown) <= width:
            break
        shown.remove(headings.index(heading))
        left_out.append(heading)
    if _least_width(widths, shown) > width:
        widths[0] = widths[0].with_minimum(min(widths[0].maximum, FIRST))
    first, *others = shown
    chunks = [[first]]  # the columns of each table: the first, and as many others as fit, at least one
    for i in others:
        if len(chunks[-1]) > 1 and _least_width(widths, [*chunks[-1], i]) > width:
            chunks.append([first])
        chunks[-1].append(i)
    parts = [_columns_table(table, columns, widths, width) for columns in chunks]
    for part in parts[1:]:
        part.title = None
    for part in parts[:-1]:
        part.caption = None
    if left_out:
        parts[-1].caption = Text(f"No room for: {', '.join(left_out)}.")
    return Group(*parts)


def _measure_column(column: Column) -> Measurement:
    """Return the least width of a column, given by its longest word or number, and its width without line breaks.

    Headings may be broken between words.
    """
    cells, heading = [_plain(cell) for cell in column.cells], _plain(column.header)
    natural = max((cell_len(cell) for cell in [heading, *cells]), default=0)
    words = [len(text) - len(text.lstrip()) + cell_len(word) for text in [heading, *cells] for word in text.split()]
    least = min(max(words, default=0), LONGEST_WORD)
    if column.justify == "right":
        least = max([least, *(cell_len(cell) for cell in cells)])
    return Measurement(least, natural)


def _plain(cell: RenderableType) -> str:
    return cell.plain if isinstance(cell, Text) else str(cell)


def _least_width(widths: Sequence[Measurement], columns: Sequence[int]) -> int:
    return sum(widths[i].minimum for i in columns) + BETWEEN * (len(columns) - 1)


def _columns_table(table: Table, columns: Sequence[int], widths: Sequence[Measurement], width: int) -> Table:
    """Return some columns of a table, without lines between them; they share the remaining width."""
    headers = [table.columns[i].copy() for i in columns]
    room, wanted = max(width - _least_width(widths, columns), 0), sum(widths[i].span for i in columns)
    for i, column in zip(columns, headers, strict=True):
        share = min(widths[i].span, room * widths[i].span // wanted) if wanted else 0
        column.width, column.overflow = min(widths[i].minimum + share, width), "fold"
    part = Table(*headers, title=table.title, caption=table.caption, box=box.SIMPLE_HEAD, padding=0)
    part.pad_edge, part.show_edge, part.collapse_padding = False, False, False
    cells = [list(table.columns[i].cells) for i in columns]
    for row, row_cells in zip(table.rows, zip(*cells, strict=True), strict=True):
        part.add_row(*row_cells, style=row.style, end_section=row.end_section)
    return part


def print_terms(rows: Iterable[tuple[str, str]]) -> None:
    """Print terms on stdout with their texts next to them, or below them on a narrow terminal."""
    if out.width >= ROOMY:
        grid = Table.grid(padding=(0, 2))
        grid.add_column(no_wrap=True)
        grid.add_column()
        for term, text in rows:
            grid.add_row(Text(term, style="bold"), Text(text))
        out.print(grid)
        return
    for term, text in rows:
        out.print(Text(term, style="bold"))
        if text:
            out.print(Padding(Text(text), (0, 0, 0, INDENT)))
