"""The global lower bound of a problem whose states are a frequency response: a bound over the controls alone.

With x(u) = base + Y u, multipliers mu of bounds on states and lambda of terms h(L), the Lagrangian

    l(u) = J(x(u), u) + <mu, x(u)> - sigma(mu) + <rho, bands> + sum (<lambda+, L> - h*(lambda+))  <=  J  if feasible

is convex on the controls that the bands allow, for any stage Hessian, if it is convex at every bin
(``control_curvature``; derived in transform/response_curvature.py, whose code the judge does not use). Therefore
D = l(u_0) + min over U of the tangent of l plus the least curvature over all bins. The multiplier eta of x = Y u does
not enter: slopes in x are pulled back to the controls exactly.

If the states of the trajectory differ from x(u_0) by r, l is taken at these states, with <slope in x, r> and the
largest loss of curvature by r: 1/2 <|Q| |r|, |r|> + <|r|, |Q| |Y du| + |S| |du|>, if the stage Hessian is not positive
semidefinite by itself. u_0 is then the part of the controls that the bands pass, as du must stay in the space on which
l is convex.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, split_signals, times_vectors, to_long_double
from lin_freq_ocp.certificate.bound import (
    NEVER_NEGATIVE,
    NUMERICAL,
    RIGOROUS,
    Bound,
    bounds_within,
    box_minimum,
    cut_bounds,
    farthest_bound,
    lower_bound,
    ray_bound,
    unit_rounding,
)
from lin_freq_ocp.certificate.hamiltonian import Extremal, diagonal_curvature, extremal_at
from lin_freq_ocp.certificate.reach import Pair, cost_is_never_negative, implied_bounds
from lin_freq_ocp.certificate.sizes import trajectory_sizes
from lin_freq_ocp.certificate.tolerances import ARITHMETIC_ROUNDING, EIGENVALUE_ERROR, NUMERICAL_REACH
from lin_freq_ocp.problem.dynamics.response import Response
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory


def best_bound(extremal: Extremal, allowed: float) -> Bound | None:
    """Return D for normal multipliers, or None if the cost is not convex; see ``bound.lower_bound``."""
    problem = extremal.problem
    response = problem.response
    if response is None:
        return lower_bound(extremal, allowed)
    curvature = control_curvature(problem, response)
    if curvature is None:
        return None
    if problem.quadratic.nonconvexity() is not None and problem.control_stop.any():
        # the cost may be convex only for controls without removed bins: take the passed part of these
        spectrum = np.fft.rfft(extremal.trajectory.u, axis=0)
        spectrum[problem.control_stop] = 0.0
        passed = Trajectory(extremal.trajectory.x, np.fft.irfft(spectrum, n=problem.horizon, axis=0))
        extremal = extremal_at(problem, passed, extremal.multipliers)
    cost, tube = extremal.cost, problem.control_tube
    proven = _evaluate(extremal, response, curvature, tube.bounds, cost, RIGOROUS, "the stated bounds")
    if proven.value == -np.inf:
        bounds, follows_from = _implied_bounds(problem)
        proven = _evaluate(extremal, response, curvature, bounds, cost, RIGOROUS, follows_from)
    if proven.value < 0 and cost_is_never_negative(problem):
        proven = replace(proven, value=0.0, sets=NEVER_NEGATIVE)
    if cost - proven.value <= allowed:
        return proven
    near = cut_bounds(tube.bounds, NUMERICAL_REACH * trajectory_sizes(problem, extremal.trajectory)[1])
    sets = f"{NUMERICAL_REACH:g} times the trajectory"
    numerical = _evaluate(extremal, response, curvature, near, cost, NUMERICAL, sets)
    return numerical if numerical.value - proven.value > allowed else proven


def farkas_bound(extremal: Extremal, sizes: Pair, multiple: float | None = None) -> Bound:
    """Return D for eta_C = 0 from any trajectory; see ``bound.ray_bound``."""
    problem = extremal.problem
    response = problem.response
    if response is None:
        return ray_bound(extremal, sizes, multiple)
    flat, bounds, u = np.zeros(problem.control_dim), problem.control_tube.bounds, extremal.trajectory.u
    if not np.isfinite(bounds).all():
        bounds, _ = _implied_bounds(problem)
    proven = _evaluate(extremal, response, flat, bounds, 0.0, RIGOROUS, "the stated bounds")
    if proven.value > -np.inf:
        return proven

    def bound_within(multiple: float) -> Bound:
        box = bounds_within(bounds, u, multiple * sizes[1])
        return _evaluate(extremal, response, flat, box, 0.0, NUMERICAL, "the stated bounds")

    return bound_within(multiple) if multiple is not None else farthest_bound(bound_within)


def control_curvature(problem: OptimalControlProblem, response: Response) -> Array | None:
    """Return the least curvature c of the cost in each control, (m,); None if the cost is not convex.

    From H_k = G^*Q G + G^*S + S'G + R: c >= 0 with diag(c) <= H_k on the controls that use bin k.
    """
    cost, adjoint, m = problem.quadratic, np.swapaxes(response.G, 1, 2).conj(), problem.control_dim
    rises, last = cost.rises
    least = np.zeros(m) if not rises.any() and last == 0 else None  # zero if the cost is exactly convex at each time
    if any(part.ndim == 3 for part in (cost.Q, cost.R, cost.S)):
        return least
    if diagonal_curvature(cost.P) is None or (not response.closed and diagonal_curvature(cost.Q) is None):
        return least
    half = adjoint @ (cost.S + cost.Q @ response.G / 2 if response.closed else cost.S) + cost.R / 2
    passed = ~problem.control_stop if response.closed else np.ones((len(half), m), dtype=bool)
    hessians = (half + np.swapaxes(half, 1, 2).conj()) * (passed[:, :, None] & passed[:, None, :])
    sizes = np.abs(np.diagonal(hessians, axis1=1, axis2=2)).max(0)
    root, error = np.sqrt(np.where(sizes > 0, sizes, 1.0)), EIGENVALUE_ERROR * m
    relative = hessians / (root[:, None] * root) + np.eye(m) * ~passed[:, None, :]
    smallest = float(np.linalg.eigvalsh(relative)[:, 0].min()) - error
    return least if smallest < -2 * error else max(smallest, 0.0) * sizes


def _implied_bounds(problem: OptimalControlProblem) -> tuple[Pair, str]:
    """Return the bounds of the controls that all constraints imply, and what they follow from."""
    region = implied_bounds(problem)
    lower, upper = (split_signals(side, problem.state_dim)[1] for side in region.bounds)
    return (lower, upper), region.follows_from


def _evaluate(
    extremal: Extremal, response: Response, curvature: Array, box: Pair, cost: float, kind: str, sets: str
) -> Bound:
    """Return D over bounds of the controls."""
    problem, multipliers = extremal.problem, extremal.multipliers
    unit, arrays = unit_rounding(problem), (extremal.z, extremal.in_z, extremal.in_z_terms)
    (x, u), (in_x, in_u), (in_x_terms, in_u_terms) = (split_signals(part, problem.state_dim) for part in arrays)
    # mu at existing bounds, and these bounds
    mu, lower, upper = multipliers.mu, problem.state_tube.lower, problem.state_tube.upper
    above, below = (mu > 0) & np.isfinite(upper), (mu < 0) & np.isfinite(lower)
    normal, limits = np.where(above | below, mu, 0.0), np.where(above, upper, np.where(below, lower, 0.0))
    slope_x, residual = normal - in_x, x - response.states(u)
    through_u = problem.equations.pull_back(to_long_double(multipliers.eta))[:, problem.state_dim :]
    slope = (through_u - in_u + response.pull_back(slope_x)).astype(np.float64)
    lost = multipliers.eta_C * np.abs(residual[:-1]).astype(np.float64)
    Q, S = (np.abs(part) for part in (problem.quadratic.Q, problem.quadratic.S))
    in_states = unit * (in_x_terms + np.abs(normal))
    in_states[:-1] += times_vectors(Q, lost)
    # response.pull_back of any weights of these magnitudes is at most the largest gain times their norm
    weights = (in_states + unit * np.abs(slope_x)).astype(np.float64)
    weights[0] += weights[-1]  # of one period, x_T repeats x_0
    through_states = np.abs(response.G).max(0).T @ np.linalg.norm(weights, axis=0)
    error = unit * (in_u_terms + np.abs(through_u)) + through_states
    error = (error + times_vectors(np.swapaxes(S, -1, -2), lost)).astype(np.float64)
    error += ARITHMETIC_ROUNDING * np.abs(slope)
    low, high = box[0] - extremal.trajectory.u, box[1] - extremal.trajectory.u
    minimum, *pessimistic = box_minimum(np.stack([slope, slope - error, slope + error]), curvature, low, high)
    losses = -np.minimum(*pessimistic)
    at_bounds = (normal * (x - limits)).sum(1)
    stage_gaps = -at_bounds.astype(np.float64)
    stage_gaps[:-1] -= minimum.sum(1)
    dynamics_term = -float((slope_x * residual).sum()) - 0.5 * float((lost * times_vectors(Q, lost)).sum())
    frequency_term, stage_term = float(sum(extremal.frequency_terms)), float(extremal.terms_gap)
    summed = float((in_x_terms * np.abs(x)).sum() + (in_u_terms * np.abs(u)).sum())
    summed += float((np.abs(normal) * (np.abs(x) + np.abs(limits))).sum())
    summed += float(sum(priced.gap_terms.sum() for priced in extremal.terms))
    certain, complementary = float(losses.sum()), float(at_bounds.sum())
    others = abs(cost) + abs(dynamics_term) + abs(frequency_term) + abs(stage_term) + abs(complementary)
    in_sums = unit * summed + ARITHMETIC_ROUNDING * others
    value = cost + complementary + dynamics_term + frequency_term - stage_term - certain - in_sums
    value = value if np.isfinite(value) else -np.inf
    rounding = certain + float(minimum.sum()) + in_sums if np.isfinite(certain) else np.inf
    return Bound(value, kind, stage_gaps, dynamics_term, frequency_term, stage_term, rounding, sets)
