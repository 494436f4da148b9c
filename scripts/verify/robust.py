"""Margins of random systems are the largest values over all extreme points (see tests/helpers/checks/margins.py)."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from helpers.checks.margins import check
from verify.seeded import check_all


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Check the systems of these seeds and print the largest differences; return whether all margins are right."""
    outcomes = check_all(check, seeds, processes, "systems with loads")
    table = Table("of margins, relative", "largest", title=f"{len(outcomes)} systems against all extreme points")
    for name in ("below", "away", "unattained"):
        table.add_row(name, f"{max(getattr(one, name) for one in outcomes):.1e}")
    console.print(table)
    failed = [one for one in outcomes if not one.passed]
    for one in failed:
        console.print(one)
    return not failed
