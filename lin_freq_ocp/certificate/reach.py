"""Boxes that contain an optimum: the stated sets, the reachable set, trajectories that cost no more than one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask, split_signals, stack_signals
from lin_freq_ocp.base.errors import NumericalError
from lin_freq_ocp.certificate.hamiltonian import state_residual
from lin_freq_ocp.certificate.tolerances import (
    INVERSE_TOLERANCE,
    MAX_STEPS,
    MAX_UNKNOWN,
    MOST_BENT,
    NEGLIGIBLE_SHARE,
    NUMERICAL_REACH,
    RADIUS_MARGIN,
)
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transform.simulation import constant_radii, growth, simulate

Pair = tuple[Array, Array]
Rows = dict[int, list[Pair]]  # per time, rows of (x_t, u_t) and how far their values can rise
MOST_ONE_SIDED = 100  # components whose one-sided bounds are combined at once, in a second; of more, none are


@dataclass(frozen=True, eq=False)
class Region:
    """Bounds (lower, upper) of z_t = (x_t, u_t), (T+1, n + m) with zeros for u_T, around every optimum.

    Trajectories outside the box cost at least ``level``, inf if none is feasible. ``follows_from`` is the reason.
    """

    bounds: Pair
    level: float
    follows_from: str


@dataclass(frozen=True, eq=False)
class Deviations:
    """Losses of a bound on every component of z_t, (T+1, n + m): they limit the distance of a better trajectory.

    Those of N trajectories have a leading axis.

    Attributes
    ----------
    slopes : (2, T+1, n + m)
        The least and the greatest slope of l_t within rounding errors.
    curvatures : (T+1, n + m)
        A lower bound of the diagonal curvature of l_t.
    losses : (T+1, n + m)
        l_t at the trajectory less its minimum over the stated sets; inf if it has no minimum.
    left : float
        The cost of the trajectory less the bound without these losses.
    """

    slopes: Array
    curvatures: Array
    losses: Array
    left: Array | float


def stated_bounds(problem: OptimalControlProblem) -> Region:
    """Return the problem's own sets; a control without any bin is zero."""
    lower, upper = problem.signal_bounds
    silent = np.append(np.zeros(problem.state_dim, dtype=bool), problem.control_stop.all(axis=0))
    if silent.any():
        rest = np.clip(0.0, lower, upper)
        lower, upper = np.where(silent, rest, lower), np.where(silent, rest, upper)
    return Region((lower, upper), np.inf, "the stated sets")


def reachable_bounds(problem: OptimalControlProblem) -> Region:
    """Return the intersection of the stated sets with the states that the controls reach from the initial set.

    States that an unbounded control or initial state affects have no other bounds than the stated ones.
    """
    stated = stated_bounds(problem)
    reach = None if problem.response is not None else _forward_reach(problem, stated.bounds)
    if reach is None:
        return stated
    return Region(_intersection(stated.bounds, reach), np.inf, f"{stated.follows_from}, forward reach")


@lru_cache(maxsize=1)  # for the rays of one problem, one after another
def implied_bounds(problem: OptimalControlProblem) -> Region:
    """Return the reachable set with the bounds that it, the dynamics and other constraints imply."""
    region, z = reachable_bounds(problem), np.clip(0.0, *problem.signal_bounds)
    radii = _stated_radii(z, region.bounds)
    _propagate_radii(problem, z, radii)
    above, below = RADIUS_MARGIN * radii[0]
    bounds = _intersection(region.bounds, (z - below, z + above))
    return Region(bounds, np.inf, f"{region.follows_from}, constraints and dynamics")


