"""Margins of random systems are the largest values over all extreme points, and loops have a plan at each step.

Plans of random problems bear all sequences of extreme loads. See tests/helpers/checks, margins.py, robust_plans.py and
robust_loops.py; a loop of 1000 steps for every so many systems.
"""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from helpers.checks import margins, robust_loops, robust_plans
from verify.seeded import check_all

SYSTEMS = 30
"""For each loop."""


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Check the systems of these seeds and print the largest differences; return whether all is right."""
    outcomes = check_all(margins.check, seeds, processes, "systems with loads")
    table = Table("of margins, relative", "largest", title=f"{len(outcomes)} systems against all extreme points")
    for name in ("below", "away", "unattained"):
        table.add_row(name, f"{max(getattr(one, name) for one in outcomes):.1e}")
    console.print(table)
    plans = check_all(robust_plans.check, seeds, processes, "plans under extreme loads")
    console.print(f"{sum(one.status == 'optimal' for one in plans)} of {len(plans)} problems with loads have a plan")
    loops = range(seeds.start, seeds.start - (-len(seeds) // SYSTEMS))
    looped = check_all(robust_loops.check, loops, processes, "loops under loads")
    table = Table("loads", "loops", "steps", "with a plan", "largest excess", title="loops under loads of the set")
    for kind in robust_loops.KINDS:
        some = [one for one in looped if one.kind == kind]
        if not some:
            continue
        counts = len(some), sum(one.steps for one in some), sum(one.planned for one in some)
        table.add_row(kind, *map(str, counts), f"{max(one.excess for one in some):.1e}")
    console.print(table)
    failed = [one for one in (*outcomes, *plans, *looped) if not one.passed]
    for one in failed:
        console.print(one)
    return not failed
