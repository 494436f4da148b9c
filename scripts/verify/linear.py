"""Random linear problems of every shape, in any units, against plain Clarabel on the same quadratic program.

Part of scripts/verify.py. The program is written here, from the problem in good units, with scipy.sparse alone. Counted
are problems without an answer where Clarabel has one, and costs that differ from Clarabel's by more than 1e-6 of what
the terms of the cost add up to in absolute value.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from helpers.checks.linear import Outcome, check
from verify.seeded import check_all


def summary(outcomes: Sequence[Outcome]) -> Table:
    """Return how many problems ended how, here and there."""
    table = Table("here", "Clarabel", "problems", title="random linear problems in any units, against plain Clarabel")
    for (ours, theirs), count in Counter((one.ours, one.theirs) for one in outcomes).most_common():
        table.add_row(ours, theirs, str(count))
    table.add_row("no answer", "an answer", str(sum(one.unanswered for one in outcomes)))
    table.add_row("another cost", "", str(sum(one.wrong for one in outcomes)))
    return table


def verify(console: Console, seeds: Sequence[int], processes: int) -> bool:
    """Check all seeds and print their outcomes; return whether all have an answer of the right cost."""
    outcomes = check_all(check, seeds, processes, "linear problems")
    console.print(summary(outcomes))
    failed = [one for one in outcomes if one.unanswered or one.wrong]
    for one in failed:
        console.print(str(one), soft_wrap=True, markup=False, highlight=False)
    return not failed