def nearby_bounds(
    problem: OptimalControlProblem,
    z: Array,
    deviations: Deviations,
    cost: float,
    allowed: float,
    mistrusted: bool = False,
) -> Region | None:
    """Return a box around all trajectories that cost no more than z, stacked signals, or None if none is known.

    A bound D adds up the losses of l_t on every component. A feasible trajectory at distances d that costs no more has

        sum over curved and bounded components of (1/2 m d^2 - |s| |d|, at least minus the loss)
            <= left + sum over all others of |s| |d| + 1/2 |m| d^2  =: q^2,

    so that |d| <= 2 |s|/m + sqrt(2/m) q where there is curvature; m of the others is zero, or below by rounding. The
    dynamics turn these radii into those of the others, all of the form alpha + beta q + gamma q^2, above and below;
    then q^2 <= left + losses + a + b q + c q^2, and q is at most the larger root if c < 1.
    Where no part of the cost can be negative, none of its terms costs more than the trajectory.
    Missing bounds do not matter: the cost is higher that far away. Components without a loss over the stated sets need
    no radius. Where these radii do not suffice, others count:
    stated bounds, or |d| <= q^2/s where the cost rises at least by s. Far ones come last, as they may be large numbers
    in place of none; if ``mistrusted``, also where the loss of the stated bounds is negligible.
    """
    level = max(float(deviations.left), 0.0) + allowed
    known, radii, others = _known_radii(problem, z, deviations, allowed, level)
    # the smaller radius of a component, and those within the reach of the values of the signal
    alpha, beta, gamma = others
    extent = alpha + gamma * level
    is_near = extent <= np.maximum(extent[::-1], NUMERICAL_REACH * np.abs(z).max(axis=0))
    near = np.stack([np.where(is_near, alpha, np.inf), beta, gamma])
    if mistrusted and not _replace(radii, near, deviations.curvatures <= 0):
        return None  # the same as with trust
    changed, lossless = True, deviations.losses == 0
    level_of_terms = cost if cost_is_never_negative(problem) and not problem.cost.has_formulas else np.inf
    for further in (near, others, None):
        if changed:
            _propagate_radii(problem, z, radii, level_of_terms)
            if (np.isfinite(radii[0]) | lossless).all():
                break
        if further is None:
            return None
        changed = _replace(radii, further, np.isinf(radii[0]))
    return box_around(problem, z, deviations, cost, radii, known)


def box_around(
    problem: OptimalControlProblem, z: Array, deviations: Deviations, cost: float, radii: Array, known: Mask
) -> Region | None:
    """Return the box of these radii around z; of known components count the losses, of others the slopes."""
    slope, bent = np.abs(deviations.slopes).max(0), np.maximum(-deviations.curvatures, 0.0)
    alpha, beta, gamma = np.where(known, 0.0, radii.max(1))
    loss = deviations.left + float(deviations.losses[known].sum())
    a = float(((slope + 0.5 * bent * alpha) * alpha).sum())
    b = float(((slope + bent * alpha) * beta).sum())
    c = float((slope * gamma + 0.5 * bent * beta**2).sum())
    if (bent * gamma).any() or not c < MOST_BENT:
        return None
    q = RADIUS_MARGIN * (b + np.sqrt(b * b + 4 * (1 - c) * max(loss + a, 0.0))) / (2 * (1 - c))
    alpha, beta, gamma = radii
    above, below = RADIUS_MARGIN * (alpha + beta * q + gamma * q * q) + (RADIUS_MARGIN - 1) * np.abs(z)
    if not (np.isfinite([above, below]) | (deviations.losses == 0)).all():
        return None
    bounds = _intersection(problem.signal_bounds, (z - below, z + above))
    return Region(bounds, cost, "trajectories that cost no more than this one")


def cost_is_never_negative(problem: OptimalControlProblem) -> bool:
    """Whether the cost without formulas is a sum of squares, norms and penalties, exactly semidefinite."""
    cost = problem.quadratic
    if any(np.any(part) for part in (cost.q, cost.r, cost.p)):
        return False
    stage, end = cost.rises
    return not stage.any() and end == 0


