"""The global lower bound D of a convex problem from any multipliers, as a sum over stages (docs/conventions.md).

l_t(x, u) = eta_C c_t + <eta_xhat, phi_t> + <eta_uhat, psi_t> - <eta_t, f_t> + <eta_{t-1}, x> + (terms <lambda+, L>),
D = sum_t min l_t over X_t x U_t - sum h*(lambda+),
J - D = sum_t (l_t(x_t, u_t) - min l_t) - <eta, dynamics residual> - <rho, frequency residual>
        + sum (h(L(x, u)) + h*(lambda+) - <lambda+, L(x, u)>).

The last sum is over terms h(L(x, u)) with multipliers lambda; lambda+ are the nearest multipliers that are subgradients
of h somewhere. D is therefore a bound for multipliers of any sign.

The tangent of l_t at (x_t, u_t), plus a diagonal lower bound of its curvature, bounds each minimum from below; for a
diagonal Hessian this is exact. The slope of the tangent is the residual of the adjoint equation and of D_u H = nu
without mu and nu. Its large terms therefore cancel before they enter D.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from scipy.linalg import block_diag

from lin_freq_ocp.base.arrays import Array, split_signals, total
from lin_freq_ocp.certificate.hamiltonian import Extremal, cost_curvatures
from lin_freq_ocp.certificate.reach import (
    Deviations,
    Pair,
    Region,
    box_around,
    cost_is_never_negative,
    equation_rows,
    implied_bounds,
    largest_residual,
    nearby_bounds,
    reachable_bounds,
    stated_bounds,
    units_of,
)
from lin_freq_ocp.certificate.sizes import trajectory_sizes
from lin_freq_ocp.certificate.tolerances import ARITHMETIC_ROUNDING, MAX_UNKNOWN, NUMERICAL_REACH
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory

Number = Array | float  # of one trajectory, or an array (N,) of N of them
RIGOROUS, NUMERICAL = "rigorous", "numerical"  # a bound for all trajectories, or for those within a box
EXTENDED = float(np.finfo(np.longdouble).eps)  # a rounding error of extended precision
NEVER_NEGATIVE = "a cost that is never negative"  # the bound 0 follows from it


@dataclass(frozen=True, eq=False)
class Bound:
    """A lower bound on the optimal cost, and its difference from the cost of a trajectory, stage by stage.

    Attributes
    ----------
    value : float
        D, with all rounding errors of its evaluation subtracted; 0 where D is below and the cost cannot be.
    kind : str
        "rigorous" if the minima are over sets that contain an optimum, "numerical" if over a box around the trajectory.
    stage_gaps : (T+1,) or None
        l_t(x_t, u_t) - min l_t; None if the bound is not a sum over stages.
    dynamics_term, frequency_term : float
        <eta, dynamics residual> and <rho, frequency residual>: the part of J - D that is due to infeasibility.
    stage_term : float
        The last sum: the part of J - D due to terms beyond boxes, such as joint rows; negative if they are violated.
    rounding : float
        Bound on the rounding errors, already subtracted from ``value``.
    sets : str
        The origin of the sets over which the minima are taken.
    multiple : float
        Of a ray: the multiple of the sizes up to which the bound holds where neither sets nor reach bound a component.
    """

    value: float
    kind: str
    stage_gaps: Array | None = None
    dynamics_term: float = 0.0
    frequency_term: float = 0.0
    stage_term: float = 0.0
    rounding: float = 0.0
    sets: str = ""
    multiple: float = np.inf


def box_minimum(slope: Array, curvature: Array, lower: Array, upper: Array) -> Array:
    """Return min of slope v + curvature v^2 / 2 over lower <= v <= upper, entrywise; -inf where it has none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        free = slope / -(np.maximum(curvature, 0.0) + 0.0)  # -0.0 becomes 0.0
        free[slope == 0] = 0.0
        v = np.minimum(np.maximum(free, lower, out=free), upper, out=free)
        least = 0.5 * curvature * v
        least += slope
        least *= v
        least[np.isinf(v)] = -np.inf
        if not (curvature < 0).any():
            return least
        ends = [np.where(np.isinf(end), -np.inf, (slope + 0.5 * curvature * end) * end) for end in (lower, upper)]
        return np.where(curvature < 0, np.minimum(*ends), least)


