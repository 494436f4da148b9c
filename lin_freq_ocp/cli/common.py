"""What the commands share: exit statuses, consoles, options, and the problem that their arguments describe."""

from __future__ import annotations

import inspect
import os
import sys
import tomllib
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem
from rich.console import Console, ConsoleDimensions
from rich.markup import escape

from lin_freq_ocp import library
from lin_freq_ocp.arrays import brief
from lin_freq_ocp.comparison.sweep.grid import CUTOFFS
from lin_freq_ocp.errors import LinFreqOCPError, ProblemError, first_line, suggestion
from lin_freq_ocp.interchange.places import naming
from lin_freq_ocp.interchange.problem_file.problem_file import read_problem
from lin_freq_ocp.interchange.problem_file.problem_tables import OPTIONAL_KEYS, REQUIRED_KEYS
from lin_freq_ocp.interchange.results.summary import to_json
from lin_freq_ocp.interchange.runs.run_file import described
from lin_freq_ocp.methods.modes.search import SearchProgress
from lin_freq_ocp.methods.nonsmooth.local_search import SmoothProgress
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.starting import INTERRUPTED

if TYPE_CHECKING:
    from rich.table import Table

PROVEN, NO_SOLUTION, BAD_INPUT, NOT_PROVEN, FAULT = 0, 1, 2, 3, 70

PAGE = ConsoleDimensions(width=200, height=100)
"""Room for tables that go to a file or a pipe, where nothing needs to be cut off."""


class PatientConsole(Console):
    """A console whose reader may leave early, as ``head`` does: what is left goes nowhere, and the status stays."""

    def on_broken_pipe(self) -> None:
        """Send the rest to nowhere."""
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


out, err = PatientConsole(), Console(stderr=True)


