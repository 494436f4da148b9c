"""Local optima over the angles of a pulse train, a proof that there is no better one near, and parts without a train.

With c a local optimum, s the steps, and multipliers of the amplitudes and dwells, L = E + lambda'(b - limit) - nu'x,
x = the dwells less their least values, is below E for every train of the problem (quarter.py). G, its slope at c, is
zero but for rounding. E is a polynomial of degree three in ordered angles, hence

    L(c + d) = L(c) + G'd + 1/2 d' M(d) d,    M(d) = H_E(c + d/3) + sum_k lambda_k diag w_k(d),

where w_k has the weighted second derivatives of b_k: 2 int (1 - t) cos k(c_i + t d_i) dt is cos kc_i - (kd_i/3) sin
kc_i within (kd_i)^2/12. With 0 <= x <= W over the box and a multiplier mu >= 0, mu x >= mu x^2/W keeps the bound: the
squares of dwells and of limited amplitudes are added, and of those with b_k = l_k = h_k any multiple, here once. An
amplitude less its limit is y(c) + u + v, u its slope times d, |v| <= 1/2 sum |b_k''| d_i^2, (u + v)^2 >= u^2/2 - v^2.
M is linear in d, its constants aside: it is positive semidefinite over a box if it is at the corners. Then the bound
over the box is L(c) less |G|'|d| and what y(c) and x(c) take from the squares. The box need not hold c.

*Parts without a train.* A weighted sum of amplitudes is a sum over the angles, whose least value over a lattice takes
one pass. Move all angles of a train to the lattice by one random offset, the mean kept: dwells keep their whole steps,
and the mean of the sum rises by at most h^2/8 times its second derivatives. A sum that misses its limits by more than
that excludes the part. Cutting planes find weights.

The local search over angles is sequential quadratic programming, and Newton's method with the limits that it meets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.methods.hybrid.quarter import RANGE_ROUNDING, Quarter
from lin_freq_ocp.problem.hybrid.pulse_train import QUARTER

# Roundings, on which claims rest
ENERGY_ROUNDING = 1e-13  # of the sums of the absolute terms of E and b_k, for twelve angles: rounding is smaller
EIGENVALUE_ROUNDING = 1e-12  # of the largest entry of M: the rounding of eigenvalues is smaller for twelve angles
# Effort: bounds and exclusions hold whatever these are; with less, more parts are left to the lattice
MOST_CORNERS = 2**12  # of a box whose curvature is asked
SUMS, MOST_SUMS = 4000, 40  # angles of a quarter for sums of amplitudes, and how many sums are tried at most
SUM_ACCURACY = 1e-9  # of amplitudes of order 1, by which a sum must miss its limits to be worth a try
AT_LIMIT = 1e-7  # distance from a limit up to which an amplitude or a dwell has a multiplier at an optimum
COST_ACCURACY = 1e-13  # change of the cost, relative to the sum of its terms, at which the search ends
AMPLITUDE_VIOLATION = 1e-9  # of amplitudes of order 1: less than the tolerance of the judge, who decides
SEARCH_STEPS = 80  # of a search: those that converge take half of them; with a quarter, times are the same
NEWTON_STEPS, NEWTON_REACH = 6, 1e-2  # after the search; a longer step [rad] is none from an optimum


def bound_near(quarter: Quarter, steps: Array, c: Array, low: Array, high: Array) -> float:
    """Return a bound on E over trains with angles within low <= a <= high (m,), by those at c; -infinity if none."""
    m, k, weight = len(c), np.array(quarter.orders, dtype=float)[:, None], 4 / np.pi * steps
    if 2**m > MOST_CORNERS:
        return -np.inf
    (E, g), (b, slopes) = quarter.energy(steps, c), quarter.amplitudes(steps, c)
    rows, x, multipliers = multipliers_of_limits(quarter, steps, c)
    D, price, nu = rows[len(k) :], multipliers[: len(k)], -multipliers[len(k) :]
    over = np.where(price == 0, 0.0, b - np.where(price > 0, quarter.high, np.where(price < 0, quarter.low, b)))
    G = g + multipliers @ rows
    corners = np.array(list(product(*zip(low - c, high - c, strict=True))))
    reach, along = np.abs(corners).max(axis=0), np.abs(rows @ corners.T).max(axis=1)
    second = weight * k
    bent = price @ (second * np.cos(k * c)) - corners / 3 * (price @ (second * k * np.sin(k * c)))
    bent += np.abs(price) @ (np.abs(second) * k**2) * reach**2 / 12
    turn = np.abs(second) @ reach**2 / 2  # the largest v
    stiff, fixed = nu / np.maximum(x + along[len(k) :], AT_LIMIT), quarter.low == quarter.high
    M = _curvature(steps, c + corners / 3) - bent[:, None] * np.eye(m) + 2 * (D.T * stiff) @ D
    value = E + price @ over - nu @ x - np.abs(G) @ reach - 2 * (stiff * np.abs(x)) @ along[len(k) :]
    size = float(np.abs(weight).sum())
    value -= ENERGY_ROUNDING * size * (size + float(np.abs(price).sum()))
    most = along[: len(k)] + turn  # of u + v
    stiff = np.where(fixed, 1.0, np.minimum(np.abs(price) / np.maximum(np.abs(over) + most, AT_LIMIT), 1.0))
    bend = stiff @ np.square(np.abs(second) * reach).sum(axis=1) / 2
    M = M + (slopes.T * stiff) @ slopes - bend * np.eye(m)
    if np.linalg.eigvalsh(M).min() <= EIGENVALUE_ROUNDING * np.abs(M).max():
        return -np.inf
    misses = np.where(fixed, np.abs(b - quarter.low), np.abs(over))
    return float(value - 2 * (stiff * misses) @ most)


def local_prices(quarter: Quarter, steps: Array, c: Array) -> Array:
    """Return the prices r (angle_lattice.py) with which the slope of L_r is zero at a local optimum."""
    _, _, multipliers = multipliers_of_limits(quarter, steps, c)
    return -multipliers[: len(quarter.orders)] * np.array(quarter.orders) / 2


def _curvature(steps: Array, a: Array) -> Array:
    """Return the second derivatives (n, m, m) of E at ordered angles (n, m)."""
    i, j = np.indices((len(steps), len(steps)))
    both, later = 8 / np.pi * np.outer(steps, steps), (QUARTER - a)[:, np.maximum(i, j)] * (i != j)
    alone = np.diagonal(both) * (2 * a - QUARTER) - (both * later).sum(axis=2)
    return np.where(i == j, alone[:, :, None], both * a[:, np.minimum(i, j)])


def multipliers_of_limits(quarter: Quarter, steps: Array, c: Array) -> tuple[Array, Array, Array]:
    """Return slopes of amplitudes and dwells (k + m + 1, m), dwells above the least, and multipliers that fit best."""
    from scipy.optimize import nnls  # slow to import

    m, (b, slopes) = len(c), quarter.amplitudes(steps, c)
    x = np.diff(np.concatenate([[0.0], c, [QUARTER]])) - quarter.dwells
    rows = np.vstack([slopes, np.diff(np.vstack([np.zeros(m), np.eye(m), np.zeros(m)]), axis=0)])
    below = np.concatenate([np.abs(b - quarter.low) < AT_LIMIT, x < AT_LIMIT])
    above = np.concatenate([np.abs(b - quarter.high) < AT_LIMIT, np.zeros(m + 1, dtype=bool)])
    sides = np.hstack([np.eye(len(rows))[:, above], -np.eye(len(rows))[:, below]])
    forces = nnls(rows.T @ sides, -quarter.energy(steps, c)[1])[0] if sides.size else np.zeros(sides.shape[1])
    return rows, x, sides @ forces


def _newton(quarter: Quarter, steps: Array, c: Array) -> Array:
    """Return the angles (m,) after steps of Newton's method with the limits that have multipliers near c."""
    k = np.array(quarter.orders, dtype=float)[:, None]
    multipliers = multipliers_of_limits(quarter, steps, c)[2]
    kept, price = multipliers != 0, multipliers[: len(k)]
    limits = np.where(price > 0, quarter.high, quarter.low)
    for _ in range(NEWTON_STEPS):
        rows, x, _ = multipliers_of_limits(quarter, steps, c)
        A, misses = rows[kept], np.concatenate([quarter.amplitudes(steps, c)[0] - limits, x])[kept]
        bent = np.diag(multipliers[: len(k)] @ (4 / np.pi * steps * k * np.cos(k * c)))
        system = np.block([[_curvature(steps, c[None])[0] - bent, A.T], [A, np.zeros((len(A), len(A)))]])
        right = -np.concatenate([quarter.energy(steps, c)[1], misses])
        step = np.linalg.lstsq(system, right, rcond=None)[0]
        c, multipliers = c + step[: len(c)], np.zeros(len(multipliers))
        multipliers[kept] = step[len(c) :]
    return c


