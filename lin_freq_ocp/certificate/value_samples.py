"""Estimates that steer the bound of value_bound.py, from samples of controls: nothing is proven by them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import minimum_filter

from lin_freq_ocp.certificate.value_grid import Grid
from lin_freq_ocp.problem.arrays import Array, Indices, Mask
from lin_freq_ocp.problem.formula_jets import values_of
from lin_freq_ocp.problem.interval_jets import interval_jets
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.piecewise_smooth import SmoothMode
from lin_freq_ocp.problem.stage_costs import StageCosts

SAMPLES = 256
"""Controls at which slopes and reachable values are estimated; nothing is proven by them."""

CLOSER = 25
"""Controls around the best sample, twice, each time closer."""

SPREAD = 5
"""Cells on both sides together that count as reached where samples reach one, beside a fortieth of all of them."""

SIDES = {1: (-0.9, 0.9), 2: (0.0,)}
"""Where in a cell the slopes of its pieces are estimated, from the centre, as parts of half its width: one state may
have a kink in every cell; of two, cells with several pieces take too long."""

MOST_SLOPE = {1: 20.0, 2: 4.0}
"""Slopes are cut at this multiple of their median, by the number of states: next to states from which nothing goes on
they are not to be trusted."""


def arrivals(problem: OptimalControlProblem, costs: StageCosts, grids: list[Grid]) -> list[Array]:
    """Return an estimate of what it costs at least to come to every cell, (cells,) per time."""
    spent = [np.full(int(grid.shape.prod()), np.inf) for grid in grids]
    spent[0][:] = 0.0
    for t, (grid, after) in enumerate(pairwise(grids)):
        x, u = grid.centres, _controls(problem, t, SAMPLES * (1 if len(grid.centres) > 1 else SPREAD))
        pairs = np.hstack([np.repeat(x, len(u), axis=0), np.tile(u, (len(x), 1))])
        total = np.repeat(spent[t], len(u)) + stage_cost(costs, t, pairs)
        for mode in problem.smooth_pieces.modes:
            y, inside = values_of(mode.f, pairs), _holds(mode, pairs)
            inside &= np.isfinite(y).all(axis=1)
            places = after.flat(after.places(np.where(inside[:, None], y, 0.0)))
            np.minimum.at(spent[t + 1], places, np.where(inside, total, np.inf))
        spent[t + 1] = minimum_filter(
            spent[t + 1].reshape(tuple(after.shape)), SPREAD + int(after.shape.max()) // 40, mode="nearest"
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


def stage_cost(costs: StageCosts, t: int, y: Array) -> Array:
    """Return c_t of pairs (points, n + m)."""
    return 0.5 * np.einsum("pi,ij,pj->p", y, costs.hessians[t], y) + y @ costs.linear[t]


def freed_slopes(gradient: Array, J: Array, weights: Array) -> Array:
    """Return what is added to slopes (p, n), so that the weighted gradient is smallest; J is (p, n, n + m)."""
    columns = np.nan_to_num(weights[:, :, None] * np.swapaxes(J, 1, 2), posinf=0.0, neginf=0.0)
    wanted = np.nan_to_num(weights * gradient, posinf=0.0, neginf=0.0)
    return -np.einsum("pji,pi->pj", np.linalg.pinv(columns), wanted)


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of the controls from the cells of one time.

    Attributes
    ----------
    grid, after : Grid
        At time t, and at t + 1, with values.
    """

    problem: OptimalControlProblem
    costs: StageCosts
    t: int
    grid: Grid
    after: Grid

    def slopes(self) -> tuple[Array, Array]:
        """Return slopes (cells, pieces, n), and of every piece the value at the centre that samples allow it."""
        grid = self.grid
        sides = np.outer(SIDES[self.problem.state_dim] if grid.width.any() else (0.0,), grid.width / 2)
        found = [self._sampled_at(grid.centres + side) for side in sides]
        slopes = np.stack([slope for _, slope in found], axis=1)
        values = np.stack([value for value, _ in found], axis=1)
        allowed = values[:, None] - np.einsum("cpn,sn->cps", slopes, sides)
        return slopes, allowed.min(axis=2)

    def _sampled_at(self, x: Array) -> tuple[Array, Array]:
        """Return what samples reach from states, and the slopes of that, (states,) and (states, n)."""
        box, m, t = self.problem.control_tube, self.problem.control_dim, self.t
        u = _controls(self.problem, t, SAMPLES)
        best, at, chosen = self._best_of(x, np.broadcast_to(u, (len(x), *u.shape)))
        each = max(3, round(CLOSER ** (1 / m)))
        offsets = np.stack(np.meshgrid(*[np.linspace(-1, 1, each)] * m, indexing="ij"), axis=-1).reshape(-1, m)
        spacing = (box.upper[t] - box.lower[t]) / max(1, round(SAMPLES ** (1 / m)) - 1)
        for _ in range(2):
            near = np.clip(at[:, None, self.problem.state_dim :] + offsets * spacing, box.lower[t], box.upper[t])
            better, place, mode = self._best_of(x, near)
            closer = better < best
            best, at = np.where(closer, better, best), np.where(closer[:, None], place, at)
            chosen, spacing = np.where(closer, mode, chosen), 2 * spacing / (each - 1)
        free = np.full((2, self.problem.state_dim), [[-np.inf], [np.inf]])
        lowest, highest = (
            np.concatenate([free[0], box.lower[t] + 1.5 * spacing]),
            np.concatenate([free[1], box.upper[t] - 1.5 * spacing]),
        )
        slopes = np.zeros((len(x), self.problem.state_dim))
        for i, mode in enumerate(self.problem.smooth_pieces.modes):
            here = (chosen == i) & np.isfinite(best)
            if here.any():
                jets = interval_jets(mode.f, at[here], at[here])
                y, J = (0.5 * (part[0] + part[1]) for part in (jets.values, jets.slopes))
                gradient = at[here] @ self.costs.hessians[self.t] + self.costs.linear[t]
                sigma = self.after.piece_at(self.after.flat(self.after.places(y)), y)
                inside = (at[here] > lowest) & (at[here] < highest)
                weights = np.where(inside | (self.after.width == 0).any(), self._control_weights, 0.0)
                sigma = sigma + freed_slopes(gradient + np.einsum("pj,pji->pi", sigma, J), J, weights)
                slope = gradient + np.einsum("pj,pji->pi", sigma, J)
                slopes[here] = np.nan_to_num(slope[:, : self.problem.state_dim], posinf=0.0, neginf=0.0)
        finite = np.isfinite(best)
        usual = MOST_SLOPE[self.problem.state_dim] * np.median(np.abs(slopes[finite]), axis=0) if finite.any() else 0.0
        return best, np.clip(slopes, -usual, usual)

    def _best_of(self, x: Array, u: Array) -> tuple[Array, Array, Indices]:
        """Return the least of c + V(f) over controls u (states, controls, m), where it is, and in which mode."""
        count = u.shape[1]
        pairs = np.hstack([np.repeat(x, count, axis=0), u.reshape(-1, u.shape[2])])
        costs = stage_cost(self.costs, self.t, pairs)
        best, at = np.full(len(x), np.inf), pairs[::count].copy()
        chosen = np.zeros(len(x), dtype=np.intp)
        for i, mode in enumerate(self.problem.smooth_pieces.modes):
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
        box = self.problem.control_tube
        return np.concatenate([np.zeros(self.problem.state_dim), (box.upper - box.lower)[self.t]])

    def _value_at(self, y: Array) -> Array:
        """Return V_{t+1}, with the distance to where it is fixed at the steepest slope of the stage."""
        after = self.after
        cell = after.flat(after.places(y))
        inside = (y >= after.lower) & (y <= after.lower + after.width * after.shape)
        far = np.where((self.after.width == 0), np.abs(y - after.lower), np.where(inside, 0.0, np.inf)).sum(axis=1)
        near = np.where((self.after.width == 0), 0.0, y - after.centres[cell])
        value = (after.values[cell] + np.einsum("psn,pn->ps", after.slopes[cell], near)).max(axis=1)
        return value + self._end_price * far

    @property
    def _end_price(self) -> float:
        tube = self.problem.control_tube
        ends = np.stack([tube.lower[self.t], tube.upper[self.t]])
        y = np.hstack([np.tile(self.grid.centres[:1], (2, 1)), ends])
        return 10 * float(np.abs(y @ self.costs.hessians[self.t] + self.costs.linear[self.t]).max() + 1)
