"""Random continuous piecewise-affine problems: flips of modes (see tests/helpers/checks/flips.py)."""

from __future__ import annotations

from collections import Counter

from rich.console import Console
from rich.table import Table

from helpers.checks.flips import check
from helpers.random.kinks import KINDS
from verify.seeded import check_all


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Check the problems of these seeds and print their outcomes; return whether all are right."""
    outcomes = check_all(check, seeds, processes, "flipping")
    columns = (
        *("joint", "flip", "stay", "degenerate", "undecided"),
        *("inside", "flip-stationary", "joint only", "no multipliers found", "long way"),
    )
    table = Table("map", "problems", "at borders", *columns, "failed", title="flips at the borders of modes")
    for kind in [*KINDS, "all"]:
        some = [one for one in outcomes if kind in (one.kind, "all")]
        total = sum((one.counts for one in some), Counter[str]())
        numbers = len(some), sum(one.borders > 0 for one in some), *(total[column] for column in columns)
        table.add_row(kind, *map(str, numbers), str(sum(not one.passed for one in some)))
    console.print(table)
    for one in outcomes:
        if not one.passed:
            console.print(f"FAILED seed {one.seed}, {one.kind}: {'; '.join(one.wrong)}", markup=False)
    return all(one.passed for one in outcomes)
