"""Boxes that contain an optimum: the stated sets, the reachable set, trajectories that cost no more than one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.errors import NumericalError
from lin_freq_ocp.certificate.hamiltonian import state_residual
from lin_freq_ocp.certificate.tolerances import (
    INVERSE_TOLERANCE,
    MAX_STEPS,
    MAX_UNKNOWN,
    MOST_BENT,
    NEGLIGIBLE_SHARE,
    POWER_BLOCK,
    RADIUS_MARGIN,
)
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transform.simulation import simulate

Pair = tuple[Array, Array]
TwoSided = dict[int, list[tuple[Array, float]]]  # per time, rows of (x_t, u_t) and the distance that they can move


@dataclass(frozen=True, eq=False)
class Region:
    """A box (lower, upper) around every optimum: x (T+1, n), u (T, m).

    Trajectories outside the box cost at least ``level``, inf if none is feasible. ``follows_from`` is the reason.
    """

    x: Pair
    u: Pair
    level: float
    follows_from: str


@dataclass(frozen=True, eq=False)
class Deviations:
    """Losses of a bound on every state (T+1, n) and control (T, m): they limit the distance of a better trajectory.

    Attributes
    ----------
    slopes, curvatures : Pair
        |slope| of l_t, rounding errors included, and a lower bound of the diagonal curvature of l_t.
    losses : Pair
        l_t at the trajectory less its minimum over the stated sets; inf if it has no minimum.
    left : float
        The cost of the trajectory less the bound without these losses.
    """

    slopes: Pair
    curvatures: Pair
    losses: Pair
    left: float


def stated_bounds(problem: OptimalControlProblem) -> Region:
    """Return the problem's own sets; a control without any bin is zero."""
    of_u, silent = problem.control_tube.bounds, problem.control_stop.all(axis=0)
    if silent.any():
        rest = np.clip(0.0, *of_u)
        of_u = np.where(silent, rest, of_u[0]), np.where(silent, rest, of_u[1])
    return Region(problem.state_tube.bounds, of_u, np.inf, "the stated sets")


def reachable_bounds(problem: OptimalControlProblem) -> Region:
    """Return the intersection of the stated sets with the states that the controls reach from the initial set.

    States that an unbounded control or initial state affects have no other bounds than the stated ones.
    """
    stated = stated_bounds(problem)
    reach = None if problem.response is not None else _forward_reach(problem, *stated.u)
    if reach is None:
        return stated
    return Region(_intersection(stated.x, reach), stated.u, np.inf, f"{stated.follows_from}, forward reach")


@lru_cache(maxsize=1)  # for the rays of one problem, one after another
def implied_bounds(problem: OptimalControlProblem) -> Region:
    """Return the reachable set with the bounds that it, the dynamics and other constraints imply."""
    region, tubes = reachable_bounds(problem), (problem.state_tube, problem.control_tube)
    signals, boxes = [tube.project(np.zeros_like(tube.lower)) for tube in tubes], (region.x, region.u)
    far = [np.maximum(np.abs(low - z), np.abs(high - z)) for z, (low, high) in zip(signals, boxes, strict=True)]
    x, u = (np.stack([radius, np.zeros_like(radius)]) for radius in far)
    _propagate_radii(problem, Trajectory(*signals), (x, u))
    pairs = [
        _intersection(box, (signal - RADIUS_MARGIN * radius[0], signal + RADIUS_MARGIN * radius[0]))
        for signal, box, radius in zip(signals, boxes, (x, u), strict=True)
    ]
    return Region(pairs[0], pairs[1], np.inf, f"{region.follows_from}, constraints and dynamics")


