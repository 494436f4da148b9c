"""Known piecewise-affine problems: enumeration, branch and bound, SCIP and DAQP must agree, and the gap be proven.

Ten instances over five systems, half with a frequency constraint. What a mixed-integer solver claims counts only so far
as its mode sequence, solved again as a convex program, has that cost.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import lin_freq_ocp as lfo
from helpers.checks.claimed import resolved
from lin_freq_ocp.methods.hybrid import solve_miqp
from lin_freq_ocp.testing import PIECEWISE_AFFINE as INSTANCES

AGREEMENT = 1e-6  # relative difference of two costs, and relative gap


@dataclass(frozen=True)
class Outcome:
    """What became of one instance.

    Attributes
    ----------
    costs : dict
        Of the sequence that each method found; None without one.
    gap : float
        The larger one of the two that are proven, relative.
    difference : float
        The largest relative difference of two costs, that of the known optimum counted at its printed digits.
    words : str
        What a mixed-integer solver claimed wrongly.
    """

    name: str
    costs: dict[str, float | None]
    gap: float
    difference: float
    message: str

    @property
    def passed(self) -> bool:
        """Whether all agree and the optimum is proven."""
        return self.difference <= AGREEMENT and self.gap <= AGREEMENT and not self.message


@cache
def answers(name: str) -> tuple[dict[str, float | None], float, str]:
    """Return what four methods say of an instance: costs, the larger gap, and what was claimed wrongly."""
    system, arguments, _ = INSTANCES[name]
    problem, costs, gap, message = lfo.library.by_name(system)(**arguments), dict[str, float | None](), 0.0, list[str]()
    for method in ("enumerate", "branch_and_bound"):
        result = lfo.solve(problem, method=method, throw=False)
        costs[method], gap = result.cost, max(gap, float("inf") if result.gap is None else abs(result.gap))
    for backend in ("scip", "daqp"):
        outcome = solve_miqp(problem, backend)
        again = resolved(problem, outcome) if outcome.sequence is not None else None
        costs[backend] = None if again is None else again.cost
        message += [] if again is None or not again.message else [f"{backend}: {again.message}"]
    return costs, gap, "; ".join(message)


def check(name: str) -> Outcome:
    """Compare the answers of four methods with one another and with the known optimum."""
    (costs, gap, message), known = answers(name), INSTANCES[name][2]
    found = [*costs.values(), *([] if known is None else [known])]
    difference = float("inf")
    if None not in found:
        numbers = [cost for cost in found if cost is not None]
        difference = (max(numbers) - min(numbers)) / max(1.0, abs(min(numbers)))
    return Outcome(name, costs, gap, difference, message)
