"""The small QP over the working rows: min l'S l / 2 + delta'l over 0 <= l <= prices (docs/spectral.md, 6, 7 and 12).

Its slope is S l + delta = slack - violation of the rows, one of which is zero:

    l = 0: slack >= 0        0 < l < price: both are 0        l = price: the row is saturated, violation >= 0

Prices are those of soft rows, and infinite for hard ones. S is positive semidefinite, and numerically singular if a
state or a control stays at a bound. ``bounded_qp`` tries block pivoting, which solves almost all small QPs, then the
interior point. The exchange measures every answer by its signals. A first reader may stop after ``block_pivoting``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dsyrk
from scipy.linalg.lapack import dgetrf, dgetrs, dposv, dpotrf, dpotrs, dpstrf

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.methods.spectral.kkt import equilibration

INTERIOR_STEPS = 60  # after which the best iterate is returned; 10 to 25 are usual
LOW_RANK_ROWS = 200  # rows from which a factor of low rank saves time
LARGEST_SHARE = 0.45  # rank over rows up to which it saves time
TO_BOUNDARY = 0.995  # fraction of the step to the boundary
REFINED = 1e-8  # diagonal added to a thin factor below which solves are refined
WARM = 1e-2  # least weight and slack of a warm start
POLISHES = 3  # refinements of the polish: each squares the relative error of the factor
DROPPINGS = 5  # passes that drop active rows of the wrong sign
PIVOTING_ROWS = 300  # rows up to which block pivoting is tried first
PIVOTING_STEPS = 30  # after which it has not converged; 1 to 4 are usual
STEPS_OF_ALL = 3  # steps that exchange all wrong rows
WORST_SHARE = 0.5  # part of the worst error from which later steps exchange a row
TINY = 1e-300  # keeps quotients of exact zeros finite
QP_RIDGE = 1e-13  # added to the diagonal: dependent rows and equations then share their multipliers
DECIDED_SOFT = 1e-13  # part of a soft row's own response left by the equations that is rounding of zero
PIVOTING_PIVOT = 1e-6  # Cholesky pivot below which rows are too dependent for block pivoting
WRONG_SLOPE = 1e-13  # slope below which a row without multiplier is wrong
INTERIOR_SOLVED = 1e-13  # defect and complementarity at which the interior point stops
INTERIOR_ACCURATE = 1e-8  # ... and up to which its answer is accurate
DIVERGED_ERROR = 1e3  # growth of that error over the best one at which it stops
INTERIOR_RIDGE = 1e-14  # added to its diagonal, which is near 1; a hundred times as much where a factorisation fails
LARGEST_RIDGE = 1e-8  # ridge at which it stops
HOLDING_DIAGONAL = 1e14  # diagonal that holds a row at zero in its polish
RANK_TOLERANCE = 3e-15  # pivot at which the rank of diag - S is exhausted
LOW_RANK_ERROR = 1e-10  # diagonal that a thin factor may miss; with more, diag - S has negative eigenvalues
BORDERED_SOLVED = 1e-12  # defects and complementarity at which the bordered interior point stops ...
# ... and complementarity alone, as the cost may be small at that scale. Further steps lose digits of the equations: at
# 1e-16, one of 900 random problems ends with residuals of 1e-6.
BORDERED_COMPLEMENTARY = 1e-14
BORDERED_ACCURATE = 1e-7  # error up to which its answer is accurate
SHORTEST_STEP = 1e-8  # step length at which it stops
ACTIVE_SIGN = 1e-11  # weight of an active row, relative to the largest, that may be negative by rounding
POLISHED_SLACK = 1e-10  # violation of a row up to which a polished answer counts
IDLE_WEIGHT = 1e-9  # weight, relative to slacks and weights, that it leaves on inactive rows

Stop = Callable[..., str | None]  # returns the reason to stop, the time limit or Ctrl-C, or None


class RowQp(NamedTuple):
    """The small QP of some rows.

    ``diagonal_bound`` is a diagonal with diag - S >= 0 of low rank: 1/R for control rows, else 0. ``response`` has the
    response of each row to a unit force on it without equations, relative to which its entry of S may be rounding.
    """

    S: Array
    delta: Array
    prices: Array
    diagonal_bound: Array
    response: Array


def bounded_qp(qp: RowQp, start: Array, stop: Stop = lambda: None) -> tuple[Array, bool]:
    """Return (l, whether it is accurate) from a warm start >= 0; not accurate if ``stop`` ends it early.

    If equations decide a soft row, it is saturated iff it is violated: its entry of S is a rounding error.
    """
    S, delta, prices, diagonal_bound, response = qp
    decided = np.isfinite(prices) & (np.diagonal(S) < DECIDED_SOFT * response)
    if decided.any():  # they are at a bound of their multipliers
        weights, free, accurate = np.where(decided & (delta < 0), prices, 0.0), ~decided, True
        if free.any():
            delta = delta[free] + S[np.ix_(free, decided)] @ weights[decided]
            rest = RowQp(S[np.ix_(free, free)], delta, prices[free], diagonal_bound[free], response[free])
            weights[free], accurate = bounded_qp(rest, start[free], stop)
        return weights, accurate
    # units in which S has a diagonal of 1 and delta a largest entry of 1: all tolerances below are relative to these
    unit = 1 / np.sqrt(np.maximum(np.diagonal(S), TINY))
    size = max(float((np.abs(delta) * unit).max()), TINY)
    S, delta, start = S * unit[:, None], delta * unit / size, start / unit / size
    S *= unit
    scaled = RowQp(S, delta, prices / unit / size, diagonal_bound * unit**2, response * unit**2)
    weights, accurate = block_pivoting(scaled, start) if len(S) <= PIVOTING_ROWS else None, True
    if weights is None:
        weights, accurate = interior_point(scaled, start, stop)
    # a saturated row has exactly its price: the exchange compares the two
    return np.where(weights >= scaled.prices, prices, weights * unit * size), accurate


def block_pivoting(qp: RowQp, start: Array) -> Array | None:
    """Exchange all wrong rows at once, later the worst ones; None if that cycles, or if rows are nearly dependent.

    Rows are active (0 < l < price, slope 0), saturated (l = price), or neither (l = 0). For each such guess, l follows
    from S l + delta = 0 on the active rows. A wrong row has an l outside of its bounds, or a slope of the wrong sign.

    An exchange of all rows is fast, but cycles on some programs. Most cycles end if only rows with at least half of the
    worst error are exchanged. Judice and Pires (1994) exchange a single row instead, which takes longer.
    """
    S, delta, prices, *_ = qp
    slope, saturated, soft = S @ start + delta, start >= prices, np.isfinite(prices).any()
    active = ((start > 0) | (slope < 0)) & ~saturated
    for step in range(PIVOTING_STEPS):
        weights, rows, target = np.zeros(len(delta)), active.nonzero()[0], delta
        if soft and saturated.any():
            weights[saturated] = prices[saturated]
            target = delta + S[:, saturated] @ weights[saturated]
        if len(rows):
            factor, solution, failed = dposv(S.take(rows, 0).take(rows, 1), target[rows], lower=1)
            if failed or factor.diagonal().min() < PIVOTING_PIVOT:
                return None
            weights[rows] = -solution
        slope = S @ weights + delta
        error = np.where(active, -weights, -WRONG_SLOPE - slope)
        if soft:
            above = active & (weights > prices)
            error = np.where(above, weights - prices, np.where(saturated, slope - WRONG_SLOPE, error))
        wrong = error > 0
        if not wrong.any():
            return weights
        if step >= STEPS_OF_ALL:  # multipliers and slopes are compared with their own kind
            worst = [error[kind].max(initial=0.0) for kind in (active, ~active)]
            wrong &= error >= WORST_SHARE * np.where(active, *worst)
        if soft:
            saturated = np.where(wrong, weights > prices, saturated)
        active ^= wrong
    return None


# A first reader may stop here. The rest is for rows that are nearly dependent, and for compliant unknowns.


def interior_point(qp: RowQp, start: Array, stop: Stop = lambda: None) -> tuple[Array, bool]:
    """Return (l, whether it is accurate) by Mehrotra's predictor-corrector; arguments as in ``bounded_qp``.

    On saturated control arcs S has eigenvalues near 0 and 1, and multipliers are not unique: active-set methods cycle.
    There S is of low rank, the width of the pass band times the length of the arcs, or diag(diagonal_bound) - S >= 0
    is, with the width of the stop band: each step is then a small system (docs/spectral.md, 6).

    Mehrotra (1992), On the implementation of a primal-dual interior point method.
    """
    S, delta, prices, diagonal_bound, _ = qp
    system, ridge, count = _thin_factor(S, diagonal_bound) or _Dense(S), INTERIOR_RIDGE, len(delta)
    weights, least = (start, WARM) if start.any() else (np.ones(count), 1.0)
    pairs = Pairs(prices)
    margins = pairs.margins(weights, least)
    slacks = pairs.slacks(system.times(margins[:count]) + delta, margins, least)
    best = np.inf, margins, slacks

    def newton(target: Array) -> tuple[Array, Array]:  # the steps of no other unknowns and of the margins
        return np.zeros(0), pairs.steps(system.solve(defect + pairs.slope(target / margins)))

    for _ in range(INTERIOR_STEPS):
        weights = margins[:count]
        defect, mean = pairs.slope(slacks) - system.times(weights) - delta, float(margins @ slacks) / len(margins)
        error = max(float(np.abs(defect).max()), mean) / (1 + float(weights.max()))
        if error < best[0]:
            best = error, margins, slacks
        # beyond its best accuracy, further steps lose digits again: the best iterate counts
        if error < INTERIOR_SOLVED or not error <= DIVERGED_ERROR * best[0] or stop():
            break
        if not system.factor(pairs.diagonal(margins, slacks) + ridge):
            ridge *= 100
            if ridge > LARGEST_RIDGE:
                break
            continue
        # longer steps towards the end, where complementarity would otherwise fall by 200 a step only
        _, margins, slacks, length = predictor_corrector(newton, margins, slacks, mean, max(TO_BOUNDARY, 1 - mean))
        if length < INTERIOR_ACCURATE:
            break
    error, margins, slacks = best
    return _polish(system, delta, pairs, margins, slacks), error < INTERIOR_ACCURATE


def _polish(system: _Dense | _Thin, delta: Array, pairs: Pairs, margins: Array, slacks: Array) -> Array:
    """Return l with zero slope on the active rows and the others at their bounds, if that lowers the slope."""
    active, weights = pairs.split(margins, slacks)
    if not active.any() or not system.factor(np.where(active, INTERIOR_RIDGE, HOLDING_DIAGONAL)):
        return weights
    polished = weights.copy()
    for _ in range(POLISHES):
        slope = np.where(active, system.times(polished) + delta, 0.0)
        polished = polished - np.where(active, system.solve(slope), 0.0)
    candidates = weights, np.clip(polished, 0.0, pairs.prices)
    return min(candidates, key=lambda l_active: float(np.abs((system.times(l_active) + delta)[active]).max()))


class Pairs:
    """Margins of the multipliers, and slacks of the rows, whose products vanish at the optimum.

    Of each of the ``count`` rows (l, slack) is a pair, and (price - l, violation) another if the price is finite:
    margins and slacks are vectors of all first pairs, then all second ones.
    """

    def __init__(self, prices: Array):
        self.prices, self.soft, self.count = prices, np.flatnonzero(np.isfinite(prices)), len(prices)

    def margins(self, weights: Array, least: float) -> Array:
        """Return the margins of multipliers l >= 0 that are moved inside their bounds by ``least``."""
        weights = np.maximum(weights, least)
        price = self.prices[self.soft]
        inside = np.minimum(least, price / 4)
        weights[self.soft] = np.clip(weights[self.soft], inside, price - inside)
        return np.concatenate([weights, price - weights[self.soft]])

    def slacks(self, slope: Array, margins: Array, least: float) -> Array:
        """Return slacks of at least ``least`` for a slope; violations may be smaller if the margin is wide."""
        smallest = least / np.maximum(1.0, margins[self.count :])
        return np.concatenate([np.maximum(slope, least), np.maximum(-slope[self.soft], smallest)])

    def slope(self, slacks: Array) -> Array:
        """Return slack - violation, (count,)."""
        return self._sum_of_pairs(slacks, -1.0)

    def _sum_of_pairs(self, numbers: Array, sign: float) -> Array:
        """Return the numbers of the first pairs plus ``sign`` times those of the second, (count,)."""
        if not len(self.soft):
            return numbers
        total = numbers[: self.count].copy()
        total[self.soft] += sign * numbers[self.count :]
        return total

    def diagonal(self, margins: Array, slacks: Array) -> Array:
        """Return slack / l + violation / (price - l), (count,), which Newton's method adds to S."""
        return self._sum_of_pairs(slacks / margins, 1.0)

    def steps(self, change: Array) -> Array:
        """Return the steps of the margins from that of l."""
        return np.concatenate([change, -change[self.soft]]) if len(self.soft) else change

    def split(self, margins: Array, slacks: Array) -> tuple[Mask, Array]:
        """Return the mask of active rows, between their bounds, and l with the others at the bounds."""
        weights, saturated = margins[: self.count], np.zeros(self.count, dtype=bool)
        saturated[self.soft] = margins[self.count :] < slacks[self.count :]
        active = (weights > slacks[: self.count]) & ~saturated
        return active, np.where(saturated, self.prices, np.where(active, weights, 0.0))


