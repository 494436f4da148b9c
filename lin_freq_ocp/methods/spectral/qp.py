"""The small QP over the working rows: min lam'S lam / 2 + d'lam over 0 <= lam <= u, S often singular.

docs/spectral.md, 6, 7 and 12. u is the price of a soft row and infinite for a hard one. A row with lam = u > 0 is
saturated: it is violated, and its slope S lam + d, which is its slack, is at most 0. S is positive semidefinite, and
numerically singular if a state or a control stays at a bound.

``bounded_qp`` tries block pivoting, then the interior point. ``BorderedQp`` keeps compliant bordering unknowns, whose
elimination would lose the digits of S. The exchange measures every answer by its signals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

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
RANK_TOLERANCE = 3e-15  # pivot at which the rank of diag - A is exhausted
LOW_RANK_ERROR = 1e-10  # diagonal that a thin factor may miss; with more, diag - A has negative eigenvalues
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


def bounded_qp(
    S: Array, d: Array, start: Array, upper: Array, diagonal_bound: Array, response: Array, stop: Stop = lambda: None
) -> tuple[Array, bool]:
    """Return (lam, whether it is accurate) from a warm start >= 0; not accurate if ``stop`` ends it early.

    ``upper`` is u. ``diagonal_bound`` is a diagonal with diag - S >= 0 of low rank: 1/R for control rows, else 0. If
    equations decide a soft row, it is saturated iff it is violated: its entry of S is a rounding error, relative to its
    ``response`` without equations.
    """
    decided = np.isfinite(upper) & (np.diagonal(S) < DECIDED_SOFT * response)
    if decided.any():  # they are at a bound of their multipliers
        lam, free, accurate = np.where(decided & (d < 0), upper, 0.0), ~decided, True
        if free.any():
            d = d[free] + S[np.ix_(free, decided)] @ lam[decided]
            rows = start[free], upper[free], diagonal_bound[free], response[free]
            lam[free], accurate = bounded_qp(S[np.ix_(free, free)], d, *rows, stop)
        return lam, accurate
    unit = 1 / np.sqrt(np.maximum(np.diagonal(S), TINY))
    size = max(float((np.abs(d) * unit).max()), TINY)
    A, b, warm = S * unit[:, None], d * unit / size, start / unit / size
    A *= unit
    scaled_upper = upper / unit / size
    lam, accurate = block_pivoting(A, b, warm, scaled_upper) if len(d) <= PIVOTING_ROWS else None, True
    if lam is None:
        lam, accurate = interior_point(A, b, scaled_upper, diagonal_bound * unit**2, warm, stop)
    return np.where(lam >= scaled_upper, upper, lam * unit * size), accurate  # exactly u if saturated


def block_pivoting(A: Array, b: Array, start: Array, upper: Array) -> Array | None:
    """Exchange all wrong rows at once, later the worst ones; None if that cycles, or if rows are nearly dependent.

    An exchange of all rows is fast, but cycles on some programs. Most cycles end if only rows with at least half of the
    worst error are exchanged. Judice and Pires (1994) exchange a single row instead, which takes longer.
    """
    slope, saturated, soft = A @ start + b, start >= upper, np.isfinite(upper).any()
    active = ((start > 0) | (slope < 0)) & ~saturated
    for step in range(PIVOTING_STEPS):
        lam, rows, target = np.zeros(len(b)), active.nonzero()[0], b
        if soft and saturated.any():
            lam[saturated] = upper[saturated]
            target = b + A[:, saturated] @ lam[saturated]
        if len(rows):
            factor, solution, failed = dposv(A.take(rows, 0).take(rows, 1), target[rows], lower=1)
            if failed or factor.diagonal().min() < PIVOTING_PIVOT:
                return None
            lam[rows] = -solution
        slope = A @ lam + b
        error = np.where(active, -lam, -WRONG_SLOPE - slope)
        if soft:
            error = np.where(active & (lam > upper), lam - upper, np.where(saturated, slope - WRONG_SLOPE, error))
        wrong = error > 0
        if not wrong.any():
            return lam
        if step >= STEPS_OF_ALL:  # multipliers and slopes are compared with their own kind
            worst = [error[kind].max(initial=0.0) for kind in (active, ~active)]
            wrong &= error >= WORST_SHARE * np.where(active, *worst)
        if soft:
            saturated = np.where(wrong, lam > upper, saturated)
        active ^= wrong
    return None


def interior_point(
    A: Array, b: Array, upper: Array, diagonal_bound: Array, start: Array, stop: Stop = lambda: None
) -> tuple[Array, bool]:
    """Return (lam, whether it is accurate) by Mehrotra's predictor-corrector; arguments after b as in ``bounded_qp``.

    A lam + b = z - y with lam >= 0, z >= 0, lam'z = 0, and, where u is finite, margin
    w = u - lam >= 0, y >= 0, w'y = 0.

    On saturated control arcs A has eigenvalues near 0 and 1, and multipliers are not unique: active-set methods cycle.
    There A is of low rank, the width of the pass band times the length of the arcs, or diag(diagonal_bound) - A >= 0
    is, with the width of the stop band: each step is then a small system (docs/spectral.md, 6).

    Mehrotra (1992), On the implementation of a primal-dual interior point method.
    """
    system, ridge, count = _thin_factor(A, diagonal_bound) or _Dense(A), INTERIOR_RIDGE, len(b)
    lam, least = (start, WARM) if start.any() else (np.ones(count), 1.0)
    caps = Caps(upper)
    weights = caps.inside(lam, least)
    z = caps.slacks(system.times(weights[:count]) + b, weights, least)
    best = np.inf, weights, z

    def newton(target: Array) -> tuple[Array, Array]:  # the steps of no other unknowns and of (lam, w)
        return np.zeros(0), caps.steps(system.solve(defect + caps.slope(target / weights)))

    for _ in range(INTERIOR_STEPS):
        lam = weights[:count]
        defect, mu = caps.slope(z) - system.times(lam) - b, float(weights @ z) / len(weights)
        error = max(float(np.abs(defect).max()), mu) / (1 + float(lam.max()))
        if error < best[0]:
            best = error, weights, z
        if error < INTERIOR_SOLVED or not error <= DIVERGED_ERROR * best[0] or stop():
            break
        if not system.factor(caps.diagonal(weights, z) + ridge):
            ridge *= 100
            if ridge > LARGEST_RIDGE:
                break
            continue
        _, weights, z, length = predictor_corrector(newton, weights, z, mu, max(TO_BOUNDARY, 1 - mu))
        if length < INTERIOR_ACCURATE:
            break
    error, weights, z = best
    return _polish(system, b, caps, weights, z), error < INTERIOR_ACCURATE


def _polish(system: _Dense | _Thin, b: Array, caps: Caps, weights: Array, z: Array) -> Array:
    """Return lam with zero slope on the active rows and the others at their bounds, if that lowers the slope."""
    active, lam = caps.split(weights, z)
    if not active.any() or not system.factor(np.where(active, INTERIOR_RIDGE, HOLDING_DIAGONAL)):
        return lam
    polished = lam.copy()
    for _ in range(POLISHES):
        slope = np.where(active, system.times(polished) + b, 0.0)
        polished = polished - np.where(active, system.solve(slope), 0.0)

    def slope_left(v: Array) -> float:
        return float(np.abs((system.times(v) + b)[active]).max())

    polished = np.clip(polished, 0.0, caps.upper)
    return polished if slope_left(polished) < slope_left(lam) else lam


class Caps:
    """Upper bounds u of lam, (count,): pairs (weights, slacks) are (lam, z), then (w, y) of the finite bounds."""

    def __init__(self, upper: Array):
        self.upper, self.capped, self.count = upper, np.flatnonzero(np.isfinite(upper)), len(upper)

    def inside(self, lam: Array, least: float) -> Array:
        """Return (lam, w) from a lam >= 0, shifted to the interior of its bounds."""
        lam = np.maximum(lam, least)
        cap = self.upper[self.capped]
        margin = np.minimum(least, cap / 4)
        lam[self.capped] = np.clip(lam[self.capped], margin, cap - margin)
        return np.concatenate([lam, cap - lam[self.capped]])

    def slacks(self, slope: Array, weights: Array, least: float) -> Array:
        """Return (z, y) for a slope z - y, with z at least ``least``; y may be smaller if the margin is wide."""
        smallest = least / np.maximum(1.0, weights[self.count :])
        return np.concatenate([np.maximum(slope, least), np.maximum(-slope[self.capped], smallest)])

    def slope(self, z: Array) -> Array:
        """Return z - y, (count,)."""
        return self._sum_of_pairs(z, -1.0)

    def _sum_of_pairs(self, pairs: Array, sign: float) -> Array:
        """Return the entries of (lam, z) plus ``sign`` times those of (w, y) of the same rows, (count,)."""
        if not len(self.capped):
            return pairs
        total = pairs[: self.count].copy()
        total[self.capped] += sign * pairs[self.count :]
        return total

    def diagonal(self, weights: Array, z: Array) -> Array:
        """Return z / lam + y / w, (count,)."""
        return self._sum_of_pairs(z / weights, 1.0)

    def steps(self, change: Array) -> Array:
        """Return the steps of (lam, w) from that of lam."""
        return np.concatenate([change, -change[self.capped]]) if len(self.capped) else change

    def split(self, weights: Array, z: Array) -> tuple[Mask, Array]:
        """Return the mask of active rows, between their bounds, and lam with the others at the bounds."""
        lam, saturated = weights[: self.count], np.zeros(self.count, dtype=bool)
        saturated[self.capped] = weights[self.count :] < z[self.count :]
        active = (lam > z[: self.count]) & ~saturated
        return active, np.where(saturated, self.upper, np.where(active, lam, 0.0))


def predictor_corrector(
    newton: Callable[[Array], tuple[Array, Array]],
    weights: Array,
    z: Array,
    mu: float,
    to_boundary: float = TO_BOUNDARY,
) -> tuple[Array, Array, Array, float]:
    """Return the step of other unknowns, the new weights and slacks, and the step length.

    It starts from weights l > 0 and slacks z > 0 with mu = l'z / count.
    ``newton`` returns the steps of other unknowns and of l for the target of the equations z dl + l dz = target. The
    step length is 0 if the products l z have vanished: no step makes them smaller.
    """
    other, dw = newton(-weights * z)
    if mu < TINY:
        return np.zeros_like(other), weights, z, 0.0
    dz = (-weights * z - z * dw) / weights
    length = min(1.0, _step_to_boundary(weights, dw, z, dz))
    after = float((weights + length * dw) @ (z + length * dz)) / float(weights @ z)
    target = after**3 * mu - weights * z - dw * dz
    other, dw = newton(target)
    dz = (target - z * dw) / weights
    length = min(1.0, to_boundary * _step_to_boundary(weights, dw, z, dz))
    return length * other, weights + length * dw, z + length * dz, length


def _step_to_boundary(weights: Array, dw: Array, z: Array, dz: Array) -> float:
    """Return the step at which the first entry of weights + step dw or z + step dz becomes zero."""
    return 1 / max(TINY, float((-dw / weights).max()), float((-dz / z).max()))


def _thin_factor(A: Array, diagonal_bound: Array) -> _Thin | None:
    """Return A by a thin factor of A or of diag(diagonal_bound) - A; None if neither is known to have a low rank.

    The eigenvalues of A, relative to diag(diagonal_bound), are near 0 and 1: they add up to its rank.
    """
    if len(A) <= LOW_RANK_ROWS or not (diagonal_bound > 0).all():
        return None
    share = float((np.diagonal(A) / diagonal_bound).mean())
    if min(share, 1 - share) > LARGEST_SHARE:
        return None
    base, sign = (np.zeros(len(A)), 1.0) if share < 1 - share else (diagonal_bound, -1.0)
    factored = sign * A  # symmetric: its transpose is in the order that LAPACK overwrites
    factored[np.diag_indices_from(A)] += base
    factor, pivots, rank, _ = dpstrf(factored.T, tol=RANK_TOLERANCE, lower=1, overwrite_a=1)
    V = np.empty((len(A), rank), order="F")
    V[pivots - 1] = np.tril(factor[:, :rank])
    missed = base + sign * (V * V).sum(1) - np.diagonal(A)
    return _Thin(base, sign, V) if rank and np.abs(missed).max() < LOW_RANK_ERROR else None


class _Dense:
    """A itself, and factors of A + diag(w)."""

    def __init__(self, A: Array):
        self.A = A

    def times(self, v: Array) -> Array:
        """Return A v."""
        return self.A @ v

    def factor(self, w: Array) -> bool:
        """Factor A + diag(w); False if it is not positive definite."""
        matrix = self.A.copy()
        np.einsum("ii->i", matrix)[:] += w
        self._lower, failed = dpotrf(matrix.T, lower=1, overwrite_a=1, clean=0)
        return failed == 0

    def solve(self, r: Array) -> Array:
        """Return (A + diag(w))^{-1} r."""
        return dpotrs(self._lower, r, lower=1)[0]


class _Thin:
    """A = diag(base) + sign V V' with a thin V, and factors of A + diag(w)."""

    def __init__(self, base: Array, sign: float, V: Array):
        self._base, self._sign, self._V, self._scaled = base, sign, V, np.empty_like(V)

    def times(self, v: Array) -> Array:
        """Return A v."""
        return self._base * v + self._sign * (self._V @ (self._V.T @ v))

    def factor(self, w: Array) -> bool:
        """Factor A + diag(w); False if it is not positive definite."""
        self._diagonal = self._base + w
        np.divide(self._V, np.sqrt(self._diagonal)[:, None], out=self._scaled)
        inner = dsyrk(self._sign, self._scaled, trans=1, lower=1)
        inner[np.diag_indices_from(inner)] += 1.0
        self._lower, failed = dpotrf(inner, lower=1, overwrite_a=1, clean=0)
        return failed == 0

    def solve(self, r: Array) -> Array:
        """Return (A + diag(w))^{-1} r, refined once where the diagonal is tiny."""
        x = self._solve_unrefined(r)
        tiny = self._diagonal.min() < REFINED
        return x + self._solve_unrefined(r - self.times(x) - (self._diagonal - self._base) * x) if tiny else x

    def _solve_unrefined(self, r: Array) -> Array:
        inner = dpotrs(self._lower, self._V.T @ (r / self._diagonal), lower=1)[0]
        return (r - self._sign * (self._V @ inner)) / self._diagonal


