"""The relaxation of a mode sequence as a path, what its duals prove, and the way back to trajectories and multipliers.

The path leads through a graph whose vertices are the modes at every time.

An edge e = (t, i, j) stands for mode i at t and j at t + 1, with weight delta_e >= 0 and share y_e of (x_t, u_t). What
comes into a vertex leaves it, weights as well as shares of the state:

    sum of delta_e over t = 0 is 1,   sum_in delta = sum_out delta,   sum_in (A_i y + B_i u + d_i delta) = sum_out x,
    y_e in delta_e (box and region of mode i at t),   A_i y + B_i u + d_i delta in delta_e (box of mode j at t + 1),
    cost of y_e in perspective;   rows over all times on the sums of y_e

(shortest paths in graphs of convex sets: Marcucci, Umenberger, Parrilo and Tedrake 2024). It is tighter than shares of
modes at each time alone (relaxation.py), as a share keeps its mode for two times. The last edge is that of x_T alone.

An edge has the variables w = (v, delta, epsilon), y = middle delta + half v, so that |v| <= delta is its box. All rows
are homogeneous: C w = b of the vertices and of rows over all times, G w + s = 0 with s >= 0 or in second-order cones.

Duals prove the shortest path, with the least Lagrangian over its box as the length of an edge. With eta_tj of the
vertex of mode j at t + 1, in natural units y = (x, u), and lambda >= 0, nu, rho as below,

    phi_tij = min over box_ti of  c_t(y) + <eta_{t-1,i}, x> - <eta_tj + nu_tij, f_ti(y)> + <lambda_tij, G_ti y - h_ti>
                                  + <rho, F_t y>  +  min over box_{t+1,j} of <nu_tij, x>,
    J within the mask >= min over paths of sum_t phi_{t, i_t, i_{t+1}} + phi_T - <rho, right>,

be the duals those of a solution or not: along a trajectory, what is added is at most zero or cancels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.problem.hybrid.mode_reach import LARGEST_BOUND, Reach
from lin_freq_ocp.problem.hybrid.mode_tree import ModeMultipliers, PathMultipliers
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.hybrid.relaxation import ModeRelaxation
from lin_freq_ocp.program.hybrid.rows import Quadratic, symmetric_roots
from lin_freq_ocp.program.program import StandardForm

THIN = 1e-9  # rows that differ by less from zero on the whole box, in natural units, are dropped: they have no interior


@dataclass(frozen=True, eq=False)
class PathModel:
    """What the programs of one problem share, in natural units y; at T there is only mode 0, without map and region.

    maps (T+1, modes, n, k), offsets (T+1, modes, n), rows (T+1, modes, r, k) and limits (T+1, modes, r) of regions,
    roots (T+1, rank, k) of Hessians, price (T+1, k), coupled (q, T+1, k) and right (q,) of rows over all times.
    """

    maps: Array
    offsets: Array
    rows: Array
    limits: Array
    roots: Array
    price: Array
    coupled: Array
    right: Array
    images: bool  # whether images have to lie in the boxes of the modes that follow

    def pairs(self, allowed: Mask, low: Array, high: Array) -> Mask:
        """Return which modes can follow each other, (T, modes, modes), as far as boxes (T+1, modes, k) tell."""
        n = self.maps.shape[2]
        middle, half = (low + high)[:-1, ..., None] / 2, (high - low)[:-1, ..., None] / 2
        centre = (self.maps[:-1] @ middle)[..., 0] + self.offsets[:-1]
        radius = (np.abs(self.maps[:-1]) @ half)[..., 0] + THIN
        above, below = (centre + radius)[:, :, None], (centre - radius)[:, :, None]
        meets = ((above >= low[1:, None, :, :n]) & (below <= high[1:, None, :, :n])).all(axis=-1)
        found = allowed[:-1, :, None] & allowed[1:, None] & meets
        while True:  # a vertex needs an edge in and an edge out
            live = np.ones(allowed.shape, dtype=bool)
            live[:-1] &= found.any(axis=2)
            live[1:] &= found.any(axis=1)
            less = found & live[:-1, :, None] & live[1:, None]
            if (less == found).all():
                return found
            found = less


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
        Rows that are not present, as they are never active, are delta >= 0.
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
    cone: Array

    @property
    def vertex_rows(self) -> int:
        """Return how many rows the vertices have."""
        return len(self.b) - len(self.coupled)


def path_program(model: PathModel, pairs: Mask, low: Array, high: Array) -> PathProgram | None:
    """Return the program of edges (T, modes, modes) and boxes (T+1, modes, k); None if there is no path."""
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
    C, places, count = _vertices(y[:, :n], image, t, i, j, T)
    used = model.coupled.any(axis=(0, 1))
    cost = (model.price[t, None] @ y)[:, 0]
    cost[:, -1] = 1.0
    after = np.minimum(t + 1, T), j
    linear, sizes, present = _linear_rows(model, y, image, t, i, low[after][:, :n], high[after][:, :n])
    cone = np.concatenate([np.zeros((len(t), 2, y.shape[-1])), -np.sqrt(2.0) * (model.roots[t] @ y)], axis=1)
    cone[:, :2, -1], cone[:, 0, -2], cone[:, 1, -2] = -1.0, -1.0, 1.0
    first = np.zeros(count)
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
        coupled=np.ascontiguousarray(model.coupled[..., used]),
        b=np.concatenate([first, model.right]),
        cost=cost,
        linear=linear,
        sizes=sizes,
        present=present,
        cone=cone,
    )


def _vertices(x: Array, image: Array, t: Indices, i: Indices, j: Indices, T: int) -> tuple[Array, Indices, int]:
    """Return the rows of vertices on each edge, their numbers, and how many there are; row 0 is that of t = 0."""
    edges, n, width = x.shape
    C = np.zeros((edges, 2 * n + 2, width))
    C[:, :n], C[:, n, -2], C[:, n + 1 : -1], C[:, -1, -2] = x, 1.0, -image, -1.0
    own, modes = t > 0, int(max(i.max(), j.max())) + 1
    present = np.zeros((T + 1, modes), dtype=bool)
    present[t[own], i[own]] = True
    number = (np.cumsum(present.ravel()) - 1).reshape(present.shape)
    places = np.full((edges, 2 * n + 2), -1)
    places[own, : n + 1] = 1 + number[t, i][own, None] * (n + 1) + np.arange(n + 1)
    places[~own, n] = 0
    places[:-1, n + 1 :] = 1 + number[t[:-1] + 1, j[:-1]][:, None] * (n + 1) + np.arange(n + 1)
    return C, places, 1 + int(present.sum()) * (n + 1)


def _linear_rows(
    model: PathModel, y: Array, image: Array, t: Indices, i: Indices, low: Array, high: Array
) -> tuple[Array, Array, Mask]:
    """Return the linear rows of edges, their sizes, and which can be active."""
    edges, k, width = y.shape
    limits, count = model.limits[t, i], model.limits.shape[2]
    rows = np.zeros((edges, 2 * k + count + 2 * low.shape[1], width))
    box, region, upper, lower = np.split(rows, np.cumsum([2 * k, count, low.shape[1]]), axis=1)
    box[:, np.arange(k), np.arange(k)], box[:, k + np.arange(k), np.arange(k)], box[..., -2] = 1.0, -1.0, -1.0
    region[:] = model.rows[t, i] @ y
    region[..., -2] -= np.where(np.isfinite(limits), limits, 0.0)
    upper[:], lower[:] = image, -image
    upper[..., -2] -= high
    lower[..., -2] += low
    spread, at = np.abs(rows[..., :k]).sum(axis=-1), rows[..., -2]
    present = (spread + at > 0) & (spread + np.abs(at) > THIN)
    present[:, 2 * k : 2 * k + count] &= np.isfinite(limits)
    present[:, 2 * k + count :] &= model.images
    present[-1] = False
    present[:, : 2 * k] = True
    rows[~present] = box[0, 0] - box[0, 0] * (np.arange(width) < k)
    sizes = np.sqrt((rows**2).sum(axis=-1))
    sizes[:, : 2 * k] = 1.0
    rows /= sizes[..., None]
    return rows, sizes, present


def path_form(program: PathProgram) -> StandardForm:
    """Return the standard form: the rows C w = b, the linear rows that are present, by edges, and the cones."""
    (edges, width), q, equations = program.cost.shape, len(program.coupled), len(program.b)
    variables, linear = np.arange(edges * width).reshape(edges, width), int(program.present.sum())
    size = program.cone.shape[1]
    coupled = program.coupled[:, program.t].swapaxes(0, 1) @ program.signals
    cones = equations + linear + np.arange(edges * size).reshape(edges, size)
    parts = (
        (np.maximum(program.places, 0), variables, np.where(program.places[..., None] >= 0, program.C, 0.0)),
        (np.broadcast_to(program.vertex_rows + np.arange(q), (edges, q)), variables, coupled),
        (cones, variables, program.cone),
        (equations + np.arange(linear), variables[np.nonzero(program.present)[0]], program.linear[program.present]),
    )
    row = np.concatenate([np.broadcast_to(rows[..., None], values.shape).ravel() for rows, _, values in parts])
    column = np.concatenate(
        [np.broadcast_to(own if values.ndim == 2 else own[:, None], values.shape).ravel() for _, own, values in parts]
    )
    value = np.concatenate([values.ravel() for _, _, values in parts])
    kept, count = np.flatnonzero(value), equations + linear + edges * size
    return StandardForm(
        P=sp.csc_array((edges * width, edges * width)),
        q=program.cost.ravel(),
        A=sp.csc_array((value[kept], (row[kept], column[kept])), shape=(count, edges * width)),
        b=np.concatenate([program.b, np.zeros(count - equations)]),
        equations=equations,
        inequalities=linear,
        cones=(size,) * edges,
        row=np.arange(count),
        sign=np.ones(count),
    )


@dataclass(frozen=True, eq=False)
class PathDuals:
    """Duals in natural units; eta_C = 0 for a proof that there is no trajectory.

    vertices (T, modes, n): eta_tj, those of T - 1 in mode 0; regions (T, modes, modes, r): lambda; images (T, modes,
    modes, n): nu; coupled (q,): rho; adjoint (T, n): eta_tj averaged by weights.
    """

    vertices: Array
    regions: Array
    images: Array
    coupled: Array
    adjoint: Array
    eta_C: float

    def times(self, factor: float) -> PathDuals:
        """Return the duals of the same relaxation with its cost in other units."""
        if not self.eta_C:
            return self
        vertices, regions, images = (factor * part for part in (self.vertices, self.regions, self.images))
        return PathDuals(vertices, regions, images, factor * self.coupled, factor * self.adjoint, self.eta_C)


class PathBounds:
    """Bounds of one problem; Hessians (T+1, k, k) in natural units."""

    def __init__(self, model: PathModel, hessians: Array):
        self._model, self._cost = model, Quadratic(hessians[:, None, None])
        self._feasible = Quadratic(np.zeros_like(hessians[:, None, None]))
        self._limits = np.where(np.isfinite(model.limits), model.limits, 0.0)

    def bound(self, pairs: Mask, low: Array, high: Array, duals: PathDuals) -> float:
        """Return what duals prove of edges (T, modes, modes) and boxes (T+1, modes, k): inf where there is no path."""
        value = np.zeros(pairs.shape[1])
        for length in self.lengths(pairs, low, high, duals)[::-1]:
            value = (length + value).min(axis=1)
        return float(value.min()) - float(duals.coupled @ self._model.right)

    def lengths(self, pairs: Mask, low: Array, high: Array, duals: PathDuals) -> Array:
        """Return phi (T+1, modes, modes), inf where an edge is missing; at T, of mode 0 to mode 0."""
        model, eta = self._model, duals.vertices
        T, modes, n = eta.shape
        slope = duals.eta_C * model.price + np.tensordot(duals.coupled, model.coupled, axes=1)
        own = np.zeros((T + 1, modes, modes, slope.shape[1]))
        own += slope[:, None, None]
        own[1:, ..., :n] += eta[:, :, None]
        ahead = eta[:, None] + duals.images
        own[:-1] -= ahead @ model.maps[:-1]
        own[:-1] += duals.regions @ model.rows[:-1]
        constant = np.zeros((T + 1, modes, modes))
        constant[:-1] -= (ahead @ model.offsets[:-1, :, :, None])[..., 0]
        constant[:-1] -= (duals.regions @ self._limits[:-1, :, :, None])[..., 0]
        ends = low[1:, None, :, :n], high[1:, None, :, :n]
        constant[:-1] += np.where(duals.images > 0, *(duals.images * end for end in ends)).sum(axis=-1)
        cost = self._cost if duals.eta_C else self._feasible
        found = constant + cost.least(own, low[:, :, None], high[:, :, None])
        present = np.zeros(found.shape, dtype=bool)
        present[:-1], present[-1, 0, 0] = pairs, True
        return np.where(present, found, np.inf)


# With more modes, nodes with more edges per time than these are solved by shares of modes: that takes less time
MOST_MODES, MOST_EDGES = 4, 8


@dataclass(frozen=True, eq=False)
class PathMember:
    """The path relaxation of one reach: its edges (T, modes, modes), boxes (T+1, modes, k), and the program, if any."""

    reach: Reach
    pairs: Mask
    low: Array
    high: Array
    program: PathProgram | None


class PathRelaxation(ModeRelaxation):
    """The relaxations of one problem as paths; those of its base where that is not possible."""

    images = True  # whether the image of an edge has to lie in the box of the mode that follows

    @cached_property
    def _paths(self) -> tuple[PathModel, PathBounds] | None:
        parts, stages = self._lagrangian, self._stages
        T, _, n, k = stages.maps.shape
        if parts is None:
            return None
        hessians = np.zeros((T + 1, k, k))
        hessians[:-1], hessians[-1, :n, :n] = parts.hessians, parts.last

        def with_end(part: Array, filled: float = 0.0) -> Array:
            return np.concatenate([part, np.full((1, *part.shape[1:]), filled)])

        model = PathModel(
            maps=with_end(stages.maps),
            offsets=with_end(stages.offsets),
            rows=with_end(stages.rows),
            limits=with_end(stages.limits, np.inf),
            roots=symmetric_roots(hessians),
            price=parts.price,
            coupled=parts.rows,
            right=parts.right,
            images=self.images,
        )
        return model, PathBounds(model, hessians)

    def path_member(self, reach: Reach) -> PathMember | None:
        """Return the path relaxation of a reach; None where ``member`` has to do."""
        found = None if self._paths is None else self._boxes(reach)
        if self._paths is None or found is None:
            return None
        pairs, low, high = found
        (T, modes), edges = reach.allowed.shape, np.count_nonzero(pairs)
        if modes > MOST_MODES and edges > MOST_EDGES * T:
            return None
        return PathMember(reach, pairs, low, high, path_program(self._paths[0], pairs, low, high))

    def _boxes(self, reach: Reach) -> tuple[Mask, Array, Array] | None:
        """Return the edges (T, modes, modes) and boxes (T+1, modes, k) of a reach; None where a box has no end."""
        taken = reach.allowed[..., None]
        unbounded = taken & ((reach.mode_lower <= -LARGEST_BOUND) | (reach.mode_upper >= LARGEST_BOUND))
        if self._paths is None or unbounded.any():
            return None
        (T, modes), (n, stages) = reach.allowed.shape, (self._n, self._stages)
        allowed = np.zeros((T + 1, modes), dtype=bool)
        allowed[:-1], allowed[-1, 0] = reach.allowed, True
        low, high = np.zeros((2, T + 1, modes, len(stages.units)))
        for part, inner, last in ((low, reach.mode_lower, reach.lower), (high, reach.mode_upper, reach.upper)):
            part[:-1] = np.where(taken, stages.scaled(inner), 0.0)
            part[-1, 0, :n] = (last[-1] - stages.last_reference) / stages.units[:n]
        if (np.abs(low) >= LARGEST_BOUND).any() or (np.abs(high) >= LARGEST_BOUND).any():
            return None
        return self._paths[0].pairs(allowed, low, high), low, high

    def later(self, duals: PathDuals) -> PathDuals:
        """Return duals moved to the time before, for a problem that begins one time later.

        What comes in at the end has the adjoint of the end before, and no other multipliers. Rows over all times keep
        what is nearest to their sum, shifted in a circle.
        """
        assert self._paths is not None
        T, all_times = len(duals.vertices), self._paths[0].coupled
        vertices, regions, images = (
            np.concatenate([part[1:], np.zeros_like(part[:1])])
            for part in (duals.vertices, duals.regions, duals.images)
        )
        vertices[T - 2 :] = duals.vertices[-1, 0]  # of x_T: at T - 1 there are now modes
        for part in (regions, images):
            part[T - 2] = part[T - 2, :, :1]
        adjoint = np.concatenate([duals.adjoint[1:], duals.adjoint[-1:]])
        if not len(duals.coupled):
            return PathDuals(vertices, regions, images, duals.coupled, adjoint, duals.eta_C)
        total = np.tensordot(duals.coupled, all_times, axes=1)
        total[:-1] = np.roll(total[:-1], -1, axis=0)
        rows = all_times.reshape(len(duals.coupled), -1)
        coupled = np.linalg.lstsq(rows.T, total.ravel(), rcond=None)[0].astype(np.float64)
        return PathDuals(vertices, regions, images, coupled, adjoint, duals.eta_C)

    def proven_by(self, reach: Reach, duals: PathDuals) -> float:
        """Return what any duals prove of a reach: as a bound on the cost, inf if that it has no trajectory."""
        found = self._boxes(reach)
        if self._paths is None or found is None:
            return -np.inf
        bound = self._paths[1].bound(*found, duals)
        if duals.eta_C:
            return self.cost(bound)
        return np.inf if bound > 0 else -np.inf

    def path_duals(self, program: PathProgram, p: Array, z: Array, w: Array | None) -> PathDuals:
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
        regions[t, i, j] = of_rows[:-1, 2 * k : -2 * n]
        images[t, i, j] = of_rows[:-1, -n:] - of_rows[:-1, -2 * n : -n]
        adjoint /= np.where(total > 0, total, 1.0)[:, None]
        return PathDuals(vertices, regions, images, p[program.vertex_rows :], adjoint, 0.0 if w is None else 1.0)

    def no_path(self) -> PathDuals:
        """Return the duals of modes that no path leads through."""
        T, modes, n, _ = self._stages.maps.shape
        parts = self._lagrangian
        return PathDuals(
            vertices=np.zeros((T, modes, n)),
            regions=np.zeros((T, modes, *self._stages.limits.shape[1:])),
            images=np.zeros((T, modes, modes, n)),
            coupled=np.zeros(0 if parts is None else len(parts.right)),
            adjoint=np.zeros((T, n)),
            eta_C=0.0,
        )

    def path_bound(self, member: PathMember, duals: PathDuals) -> float:
        """Return what duals prove: a bound on the cost; above zero, for eta_C = 0, that there is no trajectory."""
        assert self._paths is not None
        found = self._paths[1].bound(member.pairs, member.low, member.high, duals)
        return self.cost(found) if duals.eta_C else found

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

    def path_multipliers(self, duals: PathDuals) -> ModeMultipliers:
        """Return the multipliers of the duals of a path member."""
        sides = np.zeros(len(self._sides.b))
        sides[: len(duals.coupled)] = duals.coupled
        own = self._own_multipliers(sides, duals.adjoint, duals.eta_C)
        moved = duals.vertices - duals.adjoint[:, None]
        moved[-1] = 0.0  # a single vertex: its adjoint is the average
        units = self._adjoint_units
        region = duals.regions / self._stages.norms[:, :, None] / self._scaling.cost
        return ModeMultipliers(
            own, region, PathMultipliers(moved * units[:, None], duals.images * units[:, None, None])
        )

    def path_adjoint(self, duals: PathDuals) -> Array:
        """Return eta alone, (T, n)."""
        return duals.adjoint * self._adjoint_units