def predictor_corrector(
    newton: Callable[[Array], tuple[Array, Array]],
    margins: Array,
    slacks: Array,
    mean: float,
    to_boundary: float = TO_BOUNDARY,
) -> tuple[Array, Array, Array, float]:
    """Return the step of other unknowns, the new margins and slacks, and the step length.

    It starts from margins > 0 and slacks > 0, ``mean`` of whose products is given. ``newton`` returns the steps of
    other unknowns and of the margins, for the target of slacks * d_margins + margins * d_slacks = target. The step
    length is 0 if the products have vanished: no step makes them smaller.
    """
    other, d_margins = newton(-margins * slacks)
    if mean < TINY:
        return np.zeros_like(other), margins, slacks, 0.0
    d_slacks = (-margins * slacks - slacks * d_margins) / margins
    length = min(1.0, _step_to_boundary(margins, d_margins, slacks, d_slacks))
    after = float((margins + length * d_margins) @ (slacks + length * d_slacks)) / float(margins @ slacks)
    target = after**3 * mean - margins * slacks - d_margins * d_slacks
    other, d_margins = newton(target)
    d_slacks = (target - slacks * d_margins) / margins
    length = min(1.0, to_boundary * _step_to_boundary(margins, d_margins, slacks, d_slacks))
    return length * other, margins + length * d_margins, slacks + length * d_slacks, length


