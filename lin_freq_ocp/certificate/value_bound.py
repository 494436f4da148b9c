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
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from scipy.ndimage import minimum_filter

from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.problem.arrays import Array, Indices, Mask
from lin_freq_ocp.problem.formulas import values_of
from lin_freq_ocp.problem.interval_jets import interval_jets, mean_value
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.piecewise_smooth import SmoothMode
from lin_freq_ocp.problem.stage_costs import StageCosts, stage_costs
from lin_freq_ocp.problem.trajectory import Multipliers

MOST_STATES = 2
"""Cells are as many as a power of this: three states need minutes."""

ROUNDS = 14
"""Bisections of a box of (x, u), at most."""

FIRST_BOXES = 16
"""Boxes of the controls of a cell to begin with, for one control; the root of it for each of two."""

SIDES = ((-0.9,), (0.9,))
"""Where in a cell the slopes of its pieces are estimated, from the centre, as parts of half its width."""

SPREAD = 5
"""Cells on both sides together that count as reached where samples reach one."""

CLOSER = 25
"""Controls around the best sample, twice, each time closer."""

SAMPLES = 256
"""Controls at which slopes and reachable values are estimated; nothing is proven by them."""

MOST_SPANNED = 12
"""Boxes whose image meets more cells along a state are bisected before they are bounded by each of them."""

MOST_PAIRS = 400_000
"""Boxes and cells bounded at once: some hundred megabytes."""

MOST_SLOPE = 20.0
"""Slopes are cut at this multiple of their median: next to states from which nothing goes on they are not to be trusted."""

CUT_MARGIN = 5e-2
"""Part of the cost by which what it costs to come to a cell may be overestimated."""

ROUNDING = 64 * float(np.finfo(np.float64).eps)
"""Of the sum of absolute terms that a bound is made of, what is subtracted from it."""


DEBUG = False


class OutOfTime(Exception):
    """The time is over; no bound was found."""


