"""Consoles, exit statuses, and what is said of errors."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console, ConsoleDimensions
from rich.markup import escape

from lin_freq_ocp.errors import LinFreqOCPError, first_line
from lin_freq_ocp.starting import INTERRUPTED

if TYPE_CHECKING:
    from rich.table import Table

    from lin_freq_ocp.solving.method import Progress

PROVEN, NO_SOLUTION, BAD_INPUT, NOT_PROVEN, FAULT = 0, 1, 2, 3, 70


# room for tables that go to a file or a pipe, where nothing needs to be cut off
PAGE = ConsoleDimensions(width=200, height=100)


class PatientConsole(Console):
    """A console whose reader may leave early, as ``head`` does: what is left goes nowhere, and the status stays."""

    def on_broken_pipe(self) -> None:
        """Send the rest to nowhere."""
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


out, err = PatientConsole(), Console(stderr=True)


def written(status: int, *writes: Callable[[], object]) -> int:
    """Write files once the answer is printed; one that fails is complained of, and the status is that of bad input."""
    for write in writes:
        try:
            write()
        except (LinFreqOCPError, OSError) as error:
            complain(error)
            status = BAD_INPUT
    return status


def error_status(error: BaseException) -> int:
    """Return the exit status of an error that has no result: whose fault it is."""
    if isinstance(error, (click.Abort, KeyboardInterrupt)) or _interrupted(error):
        return INTERRUPTED
    if isinstance(error, MemoryError):
        return NOT_PROVEN
    return BAD_INPUT if isinstance(error, (LinFreqOCPError, OSError, click.ClickException)) else FAULT


def error_words(error: Exception) -> str:
    """Return what is said of an error; of one that nobody foresaw, that it is a fault of ours, and what to send."""
    if isinstance(error, MemoryError):
        return f"not enough memory for a problem of this size ({error})."
    if error_status(error) != FAULT:
        return str(error)
    from lin_freq_ocp.interchange.runs.run_file import described

    what = "nested too deeply for Python" if isinstance(error, RecursionError) else first_line(error)
    place = next(iter(described(error)["places"][::-1]), "no place")
    return (
        f"a fault of lin-freq-ocp, not of what it was given: {what} (at {place}). "
        "Please report it, with the file that 'lin-freq-ocp solve ... --dump FILE.zip' writes."
    )


def _interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C is behind an error: compiled code makes errors of its own of it."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


def complain(error: Exception | str) -> None:
    """Say on stderr what is wrong."""
    err.print(f"error: {error}", markup=False, highlight=False, soft_wrap=True)


def progress(what: str) -> AbstractContextManager[Any]:
    """Show what is being done, on a terminal."""
    return err.status(escape(what)) if err.is_terminal else nullcontext()


@contextmanager
def search_progress(what: str) -> Generator[Callable[[Progress], None] | None]:
    """Show what is being done, on a terminal, and yield what shows how far a search is."""
    if not err.is_terminal:
        yield None
        return
    with err.status(escape(what)) as status:
        yield lambda reached: status.update(escape(f"{what}: {reached}"))


def say(text: str) -> None:
    """Print a line on stdout, or on nothing, where the reader has left: click would make that the status 1."""
    try:
        click.echo(text)
    except BrokenPipeError:
        out.on_broken_pipe()


def print_json(summary: Mapping[str, Any]) -> None:
    """Print one JSON object on stdout."""
    from lin_freq_ocp.interchange.results.summary import to_json

    say(to_json(summary))


def fit_console() -> None:
    """Take the width that COLUMNS says; without it, a file or a pipe has room for whole tables."""
    columns = os.environ.get("COLUMNS", "")
    if columns.isdigit() and int(columns):
        out.width = int(columns)
    elif not out.is_terminal:
        out.size = PAGE


def print_table(table: Table, spare: Sequence[str] = ()) -> None:
    """Print a table on stdout, as wide as there is room; ``spare`` columns go first."""
    from lin_freq_ocp.report.narrow import fitted

    out.print(fitted(table, out.width, spare))


def print_lines(text: str) -> None:
    """Print lines on stdout, broken on a terminal only."""
    out.print(text, markup=False, highlight=False, soft_wrap=not out.is_terminal)