def lower_bound(extremal: Extremal, allowed: float) -> Bound | None:
    """Return D for normal multipliers, or None if the cost is not convex.

    Better bounds are computed only as long as the difference from the cost exceeds ``allowed``.
    """
    curvatures, problem = extremal.curvatures, extremal.problem
    if curvatures is None:
        return None
    cost = extremal.cost
    proven, found = _evaluate(extremal, curvatures, stated_bounds(problem), cost, RIGOROUS)
    mistrusting = partial(nearby_bounds, mistrusted=True)
    for around in (partial(nearby_bounds, allowed=allowed), partial(mistrusting, allowed=allowed), level_bounds):
        if cost - proven.value <= allowed:
            break
        nearby = around(problem, extremal.point, found.deviations, cost)
        if nearby is not None:
            of_nearby, _ = _evaluate(extremal, curvatures, nearby, cost, RIGOROUS)
            proven = of_nearby if of_nearby.value > proven.value else proven
    if proven.value < 0 and cost_is_never_negative(problem):
        proven = replace(proven, value=0.0, sets=NEVER_NEGATIVE)
    if cost - proven.value <= allowed:
        return proven
    largest = NUMERICAL_REACH * np.concatenate(trajectory_sizes(problem, extremal.trajectory))
    stated = stated_bounds(problem).bounds  # components without curvature are cut
    cut = [np.where(curvatures > 0, side, at) for side, at in zip(stated, cut_bounds(stated, largest), strict=True)]
    near = Region((cut[0], cut[1]), np.inf, f"{NUMERICAL_REACH:g} times the trajectory")
    numerical, _ = _evaluate(extremal, curvatures, near, cost, NUMERICAL)
    return numerical if numerical.value - proven.value > allowed else proven


def cut_bounds(bounds: Pair, largest: Array) -> Pair:
    """Return bounds of which farther ones than ``largest`` are cut there."""
    return np.clip(-largest, *bounds), np.clip(largest, *bounds)


def level_bounds(problem: OptimalControlProblem, z: Array, deviations: Deviations, cost: float) -> Region | None:
    """Return the same box by the inverse Z of the Hessian H on all changes that keep the equations M, or None.

    Where d = Z H d + Y M d + E d and E is rounding, |d| <= sqrt(2 diag(Z H Z')) q + |Y| |M d| + |E| |d| by the
    inequality of Cauchy and Schwarz, with q as in ``nearby_bounds``. That needs neither bounds nor curvature of single
    components: only that the cost is curved along all these changes.
    """
    inverse, (lower, upper) = _level_inverse(problem), problem.signal_bounds
    if inverse is None:
        return None
    (beta, weights, through_fixed, error), free = inverse, lower < upper
    residual = largest_residual(problem, Trajectory(*split_signals(z, problem.state_dim)))
    missed = np.abs(lower - z)[~free]
    of_free, sides = [weights @ (residual.ravel() + through_fixed @ missed), beta], np.zeros((2, *free.shape))
    for k, radius in enumerate(of_free):
        added = error @ radius
        if (2 * error @ added > added).any():
            return None
        sides[k, free] = radius + 2 * added
    sides[0, ~free] = missed
    radii = np.stack([sides[0], sides[1], 0 * sides[1]])[:, None].repeat(2, axis=1)
    return box_around(problem, z, deviations, cost, radii, deviations.losses == 0)


