"""The command lin-freq-ocp init: a commented problem file to start from."""

from __future__ import annotations

from pathlib import Path

import click

from lin_freq_ocp.cli.console import PROVEN, say
from lin_freq_ocp.interchange.problem_file.toml_file import init_problem_file


@click.command("init")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE.toml")
def init_command(file: Path) -> int:
    """Write a commented problem file to start from."""
    init_problem_file(file)
    say(f"wrote {file}; next: lin-freq-ocp solve {file}")
    return PROVEN
