"""What a node of our search over modes takes, and what the means that make the search fast are worth.

Called by benchmark_modes.py. Figures are seconds of the process.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np
from rich.table import Table

import lin_freq_ocp as lfo
from lin_freq_ocp.backends.clarabel_ import solve_form
from lin_freq_ocp.certificate.modes.bound import tree_bound
from lin_freq_ocp.methods.modes import branch_and_bound
from lin_freq_ocp.methods.modes.branch_and_bound import BranchAndBound
from lin_freq_ocp.methods.modes.search import TOLERANCES, SearchLimits, relaxed
from lin_freq_ocp.transcription.modes.relaxation import ModeRelaxation

Build = Callable[[], lfo.OptimalControlProblem]


def part_seconds(work: Callable[[], object], times: int = 20) -> str:
    """Return milliseconds of the process that a call takes."""
    started = time.process_time()
    for _ in range(times):
        work()
    return f"{1e3 * (time.process_time() - started) / times:.2f}"


def nodes(cases: Mapping[str, Build], count: int = 200) -> Table:
    """Return what a node takes: in a search of so many with the check of its tree, and the parts at the root."""
    parts = "reach of 8, each", "set-up", "relaxation", "bound of its duals"
    table = Table("milliseconds", "a node, everything in it", "of it the check", *parts, "relaxations")
    for name, build in cases.items():
        problem = build()
        started = time.process_time()
        outcome = BranchAndBound(problem, SearchLimits(nodes=count)).run()
        searched = time.process_time()
        tree_bound(problem, outcome.tree)
        ended, solved = time.process_time(), max(outcome.nodes, 1)
        relaxation = ModeRelaxation(problem)
        everything = np.ones((problem.horizon, len(problem.piecewise.modes)), dtype=bool)
        root = relaxation.reach.from_start(everything)
        assert root is not None
        answer, form = relaxed(relaxation, root), relaxation.member(root).form
        assert answer.duals is not None
        eight = [(root, 0, root.allowed[0])] * 8
        cells = (
            f"{float(part_seconds(lambda eight=eight, own=relaxation: own.reach.after(eight))) / 8:.2f}",
            part_seconds(lambda root=root, own=relaxation: own.member(root)),
            part_seconds(lambda form=form: solve_form(form, TOLERANCES[0], None)),
            part_seconds(lambda root=root, own=relaxation, duals=answer.duals: own.proven(root, duals)),
        )
        whole, check = (f"{1e3 * seconds / solved:.2f}" for seconds in (ended - started, ended - searched))
        table.add_row(name, whole, check, *cells, f"{outcome.nodes}")
    return table


class SolvedToTheEnd(ModeRelaxation):
    """Every relaxation is solved, as if duals on the way proved nothing."""

    @property
    def proves(self) -> bool:
        """Return False."""
        return False


def layers(cases: Mapping[str, Build], limit: float, gap: float) -> Table:
    """Return seconds of the process and relaxations of our search, and without each of its means."""
    variants: dict[str, tuple[type[ModeRelaxation], dict[str, int]]] = {
        "all": (ModeRelaxation, {}),
        "relaxations solved to the end": (SolvedToTheEnd, {}),
        "reaches each alone": (ModeRelaxation, {"SPLIT_TOGETHER": 1, "TRIED_TOGETHER": 1}),
        "rounded as often as at first": (ModeRelaxation, {"ROUNDING_SELDOM": branch_and_bound.ROUNDING_EVERY}),
    }
    table = Table("seconds, relaxations", *variants)
    for name, build in cases.items():
        cells = list[str]()
        for relaxation, constants in variants.values():
            before = {constant: getattr(branch_and_bound, constant) for constant in constants}
            for constant, value in constants.items():
                setattr(branch_and_bound, constant, value)
            started = time.process_time()
            outcome = BranchAndBound(build(), SearchLimits(gap, limit), relaxation=relaxation).run()
            cells.append(f"{time.process_time() - started:.2f}, {outcome.nodes}")
            for constant, value in before.items():
                setattr(branch_and_bound, constant, value)
        table.add_row(name, *cells)
    return table
