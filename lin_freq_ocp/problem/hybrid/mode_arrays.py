"""All modes at all times, as arrays: what each makes of a trajectory, and which hold where."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask

# A point this far beyond a facet of a region, relative to the size of its row, is still on it: solvers meet rows to
# 1e-8 or so, and the judge forgives 1e-6.
FACET_TOLERANCE = 1e-6
# Two modes lead to the same state if their images differ by less, relative to the largest sum of absolute terms:
# those of a continuous map differ by |g| times the distance from the facet, which is at most FACET_TOLERANCE of |g
# h'| times the terms for each of the two, and |g h'| <= |F_1| + |F_2|.
SAME_IMAGE = 4 * FACET_TOLERANCE
# No component is measured more finely than this fraction of what the problem says of its size, as by the judge; a
# control with levels no more finely than these.
LEAST_SIZE = 1e-4
# A replay takes the first mode whose region holds the point up to this rounding, relative to the terms of its rows.
REPLAY_ROUNDING = 16 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class ModeArrays:
    """All modes at all times, with rows of regions filled up by 0 <= inf."""

    A: Array  # (T, modes, n, n)
    B: Array  # (T, modes, n, m)
    offset: Array  # (T, modes, n)
    G: Array  # (T, modes, rows, n)
    H: Array  # (T, modes, rows, m)
    h: Array  # (T, modes, rows)
    least: tuple[Array, Array]  # (n,) and (m,): the smallest sizes of states and controls; zeros if unknown

    def with_sizes(self, x: Array, u: Array, levels: Array) -> ModeArrays:
        """Return the same modes; states (n,) and controls (m,) are known to be of these sizes, and levels (m,)."""
        return replace(self, least=(LEAST_SIZE * x, np.maximum(LEAST_SIZE * u, levels)))

    def sizes(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Return how large states, (n,), and controls, (m,), are along a trajectory: rounding is relative to it.

        A state that stays at a border at zero is as large as the terms that it is made of, by the mode that has the
        smallest ones.
        """
        largest = np.abs(x).max(axis=0), np.maximum(np.abs(u).max(axis=0), self.least[1])
        terms = np.einsum("tkij,tj->tki", _absolute(self.A), np.abs(x[: len(u)]))
        terms += np.einsum("tkij,tj->tki", _absolute(self.B), np.abs(u)) + _absolute(self.offset)
        return np.maximum.reduce([largest[0], terms.min(axis=1).max(axis=0), self.least[0]]), largest[1]

    def images(self, x: Array, u: Array) -> Array:
        """Return what each mode makes of (x_t, u_t), shape (T, modes, n); x is (T+1, n) or (T, n)."""
        through_x = np.einsum("tkij,tj->tki", self.A, x[: len(u)])
        return through_x + np.einsum("tkij,tj->tki", self.B, u) + self.offset

    def image_sizes(self, x: Array, u: Array, modes: Mask) -> Array:
        """Return what images are compared by, (n,): the largest sum of absolute terms over those modes (T, modes)."""
        of_x, of_u = self.sizes(x, u)
        terms = _absolute(self.A) @ of_x + _absolute(self.B) @ of_u + _absolute(self.offset)
        return np.where(modes[..., None], terms, 0.0).max(axis=(0, 1))

    def excess(self, x: Array, u: Array) -> Array:
        """Return G x_t + H u_t - h per row of each region, (T, modes, rows); -inf where there is no row."""
        return np.einsum("tkrj,tj->tkr", self.G, x[: len(u)]) + np.einsum("tkrj,tj->tkr", self.H, u) - self.h

    def row_sizes(self, x: Array, u: Array) -> Array:
        """Return what an excess is measured by, (modes, rows): the terms of its row for components of their sizes."""
        of_x, of_u = self.sizes(x, u)
        limits = np.where(np.isfinite(self.h), np.abs(self.h), 0.0)
        largest = (_absolute(self.G) @ of_x + _absolute(self.H) @ of_u + limits).max(axis=0)
        return np.where(largest > 0, largest, 1.0)

    def distance(self, x: Array, u: Array) -> Array:
        """Return by how much (x_t, u_t) lies outside each region, relative to the sizes of its rows; (T, modes)."""
        return np.maximum((self.excess(x, u) / self.row_sizes(x, u)).max(axis=2), 0.0)

    def active_facets(self, x: Array, u: Array) -> Mask:
        """Which rows of each region (x_t, u_t) lies on, or beyond, within FACET_TOLERANCE; (T, modes, rows)."""
        return self.excess(x, u) >= -FACET_TOLERANCE * self.row_sizes(x, u)

    def active(self, x: Array, u: Array) -> Mask:
        """Which modes hold at (x_t, u_t), within FACET_TOLERANCE; (T, modes)."""
        return self.distance(x, u) <= FACET_TOLERANCE

    def sequence(self, x: Array, u: Array) -> Indices:
        """Return the mode at every time, (T,): of those that hold, the one that leads nearest to x_{t+1}.

        Differences are added up relative to the sizes of the components; of modes that lead there equally, up to
        rounding, it is the first. Where none holds, those whose regions are nearest; x is (T+1, n), u is (T, m).
        """
        distance = self.distance(x, u)
        outside = np.where(distance <= FACET_TOLERANCE, 0.0, distance)
        nearest = outside <= outside.min(axis=1, keepdims=True)
        sizes = self.image_sizes(x, u, nearest)
        relative = np.abs(x[1:, None] - self.images(x, u)) / np.where(sizes > 0, sizes, 1.0)
        miss = np.where(nearest, relative.sum(axis=2), np.inf)
        return np.argmax(miss <= miss.min(axis=1, keepdims=True) + REPLAY_ROUNDING, axis=1)

    def active_modes(self, x: Array, u: Array) -> Mask:
        """Which modes hold at (x_t, u_t) and lead to the same state as that of ``sequence``, itself one; (T, modes).

        Of a continuous map, all that hold; of one that jumps, those on the trajectory's side.
        """
        times, sequence = np.arange(len(u)), self.sequence(x, u)
        images, active = self.images(x, u), self.active(x, u)
        active[times, sequence] = True
        sizes = self.image_sizes(x, u, active)
        here = images[times, sequence][:, None]
        return active & (np.abs(images - here) <= SAME_IMAGE * sizes).all(axis=2)


def _absolute(part: Array) -> Array:
    """Return the absolute values; what stands in memory once for all times does so again."""
    return np.abs(part) if part.strides[0] else np.broadcast_to(np.abs(part[:1]), part.shape)
