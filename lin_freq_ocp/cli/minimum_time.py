"""The command lin-freq-ocp minimum-time: the least horizon at which a problem is feasible.

Exit status: 0 a horizon is feasible and all shorter ones of the range are proven infeasible; 1 none of the range is
feasible, which is proven; 2 bad input; 3 nothing is proven of some horizon; 130 interrupted, and what is decided is
printed.
"""

from __future__ import annotations

import click

from lin_freq_ocp import __version__
from lin_freq_ocp.api.minimum_time import MinimumTime, minimum_time
from lin_freq_ocp.base.interrupts import INTERRUPTED
from lin_freq_ocp.cli.console import (
    NO_SOLUTION,
    NOT_PROVEN,
    PROVEN,
    print_certificate,
    print_json,
    print_lines,
    search_progress,
)
from lin_freq_ocp.cli.options import json_option, problem_argument, solve_options
from lin_freq_ocp.cli.problems import ProblemFile, builder, is_file, parsed_settings
from lin_freq_ocp.files.locations import FileTable
from lin_freq_ocp.files.results.summary import SCHEMA, result_summary


@click.command("minimum-time")
@problem_argument
@click.option("--horizons", nargs=2, type=int, required=True, metavar="LO HI", help="The range, both ends included.")
@solve_options
@json_option
def minimum_time_command(
    problem: str,
    horizons: tuple[int, int],
    settings: tuple[str, ...],
    method: str,
    backend: str,
    time_limit: float | None,
    tolerance: float | None,
    as_json: bool,
) -> int:
    """Find the least horizon at which a problem is feasible, and prove that one step less is not."""
    given = parsed_settings(settings)
    source = ProblemFile.read(problem, given) if is_file(problem) else builder(problem, given)
    with search_progress("looking for the least horizon") as report:
        tell = None if report is None else lambda horizon, verdict: report(f"{horizon} is {verdict}")
        found = minimum_time(source, horizons, method, backend, time_limit, tolerance, throw=False, progress=tell)
    if as_json:
        print_json(_summary(found))
    else:
        print_lines(str(found))
        if found.result is not None:
            print_certificate(found.result.problem, found.result.certificate)
    if found.interrupted:
        return INTERRUPTED
    return NOT_PROVEN if not found.proven else NO_SOLUTION if found.horizon is None else PROVEN


def _summary(found: MinimumTime) -> FileTable:
    """Return the JSON object; ``result`` is that of ``lin-freq-ocp solve --json``."""
    return {
        "schema": SCHEMA,
        "version": __version__,
        "horizon": found.horizon,
        "horizons": list(found.horizons),
        "monotone": found.monotone,
        "reason": found.reason,
        "proven": found.proven,
        "proof": found.proof,
        "verdicts": {str(T): verdict for T, verdict in found.verdicts.items()},
        "interrupted": found.interrupted,
        "result": None if found.result is None else result_summary(found.result),
    }