def complete_problem(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Return what a shell offers for a problem: the library's names with what they show, and files."""
    names = [name for name in library.PROBLEMS if name.startswith(incomplete)]
    shown = [CompletionItem(name, help=first_words(library.PROBLEMS[name])) for name in names]
    return [CompletionItem(incomplete, type="file"), *shown]


def first_words(function: Callable[..., Any]) -> str:
    """Return the first line of a docstring."""
    return (inspect.getdoc(function) or "").partition("\n")[0]


problem_argument = click.argument("problem", metavar="NAME|FILE.toml", shell_complete=complete_problem)
settings_option = click.option(
    "--set", "settings", multiple=True, metavar="KEY=VALUE", help="Set a parameter; the value is TOML."
)
backend_option = click.option(
    "--backend", default="auto", show_default=True, help="clarabel, osqp, qpsolvers:NAME; scip, daqp."
)
METHOD_HELP = "auto; spectral or convex; for modes branch_and_bound, enumerate or miqp; smooth: nonsmooth."
method_option = click.option("--method", default="auto", show_default=True, help=METHOD_HELP)
tolerance_option = click.option("--tolerance", type=float, help="Relative residuals, or over modes the gap to prove.")
time_limit_option = click.option("--time-limit", type=float, help="Seconds for the solver.")
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout and nothing else.")


def build(problem: str, settings: Sequence[str]) -> OptimalControlProblem:
    """Return the library problem of that name, or the problem in that file, with the settings applied.

    Raises
    ------
    ProblemError
        If there is no such problem, a setting is not TOML, or the problem has no such parameter.
    """
    given = parsed_settings(settings)
    if is_file(problem):
        return ProblemFile.read(problem, given).problem
    try:
        return builder(problem, given)()
    except ProblemError:
        raise
    except (
        TypeError,
        ValueError,
        ArithmeticError,
        LookupError,
        AttributeError,
    ) as error:  # one of a wrong type, met in the midst of a formula
        raise ProblemError("--set", brief(given), f"parameters that {problem} can use", f"({error})") from None


@dataclass(frozen=True)
class ProblemFile:
    """A problem file as a function of its keys; those of tables with dots, ``control_set.upper``.

    ``cutoff`` (rad/sample) and ``cutoff_hz`` stand for a low pass of all controls in place of the file's
    ``control_spectrum``, as in ``lfo.sweep``.

    Attributes
    ----------
    path : Path
        Read anew for every point; not part of what is compared when a sweep is resumed.
    settings : dict
        Values that take precedence over the file's.
    problem : OptimalControlProblem
        What the file describes; read first, so that a file with a fault is no sweep of errors.
    """

    path: Path = field(compare=False)
    settings: Mapping[str, Any]
    problem: OptimalControlProblem

    @classmethod
    def read(cls, path: str, settings: Mapping[str, Any]) -> ProblemFile:
        """Read the file, with these settings.

        Raises
        ------
        ProblemError
            If a setting has an unknown key, two set the same, or the file describes no problem.
        """
        with naming(Path(path)):
            require_keys_of_file(settings)
        return cls(Path(path), settings, read_problem(path, file_tables(settings)))

    @property
    def name(self) -> str:
        """Return the name of the problem, or else that of the file."""
        return self.problem.name or self.path.stem

    def __call__(self, **parameters: Any) -> OptimalControlProblem:
        """Return the problem with these values, which take precedence over the settings."""
        replaced = SPECTRA if any(key in SPECTRA for key in parameters) else ()
        tables = _copied({key: value for key, value in self.settings.items() if key not in replaced})
        for key, value in parameters.items():
            merge_tables(tables, _nested(key, value))
        return read_problem(self.path, file_tables(tables))


FILE_KEYS = (*REQUIRED_KEYS, *OPTIONAL_KEYS, *CUTOFFS)
"""What --set and --grid can change in a problem file, at the top; within tables, keys are written with dots."""

SPECTRA = ("control_spectrum", *CUTOFFS)
"""Keys that all set the frequency constraints of the controls."""


def require_keys_of_file(keys: Iterable[str], option: str = "") -> None:
    """Raise ProblemError unless problem files have these keys, or they stand for one, each of another field."""
    for key in keys:
        first = key.partition(".")[0]
        if first not in FILE_KEYS:
            known = f"one of {', '.join(FILE_KEYS)}"
            advice = suggestion(first, FILE_KEYS) or "Those of tables are written with dots, such as control_set.upper."
            raise ProblemError(f"{option}{key}", "an unknown key", known, advice)
    given = [key for key in SPECTRA if key in keys]
    if len(given) > 1:
        raise ProblemError(f"{option}{given[1]}", f"{given[0]}, too", "one of them", "Both set the same.")


def file_tables(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings as the tables of a problem file: a cut-off as the low pass that it stands for."""
    tables = {key: value for key, value in settings.items() if key not in CUTOFFS}
    for key in CUTOFFS:
        if key in settings:
            low_pass = {"kind": "low_pass", key: settings[key]}
            tables["control_spectrum"] = None if settings[key] is None else [low_pass]
    return tables


def is_file(problem: str) -> bool:
    """Whether this argument means a file, and not a library problem."""
    return problem not in library.PROBLEMS and (problem.endswith(".toml") or Path(problem).is_file())


def builder(name: str, given: Mapping[str, Any]) -> partial[OptimalControlProblem]:
    """Return the function that builds the library problem of that name, with these parameters set.

    Raises
    ------
    ProblemError
        If there is no such problem, or it has no such parameter.
    """
    function = library.by_name(name)
    parameters = inspect.signature(function).parameters
    for key in given:
        if key not in parameters:
            known = f"some of {', '.join(parameters)}"
            raise ProblemError(f"--set {key}", "no parameter of that name", known, suggestion(key, parameters))
    return partial(function, **given)


def parsed_settings(settings: Sequence[str]) -> dict[str, Any]:
    """Return KEY=VALUE settings as nested tables; dotted keys name entries of tables."""
    result: dict[str, Any] = {}
    for setting in settings:
        try:
            table = without_none(tomllib.loads(setting))
            merge_tables(result, table)
        except (ValueError, RecursionError) as error:  # numbers of thousands of digits and deep nesting, too
            advice = f"Text needs quotes within quotes: --set 'name=\"text\"'. ({error})"
            raise ProblemError("--set", brief(setting), "KEY=VALUE with a TOML value", advice) from None
        if not table:
            raise ProblemError("--set", brief(setting), "KEY=VALUE with a TOML value")
    return result


def without_none(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table with None for the text "none", which stands for no value: TOML has no word for that."""
    return {
        key: None if value == "none" else without_none(value) if isinstance(value, dict) else value
        for key, value in table.items()
    }


def require_writable(option: str, file: Path, problem: str) -> None:
    """Raise ProblemError unless something can be written to the file: an answer must not be lost to a slip."""
    if file.is_dir():
        raise ProblemError(f"{option} {file}", "a folder", "a file to write")
    if not file.absolute().parent.is_dir():
        raise ProblemError(f"{option} {file}", "a file in a folder that does not exist", "a file in an existing folder")
    if file.exists() and Path(problem).exists() and file.samefile(problem):
        raise ProblemError(f"{option} {file}", "the problem's own file", "another file")


def require_folder(folder: Path) -> None:
    """Raise ProblemError unless the folder exists or can be made."""
    for path in (folder, *folder.absolute().parents):
        if path.exists():
            if not path.is_dir():
                raise ProblemError(f"--out {folder}", f"{path}, a file", "a folder")
            return


def merge_tables(into: dict[str, Any], new: Mapping[str, Any]) -> None:
    """Put new entries into nested tables."""
    for key, value in new.items():
        if isinstance(value, dict) and isinstance(into.get(key), dict):
            merge_tables(into[key], value)
        else:
            into[key] = value


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


def _copied(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested tables that can be changed without changing the given ones."""
    return {key: _copied(value) if isinstance(value, Mapping) else value for key, value in table.items()}


def _nested(key: str, value: Any) -> dict[str, Any]:
    first, _, rest = key.partition(".")
    return {first: _nested(rest, value) if rest else value}


def complain(error: Exception | str) -> None:
    """Say on stderr what is wrong."""
    err.print(f"error: {error}", markup=False, highlight=False, soft_wrap=True)


def progress(what: str) -> AbstractContextManager[Any]:
    """Show what is being done, on a terminal."""
    return err.status(escape(what)) if err.is_terminal else nullcontext()


@contextmanager
def search_progress(what: str) -> Generator[Callable[[SearchProgress | SmoothProgress], None] | None]:
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
