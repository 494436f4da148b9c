"""Boxes that the optimum lies in: the stated sets, what can be reached, and what is near a trajectory as good."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.certificate.hamiltonian import state_residual
from lin_freq_ocp.errors import NumericalError
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.simulation import simulate
from lin_freq_ocp.problem.trajectory import Trajectory

OUTWARD = 1.0 + 1e-9
"""Factor by which computed radii are enlarged to cover their own rounding."""

DETERMINED = 1e-9
"""A left inverse of the columns of unknown components is one up to this; OUTWARD covers it."""

NEGLIGIBLE_SHARE = 1e-2
"""Losses of all stated bounds that add up to less than this part of the gap that is allowed are left as they are."""

BLOCK = 1024
"""Powers of A that are kept at a time."""

MOST_STEPS = 20_000
"""Horizons up to which radii are looked for step by step, which takes 0.1 ms each."""

MOST_UNKNOWN = 1000
"""Components whose radii are looked for all at once, by a dense matrix, which takes a second."""

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


@dataclass(frozen=True, eq=False)
class Deviations:
    """What a bound loses on every state and control, to say how far a trajectory that costs no more can be away.

    Attributes
    ----------
    slopes : (T+1, n), (T, m)
        |slope| of l_t, rounding errors included.
    curvatures : (T+1, n), (T, m)
        Diagonal curvature that l_t has at least.
    losses : (T+1, n), (T, m)
        l_t at the trajectory less its minimum over the stated sets; inf where there is none.
    left : float
        The cost of the trajectory less the bound without any of these losses.
    """

    slopes: Pair
    curvatures: Pair
    losses: Pair
    left: float


def stated_bounds(problem: OptimalControlProblem) -> Enclosure:
    """Return the problem's own sets."""
    x, u = problem.state_tube, problem.control_tube
    return Enclosure((x.lower, x.upper), (u.lower, u.upper), np.inf, "the stated sets")


def reachable_bounds(problem: OptimalControlProblem) -> Enclosure:
    """Return the stated sets, cut by what the bounded controls can reach from the initial set."""
    stated = stated_bounds(problem)
    reach = _forward_reach(problem, *stated.u)
    if reach is None:
        return stated
    return Enclosure(_within(stated.x, reach), stated.u, np.inf, f"{stated.follows_from}, forward reach")


def nearby_bounds(
    problem: OptimalControlProblem, trajectory: Trajectory, deviations: Deviations, cost: float, allowed: float
) -> Enclosure | None:
    """Return a box around all trajectories that cost no more than the one given, or None if none follows.

    A bound D adds up what l_t loses on every component. Of a feasible trajectory at distances d that costs no more,

        sum over curved and bounded components of (1/2 m d^2 - |s| |d|, at least minus the loss)
            <= left + sum over all others of |s| |d|  =: q^2,

    so that |d| <= 2 |s|/m + sqrt(2/m) q where there is curvature. The dynamics turn these radii into those of the
    others, all of the form alpha + beta q; then q^2 <= left + losses + a + b q, and q is at most the larger root.
    Nothing is asked of the unknown bounds: that far away the cost is higher.
    """
    known, radii = _known_radii(problem, trajectory, deviations, allowed)
    if not _propagated(problem, trajectory, known, radii):
        return None
    loss = deviations.left
    a, b = np.zeros(2)
    for slope, lost, mask, (alpha, beta) in zip(deviations.slopes, deviations.losses, known, radii, strict=True):
        loss += float(lost[mask].sum())
        a += float((slope * alpha)[~mask].sum())
        b += float((slope * beta)[~mask].sum())
    q = OUTWARD * (b + np.sqrt(b * b + 4 * max(loss + a, 0.0))) / 2
    pairs = list[Pair]()
    boxes = (problem.state_tube, problem.control_tube)
    for signal, box, (alpha, beta) in zip((trajectory.x, trajectory.u), boxes, radii, strict=True):
        radius = OUTWARD * (alpha + beta * q) + (OUTWARD - 1) * np.abs(signal)
        if not np.isfinite(radius).all():
            return None
        pairs.append(_within((box.lower, box.upper), (signal - radius, signal + radius)))
    return Enclosure(pairs[0], pairs[1], cost, "what costs no more than the trajectory")


def _within(bounds: Pair, others: Pair) -> Pair:
    """Return the intersection of two boxes; where they do not meet, and nothing is left, one of the first."""
    lower, upper = np.maximum(bounds[0], others[0]), np.minimum(bounds[1], others[1])
    nearest = np.clip(others[0], *bounds)
    return np.where(lower > upper, nearest, lower), np.where(lower > upper, nearest, upper)


Radii = list[Pair]
"""alpha and beta of |d| <= alpha + beta q, for the states and for the controls."""


