"""Time of a node of our search over modes, and how much each acceleration gains.

Called by modes.py. Figures are seconds of the process.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from rich.table import Table

import lin_freq_ocp as lfo
from lin_freq_ocp.certificate.hybrid.tree import tree_bound
from lin_freq_ocp.methods.hybrid.search import branch_and_bound
from lin_freq_ocp.methods.hybrid.search.branch_and_bound import TreeSearch
from lin_freq_ocp.methods.hybrid.search.common import TOLERANCES, SearchLimits, solve_relaxation
from lin_freq_ocp.methods.hybrid.search.node import NodeSolution
from lin_freq_ocp.problem.hybrid.forms import piecewise_affine
from lin_freq_ocp.problem.hybrid.mode_reach import Reach
from lin_freq_ocp.program.hybrid.path_relaxation import PathRelaxation
from lin_freq_ocp.program.hybrid.relaxation import ModeRelaxation

Build = Callable[[], lfo.OptimalControlProblem]


def part_seconds(work: Callable[[], object], times: int = 20) -> float:
    """Return seconds of the process that a call takes."""
    started = time.process_time()
    for _ in range(times):
        work()
    return (time.process_time() - started) / times


def nodes(cases: Mapping[str, Build], count: int = 200) -> Table:
    """Return the time of a node in a search of so many nodes, with the check of its tree, and its parts at the root."""
    parts = "reach of 8, each", "set-up", "compiled", "by Clarabel", "bound of its duals"
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
        duals = solve_relaxation(relaxation, root, compiled=True).duals
        assert duals is not None
        set_up, bound, *solves = (
            part_seconds(work)
            for work in (
                partial(relaxation.path_member, root),
                partial(relaxation.proven, root, duals),
                partial(solve_relaxation, relaxation, root, TOLERANCES, compiled=True),
                partial(solve_relaxation, relaxation, root, TOLERANCES),
            )
        )
        reach = part_seconds(partial(relaxation.reach.after, root, 0, [root.allowed[0]] * 8)) / 8
        alone = (solve - set_up for solve in solves)
        seconds = ((ended - started) / solved, (ended - searched) / solved, reach, set_up, *alone, bound)
        table.add_row(name, *(f"{1e3 * part:.2f}" for part in seconds), f"{outcome.nodes}")
    return table


def by_clarabel(
    relaxation: ModeRelaxation, reach: Reach, tolerances: tuple[float, ...], end: float, cutoff: float, _compiled: bool
) -> NodeSolution:
    """Solve a relaxation as if there were no compiled code."""
    return solve_relaxation(relaxation, reach, tolerances, end, cutoff)


def to_the_end(
    relaxation: ModeRelaxation, reach: Reach, tolerances: tuple[float, ...], end: float, _cutoff: float, compiled: bool
) -> NodeSolution:
    """Solve a relaxation as if the cutoff decided nothing."""
    return solve_relaxation(relaxation, reach, tolerances, end, None, compiled)


class WithoutImages(PathRelaxation):
    """Edges whose images may leave the box of the mode that follows."""

    images = False


VARIANTS: dict[str, tuple[type[ModeRelaxation], dict[str, object]]] = {
    "all": (PathRelaxation, {}),
    "shares of modes instead of paths": (ModeRelaxation, {}),
    "images not bounded": (WithoutImages, {}),
    "by Clarabel": (PathRelaxation, {"relaxed": by_clarabel}),
    "solved to the end": (PathRelaxation, {"relaxed": to_the_end}),
}
"""Our search without one acceleration each: the relaxation, and the change in ``branch_and_bound``."""


def layers(cases: Mapping[str, Build], limit: float, gap: float, times: int = 3) -> Table:
    """Return the least seconds of the process, and relaxations, of our search and without each of its means."""
    least = dict[tuple[str, str], tuple[float, int]]()
    for _ in range(times):
        for variant, (relaxation, changed) in VARIANTS.items():
            before = {name: getattr(branch_and_bound, name) for name in changed}
            for name, value in changed.items():
                setattr(branch_and_bound, name, value)
            for case, build in cases.items():
                started = time.process_time()
                outcome = TreeSearch(build(), SearchLimits(gap, limit), relaxation=relaxation).run()
                found = time.process_time() - started, outcome.nodes
                least[variant, case] = min(least.get((variant, case), found), found)
            for name, value in before.items():
                setattr(branch_and_bound, name, value)
    table = Table("seconds, relaxations", *cases)
    for variant in VARIANTS:
        cells = (least[variant, case] for case in cases)
        table.add_row(variant, *(f"{seconds:.2f}, {nodes}" for seconds, nodes in cells))
    return table
