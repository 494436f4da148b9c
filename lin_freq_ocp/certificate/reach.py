"""Bounds that the data imply where none are stated: the cost level set for controls, forward reach for states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.errors import NumericalError
from lin_freq_ocp.problem.arrays import Array
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.simulation import simulate

OUTWARD = 1.0 + 1e-9
"""Factor by which computed radii are enlarged to cover their own rounding."""

Pair = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class Enclosure:
    """A box around every optimum.

    Attributes
    ----------
    x, u : pairs (lower, upper) of (T+1, n) and of (T, m)
    level : float
        An optimum lies in the box, or costs at least this much; inf: it lies in the box.
    follows_from : str
        What the box follows from.
    """

    x: Pair
    u: Pair
    level: float
    follows_from: str


def stated_bounds(problem: OptimalControlProblem) -> Enclosure:
    """Return the problem's own sets."""
    x, u = problem.state_tube, problem.control_tube
    return Enclosure((x.lower, x.upper), (u.lower, u.upper), np.inf, "the stated sets")


def implied_bounds(problem: OptimalControlProblem, control_curvature: Array, cost: float | None) -> Enclosure:
    """Return a box at least as tight as the stated sets.

    Parameters
    ----------
    problem : OptimalControlProblem
    control_curvature : (T, m)
        Diagonal m with sum 1/2 m_t,i (u_t,i - u_ref)^2 <= J for costs without linear terms.
    cost : float or None
        Any level J, best a cost near the optimum: an optimum has |u_t,i - u_ref| <= sqrt(2 J / m), or costs more.
    """
    tube, controls, used, level = problem.state_tube, problem.control_tube, ["the stated sets"], np.inf
    u_lower, u_upper = np.array(controls.lower), np.array(controls.upper)
    if cost is not None and cost >= 0 and _cost_is_sum_of_squares(problem) and (control_curvature > 0).any():
        level = OUTWARD * cost
        with np.errstate(divide="ignore"):
            radius = np.where(control_curvature > 0, OUTWARD * np.sqrt(2 * level / control_curvature), np.inf)
        u_lower = np.maximum(u_lower, problem.quadratic.u_ref - radius)
        u_upper = np.minimum(u_upper, problem.quadratic.u_ref + radius)
        used.append("the cost level set")
    reach = _forward_reach(problem, u_lower, u_upper)
    if reach is None:
        return Enclosure((tube.lower, tube.upper), (u_lower, u_upper), level, ", ".join(used))
    used.append("forward reach")
    x_lower, x_upper = np.maximum(tube.lower, reach[0]), np.minimum(tube.upper, reach[1])
    return Enclosure((x_lower, x_upper), (u_lower, u_upper), level, ", ".join(used))


def _cost_is_sum_of_squares(problem: OptimalControlProblem) -> bool:
    return not any(np.any(part) for part in (problem.quadratic.q, problem.quadratic.r, problem.quadratic.p))


def _forward_reach(problem: OptimalControlProblem, u_lower: Array, u_upper: Array) -> Pair | None:
    """Return an interval around every state reachable from X_0 with bounded controls; None if there is none.

    x_t lies within sum_s |A_{t-1} .. A_{s+1} B_s| r_s + |A_{t-1} .. A_0| r_0 of the trajectory of the interval centres.
    """
    start = problem.initial_box
    if not all(np.isfinite(part).all() for part in (start.lower, start.upper, u_lower, u_upper)):
        return None
    try:
        centre = simulate(problem, (u_lower + u_upper) / 2, (start.lower + start.upper) / 2).x
    except NumericalError:
        return None
    radius = OUTWARD * _spread(problem, (start.upper - start.lower) / 2, (u_upper - u_lower) / 2)
    if not np.isfinite(radius).all():
        return None
    rounding = (OUTWARD - 1) * (np.abs(centre) + radius)
    return centre - radius - rounding, centre + radius + rounding


def _spread(problem: OptimalControlProblem, radius_0: Array, radius_u: Array) -> Array:
    """Return how far x_t can be from the trajectory of the centres, (T+1, n)."""
    dynamics, T = problem.linear, problem.horizon
    spread = np.empty((T + 1, problem.state_dim))
    spread[0] = radius_0
    transition, sum_of_responses = np.eye(problem.state_dim), np.zeros(problem.state_dim)
    responses = np.empty((0, *dynamics.B.shape[-2:]))
    largest_u = radius_u.max(0)
    with np.errstate(over="ignore", invalid="ignore"):
        for t in range(T):
            A, B, _ = dynamics.at(t)
            if dynamics.time_varying:
                responses = np.concatenate([A @ responses, B[None]])
                sum_of_responses = np.einsum("sij,sj->i", np.abs(responses), radius_u[: t + 1])
            else:
                sum_of_responses = sum_of_responses + np.abs(transition @ B) @ largest_u
            transition = A @ transition
            spread[t + 1] = sum_of_responses + np.abs(transition) @ radius_0
    return spread
