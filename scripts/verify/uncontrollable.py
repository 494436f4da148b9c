"""No two methods find two optima of one nearly uncontrollable problem (see tests/helpers/checks/uncontrollable.py)."""

from __future__ import annotations

from collections import Counter

from rich.console import Console
from rich.table import Table

from helpers.checks.uncontrollable import METHODS, check
from verify.seeded import check_all


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Check the problems of these seeds and print the statuses; return whether every optimal cost is right."""
    outcomes = check_all(check, seeds, processes, "nearly uncontrollable problems")
    unproven = sum(one.exact is None for one in outcomes)
    table = Table("method", "statuses", "wrong", title=f"{len(outcomes)} problems, {unproven} without an exact optimum")
    for method in METHODS:
        statuses = Counter(one.statuses[method] for one in outcomes)
        wrong = sum(method in one.wrong for one in outcomes)
        table.add_row(method, ", ".join(f"{name} {count}" for name, count in statuses.items()), str(wrong))
    console.print(table)
    failed = [one for one in outcomes if not one.passed]
    for one in failed:
        console.print(one)
    return not failed
