"""Infeasible and unbounded are proven or not said (see tests/helpers/checks/rays.py)."""

from __future__ import annotations

from collections import Counter

from rich.console import Console
from rich.table import Table

from helpers.checks.rays import KINDS, check
from verify.seeded import check_all


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Check the problems of these seeds and print their statuses; return whether none contradicts what is known."""
    outcomes = check_all(check, seeds, processes, "problems whose feasibility and boundedness are known")
    table = Table("kind", "problems", "contradicted", "statuses", title="proofs of infeasible and unbounded")
    for kind in KINDS:
        own = [one for one in outcomes if one.kind == kind]
        counts = Counter(status for one in own for status in one.statuses)
        statuses = ", ".join(f"{status} {count}" for status, count in counts.most_common())
        table.add_row(kind, str(len(own)), str(sum(not one.passed for one in own)), statuses)
    console.print(table)
    failed = [one for one in outcomes if not one.passed]
    for one in failed:
        console.print(one)
    return not failed
