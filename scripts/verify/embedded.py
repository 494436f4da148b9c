"""Generated controllers in C: disturbed steps of ten plants, in double and in float, against the sparse program.

Part of scripts/verify.py. Every plan in double must cost what the sparse program's answer costs, and every logged step
must be proven by lfo.certify_log.
"""

from __future__ import annotations

import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from benchmark.embedded_cases import PENALTY, PLANTS, disturbed_states
from rich.console import Console
from rich.table import Table

import lin_freq_ocp as lfo
from helpers.generated import CompiledController, write_log
from lin_freq_ocp.loop.embedded import step_problem
from verify.seeded import check_all

STEPS = 100
"""Of a loop."""

COST = 1e-8
"""Difference of costs, relative, beyond the gap that the judge leaves to the sparse program."""

APART = {"double": 1e-6, "float": 5e-3}  # of a control from that of the proven plan, relative to its bound
APART_CONVEX = 1e-4  # of a control in double from that of the sparse program, whose accuracy this is


@dataclass(frozen=True)
class Findings:
    """The results of one loop: steps by status, and the largest differences."""

    plant: str
    planned: int
    softened: int
    others: int
    unproven: int
    cost: float
    convex: float
    double: float
    float: float

    @property
    def passed(self) -> bool:
        """Whether all steps agree and are proven."""
        apart = self.double <= APART["double"] and self.float <= APART["float"] and self.convex <= APART_CONVEX
        return apart and self.cost <= COST and not self.unproven


def check(seed: int) -> Findings:
    """Run the loop of a seed."""
    warnings.simplefilter("ignore", lfo.errors.ClosedLoopWarning)
    name = list(PLANTS)[seed % len(PLANTS)]
    case = PLANTS[name]()
    problem, stated = case.problem, step_problem(case.problem, {"state_set": PENALTY} if case.hard else {})
    sizes = problem.state_dim, problem.control_dim, problem.horizon
    with tempfile.TemporaryDirectory() as folder:
        compiled = dict[str, CompiledController]()
        for real in APART:
            lfo.generate(case.controller, Path(folder) / real, real)
            compiled[real] = CompiledController(Path(folder) / real, real, *sizes)
        plans = list[tuple[np.ndarray, np.ndarray]]()

        def step(x: np.ndarray) -> np.ndarray:
            u = compiled["double"].step(x[:measured])[1]
            plans.append(compiled["double"].plan())
            return u

        measured = compiled["double"].measured  # states that follow from the controls come last
        states = disturbed_states(case, step, STEPS, seed)
        unproven, apart, exact = 0, dict[str, float](), list[int]()
        for real, one in compiled.items():
            one.begin()
            answers = [one.step(x[:measured]) for x in states]
            statuses = [status for status, _ in answers]
            log = write_log(Path(folder) / "log.csv", states[:, :measured], np.array([u for _, u in answers]), statuses)
            certified = lfo.certify_log(case.controller, log, APART[real])
            unproven += sum(str(finding) not in ("proven", "infeasible, proven") for finding in certified.findings)
            apart[real] = float(certified.differences[np.array(statuses) <= 1].max(initial=0.0))
            exact = exact or statuses
    limit, cost, convex = np.abs(problem.control_tube.bounds).max(axis=(0, 1)), 0.0, 0.0
    for x, status, plan in zip(states, exact, plans, strict=True):
        best = lfo.solve(stated.with_ends(x), "convex", throw=False)
        if status > 1 or best.control is None or best.cost is None:
            continue
        scale = max(abs(best.cost), 1e-12)
        cost = max(cost, abs(stated.value(*plan) - best.cost) / scale - abs(best.gap or 0.0))
        convex = max(convex, float((np.abs(plan[1][0] - best.control[0]) / limit).max()))
    counts = exact.count(0), exact.count(1), len(exact) - exact.count(0) - exact.count(1)
    return Findings(name, *counts, unproven, cost, convex, apart["double"], apart["float"])


def verify(console: Console, steps: range, processes: int) -> bool:
    """Run loops of so many steps in all, and print the results; return whether all passed."""
    loops = -(-len(steps) // STEPS)
    found = check_all(check, range(steps.start, steps.start + loops), processes, "generated controllers")
    table = Table("plant", "loops", "planned", "softened", "others", "not proven", title="generated controllers in C")
    for column in ("cost, convex", "control, convex", "proven plan, double", "float", "failed"):
        table.add_column(column, justify="right")
    for name in [*dict.fromkeys(one.plant for one in found), "all"]:
        some = [one for one in found if name in (one.plant, "all")]
        counts = [sum(getattr(one, part) for one in some) for part in ("planned", "softened", "others", "unproven")]
        worst = [max(getattr(one, part) for one in some) for part in ("cost", "convex", "double", "float")]
        failed = sum(not one.passed for one in some)
        table.add_row(name, str(len(some)), *map(str, counts), *(f"{value:.1e}" for value in worst), str(failed))
    console.print(table)
    return all(one.passed for one in found)
