"""The command lin-freq-ocp rerun: a dumped run, then and now."""

from __future__ import annotations

import click

from lin_freq_ocp.api.runs import load_run, rerun, rerun_summary
from lin_freq_ocp.cli.console import NOT_PROVEN, error_status, exit_status, print_json, print_lines, progress
from lin_freq_ocp.cli.options import json_option


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
