"""One step of dynamic programming with intervals: bounds of c + V(f) over boxes of (x, u), and their bisection.

A box is bounded by Taylor's formula: a quadratic plus <sigma, f> over y = (x, u), with enclosures of f.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.certificate.hybrid.global_bound.lattice import ROUNDING, CostToGo, Lattice, Minima, PricedProblem
from lin_freq_ocp.certificate.hybrid.global_bound.samples import Samples, free_slopes, holds
from lin_freq_ocp.formulas.jets import IntervalJets, interval_jets, mean_value
from lin_freq_ocp.problem.hybrid.piecewise_smooth import SmoothMode

BISECTIONS = 10  # bisections at one time of a level; boxes that are still weak are the next level's work
SMALL_BATCH = 2000  # boxes that are bounded in the time a round needs to start: fewer are cut into four
BOXES_PER_CELL = 100  # boxes bounded at one time of a level, in addition to SMALL_BATCH
MAX_SPAN = {1: 12, 2: 12, 3: 5}  # cells along a state that an image may meet to be bounded by each, by states
MAX_PAIRS = 400_000  # pairs of boxes and cells bounded at once, with Hessians of 4 x 4: some hundred megabytes


def taylor_bounds(
    hessian: Array,
    gradient: Array,
    constant: Array,
    sigma: Array,
    at: Array,
    r: Array,
    centre: IntervalJets,
    whole: IntervalJets,
    box: Indices,
) -> Array:
    """Return lower bounds of given + gradient z + 1/2 z' hessian z + sigma (f(y + z) - at) over |z| <= r, (p,).

    hessian (p, k, k), gradient and r (p, k), given (p,), sigma and at (p, n). ``centre`` and ``whole`` enclose f at the
    centres y and over the boxes numbered by ``box`` (p,).
    """
    value, terms = constant.copy(), np.abs(constant)
    slope, bend = [gradient.copy(), gradient.copy()], [hessian.copy(), hessian.copy()]
    change = np.einsum("pi,pij->pj", r, np.abs(hessian))
    slope_over_box = [gradient - change, gradient + change]
    with np.errstate(invalid="ignore"):
        for j in range(sigma.shape[1]):
            s = sigma[:, j]
            reached = _scale_interval(s, centre.values[0][box, j], centre.values[1][box, j])
            value = value + reached[0] - s * at[:, j]
            terms += np.abs(reached[0]) + np.abs(s * at[:, j])
            for total, (low, high) in (
                (slope, centre.slopes),
                (slope_over_box, whole.slopes),
                (bend, whole.curvatures),
            ):
                factor = s.reshape(-1, *[1] * (low.ndim - 2))
                for side, more in enumerate(_scale_interval(factor, low[box, j], high[box, j])):
                    total[side] = total[side] + more
        first = np.where(r > 0, -np.maximum(np.abs(slope_over_box[0]), np.abs(slope_over_box[1])) * r, 0.0).sum(axis=1)
        best = np.fmax(second_order_least(slope, bend, r), np.where(np.isnan(first), -np.inf, first))
    infinite = np.isposinf(constant)
    terms = np.where(infinite, 0.0, terms - np.where(np.isfinite(best), best, 0.0))
    return np.where(infinite, np.inf, value + best - ROUNDING * terms)


def enclose(centre: IntervalJets, whole: IntervalJets, r: Array) -> tuple[Array, Array]:
    """Return bounds of values over |z| <= r: the intersection with those of the mean value theorem."""
    mean = mean_value(centre.values, whole.slopes, r)
    return np.fmax(whole.values[0], mean[0]), np.fmin(whole.values[1], mean[1])


def second_order_least(slope: Sequence[Array], bend: Sequence[Array], r: Array) -> Array:
    """Return the least of slope z + 1/2 z' bend z over |z| <= r, both known to lie between two bounds."""
    at_most = np.maximum(np.abs(slope[0]), np.abs(slope[1]))
    largest = np.maximum(np.abs(bend[0]), np.abs(bend[1]))
    diagonal = np.arange(r.shape[1])
    largest[:, diagonal, diagonal] = 0.0
    across = (largest * r[:, None, :]).sum(axis=2) / np.where(r > 0, r, 1.0)
    curvature = bend[0][:, diagonal, diagonal] - across
    turned = (curvature > 0) & (at_most < curvature * r)
    inner = -(at_most**2) / (2 * np.where(turned, curvature, 1.0))
    minimum = np.where(r > 0, np.where(turned, inner, -at_most * r + 0.5 * curvature * r * r), 0.0).sum(axis=1)
    return np.where(np.isnan(minimum), -np.inf, minimum)


