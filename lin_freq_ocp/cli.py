"""The command line: lin-freq-ocp list | solve | compare | certify | rerun | init.

Exit status: 0 the maximum principle is satisfied and normal, or the gap is proven; 1 no solution (infeasible or
unbounded, and why); 2 bad input; 3 a point without such a proof; 130 interrupted.
"""

from __future__ import annotations

import inspect
import os
import sys
import tomllib
import warnings
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from io import TextIOWrapper
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console, ConsoleDimensions
from rich.markup import escape

from lin_freq_ocp import library
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.comparison.compare import Comparison, compare
from lin_freq_ocp.errors import BandWarning, LinFreqOCPError, ProblemError, SolveError, UnsupportedError
from lin_freq_ocp.interchange.keys import suggestion
from lin_freq_ocp.interchange.problem_file import read_problem
from lin_freq_ocp.interchange.rerun import rerun, rerun_summary
from lin_freq_ocp.interchange.run_file import dumping_errors, load_run
from lin_freq_ocp.interchange.summary import (
    certificate_summary,
    comparison_summary,
    failed_comparison_summary,
    result_summary,
    to_json,
)
from lin_freq_ocp.interchange.template import init_problem_file
from lin_freq_ocp.interchange.trajectory_file import load_trajectory
from lin_freq_ocp.methods.multipliers import uniqueness
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.result import Result
from lin_freq_ocp.solve import EXPLAIN_SECONDS, certify, explained, solve

PROVEN, NO_SOLUTION, BAD_INPUT, NOT_PROVEN, INTERRUPTED = 0, 1, 2, 3, 130

PAGE = ConsoleDimensions(width=200, height=100)
"""Room for tables that go to a file or a pipe, where nothing needs to be cut off."""


class PatientConsole(Console):
    """A console whose reader may leave early, as ``head`` does: what is left goes nowhere, and the status stays."""

    def on_broken_pipe(self) -> None:
        """Send the rest to nowhere."""
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


out, err = PatientConsole(), Console(stderr=True)

_problem = click.argument("problem", metavar="NAME|FILE.toml")
_settings = click.option(
    "--set", "settings", multiple=True, metavar="KEY=VALUE", help="Set a parameter; the value is TOML."
)
_backend = click.option("--backend", default="auto", show_default=True, help="clarabel, osqp, or qpsolvers:NAME.")
_time_limit = click.option("--time-limit", type=float, help="Seconds for the solver.")
_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout and nothing else.")


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="lin-freq-ocp")
def cli() -> None:
    """Optimal control with constraints in time and in frequency, with a certificate for every answer."""


@cli.command("list")
def list_command() -> int:
    """List the library's problems and what each shows."""
    from rich.table import Table

    table = Table("name", "what it shows", box=None, header_style="bold")
    for name, builder in library.PROBLEMS.items():
        table.add_row(name, escape((inspect.getdoc(builder) or "").splitlines()[0]))
    out.print(table)
    return PROVEN


@cli.command("solve")
@_problem
@_settings
@click.option("--method", default="auto", show_default=True, help="auto, spectral or convex.")
@_backend
@_time_limit
@click.option("--tolerance", type=float, help="Relative residuals asked of the solver.")
@click.option("--save", type=click.Path(path_type=Path), help="Write trajectory and multipliers to this .npz file.")
@click.option("--dump", type=click.Path(path_type=Path), help="Write the whole run to this .zip file; see rerun.")
@_json
def solve_command(
    problem: str,
    settings: tuple[str, ...],
    method: str,
    backend: str,
    time_limit: float | None,
    tolerance: float | None,
    save: Path | None,
    dump: Path | None,
    as_json: bool,
) -> int:
    """Solve a library problem or a problem file, and certify the answer."""
    description = build(problem, settings)
    for option, file in (("--save", save), ("--dump", dump)):
        if file is not None:
            require_writable(option, file, problem)
    if save is not None and dump is not None and save.absolute() == dump.absolute():
        raise ProblemError(f"--dump {dump}", "the file of --save", "another file")
    options = {"method": method, "backend": backend, "time_limit": time_limit, "tolerance": tolerance}
    with dumping_errors(dump, description, options):
        with _progress(f"solving {description.name or problem}"):
            result = solve(description, method, backend, time_limit, tolerance, throw=False)
        if result.status == "infeasible":
            with _progress("looking for what would help"):
                result = explained(result, EXPLAIN_SECONDS if time_limit is None else time_limit)
    if dump is not None:
        result.dump(dump)
    if save is not None and result.trajectory is not None:
        result.save(save)
    elif save is not None:
        _complain(f"nothing saved to {save}: there is no trajectory.")
    if as_json:
        _print_json(result_summary(result))
    else:
        out.print(escape(str(result)), highlight=False)
        _print_conflict(result)
        _print_certificate(description, result.certificate)
    return exit_status(result)


