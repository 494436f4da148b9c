"""A trajectory strictly inside all inequalities, at hardly any cost: near the optimum, on the way to an interior one.

The optimum z* is on its limits, and misses them by rounding. With z' optimal for limits that are tighter by a share of
their sizes, (1 - s) z* + s z' satisfies the same equations and is strictly inside for any s > 0; its cost, which is
convex, is above the optimal one by s (J(z') - J(z*)) at most. A few roundings are enough for s.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.certificate.sizes import trajectory_sizes
from lin_freq_ocp.explanation.blocks import Block, relaxed, with_bounds
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.terms.term import TermKind
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.proof.point.room import least_room
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solve import solve_judged

SHARES = (1e-3, 1e-5, 1e-7, 1e-9)  # of the sizes, by which limits are tightened; the first that leaves a solution
MOST = 0.25  # of the width of bounds, by which each may be moved


def tightened(problem: OptimalControlProblem, share: float, sizes: tuple[Array, Array]) -> OptimalControlProblem:
    """Return the problem with hard inequalities tighter by a share of the sizes (n,), (m,)."""
    amounts = share * sizes[0], share * sizes[1]
    for field, bounds, amount in (
        ("state_set", problem.state_boxes, amounts[0]),
        ("control_set", problem.control_tube, amounts[1]),
        ("initial_state", problem.initial_box, amounts[0]),
        ("terminal_state", problem.terminal_box, amounts[0]),
    ):
        if np.isfinite(bounds.lower).any() or np.isfinite(bounds.upper).any():
            problem = replace(problem, **{field: with_bounds(getattr(problem, field), _smaller(bounds, amount))})
    rows = [_tighter(one, share, sizes) for one in problem.stage_rows]
    problem = replace(problem, stage_rows=rows) if rows else problem
    for block, amount in _limits(problem, share, sizes):
        problem = relaxed(problem, block, -amount)
    return problem


def _smaller(box: Box, amount: Array) -> Box:
    """Return a box with bounds that are tighter, but where they are equal."""
    with np.errstate(invalid="ignore"):
        moved = np.minimum(amount, MOST * (box.upper - box.lower))
    return Box(box.lower + moved, box.upper - moved)


def _tighter(rows: StageRows, share: float, sizes: tuple[Array, Array]) -> StageRows:
    """Return hard rows with lower limits, but for two that make an equation."""
    if rows.penalty is not None:
        return rows
    amounts = np.broadcast_to(share * rows.sizes(*sizes), rows.e.shape).copy()
    for i, j in permutations(range(rows.rows), 2):
        opposite = (rows.C[..., i, :] == -rows.C[..., j, :]).all() and (rows.D[..., i, :] == -rows.D[..., j, :]).all()
        if opposite:
            width = rows.e[..., i] + rows.e[..., j]
            amounts[..., i] = np.minimum(amounts[..., i], MOST * np.maximum(width, 0.0))
    return StageRows(rows.C, rows.D, rows.e - amounts, rows.name)


def _limits(problem: OptimalControlProblem, share: float, sizes: tuple[Array, Array]) -> Iterator[tuple[Block, float]]:
    """Yield each entry of a field with hard limits beyond bounds and rows, and by how much they are to be lower."""
    steady = np.tile(sizes[0], (problem.horizon + 1, 1)), np.tile(sizes[1], (problem.horizon, 1))
    found: dict[tuple[str, int], float] = {}
    for term in problem.terms:
        if not term.hard or term.source is None or term.kind in (TermKind.STAGE_ROWS, TermKind.LINKED_ENDS):
            continue
        lower, upper = term.penalty.hard_bounds(term.shape)
        least = float(np.min(upper - lower))
        amount = min(share * float(term.map.sizes(*steady).max()), MOST * least) / term.per_limit
        found[term.source] = min(found.get(term.source, np.inf), amount)
    for (field, index), amount in found.items():
        if amount > 0:
            yield Block("term", field, index, field), amount


def interior(outcome: Outcome, problem: OptimalControlProblem, at: Trajectory) -> Trajectory | None:
    """Return a trajectory with room to all inequalities, by the method of the outcome; None if none was found."""
    sizes = trajectory_sizes(problem, at)
    for share in SHARES:
        found = solve_judged(tightened(problem, share, sizes), outcome.method, backend=outcome.backend or "auto")
        if found.trajectory is not None and least_room(problem, found.trajectory) > 0:
            return found.trajectory
    return None