@dataclass(frozen=True, eq=False)
class BorderedQp:
    """The small QP with the bordering unknowns as unknowns: free ends without cost, marginal modes.

    Elimination of an unknown of curvature h adds entries 1/h to S, and entries below 1e-16 of these are lost. Here
    the unknowns stay, with a proximal term: find the step p of (theta, zeta), weights l and slacks z with

        K p + C (l - l_0) = r,   z - y = s_0 - C'p + S_W (l - l_0),   l >= 0,  z >= 0,  l'z = 0,

    and y >= 0 with y'(u - l) = 0 at upper bounds l <= u, by Mehrotra's predictor-corrector on the symmetric indefinite
    matrix [[K, C], [C', -(S_W + Z/L + Y/(U - L))]], then once more with the active rows as equations (docs/spectral.md,
    7: compliant unknowns). K is (b, b), C (b, count), S_W (count, count), r (b,), s_0, l_0, u (count,); theta is first.
    """

    size: int
    K: Array
    C: Array
    S: Array
    r: Array
    slack: Array
    weights: Array
    upper: Array

    def solve(self, stop: Stop = lambda: None) -> tuple[Array, Array, bool]:
        """Return the step p, the weights l, and whether they are accurate; the best iterate if ``stop`` ends it.

        The first attempt has no upper bounds: these are often far above the weights, and cost digits.
        """
        if np.isfinite(self.upper).any():
            step, weights, accurate = replace(self, upper=np.full(len(self.upper), np.inf)).solve(stop)
            if accurate and (weights <= self.upper).all():
                return step, weights, True
        # in units of order 1
        units = equilibration(np.block([[self.K, self.C], [self.C.T, self.S]]))
        border, rows = np.split(units, [len(self.K)])
        parts = self.r * border, self.slack * rows, self.weights / rows
        size = max(1e-300, *(float(np.abs(part).max(initial=0.0)) for part in parts))
        regular = np.where(np.arange(len(self.K)) < self.size, QP_RIDGE, -QP_RIDGE)
        scaled = BorderedQp(
            size=self.size,
            K=self.K * border * border[:, None] + np.diag(regular),
            C=self.C * border[:, None] * rows,
            S=self.S * rows * rows[:, None],
            r=parts[0] / size,
            slack=parts[1] / size,
            weights=parts[2] / size,
            upper=self.upper / rows / size,
        )
        p, weights, z, accurate = _bordered_interior_point(scaled, stop)
        active, at_bounds = Caps(scaled.upper).split(weights, z)
        polished = None if stop() else _bordered_polish(scaled, active, at_bounds)
        weights, z = weights[: len(at_bounds)], z[: len(at_bounds)]
        if polished is None:
            idle = IDLE_WEIGHT * np.maximum(z, float(weights.max(initial=0.0)))
            weights = np.where(weights < idle, 0.0, weights)
        else:
            p, weights = polished
        weights = np.where(weights >= scaled.upper, self.upper, weights * rows * size)
        return p * border * size, weights, accurate