@cli.command("compare")
@_problem
@_settings
@click.option("--filters", help="Some of brickwall,butterworth,zero_phase,moving_average,clipped; default all.")
@click.option("--out", "folder", type=click.Path(path_type=Path), help="Write an HTML report and its figures here.")
@_backend
@_time_limit
@_json
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
        with _progress(f"comparing {description.name or problem}"):
            comparison = compare(description, names, backend, time_limit)
            page = None if folder is None or comparison.constrained.interrupted else comparison.save(folder)
    except SolveError as error:
        if not as_json or error.result is None:
            raise
        _print_json(failed_comparison_summary(error.result))
        return exit_status(error.result)
    if as_json:
        _print_json(comparison_summary(comparison))
    else:
        _print_comparison(comparison)
        if page is not None:
            click.echo(f"report: {page}")
    return exit_status(comparison.constrained)


@cli.command("certify")
@_problem
@click.argument("solution", metavar="SOLUTION.npz|.csv|.mat")
@_settings
@_json
def certify_command(problem: str, solution: str, settings: tuple[str, ...], as_json: bool) -> int:
    """Judge a trajectory (an .npz, with multipliers if it has them, a .csv or a .mat) by the maximum principle."""
    description = build(problem, settings)
    trajectory, multipliers = load_trajectory(solution, description)
    with _progress("certifying"):
        certificate = certify(description, trajectory, multipliers)
    if as_json:
        _print_json(certificate_summary(description, certificate))
    else:
        _print_certificate(description, certificate)
        _print_multipliers(description, trajectory, certificate)
    return certificate_status(certificate)


@cli.command("rerun")
@click.argument("file", metavar="FILE.zip")
@_json
def rerun_command(file: str, as_json: bool) -> int:
    """Repeat what solve --dump wrote; show what it ended with then and now, and what differs."""
    run = load_run(file)
    with _progress(f"solving {run.problem.name or file}"):
        comparison = rerun(run)
    if as_json:
        _print_json(rerun_summary(comparison))
    else:
        out.print(str(comparison), markup=False, highlight=False)
    if comparison.result is None:
        return BAD_INPUT if isinstance(comparison.error, LinFreqOCPError) else NOT_PROVEN
    return exit_status(comparison.result)


@cli.command("init")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE.toml")
def init_command(file: Path) -> int:
    """Write a commented problem file to start from."""
    init_problem_file(file)
    click.echo(f"wrote {file}; next: lin-freq-ocp solve {file}")
    return PROVEN


def build(problem: str, settings: Sequence[str]) -> OptimalControlProblem:
    """Return the library problem of that name, or the problem in that file, with the settings applied.

    Raises
    ------
    ProblemError
        If there is no such problem, a setting is not TOML, or the problem has no such parameter.
    """
    given = parsed_settings(settings)
    if problem not in library.PROBLEMS and (problem.endswith(".toml") or Path(problem).is_file()):
        return read_problem(problem, given)
    builder = library.by_name(problem)
    parameters = inspect.signature(builder).parameters
    for key in given:
        if key not in parameters:
            known = f"some of {', '.join(parameters)}"
            raise ProblemError(f"--set {key}", "no parameter of that name", known, suggestion(key, parameters))
    try:
        return builder(**given)
    except ProblemError:
        raise
    except (TypeError, ValueError) as error:  # a parameter of a wrong type, met in the midst of a formula
        raise ProblemError("--set", f"{given}", f"parameters that {problem} can use", f"({error})") from None


