"""The commands lin-freq-ocp certify and rerun: the maximum principle for any trajectory, and a dumped run again."""

from __future__ import annotations

import click
import numpy as np

from lin_freq_ocp.api.runs import load_run, rerun, rerun_summary
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.cli.console import (
    NOT_PROVEN,
    certificate_status,
    error_status,
    exit_status,
    print_certificate,
    print_json,
    print_lines,
    progress,
    say,
)
from lin_freq_ocp.cli.options import json_option, problem_argument, settings_option
from lin_freq_ocp.cli.problems import build
from lin_freq_ocp.files.solution_file import load_trajectory
from lin_freq_ocp.files.summary import certificate_summary
from lin_freq_ocp.methods.multipliers import uniqueness
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.certify import certify


@click.command("certify")
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
        print_certificate(description, certificate)
        _print_multipliers(description, trajectory, certificate)
    return certificate_status(certificate)


@click.command("rerun")
@click.argument("file", metavar="FILE.zip")
@json_option
def rerun_command(file: str, as_json: bool) -> int:
    """Repeat what solve --dump wrote; show what it ended with then and now, and what differs."""
    run = load_run(file)
    with progress(f"solving {run.problem.name or file}"):
        comparison = rerun(run)
    if as_json:
        print_json(rerun_summary(comparison))
    else:
        print_lines(str(comparison))
    if comparison.error is not None:
        return error_status(comparison.error)
    return NOT_PROVEN if comparison.result is None else exit_status(comparison.result)


def _print_multipliers(problem: OptimalControlProblem, trajectory: Trajectory, certificate: Certificate) -> None:
    """Print whether the multipliers are unique, or the direction that excludes any, and the conditions at borders."""
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
