"""The command line: lin-freq-ocp list | show | solve | compare | sweep | certify | init.

Exit status: 0 the maximum principle is satisfied and normal, or the gap is proven; 1 no solution (infeasible or
unbounded, and why; for a sweep, where that is an answer, 0); 2 bad input, or a file that cannot be written; 3 a point
without such a proof, or too little memory; 70 a fault of this program; 130 interrupted.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from io import TextIOWrapper
from pathlib import Path
from typing import Any

import click
import numpy as np

from lin_freq_ocp import library
from lin_freq_ocp.api.compare import Comparison, compare
from lin_freq_ocp.api.result import Result
from lin_freq_ocp.api.solve import EXPLAIN_SECONDS, explained, solve
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.cli.common import (
    BAD_INPUT,
    NO_SOLUTION,
    NOT_PROVEN,
    PROVEN,
    backend_option,
    build,
    complain,
    err,
    error_status,
    error_words,
    first_words,
    fit_console,
    json_option,
    method_option,
    out,
    print_json,
    print_lines,
    print_table,
    problem_argument,
    progress,
    require_folder,
    say,
    search_progress,
    settings_option,
    time_limit_option,
    tolerance_option,
    written,
)
from lin_freq_ocp.cli.outputs import Outputs, output_options
from lin_freq_ocp.cli.show import show_command
from lin_freq_ocp.cli.sweep import sweep_command
from lin_freq_ocp.errors import BandWarning, SolveError, UnsupportedError
from lin_freq_ocp.interchange.problem_file.template import init_problem_file
from lin_freq_ocp.interchange.results.summary import (
    certificate_summary,
    comparison_summary,
    failed_comparison_summary,
    result_summary,
)
from lin_freq_ocp.interchange.results.trajectory_file import load_trajectory
from lin_freq_ocp.interchange.runs.run_file import dumping_errors
from lin_freq_ocp.methods.multipliers import uniqueness
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.starts import start_of
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.certify import certify
from lin_freq_ocp.starting import INTERRUPTED, leave_silently, let_commands_decide
from lin_freq_ocp.status import Status


class Commands(click.Group):
    """Commands that Ctrl-C ends without a word; click would print an empty line."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise click.Abort from None


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="lin-freq-ocp")
def cli() -> None:
    """Optimal control with constraints in time and in frequency, with a certificate for every answer."""


cli.add_command(sweep_command)
cli.add_command(show_command)


@cli.command("list")
def list_command() -> int:
    """List the library's problems and what each shows."""
    from lin_freq_ocp.report.narrow import terms

    out.print(terms([(name, first_words(builder)) for name, builder in library.PROBLEMS.items()], out.width))
    return PROVEN


@cli.command("solve")
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
        _print_conflict(result)
        _print_certificate(description, result.certificate)
    return written(exit_status(result), *outputs.writes(result))


@cli.command("compare")
@problem_argument
@settings_option
@click.option("--filters", help="Some of brickwall,butterworth,zero_phase,moving_average,clipped; default all.")
@click.option("--out", "folder", type=click.Path(path_type=Path), help="Write an HTML report and its figures here.")
@backend_option
@time_limit_option
@json_option
def compare_command(
    problem: str,
    settings: tuple[str, ...],
    filters: str | None,
    folder: Path | None,
    backend: str,
    time_limit: float | None,
    as_json: bool,
) -> int:
    """Compare filtering a classical optimal control with solving under the frequency constraint."""
    description = build(problem, settings)
    if folder is not None:
        require_folder(folder)
    names = None if filters is None else [name.strip() for name in filters.split(",")]
    try:
        with progress(f"comparing {description.name or problem}"):
            comparison = compare(description, names, backend, time_limit)
    except SolveError as error:
        if not as_json or error.result is None:
            raise
        print_json(failed_comparison_summary(error.result))
        return exit_status(error.result)
    if as_json:
        print_json(comparison_summary(comparison))
    else:
        _print_comparison(comparison)
    status = exit_status(comparison.constrained)
    if folder is None or comparison.constrained.interrupted:
        return status
    return written(status, lambda: _save_report(comparison, folder, as_json))


