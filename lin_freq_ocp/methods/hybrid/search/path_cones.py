"""The cones of path relaxations, compiled: rows (rows, E) of E edges side by side, which loops go through last.

The first ``linear`` rows are >= 0; the others of an edge are one second-order cone, whose scalings are w and eta there.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.methods.structured.cones import LEAST_SQUARE
from lin_freq_ocp.methods.structured.kkt.compilation import jit


@jit
def cone_inner(linear: int, a: Array, b: Array, sign: float) -> Array:
    """Return a_0 b_0 + sign (a_1 b_1 + ...) of the cone of each edge."""
    out = np.empty(a.shape[1])
    for e in range(len(out)):
        out[e] = a[linear, e] * b[linear, e]
    for i in range(linear + 1, len(a)):
        for e in range(len(out)):
            out[e] += sign * a[i, e] * b[i, e]
    return out


@jit
def cone_tails(linear: int, v: Array) -> Array:
    """Return |(v_1, ...)| of the cone of each edge."""
    out = np.zeros(v.shape[1])
    for i in range(linear + 1, len(v)):
        for e in range(len(out)):
            out[e] += v[i, e] * v[i, e]
    for e in range(len(out)):
        out[e] = np.sqrt(out[e])
    return out


@jit
def cone_sizes(linear: int, v: Array) -> Array:
    """Return the root of v'Jv of the cone of each edge, without the cancellation of squares."""
    out = cone_tails(linear, v)
    for e in range(len(out)):
        out[e] = np.sqrt(max((v[linear, e] - out[e]) * (v[linear, e] + out[e]), LEAST_SQUARE))
    return out


@jit
def cones_margin(linear: int, v: Array) -> float:
    """Return the distance to the boundary, negative outside."""
    least, tails = np.inf, cone_tails(linear, v)
    for e in range(v.shape[1]):
        for i in range(linear):
            least = min(least, v[i, e])
        least = min(least, v[linear, e] - tails[e])
    return least


@jit
def cones_scale(linear: int, s: Array, z: Array) -> tuple[Array, Array]:
    """Return the scaling w (rows, E) and eta (E,) of interior points."""
    rows, edges = s.shape
    w, eta, twice = np.empty(s.shape), np.empty(edges), cone_inner(linear, s, z, 1.0)
    for i in range(linear):
        for e in range(edges):
            w[i, e] = np.sqrt(s[i, e] / z[i, e])
    of_s, of_z = cone_sizes(linear, s), cone_sizes(linear, z)
    for e in range(edges):
        twice[e] = 2 * np.sqrt(max((1 + twice[e] / (of_s[e] * of_z[e])) / 2, 1.0))
        w[linear, e], eta[e] = 1.0, np.sqrt(of_s[e] / of_z[e])
    for i in range(linear + 1, rows):
        for e in range(edges):
            w[i, e] = (s[i, e] / of_s[e] - z[i, e] / of_z[e]) / twice[e]
            w[linear, e] += w[i, e] * w[i, e]
    for e in range(edges):
        w[linear, e] = np.sqrt(w[linear, e])
    return w, eta


@jit
def cones_scaled(linear: int, w: Array, eta: Array, v: Array, inverse: bool) -> Array:
    """Return W v, or W^-1 v."""
    rows, edges = v.shape
    out, sign = np.empty(v.shape), -1.0 if inverse else 1.0
    for i in range(linear):
        if inverse:
            for e in range(edges):
                out[i, e] = v[i, e] / w[i, e]
        else:
            for e in range(edges):
                out[i, e] = v[i, e] * w[i, e]
    head, factor, move = cone_inner(linear, w, v, sign), np.empty(edges), np.empty(edges)
    for e in range(edges):
        factor[e] = 1 / eta[e] if inverse else eta[e]
        move[e] = sign * (v[linear, e] + (head[e] - w[linear, e] * v[linear, e]) / (1 + w[linear, e]))
        out[linear, e] = factor[e] * head[e]
    for i in range(linear + 1, rows):
        for e in range(edges):
            out[i, e] = factor[e] * (v[i, e] + w[i, e] * move[e])
    return out


@jit
def cones_product(linear: int, a: Array, b: Array) -> Array:
    """Return the Jordan product."""
    out = np.empty(a.shape)
    for i in range(linear):
        for e in range(a.shape[1]):
            out[i, e] = a[i, e] * b[i, e]
    out[linear] = cone_inner(linear, a, b, 1.0)
    for i in range(linear + 1, len(a)):
        for e in range(a.shape[1]):
            out[i, e] = a[linear, e] * b[i, e] + b[linear, e] * a[i, e]
    return out


@jit
def cones_quotient(linear: int, lam: Array, d: Array) -> Array:
    """Return the v with lam o v = d."""
    out, head, sizes = np.empty(d.shape), cone_inner(linear, lam, d, -1.0), cone_sizes(linear, lam)
    for i in range(linear):
        for e in range(d.shape[1]):
            out[i, e] = d[i, e] / lam[i, e]
    for e in range(d.shape[1]):
        out[linear, e] = head[e] / (sizes[e] * sizes[e])
    for i in range(linear + 1, len(d)):
        for e in range(d.shape[1]):
            out[i, e] = (d[i, e] - lam[i, e] * out[linear, e]) / lam[linear, e]
    return out


@jit
def cones_steepest(linear: int, lam: Array, direction: Array) -> float:
    """Return 1/a for the longest step a from lam along a scaled direction in the cone; zero if any stays in it."""
    edges = lam.shape[1]
    most, units, square = np.zeros(edges), cone_sizes(linear, lam), np.zeros(edges)
    for i in range(linear):
        for e in range(edges):
            most[e] = max(most[e], -direction[i, e] / lam[i, e])
    along, move = cone_inner(linear, lam, direction, -1.0), np.empty(edges)
    for e in range(edges):
        along[e] /= units[e]
        move[e] = (along[e] + direction[linear, e]) / (lam[linear, e] / units[e] + 1) / units[e]
    for i in range(linear + 1, len(lam)):
        for e in range(edges):
            square[e] += (direction[i, e] - move[e] * lam[i, e]) ** 2
    found = 0.0
    for e in range(edges):
        found = max(found, most[e], (np.sqrt(square[e]) - along[e]) / units[e])
    return found
