"""The cones of path relaxations, compiled: rows (rows, E) of E edges side by side.

The first ``linear`` rows are >= 0; the others of an edge are one second-order cone, whose scalings are w and eta there.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.methods.structured.kkt.compiled.compilation import jit
from lin_freq_ocp.methods.structured.model.cones import LEAST_SQUARE


@jit
def cone_size(linear: int, v: Array, e: int) -> tuple[float, float]:
    """Return the root of v'Jv of the cone of an edge, without the cancellation of squares, and |(v_1, ...)|."""
    square = 0.0
    for i in range(linear + 1, len(v)):
        square += v[i, e] * v[i, e]
    rest, head = np.sqrt(square), v[linear, e]
    return np.sqrt(max((head - rest) * (head + rest), LEAST_SQUARE)), rest


@jit
def cones_margin(linear: int, v: Array) -> float:
    """Return the distance to the boundary, negative outside."""
    least = np.inf
    for i in range(linear):
        for e in range(v.shape[1]):
            least = min(least, v[i, e])
    for e in range(v.shape[1]):
        least = min(least, v[linear, e] - cone_size(linear, v, e)[1])
    return least


@jit
def cones_scale(linear: int, s: Array, z: Array) -> tuple[Array, Array]:
    """Return the scaling w (rows, E) and eta (E,) of interior points."""
    rows, edges = s.shape
    w, eta = np.empty(s.shape), np.empty(edges)
    for i in range(linear):
        for e in range(edges):
            w[i, e] = np.sqrt(s[i, e] / z[i, e])
    for e in range(edges):
        of_s, of_z, product = cone_size(linear, s, e)[0], cone_size(linear, z, e)[0], 0.0
        for i in range(linear, rows):
            product += s[i, e] * z[i, e]
        twice, square = 2 * np.sqrt(max((1 + product / (of_s * of_z)) / 2, 1.0)), 0.0
        for i in range(linear + 1, rows):
            w[i, e] = (s[i, e] / of_s - z[i, e] / of_z) / twice
            square += w[i, e] * w[i, e]
        w[linear, e], eta[e] = np.sqrt(1 + square), np.sqrt(of_s / of_z)
    return w, eta


@jit
def cones_scaled(linear: int, w: Array, eta: Array, v: Array, inverse: bool) -> Array:
    """Return W v, or W^-1 v."""
    rows, edges = v.shape
    out = np.empty(v.shape)
    for i in range(linear):
        if inverse:
            for e in range(edges):
                out[i, e] = v[i, e] / w[i, e]
        else:
            for e in range(edges):
                out[i, e] = v[i, e] * w[i, e]
    sign = -1.0 if inverse else 1.0
    for e in range(edges):
        factor, along = 1 / eta[e] if inverse else eta[e], 0.0
        for i in range(linear + 1, rows):
            along += sign * w[i, e] * v[i, e]
        out[linear, e], move = factor * (w[linear, e] * v[linear, e] + along), v[linear, e] + along / (1 + w[linear, e])
        for i in range(linear + 1, rows):
            out[i, e] = factor * (v[i, e] + sign * w[i, e] * move)
    return out


@jit
def cones_product(linear: int, a: Array, b: Array) -> Array:
    """Return the Jordan product."""
    rows, edges = a.shape
    out = np.empty(a.shape)
    for i in range(linear):
        for e in range(edges):
            out[i, e] = a[i, e] * b[i, e]
    for e in range(edges):
        value = a[linear, e] * b[linear, e]
        for i in range(linear + 1, rows):
            value += a[i, e] * b[i, e]
            out[i, e] = a[linear, e] * b[i, e] + b[linear, e] * a[i, e]
        out[linear, e] = value
    return out


@jit
def cones_quotient(linear: int, lam: Array, d: Array) -> Array:
    """Return the v with lam o v = d."""
    rows, edges = d.shape
    out = np.empty(d.shape)
    for i in range(linear):
        for e in range(edges):
            out[i, e] = d[i, e] / lam[i, e]
    for e in range(edges):
        value = lam[linear, e] * d[linear, e]
        for i in range(linear + 1, rows):
            value -= lam[i, e] * d[i, e]
        out[linear, e] = value / cone_size(linear, lam, e)[0] ** 2
        for i in range(linear + 1, rows):
            out[i, e] = (d[i, e] - lam[i, e] * out[linear, e]) / lam[linear, e]
    return out


@jit
def cones_steepest(linear: int, lam: Array, direction: Array) -> float:
    """Return 1/a for the longest step a from lam along a scaled direction in the cone; zero if any stays in it."""
    found = 0.0
    for i in range(linear):
        for e in range(lam.shape[1]):
            found = max(found, -direction[i, e] / lam[i, e])
    for e in range(lam.shape[1]):
        unit = cone_size(linear, lam, e)[0]
        along = lam[linear, e] * direction[linear, e]
        for i in range(linear + 1, len(lam)):
            along -= lam[i, e] * direction[i, e]
        along /= unit
        move, square = (along + direction[linear, e]) / (lam[linear, e] / unit + 1), 0.0
        for i in range(linear + 1, len(lam)):
            square += (direction[i, e] - move * lam[i, e] / unit) ** 2
        found = max(found, (np.sqrt(square) - along) / unit)
    return found