def parsed_settings(settings: Sequence[str]) -> dict[str, Any]:
    """Return KEY=VALUE settings as nested tables; dotted keys name entries of tables."""
    result: dict[str, Any] = {}
    for setting in settings:
        try:
            table = tomllib.loads(setting)
        except tomllib.TOMLDecodeError as error:
            advice = f"Text needs quotes within quotes: --set 'name=\"text\"'. ({error})"
            raise ProblemError("--set", repr(setting), "KEY=VALUE with a TOML value", advice) from None
        if not table:
            raise ProblemError("--set", repr(setting), "KEY=VALUE with a TOML value")
        _merge(result, _without_none(table))
    return result


def _without_none(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table with None for the text "none", which stands for no value: TOML has no word for that."""
    return {
        key: None if value == "none" else _without_none(value) if isinstance(value, dict) else value
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


def exit_status(result: Result) -> int:
    """Return the exit status of a result."""
    if result.interrupted:
        return INTERRUPTED
    if result.status in ("infeasible", "unbounded"):
        return NO_SOLUTION
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
    sys.exit(_status(arguments))


def _status(arguments: Sequence[str] | None) -> int:
    if not out.is_terminal:
        out.size = PAGE
    try:
        return cli.main(None if arguments is None else list(arguments), "lin-freq-ocp", standalone_mode=False) or 0
    except click.ClickException as error:
        error.show()
        return BAD_INPUT
    except (click.Abort, KeyboardInterrupt):
        return INTERRUPTED
    except SolveError as error:
        _complain(error)
        return NOT_PROVEN if error.result is None else exit_status(error.result)
    except (LinFreqOCPError, OSError) as error:
        _complain(error)
        return BAD_INPUT
    except MemoryError as error:
        _complain(f"not enough memory for a problem of this size ({error}).")
        return NOT_PROVEN


def _merge(into: dict[str, Any], new: Mapping[str, Any]) -> None:
    for key, value in new.items():
        if isinstance(value, dict) and isinstance(into.get(key), dict):
            _merge(into[key], value)
        else:
            into[key] = value


def _complain(error: Exception | str) -> None:
    err.print(f"error: {error}", markup=False, highlight=False, soft_wrap=True)


def _show_warning(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
    words = "" if issubclass(category, BandWarning) else f" ({category.__name__})"
    err.print(f"warning: {message}{words}", markup=False, highlight=False, soft_wrap=True)


def _progress(what: str) -> AbstractContextManager[Any]:
    return err.status(escape(what)) if err.is_terminal else nullcontext()


def _print_json(summary: Mapping[str, Any]) -> None:
    click.echo(to_json(summary))


def _print_conflict(result: Result) -> None:
    for one in result.conflict or ():
        out.print(f"conflict  {one}", markup=False, highlight=False)
    if result.explanation is not None:
        out.print(str(result.explanation), markup=False, highlight=False)


def _print_certificate(problem: OptimalControlProblem, certificate: Certificate | None) -> None:
    if certificate is not None:
        from lin_freq_ocp.report.tables import certificate_table

        out.print(certificate_table(problem, certificate))


def _print_multipliers(problem: OptimalControlProblem, trajectory: Trajectory, certificate: Certificate) -> None:
    """Say whether there are others, or the direction that proves that there are none, and what holds at borders."""
    descent = certificate.descent
    if certificate.borders is not None:
        click.echo(f"borders     {certificate.borders}")
    if descent is not None:
        control = problem.control_names[int(np.argmax(np.abs(descent.u[descent.steepest])))]
        proven = "no normal multipliers exist" if certificate.borders is None else "no local minimum"
        click.echo(
            f"descent     {proven}: along a verified direction, which changes {control} most at "
            f"t = {descent.steepest}, the cost falls by {-descent.slope:.3g} per unit"
        )
    elif certificate.pmp == "satisfied":
        try:
            click.echo(f"multipliers {uniqueness(problem, trajectory)}")
        except UnsupportedError:  # too many to count in a moment
            return


def _print_comparison(comparison: Comparison) -> None:
    from lin_freq_ocp.report.tables import comparison_table

    out.print(escape(str(comparison.constrained)), highlight=False)
    _print_conflict(comparison.constrained)
    out.print(comparison_table(comparison))
