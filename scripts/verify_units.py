"""Verdicts do not depend on units, on scale, on the origin, or on which large number stands for none.

Every random problem is solved as drawn, and again in other words: the cost times 1e-15..1e15, units of states, controls
and time 1e-9..1e9, another origin, bounds that are not active looser by 1..1e19 or removed, states in another order, a
state more on which nothing depends. The status, whether the maximum principle is satisfied, the class of the gap and
the cost must be the same; ``certify`` must say the same of both trajectories, and of the controls spoiled by a part in
ten.
"""

from __future__ import annotations

from collections import Counter
from concurrent.futures import ProcessPoolExecutor

from rich.console import Console
from rich.progress import track
from rich.table import Table

from helpers.checks.units import CHANGES, check


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Check the problems of these seeds and print what became of them; return whether no verdict changed."""
    with ProcessPoolExecutor(processes) as pool:
        found = pool.map(check, seeds, chunksize=8)
        outcomes = list(track(found, "changing units", len(seeds), console=Console(stderr=True), transient=True))
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