def nearby_bounds(
    problem: OptimalControlProblem, trajectory: Trajectory, deviations: Deviations, cost: float, allowed: float
) -> Region | None:
    """Return a box around all trajectories that cost no more than the given trajectory, or None if none is known.

    A bound D adds up the losses of l_t on every component. A feasible trajectory at distances d that costs no more has

        sum over curved and bounded components of (1/2 m d^2 - |s| |d|, at least minus the loss)
            <= left + sum over all others of |s| |d| + 1/2 |m| d^2  =: q^2,

    so that |d| <= 2 |s|/m + sqrt(2/m) q where there is curvature; m of the others is zero, or below by rounding. The
    dynamics turn these radii into those of the others, all of the form alpha + beta q; then
    q^2 <= left + losses + a + b q + c q^2, and q is at most the larger root if c < 1.
    Missing bounds do not matter: the cost is higher that far away.
    """
    known, radii = _known_radii(problem, trajectory, deviations, allowed)
    if not _propagate_radii(problem, trajectory, radii):
        return None
    loss, a, b, c = deviations.left, 0.0, 0.0, 0.0
    for slope, curvature, lost, mask, (alpha, beta) in zip(
        deviations.slopes, deviations.curvatures, deviations.losses, known, radii, strict=True
    ):
        bent = np.maximum(-curvature, 0.0)
        loss += float(lost[mask].sum())
        a += float(((slope + 0.5 * bent * alpha) * alpha)[~mask].sum())
        b += float(((slope + bent * alpha) * beta)[~mask].sum())
        c += float((0.5 * bent * beta**2)[~mask].sum())
    if not c < MOST_BENT:
        return None
    q = RADIUS_MARGIN * (b + np.sqrt(b * b + 4 * (1 - c) * max(loss + a, 0.0))) / (2 * (1 - c))
    pairs = list[Pair]()
    boxes = (problem.state_tube, problem.control_tube)
    for signal, box, (alpha, beta) in zip((trajectory.x, trajectory.u), boxes, radii, strict=True):
        radius = RADIUS_MARGIN * (alpha + beta * q) + (RADIUS_MARGIN - 1) * np.abs(signal)
        if not np.isfinite(radius).all():
            return None
        pairs.append(_intersection((box.lower, box.upper), (signal - radius, signal + radius)))
    return Region(pairs[0], pairs[1], cost, "trajectories that cost no more than this one")


def _intersection(bounds: Pair, others: Pair) -> Pair:
    """Return the intersection of two boxes; where it is empty, the nearest point of the first."""
    lower, upper = np.maximum(bounds[0], others[0]), np.minimum(bounds[1], others[1])
    nearest = np.clip(others[0], *bounds)
    return np.where(lower > upper, nearest, lower), np.where(lower > upper, nearest, upper)


def _known_radii(
    problem: OptimalControlProblem, trajectory: Trajectory, deviations: Deviations, allowed: float
) -> tuple[list[Mask], Pair]:
    """Return which components are curved, or have negligible losses over their bounds, with their radii.

    Radii are alpha and beta of |d| <= alpha + beta q, stacked: (2, T+1, n) and (2, T, m); inf where unknown.
    """
    known, radii = list[Mask](), list[Array]()
    share = NEGLIGIBLE_SHARE * allowed / sum(lost.size for lost in deviations.losses)
    boxes = (problem.state_tube, problem.control_tube)
    for signal, box, slope, curvature, lost in zip(
        (trajectory.x, trajectory.u), boxes, deviations.slopes, deviations.curvatures, deviations.losses, strict=True
    ):
        far = np.maximum(np.abs(box.lower - signal), np.abs(box.upper - signal))
        curved = (curvature > 0) & (far > 0)
        divisor = np.where(curved, curvature, 1.0)
        radius = np.where(curved, [2 * slope / divisor, np.sqrt(2 / divisor)], [far, np.zeros_like(far)])
        mask = curved | (lost <= share) | (far == 0)
        known.append(mask)
        radii.append(np.where(mask, radius, np.inf))
    return known, (radii[0], radii[1])


