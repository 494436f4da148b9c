"""Random smooth problems without bounds, against IPOPT and dense eigenvalues (see tests/helpers/checks/smooth.py)."""

from __future__ import annotations

from collections import Counter

from rich.console import Console
from rich.table import Table

from helpers.checks.smooth import check
from helpers.random.smooth import KINDS
from verify.seeded import check_all


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Check the problems of these seeds and print their outcomes; return whether all are right."""
    outcomes = check_all(check, seeds, processes, "solving smooth problems")
    statuses = ("locally_optimal", "extremal")
    columns = (*statuses, "others", "IPOPT succeeds", "IPOPT is better", "failed")
    table = Table("kind", "problems", *columns, title="smooth problems without bounds")
    for kind in [*KINDS, "all"]:
        some = [one for one in outcomes if kind in (one.kind, "all")]
        counts = Counter(one.status for one in some)
        numbers = [len(some), *(counts[status] for status in statuses)]
        numbers += [len(some) - sum(numbers[1:]), sum(one.claim == "Solve_Succeeded" for one in some)]
        numbers += [sum(one.worse for one in some), sum(one.verdict != "right" for one in some)]
        table.add_row(kind, *map(str, numbers))
    console.print(table)
    for one in outcomes:
        if one.verdict != "right":
            console.print(f"FAILED seed {one.seed}, {one.kind}: {one.verdict}; {one}", markup=False)
    return all(one.verdict == "right" for one in outcomes)