@lru_cache(maxsize=2)  # for the candidates of one problem, one after another
def _level_inverse(problem: OptimalControlProblem) -> tuple[Array, Array, Array, Array] | None:
    """Return sqrt(2 diag(Z H Z')), |Y|, |M| of fixed components, and |E|; None if Z is unknown.

    E counts whatever Z and Y are. So equations may depend on each other: a little less than zero in place of their
    block keeps Y finite.
    """
    (lower, upper), n, T = problem.signal_bounds, problem.state_dim, problem.horizon
    curvatures, free = cost_curvatures(problem.quadratic, T), (lower < upper).ravel()
    if curvatures is None or problem.response is not None or free.sum() > MAX_UNKNOWN:
        return None
    blocks, M = np.zeros((*lower.shape, lower.shape[1])), equation_rows(problem)
    blocks[:T], blocks[T, :n, :n] = problem.quadratic.stage_hessians, problem.quadratic.P
    H = block_diag(*(blocks - np.minimum(curvatures, 0.0)[..., None] * np.eye(lower.shape[1])))[np.ix_(free, free)]
    system = np.block([[H, M[:, free].T], [M[:, free], np.zeros((T * n, T * n))]])
    units, eps = 1 / np.sqrt(units_of(system, axis=0)), np.finfo(float).eps
    units[len(H) :] = 1 / units_of(units[: len(H), None] * system[: len(H), len(H) :], axis=0)
    scaled = units[:, None] * system * units - np.sqrt(eps) * np.diag(np.arange(len(system)) >= len(H))
    try:
        solved = units[:, None] * np.linalg.solve(scaled, np.diag(units)[:, : len(H)])
    except np.linalg.LinAlgError:
        return None
    Z, Y = solved[: len(H)].T, solved[len(H) :].T
    terms, rounding = np.abs(Z) @ np.abs(H), len(system) * eps
    beta = np.sqrt(2 * (np.maximum(((Z @ H) * Z).sum(1), 0.0) + rounding * (terms * np.abs(Z)).sum(1)))
    error = np.abs(Z @ H + Y @ M[:, free] - np.eye(len(H))) + rounding * (terms + np.abs(Y) @ np.abs(M[:, free]))
    return beta, np.abs(Y), np.abs(M[:, ~free]), error


def optimum_box(extremal: Extremal, allowed: float) -> Region:
    """Return a box around every trajectory whose cost exceeds this one's by at most ``allowed``.

    If no such box is known, return the reachable set. ``allowed`` must exceed the rounding errors of the cost.
    """
    problem, curvatures = extremal.problem, extremal.curvatures
    if curvatures is not None:
        cost = extremal.cost
        _, found = _evaluate(extremal, curvatures, stated_bounds(problem), cost, RIGOROUS)
        summed = _sum_of_terms(extremal)
        level = float(cost + allowed - unit_rounding(problem) * summed - ARITHMETIC_ROUNDING * abs(cost))
        farther = replace(found.deviations, left=found.deviations.left + allowed)
        nearby = nearby_bounds(problem, extremal.point, farther, level, allowed)
        nearby = nearby or level_bounds(problem, extremal.point, farther, level)
        if nearby is not None:
            return nearby
    return reachable_bounds(problem)


def ray_bound(extremal: Extremal, sizes: Pair, multiple: float | None = None) -> Bound:
    """Return D for eta_C = 0 from any trajectory: D > 0 proves that no trajectory satisfies all constraints.

    If the stated sets prove nothing, the reachable set does or nothing does. Where neither bounds a component, nor the
    other constraints, the bound is "numerical": it holds for distances from the trajectory up to a ``multiple`` of the
    sizes, (n,) and (m,), by default the largest that leaves half of D.
    """
    problem = extremal.problem
    uncurved = np.zeros_like(extremal.in_z)
    region = stated_bounds(problem)
    proven, _ = _evaluate(extremal, uncurved, region, 0.0, RIGOROUS)
    if proven.value <= 0:
        region = reachable_bounds(problem)
        proven, _ = _evaluate(extremal, uncurved, region, 0.0, RIGOROUS)
    if proven.value > -np.inf:
        return proven

    def bound_within(multiple: float) -> Bound:
        bounds = bounds_within(region.bounds, extremal.point, multiple * np.concatenate(sizes))
        return _evaluate(extremal, uncurved, replace(region, bounds=bounds), 0.0, NUMERICAL)[0]

    if multiple is not None:
        return bound_within(multiple)
    farthest = farthest_bound(bound_within)
    if farthest.value <= 0:  # nor over any box around the trajectory
        return farthest
    proven, _ = _evaluate(extremal, uncurved, implied_bounds(problem), 0.0, RIGOROUS)
    return replace(proven, multiple=farthest.multiple) if proven.value > 0 else farthest


def farthest_bound(bound_within: Callable[[float], Bound]) -> Bound:
    """Return the bound of a ray for the largest multiple of the sizes that leaves half of D, which is linear in it."""
    nearest = bound_within(0.0)
    if nearest.value <= 0:
        return nearest
    lost = max(nearest.value - bound_within(1.0).value, np.finfo(float).eps * nearest.value)
    multiple = 0.5 * nearest.value / lost
    return replace(bound_within(multiple), multiple=multiple)


