"""The command lin-freq-ocp compare: filtering afterwards against solving with the constraint."""

from __future__ import annotations

from pathlib import Path

import click

from lin_freq_ocp.api.compare import compare
from lin_freq_ocp.base.errors import SolveError
from lin_freq_ocp.cli.console import (
    backend_option,
    exit_status,
    json_option,
    print_conflict,
    print_json,
    print_lines,
    print_table,
    problem_argument,
    progress,
    say,
    settings_option,
    write_files,
)
from lin_freq_ocp.cli.problems import build, require_folder
from lin_freq_ocp.files.solution_files import load_trajectory
from lin_freq_ocp.files.summary import comparison_summary, failed_comparison_summary


@click.command("compare")
@problem_argument
@settings_option
@click.option(
    "--filters", help="Some of brickwall,butterworth,zero_phase,moving_average,clipped,ZV,ZVD,EI; default all."
)
@click.option("--out", "folder", type=click.Path(path_type=Path), help="Write an HTML report and its figures here.")
@backend_option
@click.option("--time-limit", type=float, help="Seconds for all solves together; default 30 over modes.")
@click.option("--start", metavar="FILE", help="Over modes: begin with the trajectory in this .npz, .csv or .mat.")
@json_option
def compare_command(
    problem: str,
    settings: tuple[str, ...],
    filters: str | None,
    folder: Path | None,
    backend: str,
    time_limit: float | None,
    start: str | None,
    as_json: bool,
) -> int:
    """Compare filtering a classical optimal control with solving under the frequency constraint."""
    description = build(problem, settings)
    if folder is not None:
        require_folder(folder)
    begin = None if start is None else load_trajectory(start, description)[0]
    names = None if filters is None else [name.strip() for name in filters.split(",")]
    try:
        with progress(f"comparing {description.name or problem}"):
            comparison = compare(description, names, backend, time_limit, begin)
    except SolveError as error:
        if not as_json or error.result is None:
            raise
        print_json(failed_comparison_summary(error.result))
        return exit_status(error.result)
    if as_json:
        print_json(comparison_summary(comparison))
    else:
        from lin_freq_ocp.pages.report.tables import comparison_table, moves_rows, terminal_table

        print_lines(str(comparison.constrained))
        print_conflict(comparison.constrained)
        print_table(comparison_table(comparison))
        if comparison.moves is not None:
            print_table(terminal_table("Shortest moves at the same residual vibration", moves_rows(comparison.moves)))
    status = exit_status(comparison.constrained)
    if folder is None or comparison.constrained.interrupted:
        return status

    def save_report() -> None:
        with progress("drawing the report"):
            page = comparison.save(folder)
        if not as_json:
            say(f"report: {page}")

    return write_files(status, save_report)
