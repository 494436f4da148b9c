"""Random feasible problems of mixed features, against CVXPY (see tests/helpers/checks/mixed.py)."""

from __future__ import annotations

from collections import Counter

import numpy as np
from rich.console import Console
from rich.table import Table

from helpers.checks.mixed import check
from verify.seeded import check_all


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Check the problems of these seeds, show the results, and return whether all passed."""
    outcomes = check_all(check, seeds, processes, "mixing")
    table = Table(title=f"{len(seeds)} random problems of mixed features, against CVXPY")
    for column in ("feature", "problems"):
        table.add_column(column)
    for feature, count in Counter(one for outcome in outcomes for one in outcome.features).most_common():
        table.add_row(feature, str(count))
    console.print(table)
    solved = [outcome for outcome in outcomes if np.isfinite(outcome.difference)]
    console.print(
        f"largest difference of costs {max(o.difference for o in solved):.1e}, gap {max(o.gap for o in solved):.1e}, "
        f"condition {max(o.worst for o in solved):.1e}; "
        f"{sum(len(o.tried) for o in outcomes)} spoiled inputs of the judge"
    )
    failed = [outcome for outcome in outcomes if not outcome.passed]
    for outcome in failed:
        console.print(f"[red]seed {outcome.seed}[/]: {', '.join(outcome.wrong)}; {', '.join(outcome.features)}")
    return not failed
