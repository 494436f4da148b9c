"""Sizes of the components of a trajectory, and the scales of residuals, gaps and slopes.

Sizes follow from the trajectory, fixed ends, references, offsets and levels. Bounds do not count: a large number may
stand for no bound. Sizes change with the units of the components and with nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask, largest_over_time, seal, split_signals, stack_signals
from lin_freq_ocp.certificate.hamiltonian import Extremal, cost_and_size
from lin_freq_ocp.certificate.tolerances import (
    CONDITION_TOLERANCE,
    COST_ROUNDING,
    DATA_ROUNDING,
    GAP_TOLERANCE,
    HESSIAN_ROUNDING,
    INSIGNIFICANT_GAIN,
    SCALE_FLOOR,
    STATE_ROUNDING,
    ZERO_COMPONENT,
)
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transform.simulation import reach_of_bounds

Sizes = tuple[Array, Array]  # of states (n,) and of controls (m,)


def trajectory_sizes(problem: OptimalControlProblem, trajectory: Trajectory) -> tuple[Array, Array]:
    """Return sizes of states, (n,), and controls, (m,), all above zero.

    The size of a component is the largest of its values, fixed ends, references, as far as bounds let it reach them,
    offsets and levels. A component without such data may stay near zero. Its size is then the value that changes other
    components by their sizes within the horizon. If it acts on none, its size is the value that costs as much as the
    whole trajectory. If the trajectory is zero and there are no data, the size is that of the origin, or 1.
    """
    n, (references, slopes, curvature) = problem.state_dim, _sizes_of_cost(problem.quadratic)
    values = largest_over_time(np.abs(stack_signals(trajectory.x, trajectory.u)))
    references = np.minimum(references, values + largest_over_time(reach_of_bounds(problem)))
    A, B, offset = problem.form.gains_along(trajectory.x, trajectory.u)
    in_data = np.maximum(references, np.concatenate([offset, problem.level_sizes]))
    for end in (problem.initial_box, problem.terminal_box):
        in_data[:n] = np.maximum(in_data[:n], np.where(end.fixed, np.abs(end.lower), 0.0))
    known = np.maximum(in_data, values)
    known = np.where(known > ZERO_COMPONENT, known, 0.0)
    anchored = (in_data > 0) | (slopes > 0)
    needed = np.zeros(len(known)) if anchored.all() else _anchoring_sizes(A, B, problem.horizon, known, anchored)
    sizes = np.maximum(known, needed)
    alone = ~anchored & (needed == 0)
    if alone.any():  # by their cost, 0 if they cost nothing
        total = float(cost_and_size(problem, stack_signals(trajectory.x, trajectory.u))[1]) / problem.horizon
        by_cost = np.sqrt(np.divide(total, curvature, out=np.zeros(len(curvature)), where=curvature > 0))
        sizes = np.where(alone, np.maximum(sizes, by_cost), sizes)
    if not sizes.all() and problem.origin is not None:
        sizes[:n] = np.where(sizes[:n] > 0, sizes[:n], np.abs(problem.origin))
    sizes = np.where(sizes > 0, sizes, 1.0)
    return sizes[:n], sizes[n:]


@lru_cache(maxsize=4)  # the steps of a loop have one cost
def _sizes_of_cost(cost: QuadraticCost) -> tuple[Array, Array, Array]:
    """Return the largest references, linear costs and diagonal entries of the Hessian over times, each (n + m,)."""

    def largest(*parts: Array) -> Array:
        return np.concatenate([part.reshape(-1, part.shape[-1]).max(0) for part in parts])

    slopes = largest(np.abs(cost.q), np.abs(cost.r))
    slopes[: len(cost.p)] += np.abs(cost.p)
    curvatures = largest(*(np.diagonal(part, axis1=-2, axis2=-1) for part in (cost.Q, cost.R)))
    return largest(np.abs(cost.x_ref), np.abs(cost.u_ref)), slopes, curvatures


def _anchoring_sizes(A: Array, B: Array, horizon: int, known: Array, anchored: Mask) -> Array:
    """Return the values at which components change anchored components by their sizes, 0 where they change none.

    The change of states within the horizon per unit of a component is ``horizon`` times its gain. Anchored components
    have data; a component that acts on an anchored one anchors others in turn.
    """
    gain = np.hstack([A, B])
    effect = horizon * np.where(gain > INSIGNIFICANT_GAIN * gain.max(axis=1, keepdims=True), gain, 0.0)
    n, reached, needed = len(effect), anchored.copy(), np.zeros(len(known))
    effect = np.where(np.eye(n, len(known), dtype=bool), 0.0, effect)
    for _ in known:
        useful = reached[:n, None] & (effect > 0) & ~reached
        sizes = np.maximum(known, needed)[:n, None]
        least = np.divide(sizes, effect, out=np.full(effect.shape, np.inf), where=useful).min(0)
        newly_reached = np.isfinite(least)
        needed = np.where(newly_reached, least, needed)
        reached = reached | newly_reached
        if not newly_reached.any() or reached.all():
            break
    return needed


def cost_scale(
    problem: OptimalControlProblem, trajectory: Trajectory, known: tuple[float, float] | None = None
) -> float:
    """Return S, the sum of the sizes of the terms of the cost. Gaps are relative to S.

    ``known`` is what ``cost_and_size`` returns, if it is known: J and the sum. S is at least the cost that rounding can
    cause, divided by GAP_TOLERANCE. Rounding of the data moves each component by DATA_ROUNDING of its own terms at its
    own time: squares are taken from the references, all else from the trajectory. A control with levels moves by whole
    levels, of whose cost DATA_ROUNDING counts. Rounding of the Hessian adds HESSIAN_ROUNDING of the products of its
    entries with deviations, and rounding of J and its bound COST_ROUNDING of J.
    """
    x, u, z = trajectory.x, trajectory.u, stack_signals(trajectory.x, trajectory.u)
    quadratic, levels = problem.quadratic, problem.level_sizes
    cost, size = known or map(float, cost_and_size(problem, z))
    moved = DATA_ROUNDING * _own_terms(problem, trajectory)
    rounding = COST_ROUNDING * abs(cost) + HESSIAN_ROUNDING * quadratic.products(z)
    rounding += sum(float(part.sum()) for part in quadratic.magnitudes.terms_at(moved) if part is not None)
    in_x, in_u = split_signals(moved, problem.state_dim)
    if levels.any():
        rounding += DATA_ROUNDING * quadratic.magnitudes.value(np.zeros_like(x), np.broadcast_to(levels, u.shape))
    for term in problem.terms:
        given = term.cost(x, u)
        for sign in (-1, 1):
            rounding += float(np.abs(term.cost(x + sign * in_x, u + sign * in_u) - given).sum())
    return max(size, rounding / GAP_TOLERANCE)


@lru_cache(maxsize=2)  # for the scale of the cost and those of slopes
def _own_terms(problem: OptimalControlProblem, trajectory: Trajectory) -> Array:
    """Return the sums of the absolute values of the terms of each state and control at its time, stacked, (T+1, n + m).

    A component whose terms are all zero has its size.
    """
    z, references = np.abs(stack_signals(trajectory.x, trajectory.u)), problem.quadratic.references(problem.horizon)
    A, B, offset = problem.form.gains_along(trajectory.x, trajectory.u)
    own = z.copy() if references is None else z + np.abs(references)
    own[1:, : problem.state_dim] += z[:-1] @ np.hstack([A, B]).T + offset
    unsized = ~own.any(axis=0)
    if unsized.any():
        own[:, unsized] = np.concatenate(trajectory_sizes(problem, trajectory))[unsized]
    return seal(own)


class Scales(NamedTuple):
    """Sizes of states (n,) and controls (m,), S, ``reach_of_bounds``, and slopes of costs by formulas.

    ``slopes`` gives those for sizes (n + m,): (T+1, n + m), with zeros for u_T.
    """

    sizes: Sizes
    cost: float
    reach: Array
    slopes: Callable[[Array], Array] | None = None


def scales_of(
    problem: OptimalControlProblem, trajectory: Trajectory, known: tuple[float, float] | None = None
) -> Scales:
    """Return the scales along a trajectory; ``known`` as for ``cost_scale``."""
    cost = cost_scale(problem, trajectory, known)
    return Scales(trajectory_sizes(problem, trajectory), cost, reach_of_bounds(problem))


@dataclass(frozen=True, eq=False)
class Floors:
    """The least scale of every kind of quantity: SCALE_FLOOR of its natural size.

    Attributes
    ----------
    z : (n + m,)
        Of states and controls; of states, at least their rounding divided by CONDITION_TOLERANCE.
    level : float
        Of multipliers times signals: S, but at least SCALE_FLOOR of what a component costs that differs by its size, or
        by its reach if that is less: the median over components and times. With eta_C = 0 there is no unit of cost:
        SCALE_FLOOR of the largest terms of the Hamiltonian.
    slopes : (T+1, n + m)
        Of multipliers in the adjoint equation and in D_u H: a part of the slopes of the cost there, as a weight on one
        component or time says nothing of others; at least what rounding of the states changes in them, divided by
        CONDITION_TOLERANCE.
    terms : tuple of (dim,)
        Of the values of each term; at least what rounding of the states changes in them, as for slopes.
    bounds, limits : (n + m,), tuple of (dim,)
        Of violations of bounds and limits other than zero, which say themselves what is small: rounding of the states
        divided by CONDITION_TOLERANCE.
    rounding : (n,)
        Rounding errors of moving states, of A times these, and of their coordinates; 0 for states at rest.
    """

    z: Array
    level: float
    slopes: Array
    terms: tuple[Array, ...]
    bounds: Array
    limits: tuple[Array, ...]
    rounding: Array


def floors(extremal: Extremal, scales: Scales, origin: Array | None = None) -> Floors:
    """Return the least scales along a trajectory with these scales.

    ``origin`` (n,) is the zero of the states' coordinates, by default that of the problem of the extremal; of a problem
    with modes, that is only the average over modes.
    """
    problem, T, eta_C = extremal.problem, extremal.problem.horizon, extremal.multipliers.eta_C
    (x, u), cost, reach, slopes_at = scales
    # rounding of the states, in the coordinates of the user, and of the state equation
    start = problem.origin if origin is None else origin
    at = np.abs(extremal.trajectory.x)
    given = at if start is None else at + np.abs(start)
    moved = problem.equations.successor_sizes(given, extremal.trajectory.u)
    rounding = STATE_ROUNDING * (largest_over_time(given) + largest_over_time(moved))
    resting = largest_over_time(at) <= rounding

    size = np.concatenate([x, u])
    steep = problem.quadratic.slope_magnitudes(_own_terms(problem, extremal.trajectory))
    steep = eta_C * (steep if slopes_at is None else steep + slopes_at(size))
    # what rounding of the states does to rows, and to the slopes of the cost, is no residual
    precise = rounding / CONDITION_TOLERANCE
    coarse = np.maximum(x, precise / SCALE_FLOOR)

    def steady(of_x: Array, of_u: Array) -> Sizes:
        return np.broadcast_to(of_x, (T + 1, len(of_x))), np.broadcast_to(of_u, (T, len(of_u)))

    terms = tuple(SCALE_FLOOR * one.term.map.sizes(*steady(coarse, u)).max(0, initial=0.0) for one in extremal.terms)
    limits = tuple(one.term.map.sizes(*steady(precise, 0 * u)).max(0, initial=0.0) for one in extremal.terms)
    if eta_C == 0:  # any multiple of abnormal multipliers is as good
        parts = zip(split_signals(extremal.slope_terms, len(x)), (x, u), strict=True)
        level = stage = SCALE_FLOOR * max(float((part @ own).max()) for part, own in parts)
    else:
        varied = np.minimum(size, reach)
        near, zero = split_signals(varied, len(x)), (np.zeros((T + 1, len(x))), np.zeros((T, len(u))))
        priced = [np.abs(term.cost(*near) - term.cost(*zero)).ravel() for term in problem.terms if term.kind.is_cost]
        costs = np.concatenate([(steep * varied).ravel(), *priced])
        costs = costs[costs > 0]
        stage = SCALE_FLOOR * float(np.median(costs)) if len(costs) else 0.0
        level = max(cost, stage)
    if (coarse > x).any():
        lost = problem.quadratic.slope_magnitudes(stack_signals(*steady(coarse, u)))
        lost = lost if slopes_at is None else lost + slopes_at(np.concatenate([coarse, u]))
        steep = np.maximum(steep, eta_C * lost)
    steep = np.where(steep > 0, SCALE_FLOOR * steep, stage / size)
    least = SCALE_FLOOR * np.concatenate([coarse, u])
    return Floors(least, level, steep, terms, np.append(precise, 0 * u), limits, np.where(resting, 0.0, rounding))