def _step_to_boundary(margins: Array, d_margins: Array, slacks: Array, d_slacks: Array) -> float:
    """Return the step at which the first margin or slack becomes zero."""
    return 1 / max(TINY, float((-d_margins / margins).max()), float((-d_slacks / slacks).max()))


def _thin_factor(S: Array, diagonal_bound: Array) -> _Thin | None:
    """Return S by a thin factor of S or of diag(diagonal_bound) - S; None if neither is known to have a low rank.

    The eigenvalues of S, relative to diag(diagonal_bound), are near 0 and 1: they add up to its rank.
    """
    if len(S) <= LOW_RANK_ROWS or not (diagonal_bound > 0).all():
        return None
    share = float((np.diagonal(S) / diagonal_bound).mean())
    if min(share, 1 - share) > LARGEST_SHARE:
        return None
    base, sign = (np.zeros(len(S)), 1.0) if share < 1 - share else (diagonal_bound, -1.0)
    factored = sign * S  # symmetric: its transpose is in the order that LAPACK overwrites
    factored[np.diag_indices_from(S)] += base
    factor, pivots, rank, _ = dpstrf(factored.T, tol=RANK_TOLERANCE, lower=1, overwrite_a=1)
    thin = np.empty((len(S), rank), order="F")
    thin[pivots - 1] = np.tril(factor[:, :rank])
    missed = base + sign * (thin * thin).sum(1) - np.diagonal(S)
    return _Thin(base, sign, thin) if rank and np.abs(missed).max() < LOW_RANK_ERROR else None