def _known_radii(
    problem: OptimalControlProblem, trajectory: Trajectory, deviations: Deviations, allowed: float
) -> tuple[list[Mask], Radii]:
    """Return which components are curved, or lose next to nothing over their bounds, with the radii of those."""
    known, radii = list[Mask](), Radii()
    share = NEGLIGIBLE_SHARE * allowed / sum(lost.size for lost in deviations.losses)
    boxes = (problem.state_tube, problem.control_tube)
    for signal, box, slope, curvature, lost in zip(
        (trajectory.x, trajectory.u), boxes, deviations.slopes, deviations.curvatures, deviations.losses, strict=True
    ):
        far = np.maximum(np.abs(box.lower - signal), np.abs(box.upper - signal))
        curved = (curvature > 0) & (far > 0)
        per = np.where(curved, curvature, 1.0)
        alpha = np.where(curved, 2 * slope / per, far)
        beta = np.where(curved, np.sqrt(2 / per), 0.0)
        mask = curved | (lost <= share)
        known.append(mask)
        radii.append((np.where(mask, alpha, np.inf), np.where(mask, beta, np.inf)))
    return known, radii


def _propagated(problem: OptimalControlProblem, trajectory: Trajectory, known: list[Mask], radii: Radii) -> bool:
    """Fill in the radii that the dynamics imply of those known; whether none is left."""
    residual = np.abs(state_residual(problem, trajectory))
    residual += (OUTWARD - 1) * np.abs(trajectory.x[1:])
    rows = _two_sided_rows(problem, trajectory)
    _one_step(problem.linear.at(0)[:2], residual[0], rows.get(0, []), 0, radii)
    (alpha_x, beta_x), (alpha_u, beta_u) = radii
    if np.isfinite(alpha_u).all() and np.isfinite(alpha_x[0]).all():
        unknown = np.isinf(alpha_x)
        if unknown.any():
            along_alpha = _spread(problem.linear, alpha_x[0], alpha_u, residual)
            along_beta = _spread(problem.linear, beta_x[0], beta_u, np.zeros_like(residual))
            alpha_x[unknown], beta_x[unknown] = along_alpha[unknown], along_beta[unknown]
        return bool(np.isfinite(alpha_x).all() and np.isfinite(beta_x).all())
    if problem.horizon > MOST_STEPS:
        return False
    steps = range(problem.horizon)
    for times in (steps, reversed(steps), steps):
        for t in times:
            _one_step(problem.linear.at(t)[:2], residual[t], rows.get(t, []), t, radii)
    _all_steps(problem.linear, residual, radii)
    return all(bool(np.isfinite(part).all()) for pair in radii for part in pair)


def _two_sided_rows(problem: OptimalControlProblem, trajectory: Trajectory) -> dict[int, list[tuple[Array, float]]]:
    """Return, per time, rows of (x_t, u_t) whose values cannot move farther than the distance that stands with them.

    These are the rows around norm balls, and those of half-spaces of which there are two, opposite.
    """
    found: dict[int, list[tuple[Array, float]]] = {}
    signals = np.hstack([trajectory.x, np.vstack([trajectory.u, np.zeros(problem.control_dim)])])
    for term in problem.terms:
        rows = term.implied_rows(problem.state_dim, problem.control_dim)
        if rows is None:
            continue
        for group, t in enumerate(rows.times):
            matrix = rows.matrix(group)
            distances = _opposite(matrix, np.maximum(rows.e[group] - matrix @ signals[t], 0.0))
            found.setdefault(int(t), []).extend((row, one) for row, one in distances if np.isfinite(one) and row.any())
    return found


def _opposite(matrix: Array, slack: Array) -> list[tuple[Array, float]]:
    """Return rows of which the opposite is a row, too, with the larger of both slacks."""
    return [
        (row, max(float(slack[i]), float(slack[j])))
        for i, row in enumerate(matrix)
        for j in range(i + 1, len(matrix))
        if np.array_equal(row, -matrix[j])
    ]


def _one_step(matrices: Pair, residual: Array, rows: list[tuple[Array, float]], t: int, radii: Radii) -> None:
    """Fill in the components of x_t, u_t, x_{t+1} that the equation and the rows of this step say of the others."""
    A, B = matrices
    columns = np.hstack([A, B, -np.eye(len(A))])
    if rows:
        columns = np.vstack([columns, [np.append(row, np.zeros(len(A))) for row, _ in rows]])
        residual = np.append(residual, [distance for _, distance in rows])
    (alpha_x, beta_x), (alpha_u, beta_u) = radii
    alpha = np.concatenate([alpha_x[t], alpha_u[t], alpha_x[t + 1]])
    unknown = np.isinf(alpha)
    if not unknown.any() or unknown.sum() > len(columns):
        return
    inverse = np.linalg.pinv(columns[:, unknown])
    if np.abs(inverse @ columns[:, unknown] - np.eye(int(unknown.sum()))).max() > DETERMINED:
        return
    size, given = OUTWARD * np.abs(inverse), np.abs(columns[:, ~unknown])
    beta = np.concatenate([beta_x[t], beta_u[t], beta_x[t + 1]])
    alpha[unknown] = size @ (given @ alpha[~unknown] + residual)
    beta[unknown] = size @ (given @ beta[~unknown])
    n, m = B.shape
    for part, values in ((alpha_x, alpha), (beta_x, beta)):
        part[t], part[t + 1] = values[:n], values[n + m :]
    alpha_u[t], beta_u[t] = alpha[n : n + m], beta[n : n + m]


