"""Linear systems of path relaxations (transcription/modes/paths.py), compiled.

Edges have W variables each, and rows C of their two vertices; rows over all times act on sums of signals of edges. With
Phi = G'W^-2 G of an edge, L L' = Phi and X = [C; signals] L^-T, sums of X X' make the matrix of the multipliers: a band
of the vertices, which are numbered by time, bordered by the rows over all times.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lin_freq_ocp.arrays import Array, Indices
from lin_freq_ocp.methods.structured.kkt.compiled.compilation import jit
from lin_freq_ocp.methods.structured.kkt.compiled.loops import PIVOT, cholesky, cholesky_solve


class PathData(NamedTuple):
    """The arrays of a path program."""

    rows: Array  # (E, R + a, W): C, then the signals
    places: Indices  # (E * R,): the numbers of the rows C, -1 where there is none
    times: Indices  # (E,)
    coupled: Array  # (q, T+1, a)
    b: Array  # (vertex rows + q,)
    cost: Array  # (E, W)
    G: Array  # (rows, W)
    of_edge: Indices
    ends: Indices  # of the cones among the rows


PathFactors = tuple[Array, Array, Array, Array, Array]
"""L (E, W, W), X (E, R + a, W), the factor of the band (rows, width), the border beyond it, the factor of the rest."""


@jit
def band_width(places: Indices, edges: int) -> int:
    """Return how many entries a row of the band has, its diagonal included."""
    count, width = len(places) // edges, 1
    for e in range(edges):
        least, most = -1, -1
        for r in range(count):
            place = places[e * count + r]
            if place >= 0:
                least, most = place if least < 0 else min(least, place), max(most, place)
        width = max(width, most - least + 1)
    return width


@jit
def band_cholesky(S: Array) -> None:
    """Replace a band, S[i, j] the entry of row i and column i - width + 1 + j, by its lower factor."""
    rows, width = S.shape
    last = width - 1
    for i in range(rows):
        first, own = max(0, i - last), S[i, last]
        for j in range(first, i):
            value = S[i, j - i + last]
            for m in range(first, j):
                value -= S[i, m - i + last] * S[j, m - j + last]
            value /= S[j, last]
            S[i, j - i + last] = value
        pivot = own
        for m in range(first, i):
            pivot -= S[i, m - i + last] ** 2
        S[i, last] = np.sqrt(max(pivot, PIVOT * own)) if own > 0.0 else 1.0


@jit
def band_forward(S: Array, v: Array, at: int) -> None:
    """Replace row ``at`` of v by L^-1 v, as far as the band goes."""
    rows, width = S.shape
    last = width - 1
    for i in range(rows):
        value = v[at, i]
        for m in range(max(0, i - last), i):
            value -= S[i, m - i + last] * v[at, m]
        v[at, i] = value / S[i, last]


@jit
def band_backward(S: Array, v: Array, at: int) -> None:
    """Replace row ``at`` of v by L^-T v, as far as the band goes."""
    rows, width = S.shape
    last = width - 1
    for i in range(rows - 1, -1, -1):
        value = v[at, i] / S[i, last]
        v[at, i] = value
        for m in range(max(0, i - last), i):
            v[at, m] -= S[i, m - i + last] * value


@jit
def edge_factored(rows: Array, L: Array, X: Array, e: int) -> None:
    """Replace Phi of an edge by its factor, and write X."""
    _, count, size = X.shape
    cholesky(L[e], size)
    for r in range(count):
        for i in range(size):
            value = rows[e, r, i]
            for m in range(i):
                value -= L[e, i, m] * X[e, r, m]
            X[e, r, i] = value / L[e, i, i]


@jit
def path_factored(data: PathData, L: Array, width: int) -> PathFactors:
    """Return the factors; L (E, W, W) is Phi first."""
    rows, places, times, coupled, b, _, _, _, _ = data
    (edges, whole, size), (q, _, a) = rows.shape, coupled.shape
    count, vertices, last = whole - a, len(b) - q, width - 1
    X, S = np.empty((edges, whole, size)), np.zeros((vertices, width))
    border, rest, moments = np.zeros((q, vertices)), np.zeros((q, q)), np.zeros((coupled.shape[1], a, a))
    for e in range(edges):
        edge_factored(rows, L, X, e)
        t = times[e]
        for r in range(whole):
            i = places[e * count + r] if r < count else 0
            if i < 0:
                continue
            for c in range(r + 1):
                j = places[e * count + c] if c < count else 0
                if j < 0:
                    continue
                value = 0.0
                for m in range(size):
                    value += X[e, r, m] * X[e, c, m]
                if r < count:
                    S[max(i, j), last - abs(i - j)] += value
                elif c >= count:
                    moments[t, r - count, c - count] += value
                else:
                    for row in range(q):
                        border[row, j] += coupled[row, t, r - count] * value
    band_cholesky(S)
    rest_factored(coupled, moments, S, border, rest)
    return L, X, S, border, rest


@jit
def rest_factored(coupled: Array, moments: Array, S: Array, border: Array, rest: Array) -> None:
    """Replace the border by L^-1 border, and write the factor of what is left."""
    q, times, a = coupled.shape
    for r in range(q):
        for c in range(r + 1):
            value = 0.0
            for t in range(times):
                for i in range(a):
                    for j in range(a):
                        value += coupled[r, t, i] * moments[t, max(i, j), min(i, j)] * coupled[c, t, j]
            rest[r, c] = value
    for r in range(q):
        band_forward(S, border, r)
        for c in range(r + 1):
            value = 0.0
            for m in range(border.shape[1]):
                value += border[r, m] * border[c, m]
            rest[r, c] -= value
    cholesky(rest, q)


@jit
def path_solved(data: PathData, factors: PathFactors, of_w: Array, of_p: Array) -> tuple[Array, Array]:
    """Return (w, p) with Phi w + C'p = of_w (E, W), C w = of_p, C with the rows over all times."""
    places, times, coupled = data.places, data.times, data.coupled
    L, X, S, border, rest = factors
    (edges, whole, size), (q, _, a) = X.shape, coupled.shape
    count, w, v, sums = whole - a, of_w.copy(), np.empty((1, len(of_p))), np.zeros(coupled.shape[1:])
    vertices = len(of_p) - q
    for i in range(len(of_p)):
        v[0, i] = -of_p[i]
    for e in range(edges):
        for i in range(size):
            value = w[e, i]
            for m in range(i):
                value -= L[e, i, m] * w[e, m]
            w[e, i] = value / L[e, i, i]
        for r in range(whole):
            value = 0.0
            for m in range(size):
                value += X[e, r, m] * w[e, m]
            if r >= count:
                sums[times[e], r - count] += value
            elif places[e * count + r] >= 0:
                v[0, places[e * count + r]] += value
    band_forward(S, v, 0)
    p = v[0]
    for r in range(q):
        value = 0.0
        for t in range(len(sums)):
            for i in range(a):
                value += coupled[r, t, i] * sums[t, i]
        for m in range(vertices):
            value -= border[r, m] * p[m]
        p[vertices + r] += value
    cholesky_solve(rest, q, p[vertices:])
    for r in range(q):
        for m in range(vertices):
            p[m] -= border[r, m] * p[vertices + r]
    band_backward(S, v, 0)
    pulled = slopes(coupled, p, vertices)
    for e in range(edges):
        for r in range(whole):
            price = 0.0
            if r >= count:
                price = pulled[times[e], r - count]
            elif places[e * count + r] >= 0:
                price = p[places[e * count + r]]
            for m in range(size):
                w[e, m] -= X[e, r, m] * price
        for i in range(size - 1, -1, -1):
            value = w[e, i]
            for m in range(i + 1, size):
                value -= L[e, m, i] * w[e, m]
            w[e, i] = value / L[e, i, i]
    return w, p


@jit
def slopes(coupled: Array, p: Array, start: int) -> Array:
    """Return what multipliers of the rows over all times add to the slopes of signals, (T+1, a)."""
    q, times, a = coupled.shape
    found = np.zeros((times, max(a, 1)))
    for t in range(times):
        for i in range(a):
            for r in range(q):
                found[t, i] += coupled[r, t, i] * p[start + r]
    return found
