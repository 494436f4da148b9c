"""Boxes that every trajectory of a mask of modes stays in: the judge's own, apart from the reach that the search uses.

Intervals go forward in time through the region and the map of each mode. Beside them, zonotopes hold what only one
mode leads to: they do not grow where the map turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.certificate.tolerances import FINITE, INFINITE, INTERVAL_ROUNDING
from lin_freq_ocp.problem.hybrid.forms import piecewise_affine
from lin_freq_ocp.problem.ocp import OptimalControlProblem


@dataclass(frozen=True, eq=False)
class Stage:
    """What can be reached at a time: the state lies in lower .. upper, and in centre + generators [-1, 1]^count, too.

    ``modes`` (modes,) can be active; pair_lower, pair_upper (modes, n + m) bound (x, u) in their regions.
    """

    lower: Array
    upper: Array
    centre: Array
    generators: Array
    modes: Mask
    pair_lower: Array
    pair_upper: Array


SIDE_BY_SIDE = 64  # paths: beyond, arrays are no longer small
Stages = tuple[Stage, ...]  # T + 1 of them; the last has no modes


class IntervalReach:
    """Forward interval propagation for one problem."""

    def __init__(self, problem: OptimalControlProblem):
        self._problem, arrays = problem, piecewise_affine(problem).arrays(problem.horizon)
        n, tube = problem.state_dim, problem.control_tube
        self._x = np.maximum(problem.state_tube.lower, -INFINITE), np.minimum(problem.state_tube.upper, INFINITE)
        self._u = np.maximum(tube.lower, -INFINITE), np.minimum(tube.upper, INFINITE)
        self._maps, self._offset = np.concatenate([arrays.A, arrays.B], axis=-1), arrays.offset
        self._sizes = np.abs(self._maps)
        self._rising, self._falling = (self._maps + self._sizes) / 2, (self._maps - self._sizes) / 2
        middle, half = (self._u[0] + self._u[1]) / 2, (self._u[1] - self._u[0]) / 2
        self._A, self._pushed = self._maps[..., :n], np.einsum("tkij,tj->tki", arrays.B, middle) + arrays.offset
        self._pushes = arrays.B * half[:, None, None]
        self._rows, self._limits = np.concatenate([arrays.G, arrays.H], axis=-1), np.minimum(arrays.h, INFINITE)
        used = (self._limits < FINITE)[..., None]
        self._above, self._below = (self._rows > 0) & used, (self._rows < 0) & used
        self._divisors = np.where(self._rows == 0, 1.0, self._rows)

    def whole(self) -> Stages | None:
        """Return the stages of all mode sequences, or None if there is no trajectory."""
        (lower, upper), modes, stages = self._x, self._rows.shape[1], list[Stage]()
        for t in range(self._problem.horizon + 1):
            controls = [side[min(t, len(side) - 1)] for side in self._u]  # those of the last stage are not used
            pairs = (np.tile(np.append(x[t], u), (modes, 1)) for x, u in zip(self._x, controls, strict=True))
            stages.append(Stage(lower[t], upper[t], *_zonotope(lower[t], upper[t]), np.ones(modes, dtype=bool), *pairs))
        return None if self._forward([stages], [0], known=False) else tuple(stages)

    def restricted(self, before: Stages, t: int, modes: Mask) -> Stages | None:
        """Return the stages with only these modes (modes,) at time t, or None if they are empty."""
        return self.restricted_each([(before, t, modes)])[0]

    def restricted_each(self, choices: Sequence[tuple[Stages, int, Mask]]) -> list[Stages | None]:
        """Return what ``restricted`` does for each choice; all go forward side by side, which takes less time."""
        found = [list(before) for before, _, _ in choices]
        for stages, (_, t, modes) in zip(found, choices, strict=True):
            stages[t] = replace(stages[t], modes=stages[t].modes & modes)
        empty = self._forward(found, [t for _, t, _ in choices], known=True)
        return [None if index in empty else tuple(stages) for index, stages in enumerate(found)]

    def _forward(self, paths: list[list[Stage]], firsts: Sequence[int], known: bool) -> set[int]:
        """Go forward from the first times, in place; return the numbers of those that are empty."""
        empty, settled = set[int](), set[int]()
        for t in range(min(firsts, default=0), self._problem.horizon):
            going = [i for i, first in enumerate(firsts) if first <= t and i not in empty and i not in settled]
            for start in range(0, len(going), SIDE_BY_SIDE):
                some = going[start : start + SIDE_BY_SIDE]
                steps = self._step(t, [paths[i][t] for i in some], [paths[i][t + 1] for i in some])
                for i, found in zip(some, steps, strict=True):
                    if found is None:
                        empty.add(i)
                        continue
                    stages, after = paths[i], found[1]
                    stages[t], several = found[0], np.count_nonzero(found[0].modes) > 1
                    same = (after.lower == stages[t + 1].lower).all() and (after.upper == stages[t + 1].upper).all()
                    if known and same and several:
                        settled.add(i)  # nothing changes at later times
                    else:
                        stages[t + 1] = after
        return empty

    def _step(self, t: int, now: Sequence[Stage], after: Sequence[Stage]) -> list[tuple[Stage, Stage] | None]:
        """Return stages without modes that lead nowhere, and the next stages cut to what the others lead to."""
        n = len(now[0].lower)
        low, high = (np.array([getattr(stage, side) for stage in now]) for side in ("pair_lower", "pair_upper"))
        np.maximum(low[..., :n], np.array([stage.lower for stage in now])[:, None], out=low[..., :n])
        np.minimum(high[..., :n], np.array([stage.upper for stage in now])[:, None], out=high[..., :n])
        low, high, possible = self._cut(t, low, high)
        image_low, image_high = self._image(t, low, high)
        centres, generators, radius = self._zonotopes(t, now)
        image_low = np.maximum(np.maximum(image_low, centres - radius), np.array([s.lower for s in after])[:, None])
        image_high = np.minimum(np.minimum(image_high, centres + radius), np.array([s.upper for s in after])[:, None])
        kept = np.array([stage.modes for stage in now]) & possible & (image_low <= image_high).all(axis=-1)
        lower = np.where(kept[..., None], image_low, np.inf).min(axis=1)
        upper = np.where(kept[..., None], image_high, -np.inf).max(axis=1)
        found: list[tuple[Stage, Stage] | None] = []
        for i, (stage, following) in enumerate(zip(now, after, strict=True)):
            left = np.flatnonzero(kept[i])
            if not len(left):
                found.append(None)
                continue
            here = Stage(stage.lower, stage.upper, stage.centre, stage.generators, kept[i], low[i], high[i])
            sets = _zonotope(lower[i], upper[i])
            if len(left) == 1:
                own = generators[i, left[0], :, : stage.generators.shape[1]]
                sets = centres[i, left[0]], np.concatenate([own, self._pushes[t, left[0]]], axis=-1)
            pairs = following.pair_lower, following.pair_upper
            found.append((here, Stage(lower[i], upper[i], *sets, following.modes, *pairs)))
        return found

    def _zonotopes(self, t: int, now: Sequence[Stage]) -> tuple[Array, Array, Array]:
        """Return centres, generators without those of controls, and radii of the images, (stages, modes, n, ...)."""
        n, most = len(now[0].lower), max(stage.generators.shape[1] for stage in now)
        generators = np.zeros((len(now), 1, n, most))
        for i, stage in enumerate(now):
            generators[i, 0, :, : stage.generators.shape[1]] = stage.generators
        generators = self._A[t] @ generators
        centres = np.array([stage.centre for stage in now])[:, None, :, None]
        centres = (self._A[t] @ centres)[..., 0] + self._pushed[t]
        radius = np.abs(generators).sum(axis=-1) + np.abs(self._pushes[t]).sum(axis=-1)
        return centres, generators, radius + INTERVAL_ROUNDING * (np.abs(centres) + radius)

    def _cut(self, t: int, low: Array, high: Array) -> tuple[Array, Array, Mask]:
        """Return boxes (..., modes, k) cut by the rows of the regions, and which of them have a point."""
        rows, limits, above = self._rows[t], self._limits[t], self._above[t]
        least = np.where(rows > 0, low[..., None, :], high[..., None, :])  # where a row is least
        terms = rows * least
        room = limits - terms.sum(axis=-1)
        room += INTERVAL_ROUNDING * (np.abs(terms).sum(axis=-1) + np.abs(limits))
        ends = least + room[..., None] / self._divisors[t]
        high = np.minimum(high, np.where(above, ends, np.inf).min(axis=-2))
        low = np.maximum(low, np.where(self._below[t], ends, -np.inf).max(axis=-2))
        return np.minimum(low, high), high, (room >= 0).all(axis=-1) & (low <= high).all(axis=-1)

    def _image(self, t: int, low: Array, high: Array) -> tuple[Array, Array]:
        """Return boxes (..., modes, n) around the images of boxes (..., modes, k)."""
        rising, falling, offset = self._rising[t], self._falling[t], self._offset[t]
        size = (self._sizes[t] @ np.maximum(np.abs(low), np.abs(high))[..., None])[..., 0] + np.abs(offset)
        low, high, rounding = low[..., None], high[..., None], INTERVAL_ROUNDING * size
        least, most = (rising @ low + falling @ high)[..., 0], (rising @ high + falling @ low)[..., 0]
        return least + offset - rounding, most + offset + rounding


def _zonotope(lower: Array, upper: Array) -> tuple[Array, Array]:
    return (lower + upper) / 2, np.diag((upper - lower) / 2)
