"""Known piecewise-affine problems by four methods (see tests/helpers/checks/modes.py)."""

from __future__ import annotations

from rich.console import Console
from rich.progress import track
from rich.table import Table

from helpers.checks.modes import INSTANCES, check


def verify(console: Console) -> bool:
    """Check all instances and print what became of them; return whether all are as they must."""
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