def _replace(radii: Array, others: Array, chosen: Mask) -> bool:
    """Replace the chosen radii by others, and return whether any differ."""
    before = radii.copy()
    radii[:] = np.where(chosen, others, radii)
    return not np.array_equal(radii, before)


def _intersection(bounds: Pair, others: Pair) -> Pair:
    """Return the intersection of two boxes; where it is empty, the nearest point of the first."""
    lower, upper = np.maximum(bounds[0], others[0]), np.minimum(bounds[1], others[1])
    nearest = np.clip(others[0], *bounds)
    return np.where(lower > upper, nearest, lower), np.where(lower > upper, nearest, upper)


def _stated_radii(values: Array, bounds: Pair) -> Array:
    """Return the distances of values from their upper and lower bounds, 0 beyond them, as radii (3, 2, ..)."""
    sides = np.maximum([bounds[1] - values, values - bounds[0]], 0.0)
    return np.stack([sides, np.zeros_like(sides), np.zeros_like(sides)])


def _known_radii(
    problem: OptimalControlProblem, z: Array, deviations: Deviations, allowed: float, level: float
) -> tuple[Mask, Array, Array]:
    """Return which components are curved, or have negligible losses over their bounds, their radii, and other radii.

    Radii are alpha, beta and gamma of d <= alpha + beta q + gamma q^2, and of -d: (3, 2, T+1, n + m); inf where
    unknown. The others are those of the stated bounds or, if less where q^2 is the ``level``, of the rise of the cost.
    """
    slopes, curvature, lost = deviations.slopes, deviations.curvatures, deviations.losses
    share = NEGLIGIBLE_SHARE * allowed / (lost.size - problem.control_dim)
    stated = _stated_radii(z, problem.signal_bounds)
    curved = (curvature > 0) & (stated[0] > 0).any(0)
    divisor, slope = np.where(curved, curvature, 1.0), np.abs(slopes).max(0)
    of_curved = np.stack([2 * slope / divisor, np.sqrt(2 / divisor), np.zeros_like(divisor)])[:, None]
    known = curved | (lost <= share) | (stated[0] == 0).all(0)
    radii = np.where(known, np.where(curved, of_curved, stated), np.inf)
    rises = np.where(known & (curvature >= 0), [slopes[0], -slopes[1]], 0.0)
    gamma = RADIUS_MARGIN / np.where(rises > 0, rises, 1.0)
    steep = (rises > 0) & (gamma * level < stated[0])
    return known, radii, np.where(steep, [np.zeros_like(gamma), np.zeros_like(gamma), gamma], stated)


def largest_residual(problem: OptimalControlProblem, trajectory: Trajectory) -> Array:
    """Return a bound on |x_{t+1} - f_t(x_t, u_t)| with its rounding, (T, n)."""
    return np.abs(state_residual(problem, trajectory)) + (RADIUS_MARGIN - 1) * np.abs(trajectory.x[1:])


def _propagate_radii(problem: OptimalControlProblem, z: Array, radii: Array, level: float = np.inf) -> None:
    """Fill in the radii around z that the dynamics imply, and terms whose cost is at most ``level``."""
    (x, u), trajectory = split_signals(radii, problem.state_dim), Trajectory(*split_signals(z, problem.state_dim))
    residual, rows = largest_residual(problem, trajectory), _rows_of_steps(problem, z, level)
    left, barren = np.zeros(problem.horizon, dtype=int), set[bytes]()
    _propagate_one_step(problem, residual, rows, 0, radii, (left, barren), radii)
    if problem.response is None and np.isfinite(u[0]).all() and np.isfinite(x[0, :, 0]).all():
        unknown = np.isinf(x[0])
        if unknown.any():
            for power, (part, inputs) in enumerate(zip(x, u.max(1), strict=True)):
                moved = residual if power == 0 else np.zeros_like(residual)
                part[:] = np.where(unknown, _radii_of(problem.linear, part[:, 0].max(0), inputs, moved), part)
        return
    if problem.horizon > MAX_STEPS:
        return
    steps = range(problem.horizon)
    # each step alone comes first: radii grow with every step that they pass; without a new one, others imply none
    for known, order in ((radii.copy(), steps), (radii, steps), (radii, steps[::-1]), (radii, steps)):
        before = np.count_nonzero(np.isinf(radii[0]))
        for t in order:
            _propagate_one_step(problem, residual, rows, t, radii, (left, barren), known)
        if np.count_nonzero(np.isinf(radii[0])) == before:
            break
    _solve_all_steps(problem, trajectory, residual, radii)


