"""Where a piecewise-affine system can be while its modes are restricted: boxes forward from X_0, and modes that remain.

Everything is rounded outwards, so that what the search leaves out for these boxes is left out with proof.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.problem.dynamics.mode_arrays import ModeArrays
from lin_freq_ocp.problem.ocp import OptimalControlProblem

OUTWARD = 1e-12
"""By this part of the largest terms, sums are rounded outwards: far above their rounding errors."""


ENDLESS = 1e100
"""Stands for infinity, so that no product with zero is undefined; what is beyond UNBOUNDED came from it."""

UNBOUNDED = 1e90


@dataclass(frozen=True, eq=False)
class Reach:
    """A box around every state that modes within a mask allow.

    Attributes
    ----------
    allowed : (T, modes)
        The modes that remain of the mask: the others cannot be reached, or lead out of the state sets.
    lower, upper : (T+1, n)
        Bounds of the states.
    mode_lower, mode_upper : (T, modes, n+m)
        Bounds of (x_t, u_t) in the region of each mode that remains.
    centres, generators : sequences of (n,) and (n, count)
        x_t lies in centre + generators [-1, 1]^count, too, which does not wrap around turning dynamics.
    """

    allowed: Mask
    lower: Array
    upper: Array
    mode_lower: Array
    mode_upper: Array
    centres: tuple[Array, ...]
    generators: tuple[Array, ...]


@dataclass(frozen=True, eq=False)
class ModeReach:
    """The reach of one problem, for any mask of modes."""

    problem: OptimalControlProblem

    @cached_property
    def arrays(self) -> ModeArrays:
        """The modes at all times."""
        return self.problem.piecewise.arrays(self.problem.horizon)

    def from_start(self, allowed: Mask) -> Reach | None:
        """Return the reach of a mask (T, modes), or None if no sequence within it has a trajectory."""
        tube, controls = self.problem.state_tube, self.problem.control_tube
        lower, upper = np.maximum(tube.lower, -ENDLESS), np.minimum(tube.upper, ENDLESS)
        y_lower, y_upper = (
            np.concatenate([x[:-1], np.clip(u, -ENDLESS, ENDLESS)], axis=1)[:, None].repeat(allowed.shape[1], axis=1)
            for x, u in ((lower, controls.lower), (upper, controls.upper))
        )
        centre, spread = _ball(lower[0], upper[0])
        return self._onwards(Reach(np.array(allowed), lower, upper, y_lower, y_upper, (centre,), (spread,)), 0)

    def after(self, before: Reach, t: int, modes: Mask) -> Reach | None:
        """Return the reach with only some of the modes (modes,) at time t."""
        reach = replace(
            before,
            allowed=before.allowed.copy(),
            lower=before.lower.copy(),
            upper=before.upper.copy(),
            mode_lower=before.mode_lower.copy(),
            mode_upper=before.mode_upper.copy(),
        )
        reach.allowed[t] &= modes
        return self._onwards(reach, t)

    def _onwards(self, reach: Reach, first: int) -> Reach | None:
        """Cut a reach from time ``first`` on, in place; what it holds for later times already holds of it, too."""
        centres, generators = list(reach.centres[: first + 1]), list(reach.generators[: first + 1])
        for t in range(first, len(reach.allowed)):
            low, high, feasible = self._within_regions(t, reach)
            image_low, image_high = self._images(t, low, high)
            centre, spread = self._zonotopes(t, centres[t], generators[t])
            radius = np.abs(spread).sum(axis=-1)
            radius = radius + OUTWARD * (np.abs(centre) + radius)
            image_low = np.maximum(np.maximum(image_low, centre - radius), reach.lower[t + 1])
            image_high = np.minimum(np.minimum(image_high, centre + radius), reach.upper[t + 1])
            keep = reach.allowed[t] & feasible & (image_low <= image_high).all(axis=1)
            if not keep.any():
                return None
            reach.allowed[t], reach.mode_lower[t], reach.mode_upper[t] = keep, low, high
            new_low, new_high = image_low[keep].min(axis=0), image_high[keep].max(axis=0)
            single = np.count_nonzero(keep) == 1
            same = not single and (new_low == reach.lower[t + 1]).all() and (new_high == reach.upper[t + 1]).all()
            if same and len(reach.centres) > t + 1:
                centres += reach.centres[t + 1 :]
                generators += reach.generators[t + 1 :]
                break
            reach.lower[t + 1], reach.upper[t + 1] = new_low, new_high
            only = int(np.argmax(keep))
            after = (centre[only], spread[only]) if single else _ball(new_low, new_high)
            centres.append(after[0])
            generators.append(after[1])
        return replace(reach, centres=tuple(centres), generators=tuple(generators))

    def _within_regions(self, t: int, reach: Reach) -> tuple[Array, Array, Mask]:
        """Return the box of (x_t, u_t) cut by the region of each mode, (modes, k), and which regions it meets."""
        rows, signs, n = self._rows, self._signs, self.problem.state_dim
        low, high = reach.mode_lower[t].copy(), reach.mode_upper[t].copy()
        np.maximum(low[:, :n], reach.lower[t], out=low[:, :n])
        np.minimum(high[:, :n], reach.upper[t], out=high[:, :n])
        nearest = np.where(signs[t], low[:, None], high[:, None])
        terms = rows[t] * nearest
        limits = np.minimum(self.arrays.h[t], ENDLESS)
        slack = limits - terms.sum(axis=-1)
        slack = slack + OUTWARD * (np.abs(terms).sum(axis=-1) + self._limit_sizes[t])
        room = nearest + slack[..., None] * self._inverses[t]
        np.minimum(high, np.where(signs[t], room, np.inf).min(axis=1), out=high)
        np.maximum(low, np.where(signs[t] | (rows[t] == 0), -np.inf, room).max(axis=1), out=low)
        return np.minimum(low, high), high, (slack >= 0).all(axis=1)

    def _images(self, t: int, low: Array, high: Array) -> tuple[Array, Array]:
        """Return a box (modes, n) around what each mode makes of its box (modes, k)."""
        up, down, offset = self._increasing[t], self._decreasing[t], self.arrays.offset[t]
        low, high = low[..., None], high[..., None]
        least, most = (up @ low + down @ high)[..., 0] + offset, (up @ high + down @ low)[..., 0] + offset
        size = ((up - down) @ np.maximum(np.abs(low), np.abs(high)))[..., 0] + np.abs(offset)
        return least - OUTWARD * size, most + OUTWARD * size

    def _zonotopes(self, t: int, centre: Array, spread: Array) -> tuple[Array, Array]:
        """Return centres (modes, n) and generators (modes, n, count) of the images of a zonotope."""
        A = self.arrays.A[t]
        return A @ centre + self._pushed[t], np.concatenate([A @ spread, self._pushes[t]], axis=-1)

    @cached_property
    def _rows(self) -> Array:
        return np.concatenate([self.arrays.G, self.arrays.H], axis=-1)

    @cached_property
    def _signs(self) -> Mask:
        """Where a coefficient is above zero, so that the row bounds its component from above."""
        return self._rows > 0

    @cached_property
    def _inverses(self) -> Array:
        """1 / coefficient; endless where there is no coefficient, or no limit."""
        usable = (self._rows != 0) & np.isfinite(self.arrays.h)[..., None]
        return np.where(usable, 1 / np.where(usable, self._rows, 1.0), np.sign(self._rows) * ENDLESS)

    @cached_property
    def _limit_sizes(self) -> Array:
        return np.where(np.isfinite(self.arrays.h), np.abs(self.arrays.h), 0.0)

    @cached_property
    def _increasing(self) -> Array:
        return np.maximum(np.concatenate([self.arrays.A, self.arrays.B], axis=-1), 0.0)

    @cached_property
    def _decreasing(self) -> Array:
        return np.minimum(np.concatenate([self.arrays.A, self.arrays.B], axis=-1), 0.0)

    @cached_property
    def _control_ball(self) -> tuple[Array, Array]:
        """Centre (T, m) and generators' lengths (T, m) of the control boxes."""
        tube = self.problem.control_tube
        lower, upper = np.maximum(tube.lower, -ENDLESS), np.minimum(tube.upper, ENDLESS)
        return (lower + upper) / 2, (upper - lower) / 2

    @cached_property
    def _pushed(self) -> Array:
        """What the centres of the controls add to the next state, with the offset, (T, modes, n)."""
        return np.einsum("tkij,tj->tki", self.arrays.B, self._control_ball[0]) + self.arrays.offset

    @cached_property
    def _pushes(self) -> Array:
        """The generators that the controls add, (T, modes, n, m)."""
        return self.arrays.B * self._control_ball[1][:, None, None]


def _ball(lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return centre and generators of a box."""
    return (lower + upper) / 2, np.diag((upper - lower) / 2)
