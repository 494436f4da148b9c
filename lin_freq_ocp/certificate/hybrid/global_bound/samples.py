"""Estimates from samples of controls that steer the global bound, without proving anything."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.certificate.hybrid.global_bound.lattice import CostToGo, Lattice, PricedProblem, index_tuples
from lin_freq_ocp.formulas.jets import interval_jets, values_of
from lin_freq_ocp.problem.hybrid.piecewise_smooth import SmoothMode
from lin_freq_ocp.transform.hybrid.forms import piecewise_smooth

ARRIVAL_SAMPLES = 256  # controls at which the cost-to-come is estimated
SLOPE_SAMPLES = 128  # controls at which slopes are estimated
ZOOM_SAMPLES = 25  # controls around the best sample, each time closer
MAX_SAMPLES = 400_000  # that are looked at together: some hundred megabytes
ZOOMS, ZOOMS_TO_END = 2, 5  # refinements; more where a state is met exactly, until its distance is negligible
ARRIVAL_SPREAD = 5  # cells around a sample that count as reached, plus a fortieth of all cells
FIXED_PRICE = 20.0  # multiple of the stage cost per change of a state, for the distance to a fixed state
# Parts of half a cell at which slopes are sampled, by states: kinks in 1-D only
SIDES = {1: (-0.999, 0.999), 2: (0.0,), 3: (0.0,)}
# Multiple of the median slope, by states: slopes next to infeasible states are poor
MAX_SLOPE = {1: 20.0, 2: 4.0, 3: 4.0}
RIDGE = 1e-12  # of the squares of all columns: combinations of slopes with less effect stay as they are


def costs_to_come(stages: PricedProblem, lattices: list[Lattice]) -> list[Array]:
    """Return an estimate of the least cost-to-come of every cell of full lattices, (cells,) per time."""
    from scipy.ndimage import minimum_filter  # slow to import

    to_come = [np.full(len(lattice.cells), np.inf) for lattice in lattices]
    to_come[0][:] = 0.0
    for t, (lattice, after) in enumerate(pairwise(lattices)):
        lower, upper = stages.lower[t], stages.upper[t]
        points, _ = _unit_grid(ARRIVAL_SAMPLES * (1 if len(lattice.cells) > 1 else ARRIVAL_SPREAD), len(lower))
        x, u = lattice.centres, lower + (points + 1) / 2 * (upper - lower)
        pairs = np.hstack([np.repeat(x, len(u), axis=0), np.tile(u, (len(x), 1))])
        total = np.repeat(to_come[t], len(u)) + stages.whole_cost(t, pairs)
        for mode in stages.modes(t):
            y = values_of(mode.f, pairs, np.array([t]))
            inside = holds(mode, pairs, t) & np.isfinite(y).all(axis=1)
            cells = after.numbers(after.indices(np.where(inside[:, None], y, 0.0)))
            np.minimum.at(to_come[t + 1], cells, np.where(inside, total, np.inf))
        window = ARRIVAL_SPREAD + int(after.shape.max()) // 40
        spread = minimum_filter(to_come[t + 1].reshape(tuple(after.shape)), window, mode="nearest")
        to_come[t + 1] = spread.ravel()
    return to_come


def holds(mode: SmoothMode, pairs: Array, time: int) -> Mask:
    """Where a mode holds up to rounding at a time; at samples, which prove nothing."""
    inside, at = np.ones(len(pairs), dtype=bool), np.array([time])
    if mode.region:
        inside &= (values_of(mode.region, pairs, at) <= 0).all(axis=1)
    if mode.domain:
        inside &= (values_of(mode.domain, pairs, at) > 0).all(axis=1)
    return inside


def _unit_grid(points: int, m: int) -> tuple[Array, float]:
    """Return a grid of about ``points`` points over [-1, 1]^m, (points, m), a cross for large m, and its spacing."""
    each = round(points ** (1 / m))
    if each < 2:
        return np.vstack([np.zeros(m), np.eye(m), -np.eye(m)]), 1.0
    return np.linspace(-1, 1, each)[index_tuples(np.full(m, each))], 2 / (each - 1)


def free_slopes(gradient: Array, J: Array, weights: Array) -> Array:
    """Return the change of slopes (p, n) that makes the weighted gradient smallest; J is (p, n, n + m)."""
    columns = np.nan_to_num(weights[:, :, None] * np.swapaxes(J, 1, 2), posinf=0.0, neginf=0.0)
    wanted = np.nan_to_num(weights * gradient, posinf=0.0, neginf=0.0)
    squares = np.einsum("pij,pik->pjk", columns, columns)
    sizes = np.diagonal(squares, axis1=1, axis2=2)
    ridge = (RIDGE * sizes + (sizes == 0))[:, :, None] * np.eye(J.shape[1])
    return -np.linalg.solve(squares + ridge, np.einsum("pij,pi->pj", columns, wanted)[..., None])[..., 0]


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of the controls, between lower and upper (cells, m), from the cells of time t; ``after`` is of t + 1."""

    stages: PricedProblem
    t: int
    lattice: Lattice
    lower: Array
    upper: Array
    after: CostToGo

    def slopes(self) -> tuple[Array, Array]:
        """Return slopes (cells, pieces, n), and of every piece the value at the centre that samples allow it."""
        lattice = self.lattice
        sides = np.outer(SIDES[self.stages.problem.state_dim] if lattice.width.any() else (0.0,), lattice.width / 2)
        sampled = [self._sampled_at(lattice.centres + side) for side in sides]
        values, slopes = (np.stack(parts, axis=1) for parts in zip(*sampled, strict=True))
        allowed = values[:, None] - np.einsum("cpn,sn->cps", slopes, sides)
        return slopes, allowed.min(axis=2)

    def _sampled_at(self, x: Array) -> tuple[Array, Array]:
        """Return the least cost-to-go of samples from states, and its slopes, (states,) and (states, n)."""
        batches = np.array_split(np.arange(len(x)), len(x) * len(self._points[0]) // MAX_SAMPLES + 1)
        found = zip(*(self._best(x[rows], self.lower[rows], self.upper[rows]) for rows in batches), strict=True)
        best, at, chosen, spacing = (np.concatenate(parts) for parts in found)
        problem, costs, after = self.stages.problem, self.stages.costs, self.after
        n, free = problem.state_dim, np.full((len(x), problem.state_dim), np.inf)
        lowest = np.hstack([-free, self.stages.lower[self.t] + 1.5 * spacing])
        highest = np.hstack([free, self.stages.upper[self.t] - 1.5 * spacing])
        width = np.concatenate([np.zeros(n), (self.stages.upper - self.stages.lower)[self.t]])
        slopes, pole = np.zeros((len(x), n)), (after.lattice.width == 0).any()
        for i, mode in enumerate(piecewise_smooth(problem).modes):
            in_mode = (chosen == i) & np.isfinite(best)
            if in_mode.any():
                formulas = *mode.f, *mode.cost
                jets = interval_jets(formulas, at[in_mode], at[in_mode], curved=False, time=self.t)
                y, J = (0.5 * (part[0] + part[1]) for part in (jets.values, jets.slopes))
                gradient = at[in_mode] @ costs.hessians[self.t] + costs.linear[self.t] + J[:, n:].sum(axis=1)
                y, J = y[:, :n], J[:, :n]
                sigma = after.slopes_at(after.lattice.numbers(after.lattice.indices(y)), y)
                inside = (at[in_mode] > lowest[in_mode]) & (at[in_mode] < highest[in_mode])
                weights = np.where(inside | pole, width, 0.0)
                sigma = sigma + free_slopes(gradient + np.einsum("pj,pji->pi", sigma, J), J, weights)
                slope = gradient + np.einsum("pj,pji->pi", sigma, J)
                slopes[in_mode] = np.nan_to_num(slope[:, :n], posinf=0.0, neginf=0.0)
        finite = np.isfinite(best)
        usual = MAX_SLOPE[n] * np.median(np.abs(slopes[finite]), axis=0) if finite.any() else 0.0
        return best, np.clip(slopes, -usual, usual)

    def _best(self, x: Array, lower: Array, upper: Array) -> tuple[Array, Array, Indices, Array]:
        """Return the least of c + V(f) that samples reach, where, in which mode, and how far apart samples were."""
        (points, share), (zoom, closer_by) = self._points, _unit_grid(ZOOM_SAMPLES, lower.shape[1])
        middle, radius = 0.5 * (lower + upper), 0.5 * (upper - lower)
        best, at, chosen = self._best_of(x, middle[:, None] + points * radius[:, None])
        spacing = share * radius
        for _ in range(ZOOMS_TO_END if (self.after.lattice.width == 0).any() else ZOOMS):
            u = at[:, None, self.stages.problem.state_dim :] + zoom * spacing[:, None]
            better, where, mode = self._best_of(x, np.clip(u, lower[:, None], upper[:, None]))
            closer = better < best
            best, at = np.where(closer, better, best), np.where(closer[:, None], where, at)
            chosen = np.where(closer, mode, chosen)
            spacing = closer_by * spacing
        return best, at, chosen, spacing

    def _best_of(self, x: Array, u: Array) -> tuple[Array, Array, Indices]:
        """Return the least of c + V(f) over controls u (states, controls, m), where it is, and in which mode."""
        count, lattice = u.shape[1], self.after.lattice
        pole = lattice.width == 0
        pairs = np.hstack([np.repeat(x, count, axis=0), u.reshape(-1, u.shape[2])])
        costs = self.stages.whole_cost(self.t, pairs)
        best, at, chosen = np.full(len(x), np.inf), pairs[::count].copy(), np.zeros(len(x), dtype=np.intp)
        for i, mode in enumerate(self._modes):
            y = values_of(mode.f, pairs, np.array([self.t]))
            inside = holds(mode, pairs, self.t) & np.isfinite(y).all(axis=1)
            y = np.where(inside[:, None], y, 0.0)
            cell = lattice.numbers(lattice.indices(y))
            within = (y >= lattice.lower) & (y <= lattice.upper) & (cell >= 0)[:, None]
            # V_{t+1}, with the distance to fixed states priced
            far = np.where(pole, self._prices * np.abs(y - lattice.lower), np.where(within, 0.0, np.inf)).sum(axis=1)
            value = self.after.pieces_at(cell, np.where(pole, lattice.centres[cell], y)).max(axis=1)
            total = costs + value + far
            total = np.where(inside, total, np.inf).reshape(len(x), count)
            least = total.argmin(axis=1)
            totals = total[np.arange(len(x)), least]
            better = totals < best
            best[better], chosen[better] = totals[better], i
            at[better] = pairs.reshape(len(x), count, -1)[better, least[better]]
        return best, at, chosen

    @cached_property
    def _points(self) -> tuple[Array, float]:
        return _unit_grid(SLOPE_SAMPLES, self.stages.problem.control_dim)

    @cached_property
    def _modes(self) -> tuple[SmoothMode, ...]:
        return self.stages.modes(self.t)

    @cached_property
    def _prices(self) -> Array:
        """Prices of distances to fixed states, (n,): some ten times their cost at the slopes of the stage."""
        lattice, stages, t = self.lattice, self.stages, self.t
        low, high = np.append(lattice.lower, stages.lower[t]), np.append(lattice.upper, stages.upper[t])
        range_, corners = high - low, np.stack([low, high])
        costs = np.abs(corners @ stages.costs.hessians[t] + stages.costs.linear[t]) * range_
        for mode in piecewise_smooth(stages.problem).modes:
            slopes = interval_jets(mode.cost, corners, corners, curved=False, time=t).slopes[0].sum(axis=1)
            costs = np.maximum(costs, np.nan_to_num(np.abs(slopes) * range_, posinf=0.0))
        worth = float(costs.sum(axis=1).max()) or 1.0
        effects = np.zeros(len(self.after.lattice.width))
        for mode in piecewise_smooth(stages.problem).modes:
            slopes = interval_jets(mode.f, corners, corners, curved=False, time=t).slopes[0]
            effect = (np.abs(slopes) * range_).sum(axis=2)
            effects = np.maximum(effects, np.where(np.isfinite(effect), effect, 0.0).max(axis=0))
        with np.errstate(over="ignore", divide="ignore"):
            return np.nan_to_num(FIXED_PRICE * worth / effects, posinf=0.0)  # 0 where nothing moves a state
