"""Piecewise-affine problems: known ones by four methods, and random ones against all mode sequences.

See tests/helpers/checks/modes.py and sequences.py.
"""

from __future__ import annotations

from rich.console import Console
from rich.progress import track
from rich.table import Table

from helpers.checks import sequences
from helpers.checks.modes import INSTANCES, check
from verify.seeded import check_all


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Check all instances and the random problems of these seeds, print them; return whether all are as they must."""
    random = check_all(sequences.check, seeds, processes, "enumerating")
    infeasible = sum(one.best == float("inf") for one in random)
    failed = [one for one in random if not one.passed]
    console.print(
        f"{len(random)} random problems against all mode sequences: {infeasible} infeasible, {len(failed)} failed"
    )
    for one in failed:
        console.print(f"FAILED seed {one.seed}, optimum {one.best:.9g}: {'; '.join(one.wrong)}", markup=False)
    return _known(console) and not failed


def _known(console: Console) -> bool:
    """Check the known instances and print a table of them; return whether all are as they must."""
    names = track(list(INSTANCES), "searching", console=Console(stderr=True), transient=True)
    outcomes = [check(name) for name in names]
    table = Table("instance", "optimal cost", title="mode sequences by four methods")
    for column in ("difference of costs", "proven gap"):
        table.add_column(column, justify="right")
    table.add_column("wrong claims")
    for one in outcomes:
        cost = one.costs["branch_and_bound"]
        shown = "none" if cost is None else f"{cost:.9g}"
        table.add_row(one.name, shown, f"{one.difference:.1e}", f"{one.gap:.1e}", one.message)
    console.print(table)
    return all(one.passed for one in outcomes)