@dataclass(frozen=True, eq=False)
class Grid:
    """The cells of the states at one time, and an affine function on each.

    Attributes
    ----------
    lower, width : (n,)
        Of all cells together, and of one; width 0 where the state is fixed.
    shape : (n,) integers
    values, slopes : (cells, pieces), (cells, pieces, n)
        V is the largest of values + slopes (x - centre).
    first, last : (cells, n)
        Bounds of the states of a cell from which trajectories go on.
    """

    lower: Array
    width: Array
    shape: Indices
    values: Array
    slopes: Array
    first: Array
    last: Array

    @property
    def centres(self) -> Array:
        """Return the centres of all cells, (cells, n)."""
        places = np.stack(np.unravel_index(np.arange(int(self.shape.prod())), tuple(self.shape)), axis=1)
        return self.lower + (places + 0.5) * self.width

    def piece_at(self, cell: Indices, x: Array) -> Array:
        """Return the slopes of V at points in cells, (points, n)."""
        value = self.values[cell] + np.einsum("psn,pn->ps", self.slopes[cell], x - self.centres[cell])
        return self.slopes[cell, value.argmax(axis=1)]

    @property
    def least(self) -> Array:
        """Return a lower bound of V on every cell, (cells,)."""
        return (self.values - (np.abs(self.slopes) * self.width / 2).sum(axis=2)).max(axis=1)

    def places(self, x: Array, towards: int = 0) -> Indices:
        """Return the cells of points along each state, (..., n); towards -1 or 1, those that rounding may hide, too."""
        width = np.where(self.width > 0, self.width, 1.0)
        share = (x - self.lower) / width + towards * ROUNDING * (1 + np.abs(x / width))
        return np.clip(np.floor(np.nan_to_num(share)), 0, self.shape - 1).astype(np.intp)

    def flat(self, places: Indices) -> Indices:
        """Return numbers of cells from their places along each state."""
        return np.ravel_multi_index(tuple(np.moveaxis(places, -1, 0)), tuple(self.shape))


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
        Of ``time.perf_counter``, at which OutOfTime is raised.
    progress : callable, optional
        Called with the time that is done.

    Raises
    ------
    UnsupportedError
        If there are more than two states, or a state or control is not bounded.
    """
    costs, T = stage_costs(problem, multipliers), problem.horizon
    grids = _grids(problem, cells)
    spent = _arrivals(problem, costs, grids)
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


def _arrivals(problem: OptimalControlProblem, costs: StageCosts, grids: list[Grid]) -> list[Array]:
    """Return an estimate of what it costs at least to come to every cell, (cells,) per time."""
    spent = [np.full(int(grid.shape.prod()), np.inf) for grid in grids]
    spent[0][:] = 0.0
    for t, (grid, after) in enumerate(zip(grids, grids[1:], strict=False)):
        x, u = grid.centres, _controls(problem, t, SAMPLES * (1 if len(grid.centres) > 1 else SPREAD))
        pairs = np.hstack([np.repeat(x, len(u), axis=0), np.tile(u, (len(x), 1))])
        total = np.repeat(spent[t], len(u)) + _stage(costs, t, pairs)
        for mode in problem.smooth_pieces.modes:
            y, inside = values_of(mode.f, pairs), _holds(mode, pairs)
            inside &= np.isfinite(y).all(axis=1)
            places = after.flat(after.places(np.where(inside[:, None], y, 0.0)))
            np.minimum.at(spent[t + 1], places, np.where(inside, total, np.inf))
        spent[t + 1] = minimum_filter(
            spent[t + 1].reshape(tuple(after.shape)), 3 + cells_of(after) // 40, mode="nearest"
        ).ravel()
    return spent


def _holds(mode: SmoothMode, pairs: Array) -> Mask:
    """Where a mode holds, or does so nearly; at samples, which prove nothing."""
    inside = np.ones(len(pairs), dtype=bool)
    if mode.region:
        inside &= (values_of(mode.region, pairs) <= 0).all(axis=1)
    if mode.domain:
        inside &= (values_of(mode.domain, pairs) > 0).all(axis=1)
    return inside


def _controls(problem: OptimalControlProblem, t: int, points: int) -> Array:
    """Return a grid of about so many controls, (points, m)."""
    box, m = problem.control_tube, problem.control_dim
    each = max(2, round(points ** (1 / m)))
    axes = [np.linspace(low, high, each) for low, high in zip(box.lower[t], box.upper[t], strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, m)


def _stage(costs: StageCosts, t: int, y: Array) -> Array:
    return 0.5 * np.einsum("pi,ij,pj->p", y, costs.hessians[t], y) + y @ costs.linear[t]


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
        self._ranges = _RangeMinima(after)
        self._hessian = costs.hessians[t]

    def values(self, target: Array, tolerance: float) -> Grid:
        """Return the cells with values: at least ``target``, or near to what samples reach, if boxes show it."""
        grid, n = self._grid, self._n
        slopes, reached = self._sampled()
        pieces = slopes.shape[1]
        needed = np.minimum(reached - tolerance, target[:, None] + (np.abs(slopes) * grid.width / 2).sum(axis=2))
        lowest = np.full(reached.shape, np.inf)
        first, last = np.full(slopes.shape, np.inf), np.full(slopes.shape, -np.inf)
        boxes = self._first_boxes(pieces)
        for final in (*[False] * ROUNDS, True):
            if time.perf_counter() > self._deadline:
                raise OutOfTime
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

    def _sampled(self) -> tuple[Array, Array]:
        """Return slopes (cells, pieces, n), and of every piece the value at the centre that samples allow it."""
        grid = self._grid
        sides = np.array(SIDES if grid.width.any() else SIDES[:1]) * grid.width / 2
        found = [self._sampled_at(grid.centres + side) for side in sides]
        slopes = np.stack([slope for _, slope in found], axis=1)
        values = np.stack([value for value, _ in found], axis=1)
        allowed = values[:, None] - np.einsum("cpn,sn->cps", slopes, sides)
        return slopes, allowed.min(axis=2)

    def _sampled_at(self, x: Array) -> tuple[Array, Array]:
        """Return what samples reach from states, and the slopes of that, (states,) and (states, n)."""
        box, m, t = self._problem.control_tube, self._problem.control_dim, self._t
        u = _controls(self._problem, t, SAMPLES)
        best, at, chosen = self._best_of(x, np.broadcast_to(u, (len(x), *u.shape)))
        each = max(3, round(CLOSER ** (1 / m)))
        offsets = np.stack(np.meshgrid(*[np.linspace(-1, 1, each)] * m, indexing="ij"), axis=-1).reshape(-1, m)
        spacing = (box.upper[t] - box.lower[t]) / max(1, round(SAMPLES ** (1 / m)) - 1)
        for _ in range(2):
            near = np.clip(at[:, None, self._n :] + offsets * spacing, box.lower[t], box.upper[t])
            better, place, mode = self._best_of(x, near)
            closer = better < best
            best, at = np.where(closer, better, best), np.where(closer[:, None], place, at)
            chosen, spacing = np.where(closer, mode, chosen), 2 * spacing / (each - 1)
        free = np.full((2, self._n), [[-np.inf], [np.inf]])
        lowest, highest = (
            np.concatenate([free[0], box.lower[t] + 1.5 * spacing]),
            np.concatenate([free[1], box.upper[t] - 1.5 * spacing]),
        )
        slopes = np.zeros((len(x), self._n))
        for i, mode in enumerate(self._modes):
            here = (chosen == i) & np.isfinite(best)
            if here.any():
                jets = interval_jets(mode.f, at[here], at[here])
                y, J = (0.5 * (part[0] + part[1]) for part in (jets.values, jets.slopes))
                gradient = at[here] @ self._hessian + self._costs.linear[t]
                sigma = self._after.piece_at(self._after.flat(self._after.places(y)), y)
                inside = (at[here] > lowest) & (at[here] < highest)
                weights = np.where(inside | self._pole.any(), self._control_weights, 0.0)
                sigma = sigma + _freed(gradient + np.einsum("pj,pji->pi", sigma, J), J, weights)
                slope = gradient + np.einsum("pj,pji->pi", sigma, J)
                slopes[here] = np.nan_to_num(slope[:, : self._n], posinf=0.0, neginf=0.0)
        finite = np.isfinite(best)
        usual = MOST_SLOPE * np.median(np.abs(slopes[finite]), axis=0) if finite.any() else 0.0
        return best, np.clip(slopes, -usual, usual)

    def _best_of(self, x: Array, u: Array) -> tuple[Array, Array, Indices]:
        """Return the least of c + V(f) over controls u (states, controls, m), where it is, and in which mode."""
        count = u.shape[1]
        pairs = np.hstack([np.repeat(x, count, axis=0), u.reshape(-1, u.shape[2])])
        costs = _stage(self._costs, self._t, pairs)
        best, at = np.full(len(x), np.inf), pairs[::count].copy()
        chosen = np.zeros(len(x), dtype=np.intp)
        for i, mode in enumerate(self._modes):
            y = values_of(mode.f, pairs)
            ok = _holds(mode, pairs) & np.isfinite(y).all(axis=1)
            total = costs + self._value_at(np.where(ok[:, None], y, 0.0))
            total = np.where(ok, total, np.inf).reshape(len(x), count)
            place = total.argmin(axis=1)
            found = total[np.arange(len(x)), place]
            better = found < best
            best[better], chosen[better] = found[better], i
            at[better] = pairs.reshape(len(x), count, -1)[better, place[better]]
        return best, at, chosen

    @property
    def _control_weights(self) -> Array:
        box = self._problem.control_tube
        return np.concatenate([np.zeros(self._n), (box.upper - box.lower)[self._t]])

    def _value_at(self, y: Array) -> Array:
        """Return V_{t+1}, with the distance to where it is fixed at the steepest slope of the stage."""
        after = self._after
        cell = after.flat(after.places(y))
        inside = (y >= after.lower) & (y <= after.lower + after.width * after.shape)
        far = np.where(self._pole, np.abs(y - after.lower), np.where(inside, 0.0, np.inf)).sum(axis=1)
        near = np.where(self._pole, 0.0, y - after.centres[cell])
        value = (after.values[cell] + np.einsum("psn,pn->ps", after.slopes[cell], near)).max(axis=1)
        return value + self._end_price * far

    @property
    def _end_price(self) -> float:
        tube = self._problem.control_tube
        ends = np.stack([tube.lower[self._t], tube.upper[self._t]])
        y = np.hstack([np.tile(self._grid.centres[:1], (2, 1)), ends])
        return 10 * float(np.abs(y @ self._hessian + self._costs.linear[self._t]).max() + 1)

    def _bounded(self, boxes: _Boxes, slopes: Array) -> tuple[Array, Array]:
        """Return bounds of boxes, inf where nothing in them holds, and how much is lost along each direction."""
        bounds, steep = np.full(len(boxes.cell), np.inf), boxes.radius.copy()
        for i, mode in enumerate(self._modes):
            rows = np.flatnonzero(boxes.mode == i)
            for start in range(0, len(rows), MOST_PAIRS // 8):
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
        offset = _stage(self._costs, self._t, y) - (own * (y[:, :n] - self._grid.centres[boxes.cell])).sum(axis=1)
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
        self, pair: Indices, cell: Indices, image: tuple[Array, Array], r: Array, gradient, offset, centre, whole
    ) -> Array:
        """Return bounds of c + V(f) - slope x over boxes, with V that of one cell."""
        after, at = self._after, self._after.centres[cell]
        middle = 0.5 * (centre.slopes[0] + centre.slopes[1])[pair]
        low = np.fmax(np.fmax(image[0][pair], after.first[cell]), at - after.width * (0.5 + ROUNDING)) - at
        high = np.fmin(np.fmin(image[1][pair], after.last[cell]), at + after.width * (0.5 + ROUNDING)) - at
        found = np.full(len(pair), -np.inf)
        for piece in range(after.slopes.shape[1]):
            slopes, value = after.slopes[cell, piece], after.values[cell, piece]
            freed = _freed(gradient[pair] + np.einsum("pj,pji->pi", slopes, middle), middle, r[pair])
            for change in (freed, np.where(self._pole, freed, 0.0)):
                less = np.where(self._pole, 0.0, np.fmax(change * low, change * high)).sum(axis=1)
                more = self._with_slopes(pair, cell, slopes + change, value - less, r, gradient, offset, centre, whole)
                found = np.fmax(found, more)
        return found

    def _with_slopes(self, pair, cell, sigma, given, r, gradient, offset, centre, whole) -> Array:
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


def _freed(gradient: Array, J: Array, weights: Array) -> Array:
    """Return what is added to slopes (p, n), so that the weighted gradient is smallest; J is (p, n, n + m)."""
    columns = np.nan_to_num(weights[:, :, None] * np.swapaxes(J, 1, 2), posinf=0.0, neginf=0.0)
    wanted = np.nan_to_num(weights * gradient, posinf=0.0, neginf=0.0)
    return -np.einsum("pji,pi->pj", np.linalg.pinv(columns), wanted)


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


def _batches(rows: Indices, first: Indices, final: Indices):
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


class _RangeMinima:
    """The least of V over ranges of cells, by doubling."""

    def __init__(self, grid: Grid):
        least = grid.least
        self._tables: dict[tuple[int, ...], Array] = {}
        self._shape = tuple(int(size) for size in grid.shape)
        finite = np.isfinite(grid.values)
        self.steepest = float(np.abs(grid.slopes[finite]).max(initial=0.0))
        levels = [max(1, int(np.log2(size)) + 1) for size in self._shape]
        for level in np.ndindex(*levels):
            table = least.reshape(self._shape)
            for axis, doubled in enumerate(level):
                for k in range(doubled):
                    table = np.minimum(table, _shifted(table, axis, 2**k))
            self._tables[level] = table

    def least(self, first: Indices, final: Indices) -> Array:
        """Return the least of V over the cells first .. final along each state."""
        levels = np.log2(final - first + 1).astype(int)
        found = np.full(len(first), np.inf)
        for level, table in self._tables.items():
            rows = np.flatnonzero((levels == level).all(axis=1))
            for corner in np.ndindex(*[2] * first.shape[1]):
                at = [
                    first[rows, j] if not side else final[rows, j] - 2 ** level[j] + 1 for j, side in enumerate(corner)
                ]
                found[rows] = np.minimum(found[rows], table[tuple(at)])
        return found


def _shifted(table: Array, axis: int, by: int) -> Array:
    """Return the table moved so that an entry is that of ``by`` cells later; inf where there is none."""
    moved = np.full_like(table, np.inf)
    size = table.shape[axis]
    if by < size:
        source = [slice(None)] * table.ndim
        place = [slice(None)] * table.ndim
        source[axis], place[axis] = slice(by, size), slice(0, size - by)
        moved[tuple(place)] = table[tuple(source)]
    return moved


def cells_of(grid: Grid) -> int:
    return int(grid.shape.max())
