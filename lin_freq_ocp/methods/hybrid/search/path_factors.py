"""Linear systems of path relaxations (program/hybrid/path_relaxation.py), compiled; the last index is that of E edges.

Edges have W variables each, and rows C of their two vertices; rows over all times act on sums of signals of edges. With
Phi = G'W^-2 G of an edge, L L' = Phi and X = [C; signals] L^-T, sums of X X' make the matrix of the multipliers: a band
of the vertices, which are numbered by time, bordered by the rows over all times.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.methods.structured.kkt.compilation import jit
from lin_freq_ocp.methods.structured.kkt.dense import PIVOT
from lin_freq_ocp.methods.structured.kkt.kernels import cholesky, cholesky_solve


class PathData(NamedTuple):
    """The arrays of a path program."""

    rows: Array  # (R + a, W, E): C, then the signals
    places: Indices  # (R, E): the numbers of the rows C, -1 where there is none
    times: Indices  # (E,)
    coupled: Array  # (q, T+1, a)
    b: Array  # (vertex rows + q,)
    cost: Array  # (W, E)
    G: Array  # (linear + cone rows, W, E)
    linear: int
    shares: Array  # (rows of regions and images, E): 1 / size, zero where a row is not present
    leaves: Indices  # (E,): the mode of the vertex that an edge leaves
    enters: Indices
    images: int  # upper rows of images, the last of the linear rows but for as many lower rows


PathFactors = tuple[Array, Array, Array, Array, Array]
"""L (W, W, E), X (R + a, W, E), the factor of the band (rows, width), the bordering rows, the factor of the Schur
complement of the band."""


@jit
def band_width(places: Indices) -> int:
    """Return the number of entries of a row of the band, with the diagonal."""
    width = 1
    for e in range(places.shape[1]):
        least, most = -1, -1
        for r in range(len(places)):
            if places[r, e] >= 0:
                least, most = places[r, e] if least < 0 else min(least, places[r, e]), max(most, places[r, e])
        width = max(width, most - least + 1)
    return width


@jit
def band_cholesky(S: Array) -> None:
    """Replace a band, S[i, j] the entry of row i and column i - width + 1 + j, by its lower factor."""
    rows, width = S.shape
    last = width - 1
    for i in range(rows):
        first, diagonal = max(0, i - last), S[i, last]
        for j in range(first, i):
            value = S[i, j - i + last]
            for m in range(first, j):
                value -= S[i, m - i + last] * S[j, m - j + last]
            value /= S[j, last]
            S[i, j - i + last] = value
        pivot = diagonal
        for m in range(first, i):
            pivot -= S[i, m - i + last] ** 2
        S[i, last] = np.sqrt(max(pivot, PIVOT * diagonal)) if diagonal > 0.0 else 1.0


@jit
def band_forward(S: Array, v: Array) -> None:
    """Replace the columns of v by L^-1 v, as far as the band goes."""
    rows, width = S.shape
    last = width - 1
    for i in range(rows):
        for m in range(max(0, i - last), i):
            factor = S[i, m - i + last]
            for c in range(v.shape[1]):
                v[i, c] -= factor * v[m, c]
        for c in range(v.shape[1]):
            v[i, c] /= S[i, last]


@jit
def band_backward(S: Array, v: Array) -> None:
    """Replace v by L^-T v, as far as the band goes."""
    rows, width = S.shape
    last = width - 1
    for i in range(rows - 1, -1, -1):
        v[i] /= S[i, last]
        for m in range(max(0, i - last), i):
            v[m] -= S[i, m - i + last] * v[i]


@jit
def edge_hessians(G: Array, linear: int, inverse: tuple[Array, Array]) -> Array:
    """Return the lower triangles of G'W^-2 G, (W, W, E), from (w, eta) of W^-1."""
    rows, size, edges = G.shape
    w, eta = inverse[0], inverse[1][0]
    out, q, weight = np.zeros((size, size, edges)), np.zeros((size, edges)), np.empty(edges)
    for i in range(rows):
        for e in range(edges):
            weight[e] = w[i, e] * w[i, e] if i < linear else eta[e] * eta[e]
        if i == linear:
            weight *= -1.0
        for a in range(size):
            if i >= linear:
                for e in range(edges):
                    q[a, e] += w[i, e] * G[i, a, e]
            for b in range(a + 1):
                for e in range(edges):
                    out[a, b, e] += weight[e] * G[i, a, e] * G[i, b, e]
    for a in range(size):
        for b in range(a + 1):
            for e in range(edges):
                out[a, b, e] += 2 * q[a, e] * q[b, e] * eta[e] * eta[e]
    return out


@jit
def factor_edges(L: Array, rows: Array) -> Array:
    """Replace Phi by its factors, and return X."""
    count, size, edges = rows.shape
    X, smallest = rows.copy(), np.empty(edges)
    for j in range(size):
        for e in range(edges):
            smallest[e] = PIVOT * L[j, j, e]
        for m in range(j):
            for e in range(edges):
                L[j, j, e] -= L[j, m, e] * L[j, m, e]
        for e in range(edges):
            L[j, j, e] = np.sqrt(max(L[j, j, e], smallest[e]))
        for i in range(j + 1, size):
            for m in range(j):
                for e in range(edges):
                    L[i, j, e] -= L[i, m, e] * L[j, m, e]
            for e in range(edges):
                L[i, j, e] /= L[j, j, e]
        for r in range(count):
            for m in range(j):
                for e in range(edges):
                    X[r, j, e] -= L[j, m, e] * X[r, m, e]
            for e in range(edges):
                X[r, j, e] /= L[j, j, e]
    return X


