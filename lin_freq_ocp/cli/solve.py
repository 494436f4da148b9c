"""The commands lin-freq-ocp solve, certify, rerun and compare.

solve finds an answer with its certificate, and writes the files of --save, --csv, --plot, --proof and --dump; certify
checks the maximum principle for any trajectory; rerun repeats a dumped run; compare sets filtering afterwards against
solving with the constraint.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path

import click
import numpy as np

from lin_freq_ocp.api.result import Result
from lin_freq_ocp.api.runs import load_run, rerun, rerun_summary
from lin_freq_ocp.api.solve import EXPLAIN_SECONDS, solve, with_explanation
from lin_freq_ocp.base.atomic import replacing
from lin_freq_ocp.base.errors import ProblemError, SolveError, UnsupportedError
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.cli import console
from lin_freq_ocp.cli.problems import build, require_folder, require_writable
from lin_freq_ocp.files.reading import FileTable
from lin_freq_ocp.files.run_file import dumping_errors
from lin_freq_ocp.files.solution_files import kind_of_file, load_trajectory
from lin_freq_ocp.files.summary import (
    certificate_summary,
    comparison_summary,
    failed_comparison_summary,
    result_summary,
)
from lin_freq_ocp.methods.fitted_multipliers import uniqueness
from lin_freq_ocp.problem.hybrid.forms import linear_along
from lin_freq_ocp.problem.starts import start_of
from lin_freq_ocp.proof.enclosure import require_checker
from lin_freq_ocp.solving.certify import certify

HELP = {
    "save": "Write the trajectory to this .npz (with its multipliers), .csv or .mat file.",
    "csv": "Write the trajectory to this file as a table, one row per time.",
    "plot": "Draw the answer into this file: .png, .svg, .pdf.",
    "proof": "Write a proof of the answer to this file, which lfo-check confirms without this package.",
    "dump": "Write the whole run to this .zip file; see rerun.",
}


def require_outputs(outputs: Mapping[str, Path], problem: str) -> None:
    """Raise ProblemError, before anything is solved, unless all can be written, each to a file of its own."""
    taken: dict[Path, str] = {}
    for name, file in outputs.items():
        require_writable(f"--{name}", file, problem)
        if file.absolute() in taken:
            raise ProblemError(f"--{name} {file}", f"the file of --{taken[file.absolute()]}", "another file")
        taken[file.absolute()] = name
    if "save" in outputs:
        kind_of_file(outputs["save"], f"--save {outputs['save']}")
    if "plot" in outputs:
        from matplotlib.figure import Figure  # here, because it takes long to import

        file, kinds = outputs["plot"], Figure().canvas.get_supported_filetypes()
        if file.suffix.lower().removeprefix(".") not in kinds:
            got = f"a name that ends in {file.suffix}" if file.suffix else "a name without a suffix"
            raise ProblemError(f"--plot {file}", got, f"one that ends in .{', .'.join(kinds)}")
    if "proof" in outputs:
        require_checker()


def output_writes(outputs: Mapping[str, Path], result: Result) -> list[Callable[[], None]]:
    """Return the function that writes each file, and report the files that stay unwritten."""

    def draw_figure(file: Path) -> None:
        figure = result.plot()
        with replacing(file) as stream:
            figure.savefig(stream, dpi=150, format=file.suffix.lower().removeprefix("."))

    writers = {"save": result.save, "csv": result.to_csv, "plot": draw_figure, "dump": result.dump}
    writers["proof"] = result.write_proof
    writes: list[Callable[[], None]] = []
    for name, file in outputs.items():
        if name in ("dump", "proof") or result.trajectory is not None:
            writes.append(partial(writers[name], file))
        else:
            done = "drawn" if name == "plot" else "saved"
            console.complain(f"nothing {done} to {file}: there is no trajectory.")
    return writes


def output_options(command: console.Command) -> console.Command:
    """Add the options of all outputs to a command."""
    for name, text in reversed(HELP.items()):
        command = click.option(f"--{name}", type=click.Path(path_type=Path), help=text)(command)
    return command


@click.command("solve")
@console.problem_argument
@console.solve_options
@click.option("--node-limit", type=int, help="Over modes: relaxations to solve at most.")
@click.option("--start", metavar="FILE", help="Over modes: begin with the trajectory in this .npz, .csv or .mat.")
@click.option("--local", is_flag=True, help="Over smooth pieces: no global bound, a local answer at once.")
@output_options
@console.json_option
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
    local: bool,
    as_json: bool,
    with_trajectory: bool,
    **files: Path | None,
) -> int:
    """Solve a library problem or a problem file, and certify the answer."""
    description = build(problem, settings)
    outputs = {name: file for name in HELP if (file := files[name]) is not None}
    require_outputs(outputs, problem)
    if with_trajectory and not as_json:
        raise click.UsageError("--trajectory needs --json: it adds times, x and u to the object. For a table: --csv.")
    options: FileTable = {"method": method, "backend": backend, "time_limit": time_limit, "tolerance": tolerance}
    if node_limit is not None:
        options["node_limit"] = node_limit
    if start is not None:
        options["start"] = start_of(description, load_trajectory(start, description)[0]).saved
    if local:
        options["global_bound"] = False
    with dumping_errors(outputs.get("dump"), description, options):
        with console.search_progress(f"solving {description.name or problem}") as report:
            result = solve(description, **options, throw=False, progress=report)
        if result.status == Status.INFEASIBLE:
            with console.progress("looking for what would help"):
                result = with_explanation(result, time_limit, EXPLAIN_SECONDS if time_limit is None else None)
    if as_json:
        console.print_json(result_summary(result, with_trajectory))
    else:
        console.print_lines(str(result))
        console.print_conflict(result)
        console.print_certificate(description, result.certificate)
    return console.write_files(console.exit_status(result), *output_writes(outputs, result))


@click.command("certify")
@console.problem_argument
@click.argument("solution", metavar="SOLUTION.npz|.csv|.mat")
@console.settings_option
@click.option("--tolerance", type=float, help="Relative residuals up to which conditions hold, 1e-6 by default.")
@console.json_option
def certify_command(
    problem: str, solution: str, settings: tuple[str, ...], tolerance: float | None, as_json: bool
) -> int:
    """Judge a trajectory (an .npz, with multipliers if it has them, a .csv or a .mat) by the maximum principle."""
    description = build(problem, settings)
    trajectory, multipliers = load_trajectory(solution, description)
    with console.progress("certifying"):
        certificate = certify(description, trajectory, multipliers, tolerance)
    status, descent = console.certificate_status(certificate), certificate.descent
    if as_json:
        console.print_json(certificate_summary(description, certificate))
        return status
    console.print_certificate(description, certificate)
    if certificate.rounded is not None:
        console.say(f"rounding    {certificate.rounded}")
    if certificate.second_order is not None:
        console.say(f"second      {certificate.second_order}")
    if certificate.borders is not None:
        console.say(f"borders     {certificate.borders}")
    if descent is not None:  # a direction that excludes multipliers
        control = description.control_names[int(np.argmax(np.abs(descent.u[descent.steepest])))]
        proven = "no normal multipliers exist" if certificate.borders is None else "no local minimum"
        console.say(
            f"descent     {proven}: along a verified direction, which changes {control} most at "
            f"t = {descent.steepest}, the cost falls by {-descent.slope:.3g} per unit"
        )
    elif certificate.pmp == "satisfied":
        with suppress(UnsupportedError):  # too many to count in a moment
            console.say(f"multipliers {uniqueness(linear_along(description, trajectory), trajectory)}")
    return status


@click.command("rerun")
@click.argument("file", metavar="FILE.zip")
@console.json_option
def rerun_command(file: str, as_json: bool) -> int:
    """Repeat what solve --dump wrote; show what it ended with then and now, and what differs."""
    run = load_run(file)
    with console.progress(f"solving {run.problem.name or file}"):
        comparison = rerun(run)
    if as_json:
        console.print_json(rerun_summary(comparison))
    else:
        console.print_lines(str(comparison))
    if comparison.error is not None:
        return console.error_status(comparison.error)
    return console.NOT_PROVEN if comparison.result is None else console.exit_status(comparison.result)


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
    from lin_freq_ocp.api.compare import compare  # here, as the other commands need no filters

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
