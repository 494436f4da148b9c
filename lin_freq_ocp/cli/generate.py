"""The commands lin-freq-ocp generate and certify-log: a controller as C, and its log judged afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from lin_freq_ocp.api.generate import certify_log, generate
from lin_freq_ocp.api.receding_horizon import RecedingHorizon
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.cli import console
from lin_freq_ocp.cli.problems import build
from lin_freq_ocp.loop.log import LogFinding

soft_option = click.option(
    "--soft", multiple=True, metavar="FIELD=PENALTY", help="Constraints of a field become soft, at this penalty."
)
delay_option = click.option(
    "--delay", type=int, default=0, show_default=True, help="1: a control acts one step after its measurement."
)
PROVEN = (LogFinding.PROVEN, LogFinding.INFEASIBLE)  # of a step, for the exit status


def controller_of(problem: str, settings: Sequence[str], soft: Sequence[str], delay: int) -> RecedingHorizon:
    """Return the controller of a library problem or a problem file."""
    penalties = dict[str, float]()
    for given in soft:
        field, equals, penalty = given.partition("=")
        try:
            penalties[field] = float(penalty)
        except ValueError:
            got = repr(penalty) if equals else "no penalty"
            raise ProblemError(f"--soft {given}", got, "FIELD=PENALTY, such as state_set=1000") from None
    return RecedingHorizon(build(problem, settings), soft=penalties, delay=delay)


@click.command("generate")
@console.problem_argument
@click.argument("folder", type=click.Path(path_type=Path))
@console.settings_option
@soft_option
@delay_option
@click.option("--real", default="double", show_default=True, help="double or float.")
@click.option("--changes", type=int, help="Limit on the changes of the working set in a step, which bounds its time.")
@click.option("--memory", metavar="BYTES", help="Limit on the RAM, stack included, such as 64k.")
@click.option("--references", is_flag=True, help="A step also takes a reference of the states.")
def generate_command(
    problem: str,
    folder: Path,
    settings: tuple[str, ...],
    soft: tuple[str, ...],
    delay: int,
    real: str,
    changes: int | None,
    memory: str | None,
    references: bool,
) -> int:
    """Write a receding-horizon controller as C into a folder, with a test."""
    controller = controller_of(problem, settings, soft, delay)
    written = generate(controller, folder, real, changes, memory, references)
    console.print_lines(str(written))
    console.say(f"next: make -C {folder}")
    return console.PROVEN


@click.command("certify-log")
@console.problem_argument
@click.argument("log", type=click.Path(path_type=Path), metavar="LOG.csv")
@console.settings_option
@soft_option
@delay_option
@click.option(
    "--tolerance",
    type=float,
    default=0.01,
    show_default=True,
    help="Largest difference from the control of the optimal plan, relative to its bound.",
)
def certify_log_command(
    problem: str, log: Path, settings: tuple[str, ...], soft: tuple[str, ...], delay: int, tolerance: float
) -> int:
    """Certify the log of a generated controller: which controls are the first of a plan that is proven optimal."""
    certified = certify_log(controller_of(problem, settings, soft, delay), log, tolerance)
    console.print_lines(str(certified))
    return console.PROVEN if all(one in PROVEN for one in certified.findings) else console.NOT_PROVEN