def bounds_within(bounds: Pair, signal: Array, distance: Array) -> Pair:
    """Return bounds on a signal, at a distance from it where there are none."""
    lower, upper = bounds
    return np.where(np.isinf(lower), signal - distance, lower), np.where(np.isinf(upper), signal + distance, upper)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """D over a box, and the parts of its difference from the cost; of N trajectories, with a leading axis.

    As in ``Bound``, whose terms of dynamics, frequency and stages are ``residual_terms``. Losses in ``deviations``
    include errors of the slopes.
    """

    value: Array
    rounding: Array
    stage_gaps: Array
    residual_terms: tuple[Number, ...]
    deviations: Deviations


def evaluate_bound(
    extremal: Extremal, curvatures: Array, bounds: Pair, cost: Number, cost_terms: Number, level: float = np.inf
) -> Evaluation:
    """Return D over stacked bounds; the cost has rounding errors relative to its terms."""
    slope, unit = extremal.slopes.astype(np.float64), unit_rounding(extremal.problem)
    error = unit * extremal.slope_terms + ARITHMETIC_ROUNDING * np.abs(slope)
    slopes = np.stack([slope, slope - error, slope + error])  # and the least and the greatest within rounding errors
    minimum, *pessimistic = box_minimum(slopes, curvatures, bounds[0] - extremal.point, bounds[1] - extremal.point)
    stage_gaps, losses = 0.0 - minimum.sum(-1), -np.minimum(*pessimistic)
    dynamics_term, frequency_term = extremal.dynamics_term, sum(extremal.frequency_terms)
    stage_term, certain = extremal.terms_gap, losses.sum((-2, -1))
    finite = np.isfinite(certain)
    gap = np.where(finite, stage_gaps.sum(-1), 0.0)
    others = cost_terms + np.abs(dynamics_term) + np.abs(frequency_term) + np.abs(stage_term)
    in_sums = unit * _sum_of_terms(extremal) + ARITHMETIC_ROUNDING * (others + np.abs(gap))
    without_losses = cost + dynamics_term + frequency_term - stage_term
    value = np.where(finite, np.minimum(without_losses - certain, level) - in_sums, -np.inf)
    rounding = np.where(finite, certain, np.inf) - gap + in_sums
    terms = dynamics_term, frequency_term, stage_term
    deviations = Deviations(slopes[1:], curvatures, losses, cost - without_losses + in_sums)
    return Evaluation(value, rounding, stage_gaps, terms, deviations)


def _evaluate(extremal: Extremal, curvatures: Array, box: Region, cost: float, kind: str) -> tuple[Bound, Evaluation]:
    """Return D over a box of one trajectory."""
    found = evaluate_bound(extremal, curvatures, box.bounds, cost, abs(cost), box.level)
    dynamics, frequency, stages = map(float, found.residual_terms)
    terms = dynamics, frequency, stages, float(found.rounding)
    return Bound(float(found.value), kind, found.stage_gaps, *terms, box.follows_from), found


def _sum_of_terms(extremal: Extremal) -> Array:
    """Return the sum of the absolute values of the terms of J - D beyond the losses.

    Those are J, <eta, dynamics residual>, <rho, frequency residual>, and the gaps of terms. Those of J are products of
    deviations from the references, and linear terms.
    """
    problem, others = extremal.problem, extremal.slope_terms - extremal.cost_terms
    offset, linear = problem.linear.offset, problem.quadratic.linear_slopes(problem.horizon)
    terms = total(extremal.cost_terms * np.abs(extremal.deviations) + others * np.abs(extremal.point))
    if linear is not None:
        terms = terms + total(np.abs(linear * extremal.point))
    if offset.any():
        terms = terms + total(np.abs(extremal.multipliers.eta * offset))
    for priced in extremal.terms:
        terms = terms + priced.gap_terms.sum(-1)
    return terms


def unit_rounding(problem: OptimalControlProblem) -> float:
    """Return a bound on rounding errors of extremals, relative to the sum of the absolute values of their terms."""
    rows = sum(term.map.additions for term in problem.terms)
    operations = problem.state_dim + problem.control_dim + rows + 5 * math.log2(problem.horizon + 2) + 10
    return operations * EXTENDED
