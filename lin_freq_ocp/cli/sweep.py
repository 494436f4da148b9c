"""The commands lin-freq-ocp sweep, a problem at every point of a grid, and minimum-time, its least feasible horizon.

Exit status of a sweep: 0 every point has an answer with its proof, be it optimal, infeasible or unbounded; 2 bad input;
3 some point has none; 130 interrupted, and what is finished is kept.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from pathlib import Path

import click
import numpy as np

from lin_freq_ocp import __version__
from lin_freq_ocp.api.batch import sweep
from lin_freq_ocp.api.minimum_time import minimum_time
from lin_freq_ocp.base.arrays import brief
from lin_freq_ocp.base.atomic import open_replacement, report_write_errors
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.interrupts import INTERRUPTED
from lin_freq_ocp.batch.grid import LARGEST_GRID, Source
from lin_freq_ocp.batch.tasks import WorkerPool, process_pool
from lin_freq_ocp.cli.console import (
    NO_SOLUTION,
    NOT_PROVEN,
    PROVEN,
    Command,
    complain,
    err,
    json_option,
    print_certificate,
    print_json,
    print_lines,
    print_table,
    problem_argument,
    search_progress,
    solve_options,
    write_files,
)
from lin_freq_ocp.cli.problems import (
    ProblemFile,
    builder,
    is_file,
    parsed_settings,
    require_folder,
    require_keys_of_file,
)
from lin_freq_ocp.files.batch_files import sweep_summary
from lin_freq_ocp.files.reading import FileTable, FileValue
from lin_freq_ocp.files.summary import SCHEMA, result_summary

RANGE = re.compile(r"\s*([^:\[\],\s]+):([^:\[\],\s]+):(\d+)\s*")  # from:to:count, linear, both ends included
GRID_FORM = "KEY=[VALUE, ...] in TOML, or KEY=from:to:count"


def batch_options(files: str) -> Callable[[Command], Command]:
    """Return what adds the options of runs of many solves, which write these files, to a command."""
    count = click.IntRange(min=1)
    workers = click.option("--workers", type=count, default=1, show_default=True, help="Processes to solve on.")
    text = f"Write {files} here; resume from it."
    folder = click.option("--out", "folder", type=click.Path(path_type=Path), help=text)
    return lambda command: workers(folder(command))


@click.command("sweep")
@problem_argument
@click.option("--grid", "grids", multiple=True, required=True, metavar="KEY=VALUES", help=f"{GRID_FORM}; repeatable.")
@solve_options
@batch_options("sweep.jsonl, .csv and .png")
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
    given = parsed_settings(settings)
    source = ProblemFile.read(problem, given) if is_file(problem) else builder(problem, given)
    grid, path = parsed_grid(grids, source), _file_in(folder, "sweep.jsonl")
    options: FileTable = {"method": method, "backend": backend, "time_limit": time_limit, "tolerance": tolerance}
    with _worker_pool(workers) as executor, _progress_bar() as tell:
        found = sweep(source, grid, executor, path, **options, progress=tell)
        if found.interrupted and executor is not None:
            executor.abandon()
    if as_json:
        print_json(sweep_summary(found))
    else:
        from lin_freq_ocp.pages.report.tables import sweep_table

        print_table(sweep_table(found), ("seconds", "method", "gap"))
    status = INTERRUPTED if found.interrupted else PROVEN if found.proven else NOT_PROVEN
    if folder is None:
        return status

    def draw_sweep() -> None:
        try:
            figure = found.plot()
        except ProblemError as error:
            complain(f"no figure: {error}")
            return
        with open_replacement(folder / "sweep.png") as stream:
            figure.savefig(stream, format="png", dpi=150)

    return write_files(status, lambda: found.to_csv(folder / "sweep.csv"), draw_sweep)


def _file_in(folder: Path | None, name: str) -> Path | None:
    """Return the file of a run in a folder, which is made if it is missing; None without a folder."""
    if folder is None:
        return None
    require_folder(folder)
    with report_write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return folder / name


@contextmanager
def _worker_pool(workers: int) -> Generator[WorkerPool | None]:
    """Yield a pool of more than one process; on errors and on Ctrl-C its tasks are abandoned."""
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


@contextmanager
def _progress_bar() -> Generator[Callable[[int, int], None] | None]:
    """Show on a terminal how many points are finished."""
    if not err.is_terminal:
        yield None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("sweeping"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=err, transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@click.command("minimum-time")
@problem_argument
@click.option("--horizons", nargs=2, type=int, required=True, metavar="LO HI", help="The range, both ends included.")
@solve_options
@batch_options("minimum_time.jsonl")
@json_option
def minimum_time_command(
    problem: str,
    horizons: tuple[int, int],
    settings: tuple[str, ...],
    method: str,
    backend: str,
    time_limit: float | None,
    tolerance: float | None,
    workers: int,
    folder: Path | None,
    as_json: bool,
) -> int:
    """Find the least horizon at which a problem is feasible, and prove that one step less is not."""
    given = parsed_settings(settings)
    source = ProblemFile.read(problem, given) if is_file(problem) else builder(problem, given)
    options: FileTable = {"method": method, "backend": backend, "time_limit": time_limit, "tolerance": tolerance}
    path = _file_in(folder, "minimum_time.jsonl")
    with _worker_pool(workers) as executor, search_progress("looking for the least horizon") as report:
        tell = None if report is None else lambda horizon, verdict: report(f"{horizon} is {verdict}")
        found = minimum_time(source, horizons, **options, throw=False, progress=tell, executor=executor, path=path)
        if found.interrupted and executor is not None:
            executor.abandon()
    if as_json:
        print_json(
            {
                "schema": SCHEMA,
                "version": __version__,
                "horizon": found.horizon,
                "horizons": list(found.horizons),
                "monotone": found.monotone,
                "reason": found.reason,
                "proven": found.proven,
                "proof": found.proof,
                "verdicts": {str(T): verdict for T, verdict in found.verdicts.items()},
                "interrupted": found.interrupted,
                # That of lin-freq-ocp solve --json
                "result": None if found.result is None else result_summary(found.result),
            }
        )
    else:
        print_lines(str(found))
        if found.result is not None:
            print_certificate(found.result.problem, found.result.certificate)
    if found.interrupted:
        return INTERRUPTED
    return NOT_PROVEN if not found.proven else NO_SOLUTION if found.horizon is None else PROVEN


def parsed_grid(grids: Sequence[str], source: Source) -> dict[str, list[FileValue]]:
    """Return the values of each parameter, a list or a range; "none" is None, as in --set."""
    result: dict[str, list[FileValue]] = {}
    for given in grids:
        key, equals, text = (part.strip() for part in given.partition("="))
        if not key or not equals:
            raise ProblemError("--grid", repr(given), GRID_FORM)
        if key in result:
            raise ProblemError(f"--grid {key}", "this key twice", "one list for each key")
        match = RANGE.fullmatch(text)
        try:
            values = _range(*match.groups()) if match else tomllib.loads(f"values = {text}")["values"]
        except (ValueError, OverflowError, RecursionError) as error:
            raise ProblemError(f"--grid {key}", brief(text), GRID_FORM, f"({error})") from None
        if not isinstance(values, list):
            raise ProblemError(f"--grid {key}", repr(text), GRID_FORM, f"For a single one: {key}=[{text}].")
        result[key] = [None if value == "none" else value for value in values]
    if isinstance(source, ProblemFile):  # the sweep itself checks the parameters of functions
        require_keys_of_file(result, "--grid ")
    return result


def _range(first: str, last: str, count: str) -> list[float] | list[int]:
    """Return ``count`` numbers from the first to the last; integers, if all are and both ends are written so."""
    if int(count) > LARGEST_GRID:
        raise ValueError(f"{brief(count)} values; at most {LARGEST_GRID}")
    values: list[float] = np.linspace(float(first), float(last), int(count)).tolist()
    whole = [round(value) for value in values]
    as_integers = not any(mark in first + last for mark in ".eE")
    return whole if as_integers and whole == values else values
