"""Consoles, exit statuses, and what commands print."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TYPE_CHECKING

import click
from rich.console import Console, ConsoleDimensions
from rich.markup import escape

from lin_freq_ocp.base.errors import LinFreqOCPError, first_line
from lin_freq_ocp.base.interrupts import INTERRUPTED
from lin_freq_ocp.base.status import Status

if TYPE_CHECKING:
    from rich.table import Table

    from lin_freq_ocp.api.result import Result
    from lin_freq_ocp.certificate.verdict import Certificate
    from lin_freq_ocp.problem.ocp import OptimalControlProblem

PROVEN, NO_SOLUTION, BAD_INPUT, NOT_PROVEN, FAULT = 0, 1, 2, 3, 70
PAGE = ConsoleDimensions(width=200, height=100)  # of a file or a pipe, where no table needs to be cut off


class PatientConsole(Console):
    """A console whose reader may close the pipe early, as ``head`` does: the rest is dropped, the status is kept."""

    def on_broken_pipe(self) -> None:
        """Drop the rest."""
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


out, err = PatientConsole(), Console(stderr=True)


def written(status: int, *writes: Callable[[], object]) -> int:
    """Write files after the answer is printed; a failure is reported, and the status is that of bad input."""
    for write in writes:
        try:
            write()
        except (LinFreqOCPError, OSError) as error:
            complain(error)
            status = BAD_INPUT
    return status


def error_status(error: BaseException) -> int:
    """Return the exit status of an error that has no result."""
    if isinstance(error, (click.Abort, KeyboardInterrupt)) or _interrupted(error):
        return INTERRUPTED
    if isinstance(error, MemoryError):
        return NOT_PROVEN
    return BAD_INPUT if isinstance(error, (LinFreqOCPError, OSError, click.ClickException)) else FAULT


def error_message(error: Exception) -> str:
    """Return the message of an error; an unexpected error is a fault of this program, with a request to report it."""
    if isinstance(error, MemoryError):
        return f"not enough memory for a problem of this size ({error})."
    if error_status(error) != FAULT:
        return str(error)
    from lin_freq_ocp.files.runs.run_file import described

    what = "nested too deeply for Python" if isinstance(error, RecursionError) else first_line(error)
    location = next(iter(described(error)["places"][::-1]), "no place")
    return (
        f"a fault of lin-freq-ocp, not of what it was given: {what} (at {location}). "
        "Please report it, with the file that 'lin-freq-ocp solve ... --dump FILE.zip' writes."
    )


def _interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused an error: compiled code turns it into errors of its own."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


def complain(error: Exception | str) -> None:
    """Print an error on stderr."""
    err.print(f"error: {error}", markup=False, highlight=False, soft_wrap=True)


def progress(what: str) -> AbstractContextManager[object]:
    """Show the current work, on a terminal."""
    return err.status(escape(what)) if err.is_terminal else nullcontext()


@contextmanager
def search_progress(what: str) -> Generator[Callable[[object], None] | None]:
    """Show the current work, on a terminal, and yield a function that shows the progress of a search."""
    if not err.is_terminal:
        yield None
        return
    with err.status(escape(what)) as status:
        yield lambda reached: status.update(escape(f"{what}: {reached}"))


def say(text: str) -> None:
    """Print a line on stdout; where the reader has closed the pipe, drop it: click would exit with the status 1."""
    try:
        click.echo(text)
    except BrokenPipeError:
        out.on_broken_pipe()


def print_json(summary: Mapping[str, object]) -> None:
    """Print one JSON object on stdout."""
    from lin_freq_ocp.files.results.summary import to_json

    say(to_json(summary))


def fit_console() -> None:
    """Take the width from COLUMNS; without it, a file or a pipe has room for whole tables."""
    columns = os.environ.get("COLUMNS", "")
    if columns.isdigit() and int(columns):
        out.width = int(columns)
    elif not out.is_terminal:
        out.size = PAGE


def print_table(table: Table, spare: Sequence[str] = ()) -> None:
    """Print a table on stdout; where it is too wide, ``spare`` columns are dropped first."""
    from lin_freq_ocp.pages.report.narrow import fitted

    out.print(fitted(table, out.width, spare))


def print_lines(text: str) -> None:
    """Print lines on stdout, broken on a terminal only."""
    out.print(text, markup=False, highlight=False, soft_wrap=not out.is_terminal)


def exit_status(result: Result) -> int:
    """Return the exit status of a result."""
    if result.interrupted:
        return INTERRUPTED
    if result.status in (Status.INFEASIBLE, Status.UNBOUNDED):
        return NO_SOLUTION
    if result.tree is not None:  # with modes, an extremal need not be optimal: the gap counts
        return PROVEN if result.status == Status.OPTIMAL else NOT_PROVEN
    return NOT_PROVEN if result.certificate is None else certificate_status(result.certificate)


def certificate_status(certificate: Certificate) -> int:
    """Return the exit status of a certificate."""
    extremal = certificate.pmp == "satisfied" and certificate.normal
    return PROVEN if extremal or certificate.globally_optimal else NOT_PROVEN


def print_conflict(result: Result) -> None:
    """Print the constraints in conflict, and the changes that would help."""
    for part in result.conflict or ():
        print_lines(f"conflict  {part}")
    if result.explanation is not None:
        print_lines(str(result.explanation))


def print_certificate(problem: OptimalControlProblem, certificate: Certificate | None) -> None:
    """Print the conditions and the bound, if there is a certificate."""
    if certificate is not None:
        from lin_freq_ocp.pages.report.tables import certificate_table

        print_table(certificate_table(problem, certificate), ("scale", "tolerance", "residual", "worst at"))
