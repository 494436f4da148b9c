"""Random convex problems, solved by this package and by CVXPY on a program written by ``to_cvxpy``.

The two costs are compared. A difference is explained only where CVXPY's point is less feasible than ours, by residuals
that are worth the difference. Every optimum must satisfy every condition of the maximum principle and be proven by its
gap, unless the bound is numerical, and every infeasible problem by a verified ray (tests/helpers/checks/convex.py).
"""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from helpers.checks.convex import Outcome, check
from verify.seeded import check_all


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Check the random problems of these seeds and print their outcomes; return whether all are right."""
    outcomes = check_all(check, seeds, processes, "solving")
    console.print(summary(outcomes))
    for one in outcomes:
        if one.explained or not one.passed:
            console.print(one)
    return all(one.passed for one in outcomes)


def summary(outcomes: list[Outcome]) -> Table:
    """Return a table by kind of dynamics."""
    table = Table(
        "dynamics", "problems", "optimal", "infeasible", "other", "rigorous", "extremal", title="random linear problems"
    )
    for column in ("cost difference", "gap", "worst condition", "failed"):
        table.add_column(column, justify="right")
    for kind in [*sorted({one.kind for one in outcomes}), "all"]:
        some = [one for one in outcomes if kind in (one.kind, "all")]
        optimal = [one for one in some if "optimal" in one.status]
        infeasible = sum(one.status == "infeasible" for one in some)
        largest = [
            max((value for one in optimal if (value := getattr(one, field)) is not None), default=0.0)
            for field in ("difference", "gap", "worst")
        ]
        table.add_row(
            kind,
            *(str(count) for count in (len(some), len(optimal), infeasible, len(some) - len(optimal) - infeasible)),
            str(sum(one.bound == "rigorous" for one in optimal)),
            str(sum(one.extremal for one in optimal)),
            *(f"{value:.1e}" for value in largest),
            str(sum(not one.passed for one in some)),
        )
    return table
