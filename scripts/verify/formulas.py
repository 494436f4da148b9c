"""Random problems with smooth costs, time and path constraints by formulas, against IPOPT, and by differences.

Every accepted answer must be stationary by central differences of its cost (tests/helpers/checks/formula_costs.py), or
of its Lagrangian with path constraints (tests/helpers/checks/path_constraints.py), which every third problem has.
Answers of convex problems must have IPOPT's cost, with path constraints that of Clarabel on CVXPY's model, and a
rigorous bound. Of others, worse local optima than IPOPT's are counted and printed, and better ones.
"""

from __future__ import annotations

from itertools import islice
from typing import NamedTuple

import numpy as np
from benchmark.ipopt import solved_by_ipopt
from rich.console import Console
from rich.table import Table

import lin_freq_ocp as lfo
from helpers.checks import path_constraints
from helpers.checks.formula_costs import Checked, check, random_problem
from lin_freq_ocp.methods.hybrid.smooth.local_search import LocalSearch
from verify.seeded import check_all

SAME = 1e-6  # relative difference of costs


class Compared(NamedTuple):
    """An answer, and the cost of IPOPT's, not a number if it claims none."""

    ours: Checked | path_constraints.Checked
    other: float

    @property
    def difference(self) -> float:
        """Return our cost less IPOPT's, relative to S or so."""
        return (self.ours.cost - self.other) / max(1.0, abs(self.other))

    @property
    def passed(self) -> bool:
        """Whether ours is right, and a convex one as cheap as IPOPT's."""
        return self.ours.passed and not (self.ours.convex and abs(self.difference) > SAME)


def compare(seed: int) -> Compared:
    """Return our answer of a random problem, and IPOPT's from our first start: controls in the middle of their box."""
    problem = random_problem(seed)
    tube = problem.control_tube
    bounded = np.isfinite(tube.lower)
    middle = np.where(bounded, 0.5 * (np.where(bounded, tube.lower, 0.0) + np.where(bounded, tube.upper, 0.0)), 0.0)
    claim = solved_by_ipopt(problem, lfo.simulate(problem, middle))
    return Compared(check(seed), claim.cost if claim.status == "Solve_Succeeded" else float("nan"))


def compare_path(seed: int) -> Compared:
    """Return our answer of a random problem with a path constraint, and IPOPT's best from our first starts.

    Of a convex problem with a quadratic cost, the other answer is that of CVXPY's model.
    """
    random, ours = path_constraints.random_path(seed), path_constraints.check(seed)
    if random.convex and not random.data["smooth"]:
        return Compared(ours, path_constraints.cost_by_cvxpy(random))
    search = LocalSearch(random.problem)
    starts = [start for start, _ in islice(search.starts(), search.enough_starts)]
    claims = [solved_by_ipopt(random.problem, start) for start in starts]
    costs = [claim.cost for claim in claims if claim.status == "Solve_Succeeded"]
    return Compared(ours, min(costs, default=float("nan")))


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Compare the problems of these seeds and print a summary; return whether all are right."""
    costs, paths = [seed for seed in seeds if seed % 3 < 2], [seed // 3 for seed in seeds if seed % 3 == 2]
    groups = {
        "costs": check_all(compare, costs, processes, "comparing costs"),
        "path constraints": check_all(compare_path, paths, processes, "comparing path constraints"),
    }
    table = Table("formulas", "problems", title="random problems by formulas, against IPOPT")
    for heading in ("accepted", "same cost", "better", "worse", "slope left", "wrong"):
        table.add_column(heading, justify="right")
    kinds = [(group, name, name == "convex") for group in groups for name in ("convex", "others")]
    for group, name, convex in kinds:
        some = [one for one in groups[group] if one.ours.convex == convex]
        accepted = [one for one in some if one.ours.satisfied]
        table.add_row(
            f"{group}, {name}",
            str(len(some)),
            str(len(accepted)),
            str(sum(abs(one.difference) <= SAME for one in accepted)),
            str(sum(one.difference < -SAME for one in accepted)),
            str(sum(one.difference > SAME for one in accepted)),
            f"{max((one.ours.left for one in accepted), default=0.0):.1e}",
            str(sum(not one.passed for one in some)),
        )
    console.print(table)
    found = [one for group in groups.values() for one in group]
    active = sum(one.ours.active for one in groups["path constraints"])
    console.print(f"path constraints with a multiplier above zero: {active} of {len(paths)}")
    for one in found:
        if not one.passed or one.difference > SAME:
            console.print(one)
    return all(one.passed for one in found)
