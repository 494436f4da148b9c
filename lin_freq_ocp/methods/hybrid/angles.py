"""A lower bound on the cost of every pulse train, by branch and bound over boxes of its angles.

J = E + e_0 and b_k (quarter.py) are twice differentiable in the angles, with K_ab = pi/2 - max(a, b) and
K_aa = -min(a, b) for a != b, and d^2 K(a, a)/da^2 = pi - 4a.
With any lambda and l_k <= b_k <= h_k, a feasible train has

    J >= L = J + sum_k lambda_k b_k - sum_k max(lambda_k l_k, lambda_k h_k),

and on a box with centre c and half widths r, by Taylor's formula,

    L >= L(c) - sum_i |L_i(c)| r_i + 1/2 sum_i min(0, least of L_ii) r_i^2 - 1/2 sum_(i != j) |L_ij| r_i r_j.

lambda makes the slope at the centre small (least squares), or is zero. Boxes are left out where a dwell is too short,
or a b_k misses its bounds; the others are halved until the least of their bounds is the cost wanted. Patterns of
steps are all those with levels within the limit. A train with fewer switches is one of them: two opposite steps at the
same angle do nothing, nor does a step at pi/2. No bound is below that of Parseval's equation, J = sum_k (b_k/k)^2 + e_0
over all odd k: the least squares of the amplitudes that have bounds, and nothing of the others.

The local search over angles is sequential quadratic programming.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from functools import partial

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.hybrid.quarter import Quarter
from lin_freq_ocp.problem.hybrid.pulse_train import QUARTER

ROUNDING = 1e-12  # of the sums of the absolute terms of J and b_k: some 10^3 rounding errors are smaller
MOST_BOXES = 2_000_000  # at once: some seconds and a gigabyte
MOST_PATTERNS = 100_000  # of steps: of more, MOST_BOXES is reached while boxes are still wide
BATCH = 20_000  # boxes bounded between two looks at the clock: some hundredths of a second
STEEPEST = 100.0  # largest multiplier, in sizes of J over those of b_k: its terms' rounding is below that of J
COST_ROUNDING = 1e-15  # change of the cost, relative to the sum of its terms, that is rounding: steps end there
AMPLITUDE_VIOLATION = 1e-9  # of amplitudes of order 1: less than the tolerance of the judge


@dataclass(frozen=True, eq=False)
class AngleBoxes:
    """Boxes of angles: patterns of steps, centres and half widths, each (boxes, d), and bounds (boxes,)."""

    steps: Array
    centre: Array
    radius: Array
    bound: Array

    def take(self, kept: Indices | Mask) -> AngleBoxes:
        """Return some of the boxes."""
        return AngleBoxes(self.steps[kept], self.centre[kept], self.radius[kept], self.bound[kept])

    @staticmethod
    def joined(parts: Sequence[AngleBoxes]) -> AngleBoxes:
        """Return the boxes of all parts."""
        names = [field.name for field in fields(AngleBoxes)]
        return AngleBoxes(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def halved(self) -> AngleBoxes:
        """Return both halves of every box along its longest side."""
        rows, side, radius = np.arange(len(self.bound)), self.radius.argmax(axis=1), self.radius.copy()
        radius[rows, side] /= 2
        shift = np.zeros_like(radius)
        shift[rows, side] = radius[rows, side]
        return AngleBoxes.joined([replace(self, centre=self.centre + s * shift, radius=radius) for s in (-1.0, 1.0)])


class AngleBound:
    """The boxes of one problem; ``halve`` them until ``value`` is the bound wanted.

    ``low`` and ``high`` are the bounds on the amplitudes, and ``size`` is the sum of the absolute terms of J.
    """

    def __init__(self, quarter: Quarter):
        self._quarter = quarter
        self._orders = np.array(quarter.orders, dtype=float)
        self._price, self._offset = quarter.price, quarter.offset
        self.low, self.high = quarter.low, quarter.high
        d = len(quarter.dwells) - 1
        self._amplitude = max(d, 1) * quarter.step * 4 / np.pi
        self.size = self._price * (2 * self._amplitude**2 + abs(self._offset))
        # all patterns of steps whose levels stay within their bounds
        signs = np.zeros((1, 0))
        for _ in range(d):
            signs = np.vstack([np.column_stack([signs, np.full(len(signs), s)]) for s in (1.0, -1.0)])
            levels = signs.sum(axis=1)
            signs = signs[(levels >= quarter.lowest) & (levels <= quarter.highest)]
            if len(signs) > MOST_PATTERNS:
                raise UnsupportedError(
                    f"no bound over angles: got more than {MOST_PATTERNS:,} orders of {d} steps up and down; expected "
                    "a shorter horizon, or fewer levels."
                )
        steps = signs * quarter.step
        least = zip(np.maximum(np.maximum(self.low, -self.high), 0.0), quarter.orders, strict=True)
        trivial = sum(((Fraction(b) / k) ** 2 for b, k in least), Fraction(self._offset))
        whole = self._price * np.nextafter(float(trivial), -np.inf)
        middle = np.full(steps.shape, QUARTER / 2)
        self.boxes = AngleBoxes(steps, middle, middle.copy(), np.full(len(steps), whole))
        self.done = np.inf  # the least bound of the boxes that were dropped for their bound

    @property
    def value(self) -> float:
        """Return the bound on the cost of every train."""
        return min(self.done, float(self.boxes.bound.min(initial=np.inf)))

    @property
    def widest(self) -> float:
        """Return the largest half width; 0 without boxes."""
        return float(self.boxes.radius.max(initial=0.0))

    def best(self) -> Iterator[tuple[Array, Array]]:
        """Yield steps and angles of the centre of the box with the least bound, of one pattern after the other."""
        seen = set[bytes]()
        for i in np.argsort(self.boxes.bound):
            key = self.boxes.steps[i].tobytes()
            if key not in seen:
                seen.add(key)
                yield self.boxes.steps[i], np.maximum.accumulate(self.boxes.centre[i])

    def halve(self, cutoff: float, end: float = np.inf) -> bool:
        """Halve every box with a bound below the cutoff along its longest side; False where there are too many.

        Boxes whose turn comes after ``end``, by ``clock.now``, stay whole.
        """
        open_ = self.boxes.bound < cutoff
        self.done = min(self.done, float(self.boxes.bound[~open_].min(initial=np.inf)))
        self.boxes = self.boxes.take(open_)
        count = len(self.boxes.bound)
        if 2 * count > MOST_BOXES:
            return False
        batches = [self.boxes.take(rows) for rows in np.array_split(np.arange(count), count // BATCH + 1)]
        self.boxes = AngleBoxes.joined([one if now() > end else self._bound_boxes(one.halved()) for one in batches])
        return True

    def _bound_boxes(self, boxes: AngleBoxes) -> AngleBoxes:
        """Return the boxes that may hold a train, with their bounds: not below those of the boxes that they are of."""
        s, c, r = boxes.steps, boxes.centre, boxes.radius
        # boxes whose dwells and amplitudes may meet their bounds
        ends = ((0, 0), (1, 1))
        low, high = np.pad(c - r, ends), np.pad(c + r, ends)
        low[:, -1] = high[:, -1] = QUARTER
        ordered = (low[:, :-1] + self._quarter.dwells <= high[:, 1:] + ROUNDING).all(axis=1)
        values, slopes, curvature = self._amplitudes(s, c, r)
        reach = (np.abs(slopes) * r[:, None]).sum(2) + (curvature * r[:, None] ** 2).sum(2) / 2
        reach += ROUNDING * self._amplitude
        meets = ((values + reach >= self.low) & (values - reach <= self.high)).all(axis=1)
        possible = np.flatnonzero(ordered & meets)
        boxes, values, slopes, curvature = boxes.take(possible), values[possible], slopes[possible], curvature[possible]
        s, c, r = boxes.steps, boxes.centre, boxes.radius
        cost, slope, most, least = self._cost(s, c, r)
        bound = boxes.bound
        for active in (0, 1, len(self._orders)):
            # lambda that makes the slope at the centre small; zero where it would be large
            weights = np.zeros((len(slope), active))
            if active:
                weights = -np.einsum("nik,ni->nk", np.linalg.pinv(slopes[:, :active], rcond=1e-6), slope)
                small = (np.abs(weights) < STEEPEST * self.size / self._amplitude).all(axis=1, keepdims=True)
                weights = np.where(small, weights, 0.0)
            value = cost + (weights * values[:, :active]).sum(1)
            limits = np.where(weights > 0, self.high[:active], self.low[:active])
            ends = weights * np.where(weights == 0, 0.0, limits)  # there may be no limit where there is no multiplier
            steep = np.abs(slope + np.einsum("nk,nki->ni", weights, slopes[:, :active]))
            diagonal = least + np.einsum("nk,nki->ni", np.abs(weights), -curvature[:, :active])
            bend = (np.minimum(diagonal, 0.0) * r**2).sum(1) - np.einsum("ni,nij,nj->n", r, most, r)
            bound = np.maximum(bound, value - ends.sum(1) - (steep * r).sum(1) + bend / 2 - ROUNDING * self.size)
        return AngleBoxes(s, c, r, bound)

    def _amplitudes(self, s: Array, c: Array, r: Array) -> tuple[Array, Array, Array]:
        """Return b_k at centres, (boxes, k), slopes and largest |second derivatives| on boxes, (boxes, k, d)."""
        k, weight = self._orders[:, None], (4 / np.pi) * s[:, None]
        waves, turned = np.cos(k * c[:, None]), -np.sin(k * c[:, None])
        curved = np.minimum(np.abs(waves) + k * r[:, None], 1.0)
        return (weight * waves / k).sum(2), weight * turned, np.abs(weight) * k * curved

    def _cost(self, s: Array, c: Array, r: Array) -> tuple[Array, Array, Array, Array]:
        """Return J and its slopes at centres, the largest |L_ij| (i != j, else 0) and the least L_ii of J on boxes."""
        a, both = QUARTER - c, self._price * (4 / np.pi) * s[:, :, None] * s[:, None, :]
        low, high = np.minimum(a[:, :, None], a[:, None, :]), np.maximum(a[:, :, None], a[:, None, :])
        kernel = low * high * QUARTER - low**3 / 6 - low * high**2 / 2
        cost = (both * kernel).sum((1, 2)) + self._price * self._offset
        first, second = a[:, :, None], a[:, None, :]
        of_first = np.where(first <= second, second * QUARTER - (first**2 + second**2) / 2, second * (QUARTER - first))
        slope = -2 * (both * of_first).sum(2)
        others = ~np.eye(a.shape[1], dtype=bool)
        widest = np.maximum(r[:, :, None], r[:, None, :])
        most = np.where(others, np.abs(2 * both) * np.maximum(QUARTER - high + widest, 0.0), 0.0)
        mixed = -2 * both * np.where(both > 0, low + widest, np.maximum(low - widest, 0.0))
        alone = np.diagonal(both, axis1=1, axis2=2) * (np.pi - 4 * a - 4 * r)
        return cost, slope, most, alone + np.where(others, mixed, 0.0).sum(2)


def local_angles(quarter: Quarter, steps: Array, angles: Array) -> tuple[Array, float] | None:
    """Return the angles (d,) of a local optimum near ``angles``, and its cost; None if the search fails."""
    from scipy.optimize import LinearConstraint, NonlinearConstraint, minimize  # slow to import

    low, high, count = quarter.low, quarter.high, len(angles)
    size = 2 * (max(count, 1) * quarter.step * 4 / np.pi) ** 2 + abs(quarter.offset)

    def cost(angles: Array) -> tuple[float, Array]:
        value, slope = quarter.energy(steps, angles)
        return (value + quarter.offset) / size, slope / size

    def amplitudes(derivative: int, rows: Indices, angles: Array) -> Array:  # of order 0, or 1: their slopes
        return quarter.amplitudes(steps, angles)[derivative][rows]

    constraints: list[LinearConstraint | NonlinearConstraint] = []
    limited = np.isfinite(low) | np.isfinite(high)
    for rows in (np.flatnonzero(low == high), np.flatnonzero((low < high) & limited)):
        if len(rows):
            values, slopes = partial(amplitudes, 0, rows), partial(amplitudes, 1, rows)
            constraints.append(NonlinearConstraint(values, low[rows], high[rows], jac=slopes))
    if count > 1:
        constraints.append(LinearConstraint(np.diff(np.eye(count), axis=0), quarter.dwells[1:-1], np.inf))
    first, last = quarter.dwells[0], QUARTER - quarter.dwells[-1]
    optimum = minimize(
        cost,
        angles,
        jac=True,
        method="SLSQP",
        bounds=[(first, last)] * count,
        constraints=constraints,
        options={"ftol": COST_ROUNDING, "maxiter": 200},
    )
    at = np.clip(np.maximum.accumulate(optimum.x), first, last)
    values, _ = quarter.amplitudes(steps, at)
    violation = float(np.maximum(low - values, values - high).max(initial=0.0))
    violation = max(violation, float((quarter.dwells[1:-1] - np.diff(at)).max(initial=0.0)))
    return None if violation > AMPLITUDE_VIOLATION else (at, quarter.price * size * cost(at)[0])