def local_angles(quarter: Quarter, steps: Array, angles: Array) -> tuple[Array, float] | None:
    """Return the angles (d,) of a local optimum near ``angles``, and its cost; None if the search fails.

    Where it fails, a second one begins at angles whose amplitudes miss their limits least.
    """
    from scipy.optimize import LinearConstraint, NonlinearConstraint, minimize  # slow to import

    low, high, count = quarter.low, quarter.high, len(angles)
    size = 2 * (count * quarter.step * 4 / np.pi) ** 2 + abs(quarter.offset)
    first, last = quarter.dwells[0], QUARTER - quarter.dwells[-1]
    differences = np.diff(np.vstack([np.zeros(count), np.eye(count), np.zeros(count)]), axis=0)
    dwells = LinearConstraint(differences, quarter.dwells - QUARTER * (np.arange(count + 1) == count), np.inf)

    def cost(angles: Array) -> tuple[float, Array]:
        value, slope = quarter.energy(steps, angles)
        return (value + quarter.offset) / size, slope / size

    def squares(angles: Array) -> tuple[float, Array]:
        values, slopes = quarter.amplitudes(steps, angles)
        over = values - np.clip(values, low, high)
        return float(over @ over), 2 * over @ slopes

    def amplitudes(derivative: int, rows: Indices, angles: Array) -> Array:  # of order 0, or 1: their slopes
        return quarter.amplitudes(steps, angles)[derivative][rows]

    def misses(angles: Array) -> float:
        values, _ = quarter.amplitudes(steps, angles)
        short = float((quarter.dwells[1:-1] - np.diff(angles)).max(initial=0.0))
        return max(short, float(np.maximum(low - values, values - high).max(initial=0.0)))

    def search(
        objective: Callable[[Array], tuple[float, Array]],
        start: Array,
        limits: Sequence[LinearConstraint | NonlinearConstraint],
    ) -> Array:
        found = minimize(
            objective,
            start,
            jac=True,
            method="SLSQP",
            constraints=[*limits, dwells],
            options={"ftol": COST_ACCURACY, "maxiter": SEARCH_STEPS},
        ).x
        return np.clip(np.maximum.accumulate(found), first, last)

    limits = list[NonlinearConstraint]()
    limited = np.isfinite(low) | np.isfinite(high)
    for rows in (np.flatnonzero(low == high), np.flatnonzero((low < high) & limited)):
        if len(rows):
            values, slopes = partial(amplitudes, 0, rows), partial(amplitudes, 1, rows)
            limits.append(NonlinearConstraint(values, low[rows], high[rows], jac=slopes))
    at = search(cost, angles, limits)
    if misses(at) > AMPLITUDE_VIOLATION:
        at = search(cost, search(squares, angles, ()), limits)
    better = _newton(quarter, steps, at)
    better = np.clip(np.maximum.accumulate(better), first, last)
    if np.abs(better - at).max(initial=0.0) <= NEWTON_REACH and misses(better) <= AMPLITUDE_VIOLATION:
        at = better
    return None if misses(at) > AMPLITUDE_VIOLATION else (at, quarter.price * size * cost(at)[0])


