"""The commands lin-freq-ocp list and init: the library, and a problem file to start from."""

from __future__ import annotations

from pathlib import Path

import click

from lin_freq_ocp import library
from lin_freq_ocp.cli.console import PROVEN, out, say
from lin_freq_ocp.cli.options import first_line_of


@click.command("list")
def list_command() -> int:
    """List the library's problems and what each shows."""
    from lin_freq_ocp.pages.report.narrow import terms

    out.print(terms([(name, first_line_of(builder)) for name, builder in library.PROBLEMS.items()], out.width))
    return PROVEN


@click.command("init")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE.toml")
def init_command(file: Path) -> int:
    """Write a commented problem file to start from."""
    from lin_freq_ocp.files.problem_file import init_problem_file

    init_problem_file(file)
    say(f"wrote {file}; next: lin-freq-ocp solve {file}")
    return PROVEN