@cli.command("certify")
@problem_argument
@click.argument("solution", metavar="SOLUTION.npz|.csv|.mat")
@settings_option
@click.option("--tolerance", type=float, help="Relative residuals up to which conditions hold, 1e-6 by default.")
@json_option
def certify_command(
    problem: str, solution: str, settings: tuple[str, ...], tolerance: float | None, as_json: bool
) -> int:
    """Judge a trajectory (an .npz, with multipliers if it has them, a .csv or a .mat) by the maximum principle."""
    description = build(problem, settings)
    trajectory, multipliers = load_trajectory(solution, description)
    with progress("certifying"):
        certificate = certify(description, trajectory, multipliers, tolerance)
    if as_json:
        print_json(certificate_summary(description, certificate))
    else:
        _print_certificate(description, certificate)
        _print_multipliers(description, trajectory, certificate)
    return certificate_status(certificate)


@cli.command("init")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE.toml")
def init_command(file: Path) -> int:
    """Write a commented problem file to start from."""
    init_problem_file(file)
    say(f"wrote {file}; next: lin-freq-ocp solve {file}")
    return PROVEN


def exit_status(result: Result) -> int:
    """Return the exit status of a result."""
    if result.interrupted:
        return INTERRUPTED
    if result.status in (Status.INFEASIBLE, Status.UNBOUNDED):
        return NO_SOLUTION
    if result.tree is not None:  # extremal is not optimal where there are modes: what counts is the gap
        return PROVEN if result.status == Status.OPTIMAL else NOT_PROVEN
    return NOT_PROVEN if result.certificate is None else certificate_status(result.certificate)


def certificate_status(certificate: Certificate) -> int:
    """Return the exit status of a certificate."""
    extremal = certificate.pmp == "satisfied" and certificate.normal
    return PROVEN if extremal or certificate.globally_optimal else NOT_PROVEN


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with its status."""
    warnings.showwarning = _show_warning
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that lacks a character shows another
    ours = let_commands_decide()
    status = _status(arguments)
    if ours:
        leave_silently()
    sys.exit(status)


def _status(arguments: Sequence[str] | None) -> int:
    fit_console()
    try:
        return cli.main(None if arguments is None else list(arguments), "lin-freq-ocp", standalone_mode=False) or 0
    except click.ClickException as error:
        error.show()
        return BAD_INPUT
    except (click.Abort, KeyboardInterrupt):
        return INTERRUPTED
    except SolveError as error:
        complain(error)
        return NOT_PROVEN if error.result is None else exit_status(error.result)
    except Exception as error:
        if error_status(error) != INTERRUPTED:
            complain(error_words(error))
        return error_status(error)


def _show_warning(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
    words = "" if issubclass(category, BandWarning) else f" ({category.__name__})"
    err.print(f"warning: {message}{words}", markup=False, highlight=False, soft_wrap=True)


def _print_conflict(result: Result) -> None:
    for one in result.conflict or ():
        print_lines(f"conflict  {one}")
    if result.explanation is not None:
        print_lines(str(result.explanation))


def _print_certificate(problem: OptimalControlProblem, certificate: Certificate | None) -> None:
    if certificate is not None:
        from lin_freq_ocp.report.tables import certificate_table

        print_table(certificate_table(problem, certificate), ("scale", "tolerance", "residual", "worst at"))


def _print_multipliers(problem: OptimalControlProblem, trajectory: Trajectory, certificate: Certificate) -> None:
    """Say whether there are others, or the direction that proves that there are none, and what holds at borders."""
    descent = certificate.descent
    if certificate.rounded is not None:
        say(f"rounding    {certificate.rounded}")
    if certificate.borders is not None:
        say(f"borders     {certificate.borders}")
    if descent is not None:
        control = problem.control_names[int(np.argmax(np.abs(descent.u[descent.steepest])))]
        proven = "no normal multipliers exist" if certificate.borders is None else "no local minimum"
        say(
            f"descent     {proven}: along a verified direction, which changes {control} most at "
            f"t = {descent.steepest}, the cost falls by {-descent.slope:.3g} per unit"
        )
    elif certificate.pmp == "satisfied":
        try:
            say(f"multipliers {uniqueness(problem, trajectory)}")
        except UnsupportedError:  # too many to count in a moment
            return


def _save_report(comparison: Comparison, folder: Path, quiet: bool) -> None:
    with progress("drawing the report"):
        page = comparison.save(folder)
    if not quiet:
        say(f"report: {page}")


def _print_comparison(comparison: Comparison) -> None:
    from lin_freq_ocp.report.tables import comparison_table

    print_lines(str(comparison.constrained))
    _print_conflict(comparison.constrained)
    print_table(comparison_table(comparison))
