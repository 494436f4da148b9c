"""The command line: lin-freq-ocp and its commands.

Exit status: 0 the maximum principle is satisfied and normal, or the gap is proven; 1 infeasible or unbounded, with the
reason (0 for a sweep, in which both are answers); 2 bad input, or a file that cannot be written; 3 a point without such
a proof, a plan that some load breaks, or too little memory; 70 a fault of this program; 130 interrupted.
"""

from __future__ import annotations

import ast
import atexit
import gc
import logging
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from io import TextIOWrapper
from pathlib import Path

import click

from lin_freq_ocp import __version__
from lin_freq_ocp.base.errors import BandWarning, ClosedLoopWarning, SolveError, suggestion
from lin_freq_ocp.base.interrupts import INTERRUPTED, leave_silently, let_commands_decide
from lin_freq_ocp.cli import console

# The commands, in the order of the help, and their modules.
COMMANDS = {
    "list": "show",
    "show": "show",
    "solve": "solve",
    "compare": "solve",
    "sweep": "sweep",
    "minimum-time": "sweep",
    "shaper": "input_shaper",
    "explore": "explore",
    "certify": "solve",
    "worst-case": "solve",
    "rerun": "solve",
    "generate": "generate",
    "certify-log": "generate",
    "init": "show",
    "schema": "show",
}
FUNCTION = "{}_command"  # of a command in its module


class Commands(click.Group):
    """Commands that are imported when they are called; Ctrl-C ends them without a message."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; Ctrl-C during the import ends the process."""
        if cmd_name not in COMMANDS:
            return None
        leave_silently()
        module = import_module(f"lin_freq_ocp.cli.{COMMANDS[cmd_name]}")
        let_commands_decide()
        command: click.Command = getattr(module, FUNCTION.format(cmd_name.replace("-", "_")))
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; the error for an unknown name suggests the nearest command."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            raise click.UsageError(f"{error.message} {suggestion(args[0], COMMANDS)}".rstrip(), ctx) from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the first line of each command's docstring, read from the source: importing all takes a second."""
        lines = dict[str, str]()
        for module in set(COMMANDS.values()):
            for node in ast.parse(Path(__file__).with_name(f"{module}.py").read_bytes()).body:
                if isinstance(node, ast.FunctionDef):
                    lines[node.name] = (ast.get_docstring(node) or "").partition("\n")[0]
        with formatter.section("Commands"):
            formatter.write_dl([(name, lines[FUNCTION.format(name.replace("-", "_"))]) for name in COMMANDS])

    def invoke(self, ctx: click.Context) -> object:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise click.Abort from None


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, package_name="lin-freq-ocp")
def cli() -> None:
    """Optimal control with constraints in time and in frequency, with a certificate for every answer."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with its status."""
    warnings.showwarning = _show_warning
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # its font cache is missing, or cannot be written: it works
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that lacks a character shows a question mark
    atexit.register(gc.freeze)  # without it, Python collects garbage for a tenth of a second before it ends
    silent = False
    try:
        silent = let_commands_decide()
        status = _run_command(arguments)
    except KeyboardInterrupt:  # before the command began, or after it ended
        status = INTERRUPTED
    if silent:
        leave_silently()
    # If Ctrl-C interrupts code that exec() runs, such as that of dataclasses, Python later ends by the signal, not with
    # our status, even if KeyboardInterrupt was caught. Another call of exec() prevents that.
    exec("")
    sys.exit(status)


def _run_command(arguments: Sequence[str] | None) -> int:
    console.fit_console()
    try:
        return cli.main(None if arguments is None else list(arguments), "lin-freq-ocp", standalone_mode=False) or 0
    except click.ClickException as error:
        error.show()
        return console.BAD_INPUT
    except (click.Abort, KeyboardInterrupt):
        return INTERRUPTED
    except SolveError as error:
        console.complain(error)
        return console.NOT_PROVEN if error.result is None else console.exit_status(error.result)
    except Exception as error:
        if console.error_status(error) != INTERRUPTED:
            console.complain(console.error_message(error))
        return console.error_status(error)


def _show_warning(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
    kind = "" if issubclass(category, (BandWarning, ClosedLoopWarning)) else f" ({category.__name__})"
    console.err.print(f"warning: {message}{kind}", markup=False, highlight=False, soft_wrap=True)