def _propagate_radii(problem: OptimalControlProblem, trajectory: Trajectory, radii: Pair) -> bool:
    """Fill in the radii that the dynamics imply; return whether all are known."""
    x, u = radii
    residual = np.abs(state_residual(problem, trajectory))
    residual += (RADIUS_MARGIN - 1) * np.abs(trajectory.x[1:])
    rows = _two_sided_rows(problem, trajectory)
    left = np.zeros(problem.horizon, dtype=int)
    _propagate_one_step(problem, residual, rows, 0, radii, left)
    if problem.response is None and np.isfinite(u[0]).all() and np.isfinite(x[0, 0]).all():
        unknown = np.isinf(x[0])
        if unknown.any():
            for side, moved in enumerate((residual, np.zeros_like(residual))):
                x[side, unknown] = _radii_of(problem.linear, x[side, 0], u[side], moved)[unknown]
        return bool(np.isfinite(x).all())
    if problem.horizon > MAX_STEPS:
        return False
    steps = range(problem.horizon)
    for t in (*steps, *reversed(steps), *steps):
        _propagate_one_step(problem, residual, rows, t, radii, left)
    _solve_all_steps(problem, trajectory, residual, radii)
    return all(bool(np.isfinite(part).all()) for part in radii)


def _two_sided_rows(problem: OptimalControlProblem, trajectory: Trajectory) -> TwoSided:
    """Return, per time, rows of (x_t, u_t) with the largest distance that their values can move.

    These are the rows around norm balls, and pairs of opposite half-spaces.
    """
    two_sided: TwoSided = {}
    signals = np.hstack([trajectory.x, np.vstack([trajectory.u, np.zeros(problem.control_dim)])])
    for term in problem.terms:
        rows = term.implied_rows(problem.state_dim, problem.control_dim)
        if rows is None:
            continue
        for group, t in enumerate(rows.times):
            matrix = rows.matrix(group)
            units = _units_of(matrix, axis=1)
            matrix, limits = matrix / units[:, None], rows.e[group] / units
            slack = np.maximum(limits - matrix @ signals[t], 0.0)
            for i, row in enumerate(matrix):
                for j in range(i + 1, len(matrix)):
                    distance = max(float(slack[i]), float(slack[j]))
                    if np.array_equal(row, -matrix[j]) and np.isfinite(distance) and row.any():
                        two_sided.setdefault(int(t), []).append((row, distance))
    return two_sided


def _propagate_one_step(
    problem: OptimalControlProblem, residual: Array, rows: TwoSided, t: int, radii: Pair, left: Indices
) -> None:
    """Fill in the components of x_t, u_t, x_{t+1} that the equation and the rows of this step imply.

    ``left`` (T,) says how many stay unknown: with so many, the step implies no more.
    """
    n, m, (x, u) = problem.state_dim, problem.control_dim, radii
    values = np.concatenate([x[:, t], u[:, t], x[:, t + 1]], axis=1)
    if np.count_nonzero(np.isinf(values[0])) in (0, left[t]):
        return
    rows_here = rows.get(t, [])
    columns, distances = [np.append(row, np.zeros(n)) for row, _ in rows_here], [distance for _, distance in rows_here]
    if problem.response is None:  # no single step of a response says anything
        A, B, _ = problem.linear.at(t)
        columns, distances = [*np.hstack([A, B, -np.eye(n)]), *columns], [*residual[t], *distances]
    if columns and _determine_radii(np.array(columns), np.array(distances), values):
        x[:, t], u[:, t], x[:, t + 1] = values[:, :n], values[:, n : n + m], values[:, n + m :]
    left[t] = np.count_nonzero(np.isinf(values[0]))