class _Dense:
    """S itself, and factors of S + diag(added)."""

    def __init__(self, S: Array):
        self._S = S

    def times(self, v: Array) -> Array:
        """Return S v."""
        return self._S @ v

    def factor(self, added: Array) -> bool:
        """Factor S + diag(added); False if it is not positive definite."""
        matrix = self._S.copy()
        np.einsum("ii->i", matrix)[:] += added
        self._lower, failed = dpotrf(matrix.T, lower=1, overwrite_a=1, clean=0)
        return failed == 0

    def solve(self, r: Array) -> Array:
        """Return (S + diag(added))^{-1} r."""
        return dpotrs(self._lower, r, lower=1)[0]


class _Thin:
    """S = diag(base) + sign X X' with a thin factor X, and factors of S + diag(added)."""

    def __init__(self, base: Array, sign: float, thin: Array):
        self._base, self._sign, self._thin, self._scaled = base, sign, thin, np.empty_like(thin)

    def times(self, v: Array) -> Array:
        """Return S v."""
        return self._base * v + self._sign * (self._thin @ (self._thin.T @ v))

    def factor(self, added: Array) -> bool:
        """Factor S + diag(added); False if it is not positive definite."""
        self._diagonal = self._base + added
        np.divide(self._thin, np.sqrt(self._diagonal)[:, None], out=self._scaled)
        inner = dsyrk(self._sign, self._scaled, trans=1, lower=1)
        inner[np.diag_indices_from(inner)] += 1.0
        self._lower, failed = dpotrf(inner, lower=1, overwrite_a=1, clean=0)
        return failed == 0

    def solve(self, r: Array) -> Array:
        """Return (S + diag(added))^{-1} r, refined once where the diagonal is tiny."""
        v = self._solve_unrefined(r)
        if self._diagonal.min() < REFINED:
            v += self._solve_unrefined(r - self.times(v) - (self._diagonal - self._base) * v)
        return v

    def _solve_unrefined(self, r: Array) -> Array:
        inner = dpotrs(self._lower, self._thin.T @ (r / self._diagonal), lower=1)[0]
        return (r - self._sign * (self._thin @ inner)) / self._diagonal


