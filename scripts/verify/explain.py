"""Random infeasible problems are explained, and each statement is checked (see tests/helpers/checks/explain.py)."""

from __future__ import annotations

from collections import Counter

from rich.console import Console
from rich.table import Table

from helpers.checks.explain import check
from helpers.random.infeasible import KINDS
from verify.seeded import check_all


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Check the problems of these seeds and print their outcomes; return whether all are right."""
    outcomes = check_all(check, seeds, processes, "explaining")
    table = Table(
        "made infeasible", "problems", "blocks", "cures", "not decided", "failed", title="infeasible, explained"
    )
    for kind in [*KINDS, "all"]:
        some = [one for one in outcomes if kind in (one.kind, "all")]
        if some:
            sizes, cures = [len(one.family) for one in some], Counter(cure for one in some for cure in one.cures)
            told = ", ".join(f"{count} {what}" for what, count in cures.most_common())
            unsure, failed = sum(one.unsure for one in some), sum(not one.passed for one in some)
            table.add_row(kind, str(len(some)), f"{min(sizes)} to {max(sizes)}", told, str(unsure), str(failed))
    console.print(table)
    for one in outcomes:
        if not one.passed:
            console.print(f"FAILED seed {one.seed}, {one.kind}: {'; '.join(one.wrong)}", markup=False)
    return all(one.passed for one in outcomes)
