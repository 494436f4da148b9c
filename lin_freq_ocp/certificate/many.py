"""The judge of a batch: trajectories of one problem from many initial states, certified at once.

Extremals and their bound are those of one trajectory, with the trajectories as first axis. Conditions are those of
``Certificate.proven_within``, with scales without their floors: a trajectory that passes here passes there. Callers
judge the others one by one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask, assign, largest_over_time, split_signals, stack_signals
from lin_freq_ocp.certificate.bound import evaluate_bound
from lin_freq_ocp.certificate.hamiltonian import Extremal, extremal_within
from lin_freq_ocp.certificate.reach import Pair
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE, GAP_TOLERANCE, RADIUS_MARGIN
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Extremals
from lin_freq_ocp.transform.simulation import constant_radii


@dataclass(frozen=True, eq=False)
class Verdicts:
    """Costs, rigorous lower bounds, gaps relative to the cost's terms, and whether each is proven optimal, all (N,)."""

    costs: Array
    bounds: Array
    gaps: Array
    proven: Mask


@lru_cache(maxsize=4)  # a loop and its softened problem ask at every step
def batch_judge_takes(problem: OptimalControlProblem) -> bool:
    """Whether ``judge_batch`` takes a problem: time-invariant, quadratic, boxes, stop bands of controls, rows at times.

    Rows at times are joint rows and soft sets of half-spaces, the same terms for every initial state.
    """
    cost, dynamics = problem.quadratic, problem.linear
    constant = not dynamics.time_varying and all(part.ndim == 2 for part in (cost.Q, cost.R, cost.S))
    if not constant or problem.cost.has_formulas or problem.state_stop.any() or not problem.ends[0].fixed.all():
        return False
    of_start = problem.hard_state_sets or bool(problem.initial_state.members) or bool(problem.met_ends[0][1].any())
    return not of_start and all(term.takes_batches for term in problem.terms)


def judge_batch(problem: OptimalControlProblem, starts: Array, extremals: Extremals) -> Verdicts:
    """Judge trajectories from initial states (N, n) of a problem that differs in the initial state only."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        extremal = _extremal_from(problem, starts, extremals)
        costs, scale = extremal.cost_and_size
        curvatures = np.zeros(extremal.z.shape[1:]) if extremal.curvatures is None else extremal.curvatures
        found = evaluate_bound(extremal, curvatures, _reachable_bounds(extremal, curvatures), costs, scale)
        gaps = np.where(scale > 0, (costs - found.value) / scale, np.inf).astype(np.float64)
        worth, boxes = extremal.cost_of_residuals, problem.state_boxes
        inside = ((boxes.lower[0] <= starts) & (starts <= boxes.upper[0])).all(1)
        proven = (np.abs(gaps) <= GAP_TOLERANCE) & (worth <= GAP_TOLERANCE * scale) & inside
        return Verdicts(costs, found.value, gaps, proven & _feasible(extremal))


def _extremal_from(problem: OptimalControlProblem, starts: Array, extremals: Extremals) -> Extremal:
    """Return the extremal of all trajectories, with their own first states; a bin that is free has no price."""
    n, multipliers = problem.state_dim, extremals.multipliers
    lower, upper = (np.repeat(side[None], len(starts), axis=0) for side in problem.signal_bounds)
    lower[:, 0, :n] = upper[:, 0, :n] = starts
    assign(multipliers, rho_u=np.where(problem.control_stop, multipliers.rho_u, 0.0))
    return extremal_within(problem, extremals.trajectory, multipliers, (lower, upper))


def _reachable_bounds(extremal: Extremal, curvatures: Array) -> Pair:
    """Return bounds, (N, T+1, n + m): the stated ones; absent ones of states without curvature are implied.

    A feasible trajectory differs from the given one by what controls within their bounds, its residual and its first
    state move, at most.
    """
    problem, n, (lower, upper) = extremal.problem, extremal.problem.state_dim, extremal.bounds
    (x, u), least, most = split_signals(extremal.point, n), lower[..., :-1, n:], upper[..., :-1, n:]
    absent = (np.isinf(lower) | np.isinf(upper)) & (curvatures <= 0)
    if not absent.any() or not np.isfinite(least).all() or not np.isfinite(most).all():
        return lower, upper
    reach = np.maximum(np.abs(most - u), np.abs(u - least)).max(1)
    moved = np.abs(extremal.residual.astype(np.float64)).max(1) + (RADIUS_MARGIN - 1) * np.abs(x).max(1)
    apart = np.abs(x[:, 0] - lower[:, 0, :n])
    radii = constant_radii(problem.linear, apart.T, np.hstack([reach, moved]).T, problem.horizon)
    radius = RADIUS_MARGIN * np.moveaxis(radii, 2, 0) + (RADIUS_MARGIN - 1) * np.abs(x)
    radius, point = stack_signals(radius, np.zeros_like(u)), extremal.point
    low, high = np.maximum(lower, point - radius), np.minimum(upper, point + radius)
    return np.where(absent, low, lower), np.where(absent, high, upper)


def _feasible(extremal: Extremal) -> Mask:
    """Return which trajectories satisfy dynamics, bounds and stop bands, relative to the sizes of the components."""
    problem, (x, u) = extremal.problem, (extremal.trajectory.x, extremal.trajectory.u)
    checks = [(largest_over_time(np.abs(extremal.residual.astype(np.float64))), problem.linear.motion_sizes(x, u))]
    checks.append((largest_over_time(extremal.violation), largest_over_time(np.abs(extremal.point))))
    if problem.control_stop.any():
        spectra = np.abs(np.fft.rfft(u, axis=1)) * problem.control_stop
        checks.append((spectra.max(1), np.linalg.norm(u, axis=1)))
    checks += [(k.term.penalty.violation(k.values).max(1), k.sizes.max(1)) for k in extremal.terms if k.term.hard]
    errors, scales = (np.concatenate(side, axis=1) for side in zip(*checks, strict=True))
    return np.all(errors <= CONDITION_TOLERANCE * scales, axis=1)
