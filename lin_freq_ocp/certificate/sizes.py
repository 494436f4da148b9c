"""Sizes of the components of a trajectory, and the scales that residuals, gaps and slopes are compared with.

Sizes come from the trajectory, from fixed ends, references, offsets and levels, never from bounds: a bound may stand
for none.
They change with the units of the components and with nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.certificate.hamiltonian import Extremal
from lin_freq_ocp.certificate.tolerances import (
    CONDITION_TOLERANCE,
    DATA_ROUNDING,
    GAP_TOLERANCE,
    HESSIAN_ROUNDING,
    INSIGNIFICANT_GAIN,
    SCALE_FLOOR,
    STATE_ROUNDING,
    ZERO_COMPONENT,
)
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory


def trajectory_sizes(problem: OptimalControlProblem, trajectory: Trajectory) -> tuple[Array, Array]:
    """Return sizes of states, (n,), and controls, (m,), all above zero.

    A component is as large as its largest value, its fixed ends, references, offsets and levels. A component without
    data of its own that stays near zero is as large as what changes the others by their own sizes within the horizon (a
    state, no larger than what the others make of it in a step), else as what changes the cost by its whole value. 1
    where the trajectory is zero and there are no data.
    """
    n = problem.state_dim
    A, B, offset = problem.dynamics.gains_along(trajectory.x, trajectory.u)
    own = _own_sizes(problem, offset)
    known = np.maximum(own, np.concatenate([np.abs(signal).max(0) for signal in (trajectory.x, trajectory.u)]))
    known = np.where(known > ZERO_COMPONENT, known, 0.0)
    gain = np.hstack([A, B])
    gain = np.where(gain > INSIGNIFICANT_GAIN * gain.max(axis=1, keepdims=True), gain, 0.0)
    anchored = (own > 0) | _has_slope(problem)
    needed = _anchoring_sizes(problem.horizon * gain, known, anchored)
    sizes = np.maximum(known, needed)
    caused = gain @ sizes
    most = np.where(caused > 0, caused, needed[:n])
    most = np.where(anchored[:n], gain[:, n:] @ sizes[n:], most)  # what A makes of large values is no move
    sizes[:n] = np.maximum(known[:n], np.minimum(np.where(needed[:n] > 0, sizes[:n], np.inf), most))
    alone = ~anchored & (needed == 0)
    if alone.any():
        sizes = np.where(alone, np.maximum(sizes, _sizes_by_cost(problem, trajectory)), sizes)
    sizes = np.where(sizes > 0, sizes, 1.0)
    return sizes[:n], sizes[n:]


def _sizes_by_cost(problem: OptimalControlProblem, trajectory: Trajectory) -> Array:
    """Return what a component must be to cost what all terms of the cost add up to, 0 if it costs nothing."""
    cost = problem.quadratic
    curvature = np.concatenate(
        [np.diagonal(part, axis1=-2, axis2=-1).reshape(-1, part.shape[-1]).max(0) for part in (cost.Q, cost.R)]
    )
    total = _sum_of_terms(problem, trajectory) / problem.horizon
    return np.sqrt(np.divide(total, curvature, out=np.zeros(len(curvature)), where=curvature > 0))


def _anchoring_sizes(effect: Array, known: Array, anchored: Mask) -> Array:
    """Return what a component must be to change those that are anchored in data by their sizes, 0 where it cannot.

    effect : (n, n + m), the change of states within the horizon per unit of a component. Components that act on
    anchored components are anchors of others in turn.
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


def cost_scale(
    problem: OptimalControlProblem, trajectory: Trajectory, sizes: tuple[Array, Array] | None = None
) -> float:
    """Return S, the sum of the absolute values of the terms of the cost: what gaps are relative to.

    The quadratic part is a single term at each time, as are every linear term and every penalty. S is at least the cost
    of deviations of DATA_ROUNDING over GAP_TOLERANCE: squares from the references, all else from the trajectory. A
    control with levels moves by whole levels: of what these cost, DATA_ROUNDING counts. S is at least HESSIAN_ROUNDING
    of products of entries and deviations, over the same: what cancels is known no better. ``sizes`` are those of the
    trajectory, if known.
    """
    x, u = trajectory.x, trajectory.u
    pairs = zip((x, u), sizes or trajectory_sizes(problem, trajectory), strict=True)
    in_x, in_u = (np.broadcast_to(DATA_ROUNDING * size, signal.shape) for signal, size in pairs)
    magnitudes, levels = problem.quadratic.magnitudes(), problem.dynamics.level_sizes
    deviations = (np.abs(part) for part in problem.quadratic.deviations(x, u))
    rounding = magnitudes.value(in_x, in_u) + HESSIAN_ROUNDING * magnitudes.value(*deviations)
    if levels.any():
        rounding += DATA_ROUNDING * magnitudes.value(np.zeros_like(x), np.broadcast_to(levels, u.shape))
    for term in problem.terms:
        for sign in (-1, 1):
            rounding += float(np.abs(term.cost(x + sign * in_x, u + sign * in_u) - term.cost(x, u)).sum())
    return max(_sum_of_terms(problem, trajectory), rounding / GAP_TOLERANCE)


