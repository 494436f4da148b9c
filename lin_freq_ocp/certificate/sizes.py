"""How large the components of a trajectory are: what residuals, floors and deviations are measured by.

Sizes come from the trajectory, from fixed ends, references and offsets, never from bounds: a bound may stand for none.
They change with the units of the components and with nothing else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.problem.dynamics.mode_arrays import ModeArrays

if TYPE_CHECKING:
    from lin_freq_ocp.problem.ocp import OptimalControlProblem
    from lin_freq_ocp.problem.trajectory import Trajectory

INSIGNIFICANT_GAIN = 1e-14
"""Entries of a row of [A, B] below this part of its largest one are rounding, as in a linearisation where a state is
zero up to rounding: no size follows from them."""

NOTHING = 1e-20
"""Components that are nowhere larger are zero, as bounds of 1e20 and more are none."""

GAP_TOLERANCE = 1e-6
"""Relative gap (J - D)/S up to which a feasible point is called globally optimal."""

DATA_ROUNDING = 1e-12
"""Deviations of states and controls, relative to their sizes, that solvers and printed data leave: where the cost is
zero up to what they cost, a gap of that much is none."""


def trajectory_sizes(problem: OptimalControlProblem, trajectory: Trajectory) -> tuple[Array, Array]:
    """Return sizes of states, (n,), and controls, (m,), all above zero.

    A component is as large as its largest value, its fixed ends, references and offsets. One that has no data of its
    own and stays near zero is as large as what changes the others by their own sizes within the horizon (a state, no
    larger than what the others make of it in a step), else as what changes the cost by all that it adds up to. 1 where
    the trajectory is zero and nothing else is said.
    """
    n = problem.state_dim
    A, B, offset = problem.dynamics.gains_along(trajectory.x, trajectory.u)
    own = _own_sizes(problem, offset)
    known = np.maximum(own, np.concatenate([np.abs(signal).max(0) for signal in (trajectory.x, trajectory.u)]))
    known = np.where(known > NOTHING, known, 0.0)
    gain = np.hstack([A, B])
    gain = np.where(gain > INSIGNIFICANT_GAIN * gain.max(axis=1, keepdims=True), gain, 0.0)
    anchored = (own > 0) | _has_slope(problem)
    needed = _needed(problem.horizon * gain, known, anchored)
    sizes = np.maximum(known, needed)
    caused = gain @ sizes
    most = np.where(caused > 0, caused, np.where(needed[:n] > 0, needed[:n], 0.0))
    sizes[:n] = np.maximum(known[:n], np.minimum(np.where(needed[:n] > 0, sizes[:n], np.inf), most))
    alone = ~anchored & (needed == 0)
    sizes = np.where(alone, np.maximum(sizes, _priced(problem, trajectory)), sizes)
    sizes = np.where(sizes > 0, sizes, 1.0)
    return sizes[:n], sizes[n:]


def _priced(problem: OptimalControlProblem, trajectory: Trajectory) -> Array:
    """Return what a component must be to cost what all terms of the cost add up to, 0 if it costs nothing."""
    cost = problem.quadratic
    curvature = np.concatenate(
        [np.diagonal(part, axis1=-2, axis2=-1).reshape(-1, part.shape[-1]).max(0) for part in (cost.Q, cost.R)]
    )
    total = _sum_of_terms(problem, trajectory) / problem.horizon
    return np.sqrt(np.divide(total, curvature, out=np.zeros(len(curvature)), where=curvature > 0))


def _needed(effect: Array, known: Array, anchored: Mask) -> Array:
    """Return what a component must be to change those that are anchored in data by their sizes, 0 where it cannot.

    effect : (n, n + m), the change of states within the horizon per unit of a component. Components that act on the
    anchored ones are anchors of others in turn.
    """
    n, reached, needed = len(effect), anchored.copy(), np.zeros(len(known))
    effect = np.where(np.eye(n, len(known), dtype=bool), 0.0, effect)
    for _ in known:
        useful = reached[:n, None] & (effect > 0) & ~reached
        sizes = np.maximum(known, needed)[:n, None]
        least = np.divide(sizes, effect, out=np.full(effect.shape, np.inf), where=useful).min(0)
        found = np.isfinite(least)
        needed = np.where(found, least, needed)
        reached = reached | found
        if not found.any():
            break
    return needed


def cost_scale(problem: OptimalControlProblem, trajectory: Trajectory) -> float:
    """Return S, what the terms of the cost add up to in absolute value: what gaps are relative to.

    Its quadratic part is one term at each time, every linear term and every penalty one of its own. At least what
    deviations of DATA_ROUNDING cost, over GAP_TOLERANCE.
    """
    return max(_sum_of_terms(problem, trajectory), _cost_of_rounding(problem, trajectory) / GAP_TOLERANCE)


def _sum_of_terms(problem: OptimalControlProblem, trajectory: Trajectory) -> float:
    """Return the sum of the absolute values of the terms of the cost."""
    cost, x, u = problem.quadratic, trajectory.x, trajectory.u
    linear = np.append((x[:-1] * cost.q).sum(1) + (u * cost.r).sum(1), x[-1] @ cost.p)
    total = float(np.abs(cost.stage_values(x, u) - linear).sum() + np.abs(x[-1] * cost.p).sum())
    total += float(np.abs(x[:-1] * cost.q).sum() + np.abs(u * cost.r).sum())
    return total + sum(float(np.abs(term.cost(x, u)).sum()) for term in problem.terms)


def _cost_of_rounding(problem: OptimalControlProblem, trajectory: Trajectory) -> float:
    """Return what deviations of DATA_ROUNDING cost: squares from the references, all else from the trajectory."""
    x, u = trajectory.x, trajectory.u
    moved = [
        np.broadcast_to(DATA_ROUNDING * size, signal.shape)
        for signal, size in zip((x, u), trajectory_sizes(problem, trajectory), strict=True)
    ]
    changes = [
        float(np.abs(term.cost(x + sign * moved[0], u + sign * moved[1]) - term.cost(x, u)).sum())
        for term in problem.terms
        for sign in (-1, 1)
    ]
    return problem.quadratic.magnitudes().value(*moved) + sum(changes)


def measured_modes(problem: OptimalControlProblem, trajectory: Trajectory) -> ModeArrays:
    """Return the modes of a problem at all times, which measure components by their sizes along a trajectory."""
    return problem.piecewise.arrays(problem.horizon).with_sizes(*trajectory_sizes(problem, trajectory))


def _own_sizes(problem: OptimalControlProblem, offset: Array) -> Array:
    """Return how large fixed ends, references and offsets say that states and controls are, (n + m,)."""
    n, cost = problem.state_dim, problem.quadratic
    x = np.maximum(offset, np.abs(cost.x_ref).reshape(-1, n).max(0))
    for end in (problem.initial_box, problem.terminal_box):
        x = np.maximum(x, np.where(end.fixed, np.abs(end.lower), 0.0))
    return np.append(x, np.abs(cost.u_ref).reshape(-1, problem.control_dim).max(0))


def _has_slope(problem: OptimalControlProblem) -> Mask:
    """Return which states and controls the quadratic cost has a linear term in, (n + m,)."""
    n, m, cost = problem.state_dim, problem.control_dim, problem.quadratic
    in_x = np.abs(cost.q).reshape(-1, n).max(0) + np.abs(cost.p)
    return np.append(in_x, np.abs(cost.r).reshape(-1, m).max(0)) > 0