class NearestTrain(NamedTuple):
    """Steps and angles (m,) of a train, by how much its amplitudes miss their limits; or weights that exclude all."""

    steps: Array
    angles: Array
    missed: float
    excluded_by: Array | None = None


def nearest_train(quarter: Quarter, low: Array, high: Array, sign: Indices) -> NearestTrain:
    """Return a train whose amplitudes miss their limits little, or weights of a sum that no train meets.

    Angles are in a range, and steps have signs, 0 where both are allowed.
    """
    from scipy.optimize import linprog  # slow to import

    q, k, best = quarter, np.array(quarter.orders, dtype=float), NearestTrain(np.zeros(0), np.zeros(0), np.inf)
    ends = np.where(np.isfinite(q.high), q.high, 0.0), np.where(np.isfinite(q.low), q.low, 0.0)
    bounds = [(0.0, float(one)) for one in np.isfinite([q.high, q.low]).ravel()] + [(None, None)]
    curved = 4 / np.pi * q.step * len(sign) * (QUARTER / SUMS) ** 2 / 8 * k
    weights, rows = np.zeros(len(k)), list[Array]()
    for _ in range(MOST_SUMS):
        found = _least_sum(q, low, high, sign, weights)
        if found is None:
            return best._replace(excluded_by=weights)
        steps, angles = found
        values = q.amplitudes(steps, angles)[0]
        most = np.maximum(weights, 0.0) @ ends[0] - np.maximum(-weights, 0.0) @ ends[1]
        if weights @ values - np.abs(weights) @ curved - ENERGY_ROUNDING * len(sign) * np.abs(weights).sum() > most:
            return best._replace(excluded_by=weights)
        missed = float(np.maximum(q.low - values, values - q.high).max(initial=0.0))
        best = min(best, NearestTrain(steps, angles, missed), key=lambda one: one.missed)
        rows.append(np.concatenate([ends[0] - values, values - ends[1], [1.0]]))
        objective = np.append(np.zeros(2 * len(k)), -1.0)
        answer = linprog(objective, np.array(rows), np.zeros(len(rows)), bounds=bounds, method="highs")
        if answer.x is None or answer.fun is None or -answer.fun <= SUM_ACCURACY:
            break
        weights = answer.x[: len(k)] - answer.x[len(k) : -1]
    return best


