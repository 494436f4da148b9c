"""Arguments and options that several commands have."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import TypeVar

import click
from click.shell_completion import CompletionItem

Command = TypeVar("Command", bound=Callable[..., object])


def complete_problem(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Return the completions of a problem: names of the library with their first lines, and files."""
    from lin_freq_ocp import library

    names = [name for name in library.PROBLEMS if name.startswith(incomplete)]
    shown = [CompletionItem(name, help=first_line_of(library.PROBLEMS[name])) for name in names]
    return [CompletionItem(incomplete, type="file"), *shown]


def first_line_of(function: Callable[..., object]) -> str:
    """Return the first line of a docstring."""
    return (inspect.getdoc(function) or "").partition("\n")[0]


problem_argument = click.argument("problem", metavar="NAME|FILE.toml", shell_complete=complete_problem)
settings_option = click.option(
    "--set", "settings", multiple=True, metavar="KEY=VALUE", help="Set a parameter; the value is TOML."
)
backend_option = click.option(
    "--backend", default="auto", show_default=True, help="clarabel, osqp, qpsolvers:NAME; scip, daqp."
)
METHOD_HELP = "auto; spectral, structured or convex; for modes branch_and_bound, enumerate or miqp; smooth: nonsmooth."
method_option = click.option("--method", default="auto", show_default=True, help=METHOD_HELP)
tolerance_option = click.option("--tolerance", type=float, help="Relative residuals, or over modes the gap to prove.")
time_limit_option = click.option("--time-limit", type=float, help="Seconds for the solver.")
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout and nothing else.")


def solve_options(command: Command) -> Command:
    """Add the options of solve that every method knows, with the settings of the problem."""
    for option in (tolerance_option, time_limit_option, backend_option, method_option, settings_option):
        command = option(command)
    return command
