"""Time of a node of our search over modes, and how much each acceleration gains.

Called by modes.py. Figures are seconds of the process.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from unittest.mock import patch

import numpy as np
from rich.table import Table

import lin_freq_ocp as lfo
from lin_freq_ocp.certificate.hybrid.tree import tree_bound
from lin_freq_ocp.methods.hybrid.search import branch_and_bound, node
from lin_freq_ocp.methods.hybrid.search.branch_and_bound import TreeSearch
from lin_freq_ocp.methods.hybrid.search.common import TOLERANCES, SearchLimits, solve_relaxation
from lin_freq_ocp.methods.hybrid.search.node import NodeSolution
from lin_freq_ocp.program.hybrid.path_relaxation import PathRelaxation
from lin_freq_ocp.program.hybrid.relaxation import ModeRelaxation
from lin_freq_ocp.transform.hybrid.forms import piecewise_affine
from lin_freq_ocp.transform.hybrid.mode_reach import Reach

Build = Callable[[], lfo.OptimalControlProblem]


def part_seconds(work: Callable[[], object], times: int = 20) -> float:
    """Return seconds of the process that a call takes."""
    started = time.process_time()
    for _ in range(times):
        work()
    return (time.process_time() - started) / times


def nodes(cases: Mapping[str, Build], count: int = 200) -> Table:
    """Return the time of a node in a search of so many nodes, with the check of its tree, and its parts at the root."""
    parts = "reach of 8, each", "set-up", "compiled", "shares by Clarabel", "bound of its duals"
    table = Table("milliseconds", "a node, everything in it", "of it the check", *parts, "relaxations")
    for name, build in cases.items():
        problem = build()
        started = time.process_time()
        outcome = TreeSearch(problem, SearchLimits(nodes=count)).run()
        searched = time.process_time()
        tree_bound(problem, outcome.tree)
        ended, solved = time.process_time(), max(outcome.nodes, 1)
        relaxation = PathRelaxation(problem)
        everything = np.ones((problem.horizon, len(piecewise_affine(problem).modes)), dtype=bool)
        root = relaxation.reach.from_start(everything)
        assert root is not None
        duals = solve_relaxation(relaxation, root).duals
        assert duals is not None
        solve = partial(solve_relaxation, relaxation, root, TOLERANCES)
        parts_of_node = partial(relaxation.path_member, root), partial(relaxation.proven, root, duals), solve
        set_up, bound, compiled = (part_seconds(work) for work in parts_of_node)
        with patch.object(node, "path_library", return_value=None):
            shares = part_seconds(solve)
        reach = part_seconds(partial(relaxation.reach.after, root, 0, [root.allowed[0]] * 8)) / 8
        of_node = (ended - started) / solved, (ended - searched) / solved
        seconds = (*of_node, reach, set_up, compiled - set_up, shares, bound)
        table.add_row(name, *(f"{1e3 * part:.2f}" for part in seconds), f"{outcome.nodes}")
    return table


def to_the_end() -> AbstractContextManager[object]:
    """Solve relaxations as if the cutoff decided nothing."""

    def solve(
        relaxation: ModeRelaxation, reach: Reach, tolerances: tuple[float, ...], end: float, _cutoff: float
    ) -> NodeSolution:
        return solve_relaxation(relaxation, reach, tolerances, end)

    return patch.object(branch_and_bound, "solve_relaxation", solve)


class WithoutImages(PathRelaxation):
    """Edges whose images may leave the box of the mode that follows."""

    images = False


VARIANTS: dict[str, tuple[type[ModeRelaxation], Callable[[], AbstractContextManager[object]]]] = {
    "all": (PathRelaxation, nullcontext),
    "shares of modes instead of paths": (ModeRelaxation, nullcontext),
    "images not bounded": (WithoutImages, nullcontext),
    "solved to the end": (PathRelaxation, to_the_end),
}
"""Our search without one acceleration each: the relaxation, and what else changes."""


def layers(cases: Mapping[str, Build], limit: float, gap: float, times: int = 3) -> Table:
    """Return the least seconds of the process, and relaxations, of our search and without each of its means."""
    least = dict[tuple[str, str], tuple[float, int]]()
    for _ in range(times):
        for variant, (relaxation, changed) in VARIANTS.items():
            for case, build in cases.items():
                problem, started = build(), time.process_time()
                with changed():
                    outcome = TreeSearch(problem, SearchLimits(gap, limit), relaxation=relaxation(problem)).run()
                found = time.process_time() - started, outcome.nodes
                least[variant, case] = min(least.get((variant, case), found), found)
    table = Table("seconds, relaxations", *cases)
    for variant in VARIANTS:
        cells = (least[variant, case] for case in cases)
        table.add_row(variant, *(f"{seconds:.2f}, {nodes}" for seconds, nodes in cells))
    return table
