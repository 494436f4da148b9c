"""All reachable mode sequences, solved one by one: an oracle for short horizons."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.hybrid.search.common import (
    SearchLimits,
    SearchOutcome,
    SearchProgress,
    one_mode_each,
    solve_relaxation,
    tree_with_proofs,
)
from lin_freq_ocp.problem.hybrid.mode_tree import ModeNode
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.program.hybrid.relaxation import ModeRelaxation
from lin_freq_ocp.program.hybrid.rows import Duals
from lin_freq_ocp.transform.hybrid.forms import piecewise_affine
from lin_freq_ocp.transform.hybrid.mode_reach import Reach

MOST_SEQUENCES = 10_000  # solved within minutes


def enumerate_sequences(
    problem: OptimalControlProblem, limits: SearchLimits, progress: Callable[[SearchProgress], None] | None = None
) -> SearchOutcome:
    """Solve every sequence in the forward reach.

    Raises
    ------
    UnsupportedError
        If there are more than MOST_SEQUENCES, or a signal has no bounds where several modes are possible.
    """
    started, relaxation = now(), ModeRelaxation(problem, limits.level)
    end = started + limits.search_seconds
    everything = np.ones((problem.horizon, len(piecewise_affine(problem).modes)), dtype=bool)
    root = relaxation.reach.from_start(everything)
    if root is not None:
        relaxation.require_bounds(root)
    nodes = [ModeNode(-1, -1, everything, np.inf if root is None else -np.inf, None)]
    unsplit: list[tuple[int, Reach]] = [] if root is None else [(0, root)]
    leaves: list[tuple[int, Reach]] = []
    while unsplit and now() <= end:  # a tree that splits every time in order
        parent, reach = unsplit.pop()
        several = reach.allowed.sum(axis=1) > 1
        if not several.any():
            leaves.append((parent, reach))
            continue
        t = int(np.argmax(several))
        masks = one_mode_each(reach.allowed, t)
        children = relaxation.reach.after(reach, t, [mask[t] for mask in masks])
        for allowed, child in zip(masks, children, strict=True):
            bound = np.inf if child is None else -np.inf
            nodes.append(ModeNode(parent, t, allowed if child is None else child.allowed, bound, None))
            if child is not None:
                unsplit.append((len(nodes) - 1, child))
        if len(unsplit) + len(leaves) > MOST_SEQUENCES:
            text = (
                f"method: 'enumerate' has more than {MOST_SEQUENCES} sequences to solve here; use 'branch_and_bound'."
            )
            raise UnsupportedError(text)
    if unsplit:  # too late: the root alone covers all sequences
        nodes, leaves = nodes[:1], []
    duals: list[Duals | None] = [None] * len(nodes)
    setup = now() - started
    best, cost, interrupted, solved = None, np.inf, False, 0
    message = limits.reached(setup, solved)
    try:
        for index, reach in leaves:
            seconds = now() - started
            message = limits.reached(seconds, solved)
            if message:
                break
            if progress is not None:
                progress(SearchProgress(cost, -np.inf, solved, len(leaves) - solved, seconds))
            answer, solved = solve_relaxation(relaxation, reach, end=end), solved + 1
            nodes[index] = replace(nodes[index], bound=answer.bound)
            duals[index] = answer.duals
            if answer.trajectory is not None and answer.bound < cost:
                best, cost = answer.sequence, answer.bound
    except KeyboardInterrupt:
        message, interrupted = "interrupted", True
    return SearchOutcome(best, cost, tree_with_proofs(relaxation, nodes, duals), message, interrupted, solved, setup)
