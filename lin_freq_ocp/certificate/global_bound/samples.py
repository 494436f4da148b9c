"""Estimates that steer the bound of value_bound.py, from samples of controls: nothing is proven by them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from lin_freq_ocp.arrays import Array, Indices, Mask
from lin_freq_ocp.certificate.global_bound.grid import CostToGo, Lattice
from lin_freq_ocp.certificate.global_bound.stages import Stages
from lin_freq_ocp.formulas.jets import interval_jets, values_of
from lin_freq_ocp.problem.dynamics.piecewise_smooth import SmoothMode

ARRIVING = 256
"""Controls at which what can be reached is estimated."""

SAMPLES = 128
"""Controls at which slopes are estimated."""

CLOSER = 25
"""Controls around the best sample, each time closer."""

ZOOMS, ZOOMS_TO_END = 2, 5
"""Times that samples come closer; where one state has to be met exactly, until its distance says nothing any more."""

SPREAD = 5
"""Cells on both sides together that count as reached where samples reach one, beside a fortieth of all of them."""

SIDES = {1: (-0.999, 0.999), 2: (0.0,), 3: (0.0,)}
"""Where in a cell the slopes of its pieces are estimated, from the centre, as parts of half its width: one state may
have a kink in every cell; of more, cells with several pieces take too long."""

MOST_SLOPE = {1: 20.0, 2: 4.0, 3: 4.0}
"""Slopes are cut at this multiple of their median, by the number of states: next to states from which nothing goes on
they are not to be trusted."""

SMALLEST_SQUARE = 1e-12
"""Relative to the squares of all columns: a combination of slopes whose effect is smaller stays as it is."""


def arrivals(stages: Stages, lattices: list[Lattice]) -> list[Array]:
    """Return an estimate of what it costs at least to come to every cell of full lattices, (cells,) per time."""
    from scipy.ndimage import minimum_filter  # slow to import

    spent = [np.full(len(lattice.cells), np.inf) for lattice in lattices]
    spent[0][:] = 0.0
    for t, (lattice, after) in enumerate(pairwise(lattices)):
        x, u = lattice.centres, _controls(stages, t, ARRIVING * (1 if len(lattice.cells) > 1 else SPREAD))
        pairs = np.hstack([np.repeat(x, len(u), axis=0), np.tile(u, (len(x), 1))])
        total = np.repeat(spent[t], len(u)) + stages.cost(t, pairs)
        for mode in stages.problem.smooth_pieces.modes:
            y, inside = values_of(mode.f, pairs), holds(mode, pairs)
            inside &= np.isfinite(y).all(axis=1)
            places = after.numbers(after.places(np.where(inside[:, None], y, 0.0)))
            np.minimum.at(spent[t + 1], places, np.where(inside, total, np.inf))
        spent[t + 1] = minimum_filter(
            spent[t + 1].reshape(tuple(after.shape)), SPREAD + int(after.shape.max()) // 40, mode="nearest"
        ).ravel()
    return spent


def holds(mode: SmoothMode, pairs: Array) -> Mask:
    """Where a mode holds, or does so nearly; at samples, which prove nothing."""
    inside = np.ones(len(pairs), dtype=bool)
    if mode.region:
        inside &= (values_of(mode.region, pairs) <= 0).all(axis=1)
    if mode.domain:
        inside &= (values_of(mode.domain, pairs) > 0).all(axis=1)
    return inside


def _controls(stages: Stages, t: int, points: int) -> Array:
    """Return a grid of about so many controls, (points, m)."""
    lower, upper = stages.lower[t], stages.upper[t]
    return lower + (_unit_grid(points, len(lower)) + 1) / 2 * (upper - lower)


def _unit_grid(points: int, m: int) -> Array:
    """Return a grid of about so many points over [-1, 1]^m, (points, m)."""
    axis = np.linspace(-1, 1, max(2, round(points ** (1 / m))))
    return np.stack(np.meshgrid(*[axis] * m, indexing="ij"), axis=-1).reshape(-1, m)


def freed_slopes(gradient: Array, J: Array, weights: Array) -> Array:
    """Return what is added to slopes (p, n), so that the weighted gradient is smallest; J is (p, n, n + m)."""
    columns = np.nan_to_num(weights[:, :, None] * np.swapaxes(J, 1, 2), posinf=0.0, neginf=0.0)
    wanted = np.nan_to_num(weights * gradient, posinf=0.0, neginf=0.0)
    squares = np.einsum("pij,pik->pjk", columns, columns)
    size = np.trace(squares, axis1=1, axis2=2)
    ridge = (SMALLEST_SQUARE * size + (size == 0))[:, None, None] * np.eye(J.shape[1])
    return -np.linalg.solve(squares + ridge, np.einsum("pij,pi->pj", columns, wanted)[..., None])[..., 0]


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of the controls from the cells of one time.

    Attributes
    ----------
    lattice : Lattice
        Of time t.
    lower, upper : (cells, m)
        The controls to sample in every cell.
    after : CostToGo
        At t + 1.
    """

    stages: Stages
    t: int
    lattice: Lattice
    lower: Array
    upper: Array
    after: CostToGo

    def slopes(self) -> tuple[Array, Array]:
        """Return slopes (cells, pieces, n), and of every piece the value at the centre that samples allow it."""
        lattice = self.lattice
        sides = np.outer(SIDES[self.stages.problem.state_dim] if lattice.width.any() else (0.0,), lattice.width / 2)
        found = [self._sampled_at(lattice.centres + side) for side in sides]
        slopes = np.stack([slope for _, slope in found], axis=1)
        values = np.stack([value for value, _ in found], axis=1)
        allowed = values[:, None] - np.einsum("cpn,sn->cps", slopes, sides)
        return slopes, allowed.min(axis=2)

    def _sampled_at(self, x: Array) -> tuple[Array, Array]:
        """Return what samples reach from states, and the slopes of that, (states,) and (states, n)."""
        best, at, chosen, spacing = self._best(x)
        n = self.stages.problem.state_dim
        free = np.full((len(x), n), np.inf)
        lowest = np.hstack([-free, self.stages.lower[self.t] + 1.5 * spacing])
        highest = np.hstack([free, self.stages.upper[self.t] - 1.5 * spacing])
        slopes = np.zeros((len(x), n))
        for i, mode in enumerate(self.stages.problem.smooth_pieces.modes):
            here = (chosen == i) & np.isfinite(best)
            if here.any():
                jets = interval_jets(mode.f, at[here], at[here], curved=False)
                y, J = (0.5 * (part[0] + part[1]) for part in (jets.values, jets.slopes))
                gradient = at[here] @ self.stages.costs.hessians[self.t] + self.stages.costs.linear[self.t]
                places = self.after.lattice.numbers(self.after.lattice.places(y))
                sigma = self.after.piece_at(places, y)
                inside = (at[here] > lowest[here]) & (at[here] < highest[here])
                pole = (self.after.lattice.width == 0).any()
                weights = np.where(inside | pole, self._control_weights, 0.0)
                sigma = sigma + freed_slopes(gradient + np.einsum("pj,pji->pi", sigma, J), J, weights)
                slope = gradient + np.einsum("pj,pji->pi", sigma, J)
                slopes[here] = np.nan_to_num(slope[:, :n], posinf=0.0, neginf=0.0)
        finite = np.isfinite(best)
        usual = MOST_SLOPE[n] * np.median(np.abs(slopes[finite]), axis=0) if finite.any() else 0.0
        return best, np.clip(slopes, -usual, usual)

    def _best(self, x: Array) -> tuple[Array, Array, Indices, Array]:
        """Return the least of c + V(f) that samples reach, where, in which mode, and how far apart samples were."""
        m = self.stages.problem.control_dim
        points, zoom = _unit_grid(SAMPLES, m), _unit_grid(CLOSER, m)
        middle, radius = 0.5 * (self.lower + self.upper), 0.5 * (self.upper - self.lower)
        best, at, chosen = self._best_of(x, middle[:, None] + points * radius[:, None])
        spacing = 2 * radius / (round(len(points) ** (1 / m)) - 1)
        for _ in range(ZOOMS_TO_END if (self.after.lattice.width == 0).any() else ZOOMS):
            u = at[:, None, self.stages.problem.state_dim :] + zoom * spacing[:, None]
            u = np.clip(u, self.lower[:, None], self.upper[:, None])
            better, place, mode = self._best_of(x, u)
            closer = better < best
            best, at = np.where(closer, better, best), np.where(closer[:, None], place, at)
            chosen = np.where(closer, mode, chosen)
            spacing = 2 * spacing / (round(len(zoom) ** (1 / m)) - 1)
        return best, at, chosen, spacing

    def _best_of(self, x: Array, u: Array) -> tuple[Array, Array, Indices]:
        """Return the least of c + V(f) over controls u (states, controls, m), where it is, and in which mode."""
        count = u.shape[1]
        pairs = np.hstack([np.repeat(x, count, axis=0), u.reshape(-1, u.shape[2])])
        costs = self.stages.cost(self.t, pairs)
        best, at, chosen = np.full(len(x), np.inf), pairs[::count].copy(), np.zeros(len(x), dtype=np.intp)
        for i, mode in enumerate(self.stages.problem.smooth_pieces.modes):
            y = values_of(mode.f, pairs)
            ok = holds(mode, pairs) & np.isfinite(y).all(axis=1)
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
        width = (self.stages.upper - self.stages.lower)[self.t]
        return np.concatenate([np.zeros(self.stages.problem.state_dim), width])

    def _value_at(self, y: Array) -> Array:
        """Return V_{t+1}, with the distance to where it is fixed at the steepest slope of the stage."""
        after, lattice = self.after, self.after.lattice
        cell, pole = lattice.numbers(lattice.places(y)), lattice.width == 0
        inside = (y >= lattice.lower) & (y <= lattice.upper) & (cell >= 0)[:, None]
        far = np.where(pole, np.abs(y - lattice.lower), np.where(inside, 0.0, np.inf)).sum(axis=1)
        near = np.where(pole, 0.0, y - lattice.centres[cell])
        value = (after.values[cell] + np.einsum("psn,pn->ps", after.slopes[cell], near)).max(axis=1)
        return value + self._end_price * far

    @property
    def _end_price(self) -> float:
        ends = np.stack([self.stages.lower[self.t], self.stages.upper[self.t]])
        y = np.hstack([np.tile(self.lattice.centres[:1], (2, 1)), ends])
        return 10 * float(np.abs(y @ self.stages.costs.hessians[self.t] + self.stages.costs.linear[self.t]).max() + 1)
