"""Problems with states added to their own: the memory of a constraint becomes a state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, with_columns, with_rows
from lin_freq_ocp.problem.costs.quadratic import Cost, CostSum, QuadraticCost
from lin_freq_ocp.problem.dynamics.base import Dynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet, Intersection
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.base import entries_of
from lin_freq_ocp.problem.terms.stage_rows import StageRows


@dataclass(frozen=True, eq=False)
class AddedStates:
    """States w of w_{t+1} = A w_t + B u_t, without cost."""

    A: Array  # (k, k)
    B: Array  # (k, m)
    initial: Box  # of w_0, bounds (k,)
    lower: Array  # (k,), of w_t at all times
    names: Sequence[str]


def extended(problem: OptimalControlProblem, added: AddedStates) -> OptimalControlProblem:
    """Return the problem in the states (x, w); its own constraints and cost are as they were."""
    dynamics = problem.dynamics.augmented(added.A, added.B, added.names, problem.horizon)
    return wider(problem, dynamics, added.initial, added.lower, _wider_cost(problem, len(added.A)))


def wider(
    problem: OptimalControlProblem, dynamics: Dynamics, initial: Box, lower: Array, cost: Cost
) -> OptimalControlProblem:
    """Return the problem in the states (x, w) of other dynamics, with w_0 in a box and w_t >= lower, (k,)."""
    k = len(lower)
    free = np.full(k, np.inf)
    return replace(
        problem,
        dynamics=dynamics,
        cost=cost,
        state_set=_wider_state_set(problem, lower),
        initial_state=_with_box(problem.initial_state, problem.initial_box, initial),
        terminal_state=_with_box(problem.terminal_state, problem.terminal_box, Box(-free, free)),
        state_spectrum=[
            more for one in entries_of(problem.state_spectrum) for more in one.extended(problem.state_dim, k)
        ]
        or None,
        stage_rows=[
            StageRows(with_columns(rows.C, k), rows.D, rows.e, rows.name, rows.penalty) for rows in problem.stage_rows
        ],
        output_spectrum=[one.extended(problem.state_dim, k) for one in entries_of(problem.output_spectrum)] or None,
    )


def _wider_cost(problem: OptimalControlProblem, k: int) -> CostSum:
    cost, n = problem.quadratic, problem.state_dim
    wider = QuadraticCost(
        Q=with_rows(with_columns(cost.Q, k), np.zeros((k, n + k))),
        R=cost.R,
        S=with_rows(cost.S, np.zeros((k, problem.control_dim))),
        q=with_columns(cost.q, k),
        r=cost.r,
        P=with_rows(with_columns(cost.P, k), np.zeros((k, n + k))),
        p=with_columns(cost.p, k),
        x_ref=with_columns(cost.x_ref, k),
        u_ref=cost.u_ref,
    )
    return CostSum([wider, *(one.extended(n, k) for one in problem.cost.norms)])


def _wider_state_set(problem: OptimalControlProblem, lower: Array) -> ConvexSet | list[ConvexSet]:
    given, boxes, upper = problem.state_set, problem.state_boxes, np.full(len(lower), np.inf)
    if given is not None and not isinstance(given, ConvexSet):
        return [_with_box(one, boxes.at(t), Box(lower, upper)) for t, one in enumerate(given)]
    shape = problem.horizon + 1, len(lower)
    return _with_box(given, boxes, Box(np.broadcast_to(lower, shape), np.broadcast_to(upper, shape)))


def _with_box(given: ConvexSet | None, bounds: Box, added: Box) -> ConvexSet:
    """Return the set of (x, w) with x in the given set, whose bounds these are, and w within the added ones."""
    box = Box(np.hstack([bounds.lower, added.lower]), np.hstack([bounds.upper, added.upper]))
    n, k = bounds.lower.shape[-1], added.lower.shape[-1]
    members = () if given is None else given.members
    return Intersection([box, *(one.extended(n, k) for one in members)]) if members else box