def _solve_all_steps(problem: OptimalControlProblem, trajectory: Trajectory, residual: Array, radii: Pair) -> None:
    """Fill in radii that only equations and two-sided constraints of all times determine.

    Such are those of a free state with partly fixed ends, and of a signal whose bins are all limited.
    """
    x, u = radii
    values = np.concatenate([part.reshape(2, -1) for part in radii], axis=1)
    if not 0 < np.isinf(values[0]).sum() <= MAX_UNKNOWN:
        return
    T, n = residual.shape
    columns, of_u = np.zeros((T, n, values.shape[1])), (T + 1) * n + np.arange(u[0].size).reshape(T, -1)
    if problem.response is not None:
        columns[..., x[0].size :] = problem.response.matrix[n:].reshape(T, n, -1)
    for t in range(T):
        if problem.response is None:
            A, B, _ = problem.linear.at(t)
            columns[t][:, t * n : (t + 1) * n], columns[t][:, of_u[t]] = A, B
        columns[t][:, (t + 1) * n : (t + 2) * n] = -np.eye(n)
    rows, distances = [columns.reshape(T * n, -1)], [residual.ravel()]
    for term in problem.terms:
        at = term.map.values(trajectory.x, trajectory.u)
        distance = np.max([np.abs(side - at) for side in term.penalty.hard_bounds(term.shape)], axis=0).ravel()
        limited = np.flatnonzero(np.isfinite(distance))
        rows.append(term.map.rows(T, n, problem.control_dim)[0][limited].toarray())
        distances.append(distance[limited])
    if _determine_radii(np.vstack(rows), np.concatenate(distances), values):
        x[:], u[:] = values[:, : x[0].size].reshape(x.shape), values[:, x[0].size :].reshape(u.shape)


def _determine_radii(columns: Array, residual: Array, values: Array) -> bool:
    """Fill in the unknown radii, values (2, k), that |columns d| <= residual implies; return whether it implies any.

    Rows that share no unknown component with others say what they say without these.
    """
    unknown = np.flatnonzero(np.isinf(values[0]))
    bounds = _radii_of_block(columns, residual, values, unknown)
    if bounds is not None:
        values[:, unknown] = bounds
        return True
    present = columns[:, unknown] != 0
    block_of = np.arange(len(unknown))  # the last component of each block
    for row in present:
        block_of[(block_of[:, None] == block_of[row]).any(axis=1)] = block_of[row].max(initial=0)
    blocks, filled = np.unique(block_of), False
    for block in blocks if len(blocks) > 1 else ():
        chosen = block_of == block
        rows = present[:, chosen].any(axis=1)
        bounds = _radii_of_block(columns[rows], residual[rows], values, unknown[chosen])
        if bounds is not None:
            values[:, unknown[chosen]], filled = bounds, True
    return filled


def _radii_of_block(columns: Array, residual: Array, values: Array, unknown: Indices) -> Array | None:
    """Return the radii of the unknown components of these rows alone; None if the rows do not bound them.

    Rows and components are in units in which their largest coefficients are 1: a left inverse that is accurate in one
    choice of units of the states may not be in another.
    """
    if len(unknown) > len(columns):
        return None
    block = columns[:, unknown]
    of_rows = _units_of(block, axis=1)
    units = _units_of(block / of_rows[:, None], axis=0)
    block = block / of_rows[:, None] / units
    Q, R = np.linalg.qr(block)
    if not np.diag(R).all():
        return None
    inverse = np.linalg.solve(R, Q.T)  # not SciPy's: its threads and NumPy's wait for each other
    if not np.abs(inverse @ block - np.eye(len(R))).max() <= INVERSE_TOLERANCE:
        return None
    known = columns.any(axis=0) & ~np.isinf(values[0])
    bounds = values[:, known] @ np.abs(columns[:, known]).T + np.stack([residual, np.zeros_like(residual)])
    return bounds / of_rows @ (RADIUS_MARGIN * np.abs(inverse)).T / units


def _units_of(coefficients: Array, axis: int) -> Array:
    """Return the largest absolute value along an axis, 1 where all are zero."""
    largest = np.abs(coefficients).max(axis=axis)
    return np.where(largest > 0, largest, 1.0)


