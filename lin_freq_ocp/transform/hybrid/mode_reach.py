"""The reachable states of a piecewise-affine system with restricted modes: boxes from X_0 on, and reachable modes.

All bounds are rounded outwards, so that a mode outside of them is proven unreachable. Several masks propagate at once:
the arrays are small, and for a single mask most of the time would be overhead of calls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.transform.hybrid.forms import INFINITE, OUTWARD, boxes_of_steps, piecewise_affine

LARGEST_BOUND = 1e90  # larger bounds come from INFINITE


@dataclass(frozen=True, eq=False)
class Reach:
    """Boxes of the states that modes within a mask can reach.

    Attributes
    ----------
    allowed : (T, modes)
        The modes of the mask that can be reached and do not lead out of the state sets.
    lower, upper : (T+1, n)
        Bounds of the states.
    mode_lower, mode_upper : (T, modes, n+m)
        Bounds of (x_t, u_t) in the region of each allowed mode.
    centres, generators : sequences of (n,) and (n, count)
        x_t also lies in the zonotope centre + generators [-1, 1]^count, which does not grow as boxes of rotations do.
    """

    allowed: Mask
    lower: Array
    upper: Array
    mode_lower: Array
    mode_upper: Array
    centres: tuple[Array, ...]
    generators: tuple[Array, ...]


class ModeReach:
    """The reach of one problem, for any mask of modes."""

    def __init__(self, problem: OptimalControlProblem):
        self.problem, self._stated, n = problem, boxes_of_steps(problem), problem.state_dim
        self.arrays = piecewise_affine(problem).arrays(problem.horizon)
        arrays = self.arrays
        maps, self._rows, limits = arrays.maps, arrays.rows, arrays.h
        self._increasing, self._decreasing = np.maximum(maps, 0.0), np.minimum(maps, 0.0)
        self._limits, finite = np.minimum(limits, INFINITE), np.isfinite(limits)
        self._limit_sizes = np.where(finite, np.abs(limits), 0.0)
        usable = (self._rows != 0) & finite[..., None]
        inverses = 1 / np.where(usable, self._rows, 1.0)
        self._inverses = np.where(usable, inverses, np.sign(self._rows) * INFINITE)  # no coefficient, or no limit
        lower, upper = (side[..., n:] for side in self._stated)
        # the contribution of the controls to the next state: that of their centres, and generators
        self._pushed = np.einsum("tkij,tkj->tki", arrays.B, (lower + upper) / 2) + arrays.offset
        self.pushes = arrays.B * ((upper - lower) / 2)[:, :, None]  # (T, modes, n, m)
        self._pushed_radius = np.abs(self.pushes).sum(axis=-1)
        self._above, self._below = self._rows > 0, self._rows < 0
        self._absolute = self._increasing - self._decreasing

    def from_start(self, allowed: Mask) -> Reach | None:
        """Return the reach of a mask (T, modes), or None if no sequence within it has a trajectory."""
        return self.from_start_each([allowed])[0]

    def from_start_each(self, masks: Sequence[Mask]) -> list[Reach | None]:
        """Return the reach of each mask (T, modes)."""
        if not masks:
            return []
        tube = self.problem.state_tube
        lower, upper = np.maximum(tube.lower, -INFINITE), np.minimum(tube.upper, INFINITE)
        centre, spread = (lower[0] + upper[0]) / 2, np.diag((upper[0] - lower[0]) / 2)
        unrestricted = Reach(masks[0], lower, upper, *self._stated, (centre,), (spread,))
        return _Propagation(self, unrestricted, 0, np.array(masks)).run()

    def after(self, reach: Reach, t: int, choices: Sequence[Mask]) -> list[Reach | None]:
        """Return the reach with fewer modes at a time, for each choice (modes,) of them."""
        allowed = np.stack([reach.allowed] * len(choices))
        allowed[:, t] &= np.array(choices)
        return _Propagation(self, reach, t, allowed).run()

    def within_regions(self, t: int, low: Array, high: Array) -> tuple[Array, Array, Mask]:
        """Return boxes of (x_t, u_t), (..., modes, k), cut by the region of each mode, and which regions they meet."""
        rows, above = self._rows[t], self._above[t]
        nearest = np.where(above, low[..., None, :], high[..., None, :])
        terms = rows * nearest
        slack = self._limits[t] - terms.sum(axis=-1)
        slack += OUTWARD * (np.abs(terms).sum(axis=-1) + self._limit_sizes[t])
        limit = nearest + slack[..., None] * self._inverses[t]
        high = np.minimum(high, np.where(above, limit, np.inf).min(axis=-2))
        low = np.maximum(low, np.where(self._below[t], limit, -np.inf).max(axis=-2))
        meets = (slack >= 0).all(axis=-1) & (low <= high).all(axis=-1)  # each row alone may be feasible, and not all
        return np.minimum(low, high), high, meets

    def images(self, t: int, low: Array, high: Array) -> tuple[Array, Array]:
        """Return boxes (..., modes, n) around the images of boxes (..., modes, k)."""
        up, down, offset = self._increasing[t], self._decreasing[t], self.arrays.offset[t]
        size = (self._absolute[t] @ np.maximum(np.abs(low), np.abs(high))[..., None])[..., 0] + np.abs(offset)
        low, high, rounding = low[..., None], high[..., None], OUTWARD * size
        least, most = (up @ low + down @ high)[..., 0], (up @ high + down @ low)[..., 0]
        return least + offset - rounding, most + offset + rounding

    def zonotopes(self, t: int, centres: Array, generators: Array) -> tuple[Array, Array, Array]:
        """Return centres, radii, (batch, modes, n), and generators of images, without the generators of controls."""
        A = self.arrays.A[t]
        centre = (A @ centres[:, None, :, None])[..., 0] + self._pushed[t]
        spread = A @ generators[:, None]
        radius = np.abs(spread).sum(axis=-1) + self._pushed_radius[t]
        return centre, radius + OUTWARD * (np.abs(centre) + radius), spread


class _Propagation:
    """The propagation of a reach with other masks, (count, T, modes), from a time on; its later bounds stay valid."""

    def __init__(self, system: ModeReach, before: Reach, first: int, allowed: Mask):
        self._system, self._before, self._first, self._allowed, count = system, before, first, allowed, len(allowed)
        self._lower, self._upper, self._mode_lower, self._mode_upper = (
            np.stack([part] * count) for part in (before.lower, before.upper, before.mode_lower, before.mode_upper)
        )
        self._centres = [list(before.centres[: first + 1]) for _ in range(count)]
        self._generators = [list(before.generators[: first + 1]) for _ in range(count)]
        # those of the present time, of which ``sizes`` generators are used, the others zero
        self._centre = np.stack([before.centres[first]] * count)
        self._spread = np.stack([before.generators[first]] * count)
        self._sizes = np.full(count, self._spread.shape[2])

    def run(self) -> list[Reach | None]:
        """Return the reaches, None where no sequence has a trajectory."""
        count, T, _ = self._allowed.shape
        possible, live = np.ones(count, dtype=bool), np.arange(count)
        for t in range(self._first, T):
            if not len(live):
                break
            keep, settled = self._step(t, live)
            possible[live] = keep
            live = live[keep & ~settled]
        arrays = self._allowed, self._lower, self._upper, self._mode_lower, self._mode_upper
        zonotopes = zip(self._centres, self._generators, strict=True)
        return [
            Reach(*(part[b].copy() for part in arrays), centres=tuple(centres), generators=tuple(generators))
            if possible[b]
            else None
            for b, (centres, generators) in enumerate(zonotopes)
        ]

    def _step(self, t: int, live: Indices) -> tuple[Mask, Mask]:
        """Propagate from t to t + 1; return which masks have a trajectory, and for which nothing changes later."""
        system, n, before = self._system, self._lower.shape[2], self._before
        low, high = self._mode_lower[live, t], self._mode_upper[live, t]
        np.maximum(low[..., :n], self._lower[live, None, t], out=low[..., :n])
        np.minimum(high[..., :n], self._upper[live, None, t], out=high[..., :n])
        low, high, feasible = system.within_regions(t, low, high)
        image_low, image_high = system.images(t, low, high)
        centre, radius, spread = system.zonotopes(
            t, self._centre[live], self._spread[live, :, : self._sizes[live].max()]
        )
        last_low, last_high = self._lower[live, t + 1], self._upper[live, t + 1]
        image_low = np.maximum(np.maximum(image_low, centre - radius), last_low[:, None])
        image_high = np.minimum(np.minimum(image_high, centre + radius), last_high[:, None])
        keep = self._allowed[live, t] & feasible & (image_low <= image_high).all(axis=-1)
        self._allowed[live, t], self._mode_lower[live, t], self._mode_upper[live, t] = keep, low, high
        new_low = np.where(keep[..., None], image_low, np.inf).min(axis=1)
        new_high = np.where(keep[..., None], image_high, -np.inf).max(axis=1)
        self._lower[live, t + 1], self._upper[live, t + 1] = new_low, new_high
        count = keep.sum(axis=1)
        same = (count > 1) & (new_low == last_low).all(axis=1) & (new_high == last_high).all(axis=1)
        same &= len(before.centres) > t + 1
        # the zonotope of the image of a single mode; of several, that of the box around the union
        single, several, pushes, used = (
            np.flatnonzero(count == 1),
            np.flatnonzero(count > 1),
            system.pushes[t],
            spread.shape[3],
        )
        one, many, only = live[single], live[several], keep.argmax(axis=1)[single]
        # new arrays, as reaches keep those of earlier times
        m = pushes.shape[2]
        self._centre, self._spread = self._centre.copy(), np.zeros((len(self._sizes), n, max(used + m, n)))
        self._centre[one], self._spread[one, :, :used] = centre[single, only], spread[single, only]
        self._spread[one[:, None], :, self._sizes[one, None] + np.arange(m)] = pushes[only].swapaxes(1, 2)
        self._centre[many] = (new_low[several] + new_high[several]) / 2
        self._spread[many[:, None], np.arange(n), np.arange(n)] = (new_high[several] - new_low[several]) / 2
        self._sizes[one] += m
        self._sizes[many] = n
        for b, settled, possible in zip(live, same, count > 0, strict=True):
            if settled:
                self._centres[b] += before.centres[t + 1 :]
                self._generators[b] += before.generators[t + 1 :]
            elif possible:
                self._centres[b].append(self._centre[b])
                self._generators[b].append(self._spread[b, :, : self._sizes[b]])
        return count > 0, same
