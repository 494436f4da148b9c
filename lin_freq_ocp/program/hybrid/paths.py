"""The relaxation of a mode sequence as a path, in a graph whose vertices are the modes at every time.

An edge e = (t, i, j) stands for mode i at t and j at t + 1, with weight delta_e >= 0 and share y_e of (x_t, u_t). What
comes into a vertex leaves it, weights as well as shares of the state:

    sum of delta_e over t = 0 is 1,   sum_in delta = sum_out delta,   sum_in (A_i y + B_i u + d_i delta) = sum_out x,
    y_e in delta_e (box and region of mode i at t),   A_i y + B_i u + d_i delta in delta_e (box of mode j at t + 1),
    cost of y_e in perspective;   rows over all times on the sums of y_e

(shortest paths in graphs of convex sets: Marcucci, Umenberger, Parrilo and Tedrake 2024). It is tighter than shares of
modes at each time alone (relaxation.py), as a share keeps its mode for two times. The last edge is that of x_T alone.

An edge has the variables w = (v, delta, epsilon), y = middle delta + half v, so that |v| <= delta is its box. All rows
are homogeneous: C w = b of the vertices and of rows over all times, G w + s = 0 with s >= 0 or in second-order cones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask
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
    y = _of_shares(middle, half)
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


def _of_shares(middle: Array, half: Array) -> Array:
    """Return y of w, (E, k, k+2)."""
    edges, k = middle.shape
    y = np.zeros((edges, k, k + 2))
    y[:, np.arange(k), np.arange(k)], y[..., -2] = half, middle
    return y


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