@dataclass(frozen=True, eq=False)
class BorderedQp:
    """The small QP with the bordering unknowns as unknowns: free ends without cost, marginal modes.

    Elimination of an unknown of curvature h adds entries 1/h to S, and entries below 1e-16 of these are lost. Here
    theta and zeta stay, with a proximal term in K: find their step and weights l with

        K step + C (l - l_0) = defects,        slack - violation = slack_0 - C'step + S_W (l - l_0),

    both l'slack = 0 and (prices - l)'violation = 0, by Mehrotra's predictor-corrector on the symmetric indefinite
    matrix [[K, C], [C', -(S_W + diagonal of Pairs)]], then once more with the active rows as equations
    (docs/spectral.md, 7: compliant unknowns). K is (b, b), C (b, count), S_W (count, count), the ``size`` theta first.
    """

    size: int
    K: Array
    C: Array
    S_W: Array
    defects: Array  # (b,)
    slack: Array  # slack_0, of the weights l_0, (count,)
    weights: Array  # l_0
    prices: Array

    def solve(self, stop: Stop = lambda: None) -> tuple[Array, Array, bool]:
        """Return the step of (theta, zeta), the weights l, and whether they are accurate.

        They are the best iterate if ``stop`` ends it. The first attempt has no prices: these are often far above the
        weights, and cost digits.
        """
        if np.isfinite(self.prices).any():
            step, weights, accurate = replace(self, prices=np.full(len(self.prices), np.inf)).solve(stop)
            if accurate and (weights <= self.prices).all():
                return step, weights, True
        # in units of order 1
        units = equilibration(np.block([[self.K, self.C], [self.C.T, self.S_W]]))
        border, rows = np.split(units, [len(self.K)])
        parts = self.defects * border, self.slack * rows, self.weights / rows
        size = max(1e-300, *(float(np.abs(part).max(initial=0.0)) for part in parts))
        regular = np.where(np.arange(len(self.K)) < self.size, QP_RIDGE, -QP_RIDGE)
        scaled = BorderedQp(
            size=self.size,
            K=self.K * border * border[:, None] + np.diag(regular),
            C=self.C * border[:, None] * rows,
            S_W=self.S_W * rows * rows[:, None],
            defects=parts[0] / size,
            slack=parts[1] / size,
            weights=parts[2] / size,
            prices=self.prices / rows / size,
        )
        step, margins, slacks, accurate = _bordered_interior_point(scaled, stop)
        active, at_bounds = Pairs(scaled.prices).split(margins, slacks)
        polished = None if stop() else _bordered_polish(scaled, active, at_bounds)
        if polished is None:
            weights = margins[: len(at_bounds)]
            idle = IDLE_WEIGHT * np.maximum(slacks[: len(at_bounds)], float(weights.max(initial=0.0)))
            weights = np.where(weights < idle, 0.0, weights)
        else:
            step, weights = polished
        weights = np.where(weights >= scaled.prices, self.prices, weights * rows * size)
        return step * border * size, weights, accurate


