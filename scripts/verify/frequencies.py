"""Masks at every frequency: random problems between two bounds of an independent model, and proven maxima of signals.

Part of scripts/verify.py. CVXPY solves every problem with the mask at 64 points for each sample. That cost is a lower
bound. With a limit that is lowered until the spectrum, sampled at 1024 points for each sample, stays below the true
limit, it is an upper bound. Then the largest |V|/l of random signals of 10 to 100 000 samples, with masks 0 to 100 dB
below their peak, is compared with an FFT in extended precision and a search around its peaks: no proven value may be
below it, or above the value at its own frequency by more than 2e-9, of which 1e-9 is that of the first of equal peaks.
"""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.table import Table

from helpers.checks.frequencies import KINDS, check, peak_errors
from verify.seeded import check_all

ABOVE = 2e-9  # of a proven maximum over the value at its own frequency


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Check problems and signals, and print the results; return whether all passed."""
    found = check_all(check, seeds, processes, "masks at every frequency")
    table = Table("mask", "problems", "optimal", "infeasible", title="masks at every frequency, against CVXPY on grids")
    for column in ("below the lower bound", "above the upper", "bracket", "largest excess", "failed"):
        table.add_column(column, justify="right")
    for kind in [*KINDS, "all"]:
        some = [one for one in found if kind in (one.kind, "all")]
        optimal = [one for one in some if one.status == "optimal"]
        below = max((one.lower / one.cost - 1 for one in optimal), default=0.0)
        above = max((one.cost / one.upper - 1 for one in optimal), default=0.0)
        width = float(np.median([one.upper / one.lower - 1 for one in optimal])) if optimal else 0.0
        excess = max((one.excess for one in optimal), default=0.0)
        infeasible = sum(one.status == "infeasible" for one in some)
        counts = len(some), len(optimal), infeasible
        failed = sum(not one.passed for one in some)
        table.add_row(kind, *map(str, counts), *(f"{v:.1e}" for v in (below, above, width, excess)), str(failed))
    console.print(table)
    for one in found:
        if not one.passed:
            console.print(one)
    signals = range(seeds.start, seeds.start + 5 * len(seeds))
    errors = np.array(check_all(peak_errors, signals, processes, "proven maxima"))
    bad = int((errors[:, 0] > 0).sum() + (errors[:, 1] > ABOVE).sum())
    console.print(
        f"proven maxima of {len(signals)} signals of 10 to 100 000 samples, 0 to 100 dB deep: at most "
        f"{errors[:, 0].max():.1e} below a search, {errors[:, 1].max():.1e} above the value there; {bad} failed"
    )
    return all(one.passed for one in found) and not bad