def _sum_of_terms(problem: OptimalControlProblem, trajectory: Trajectory) -> float:
    """Return the sum of the absolute values of the terms of the cost."""
    x, u = trajectory.x, trajectory.u
    parts = problem.cost.formula_values(x, u), *(term.cost(x, u) for term in problem.terms)
    return problem.quadratic.sum_of_terms(x, u) + sum(float(np.abs(part).sum()) for part in parts)


def _own_sizes(problem: OptimalControlProblem, offset: Array) -> Array:
    """Return how large fixed ends, references, offsets and levels say that states and controls are, (n + m,)."""
    n, cost = problem.state_dim, problem.quadratic
    x = np.maximum(offset, np.abs(cost.x_ref).reshape(-1, n).max(0))
    for end in (problem.initial_box, problem.terminal_box):
        x = np.maximum(x, np.where(end.fixed, np.abs(end.lower), 0.0))
    u = np.abs(cost.u_ref).reshape(-1, problem.control_dim).max(0)
    return np.append(x, np.maximum(u, problem.dynamics.level_sizes))


def _has_slope(problem: OptimalControlProblem) -> Mask:
    """Return which states and controls the quadratic cost has a linear term in, (n + m,)."""
    n, m, cost = problem.state_dim, problem.control_dim, problem.quadratic
    in_x = np.abs(cost.q).reshape(-1, n).max(0) + np.abs(cost.p)
    return np.append(in_x, np.abs(cost.r).reshape(-1, m).max(0)) > 0


@dataclass(frozen=True, eq=False)
class Floors:
    """The least scale of every kind of quantity: SCALE_FLOOR of its natural size.

    x (n,) and u (m,) are those of states and controls, x at least the rounding of states that do not move, over the
    tolerance; ``rounding`` (n,) is that of states that move, of what A makes of them, and of the coordinates they are
    given in. in_x (n,) and in_u (m,) of multipliers in the adjoint equation
    and in D_u H, and terms (dim,) of the values of each term. ``level`` is what multipliers times signals are compared
    with: S, but at least SCALE_FLOOR of what a stage costs with states and controls of their natural sizes; for
    eta_C = 0, which has no unit of cost, SCALE_FLOOR of the largest terms of the Hamiltonian.
    """

    x: Array
    u: Array
    level: float
    in_x: Array
    in_u: Array
    terms: tuple[Array, ...]
    rounding: Array


def floors(
    extremal: Extremal, sizes: tuple[Array, Array] | None = None, cost: float | None = None, origin: Array | None = None
) -> Floors:
    """Return the least scales along a trajectory whose components have these sizes, (n,) and (m,), and whose S is cost.

    ``origin`` (n,) is where the states count from. The default are those of the extremal's own problem; of a problem
    with modes, the extremal knows the average only.
    """
    problem, T = extremal.problem, extremal.problem.horizon
    x, u = trajectory_sizes(problem, extremal.trajectory) if sizes is None else sizes
    steady = np.ones((T + 1, 1)) * x, np.ones((T, 1)) * u
    terms = tuple(SCALE_FLOOR * priced.term.map.sizes(*steady).max(0, initial=0.0) for priced in extremal.terms)
    if extremal.multipliers.eta_C == 0:  # any multiple of abnormal multipliers is as good
        before = np.abs(extremal.eta_before) + extremal.in_x_terms
        level = stage = SCALE_FLOOR * float(max((before @ x).max(), (extremal.in_u_terms @ u).max()))
    else:
        in_x, in_u = problem.quadratic.gradient_magnitudes(*steady)
        priced = [term.cost(*steady).max(initial=0.0) for term in problem.terms if term.kind.is_cost]
        stage = SCALE_FLOOR * float(max((in_x @ x).max(), (in_u @ u).max(), *priced))
        level = max(cost_scale(problem, extremal.trajectory) if cost is None else cost, stage)
    # of states, in the coordinates that they are given in: what it makes of the state equations
    start = problem.origin if origin is None else origin
    given = np.abs(extremal.trajectory.x) + (0.0 if start is None else np.abs(start))
    moved = problem.equations.successor_sizes(given, extremal.trajectory.u)
    rounding = STATE_ROUNDING * (given.max(0) + moved.max(0))
    resting = np.abs(extremal.trajectory.x).max(0) <= rounding
    least = np.maximum(SCALE_FLOOR * x, np.where(resting, rounding / CONDITION_TOLERANCE, 0.0))
    rounding = np.where(resting, 0.0, rounding)
    return Floors(least, SCALE_FLOOR * u, level, stage / x, stage / u, terms, rounding)
