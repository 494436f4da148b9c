"""The commands lin-freq-ocp solve, certify, worst-case, rerun and compare.

solve finds an answer with its certificate, and writes the files of --save, --csv, --plot, --proof and --dump; certify
checks the maximum principle for any trajectory; rerun repeats a saved run; compare compares filters of the classical
solution with the constrained solution.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import nullcontext, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lin_freq_ocp.api.result import Result
from lin_freq_ocp.api.solve import EXPLAIN_SECONDS, solve, with_explanation
from lin_freq_ocp.base.activity import activity
from lin_freq_ocp.base.atomic import open_replacement
from lin_freq_ocp.base.errors import ProblemError, SolveError, UnsupportedError
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.cli import console
from lin_freq_ocp.cli.problems import build, require_folder, require_writable
from lin_freq_ocp.files.reading import FileTable, FileValue
from lin_freq_ocp.files.solution_files import kind_of_file, load_trajectory
from lin_freq_ocp.files.summary import (
    certificate_summary,
    comparison_summary,
    failed_comparison_summary,
    result_summary,
    worst_case_summary,
)
from lin_freq_ocp.methods.fitted_multipliers import uniqueness
from lin_freq_ocp.proof.enclosure import require_checker
from lin_freq_ocp.solving.certify import certify
from lin_freq_ocp.transform.starts import start_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HELP = {
    "save": "Write the trajectory to this .npz (with its multipliers), .csv or .mat file.",
    "csv": "Write the trajectory to this file as a table, one row per time.",
    "plot": "Draw the answer into this file: .png, .svg, .pdf.",
    "proof": "Write a proof of the answer to this file; lfo-check checks it without this package.",
    "dump": "Write problem, options and answer to this .zip file; see rerun.",
}


def output_options(command: console.Command) -> console.Command:
    """Add the options of an answer to a command: its files, --json and --trajectory."""
    text = "With --json: times, x and u, too."
    command = click.option("--trajectory", "with_trajectory", is_flag=True, help=text)(command)
    command = console.json_option(command)
    for name, text in reversed(HELP.items()):
        command = click.option(f"--{name}", type=click.Path(path_type=Path), help=text)(command)
    return command


def take_outputs(options: FileTable, problem: str, as_json: bool, with_trajectory: bool) -> dict[str, Path]:
    """Take the files to write out of the options; raise an error unless they differ and can be written."""
    if with_trajectory and not as_json:
        raise click.UsageError("--trajectory needs --json: it adds times, x and u to the object. For a table: --csv.")
    outputs: dict[str, Path] = {name: file for name in HELP if (file := options.pop(name)) is not None}
    taken: dict[Path, str] = {}
    for name, file in outputs.items():
        require_writable(f"--{name}", file, problem)
        if file.absolute() in taken:
            raise ProblemError(f"--{name} {file}", f"the file of --{taken[file.absolute()]}", "another file")
        taken[file.absolute()] = name
    if "save" in outputs:
        kind_of_file(outputs["save"], f"--save {outputs['save']}")
    if "plot" in outputs:
        from matplotlib.figure import Figure  # slow to import

        file, kinds = outputs["plot"], Figure().canvas.get_supported_filetypes()
        if file.suffix.lower().removeprefix(".") not in kinds:
            got = f"a name that ends in {file.suffix}" if file.suffix else "a name without a suffix"
            raise ProblemError(f"--plot {file}", got, f"one that ends in .{', .'.join(kinds)}")
    if "proof" in outputs:
        require_checker()
    return outputs


def save_figure(figure: Figure, file: Path) -> None:
    """Write a figure to a file, in the format of its suffix."""
    with open_replacement(file) as stream:
        figure.savefig(stream, dpi=150, format=file.suffix.lower().removeprefix("."))


def write_outputs(outputs: Mapping[str, Path], result: Result | None, status: int) -> int:
    """Write the files of an answer, report those without content, and return the exit status."""
    writers: dict[str, Callable[[Result, Path], None]] = {"save": Result.save, "csv": Result.to_csv}
    writers |= {"dump": Result.dump, "proof": Result.write_proof}
    writers["plot"] = lambda answer, file: save_figure(answer.plot(), file)
    writes: list[Callable[[], None]] = []
    for name, file in outputs.items():
        if result is not None and (name in ("dump", "proof") or result.trajectory is not None):
            writes.append(partial(writers[name], result, file))
        else:
            done = "drawn" if name == "plot" else "saved"
            console.complain(f"nothing {done} to {file}: there is no {'answer' if result is None else 'trajectory'}.")
    return console.write_files(status, *writes)


@click.command("solve")
@console.problem_argument
@console.solve_options
@click.option("--node-limit", type=int, help="With modes: the largest number of relaxations to solve.")
@click.option("--start", metavar="FILE", help="With modes: start from the trajectory in this .npz, .csv or .mat.")
@click.option("--local", is_flag=True, help="Smooth pieces: a local answer at once, without a global bound.")
@output_options
def solve_command(
    problem: str,
    settings: tuple[str, ...],
    node_limit: int | None,
    start: str | None,
    local: bool,
    as_json: bool,
    with_trajectory: bool,
    **options: FileValue,  # method, backend, time_limit and tolerance, and the files
) -> int:
    """Solve a library problem or a problem file, and certify the answer."""
    description = build(problem, settings)
    outputs, time_limit = take_outputs(options, problem, as_json, with_trajectory), options["time_limit"]
    if node_limit is not None:
        options["node_limit"] = node_limit
    if start is not None:
        options["start"] = start_of(description, load_trajectory(start, description)[0]).saved
    if local:
        options["global_bound"] = False
    dump = nullcontext()
    if (path := outputs.get("dump")) is not None:
        from lin_freq_ocp.files.run_file import dumping_errors  # slow to import

        dump = dumping_errors(path, description, options)
    with dump:
        result = solve(description, **options, throw=False)
        if result.status == Status.INFEASIBLE or result.ray is not None:
            result = with_explanation(result, time_limit, EXPLAIN_SECONDS if time_limit is None else None)
    worst, status = None, console.exit_status(result)
    if description.uncertainty is not None and result.trajectory is not None:
        from lin_freq_ocp.uncertainty.protocol import RobustProblem, worst_case  # slow to import

        assert isinstance(description, RobustProblem)
        with activity("the nominal problem"):
            nominal = solve(description.given, **options, throw=False)
        worst = replace(worst_case(description.given, description.uncertainty, result), nominal=nominal.cost)
    if as_json:
        console.print_json(result_summary(result, with_trajectory, worst))
    else:
        console.print_lines(str(result))
        console.print_conflict(result)
        console.print_certificate(description, result.certificate)
        if worst is not None:
            console.print_lines(str(worst))
    return write_outputs(outputs, result, status if worst is None or worst.holds else status or console.NOT_PROVEN)


@click.command("certify")
@console.problem_argument
@click.argument("solution", metavar="SOLUTION.npz|.csv|.mat")
@console.settings_option
@click.option("--tolerance", type=float, help="Relative residuals up to which conditions hold; default 1e-6.")
@console.json_option
def certify_command(
    problem: str, solution: str, settings: tuple[str, ...], tolerance: float | None, as_json: bool
) -> int:
    """Check the maximum principle for a trajectory: an .npz (with its multipliers, if any), a .csv or a .mat."""
    description = build(problem, settings)
    trajectory, multipliers = load_trajectory(solution, description)
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
    if certificate.borders is not None and str(certificate.borders):
        console.say(f"borders     {certificate.borders}")
    if descent is not None:  # a direction that rules out multipliers
        t, j = descent.steepest
        proven = "no normal multipliers exist" if certificate.borders is None else "no local minimum"
        console.say(
            f"descent     {proven}: along a verified direction, which changes {description.control_names[j]} most "
            f"at t = {t}, the cost falls by {-descent.slope:.3g} per unit"
        )
    elif certificate.pmp == "satisfied":
        from lin_freq_ocp.transform.hybrid.forms import linear_along  # it loads what has modes

        with suppress(UnsupportedError):  # too many to count quickly
            console.say(f"multipliers {uniqueness(linear_along(description, trajectory), trajectory)}")
    return status


@click.command("worst-case")
@console.problem_argument
@click.argument("plan", metavar="PLAN.npz|.csv|.mat")
@console.settings_option
@console.json_option
def worst_case_command(problem: str, plan: str, settings: tuple[str, ...], as_json: bool) -> int:
    """Show what the worst loads of a problem file do to a plan, and whether all limits hold: .npz, .csv or .mat."""
    from lin_freq_ocp.uncertainty.protocol import RobustProblem, worst_case  # slow to import

    description = build(problem, settings)
    if not isinstance(description, RobustProblem):
        raise ProblemError("disturbance", "nothing", "a table [disturbance], [discs] or [[plants]] in the problem file")
    worst = worst_case(description.given, description.uncertainty, load_trajectory(plan, description)[0])
    console.print_json(worst_case_summary(description, worst)) if as_json else console.print_lines(str(worst))
    return console.PROVEN if worst.holds else console.NOT_PROVEN


@click.command("rerun")
@click.argument("file", metavar="FILE.zip")
@console.json_option
def rerun_command(file: str, as_json: bool) -> int:
    """Repeat the run in a file of solve --dump, and show in which results it differs."""
    from lin_freq_ocp.api.runs import load_run, rerun, rerun_summary  # slow to import

    run = load_run(file)
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
    "--filters",
    help="Some of brickwall,butterworth,zero_phase,moving_average,clipped, and ZV,ZVD,EI (default: all of these), "
    "MZV,2HUMP_EI,3HUMP_EI.",
)
@click.option("--out", "folder", type=click.Path(path_type=Path), help="Write an HTML report into this folder.")
@console.backend_option
@click.option("--time-limit", type=float, help="Seconds for all solves together; default with modes: 30.")
@click.option("--start", metavar="FILE", help="With modes: start from the trajectory in this .npz, .csv or .mat.")
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
    from lin_freq_ocp.api.compare import compare  # here: the other commands need no filters

    description = build(problem, settings)
    if folder is not None:
        require_folder(folder)
    trajectory = None if start is None else load_trajectory(start, description)[0]
    names = None if filters is None else [name.strip() for name in filters.split(",")]
    try:
        comparison = compare(description, names, backend, time_limit, trajectory)
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
        elif comparison.shaper_obstacle:
            console.say(f"Input shapers do not apply: {comparison.shaper_obstacle}.")
    status = console.exit_status(comparison.constrained)
    if folder is None or comparison.constrained.interrupted:
        return status

    def save_report() -> None:
        page = comparison.save(folder)
        if not as_json:
            console.say(f"report: {page}")

    return console.write_files(status, save_report)