@jit
def factor_path(data: PathData, L: Array, width: int) -> PathFactors:
    """Return the factors; L (W, W, E) is Phi first."""
    rows, places, times, coupled, b = data.rows, data.places, data.times, data.coupled, data.b
    (whole, size, edges), q, count = rows.shape, len(coupled), len(places)
    a, vertices, last = whole - count, len(b) - q, width - 1
    X, S, value = factor_edges(L, rows), np.zeros((vertices, width)), np.empty(edges)
    border, rest, moments = np.zeros((vertices, q)), np.zeros((q, q)), np.zeros((coupled.shape[1], a, a))
    for r in range(whole):
        for c in range(r + 1):
            value[:] = 0.0
            for m in range(size):
                for e in range(edges):
                    value[e] += X[r, m, e] * X[c, m, e]
            for e in range(edges):
                i, j = places[r, e] if r < count else 0, places[c, e] if c < count else 0
                if i < 0 or j < 0:
                    continue
                if r < count:
                    S[max(i, j), last - abs(i - j)] += value[e]
                elif c >= count:
                    moments[times[e], r - count, c - count] += value[e]
                else:
                    for row in range(q):
                        border[j, row] += coupled[row, times[e], r - count] * value[e]
    band_cholesky(S)
    factor_remainder(coupled, moments, S, border, rest)
    return L, X, S, border, rest


@jit
def factor_remainder(coupled: Array, moments: Array, S: Array, border: Array, rest: Array) -> None:
    """Replace the border by L^-1 border, and write the factor of the Schur complement."""
    q, times, a = coupled.shape
    for r in range(q):
        for c in range(r + 1):
            value = 0.0
            for t in range(times):
                for i in range(a):
                    for j in range(a):
                        value += coupled[r, t, i] * moments[t, max(i, j), min(i, j)] * coupled[c, t, j]
            rest[r, c] = value
    band_forward(S, border)
    for m in range(len(border)):
        for r in range(q):
            for c in range(r + 1):
                rest[r, c] -= border[m, r] * border[m, c]
    cholesky(rest, q)


@jit
def solve_path(data: PathData, factors: PathFactors, of_w: Array, of_p: Array) -> tuple[Array, Array]:
    """Return (w, p) with Phi w + C'p = of_w (W, E), C w = of_p, C with the rows over all times."""
    (L, X, S, border, rest), q = factors, len(data.coupled)
    (_, size, edges), vertices = X.shape, len(of_p) - q
    w, v = of_w.copy(), np.empty((len(of_p), 1))
    for i in range(size):
        for m in range(i):
            for e in range(edges):
                w[i, e] -= L[i, m, e] * w[m, e]
        for e in range(edges):
            w[i, e] /= L[i, i, e]
    p = v.ravel()
    p[:] = -of_p
    add_rows(data, X, w, p)
    band_forward(S, v)
    for m in range(vertices):
        for r in range(q):
            p[vertices + r] -= border[m, r] * p[m]
    cholesky_solve(rest, q, p[vertices:])
    for m in range(vertices):
        for r in range(q):
            p[m] -= border[m, r] * p[vertices + r]
    band_backward(S, p)
    add_adjoint(data, X, -p, w)
    for i in range(size - 1, -1, -1):
        for m in range(i + 1, size):
            for e in range(edges):
                w[i, e] -= L[m, i, e] * w[m, e]
        for e in range(edges):
            w[i, e] /= L[i, i, e]
    return w, p


@jit
def add_rows(data: PathData, rows: Array, w: Array, out: Array) -> None:
    """Add the rows of vertices and over all times, with these coefficients, applied to w."""
    places, times, coupled = data.places, data.times, data.coupled
    (whole, size, edges), count, q = rows.shape, len(places), len(coupled)
    sums, value = np.zeros((coupled.shape[1], whole - count)), np.empty(edges)
    for r in range(whole):
        value[:] = 0.0
        for m in range(size):
            for e in range(edges):
                value[e] += rows[r, m, e] * w[m, e]
        for e in range(edges):
            if r >= count:
                sums[times[e], r - count] += value[e]
            elif places[r, e] >= 0:
                out[places[r, e]] += value[e]
    for r in range(q):
        for t in range(len(sums)):
            for i in range(whole - count):
                out[len(out) - q + r] += coupled[r, t, i] * sums[t, i]


@jit
def add_adjoint(data: PathData, rows: Array, p: Array, out: Array) -> None:
    """Add the adjoint of ``add_rows``."""
    places, times, coupled = data.places, data.times, data.coupled
    (whole, size, edges), count, q = rows.shape, len(places), len(coupled)
    pulled, price = np.zeros((coupled.shape[1], whole - count)), np.empty(edges)
    for r in range(q):
        for t in range(len(pulled)):
            for i in range(whole - count):
                pulled[t, i] += coupled[r, t, i] * p[len(p) - q + r]
    for r in range(whole):
        for e in range(edges):
            if r >= count:
                price[e] = pulled[times[e], r - count]
            else:
                price[e] = p[places[r, e]] if places[r, e] >= 0 else 0.0
        for m in range(size):
            for e in range(edges):
                out[m, e] += rows[r, m, e] * price[e]
