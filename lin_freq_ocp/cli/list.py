"""The command lin-freq-ocp list: the library."""

from __future__ import annotations

import click

from lin_freq_ocp import library
from lin_freq_ocp.cli.console import PROVEN, out
from lin_freq_ocp.cli.options import first_words


@click.command("list")
def list_command() -> int:
    """List the library's problems and what each shows."""
    from lin_freq_ocp.report.narrow import terms

    out.print(terms([(name, first_words(builder)) for name, builder in library.PROBLEMS.items()], out.width))
    return PROVEN
