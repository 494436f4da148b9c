"""The command lin-freq-ocp solve: an answer, its certificate, and files of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from lin_freq_ocp.api.solve import EXPLAIN_SECONDS, explained, solve
from lin_freq_ocp.cli.answers import exit_status, print_certificate, print_conflict
from lin_freq_ocp.cli.console import print_json, print_lines, progress, search_progress, written
from lin_freq_ocp.cli.options import (
    backend_option,
    json_option,
    method_option,
    problem_argument,
    settings_option,
    time_limit_option,
    tolerance_option,
)
from lin_freq_ocp.cli.outputs import Outputs, output_options
from lin_freq_ocp.cli.problems import build
from lin_freq_ocp.interchange.results.solution_file import load_trajectory
from lin_freq_ocp.interchange.results.summary import result_summary
from lin_freq_ocp.interchange.runs.run_file import dumping_errors
from lin_freq_ocp.problem.starts import start_of
from lin_freq_ocp.status import Status


@click.command("solve")
@problem_argument
@settings_option
@method_option
@backend_option
@time_limit_option
@tolerance_option
@click.option("--node-limit", type=int, help="Over modes: relaxations to solve at most.")
@click.option("--start", metavar="FILE", help="Over modes: begin with the trajectory in this .npz, .csv or .mat.")
@output_options
@json_option
@click.option("--trajectory", "with_trajectory", is_flag=True, help="With --json: the times, x and u, too.")
def solve_command(
    problem: str,
    settings: tuple[str, ...],
    method: str,
    backend: str,
    time_limit: float | None,
    tolerance: float | None,
    node_limit: int | None,
    start: str | None,
    as_json: bool,
    with_trajectory: bool,
    **files: Path | None,
) -> int:
    """Solve a library problem or a problem file, and certify the answer."""
    description, outputs = build(problem, settings), Outputs(**files)
    outputs.require_writable(problem)
    if with_trajectory and not as_json:
        raise click.UsageError("--trajectory needs --json: it adds times, x and u to the object. For a table: --csv.")
    options: dict[str, Any] = {"method": method, "backend": backend, "time_limit": time_limit, "tolerance": tolerance}
    if node_limit is not None:
        options["node_limit"] = node_limit
    if start is not None:
        options["start"] = start_of(description, load_trajectory(start, description)[0]).saved
    with dumping_errors(outputs.dump, description, options):
        with search_progress(f"solving {description.name or problem}") as report:
            result = solve(description, **options, throw=False, progress=report)
        if result.status == Status.INFEASIBLE:
            with progress("looking for what would help"):
                result = explained(result, EXPLAIN_SECONDS if time_limit is None else time_limit)
    if as_json:
        print_json(result_summary(result, with_trajectory))
    else:
        print_lines(str(result))
        print_conflict(result)
        print_certificate(description, result.certificate)
    return written(exit_status(result), *outputs.writes(result))
