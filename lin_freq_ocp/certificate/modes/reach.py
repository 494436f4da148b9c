"""Boxes that every trajectory of a mask of modes stays in: the judge's own, apart from the reach that the search uses.

Intervals go forward in time through the region and the map of each mode. Beside them, zonotopes hold what only one
mode leads to: they do not grow where the map turns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.problem.ocp import OptimalControlProblem

INFINITE = 1e100
"""Stands for infinity in intervals, so that its product with zero is zero."""

FINITE = 1e90
"""Interval ends beyond this stem from INFINITE."""

INTERVAL_ROUNDING = 1e-13
"""Part of the absolute terms of a sum that intervals are widened by: 100 times the rounding of 10 terms."""


@dataclass(frozen=True, eq=False)
class Stage:
    """What can be reached at one time.

    Attributes
    ----------
    lower, upper : (n,)
        Bounds of the state.
    centre, generators : (n,), (n, count)
        The state lies in centre + generators [-1, 1]^count, too.
    modes : (modes,)
        Which modes can hold; none at the last time.
    pair_lower, pair_upper : (modes, n + m)
        Bounds of (x, u) in the region of each mode.
    """

    lower: Array
    upper: Array
    centre: Array
    generators: Array
    modes: Mask
    pair_lower: Array
    pair_upper: Array


Stages = tuple[Stage, ...]
"""T + 1 stages."""


class IntervalReach:
    """Forward interval propagation for one problem."""

    def __init__(self, problem: OptimalControlProblem):
        self._problem, arrays = problem, problem.piecewise.arrays(problem.horizon)
        self._maps = np.concatenate([arrays.A, arrays.B], axis=-1)
        self._rows = np.concatenate([arrays.G, arrays.H], axis=-1)
        self._limits, self._offset = np.minimum(arrays.h, INFINITE), arrays.offset

    def whole(self) -> Stages | None:
        """Return the stages of all mode sequences, or None if none has a trajectory."""
        problem, modes = self._problem, self._rows.shape[1]
        x, u = (
            (np.maximum(tube.lower, -INFINITE), np.minimum(tube.upper, INFINITE))
            for tube in (problem.state_tube, problem.control_tube)
        )
        stages = list[Stage]()
        for t in range(problem.horizon + 1):
            inputs = [side[t] if t < problem.horizon else np.zeros(problem.control_dim) for side in u]
            pairs = (np.tile(np.append(bound[t], side), (modes, 1)) for bound, side in zip(x, inputs, strict=True))
            stages.append(Stage(x[0][t], x[1][t], *_zonotope(x[0][t], x[1][t]), np.ones(modes, dtype=bool), *pairs))
        return self._forward(stages, 0, known=False)

    def restricted(self, before: Stages, t: int, modes: Mask) -> Stages | None:
        """Return the stages with only these modes (modes,) at time t, or None if nothing is left."""
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
        """Return a stage without modes that lead nowhere, and the next one cut to what the others lead to."""
        n = self._problem.state_dim
        low, high = now.pair_lower.copy(), now.pair_upper.copy()
        low[:, :n], high[:, :n] = np.maximum(low[:, :n], now.lower), np.minimum(high[:, :n], now.upper)
        low, high, possible = _cut(low, high, self._rows[t], self._limits[t])
        image_low, image_high = _image(self._maps[t], self._offset[t], low, high)
        centre, generators = self._zonotope_images(t, now)
        radius = np.abs(generators).sum(axis=-1)
        radius = radius + INTERVAL_ROUNDING * (np.abs(centre) + radius)
        image_low = np.maximum.reduce([image_low, centre - radius, np.broadcast_to(after.lower, centre.shape)])
        image_high = np.minimum.reduce([image_high, centre + radius, np.broadcast_to(after.upper, centre.shape)])
        kept = now.modes & possible & (image_low <= image_high).all(axis=1)
        if not kept.any():
            return None
        lower, upper = image_low[kept].min(axis=0), image_high[kept].max(axis=0)
        only = int(np.argmax(kept))
        single = np.count_nonzero(kept) == 1
        sets = (centre[only], generators[only]) if single else _zonotope(lower, upper)
        here = replace(now, modes=kept, pair_lower=low, pair_upper=high)
        return here, replace(after, lower=lower, upper=upper, centre=sets[0], generators=sets[1])

    def _zonotope_images(self, t: int, now: Stage) -> tuple[Array, Array]:
        """Return centres (modes, n) and generators (modes, n, count) of what each mode makes of the zonotope."""
        n, tube = self._problem.state_dim, self._problem.control_tube
        A, B = self._maps[t, :, :, :n], self._maps[t, :, :, n:]
        lower, upper = np.maximum(tube.lower[t], -INFINITE), np.minimum(tube.upper[t], INFINITE)
        middle, half = (lower + upper) / 2, (upper - lower) / 2
        return A @ now.centre + B @ middle + self._offset[t], np.concatenate([A @ now.generators, B * half], axis=-1)


def _zonotope(lower: Array, upper: Array) -> tuple[Array, Array]:
    return (lower + upper) / 2, np.diag((upper - lower) / 2)


def _cut(low: Array, high: Array, rows: Array, limits: Array) -> tuple[Array, Array, Mask]:
    """Return boxes (modes, k) cut by rows (modes, r, k) y <= limits (modes, r), and which of them have a point."""
    least = np.where(rows > 0, low[:, None], high[:, None])  # where a row is least
    terms = rows * least
    room = limits - terms.sum(axis=-1) + INTERVAL_ROUNDING * (np.abs(terms).sum(axis=-1) + np.abs(limits))
    step = np.where(limits < FINITE, room, np.inf)[..., None] / np.where(rows == 0, 1.0, rows)
    high = np.minimum(high, np.where(rows > 0, least + step, np.inf).min(axis=1))
    low = np.maximum(low, np.where(rows < 0, least + step, -np.inf).max(axis=1))
    return np.minimum(low, high), high, (room >= 0).all(axis=1)


def _image(maps: Array, offset: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Return boxes (modes, n) around maps (modes, n, k) of boxes (modes, k), with offsets (modes, n)."""
    ends = np.stack([maps * low[:, None], maps * high[:, None]])
    rounding = INTERVAL_ROUNDING * (np.abs(ends).max(axis=0).sum(axis=-1) + np.abs(offset))
    return ends.min(axis=0).sum(axis=-1) + offset - rounding, ends.max(axis=0).sum(axis=-1) + offset + rounding
