"""The command lin-freq-ocp sweep: a problem at every point of a grid, on several processes.

Exit status: 0 every point has an answer with its proof, be it optimal, infeasible or unbounded; 2 bad input; 3 some
point has none; 130 interrupted, and what is finished is kept.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import numpy as np

from lin_freq_ocp.atomic import replacing, writing
from lin_freq_ocp.cli_common import (
    NOT_PROVEN,
    PROVEN,
    backend_option,
    builder,
    complain,
    err,
    is_file,
    json_option,
    merge_tables,
    method_option,
    out,
    parsed_settings,
    print_json,
    problem_argument,
    require_folder,
    settings_option,
    time_limit_option,
    tolerance_option,
    written,
)
from lin_freq_ocp.comparison.sweep import Sweep, sweep
from lin_freq_ocp.comparison.sweep_grid import CUTOFFS, MOST_POINTS, with_values
from lin_freq_ocp.comparison.sweep_tasks import WorkerPool, process_pool
from lin_freq_ocp.errors import ProblemError, suggestion
from lin_freq_ocp.interchange.problem_file import read_problem
from lin_freq_ocp.interchange.problem_tables import OPTIONAL_KEYS, REQUIRED_KEYS
from lin_freq_ocp.interchange.sweep_file import sweep_summary
from lin_freq_ocp.problem.arrays import brief
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.starting import INTERRUPTED

RANGE = re.compile(r"\s*([^:\[\],\s]+):([^:\[\],\s]+):(\d+)\s*")
"""from:to:count, linear, both ends included."""

GRID_FORM = "KEY=[VALUE, ...] in TOML, or KEY=from:to:count"


@dataclass(frozen=True)
class ProblemFile:
    """A problem file as a function of its keys; those of tables with dots, ``control_set.upper``.

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

    @property
    def name(self) -> str:
        """Return the name of the problem, or else that of the file."""
        return self.problem.name or self.path.stem

    def __call__(self, **parameters: Any) -> OptimalControlProblem:
        """Return the problem with these values; ``cutoff`` and ``cutoff_hz`` as in ``lfo.sweep``."""
        tables: dict[str, Any] = {}
        merge_tables(tables, self.settings)
        for key, value in parameters.items():
            if key not in CUTOFFS:
                merge_tables(tables, _nested(key, value))
        cutoffs = {key: value for key, value in parameters.items() if key in CUTOFFS}
        problem = read_problem(self.path, tables)
        return with_values(problem, cutoffs) if cutoffs else problem


@click.command("sweep")
@problem_argument
@click.option("--grid", "grids", multiple=True, required=True, metavar="KEY=VALUES", help=f"{GRID_FORM}; repeatable.")
@settings_option
@method_option
@backend_option
@time_limit_option
@tolerance_option
@click.option("--workers", type=click.IntRange(min=1), default=1, show_default=True, help="Processes to solve on.")
@click.option(
    "--out", "folder", type=click.Path(path_type=Path), help="Write sweep.jsonl, .csv and .png here; resume from it."
)
@json_option
def sweep_command(
    problem: str,
    grids: tuple[str, ...],
    settings: tuple[str, ...],
    method: str,
    backend: str,
    time_limit: float | None,
    tolerance: float | None,
    workers: int,
    folder: Path | None,
    as_json: bool,
) -> int:
    """Solve a problem at every point of a grid of parameters, to see what bandwidth, time or a bound costs."""
    source = _source(problem, settings)
    grid = parsed_grid(grids, source)
    path = None
    if folder is not None:
        require_folder(folder)
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        path = folder / "sweep.jsonl"
    options: dict[str, Any] = {"method": method, "backend": backend, "time_limit": time_limit, "tolerance": tolerance}
    with _pool(workers) as executor, _bar() as tell:
        found = sweep(source, grid, executor, path, **options, progress=tell)
        if found.interrupted and executor is not None:
            executor.abandon()
    if as_json:
        print_json(sweep_summary(found))
    else:
        from lin_freq_ocp.report.tables import sweep_table

        out.print(sweep_table(found))
    status = INTERRUPTED if found.interrupted else PROVEN if found.proven else NOT_PROVEN
    return status if folder is None else written(status, lambda: _save(found, folder))


