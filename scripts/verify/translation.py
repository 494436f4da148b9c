"""The same problem far from zero has the same verdict (see tests/helpers/checks/translation.py)."""

from __future__ import annotations

from collections import Counter

from rich.console import Console
from rich.table import Table

from helpers.checks.translation import QUESTIONS, check
from verify.seeded import check_all


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Check the problems of these seeds and print their outcomes; return whether no verdict changed."""
    outcomes = check_all(check, seeds, processes, "counting from far away")
    title = "verdicts that changed far from zero, of problems"
    table = Table("class", *QUESTIONS, "statuses", "rounded", "largest cost difference", title=title)
    for kind in sorted({one.kind for one in outcomes}):
        own = [one for one in outcomes if one.kind == kind]
        cells = [[one for one in own if one.question == question] for question in QUESTIONS]
        counts = [f"{sum(not one.passed for one in some)} of {len(some)}" for some in cells]
        solved = [one for one in own if one.question == "solve"]
        statuses = ", ".join(f"{name} {count}" for name, count in Counter(str(one.first[0]) for one in solved).items())
        rounded = str(sum(one.rounded and one.first != one.second for one in own))
        table.add_row(kind, *counts, statuses, rounded, f"{max(one.cost_difference for one in own):.1e}")
    console.print(table)
    failed = [one for one in outcomes if not one.passed]
    for one in failed:
        console.print(one)
    return not failed