def _rows_of_steps(problem: OptimalControlProblem, z: Array, level: float) -> Rows:
    """Return, per time, rows of z_t = (x_t, u_t) with the largest distance that their values can rise."""
    by_time: Rows = {}
    for term in problem.terms:
        rows = term.implied_rows(problem.state_dim, problem.control_dim, level)
        if rows is None:
            continue
        for group, t in enumerate(rows.times):
            matrix = rows.matrix(group)
            by_time.setdefault(int(t), []).append((matrix, np.maximum(rows.e[group] - matrix @ z[t], 0.0)))
    return by_time


def _propagate_one_step(
    problem: OptimalControlProblem,
    residual: Array,
    rows: Rows,
    t: int,
    radii: Array,
    barren: tuple[Indices, set[bytes]],
    known: Array,
) -> None:
    """Fill in the components of x_t, u_t, x_{t+1} that ``known`` radii, the equation and rows of this step imply.

    ``barren`` (T,) says how many sides stay unknown: with so many, the step implies no more. Its set has the unknown
    sides of steps of constant dynamics without rows that implied none: which are implied does not depend on values.
    """
    n, (left, patterns) = problem.state_dim, barren
    values = np.concatenate([known[:, :, t], known[:, :, t + 1, :n]], axis=2)
    unknown = np.isinf(values[0])
    pattern, count = unknown.tobytes(), np.count_nonzero(unknown)
    if count in (0, left[t]):
        return
    if pattern in patterns and t not in rows:
        left[t] = count
        return
    columns = [np.hstack([matrix, np.zeros((len(matrix), n))]) for matrix, _ in rows.get(t, [])]
    limits = [np.stack([slack, np.full_like(slack, np.inf)]) for _, slack in rows.get(t, [])]
    if problem.response is None:  # no single step of a response says anything
        A, B, _ = problem.linear.at(t)
        columns, limits = [np.hstack([A, B, -np.eye(n)]), *columns], [np.stack([residual[t]] * 2), *limits]
    if columns and _determine_radii(np.vstack(columns), np.hstack(limits), values):
        own = radii[:, :, t], radii[:, :, t + 1, :n]
        for part, new in zip(own, np.split(values, [radii.shape[-1]], axis=2), strict=True):
            part[:] = np.where(np.isinf(part[0]), new, part)
    elif columns and t not in rows and not problem.linear.time_varying and np.isfinite(residual[t]).all():
        patterns.add(pattern)
    left[t] = np.count_nonzero(np.isinf(values[0]))


def _solve_all_steps(problem: OptimalControlProblem, trajectory: Trajectory, residual: Array, radii: Array) -> None:
    """Fill in radii that only equations and constraints of all times determine.

    Such are those of a free state with partly fixed ends, and of a signal whose bins are all limited.
    """
    values = radii.reshape(3, 2, -1)
    if not 0 < np.isinf(values[0]).any(0).sum() <= MAX_UNKNOWN:
        return
    rows, limits = [equation_rows(problem)], [np.stack([residual.ravel()] * 2)]
    positions = split_signals(np.arange(values.shape[2]).reshape(len(trajectory.x), -1), problem.state_dim)
    columns = np.concatenate([part.ravel() for part in positions])  # of all states, then of all controls
    at_zero = [(map, (np.zeros(1), np.zeros(1))) for map in problem.stop_band_maps]
    for map, bounds in (*((term.map, term.penalty.hard_bounds(term.shape)) for term in problem.terms), *at_zero):
        sides = _stated_radii(map.values(trajectory.x, trajectory.u), bounds)[0].reshape(2, -1)
        limited = np.flatnonzero(np.isfinite(sides).any(0))
        rows.append(np.zeros((len(limited), values.shape[2])))
        rows[-1][:, columns] = map.rows(problem.horizon, problem.state_dim, problem.control_dim)[0][limited].toarray()
        limits.append(sides[:, limited])
    _determine_radii(np.vstack(rows), np.hstack(limits), values)