def _forward_reach(problem: OptimalControlProblem, u_lower: Array, u_upper: Array) -> Pair | None:
    """Return an interval around every state reachable from X_0; None if the simulation overflows.

    x_t lies within sum_s |A_{t-1} .. A_{s+1} B_s| r_s + |A_{t-1} .. A_0| r_0 of the trajectory of the interval centres.
    """
    start, none = problem.initial_box, np.zeros((problem.horizon, problem.state_dim))
    boxes = [(u_lower, u_upper), (start.lower, start.upper)]
    free_u, free_0 = (np.isinf(lower) | np.isinf(upper) for lower, upper in boxes)
    free = _affected_states(problem.linear, free_0, free_u)
    if free[1:].all():
        return None
    boxes = [tuple(np.where(one, 0.0, side) for side in box) for one, box in zip((free_u, free_0), boxes, strict=True)]
    try:
        centre = simulate(problem, *((lower + upper) / 2 for lower, upper in boxes)).x
    except NumericalError:
        return None
    radius_u, radius_0 = ((upper - lower) / 2 for lower, upper in boxes)
    radius = RADIUS_MARGIN * _radii_of(problem.linear, radius_0, radius_u, none)
    radius = np.where(free | ~np.isfinite(radius), np.inf, radius)
    rounding = (RADIUS_MARGIN - 1) * (np.abs(centre) + radius)
    return centre - radius - rounding, centre + radius + rounding


def _affected_states(dynamics: LinearDynamics, start: Mask, controls: Mask) -> Mask:
    """Return which states, (T+1, n), depend on these components of the initial state (n,) and controls (T, m)."""
    affected = np.zeros((len(controls) + 1, len(start)), dtype=bool)
    affected[0] = start
    if start.any() or controls.any():
        for t, chosen in enumerate(controls):
            A, B, _ = dynamics.at(t)
            affected[t + 1] = (A[:, affected[t]] != 0).any(1) | (B[:, chosen] != 0).any(1)
    return affected


def _radii_of(dynamics: LinearDynamics, radius_0: Array, radius_u: Array, radius_d: Array) -> Array:
    """Return the radii of x_t, (T+1, n), from the radii of x_0 (n,), u_t (T, m) and the offsets (T, n)."""
    inputs = np.hstack([radius_u, radius_d])
    with np.errstate(over="ignore", invalid="ignore"):
        if not dynamics.time_varying:
            return constant_radii(dynamics, radius_0, inputs.max(0), len(inputs))
        n, spread = len(radius_0), [radius_0]
        transition, responses = np.eye(n), np.empty((0, n, inputs.shape[1]))
        for t in range(len(inputs)):
            A, B, _ = dynamics.at(t)
            responses = np.concatenate([A @ responses, np.hstack([B, np.eye(n)])[None]])
            transition = A @ transition
            spread.append(np.einsum("sij,sj->i", np.abs(responses), inputs[: t + 1]) + np.abs(transition) @ radius_0)
        return np.array(spread)


def constant_radii(dynamics: LinearDynamics, radius_0: Array, largest: Array, T: int) -> Array:
    """Return the same for constant dynamics and radii of inputs (m + n,), with powers of A by blocks.

    For k starts and inputs, (n, k) and (m + n, k): (T+1, n, k).
    """
    A, B, _ = dynamics.at(0)
    n, count = len(A), min(POWER_BLOCK, T + 1)
    powers = np.eye(n)[None]
    while len(powers) < count:
        powers = np.concatenate([powers, powers[: count - len(powers)] @ (A @ powers[-1])])
    inputs, whole, first = np.hstack([B, np.eye(n)]), A @ powers[-1], np.eye(n)
    of_inputs, of_start = np.empty((T + 1, *radius_0.shape)), np.empty((T + 1, *radius_0.shape))
    for start in range(0, T + 1, count):
        block = powers[: T + 1 - start] @ first
        of_start[start : start + count] = np.abs(block) @ radius_0
        of_inputs[start : start + count] = np.abs(block @ inputs) @ largest
        first = whole @ first
    return np.concatenate([np.zeros((1, *radius_0.shape)), np.cumsum(of_inputs[:-1], axis=0)]) + of_start
