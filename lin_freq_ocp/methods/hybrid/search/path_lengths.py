"""The bound that multipliers of a path relaxation prove, compiled: a shortest path (program/hybrid/path_relaxation.py).

An edge with delta = 1 has the share w = (v, 1, epsilon), |v| <= 1, and the length

    phi = min over v of  slope'(v, 1) + |r(v)|^2 / 4,     slope = cost + C'p + (G'z of regions and images) of v and 1,

r the rows of the cone beyond the first two. Its gradient at any point bounds it from below, as it is convex.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.methods.hybrid.search.path_factors import PathData, add_adjoint
from lin_freq_ocp.methods.structured.kkt.compilation import jit
from lin_freq_ocp.methods.structured.kkt.kernels import dot

SWEEPS = 2  # of minimisation by coordinates from the point of the embedding; one is exact if the Hessian is diagonal


@jit
def path_slopes(data: PathData, p: Array, z: Array, tau: float) -> Array:
    """Return the slopes of (p, z)/tau (W, E); the last row, of epsilon, is that of a constant to be added to phi."""
    slope = tau * data.cost
    add_adjoint(data, data.rows, p, slope)
    width, first = len(slope), data.linear - len(data.shares)
    slope[width - 1] = 0.0
    for i in range(len(data.shares)):
        for m in range(width - 1):
            for e in range(slope.shape[1]):
                if data.shares[i, e] > 0.0:
                    slope[m, e] += data.G[first + i, m, e] * z[first + i, e]
    n = data.images
    for d in range(n):  # the part common to both bounds of an image counts as zero: it is the width of its box
        up, low = len(data.shares) - 2 * n + d, len(data.shares) - n + d
        for e in range(slope.shape[1]):
            of_up, of_low = data.shares[up, e], data.shares[low, e]
            if of_up > 0.0 and of_low > 0.0:
                common = min(of_up * z[first + up, e], of_low * z[first + low, e])
                sides = data.G[first + up, width - 2, e] / of_up + data.G[first + low, width - 2, e] / of_low
                slope[width - 1, e] -= common * sides
    slope /= tau
    return slope


@jit
def path_lengths(data: PathData, slope: Array, w: Array) -> Array:
    """Return phi (E,) of slopes, from the shares w on."""
    k, edges, first = len(w) - 2, w.shape[1], data.linear + 2
    G, rank = data.G, len(data.G) - first
    v, r, phi = np.empty((k, edges)), np.empty((rank, edges)), slope[k] + slope[k + 1]
    for j in range(k):
        for e in range(edges):
            v[j, e] = min(max(w[j, e] / w[k, e], -1.0), 1.0) if w[k, e] > 0.0 else 0.0
    for i in range(rank):
        r[i] = G[first + i, k]
        for j in range(k):
            for e in range(edges):
                r[i, e] += G[first + i, j, e] * v[j, e]
    gradient, curvature = np.empty(edges), np.empty(edges)
    for sweep in range(SWEEPS + 1):
        for j in range(k):
            gradient[:], curvature[:] = slope[j], 0.0
            for i in range(rank):
                for e in range(edges):
                    gradient[e] += 0.5 * G[first + i, j, e] * r[i, e]
                    curvature[e] += 0.5 * G[first + i, j, e] * G[first + i, j, e]
            for e in range(edges):
                if sweep == SWEEPS:
                    phi[e] += slope[j, e] * v[j, e] - gradient[e] * v[j, e] - abs(gradient[e])
                    continue
                most = 2.0 * curvature[e]  # a longer step would cross the whole box
                step = gradient[e] / curvature[e] if abs(gradient[e]) < most else np.sign(gradient[e]) * 2.0
                gradient[e] = min(max(v[j, e] - step, -1.0), 1.0) - v[j, e]
            if sweep < SWEEPS:
                v[j] += gradient
                for i in range(rank):
                    for e in range(edges):
                        r[i, e] += G[first + i, j, e] * gradient[e]
    for i in range(rank):
        for e in range(edges):
            phi[e] += 0.25 * r[i, e] * r[i, e]
    return phi


@jit
def shortest_path(data: PathData, phi: Array) -> float:
    """Return the least sum of lengths from t = 0 to T."""
    last, modes = data.times[len(phi) - 1], 1 + max(data.leaves.max(), data.enters.max())
    value = np.full((last + 2, modes), np.inf)
    value[last + 1] = 0.0
    for e in range(len(phi) - 1, -1, -1):
        t, i = data.times[e], data.leaves[e]
        value[t, i] = min(value[t, i], phi[e] + value[t + 1, data.enters[e]])
    return value[0].min()


@jit
def proven_path_bound(data: PathData, w: Array, p: Array, z: Array, tau: float) -> float:
    """Return the lower bound on the objective that (p, z)/tau prove."""
    phi = path_lengths(data, path_slopes(data, p, z, tau), w)
    return shortest_path(data, phi) - dot(data.b, p) / tau