def equation_rows(problem: OptimalControlProblem) -> Array:
    """Return f_t(x_t, u_t) - x_{t+1} without its offset as rows on stacked signals, (T n, (T+1) (n + m))."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    rows = np.zeros((T, n, T + 1, n + m))
    if problem.response is not None:
        rows[:, :, :-1, n:] = problem.response.matrix[n:].reshape(T, n, T, m)
    for t in range(T):
        if problem.response is None:
            A, B, _ = problem.linear.at(t)
            rows[t, :, t] = np.hstack([A, B])
        rows[t, :, t + 1, :n] = -np.eye(n)
    return rows.reshape(T * n, -1)


def _determine_radii(columns: Array, limits: Array, values: Array) -> bool:
    """Fill in the unknown radii, values (3, 2, k), that these rows imply; return whether they imply any.

    ``limits`` (2, rows) bound columns d from above, and -columns d. Rows that share no unknown component with others
    say what they say without these.
    """
    unknown = np.flatnonzero(np.isinf(values[0]).any(0))
    if _fill_block(columns, limits, values, unknown):
        return True
    present = columns[:, unknown] != 0
    block_of = np.arange(len(unknown))  # the last component of each block
    for row in present:
        block_of[(block_of[:, None] == block_of[row]).any(axis=1)] = block_of[row].max(initial=0)
    blocks, filled = np.unique(block_of), False
    for block in blocks if len(blocks) > 1 else ():
        chosen = block_of == block
        rows = present[:, chosen].any(axis=1)
        filled |= _fill_block(columns[rows], limits[:, rows], values, unknown[chosen])
    return filled


def _fill_block(columns: Array, limits: Array, values: Array, unknown: Indices) -> bool:
    """Fill in those unknown components that these rows alone bound; return whether there are any.

    Rows and components are in units in which their largest coefficients are 1: weights that are accurate in one choice
    of units of the states may not be in another.
    """
    block = columns[:, unknown]
    if not block.size:
        return False
    of_rows = units_of(block, axis=1)
    units = units_of(block / of_rows[:, None], axis=0)
    rows = np.vstack([block / of_rows[:, None] / units, np.eye(len(unknown))])  # also their own one-sided bounds
    known = columns.any(axis=0) & ~np.isinf(values[0]).any(0)
    moved = _largest(columns[:, known], values[:, ::-1, known])
    above = np.stack([moved, _largest(-columns[:, known], values[:, ::-1, known])], axis=1)
    above[0] += limits
    above = np.concatenate([above / of_rows, values[:, :, unknown] * units], axis=2)
    finite = np.isfinite(above[0])
    weights, held = _weights(rows, finite)
    if not held.all():
        apart = ~block[:, ~held].any(axis=1)
        return bool(held.any()) and _fill_block(columns[apart], limits[:, apart], values, unknown[held])
    bounds = [_largest(of_side, np.where(finite, above, 0.0)) * RADIUS_MARGIN / units for of_side in weights]
    old = values[:, :, unknown]
    values[:, :, unknown] = np.where(np.isinf(old[0]), np.stack(bounds, axis=1), old)
    return True


def _largest(coefficients: Array, sides: Array) -> Array:
    """Return the largest values, (3, rows), of coefficients v where v <= sides[:, 0] and -v <= sides[:, 1]."""
    return sides[:, 0] @ np.maximum(coefficients, 0.0).T + sides[:, 1] @ np.maximum(-coefficients, 0.0).T


def _weights(rows: Array, finite: Mask) -> tuple[Array, Mask]:
    """Return weights (2, k, rows) whose sums of rows are components and their negatives, and which ones have some.

    Rows that are bounded on one side, ``finite`` (2, rows), have weights of one sign.
    """
    both, k = finite.all(axis=0), rows.shape[1]
    weights = np.zeros((2, k, len(rows)))
    if np.count_nonzero(both) >= k:
        Q, R = np.linalg.qr(rows[both])
        if np.diag(R).all():
            inverse = np.linalg.solve(R, Q.T)  # not SciPy's: its threads and NumPy's wait for each other
            if np.abs(inverse @ rows[both] - np.eye(k)).max() <= INVERSE_TOLERANCE:
                weights[0][:, both], weights[1][:, both] = inverse, -inverse
                return weights, np.ones(k, dtype=bool)
    if k > MOST_ONE_SIDED:
        return weights, np.zeros(k, dtype=bool)
    return _weights_by_sign(rows.tobytes(), finite.tobytes(), rows.shape)


@lru_cache(maxsize=64)  # the steps of constant dynamics have the same
def _weights_by_sign(of_rows: bytes, of_finite: bytes, shape: tuple[int, int]) -> tuple[Array, Mask]:
    from scipy.optimize import nnls  # slow to import

    rows, finite = np.frombuffer(of_rows).reshape(shape), np.frombuffer(of_finite, dtype=bool).reshape(2, -1)
    signed, count, k = np.vstack([rows[finite[0]], -rows[finite[1]]]), np.count_nonzero(finite[0]), shape[1]
    weights, held = np.zeros((2, k, shape[0])), np.zeros((2, k), dtype=bool)
    for side, of_side in enumerate((np.eye(k), -np.eye(k))):
        for i, component in enumerate(of_side if len(signed) else ()):
            try:
                sums, _ = nnls(signed.T, component)
            except RuntimeError:  # too many iterations
                continue
            held[side, i] = np.abs(sums @ signed - component).max() <= INVERSE_TOLERANCE
            weights[side, i, finite[0]] += sums[:count]
            weights[side, i, finite[1]] -= sums[count:]
    return weights, held[0] & held[1]


def units_of(coefficients: Array, axis: int) -> Array:
    """Return the largest absolute value along an axis, 1 where all are zero."""
    largest = np.abs(coefficients).max(axis=axis)
    return np.where(largest > 0, largest, 1.0)


def _forward_reach(problem: OptimalControlProblem, bounds: Pair) -> Pair | None:
    """Return the bounds with intervals around all states reachable from X_0; None if the simulation overflows.

    x_t lies within sum_s |A_{t-1} .. A_{s+1} B_s| r_s + |A_{t-1} .. A_0| r_0 of the trajectory of the interval centres.
    """
    start, none = problem.initial_box, np.zeros((problem.horizon, problem.state_dim))
    u_lower, u_upper = (split_signals(side, problem.state_dim)[1] for side in bounds)
    boxes = [(u_lower, u_upper), (start.lower, start.upper)]
    free_u, free_0 = (np.isinf(lower) | np.isinf(upper) for lower, upper in boxes)
    free = np.zeros_like(problem.state_tube.lower, dtype=bool)
    if free_0.any() or free_u.any():  # states that a path of nonzero entries leads to
        entries = [(A != 0, B != 0) for A, B, _ in map(problem.linear.at, range(problem.horizon))]
        free = growth(entries, free_0, free_u, 0.0) > 0
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
    return stack_signals(centre - radius - rounding, u_lower), stack_signals(centre + radius + rounding, u_upper)


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