def _least_sum(quarter: Quarter, low: Array, high: Array, sign: Indices, weights: Array) -> tuple[Array, Array] | None:
    """Return steps and angles of the train of a lattice with the least weighted sum of amplitudes; None without one."""
    h, m, k = QUARTER / SUMS, len(sign), np.array(quarter.orders, dtype=float)
    wave = 4 / np.pi * quarter.step * np.cos(h * np.outer(np.arange(SUMS + 1), k)) @ (weights / k)
    hold = np.floor(quarter.dwells / h - RANGE_ROUNDING).astype(int).clip(0)
    first, last = np.floor(low / h - RANGE_ROUNDING).astype(int), np.ceil(high / h + RANGE_ROUNDING).astype(int)
    levels = quarter.highest - quarter.lowest + 1
    rest, choices = np.zeros((levels, SUMS + 1)), np.full((m, levels, 2, SUMS + 1), np.inf)
    for c in reversed(range(m)):
        switch = slice(max(first[c], hold[0]), min(last[c], SUMS - hold[c + 1]) + 1)
        after = slice(switch.start + hold[c + 1], switch.stop + hold[c + 1])
        if switch.start >= switch.stop:
            return None
        for s in {1, -1} if sign[c] == 0 else {int(sign[c])}:
            to = slice(max(s, 0), levels + min(s, 0))
            choices[c, max(-s, 0) : levels + min(-s, 0), (1 - s) // 2, switch] = s * wave[switch] + rest[to, after]
        rest = np.minimum.accumulate(choices[c].min(axis=1)[:, ::-1], axis=1)[:, ::-1]
    level, i, steps, angles = -quarter.lowest, 0, np.zeros(m), np.zeros(m)
    if rest[level, 0] == np.inf:
        return None
    for c in range(m):
        side, at = np.unravel_index(choices[c, level, :, i:].argmin(), (2, SUMS + 1 - i))
        s = 1 - 2 * int(side)
        steps[c], angles[c] = s * quarter.step, (i + at) * h
        level, i = level + s, i + int(at) + int(hold[c + 1])
    return steps, angles
