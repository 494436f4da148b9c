"""Branch and bound whose sub-trees are searched by the workers of any executor of ``concurrent.futures``.

The first nodes are searched here, until PARTS are open; each is then a search of its own, which begins with the best
sequence known, and its tree replaces its root. The tree does not depend on the number or order of the workers. If a
worker is lost, its part is searched here.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import BrokenExecutor, CancelledError, Executor, as_completed
from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.arrays import Indices
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.methods.hybrid.search.branch_and_bound import TreeSearch
from lin_freq_ocp.methods.hybrid.search.common import SearchLimits, SearchOutcome, SearchProgress
from lin_freq_ocp.problem.hybrid.mode_tree import ModeNode, ModeTree
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.transform.hybrid.mode_reach import Reach

LOST = (BrokenExecutor, CancelledError, ConnectionError)  # raised by a future whose worker died or was cut off
PARTS = 32  # enough to keep a few workers busy to the end; not more, as parts do not share better sequences


def search_in_parts(
    problem: OptimalControlProblem,
    limits: SearchLimits,
    executor: Executor,
    progress: Callable[[SearchProgress], None] | None = None,
    start: Indices | None = None,
) -> SearchOutcome:
    """Search with the workers of an executor; as ``BranchAndBound.run``."""
    started = now()
    first = TreeSearch(problem, limits, progress=progress)
    outcome = first.run(start, until_open=PARTS)
    if outcome.message or not first.open_nodes:
        return outcome
    left = replace(limits, seconds=limits.seconds - (now() - started))
    futures = {
        executor.submit(search_part, problem, reach, outcome.sequence, left): (root, reach)
        for root, reach in first.open_nodes
    }
    outcomes: dict[int, SearchOutcome] = {}
    message, interrupted = "", False
    try:
        for future in as_completed(futures):
            root, reach = futures[future]
            try:
                outcomes[root] = future.result()
            except LOST:
                outcomes[root] = search_part(problem, reach, outcome.sequence, left)
            if progress is not None:
                cost = min(outcome.cost, *(part.cost for part in outcomes.values()))
                bound = min((node.bound for node in outcome.tree.nodes if node.proof is not None), default=-np.inf)
                solved = outcome.nodes + sum(part.nodes for part in outcomes.values())
                seconds = now() - started
                progress(SearchProgress(cost, min(bound, cost), solved, len(futures) - len(outcomes), seconds))
    except KeyboardInterrupt:
        message, interrupted = "interrupted", True
        for future in futures:
            future.cancel()
    # the first tree, with the trees of the parts instead of their roots, in the order of the roots
    nodes: list[ModeNode] = list(outcome.tree.nodes)
    best = outcome
    for root in sorted(outcomes):
        part = outcomes[root]
        part_nodes, shift = part.tree.nodes, len(nodes) - 1
        nodes[root] = replace(
            nodes[root], proof=part_nodes[0].proof or (nodes[root].proof if len(part_nodes) == 1 else None)
        )
        nodes += [replace(node, parent=root if node.parent == 0 else node.parent + shift) for node in part_nodes[1:]]
        best = part if part.cost < best.cost else best
        message = message or part.message
    solved = outcome.nodes + sum(part.nodes for part in outcomes.values())
    interrupted = interrupted or any(part.interrupted for part in outcomes.values())
    return SearchOutcome(best.sequence, best.cost, ModeTree(tuple(nodes)), message, interrupted, solved, outcome.setup)


def search_part(
    problem: OptimalControlProblem, reach: Reach, start: Indices | None, limits: SearchLimits
) -> SearchOutcome:
    """Search the sequences within a reach."""
    return TreeSearch(problem, limits).run(start, reach)