def _bordered_interior_point(qp: BorderedQp, stop: Stop) -> tuple[Array, Array, Array, bool]:
    """Return the step of (theta, zeta), margins and slacks, and whether they are accurate."""
    b, count = qp.C.shape
    pairs, step = Pairs(qp.prices), np.zeros(b)
    margins = pairs.margins(np.ones(count), 1.0)
    slacks = pairs.slacks(qp.slack + qp.S_W @ (margins[:count] - qp.weights), margins, 1.0)
    best = np.inf, step, margins, slacks
    matrix = np.empty((b + count, b + count), order="F")
    matrix[:b, :b], matrix[:b, b:], matrix[b:, :b] = qp.K, qp.C, qp.C.T
    diagonal = np.arange(b, b + count)

    def newton(target: Array) -> tuple[Array, Array]:  # of (theta, zeta), and of the margins
        right = np.concatenate([border_defect, -row_defect - pairs.slope(target / margins)])
        change = dgetrs(factor, pivots, right)[0]
        return change[:b], pairs.steps(change[b:])

    for _ in range(INTERIOR_STEPS):
        change = margins[:count] - qp.weights
        border_defect = qp.defects - qp.C @ change - qp.K @ step
        row_defect = pairs.slope(slacks) - qp.slack + qp.C.T @ step - qp.S_W @ change
        mean = float(margins @ slacks) / len(margins)
        largest = max(float(np.abs(border_defect).max()), float(np.abs(row_defect).max()), mean)
        error = largest / (1 + float(margins[:count].max()))
        if error < best[0]:
            best = error, step, margins, slacks
        if (error < BORDERED_SOLVED and mean < BORDERED_COMPLEMENTARY) or not np.isfinite(error) or stop():
            break
        matrix[b:, b:] = -qp.S_W
        matrix[diagonal, diagonal] -= pairs.diagonal(margins, slacks) + QP_RIDGE
        factor, pivots, failed = dgetrf(matrix)
        if failed:
            break
        further, margins, slacks, length = predictor_corrector(newton, margins, slacks, mean)
        step = step + further
        if length < SHORTEST_STEP:
            break
    error, step, margins, slacks = best
    return step, margins, slacks, error < BORDERED_ACCURATE


def _bordered_polish(qp: BorderedQp, active: Mask, at_bounds: Array) -> tuple[Array, Array] | None:
    """Return the step and weights with the active rows as equations; None if signs or slacks are wrong.

    The weights of the others are ``at_bounds``, (count,): 0 or their prices.
    """
    for _ in range(DROPPINGS):
        rows = np.flatnonzero(active)
        matrix = np.block([[qp.K, qp.C[:, rows]], [qp.C[:, rows].T, -qp.S_W[np.ix_(rows, rows)]]])
        idle = np.where(active, 0.0, qp.weights - at_bounds)
        right = np.concatenate([qp.defects + qp.C @ idle, (qp.slack - qp.S_W @ idle)[rows]])
        factor, pivots, failed = dgetrf(matrix)
        if failed:
            return None
        solution = dgetrs(factor, pivots, right)[0]
        solution += dgetrs(factor, pivots, right - matrix @ solution)[0]
        if not np.isfinite(solution).all():
            return None
        step, weights = solution[: len(qp.K)], np.where(active, 0.0, at_bounds)
        weights[rows] = qp.weights[rows] + solution[len(qp.K) :]
        rounding = ACTIVE_SIGN * max(1.0, float(weights.max(initial=0.0)))
        below, above = weights < -rounding, weights > qp.prices + rounding
        if not (below | above).any():
            slack = qp.slack - qp.C.T @ step + qp.S_W @ (weights - qp.weights)
            wrong = np.where(weights >= qp.prices, slack > POLISHED_SLACK, slack < -POLISHED_SLACK)
            return None if wrong.any() else (step, np.clip(weights, 0.0, qp.prices))
        active, at_bounds = active & ~(below | above), np.where(above, qp.prices, at_bounds * ~active)
    return None
