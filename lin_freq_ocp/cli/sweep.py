"""The commands lin-freq-ocp sweep, a problem at every point of a grid, and minimum-time, its least feasible horizon.

Exit status of a sweep: 0 every point is proven optimal, infeasible or unbounded; 2 bad input; 3 some point is not
proven; 130 interrupted, with the finished points saved.
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
from lin_freq_ocp.base.atomic import report_write_errors
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.interrupts import INTERRUPTED
from lin_freq_ocp.batch.grid import LARGEST_GRID, Source
from lin_freq_ocp.batch.tasks import WorkerPool, process_pool
from lin_freq_ocp.cli.console import (
    NO_SOLUTION,
    NOT_PROVEN,
    PROVEN,
    Command,
    json_option,
    print_certificate,
    print_json,
    print_lines,
    print_table,
    problem_argument,
    solve_options,
    write_files,
)
from lin_freq_ocp.cli.problems import ProblemFile, read_source, require_folder, require_keys_of_file
from lin_freq_ocp.cli.solve import output_options, take_outputs, write_outputs
from lin_freq_ocp.files.batch_files import sweep_summary
from lin_freq_ocp.files.reading import FileValue
from lin_freq_ocp.files.summary import SCHEMA, result_summary

RANGE = re.compile(r"\s*([^:\[\],\s]+):([^:\[\],\s]+):(\d+)\s*")  # from:to:count, linear, both ends included
PRINTED = ("horizon", "horizons", "monotone", "reason", "proven", "proof", "interrupted")  # by minimum-time --json
GRID_FORM = "KEY=[VALUE, ...] in TOML, or KEY=from:to:count"


def batch_options(files: str) -> Callable[[Command], Command]:
    """Return a decorator that adds the options of runs of many solves, which write these files, to a command."""
    count = click.IntRange(min=1)
    workers = click.option("--workers", type=count, default=1, show_default=True, help="Number of processes.")
    text = f"Write {files} into this folder; resume from it."
    folder = click.option("--out", "folder", type=click.Path(path_type=Path), help=text)
    return lambda command: workers(folder(command))


@click.command("sweep")
@problem_argument
@click.option("--grid", "grids", multiple=True, metavar="KEY=VALUES", help=f"{GRID_FORM}; repeatable.")
@solve_options
@batch_options("a page, and sweep.jsonl, .csv, .svg and .png")
@json_option
def sweep_command(
    problem: str,
    grids: tuple[str, ...],
    settings: tuple[str, ...],
    workers: int,
    folder: Path | None,
    as_json: bool,
    **options: FileValue,  # method, backend, time_limit and tolerance
) -> int:
    """Solve a problem at every point of a grid, to see the cost of bandwidth, time or a bound."""
    source = read_source(problem, settings)
    grid, path = parse_grid(grids, source), _file_in(folder, "sweep.jsonl")
    with _worker_pool(workers) as executor:
        points = sweep(source, grid, executor, path, **options)
        if points.interrupted and executor is not None:
            executor.abandon()
    if as_json:
        print_json(sweep_summary(points))
    else:
        from lin_freq_ocp.pages.report.tables import sweep_table

        print_table(sweep_table(points), ("seconds", "method", "gap"))
    status = INTERRUPTED if points.interrupted else PROVEN if points.proven else NOT_PROVEN
    if folder is None:
        return status
    return write_files(status, lambda: points.to_csv(folder / "sweep.csv"), lambda: points.save(folder))


def _file_in(folder: Path | None, name: str) -> Path | None:
    """Return the file of a run in a folder, which is created if it is missing; None without a folder."""
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


@click.command("minimum-time")
@problem_argument
@click.option("--horizons", nargs=2, type=int, required=True, metavar="LO HI", help="The range, both ends included.")
@solve_options
@batch_options("minimum_time.jsonl")
@output_options
def minimum_time_command(
    problem: str,
    horizons: tuple[int, int],
    settings: tuple[str, ...],
    workers: int,
    folder: Path | None,
    as_json: bool,
    with_trajectory: bool,
    **options: FileValue,  # method, backend, time_limit and tolerance, and the files
) -> int:
    """Find the least horizon at which a problem is feasible, and prove that one step less is not.

    The files of --save, --csv, --plot, --proof and --dump hold the answer at that horizon.
    """
    source = read_source(problem, settings)
    outputs = take_outputs(options, problem, as_json, with_trajectory)
    path = _file_in(folder, "minimum_time.jsonl")
    with _worker_pool(workers) as executor:
        shortest = minimum_time(source, horizons, **options, throw=False, executor=executor, path=path)
        if shortest.interrupted and executor is not None:
            executor.abandon()
    result = shortest.result
    if as_json:
        summary = {"schema": SCHEMA, "version": __version__} | {name: getattr(shortest, name) for name in PRINTED}
        summary["verdicts"] = {str(T): verdict for T, verdict in shortest.verdicts.items()}
        summary["result"] = None if result is None else result_summary(result, with_trajectory)  # as of solve --json
        print_json(summary)
    else:
        print_lines(str(shortest))
        if result is not None:
            print_certificate(result.problem, result.certificate)
    status = NOT_PROVEN if not shortest.proven else NO_SOLUTION if shortest.horizon is None else PROVEN
    return write_outputs(outputs, result, INTERRUPTED if shortest.interrupted else status)


def parse_grid(grids: Sequence[str], source: Source) -> dict[str, list[FileValue]]:
    """Return the values of each parameter, a list or a range; "none" is None, as in --set."""
    if not grids:
        raise ProblemError("--grid", "none", GRID_FORM)
    result: dict[str, list[FileValue]] = {}
    for setting in grids:
        key, equals, text = (part.strip() for part in setting.partition("="))
        if not key or not equals:
            raise ProblemError("--grid", repr(setting), GRID_FORM)
        if key in result:
            raise ProblemError(f"--grid {key}", "this key twice", "one list for each key")
        match = RANGE.fullmatch(text)
        try:
            if match is None:
                values = tomllib.loads(f"values = {text}")["values"]
            else:
                first, last, count = match.groups()
                if int(count) > LARGEST_GRID:
                    raise ValueError(f"{brief(count)} values; at most {LARGEST_GRID}")
                values = np.linspace(float(first), float(last), int(count)).tolist()
                whole = [round(value) for value in values]  # integers, if all are and both ends are written as such
                values = whole if whole == values and not any(mark in first + last for mark in ".eE") else values
        except (ValueError, OverflowError, RecursionError) as error:
            raise ProblemError(f"--grid {key}", brief(text), GRID_FORM, f"({error})") from None
        if not isinstance(values, list):
            raise ProblemError(f"--grid {key}", repr(text), GRID_FORM, f"For a single one: {key}=[{text}].")
        result[key] = [None if value == "none" else value for value in values]
    if isinstance(source, ProblemFile):  # sweep() checks the parameters of functions
        require_keys_of_file(result, "--grid ")
    return result