@contextmanager
def _pool(workers: int) -> Generator[WorkerPool | None]:
    """Yield processes to work on, if more than one is wanted; on errors and on Ctrl-C they are not waited for."""
    if workers == 1:
        yield None
        return
    pool = process_pool(workers)
    try:
        yield pool
    except BaseException:
        pool.abandon()
        raise
    pool.shutdown()


def parsed_grid(grids: Sequence[str], source: Any) -> dict[str, list[Any]]:
    """Return the values of each parameter; "none" is None, as it is in --set.

    Raises
    ------
    ProblemError
        If one is neither a list nor a range, is given twice, or is a key that no problem file has.
    """
    result: dict[str, list[Any]] = {}
    for given in grids:
        key, equals, text = (part.strip() for part in given.partition("="))
        if not key or not equals:
            raise ProblemError("--grid", repr(given), GRID_FORM)
        if key in result:
            raise ProblemError(f"--grid {key}", "this key twice", "one list for each key")
        _require_key(key, source)
        result[key] = _values(key, text)
    return result


def _source(problem: str, settings: Sequence[str]) -> Callable[..., OptimalControlProblem]:
    given = parsed_settings(settings)
    return (
        ProblemFile(Path(problem), given, read_problem(problem, given)) if is_file(problem) else builder(problem, given)
    )


def _require_key(key: str, source: Any) -> None:
    """Raise ProblemError if this is no key of problem files; what functions take, the sweep looks at itself."""
    known = (*REQUIRED_KEYS, *OPTIONAL_KEYS, *CUTOFFS)
    if isinstance(source, ProblemFile) and key.partition(".")[0] not in known:
        raise ProblemError(f"--grid {key}", "an unknown key", f"some of {', '.join(known)}", suggestion(key, known))


def _values(key: str, text: str) -> list[Any]:
    match = RANGE.fullmatch(text)
    try:
        if match:
            return _range(*match.groups())
        values = tomllib.loads(f"values = {text}")["values"]
    except (ValueError, OverflowError, RecursionError) as error:
        raise ProblemError(f"--grid {key}", brief(text), GRID_FORM, f"({error})") from None
    if not isinstance(values, list):
        raise ProblemError(f"--grid {key}", repr(text), GRID_FORM, f"For a single one: {key}=[{text}].")
    return [None if value == "none" else value for value in values]


def _range(first: str, last: str, count: str) -> list[float] | list[int]:
    """Return so many numbers from the first to the last; whole ones, if all are and both ends are written so."""
    if int(count) > MOST_POINTS:
        raise ValueError(f"{brief(count)} values; at most {MOST_POINTS}")
    values: list[float] = np.linspace(float(first), float(last), int(count)).tolist()
    whole = [round(value) for value in values]
    written = not any(mark in first + last for mark in ".eE")
    return whole if written and whole == values else values


def _nested(key: str, value: Any) -> dict[str, Any]:
    first, _, rest = key.partition(".")
    return {first: _nested(rest, value) if rest else value}


def _save(found: Sweep, folder: Path) -> None:
    found.to_csv(folder / "sweep.csv")
    try:
        figure = found.plot()
    except ProblemError as error:
        complain(f"no figure: {error}")
        return
    with replacing(folder / "sweep.png") as stream:
        figure.savefig(stream, format="png", dpi=150)


@contextmanager
def _bar() -> Generator[Callable[[int, int], None] | None]:
    """Show on a terminal how many points are finished."""
    if not err.is_terminal:
        yield None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("sweeping"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=err, transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
