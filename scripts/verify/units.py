"""The same problem in other units has the same verdict (see tests/helpers/checks/units.py)."""

from __future__ import annotations

from collections import Counter

from rich.console import Console
from rich.table import Table

from helpers.checks.units import CHANGES, check
from verify.seeded import check_all


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Check the problems of these seeds and print their outcomes; return whether no verdict changed."""
    outcomes = check_all(check, seeds, processes, "changing units")
    table = Table("class", *CHANGES, "statuses", "largest cost difference", title="verdicts that changed, of problems")
    for kind in sorted({one.kind for one in outcomes}):
        own = [one for one in outcomes if one.kind == kind]
        cells = [[one for one in own if one.change == change] for change in CHANGES]
        counts = [f"{sum(not one.passed for one in some)} of {len(some)}" for some in cells]
        statuses = ", ".join(f"{status} {count}" for status, count in Counter(one.first.status for one in own).items())
        table.add_row(kind, *counts, statuses, f"{max(one.difference for one in own):.1e}")
    console.print(table)
    failed = [one for one in outcomes if not one.passed]
    for one in failed:
        console.print(one)
    return not failed
