"""A lower bound on the cost of every trajectory of piecewise-smooth dynamics, by dynamic programming with intervals.

For one or two states. Backwards in time, every cell of a grid of states gets an affine function V_t below

    min over u of   c_t(x, u) + V_{t+1}(f_t(x, u)),

with any slope; D is the least of V_0 over X_0. c_t holds the signals of frequency multipliers, which vanish in the sum
over a feasible trajectory, so that for any multipliers D is a bound; its distance to the optimum is then at least the
duality gap of the frequency constraint. The minimum is taken over boxes of (x, u), modes, and cells that the image of a
box meets, each bounded by Taylor's formula of second order with enclosures of f, its gradient and its Hessian. Boxes
are bisected where that says too little. Where a cell has no width, as a fixed end, the slope is free: it is chosen so
that the bound is best.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.certificate.value_grid import ROUNDING, Grid, RangeMinima
from lin_freq_ocp.certificate.value_samples import Samples, arrivals, freed_slopes, stage_cost
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.problem.arrays import Array, Indices, Mask
from lin_freq_ocp.problem.interval_jets import IntervalJets, interval_jets, mean_value
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.piecewise_smooth import SmoothMode
from lin_freq_ocp.problem.stage_costs import StageCosts, stage_costs
from lin_freq_ocp.problem.trajectory import Multipliers

MOST_STATES = 2
"""Cells are as many as a power of this: three states need minutes."""

ROUNDS = {1: 17, 2: 13}
"""Bisections of a box of (x, u) at most, by the number of states."""

FIRST_BOXES = 16
"""Boxes of the controls of a cell to begin with, for one control; the root of it for each of two."""

MOST_SPANNED = 12
"""Boxes whose image meets more cells along a state are bisected before they are bounded by each of them."""

MOST_PAIRS = 400_000
"""Boxes and cells bounded at once: some hundred megabytes."""

CUT_MARGIN = 5e-2
"""Part of the cost by which what it costs to come to a cell may be overestimated."""


class OutOfTimeError(Exception):
    """The time is over; no bound was found."""


def value_bound(
    problem: OptimalControlProblem,
    multipliers: Multipliers,
    cost: float,
    cells: int,
    tolerance: float,
    deadline: float = np.inf,
    progress: Callable[[int], None] | None = None,
) -> float:
    """Return D <= J for every feasible trajectory.

    Parameters
    ----------
    multipliers : Multipliers
        Those of frequency constraints and terms; eta is not looked at.
    cost : float
        Of a trajectory: what costs more is not looked at closely. D is a bound whatever it is.
    cells : int
        Of each state.
    tolerance : float
        What each step may lose.
    deadline : float
        Of ``time.perf_counter``, at which OutOfTimeError is raised.
    progress : callable, optional
        Called with the time that is done.

    Raises
    ------
    UnsupportedError
        If there are more than two states, or a state or control is not bounded.
    """
    costs, T = stage_costs(problem, multipliers), problem.horizon
    grids = _grids(problem, cells)
    spent = arrivals(problem, costs, grids)
    after = _last(costs, grids[T])
    for t in range(T - 1, -1, -1):
        here = _Backward(problem, costs, t, grids[t], after, deadline)
        target = cost - costs.constant - spent[t] + CUT_MARGIN * max(1.0, abs(cost))
        after = here.values(target, tolerance)
        if progress is not None:
            progress(t)
    slack = ROUNDING * T * (costs.size + float(np.abs(after.values[np.isfinite(after.values)]).max(initial=0.0)))
    return float(after.least.min() + costs.constant - slack)


def _grids(problem: OptimalControlProblem, cells: int) -> list[Grid]:
    """Return cells over what can be reached at each time, without values."""
    n = problem.state_dim
    tube, controls = problem.state_tube, problem.control_tube
    if n > MOST_STATES:
        raise UnsupportedError(f"a global bound: got {n} states; expected at most {MOST_STATES}.")
    lower, upper, grids = tube.lower[0], tube.upper[0], list[Grid]()
    for t in range(problem.horizon + 1):
        for j in np.flatnonzero(~np.isfinite(lower) | ~np.isfinite(upper)):
            raise UnsupportedError(f"a global bound: {problem.state_names[j]} is not bounded at t = {t}.")
        width, shape = upper - lower, np.where(upper > lower, cells, 1)
        grids.append(Grid(lower, width / shape, shape, np.zeros((0, 1)), np.zeros((0, 1, n)), *np.zeros((2, 0, n))))
        if t == problem.horizon:
            break
        box = [np.append(part, bound[t])[None] for part, bound in ((lower, controls.lower), (upper, controls.upper))]
        for j in np.flatnonzero(~np.isfinite(box[0][0, n:]) | ~np.isfinite(box[1][0, n:])):
            raise UnsupportedError(f"a global bound: {problem.control_names[j]} is not bounded.")
        images = [interval_jets(mode.f, *box).values for mode in problem.smooth_pieces.modes]
        lower = np.maximum(np.min([image[0][0] for image in images], axis=0), tube.lower[t + 1])
        upper = np.minimum(np.max([image[1][0] for image in images], axis=0), tube.upper[t + 1])
        upper = np.maximum(lower, upper)  # where nothing is left, no image will meet the cell
    return grids


def _last(costs: StageCosts, grid: Grid) -> Grid:
    """Return the tangents of the last cost at the centres: below it, as it is convex."""
    x = grid.centres
    slopes = x @ costs.terminal_hessian + costs.terminal_linear
    values = 0.5 * np.einsum("ci,ij,cj->c", x, costs.terminal_hessian, x) + x @ costs.terminal_linear
    everything = np.full(x.shape, np.inf)
    values = values - ROUNDING * np.abs(values)
    return Grid(grid.lower, grid.width, grid.shape, values[:, None], slopes[:, None], -everything, everything)


@dataclass(frozen=True, eq=False)
class _Boxes:
    """Boxes of (x, u) in a cell and a mode each, for one piece of V_t: centres and radii (boxes, n + m)."""

    cell: Indices
    piece: Indices
    mode: Indices
    centre: Array
    radius: Array

    def take(self, chosen: Mask | Indices) -> _Boxes:
        return _Boxes(
            self.cell[chosen], self.piece[chosen], self.mode[chosen], self.centre[chosen], self.radius[chosen]
        )

    def bisected(self, along: Indices) -> _Boxes:
        """Return both halves of every box along a direction each."""
        rows = np.arange(len(along))
        radius, shift = self.radius.copy(), np.zeros_like(self.centre)
        radius[rows, along] /= 2
        shift[rows, along] = radius[rows, along]
        grown = radius * (1 + ROUNDING)
        return _Boxes(
            np.tile(self.cell, 2),
            np.tile(self.piece, 2),
            np.tile(self.mode, 2),
            np.vstack([self.centre - shift, self.centre + shift]),
            np.vstack([grown, grown]),
        )


class _Backward:
    """One step of the recursion."""

    def __init__(
        self, problem: OptimalControlProblem, costs: StageCosts, t: int, grid: Grid, after: Grid, deadline: float
    ):
        self._modes, self._n, self._t = problem.smooth_pieces.modes, problem.state_dim, t
        self._problem, self._costs, self._grid, self._after, self._deadline = problem, costs, grid, after, deadline
        self._pole = after.width == 0
        self._ranges = RangeMinima(after)
        self._hessian = costs.hessians[t]

    def values(self, target: Array, tolerance: float) -> Grid:
        """Return the cells with values: at least ``target``, or near to what samples reach, if boxes show it."""
        grid, n = self._grid, self._n
        slopes, reached = Samples(self._problem, self._costs, self._t, grid, self._after).slopes()
        pieces = slopes.shape[1]
        needed = np.minimum(reached - tolerance, target[:, None] + (np.abs(slopes) * grid.width / 2).sum(axis=2))
        lowest = np.full(reached.shape, np.inf)
        first, last = np.full(slopes.shape, np.inf), np.full(slopes.shape, -np.inf)
        boxes = self._first_boxes(pieces)
        for final in (*[False] * ROUNDS[n], True):
            bounds, steep = self._bounded(boxes, slopes)
            place = boxes.cell, boxes.piece
            weak = (bounds < needed[place]) & (not final)
            np.minimum.at(lowest, (place[0][~weak], place[1][~weak]), bounds[~weak])
            weak &= bounds < lowest[place]
            done = np.flatnonzero(~weak & (bounds < np.inf))
            at = place[0][done], place[1][done]
            np.minimum.at(lowest, at, bounds[done])
            np.minimum.at(first, at, boxes.centre[done, :n] - boxes.radius[done, :n])
            np.maximum.at(last, at, boxes.centre[done, :n] + boxes.radius[done, :n])
            boxes = boxes.take(weak).bisected(np.argmax(steep[weak], axis=1))
            if not len(boxes.cell):
                break
        return Grid(grid.lower, grid.width, grid.shape, lowest, slopes, first.max(axis=1), last.min(axis=1))

    def _first_boxes(self, pieces: int) -> _Boxes:
        problem, grid, t = self._problem, self._grid, self._t
        box, m = problem.control_tube, problem.control_dim
        each = max(1, round(FIRST_BOXES ** (1 / m)))
        width = (box.upper[t] - box.lower[t]) / each
        parts = np.stack(np.meshgrid(*[np.arange(each)] * m, indexing="ij"), axis=-1).reshape(-1, m)
        u, x, modes = box.lower[t] + (parts + 0.5) * width, grid.centres, len(self._modes)
        count = len(x) * len(u)
        centre = np.hstack([np.repeat(x, len(u), axis=0), np.tile(u, (len(x), 1))])
        radius = np.concatenate([grid.width, width]) / 2 * (1 + ROUNDING)
        return _Boxes(
            np.tile(np.repeat(np.arange(len(x)), len(u)), modes * pieces),
            np.repeat(np.arange(pieces), modes * count),
            np.tile(np.repeat(np.arange(modes), count), pieces),
            np.tile(centre, (modes * pieces, 1)),
            np.tile(radius, (modes * pieces * count, 1)),
        )

    def _bounded(self, boxes: _Boxes, slopes: Array) -> tuple[Array, Array]:
        """Return bounds of boxes, inf where nothing in them holds, and how much is lost along each direction."""
        bounds, steep = np.full(len(boxes.cell), np.inf), boxes.radius.copy()
        for i, mode in enumerate(self._modes):
            rows = np.flatnonzero(boxes.mode == i)
            for start in range(0, len(rows), MOST_PAIRS // 8):
                if time.perf_counter() > self._deadline:
                    raise OutOfTimeError
                part = rows[start : start + MOST_PAIRS // 8]
                bounds[part], steep[part] = self._of_mode(mode, boxes.take(part), slopes)
        return bounds, steep

    def _of_mode(self, mode: SmoothMode, boxes: _Boxes, slopes: Array) -> tuple[Array, Array]:
        y, r, n, after = boxes.centre, boxes.radius, self._n, self._after
        lower, upper = y - r, y + r
        possible = _possible(mode, lower, upper)
        whole, centre = interval_jets(mode.f, lower, upper), interval_jets(mode.f, y, y)
        mean = mean_value(centre.values, whole.slopes, r)
        low, high = np.fmax(whole.values[0], mean[0]), np.fmin(whole.values[1], mean[1])
        top = after.lower + after.width * after.shape
        beyond = ROUNDING * (np.abs(after.lower) + np.abs(top))
        possible &= ((high >= after.lower - beyond) & (low <= top + beyond)).all(axis=1)
        first, final = after.places(np.fmax(low, after.lower), -1), after.places(np.fmin(high, top), 1)
        span = (final - first + 1).max(axis=1)
        gradient = y @ self._hessian + self._costs.linear[self._t]
        own = slopes[boxes.cell, boxes.piece]
        gradient[:, :n] -= own
        offset = stage_cost(self._costs, self._t, y) - (own * (y[:, :n] - self._grid.centres[boxes.cell])).sum(axis=1)
        change = np.abs(gradient) + r @ np.abs(self._hessian)
        bounds = np.where(possible, offset - (change * r).sum(axis=1) + self._ranges.least(first, final), np.inf)
        steep = np.where(
            np.isfinite(whole.slopes[0]), np.maximum(np.abs(whole.slopes[0]), np.abs(whole.slopes[1])), 1e3
        )
        steep = (change + steep.sum(axis=1) * (1 + self._ranges.steepest)) * r
        for rows in _batches(np.flatnonzero(possible & (span <= MOST_SPANNED)), first, final):
            pair, cell = _pairs(rows, first, final, after)
            met = ((low[pair] <= after.last[cell]) & (high[pair] >= after.first[cell])).all(axis=1)
            pair, cell = pair[met], cell[met]
            found = self._second_order(pair, cell, (low, high), r, gradient, offset, centre, whole)
            closer = np.full(len(y), np.inf)
            np.minimum.at(closer, pair, found)
            bounds[rows] = np.fmax(bounds[rows], closer[rows])
        return bounds, steep

    def _second_order(
        self,
        pair: Indices,
        cell: Indices,
        image: tuple[Array, Array],
        r: Array,
        gradient: Array,
        offset: Array,
        centre: IntervalJets,
        whole: IntervalJets,
    ) -> Array:
        """Return bounds of c + V(f) - slope x over boxes, with V that of one cell."""
        after, at = self._after, self._after.centres[cell]
        middle = 0.5 * (centre.slopes[0] + centre.slopes[1])[pair]
        low = np.fmax(np.fmax(image[0][pair], after.first[cell]), at - after.width * (0.5 + ROUNDING)) - at
        high = np.fmin(np.fmin(image[1][pair], after.last[cell]), at + after.width * (0.5 + ROUNDING)) - at
        found = np.full(len(pair), -np.inf)
        for piece in range(after.slopes.shape[1]):
            slopes, value = after.slopes[cell, piece], after.values[cell, piece]
            freed = freed_slopes(gradient[pair] + np.einsum("pj,pji->pi", slopes, middle), middle, r[pair])
            for change in (freed, np.where(self._pole, freed, 0.0)):
                less = np.where(self._pole, 0.0, np.fmax(change * low, change * high)).sum(axis=1)
                more = self._with_slopes(pair, cell, slopes + change, value - less, r, gradient, offset, centre, whole)
                found = np.fmax(found, more)
        return found

    def _with_slopes(
        self,
        pair: Indices,
        cell: Indices,
        sigma: Array,
        given: Array,
        r: Array,
        gradient: Array,
        offset: Array,
        centre: IntervalJets,
        whole: IntervalJets,
    ) -> Array:
        """Return bounds with V = given + sigma (x - centre) on the cell."""
        after, r = self._after, r[pair]
        value = offset[pair] + given
        terms = np.abs(offset[pair]) + np.abs(given)
        slope = [gradient[pair].copy(), gradient[pair].copy()]
        bend = [np.broadcast_to(self._hessian, (len(pair), *self._hessian.shape)).copy() for _ in range(2)]
        wide = [gradient[pair] - r @ np.abs(self._hessian), gradient[pair] + r @ np.abs(self._hessian)]
        with np.errstate(invalid="ignore"):
            for j in range(self._n):
                s = sigma[:, j]
                at = _scaled(s, centre.values[0][pair, j], centre.values[1][pair, j])
                value = value + at[0] - s * after.centres[cell, j]
                terms += np.abs(at[0]) + np.abs(s * after.centres[cell, j])
                for total, jets in ((slope, centre.slopes), (wide, whole.slopes)):
                    more = _scaled(s[:, None], jets[0][pair, j], jets[1][pair, j])
                    total[0], total[1] = total[0] + more[0], total[1] + more[1]
                more = _scaled(s[:, None, None], whole.curvatures[0][pair, j], whole.curvatures[1][pair, j])
                bend[0], bend[1] = bend[0] + more[0], bend[1] + more[1]
            at_most = np.maximum(np.abs(slope[0]), np.abs(slope[1]))
            largest = np.maximum(np.abs(bend[0]), np.abs(bend[1]))
            diagonal = np.arange(r.shape[1])
            largest[:, diagonal, diagonal] = 0.0
            safe = np.where(r > 0, r, 1.0)
            across = (largest * r[:, None, :]).sum(axis=2) / safe
            curvature = bend[0][:, diagonal, diagonal] - across
            turned = (curvature > 0) & (at_most < curvature * r)
            inner = -(at_most**2) / (2 * np.where(turned, curvature, 1.0))
            second = np.where(turned, inner, -at_most * r + 0.5 * curvature * r * r)
            first = -np.maximum(np.abs(wide[0]), np.abs(wide[1])) * r
            lost = [np.where(r > 0, part, 0.0).sum(axis=1) for part in (second, first)]
        best = np.fmax(*[np.where(np.isnan(part), -np.inf, part) for part in lost])
        nothing = np.isposinf(given)
        terms = np.where(nothing, 0.0, terms - np.where(np.isfinite(best), best, 0.0))
        return np.where(nothing, np.inf, value + best - ROUNDING * terms)


def _scaled(factor: Array, low: Array, high: Array) -> tuple[Array, Array]:
    ends = factor * low, factor * high
    return np.fmin(*ends), np.fmax(*ends)


def _possible(mode: SmoothMode, lower: Array, upper: Array) -> Mask:
    """Whether a mode can hold somewhere in each box."""
    possible = np.ones(len(lower), dtype=bool)
    middle, radius = 0.5 * (lower + upper), 0.5 * (upper - lower)
    for formulas, sign in ((mode.region, 1.0), (mode.domain, -1.0)):
        if formulas:
            whole, centre = interval_jets(formulas, lower, upper), interval_jets(formulas, middle, middle)
            mean = mean_value(centre.values, whole.slopes, radius)
            low, high = np.fmax(whole.values[0], mean[0]), np.fmin(whole.values[1], mean[1])
            excluded = low > 0 if sign > 0 else high <= 0
            possible &= ~excluded.any(axis=1)
    return possible


def _batches(rows: Indices, first: Indices, final: Indices) -> Iterator[Indices]:
    """Yield rows whose pairs are at most MOST_PAIRS together."""
    counts = np.cumsum((final[rows] - first[rows] + 1).prod(axis=1)) // MOST_PAIRS
    for k in np.unique(counts):
        yield rows[counts == k]


def _pairs(rows: Indices, first: Indices, final: Indices, after: Grid) -> tuple[Indices, Indices]:
    """Return every row with each cell that its image meets."""
    sizes = final[rows] - first[rows] + 1
    counts = sizes.prod(axis=1)
    pair = np.repeat(rows, counts)
    local = np.arange(len(pair)) - np.repeat(np.cumsum(counts) - counts, counts)
    repeated, places = np.repeat(sizes, counts, axis=0), np.empty((len(pair), sizes.shape[1]), dtype=np.intp)
    for j in range(sizes.shape[1] - 1, -1, -1):
        local, places[:, j] = np.divmod(local, repeated[:, j])
    return pair, after.flat(np.repeat(first[rows], counts, axis=0) + places)
