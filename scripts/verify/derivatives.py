"""Derivatives of random optima against differences, their kinks, and other units (helpers/checks/derivatives.py)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from helpers.checks.derivatives import Check, Kink, Units, check, kink, units
from verify.seeded import check_all

WORST = {"vjp": 1e-6, "cost": 1e-6, "transposed": 1e-11, "affine": 1e-10}


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Check problems of these seeds, a third as many kinks, and as many in other units; return whether all is right."""
    fewer = seeds[: max(1, len(seeds) // 3)]
    checks = check_all(check, seeds, processes, "derivatives and differences")
    kinks = check_all(kink, fewer, processes, "kinks")
    others = check_all(units, fewer, processes, "other units")
    table = Table("figure", "median", "largest", "of", "at most", title="derivatives of random optima")
    good = True
    for name, limit in WORST.items():
        found = np.array([getattr(one, name) for one in checks])
        found = found[np.isfinite(found)]
        good &= bool((found <= limit).all())
        table.add_row(name, f"{np.median(found):.1e}", f"{found.max():.1e}", str(len(found)), f"{limit:.0e}")
    errors = np.array([one.error for one in kinks if np.isfinite(one.error)])
    table.add_row("sides of kinks", f"{np.median(errors):.1e}", f"{errors.max():.1e}", str(len(errors)), "1e-06")
    apart = np.array([one.apart for one in others if np.isfinite(one.apart)])
    table.add_row("other units", f"{np.median(apart):.1e}", f"{apart.max():.1e}", str(len(apart)), "1e-08")
    console.print(table)
    for title, outcomes in (("problems", checks), ("kinks", kinks), ("units", others)):
        console.print(title, dict(Counter(one.outcome for one in outcomes)))
    failed = failures(checks, kinks, others)
    for one in failed:
        console.print(one)
    return good and not failed and bool((errors <= 1e-6).all() and (apart <= 1e-8).all())


def failures(checks: Sequence[Check], kinks: Sequence[Kink], others: Sequence[Units]) -> list[Check | Kink | Units]:
    """Return what is wrong: no derivative where there is one, a kink that is missed or not named, other verdicts."""
    wrong: list[Check | Kink | Units] = [
        one for one in checks if one.outcome == "no derivative" or one.vjp > WORST["vjp"] or not one.beyond
    ]
    wrong += [one for one in kinks if one.outcome == "missed" or (one.outcome == "two sides" and not one.named)]
    return wrong + [one for one in others if not one.same]
