"""The relaxation of a mode sequence as a path, the bound of its duals, and the recovery of its solutions.

The path leads through a graph whose vertices are the modes at every time.

An edge e = (t, i, j) stands for mode i at t and j at t + 1, with weight delta_e >= 0 and share y_e of (x_t, u_t). What
comes into a vertex leaves it, weights as well as shares of the state:

    sum of delta_e over t = 0 is 1,   sum_in delta = sum_out delta,   sum_in (A_i y + B_i u + d_i delta) = sum_out x,
    y_e in delta_e (box and region of mode i at t),   A_i y + B_i u + d_i delta in delta_e (box of mode j at t + 1),
    cost of y_e in perspective;   rows over all times on the sums of y_e, equations all of them;   rows of x_T

(shortest paths in graphs of convex sets: Marcucci, Umenberger, Parrilo and Tedrake 2024). It is tighter than shares of
modes at each time alone (relaxation.py), as a share keeps its mode for two times. The last edge is that of x_T alone.

An edge has the variables w = (v, delta, epsilon), y = middle delta + half v, so that |v| <= delta is its box. All rows
are homogeneous: C w = b of the vertices and of rows over all times, G w + s = 0 with s >= 0 or in second-order cones.

Duals prove the shortest path, with the least Lagrangian over its box as the length of an edge. With eta_tj of the
vertex of mode j at t + 1, in natural units y = (x, u), and lambda >= 0, nu, rho as below,

    phi_tij = min over box_ti of  c_t(y) + <eta_{t-1,i}, x> - <eta_tj + nu_tij, f_ti(y)> + <lambda_tij, G_ti y - h_ti>
                                  + <rho, F_t y>  +  min over box_{t+1,j} of <nu_tij, x>,
    J within the mask >= min over paths of sum_t phi_{t, i_t, i_{t+1}} + phi_T - <rho, right>,

for any duals, of a solution or not: along a trajectory, the added terms are at most zero or cancel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.hybrid.relaxation import ModeRelaxation
from lin_freq_ocp.program.hybrid.rows import THIN, Duals, PathModel
from lin_freq_ocp.transform.hybrid.mode_reach import LARGEST_BOUND, Reach


@dataclass(frozen=True, eq=False)
class PathProgram:
    """The relaxation of one reach; E edges by time, the last that of x_T, with W = k + 2 variables each.

    Attributes
    ----------
    t, i, j : (E,)
    middle, half : (E, k)
    C : (E, 2n+2, W), places : (E, 2n+2)
        Rows of the vertex that an edge leaves and of that which it enters: their numbers, -1 for none.
    signals : (E, a, W), coupled : (q, T+1, a)
        The entries of y that rows over all times have, and these rows.
    b : (vertex rows + q,), cost : (E, W)
    linear : (E, R, W), sizes : (E, R), present : (E, R)
        G for s >= 0, each row divided by its size: k upper and k lower bounds, regions, n upper and n lower images.
        Rows that can never be active are not present; delta >= 0 replaces them.
    ends : (count,)
        Which inequalities of x_T can be active: they are rows of the last edge, at the location of its region.
    cone : (E, rank + 2, W)
        G for the second-order cone.
    """

    t: Indices
    i: Indices
    j: Indices
    middle: Array
    half: Array
    C: Array
    places: Indices
    signals: Array
    coupled: Array
    b: Array
    cost: Array
    linear: Array
    sizes: Array
    present: Mask
    ends: Indices
    cone: Array

    @property
    def vertex_rows(self) -> int:
        """Return how many rows the vertices have."""
        return len(self.b) - len(self.coupled)


def path_program(model: PathModel, pairs: Mask, low: Array, high: Array, images: bool = True) -> PathProgram | None:
    """Return the program of edges (T, modes, modes) and boxes (T+1, modes, k); None if there is no path.

    ``images``: whether the image of an edge has to lie in the box of the mode that follows.
    """
    n, T = model.maps.shape[2], len(pairs)
    if not pairs.any(axis=(1, 2)).all():
        return None
    t, i, j = (np.append(part, last) for part, last in zip(np.nonzero(pairs), (T, 0, 0), strict=True))
    middle, half = (low + high)[t, i] / 2, (high - low)[t, i] / 2
    k = middle.shape[1]
    y = np.zeros((*middle.shape, k + 2))  # y of w
    y[:, np.arange(k), np.arange(k)], y[..., -2] = half, middle
    image = model.maps[t, i] @ y
    image[..., -2] += model.offsets[t, i]
    image[-1] = 0.0
    # the rows of the vertices that each edge leaves and enters, and their numbers; row 0 is that of t = 0
    edges, modes, after_start = len(t), int(max(i.max(), j.max())) + 1, t > 0
    C = np.zeros((edges, 2 * n + 2, k + 2))
    C[:, :n], C[:, n, -2], C[:, n + 1 : -1], C[:, -1, -2] = y[:, :n], 1.0, -image, -1.0
    present_vertices = np.zeros((T + 1, modes), dtype=bool)
    present_vertices[t[after_start], i[after_start]] = True
    number = (np.cumsum(present_vertices.ravel()) - 1).reshape(present_vertices.shape)
    places = np.full((edges, 2 * n + 2), -1)
    places[after_start, : n + 1] = 1 + number[t, i][after_start, None] * (n + 1) + np.arange(n + 1)
    places[~after_start, n] = 0
    places[:-1, n + 1 :] = 1 + number[t[:-1] + 1, j[:-1]][:, None] * (n + 1) + np.arange(n + 1)
    equations, used = model.coupled[: model.equations], model.coupled[: model.equations].any(axis=(0, 1))
    cost = (model.price[t, None] @ y)[:, 0]
    cost[:, -1] = 1.0
    after = np.minimum(t + 1, T), j
    linear, sizes, present, ends = _linear_rows(model, y, image, t, i, low[after][:, :n], high[after][:, :n], images)
    cone = np.concatenate([np.zeros((len(t), 2, y.shape[-1])), -np.sqrt(2.0) * (model.roots[t] @ y)], axis=1)
    cone[:, :2, -1], cone[:, 0, -2], cone[:, 1, -2] = -1.0, -1.0, 1.0
    first = np.zeros(1 + int(present_vertices.sum()) * (n + 1))
    first[0] = 1.0
    return PathProgram(
        t=t,
        i=i,
        j=j,
        middle=middle,
        half=half,
        C=C,
        places=places,
        signals=y[:, used],
        coupled=np.ascontiguousarray(equations[..., used]),
        b=np.concatenate([first, model.right[: model.equations]]),
        cost=cost,
        linear=linear,
        sizes=sizes,
        present=present,
        ends=ends,
        cone=cone,
    )


def _linear_rows(
    model: PathModel, y: Array, image: Array, t: Indices, i: Indices, low: Array, high: Array, images: bool
) -> tuple[Array, Array, Mask, Indices]:
    """Return the linear rows of edges, their sizes, which can be active, and the inequalities of x_T that can be."""
    edges, k, width = y.shape
    limits, n = model.limits[t, i], low.shape[1]
    of_end = model.coupled[model.equations :, -1] @ y[-1]
    of_end[:, -2] -= model.right[model.equations :]
    ends = np.flatnonzero(_can_be_active(of_end))
    count, regions = max(limits.shape[1], len(ends)), limits.shape[1]
    rows = np.zeros((edges, 2 * k + count + 2 * n, width))
    box, region, upper, lower = np.split(rows, np.cumsum([2 * k, count, n]), axis=1)
    box[:, np.arange(k), np.arange(k)], box[:, k + np.arange(k), np.arange(k)], box[..., -2] = 1.0, -1.0, -1.0
    region[:, :regions] = model.rows[t, i] @ y
    region[:, :regions, -2] -= np.where(np.isfinite(limits), limits, 0.0)
    upper[:], lower[:] = image, -image
    upper[..., -2] -= high
    lower[..., -2] += low
    present = _can_be_active(rows)
    present[:, 2 * k : 2 * k + regions] &= np.isfinite(limits)
    present[:, 2 * k + regions : 2 * k + count] = False
    present[:, 2 * k + count :] &= images
    present[-1] = False
    region[-1, : len(ends)], present[-1, 2 * k : 2 * k + len(ends)] = of_end[ends], True
    present[:, : 2 * k] = True
    rows[~present] = box[0, 0] - box[0, 0] * (np.arange(width) < k)
    sizes = np.sqrt((rows**2).sum(axis=-1))
    sizes[:, : 2 * k] = 1.0
    rows /= sizes[..., None]
    return rows, sizes, present, ends


def _can_be_active(rows: Array) -> Mask:
    """Return which homogeneous rows (..., W) of (v, delta, epsilon) are active or violated at a |v| <= delta."""
    spread, at = np.abs(rows[..., :-2]).sum(axis=-1), rows[..., -2]
    return (spread + at > 0) & (spread + np.abs(at) > THIN)


# With more modes, nodes with more edges per time than these are solved by shares of modes: that takes less time
MOST_MODES, MOST_EDGES = 4, 8


@dataclass(frozen=True, eq=False)
class PathMember:
    """The path relaxation of one reach: its program, None if there is no path."""

    program: PathProgram | None


class PathRelaxation(ModeRelaxation):
    """The relaxations of one problem as paths; those of its base where that is not possible, or not solved in C."""

    images = True  # whether the image of an edge has to lie in the box of the mode that follows

    def path_member(self, reach: Reach) -> PathMember | None:
        """Return the path relaxation of a reach; None where ``member`` has to do, as where a box has no end."""
        taken = reach.allowed[..., None]
        unbounded = taken & ((reach.mode_lower <= -LARGEST_BOUND) | (reach.mode_upper >= LARGEST_BOUND))
        if self._bounds is None or not self._bounds.model.of_end or unbounded.any():
            return None
        pairs, low, high = (part[0] for part in self._boxes(self._bounds.model, [reach]))
        if (np.abs(low) >= LARGEST_BOUND).any() or (np.abs(high) >= LARGEST_BOUND).any():
            return None
        (T, modes), edges = reach.allowed.shape, np.count_nonzero(pairs)
        if modes > MOST_MODES and edges > MOST_EDGES * T:
            return None
        return PathMember(path_program(self._bounds.model, pairs, low, high, self.images))

    def later(self, duals: Duals) -> Duals | None:
        """Return duals of paths moved to the time before, for a problem that begins one time later; None of others.

        The new last time has the adjoint of the former end, and no other multipliers. The multipliers of equations over
        all times are those whose sum is nearest to the former one, shifted cyclically; those of x_T stay.
        """
        if self._bounds is None or duals.vertices is None or duals.images is None:
            return None
        T, all_times = len(duals.vertices), self._bounds.model.coupled[: self._bounds.model.equations]
        vertices, regions, images = (
            np.concatenate([part[1:], np.zeros_like(part[:1])])
            for part in (duals.vertices, duals.regions, duals.images)
        )
        vertices[T - 2 :] = duals.vertices[-1, 0]  # of x_T: at T - 1 there are now modes
        for part in (regions, images):
            part[T - 2] = part[T - 2, :, :1]
        adjoint = np.concatenate([duals.adjoint[1:], duals.adjoint[-1:]])
        sides = duals.sides
        if len(all_times):
            total = np.tensordot(sides[: len(all_times)], all_times, axes=1)
            total[:-1] = np.roll(total[:-1], -1, axis=0)
            rows = all_times.reshape(len(all_times), -1)
            nearest = np.linalg.lstsq(rows.T, total.ravel(), rcond=None)[0].astype(np.float64)
            sides = np.append(nearest, sides[len(all_times) :])
        return Duals(adjoint, sides, regions, duals.eta_C, vertices, images)

    def path_duals(self, program: PathProgram, p: Array, z: Array, w: Array | None) -> Duals:
        """Return the duals of C w = b and of linear rows, (E, R), with the weights of w (E, W), or those of a ray."""
        T, modes = self._stages.limits.shape[:2]
        (edges, k), n = program.middle.shape, self._n
        t, i, j = program.t[:-1], program.i[:-1], program.j[:-1]
        of_edges = p[program.places[:-1, n + 1 : -1]]
        weights = np.ones(edges - 1) if w is None else np.maximum(w[:-1, -2], 0.0)
        vertices, adjoint, total = np.zeros((T, modes, n)), np.zeros((T, n)), np.zeros(T)
        vertices[t, j] = of_edges
        np.add.at(adjoint, t, weights[:, None] * of_edges)
        np.add.at(total, t, weights)
        of_rows = np.where(program.present, np.maximum(z, 0.0) / program.sizes, 0.0)
        regions, images = np.zeros((T, modes, modes, self._stages.limits.shape[2])), np.zeros((T, modes, modes, n))
        regions[t, i, j] = of_rows[:-1, 2 * k : 2 * k + regions.shape[-1]]
        images[t, i, j] = of_rows[:-1, -n:] - of_rows[:-1, -2 * n : -n]
        adjoint /= np.where(total > 0, total, 1.0)[:, None]
        sides, of_equations = np.zeros(len(self._sides.b)), p[program.vertex_rows :]
        sides[: len(of_equations)] = of_equations
        sides[len(of_equations) + program.ends] = of_rows[-1, 2 * k : 2 * k + len(program.ends)]
        return Duals(adjoint, sides, regions, 0.0 if w is None else 1.0, vertices, images)

    def no_path(self) -> Duals:
        """Return the duals that prove that no path leads through the modes."""
        T, modes, n, _ = self._stages.maps.shape
        regions = np.zeros((T, modes, *self._stages.limits.shape[1:]))
        vertices, images = np.zeros((T, modes, n)), np.zeros((T, modes, modes, n))
        return Duals(np.zeros((T, n)), np.zeros(len(self._sides.b)), regions, 0.0, vertices, images)

    def path_point(self, program: PathProgram, w: Array) -> tuple[Trajectory, Array]:
        """Return (x, u) and the weights of modes, (T, modes), of variables (E, W)."""
        T, modes = self._stages.limits.shape[:2]
        y, weights = np.zeros((T + 1, program.middle.shape[1])), np.zeros((T + 1, modes))
        np.add.at(y, program.t, program.middle * w[:, -2:-1] + program.half * w[:, :-2])
        np.add.at(weights, (program.t, program.i), w[:, -2])
        y *= self._stages.units
        y[:-1] += self._stages.references
        x = np.vstack([y[:-1, : self._n], y[-1:, : self._n] + self._stages.last_reference])
        return Trajectory(x, y[:-1, self._n :]), weights[:-1]
