"""Random problems of all kinds by the structured method and by every other that takes them.

Part of scripts/verify.py (see tests/helpers/checks/structured.py). It fails where the structured method, with compiled
loops or without, has no answer to a problem that another answers, contradicts a proof, or has another cost and the
larger gap. The errors of the other methods are counted, too.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from helpers.checks.structured import ERRORS, METHODS, Outcome, Verdict, check
from verify.seeded import check_all


def summary(outcomes: Sequence[Outcome]) -> Table:
    """Return the number of answers of every method, by kind."""
    table = Table("answer", *METHODS, title=f"{len(outcomes)} random problems by every linear method")
    counts = {name: Counter(one.verdicts[name] for one in outcomes) for name in METHODS}
    for verdict in Verdict:
        style = "red" if verdict in ERRORS and counts["structured"][verdict] + counts["plain"][verdict] else None
        table.add_row(verdict, *(str(counts[name][verdict]) for name in METHODS), style=style)
    return table


def verify(console: Console, seeds: Sequence[int], processes: int) -> bool:
    """Check all seeds and print their outcomes; return whether the structured method is right everywhere."""
    outcomes = check_all(check, seeds, processes, "all linear methods")
    console.print(summary(outcomes))
    for one in outcomes:
        if one.notable:
            console.print(str(one), soft_wrap=True, markup=False, highlight=False)
    return all(one.passed for one in outcomes)