def _scale_interval(factor: Array, low: Array, high: Array) -> tuple[Array, Array]:
    ends = factor * low, factor * high
    return np.fmin(*ends), np.fmax(*ends)


class OutOfTimeError(Exception):
    """The deadline has passed; no bound was found."""


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes of (x, u), each in a cell and a mode.

    Attributes
    ----------
    cell, mode : (boxes,)
    centre, radius : (boxes, n + m)
    low, high : (boxes, n)
        Bounds of the states that the box leads to.
    reduced : (boxes,)
        Reduced cost: c + V_{t+1}(f) >= V_t + reduced in the box.
    """

    cell: Indices
    mode: Indices
    centre: Array
    radius: Array
    low: Array
    high: Array
    reduced: Array

    @classmethod
    def unbounded(cls, cell: Indices, mode: Indices, centre: Array, radius: Array, n: int) -> Boxes:
        """Return boxes with no bounds of their images yet."""
        far = np.full((len(cell), n), np.inf)
        return cls(cell, mode, centre, radius, -far, far, np.zeros(len(cell)))

    @property
    def bytes(self) -> int:
        """Return the memory that the boxes take."""
        return sum(getattr(self, field.name).nbytes for field in fields(self))

    def take(self, chosen: Mask | Indices) -> Boxes:
        """Return some of the boxes."""
        return Boxes(*(getattr(self, field.name)[chosen] for field in fields(self)))

    @staticmethod
    def joined(parts: Sequence[Boxes]) -> Boxes:
        """Return the boxes of all parts."""
        return Boxes(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Boxes)))

    def bisected(self, steep: Array) -> tuple[Boxes, Array]:
        """Return both halves of every box along its steepest direction, and how steep they are, (boxes, n + m)."""
        rows, steepest = np.arange(len(steep)), np.argmax(steep, axis=1)
        radius, shift, less = self.radius.copy(), np.zeros_like(self.centre), steep.copy()
        radius[rows, steepest] /= 2
        shift[rows, steepest] = radius[rows, steepest]
        radius[rows, steepest] *= 1 + ROUNDING
        less[rows, steepest] /= 2
        image = self.low, self.high, self.reduced
        halves = [Boxes(self.cell, self.mode, self.centre + side * shift, radius, *image) for side in (-1, 1)]
        return Boxes.joined(halves), np.tile(less, (2, 1))

    def extremes(self, cells: int, part: slice) -> tuple[Array, Array]:
        """Return the least and largest values of components of (x, u) over the boxes of each cell, (cells, .)."""
        centre, radius = self.centre[:, part], self.radius[:, part]
        lower, upper = np.full((cells, centre.shape[1]), np.inf), np.full((cells, centre.shape[1]), -np.inf)
        np.minimum.at(lower, self.cell, centre - radius)
        np.maximum.at(upper, self.cell, centre + radius)
        return lower, upper


def met_cells(boxes: Boxes, after: CostToGo) -> Iterator[tuple[Indices, Indices]]:
    """Yield numbers of boxes with numbers of cells of t + 1 that they may lead to, in batches."""
    lattice = after.lattice
    first, final = lattice.indices(boxes.low, -1), lattice.indices(boxes.high, 1)
    for rows in _batches(np.flatnonzero(_meets(boxes, lattice)), first, final, MAX_PAIRS):
        yield _pairs(rows, first, final, boxes, after)


def _meets(boxes: Boxes, lattice: Lattice) -> Mask:
    margin = ROUNDING * (np.abs(lattice.lower) + np.abs(lattice.upper))
    meets = (boxes.high >= lattice.lower - margin) & (boxes.low <= lattice.upper + margin)
    return np.asarray(meets.all(axis=1))


class BackwardStep:
    """The step from t to t + 1."""

    def __init__(self, stages: PricedProblem, t: int, lattice: Lattice, after: CostToGo, deadline: float):
        self._modes, self._n, self._t = stages.modes(t), stages.problem.state_dim, t
        self._stages, self._lattice, self._after, self._deadline = stages, lattice, after, deadline
        self._pole = after.lattice.width == 0
        self._minima = Minima(after)
        self._hessian = stages.costs.hessians[t]
        self._most = MAX_PAIRS // max(1, self._hessian.size // 16)  # pairs at once

    def slopes(self, boxes: Boxes) -> tuple[Array, Array]:
        """Return slopes for the pieces of every cell, and the value at its centre that samples of its boxes allow."""
        ends = self._stages.lower[self._t], self._stages.upper[self._t]
        controls = boxes.extremes(len(self._lattice.cells), slice(self._n, None))
        lower, upper = (np.clip(bounds, *ends) for bounds in controls)
        return Samples(self._stages, self._t, self._lattice, lower, upper, self._after).slopes()

    def values(
        self, boxes: Boxes, slopes: Array, target: Array, cutoff: Array, tolerance: float, room: int
    ) -> tuple[CostToGo, Boxes]:
        """Return V_t with slopes (cells, pieces, n), and boxes that cover all trajectories below the cutoff.

        Boxes whose bound is above target (cells, pieces), or within the tolerance of the value at the centre of a box,
        are not bisected any more, nor are any beyond so many bytes of ``room``; those above the cutoff (cells,
        pieces) are dropped.
        """
        lattice, target = self._lattice, target.copy()
        lowest = np.full(target.shape, np.inf)
        cover_parts: list[Boxes] = []
        bounds_kept: list[Array] = []
        total, taken, most = 0, 0, SMALL_BATCH + BOXES_PER_CELL * len(lowest)
        for round_ in range(BISECTIONS):
            total, taken = total + len(boxes.cell), taken + boxes.bytes
            final = round_ == BISECTIONS - 1 or total > most or taken + 4 * boxes.bytes > room
            boxes, bounds, reached, steep = self._bound_boxes(boxes, slopes)
            np.minimum.at(target, boxes.cell, reached - tolerance)
            looked_at = np.flatnonzero(~(bounds >= cutoff[boxes.cell]).any(axis=1))
            boxes, bounds, steep = boxes.take(looked_at), bounds[looked_at], steep[looked_at]
            weak = np.asarray((bounds < target[boxes.cell]).any(axis=1) & (not final))
            np.minimum.at(lowest, boxes.cell[~weak], bounds[~weak])
            weak &= (bounds < np.minimum(target, lowest)[boxes.cell]).any(axis=1)
            np.minimum.at(lowest, boxes.cell[~weak], bounds[~weak])
            cover_parts.append(boxes.take(~weak))
            bounds_kept.append(bounds[~weak])
            boxes, steep = boxes.take(weak).bisected(steep[weak])
            if len(boxes.cell) < SMALL_BATCH:
                boxes, _ = boxes.bisected(steep)
            if not len(boxes.cell):
                break
        cover = Boxes.joined(cover_parts)
        with np.errstate(invalid="ignore"):
            cover.reduced[:] = np.nan_to_num((np.concatenate(bounds_kept) - lowest[cover.cell]).min(axis=1))
        return CostToGo(lattice, lowest, slopes, *cover.extremes(len(lowest), slice(self._n))), cover

    def _bound_boxes(self, boxes: Boxes, slopes: Array) -> tuple[Boxes, Array, Array, Array]:
        """Return the boxes in which their mode can hold, with bounds, values at centres, and losses per direction."""
        none = np.zeros((0, slopes.shape[1]))
        bounded = [(boxes.take(np.zeros(0, dtype=np.intp)), none, none, boxes.radius[:0])]
        for i, mode in enumerate(self._modes):
            rows = np.flatnonzero(boxes.mode == i)
            for start in range(0, len(rows), self._most // 8):
                if now() > self._deadline:
                    raise OutOfTimeError
                bounded.append(self._of_mode(mode, boxes.take(rows[start : start + self._most // 8]), slopes))
        parts, *arrays = zip(*bounded, strict=True)
        bounds, reached, steep = (np.concatenate(array) for array in arrays)
        return Boxes.joined(parts), bounds, reached, steep

    def _of_mode(self, mode: SmoothMode, boxes: Boxes, slopes: Array) -> tuple[Boxes, Array, Array, Array]:
        after = self._after.lattice
        # boxes in which the mode can hold somewhere
        possible, (y, r) = np.ones(len(boxes.cell), dtype=bool), (boxes.centre, boxes.radius)
        for formulas, inside in ((mode.region, 1.0), (mode.domain, -1.0)):
            if formulas:
                centre = interval_jets(formulas, y, y, curved=False, time=self._t)
                whole = interval_jets(formulas, y - r, y + r, curved=False, time=self._t)
                low, high = enclose(centre, whole, r)
                possible &= ~(low > 0 if inside > 0 else high <= 0).any(axis=1)
        boxes = boxes.take(possible)
        y, r = boxes.centre, boxes.radius
        formulas = *mode.f, *mode.cost  # the cost by formulas counts as one more component of f, with the slope 1
        whole = interval_jets(formulas, y - r, y + r, time=self._t)
        centre = interval_jets(formulas, y, y, curved=False, time=self._t)
        low, high = enclose(centre, whole, r)
        boxes.low[:], boxes.high[:] = low[:, : self._n], high[:, : self._n]
        meets = _meets(boxes, after)
        first, final = after.indices(boxes.low, -1), after.indices(boxes.high, 1)
        span = (final - first + 1).max(axis=1)
        cell_slopes = slopes[boxes.cell]
        gradient = np.repeat(
            (y @ self._hessian + self._stages.costs.linear[self._t])[:, None], cell_slopes.shape[1], axis=1
        )
        gradient[:, :, : self._n] -= cell_slopes
        from_centre = y[:, : self._n] - self._lattice.centres[boxes.cell]
        offset = self._stages.cost(self._t, y)[:, None] - np.einsum("psn,pn->ps", cell_slopes, from_centre)
        change = np.abs(gradient) + (r @ np.abs(self._hessian))[:, None]
        least = self._minima.least(first, final) + low[:, self._n :].sum(axis=1)
        bounds = offset - (change * r[:, None]).sum(axis=2) + least[:, None]
        bounds[~meets] = np.inf
        for rows in _batches(np.flatnonzero(meets & (span <= MAX_SPAN[self._n])), first, final, self._most):
            pair, cell = _pairs(rows, first, final, boxes, self._after)
            closer = np.full(bounds.shape, np.inf)
            for s in range(cell_slopes.shape[1]):
                pair_bounds = self._second_order(pair, cell, boxes, gradient[:, s], offset[:, s], centre, whole)
                np.minimum.at(closer[:, s], pair, pair_bounds)
            bounds[rows] = np.fmax(bounds[rows], closer[rows])
        steep = change.max(axis=1) * r
        # about how much of V the image of a box leaves open, by its directions: along a state where V is flat, as where
        # an end is fixed, an image over everything is worth the spread of V, or a cost
        widths = np.where(np.isfinite(boxes.high - boxes.low), boxes.high - boxes.low, 0.0)
        extent = np.maximum(after.upper - after.lower, widths.max(axis=0, initial=0.0))
        extent = np.where(extent > 0, extent, 1.0)
        cost = float(steep.sum(axis=1).max(initial=0.0))
        worth = self._minima.steepest + (self._minima.spread or cost or 1.0) / extent
        worth, extent = (np.append(part, np.ones(len(mode.cost))) for part in (worth, extent))
        largest = np.maximum(np.abs(whole.slopes[0]), np.abs(whole.slopes[1])) * r[:, None]
        everywhere = np.where(r[:, None] > 0, extent[:, None], 0.0)
        steep += np.einsum("i,pij->pj", worth, np.where(np.isfinite(largest), largest, everywhere))
        reached = 0.5 * (centre.values[0] + centre.values[1])
        cost_to_go = self._after.at(reached[:, : self._n]) + reached[:, self._n :].sum(axis=1)
        reached = np.where(holds(mode, y, self._t), cost_to_go, np.inf)
        return boxes, bounds, offset + reached[:, None], steep

    def _second_order(
        self,
        pair: Indices,
        cell: Indices,
        boxes: Boxes,
        gradient: Array,
        offset: Array,
        centre: IntervalJets,
        whole: IntervalJets,
    ) -> Array:
        """Return bounds of c + V(f) - slope x over boxes, with V that of one cell; the last of f may be a cost."""
        after, r, width = self._after, boxes.radius[pair], self._after.lattice.width
        at = after.lattice.centres[cell]
        middle = 0.5 * (centre.slopes[0] + centre.slopes[1])[pair]
        middle, of_cost = middle[:, : self._n], middle[:, self._n :]
        prices, steeper = np.ones(of_cost.shape[:2]), gradient[pair] + of_cost.sum(axis=1)
        target = np.hstack([at, np.zeros_like(prices)])
        half = width * (0.5 + ROUNDING) + ROUNDING * np.abs(at)
        low = np.fmax(np.fmax(boxes.low[pair], after.first[cell]) - at, -half)
        high = np.fmin(np.fmin(boxes.high[pair], after.last[cell]) - at, half)
        hessian = np.broadcast_to(self._hessian, (len(pair), *self._hessian.shape))
        bounds = np.full(len(pair), -np.inf)
        for piece in range(after.slopes.shape[1]):
            slopes, value = after.slopes[cell, piece], after.values[cell, piece]
            freed = free_slopes(steeper + np.einsum("pj,pji->pi", slopes, middle), middle, r)
            for change in (freed, np.where(self._pole, freed, 0.0)):
                less = np.where(self._pole, 0.0, np.fmax(change * low, change * high)).sum(axis=1)
                sigma, constant = slopes + change, value - less
                more = taylor_bounds(
                    hessian,
                    gradient[pair],
                    offset[pair] + constant,
                    np.hstack([sigma, prices]),
                    target,
                    r,
                    centre,
                    whole,
                    pair,
                )
                bounds = np.fmax(bounds, more)
        return bounds


def _batches(rows: Indices, first: Indices, final: Indices, most: int) -> Iterator[Indices]:
    """Yield batches of rows with some ``most`` pairs each."""
    counts = np.cumsum((final[rows] - first[rows] + 1).prod(axis=1)) // most
    for k in np.unique(counts):
        yield rows[counts == k]


def _pairs(rows: Indices, first: Indices, final: Indices, boxes: Boxes, after: CostToGo) -> tuple[Indices, Indices]:
    """Return boxes with each cell that their image meets and from which trajectories go on."""
    sizes = final[rows] - first[rows] + 1
    counts = sizes.prod(axis=1)
    pair = np.repeat(rows, counts)
    local = np.arange(len(pair)) - np.repeat(np.cumsum(counts) - counts, counts)
    repeated, indices = np.repeat(sizes, counts, axis=0), np.empty((len(pair), sizes.shape[1]), dtype=np.intp)
    for j in range(sizes.shape[1] - 1, -1, -1):
        local, indices[:, j] = np.divmod(local, repeated[:, j])
    cell = after.lattice.numbers(np.repeat(first[rows], counts, axis=0) + indices)
    pair, cell = pair[cell >= 0], cell[cell >= 0]
    met = ((boxes.low[pair] <= after.last[cell]) & (boxes.high[pair] >= after.first[cell])).all(axis=1)
    return pair[met], cell[met]
