"""Products with the matrices of small problems, compiled; points are flat, as in small.py."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.arrays import Array, Indices
from lin_freq_ocp.methods.structured.kkt.compiled.compilation import jit


@jit
def dot(x: Array, y: Array) -> float:
    """Return x'y."""
    value = 0.0
    for i in range(len(x)):
        value += x[i] * y[i]
    return value


@jit
def largest(x: Array) -> float:
    """Return the largest absolute entry."""
    value = 0.0
    for i in range(len(x)):
        value = max(value, abs(x[i]))
    return value


@jit
def rows_of(A: Array, B: Array, G: Array, times: Indices, free: Indices, y: Array, out: Array) -> None:
    """Write A y but for the equations, which are left at zero."""
    stages, n, k = B.shape
    nz = n + k
    for i in range(len(out)):
        out[i] = 0.0
    for t in range(stages - 1):
        for i in range(n):
            value = y[(t + 1) * nz + i]
            for m in range(n):
                value -= A[t, i, m] * y[t * nz + m]
            for m in range(k):
                value -= B[t, i, m] * y[t * nz + n + m]
            out[t * n + i] = value
    at = stages * n
    for i in range(n):
        out[at + i] = y[i]
    for i in range(len(free)):
        out[at + free[i]] = 0.0
    for i in range(len(G)):
        value = 0.0
        for j in range(nz):
            value += G[i, j] * y[times[i] * nz + j]
        out[at + n + i] = value


@jit
def adjoint(A: Array, B: Array, G: Array, times: Indices, free: Indices, z: Array, out: Array) -> None:
    """Write A'z but for the equations."""
    stages, n, k = B.shape
    nz = n + k
    for i in range(len(out)):
        out[i] = 0.0
    for t in range(stages - 1):
        for i in range(n):
            value = z[t * n + i]
            out[(t + 1) * nz + i] += value
            for m in range(n):
                out[t * nz + m] -= A[t, i, m] * value
            for m in range(k):
                out[t * nz + n + m] -= B[t, i, m] * value
    at = stages * n
    for i in range(n):
        out[i] += z[at + i]
    for i in range(len(free)):
        out[free[i]] -= z[at + free[i]]
    for i in range(len(G)):
        for j in range(nz):
            out[times[i] * nz + j] += G[i, j] * z[at + n + i]


@jit
def add_equations(first: Indices, places: Indices, entries: Array, y: Array, start: int, out: Array) -> None:
    """Add the equations of y to out from ``start`` on."""
    for i in range(len(first) - 1):
        for e in range(first[i], first[i + 1]):
            out[start + i] += entries[e] * y[places[e]]


@jit
def add_coupled(first: Indices, places: Indices, entries: Array, z: Array, start: int, out: Array) -> None:
    """Add the adjoint of the equations, whose duals start at ``start``."""
    for i in range(len(first) - 1):
        for e in range(first[i], first[i + 1]):
            out[places[e]] += entries[e] * z[start + i]


@jit
def curvature(H: Array, y: Array, out: Array) -> None:
    """Write P y."""
    stages, nz, _ = H.shape
    for t in range(stages):
        for i in range(nz):
            value = 0.0
            for j in range(nz):
                value += H[t, i, j] * y[t * nz + j]
            out[t * nz + i] = value


@jit
def weighted(H: Array, G: Array, times: Indices, ends: Indices, w: Array, eta: Array) -> Array:
    """Return H + G'W^-2 G."""
    nz = G.shape[1]
    out, q = H.copy(), np.empty(nz)
    for i in range(ends[0]):
        t, weight = times[i], 1 / (w[i] * w[i])
        for a in range(nz):
            if G[i, a] != 0.0:
                for b in range(nz):
                    out[t, a, b] += weight * G[i, a] * G[i, b]
    for j in range(len(ends) - 1):
        head, t, weight = ends[j], times[ends[j]], 1 / (eta[j] * eta[j])
        for a in range(nz):
            q[a] = 2 * w[head] * G[head, a]
            for i in range(head, ends[j + 1]):
                q[a] -= w[i] * G[i, a]
        for a in range(nz):
            for b in range(nz):
                value = 2 * q[a] * q[b] - 2 * G[head, a] * G[head, b]
                for i in range(head, ends[j + 1]):
                    value += G[i, a] * G[i, b]
                out[t, a, b] += weight * value
    return out