def _all_steps(dynamics: LinearDynamics, residual: Array, radii: Radii) -> None:
    """Fill in what the equations of all steps together determine, as a free state whose ends are fixed in part."""
    (alpha_x, beta_x), (alpha_u, beta_u) = radii
    unknown = np.isinf(np.concatenate([alpha_x.ravel(), alpha_u.ravel()]))
    if not 0 < unknown.sum() <= min(MOST_UNKNOWN, residual.size):
        return
    T, n = residual.shape
    columns, of_u = np.zeros((T, n, len(unknown))), (T + 1) * n + np.arange(T * alpha_u.shape[1]).reshape(T, -1)
    for t in range(T):
        A, B, _ = dynamics.at(t)
        columns[t][:, t * n : (t + 1) * n], columns[t][:, of_u[t]] = A, B
        columns[t][:, (t + 1) * n : (t + 2) * n] = -np.eye(n)
    matrix = columns.reshape(T * n, -1)
    Q, R = np.linalg.qr(matrix[:, unknown])
    if np.abs(np.diag(R)).min() <= DETERMINED * np.abs(R).max():
        return
    inverse = solve_triangular(R, Q.T)
    if np.abs(inverse @ matrix[:, unknown] - np.eye(int(unknown.sum()))).max() > DETERMINED:
        return
    size, given = OUTWARD * np.abs(inverse), np.abs(matrix[:, ~unknown])
    for of_x, of_controls, moved in ((alpha_x, alpha_u, residual.ravel()), (beta_x, beta_u, np.zeros(T * n))):
        values = np.concatenate([of_x.ravel(), of_controls.ravel()])
        values[unknown] = size @ (given @ values[~unknown] + moved)
        of_x[:] = values[: of_x.size].reshape(of_x.shape)
        of_controls[:] = values[of_x.size :].reshape(of_controls.shape)


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
    none = np.zeros((problem.horizon, problem.state_dim))
    radius = OUTWARD * _spread(problem.linear, (start.upper - start.lower) / 2, (u_upper - u_lower) / 2, none)
    if not np.isfinite(radius).all():
        return None
    rounding = (OUTWARD - 1) * (np.abs(centre) + radius)
    return centre - radius - rounding, centre + radius + rounding


def _spread(dynamics: LinearDynamics, radius_0: Array, radius_u: Array, radius_d: Array) -> Array:
    """Return how far x_t can be away, (T+1, n), if x_0, u_t and the offsets are away by radii (n,), (T, m), (T, n)."""
    inputs = np.hstack([radius_u, radius_d])
    with np.errstate(over="ignore", invalid="ignore"):
        if dynamics.time_varying:
            return _spread_step_by_step(dynamics, radius_0, inputs)
        return _spread_in_blocks(dynamics, radius_0, inputs.max(0), len(inputs))


def _spread_step_by_step(dynamics: LinearDynamics, radius_0: Array, inputs: Array) -> Array:
    n, spread = len(radius_0), [radius_0]
    transition, responses = np.eye(n), np.empty((0, n, inputs.shape[1]))
    for t in range(len(inputs)):
        A, B, _ = dynamics.at(t)
        responses = np.concatenate([A @ responses, np.hstack([B, np.eye(n)])[None]])
        transition = A @ transition
        spread.append(np.einsum("sij,sj->i", np.abs(responses), inputs[: t + 1]) + np.abs(transition) @ radius_0)
    return np.array(spread)


def _spread_in_blocks(dynamics: LinearDynamics, radius_0: Array, largest: Array, T: int) -> Array:
    """Return the same for constant dynamics and radii of inputs (m + n,), with powers of A by blocks."""
    A, B, _ = dynamics.at(0)
    n, count = len(A), min(BLOCK, T + 1)
    powers = np.empty((count, n, n))
    powers[0] = np.eye(n)
    for k in range(1, count):
        powers[k] = A @ powers[k - 1]
    inputs, whole, first = np.hstack([B, np.eye(n)]), A @ powers[-1], np.eye(n)
    of_inputs, of_start = np.empty((T + 1, n)), np.empty((T + 1, n))
    for start in range(0, T + 1, count):
        block = powers[: T + 1 - start] @ first
        of_start[start : start + count] = np.abs(block) @ radius_0
        of_inputs[start : start + count] = np.abs(block @ inputs) @ largest
        first = whole @ first
    sums = np.vstack([np.zeros(n), np.cumsum(of_inputs[:-1], axis=0)])
    return sums + of_start
