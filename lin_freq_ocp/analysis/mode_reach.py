"""Where a piecewise-affine system can be while its modes are restricted: boxes forward from X_0, and modes that remain.

Everything is rounded outwards, so that what the search leaves out for these boxes is left out with proof.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.problem.ocp import OptimalControlProblem

OUTWARD = 1e-12  # part of the largest terms by which sums are rounded outwards: far above their rounding errors
INFINITE = 1e100  # stands for infinity, so that its product with zero is zero
UNBOUNDED = 1e90  # larger bounds stem from INFINITE


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


class ModeReach:
    """The reach of one problem, for any mask of modes."""

    def __init__(self, problem: OptimalControlProblem):
        self.problem, self.arrays, tube = problem, problem.piecewise.arrays(problem.horizon), problem.control_tube
        arrays = self.arrays
        maps, self._rows = np.concatenate([arrays.A, arrays.B], axis=-1), np.concatenate([arrays.G, arrays.H], axis=-1)
        self._increasing, self._decreasing = np.maximum(maps, 0.0), np.minimum(maps, 0.0)
        self._limits = np.minimum(arrays.h, INFINITE)
        finite = np.isfinite(arrays.h)
        self._limit_sizes = np.where(finite, np.abs(arrays.h), 0.0)
        usable = (self._rows != 0) & finite[..., None]
        inverses = 1 / np.where(usable, self._rows, 1.0)
        self._inverses = np.where(usable, inverses, np.sign(self._rows) * INFINITE)  # no coefficient, or no limit
        lower, upper = np.maximum(tube.lower, -INFINITE), np.minimum(tube.upper, INFINITE)
        # what the centres of the controls add to the next state, and the generators that the controls add
        self._pushed = np.einsum("tkij,tj->tki", arrays.B, (lower + upper) / 2) + arrays.offset
        self._pushes = arrays.B * ((upper - lower) / 2)[:, None, None]

    def from_start(self, allowed: Mask) -> Reach | None:
        """Return the reach of a mask (T, modes), or None if no sequence within it has a trajectory."""
        tube, controls = self.problem.state_tube, self.problem.control_tube
        lower, upper = np.maximum(tube.lower, -INFINITE), np.minimum(tube.upper, INFINITE)
        y_lower, y_upper = (
            np.concatenate([x[:-1], np.clip(u, -INFINITE, INFINITE)], axis=1)[:, None].repeat(allowed.shape[1], axis=1)
            for x, u in ((lower, controls.lower), (upper, controls.upper))
        )
        centre, spread = _ball(lower[0], upper[0])
        return self._onwards(Reach(np.array(allowed), lower, upper, y_lower, y_upper, (centre,), (spread,)), 0)

    def after(self, before: Reach, t: int, modes: Mask) -> Reach | None:
        """Return the reach with only some of the modes (modes,) at time t."""
        copied = ("allowed", "lower", "upper", "mode_lower", "mode_upper")
        reach = replace(before, **{field: getattr(before, field).copy() for field in copied})
        reach.allowed[t] &= modes
        return self._onwards(reach, t)

    def _onwards(self, reach: Reach, first: int) -> Reach | None:
        """Cut a reach from time ``first`` on, in place; its bounds at later times are kept."""
        centres, generators = list(reach.centres[: first + 1]), list(reach.generators[: first + 1])
        for t in range(first, len(reach.allowed)):
            low, high, feasible = self._within_regions(t, reach)
            image_low, image_high = self._images(t, low, high)
            A = self.arrays.A[t]
            centre = A @ centres[t] + self._pushed[t]
            spread = np.concatenate([A @ generators[t], self._pushes[t]], axis=-1)
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
        rows, n = self._rows[t], self.problem.state_dim
        above = rows > 0
        low, high = reach.mode_lower[t].copy(), reach.mode_upper[t].copy()
        np.maximum(low[:, :n], reach.lower[t], out=low[:, :n])
        np.minimum(high[:, :n], reach.upper[t], out=high[:, :n])
        nearest = np.where(above, low[:, None], high[:, None])
        terms = rows * nearest
        slack = self._limits[t] - terms.sum(axis=-1)
        slack = slack + OUTWARD * (np.abs(terms).sum(axis=-1) + self._limit_sizes[t])
        room = nearest + slack[..., None] * self._inverses[t]
        np.minimum(high, np.where(above, room, np.inf).min(axis=1), out=high)
        np.maximum(low, np.where(rows < 0, room, -np.inf).max(axis=1), out=low)
        return np.minimum(low, high), high, (slack >= 0).all(axis=1)

    def _images(self, t: int, low: Array, high: Array) -> tuple[Array, Array]:
        """Return a box (modes, n) around the image of each mode's box (modes, k)."""
        up, down, offset = self._increasing[t], self._decreasing[t], self.arrays.offset[t]
        low, high = low[..., None], high[..., None]
        least, most = (up @ low + down @ high)[..., 0] + offset, (up @ high + down @ low)[..., 0] + offset
        size = ((up - down) @ np.maximum(np.abs(low), np.abs(high)))[..., 0] + np.abs(offset)
        return least - OUTWARD * size, most + OUTWARD * size


def _ball(lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return centre and generators of a box."""
    return (lower + upper) / 2, np.diag((upper - lower) / 2)
