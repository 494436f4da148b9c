"""certify() of trajectories alone agrees with solve (see tests/helpers/checks/alone.py)."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

import lin_freq_ocp as lfo
from helpers.checks.alone import KINDS, METHODS, Outcome, check, judged_alone
from verify.seeded import check_all


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Certify random problems and those of the library; return whether all proven optima are certified."""
    outcomes = check_all(check, seeds, processes, "trajectories certified alone")
    outcomes += [one for name in lfo.library.PROBLEMS for one in of_library(name)]
    table = Table("kind", "proven optima", "not certified", "largest residual", title="certify() of a trajectory alone")
    for kind in (*KINDS, "library"):
        own = [one for one in outcomes if one.kind == kind and one.status == "optimal"]
        wrong = sum(not one.passed for one in own)
        worst = max((one.worst for one in own), default=0.0)
        table.add_row(kind, str(len(own)), str(wrong), f"{worst:.1e} of the tolerance")
    console.print(table)
    failed = [one for one in outcomes if not one.passed]
    for one in failed:
        console.print(one)
    return not failed


def of_library(name: str) -> list[Outcome]:
    """Return the outcomes of a library problem by every method for linear dynamics; none if it has others."""
    problem = lfo.library.PROBLEMS[name]()
    if problem.mode_names or not isinstance(problem.dynamics, lfo.LinearDynamics | lfo.FrequencyResponse):
        return []
    found = list[Outcome]()
    for method in METHODS:
        try:
            found.append(judged_alone(problem, method, "library"))
        except lfo.errors.UnsupportedError:  # the method is not for this problem
            continue
    return found
