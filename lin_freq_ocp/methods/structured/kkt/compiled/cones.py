"""The cones of model/cones.py, compiled, for rows that are all present: one flat array.

Of the rows, the first ends[0] are >= 0; cone j has the rows ends[j] .. ends[j+1] - 1. Scalings are the w and eta there.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.arrays import Array, Indices
from lin_freq_ocp.methods.structured.kkt.compiled.compilation import jit
from lin_freq_ocp.methods.structured.model.cones import LEAST_SQUARE


@jit
def margin(ends: Indices, v: Array) -> float:
    """Return the distance to the boundary, negative outside."""
    least = np.inf
    for i in range(ends[0]):
        least = min(least, float(v[i]))
    for j in range(len(ends) - 1):
        least = min(least, float(v[ends[j]] - tail(v, ends[j], ends[j + 1])))
    return least


@jit
def tail(v: Array, start: int, stop: int) -> float:
    """Return |(v_1, ...)|."""
    square = 0.0
    for i in range(start + 1, stop):
        square += v[i] * v[i]
    return np.sqrt(square)


@jit
def size(v: Array, start: int, stop: int) -> float:
    """Return the root of v'Jv without the cancellation of squares."""
    rest = tail(v, start, stop)
    return np.sqrt(max((v[start] - rest) * (v[start] + rest), LEAST_SQUARE))


@jit
def scale(ends: Indices, s: Array, z: Array, w: Array, eta: Array) -> None:
    """Write the scaling of interior points."""
    for i in range(ends[0]):
        w[i] = np.sqrt(s[i] / z[i])
    for j in range(len(ends) - 1):
        start, stop = ends[j], ends[j + 1]
        of_s, of_z, product = size(s, start, stop), size(z, start, stop), 0.0
        for i in range(start, stop):
            product += s[i] * z[i]
        twice, square = 2 * np.sqrt(max((1 + product / (of_s * of_z)) / 2, 1.0)), 0.0
        for i in range(start + 1, stop):
            w[i] = (s[i] / of_s - z[i] / of_z) / twice
            square += w[i] * w[i]
        w[start], eta[j] = np.sqrt(1 + square), np.sqrt(of_s / of_z)


@jit
def scaled(ends: Indices, w: Array, eta: Array, v: Array, power: int) -> Array:
    """Return W^power v, for the powers -2, -1, 1 and 2."""
    out = np.empty(len(v))
    for i in range(ends[0]):
        factor = w[i] if power > 0 else 1 / w[i]
        out[i] = v[i] * (factor if abs(power) == 1 else factor * factor)
    for j in range(len(ends) - 1):
        start, stop = ends[j], ends[j + 1]
        factor, sign, along = eta[j] if power > 0 else 1 / eta[j], 1.0 if power > 0 else -1.0, 0.0
        for i in range(start + 1, stop):
            along += sign * w[i] * v[i]
        if abs(power) == 1:
            out[start], move = factor * (w[start] * v[start] + along), v[start] + along / (1 + w[start])
            for i in range(start + 1, stop):
                out[i] = factor * (v[i] + sign * w[i] * move)
        else:
            twice = 2 * (w[start] * v[start] + along)
            out[start] = factor * factor * (twice * w[start] - v[start])
            for i in range(start + 1, stop):
                out[i] = factor * factor * (twice * sign * w[i] + v[i])
    return out


@jit
def product(ends: Indices, a: Array, b: Array) -> Array:
    """Return the Jordan product."""
    out = np.empty(len(a))
    for i in range(ends[0]):
        out[i] = a[i] * b[i]
    for j in range(len(ends) - 1):
        head, value = ends[j], a[ends[j]] * b[ends[j]]
        for i in range(head + 1, ends[j + 1]):
            value += a[i] * b[i]
            out[i] = a[head] * b[i] + b[head] * a[i]
        out[head] = value
    return out


@jit
def quotient(ends: Indices, lam: Array, d: Array) -> Array:
    """Return the v with lam o v = d."""
    out = np.empty(len(d))
    for i in range(ends[0]):
        out[i] = d[i] / lam[i]
    for j in range(len(ends) - 1):
        head, value = ends[j], lam[ends[j]] * d[ends[j]]
        for i in range(head + 1, ends[j + 1]):
            value -= lam[i] * d[i]
        out[head] = value / size(lam, head, ends[j + 1]) ** 2
        for i in range(head + 1, ends[j + 1]):
            out[i] = (d[i] - lam[i] * out[head]) / lam[head]
    return out


@jit
def steepest(ends: Indices, lam: Array, direction: Array) -> float:
    """Return 1/a for the longest step a from lam along a scaled direction in the cone; zero if any stays in it."""
    found = 0.0
    for i in range(ends[0]):
        found = max(found, -direction[i] / lam[i])
    for j in range(len(ends) - 1):
        start, stop = ends[j], ends[j + 1]
        unit = size(lam, start, stop)
        along = lam[start] * direction[start]
        for i in range(start + 1, stop):
            along -= lam[i] * direction[i]
        along /= unit
        move, square = (along + direction[start]) / (lam[start] / unit + 1), 0.0
        for i in range(start + 1, stop):
            square += (direction[i] - move * lam[i] / unit) ** 2
        found = max(found, (np.sqrt(square) - along) / unit)
    return found
