"""Boxes that every trajectory of a mask of modes stays in: the judge's own, apart from the reach that the search uses.

Intervals go forward in time through the region and the map of each mode. Beside them, zonotopes hold what only one
mode leads to: they do not grow where the map turns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.certificate.tolerances import FINITE, INFINITE, INTERVAL_ROUNDING
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


Stages = tuple[Stage, ...]  # T + 1 of them; the last has no modes


class IntervalReach:
    """Forward interval propagation for one problem."""

    def __init__(self, problem: OptimalControlProblem):
        self._problem, arrays = problem, problem.piecewise.arrays(problem.horizon)
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
        return self._forward(stages, 0, known=False)

    def restricted(self, before: Stages, t: int, modes: Mask) -> Stages | None:
        """Return the stages with only these modes (modes,) at time t, or None if they are empty."""
        stages = list(before)
        stages[t] = replace(stages[t], modes=stages[t].modes & modes)
        return self._forward(stages, t, known=True)

    def _forward(self, stages: list[Stage], first: int, known: bool) -> Stages | None:
        for t in range(first, self._problem.horizon):
            found = self._step(t, stages[t], stages[t + 1])
            if found is None:
                return None
            stages[t], after = found
            same = np.array_equal(after.lower, stages[t + 1].lower) and np.array_equal(after.upper, stages[t + 1].upper)
            if known and same and np.count_nonzero(stages[t].modes) > 1:
                break  # nothing changes at later times
            stages[t + 1] = after
        return tuple(stages)

    def _step(self, t: int, now: Stage, after: Stage) -> tuple[Stage, Stage] | None:
        """Return a stage without modes that lead nowhere, and the next stage cut to what the others lead to."""
        n = len(now.lower)
        low, high = now.pair_lower.copy(), now.pair_upper.copy()
        np.maximum(low[:, :n], now.lower, out=low[:, :n])
        np.minimum(high[:, :n], now.upper, out=high[:, :n])
        low, high, possible = self._cut(t, low, high)
        image_low, image_high = self._image(t, low, high)
        centre = self._A[t] @ now.centre + self._pushed[t]
        generators = np.concatenate([self._A[t] @ now.generators, self._pushes[t]], axis=-1)
        radius = np.abs(generators).sum(axis=-1)
        radius += INTERVAL_ROUNDING * (np.abs(centre) + radius)
        image_low = np.maximum(np.maximum(image_low, centre - radius), after.lower)
        image_high = np.minimum(np.minimum(image_high, centre + radius), after.upper)
        kept = now.modes & possible & (image_low <= image_high).all(axis=1)
        if not kept.any():
            return None
        here = Stage(now.lower, now.upper, now.centre, now.generators, kept, low, high)
        lower, upper = image_low[kept].min(axis=0), image_high[kept].max(axis=0)
        only = int(np.argmax(kept))
        sets = (centre[only], generators[only]) if kept.sum() == 1 else _zonotope(lower, upper)
        return here, Stage(lower, upper, *sets, after.modes, after.pair_lower, after.pair_upper)

    def _cut(self, t: int, low: Array, high: Array) -> tuple[Array, Array, Mask]:
        """Return boxes (modes, k) cut by the rows of the regions, and which of them have a point."""
        rows, limits, above = self._rows[t], self._limits[t], self._above[t]
        least = np.where(rows > 0, low[:, None], high[:, None])  # where a row is least
        terms = rows * least
        room = limits - terms.sum(axis=-1)
        room += INTERVAL_ROUNDING * (np.abs(terms).sum(axis=-1) + np.abs(limits))
        ends = least + room[..., None] / self._divisors[t]
        high = np.minimum(high, np.where(above, ends, np.inf).min(axis=1))
        low = np.maximum(low, np.where(self._below[t], ends, -np.inf).max(axis=1))
        return np.minimum(low, high), high, (room >= 0).all(axis=1)

    def _image(self, t: int, low: Array, high: Array) -> tuple[Array, Array]:
        """Return boxes (modes, n) around the images of boxes (modes, k)."""
        rising, falling, offset = self._rising[t], self._falling[t], self._offset[t]
        size = (self._sizes[t] @ np.maximum(np.abs(low), np.abs(high))[..., None])[..., 0] + np.abs(offset)
        low, high, rounding = low[..., None], high[..., None], INTERVAL_ROUNDING * size
        least, most = (rising @ low + falling @ high)[..., 0], (rising @ high + falling @ low)[..., 0]
        return least + offset - rounding, most + offset + rounding


def _zonotope(lower: Array, upper: Array) -> tuple[Array, Array]:
    return (lower + upper) / 2, np.diag((upper - lower) / 2)
