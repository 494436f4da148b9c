"""The command lin-freq-ocp compare: filtering afterwards against solving with the constraint."""

from __future__ import annotations

from pathlib import Path

import click

from lin_freq_ocp.api.compare import compare
from lin_freq_ocp.base.errors import SolveError
from lin_freq_ocp.cli import console
from lin_freq_ocp.cli.problems import build, require_folder
from lin_freq_ocp.files.solution_files import load_trajectory
from lin_freq_ocp.files.summary import comparison_summary, failed_comparison_summary


@click.command("compare")
@console.problem_argument
@console.settings_option
@click.option(
    "--filters", help="Some of brickwall,butterworth,zero_phase,moving_average,clipped,ZV,ZVD,EI; default all."
)
@click.option("--out", "folder", type=click.Path(path_type=Path), help="Write an HTML report and its figures here.")
@console.backend_option
@click.option("--time-limit", type=float, help="Seconds for all solves together; default 30 over modes.")
@click.option("--start", metavar="FILE", help="Over modes: begin with the trajectory in this .npz, .csv or .mat.")
@console.json_option
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
        with console.progress(f"comparing {description.name or problem}"):
            comparison = compare(description, names, backend, time_limit, begin)
    except SolveError as error:
        if not as_json or error.result is None:
            raise
        console.print_json(failed_comparison_summary(error.result))
        return console.exit_status(error.result)
    if as_json:
        console.print_json(comparison_summary(comparison))
    else:
        from lin_freq_ocp.pages.report.tables import comparison_table, moves_rows, terminal_table

        console.print_lines(str(comparison.constrained))
        console.print_conflict(comparison.constrained)
        console.print_table(comparison_table(comparison))
        if comparison.moves is not None:
            console.print_table(
                terminal_table("Shortest moves at the same residual vibration", moves_rows(comparison.moves))
            )
    status = console.exit_status(comparison.constrained)
    if folder is None or comparison.constrained.interrupted:
        return status

    def save_report() -> None:
        with console.progress("drawing the report"):
            page = comparison.save(folder)
        if not as_json:
            console.say(f"report: {page}")

    return console.write_files(status, save_report)
