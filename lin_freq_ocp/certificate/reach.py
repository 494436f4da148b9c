"""Bounds that the data imply where none are stated: the cost level set for controls, forward reach for states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.problem.arrays import Array
from lin_freq_ocp.problem.ocp import OptimalControlProblem

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
        u_lower = np.maximum(u_lower, problem.cost.u_ref - radius)
        u_upper = np.minimum(u_upper, problem.cost.u_ref + radius)
        used.append("the cost level set")
    reach = _forward_reach(problem, u_lower, u_upper)
    if reach is None:
        return Enclosure((tube.lower, tube.upper), (u_lower, u_upper), level, ", ".join(used))
    used.append("forward reach")
    x_lower, x_upper = np.maximum(tube.lower, reach[0]), np.minimum(tube.upper, reach[1])
    return Enclosure((x_lower, x_upper), (u_lower, u_upper), level, ", ".join(used))


def _cost_is_sum_of_squares(problem: OptimalControlProblem) -> bool:
    return not any(np.any(part) for part in (problem.cost.q, problem.cost.r, problem.cost.p))


def _forward_reach(problem: OptimalControlProblem, u_lower: Array, u_upper: Array) -> Pair | None:
    """Return an interval around every state reachable from X_0 with bounded controls; None if there is none.

    x_t lies within sum_k |A^k B| r + |A^t| r_0 of the trajectory of the interval centres (no wrapping of intervals).
    """
    start = problem.initial_state
    finite = all(np.isfinite(part).all() for part in (start.lower, start.upper, u_lower, u_upper))
    if problem.dynamics.time_varying or not finite:
        return None
    T, n = problem.horizon, problem.state_dim
    A, B = problem.dynamics.A, problem.dynamics.B
    centre_u, radius_u = (u_lower + u_upper) / 2, ((u_upper - u_lower) / 2).max(0)
    centre, radius = np.empty((T + 1, n)), np.empty((T + 1, n))
    centre[0], spread = (start.lower + start.upper) / 2, np.zeros(n)
    power, radius_0 = np.eye(n), (start.upper - start.lower) / 2
    radius[0] = radius_0
    with np.errstate(over="ignore", invalid="ignore"):
        for t in range(T):
            spread = spread + np.abs(power @ B) @ radius_u
            power = A @ power
            radius[t + 1] = spread + np.abs(power) @ radius_0
            centre[t + 1] = A @ centre[t] + B @ centre_u[t] + problem.dynamics.at(t)[2]
        lower, upper = centre - OUTWARD * radius, centre + OUTWARD * radius
    if not (np.isfinite(lower).all() and np.isfinite(upper).all()):
        return None
    slack = (OUTWARD - 1) * (np.abs(lower) + np.abs(upper))
    return lower - slack, upper + slack