def _bordered_interior_point(qp: BorderedQp, stop: Stop) -> tuple[Array, Array, Array, bool]:
    b, count = qp.C.shape
    caps, p = Caps(qp.upper), np.zeros(b)
    weights = caps.inside(np.ones(count), 1.0)
    z = caps.slacks(qp.slack + qp.S @ (weights[:count] - qp.weights), weights, 1.0)
    best = np.inf, p, weights, z
    matrix = np.empty((b + count, b + count), order="F")
    matrix[:b, :b], matrix[:b, b:], matrix[b:, :b] = qp.K, qp.C, qp.C.T
    diagonal = np.arange(b, b + count)

    def newton(target: Array) -> tuple[Array, Array]:  # the steps of p and of (l, u - l)
        step = dgetrs(factor, pivots, np.concatenate([r1, -r2 - caps.slope(target / weights)]))[0]
        return step[:b], caps.steps(step[b:])

    for _ in range(INTERIOR_STEPS):
        change = weights[:count] - qp.weights
        r1 = qp.r - qp.C @ change - qp.K @ p
        r2 = caps.slope(z) - qp.slack + qp.C.T @ p - qp.S @ change
        mu = float(weights @ z) / len(weights)
        error = max(float(np.abs(r1).max()), float(np.abs(r2).max()), mu) / (1 + float(weights[:count].max()))
        if error < best[0]:
            best = error, p, weights, z
        if (error < BORDERED_SOLVED and mu < BORDERED_COMPLEMENTARY) or not np.isfinite(error) or stop():
            break
        matrix[b:, b:] = -qp.S
        matrix[diagonal, diagonal] -= caps.diagonal(weights, z) + QP_RIDGE
        factor, pivots, failed = dgetrf(matrix)
        if failed:
            break
        dp, weights, z, length = predictor_corrector(newton, weights, z, mu)
        p = p + dp
        if length < SHORTEST_STEP:
            break
    error, p, weights, z = best
    return p, weights, z, error < BORDERED_ACCURATE


