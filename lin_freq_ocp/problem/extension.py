"""Problems with further states beside their own: what a constraint must remember becomes a state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.problem.arrays import Array
from lin_freq_ocp.problem.costs import QuadraticCost
from lin_freq_ocp.problem.dynamics import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets import Box
from lin_freq_ocp.problem.spectrum import bands_of
from lin_freq_ocp.problem.stage_rows import StageRows


@dataclass(frozen=True, eq=False)
class FurtherStates:
    """States w of w_{t+1} = A w_t + B u_t, without cost.

    Attributes
    ----------
    A : (k, k), B : (k, m)
    initial : Box
        Of w_0, bounds (k,).
    lower : (k,)
        Of w_t, at all times.
    names : sequence of str
    """

    A: Array
    B: Array
    initial: Box
    lower: Array
    names: Sequence[str]


def extended(problem: OptimalControlProblem, further: FurtherStates) -> OptimalControlProblem:
    """Return the problem in the states (x, w); its own constraints and cost are as they were."""
    n, k, T, plant, cost = problem.state_dim, len(further.A), problem.horizon, problem.dynamics, problem.quadratic
    A = _below(_beside(plant.A, k), np.hstack([np.zeros((k, n)), further.A]))
    boxes, none = problem.state_boxes, np.full((T + 1, k), np.inf)
    free = np.full(k, np.inf)
    return replace(
        problem,
        dynamics=LinearDynamics(
            A,
            _below(plant.B, further.B),
            _beside(plant.offset, k),
            plant.sampling_time,
            [*plant.state_names, *further.names],
            plant.control_names,
        ),
        cost=QuadraticCost(
            Q=_below(_beside(cost.Q, k), np.zeros((k, n + k))),
            R=cost.R,
            S=_below(cost.S, np.zeros((k, problem.control_dim))),
            q=_beside(cost.q, k),
            r=cost.r,
            P=_below(_beside(cost.P, k), np.zeros((k, n + k))),
            p=_beside(cost.p, k),
            x_ref=_beside(cost.x_ref, k),
            u_ref=cost.u_ref,
        ),
        state_set=Box(
            np.hstack([boxes.lower, np.broadcast_to(further.lower, (T + 1, k))]), np.hstack([boxes.upper, none])
        ),
        initial_state=_joined(problem.initial_box, further.initial),
        terminal_state=_joined(problem.terminal_box, Box(-free, free)),
        state_spectrum=bands_of(problem.state_stop),
        stage_rows=[StageRows(_beside(rows.C, k), rows.D, rows.e, rows.name) for rows in problem.stage_rows],
    )


def _beside(array: Array, columns: int) -> Array:
    """Return the array with so many zeros more along its last axis."""
    return np.concatenate([array, np.zeros((*array.shape[:-1], columns))], axis=-1)


def _below(array: Array, rows: Array) -> Array:
    """Return the array, or each of one per time, with these rows below."""
    return np.concatenate([array, np.broadcast_to(rows, (*array.shape[:-2], *rows.shape))], axis=-2)


def _joined(first: Box, second: Box) -> Box:
    return Box(np.append(first.lower, second.lower), np.append(first.upper, second.upper))