def _bordered_polish(qp: BorderedQp, active: Mask, at_bounds: Array) -> tuple[Array, Array] | None:
    """Return the step and weights with the active rows as equations; None if signs or slacks are wrong.

    The weights of the others are ``at_bounds``, (count,): 0 or their upper bounds.
    """
    for _ in range(DROPPINGS):
        rows = np.flatnonzero(active)
        matrix = np.block([[qp.K, qp.C[:, rows]], [qp.C[:, rows].T, -qp.S[np.ix_(rows, rows)]]])
        idle = np.where(active, 0.0, qp.weights - at_bounds)
        right = np.concatenate([qp.r + qp.C @ idle, (qp.slack - qp.S @ idle)[rows]])
        factor, pivots, failed = dgetrf(matrix)
        if failed:
            return None
        step = dgetrs(factor, pivots, right)[0]
        step += dgetrs(factor, pivots, right - matrix @ step)[0]
        p, exact = step[: len(qp.r)], np.where(active, 0.0, at_bounds)
        exact[rows] = qp.weights[rows] + step[len(qp.r) :]
        if not np.isfinite(step).all():
            return None
        sign = ACTIVE_SIGN * max(1.0, float(exact.max(initial=0.0)))
        below, above = exact < -sign, exact > qp.upper + sign
        if not (below | above).any():
            slack = qp.slack - qp.C.T @ p + qp.S @ (exact - qp.weights)
            wrong = np.where(exact >= qp.upper, slack > POLISHED_SLACK, slack < -POLISHED_SLACK)
            return None if wrong.any() else (p, np.clip(exact, 0.0, qp.upper))
        active, at_bounds = active & ~(below | above), np.where(above, qp.upper, at_bounds * ~active)
    return None
