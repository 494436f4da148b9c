"""The three steps of the embedding of small problems, compiled: residuals, factors, and a direction.

Points are flat: y (T+1)(n+k); z holds the dynamics (T+1) n, x_0 (n), the rows of stages that are present (rows), and
the equations that couple times. The terminal ones among these also weigh in the regulator: that changes no solution.
Calls are costly to compile: functions that call others take few arguments, and are few.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types

from lin_freq_ocp.arrays import Array, Indices
from lin_freq_ocp.methods.structured.algorithm import embedding
from lin_freq_ocp.methods.structured.algorithm.embedding import FRACTION, INTERIOR, MOVED
from lin_freq_ocp.methods.structured.kkt.compiled import cones, loops, rows
from lin_freq_ocp.methods.structured.kkt.compiled.compilation import WRITTEN, WRITTEN_INDICES, Kernels, inlined, jit
from lin_freq_ocp.methods.structured.kkt.compiled.cones import margin, product, quotient, scale, scaled, steepest
from lin_freq_ocp.methods.structured.kkt.compiled.factors import cholesky, cholesky_solve
from lin_freq_ocp.methods.structured.kkt.compiled.loops import factor, solve
from lin_freq_ocp.methods.structured.kkt.compiled.rows import (
    add_coupled,
    add_equations,
    adjoint,
    curvature,
    dot,
    largest,
    rows_of,
    weighted,
)


class Data(NamedTuple):
    """The arrays of a problem."""

    A: Array  # (T+1, n, n)
    B: Array  # (T+1, n, k)
    H: Array  # (T+1, n+k, n+k)
    h: Array  # flat
    b: Array  # as z
    G: Array  # (rows, n+k)
    times: Indices  # (rows,)
    ends: Indices  # of the cones among the rows
    free: Indices  # entries of x_0
    first: Indices  # (equations + 1,): where the entries of an equation start
    places: Indices  # their places in y
    entries: Array
    weights: Array  # (equations,): those of the terminal rows in the regulator


class Numbers(NamedTuple):
    """What is measured of a point, in the order of the array that kernels write."""

    tau: float
    kappa: float
    yPy: float
    hy: float
    bz: float
    sz: float
    size_y: float  # the largest entry of y, and so on
    size_z: float
    size_Py: float
    size_Atz: float
    size_Ays: float  # A y + s
    size_f_y: float
    size_f_z: float
    left: float  # which part of f_y and f_z the step should leave


NUMBERS = len(Numbers._fields)
TAU, KAPPA, YPY, HY, BZ, SZ, SIZE_Y, SIZE_Z, SIZE_PY, SIZE_ATZ, SIZE_AYS, SIZE_FY, SIZE_FZ, LEFT = range(NUMBERS)

Factors = tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array, Array, Array]
"""K, L, A_c, P, the factor of the free block of P_0, w, eta, lam; the factor of the Schur complement of the equations,
the responses y to them, and with these eta and lam0."""


@inlined
def measure(
    data: Data, point: tuple[Array, Array, Array], residuals: tuple[Array, Array, Array], numbers: Array
) -> None:
    """Write the residuals f_y, f_z and P y of a point y, z, s, and the numbers behind tau and kappa."""
    A, B, H, h, b, G, times, _, free, first, places, entries, weights = data
    (y, z, s), (f_y, f_z, Py), tau = point, residuals, numbers[TAU]
    stop = len(b) - len(weights)
    start = stop - len(G)
    curvature(H, y, Py)
    adjoint(A, B, G, times, free, z, f_y)
    add_coupled(first, places, entries, z, stop, f_y)
    rows_of(A, B, G, times, free, y, f_z)
    add_equations(first, places, entries, y, stop, f_z)
    numbers[SZ] = 0.0
    for i in range(len(s)):
        f_z[start + i] += s[i]
        numbers[SZ] += s[i] * z[start + i]
    numbers[SIZE_ATZ], numbers[SIZE_AYS] = largest(f_y), largest(f_z)
    for i in range(len(y)):
        f_y[i] += Py[i] + tau * h[i]
    for i in range(len(b)):
        f_z[i] -= tau * b[i]
    numbers[YPY], numbers[HY], numbers[BZ] = dot(y, Py), dot(h, y), dot(b, z)
    numbers[SIZE_FY], numbers[SIZE_FZ] = largest(f_y), largest(f_z)
    numbers[SIZE_Y], numbers[SIZE_Z], numbers[SIZE_PY] = largest(y), largest(z), largest(Py)


@jit
def solved(data: Data, factors: Factors, of_y: Array, of_z: Array, y: Array, z: Array) -> None:
    """Add to (y, z) the solution of P y + A'z = of_y, A y - W^2 z = of_z."""
    A, B, _, _, _, G, times, ends, free, first, places, entries, weights = data
    K, L, Ac, P, P0, w, eta, _, schur, Y, N = factors
    stages, n, k = B.shape
    rows, count, at, nz = len(G), len(weights), (stages + 1) * n, n + k
    gradient = np.zeros((stages, nz))
    flat = gradient.ravel()
    of_rows = scaled(ends, w, eta, of_z[at : at + rows], -2)
    for i in range(len(of_y)):
        flat[i] = -of_y[i]
    for i in range(rows):
        for j in range(nz):
            flat[times[i] * nz + j] -= G[i, j] * of_rows[i]
    f = of_z[at + rows :]
    for i in range(count):
        if weights[i] > 0.0:
            flat[places[first[i]]] -= weights[i] * f[i]
    c, x0 = of_z[: stages * n].reshape((stages, n)), of_z[stages * n : at]
    y_, eta_, lam0 = solve(A, B, K, L, Ac, P, P0, free, gradient, c, x0)
    dy, deta, nu = y_.ravel(), eta_.ravel(), -f
    add_equations(first, places, entries, dy, 0, nu)
    cholesky_solve(schur, count, nu)
    for i in range(count):
        for j in range(len(dy)):
            dy[j] += nu[i] * Y[i, j]
        for j in range(stages * n):
            deta[j] += nu[i] * N[i, j]
        for j in range(n):
            lam0[j] += nu[i] * N[i, stages * n + j]
    for i in range(rows):
        of_rows[i] = -of_z[at + i]
        for j in range(nz):
            of_rows[i] += G[i, j] * dy[times[i] * nz + j]
    of_rows = scaled(ends, w, eta, of_rows, -2)
    for j in range(len(dy)):
        y[j] += dy[j]
    for j in range(stages * n):
        z[j] += deta[j]
    for j in range(n):
        z[stages * n + j] += lam0[j]
    for i in range(rows):
        z[at + i] += of_rows[i]
    for i in range(count):
        z[at + rows + i] += nu[i]
        if weights[i] > 0.0:
            z[at + rows + i] += weights[i] * (dy[places[first[i]]] - f[i])


@inlined
def subtract_product(data: Data, factors: Factors, y: Array, z: Array, of_y: Array, of_z: Array) -> None:
    """Subtract (P y + A'z, A y - W^2 z) from (of_y, of_z)."""
    A, B, H, _, _, G, times, ends, free, first, places, entries, weights = data
    start, of_rows = len(z) - len(weights) - len(G), np.empty(len(G))
    Py, Atz, Ay = np.empty(len(y)), np.empty(len(y)), np.empty(len(z))
    curvature(H, y, Py)
    adjoint(A, B, G, times, free, z, Atz)
    add_coupled(first, places, entries, z, start + len(G), Atz)
    rows_of(A, B, G, times, free, y, Ay)
    add_equations(first, places, entries, y, start + len(G), Ay)
    for i in range(len(y)):
        of_y[i] -= Py[i] + Atz[i]
    for i in range(len(z)):
        of_z[i] -= Ay[i]
    for i in range(len(G)):
        of_rows[i] = z[start + i]
    of_rows = scaled(ends, factors[5], factors[6], of_rows, 2)
    for i in range(len(G)):
        of_z[start + i] += of_rows[i]


@jit
def solution(data: Data, factors: Factors, of_y: Array, of_z: Array, refine: bool) -> tuple[Array, Array]:
    """Return (y, z) with P y + A'z = of_y, A y - W^2 z = of_z, refined twice if asked for."""
    y, z = np.zeros(len(of_y)), np.zeros(len(of_z))
    for attempt in range(3 if refine else 1):
        left_y, left_z = of_y.copy(), of_z.copy()
        if attempt > 0:
            subtract_product(data, factors, y, z, left_y, left_z)
        solved(data, factors, left_y, left_z, y, z)
    return y, z


@inlined
def factored(data: Data, s: Array, z: Array) -> Factors:
    """Return the factors at the scaling of s and z, of which only the rows of stages count."""
    A, B, H, _, b, G, times, ends, free, first, places, entries, weights = data
    stages, n, k = B.shape
    count, rows, nz = len(weights), np.empty(len(s)), n + k
    for i in range(len(s)):
        rows[i] = z[len(b) - count - len(s) + i]
    w, eta = np.empty(len(s)), np.empty(len(ends) - 1)
    scale(ends, s, rows, w, eta)
    Phi = weighted(H, G, times, ends, w, eta)
    for i in range(count):
        if weights[i] > 0.0:
            place = places[first[i]] % nz
            Phi[stages - 1, place, place] += weights[i]
    K, L, Ac, P, P0 = factor(A, B, Phi, free)
    Y, N, S = np.empty((count, len(H) * nz)), np.empty((count, (stages + 1) * n)), np.zeros((count, count))
    c, x0 = np.zeros((stages, n)), np.zeros(n)
    for j in range(count):
        gradient = np.zeros((stages, nz))
        flat = gradient.ravel()
        for e in range(first[j], first[j + 1]):
            flat[places[e]] = entries[e]
        y, deta, lam0 = solve(A, B, K, L, Ac, P, P0, free, gradient, c, x0)
        of_y, of_eta = y.ravel(), deta.ravel()
        for i in range(len(of_y)):
            Y[j, i] = of_y[i]
        for i in range(stages * n):
            N[j, i] = of_eta[i]
        for i in range(n):
            N[j, stages * n + i] = lam0[i]
        for i in range(count):
            for e in range(first[i], first[i + 1]):
                S[i, j] -= entries[e] * of_y[places[e]]
    cholesky(S, count)
    return K, L, Ac, P, P0, w, eta, scaled(ends, w, eta, rows, 1), S, Y, N


@inlined
def directed(
    data: Data,
    factors: Factors,
    residuals: tuple[Array, Array, Array],
    constant: tuple[Array, Array],
    second: Array,
    numbers: tuple[float, float, float, float, float, float, float],
    refine: bool,
) -> tuple[Array, Array, Array, Array, tuple[float, float, float]]:
    """Return dy, dz, ds, W^-1 ds o W dz; dtau, dkappa, and 1/a for the longest step a.

    residuals: f_y, f_z, P y. second: what is added to the complementarity lam o lam. numbers: sigma, sigma mu, f_tau,
    y'P y, tau, kappa, d_kappa.
    """
    h, b, G, ends = data.h, data.b, data.G, data.ends
    start = len(b) - len(data.weights) - len(G)
    sigma, centre, f_tau, yPy, tau, kappa, d_kappa = numbers
    w, eta, lam = factors[5], factors[6], factors[7]
    (f_y, f_z, Py), rest = residuals, 1 - sigma
    d_s = product(ends, lam, lam)
    for i in range(len(d_s)):
        d_s[i] += second[i]
    for i in range(ends[0]):
        d_s[i] -= centre
    for j in range(len(ends) - 1):
        d_s[ends[j]] -= centre
    moved = scaled(ends, w, eta, quotient(ends, lam, d_s), 1)
    of_y, of_z, slope = np.empty(len(h)), np.empty(len(b)), np.empty(len(h))
    for i in range(len(h)):
        of_y[i], slope[i] = -rest * f_y[i], h[i] + 2 * Py[i] / tau
    for i in range(len(b)):
        of_z[i] = -rest * f_z[i]
    for i in range(len(moved)):
        of_z[start + i] += moved[i]
    y, z = solution(data, factors, of_y, of_z, refine)
    steepness = dot(slope, constant[0]) + dot(b, constant[1]) - yPy / tau**2 - kappa / tau
    dtau = (-rest * f_tau + d_kappa / tau - dot(slope, y) - dot(b, z)) / steepness
    for i in range(len(y)):
        y[i] += dtau * constant[0][i]
    for i in range(len(z)):
        z[i] += dtau * constant[1][i]
    s, of_rows = np.empty(len(G)), np.empty(len(G))
    for i in range(len(G)):
        s[i], of_rows[i] = dtau * b[start + i] - rest * f_z[start + i], z[start + i]
        for j in range(G.shape[1]):
            s[i] -= G[i, j] * y[data.times[i] * G.shape[1] + j]
    of_s, of_rows = scaled(ends, w, eta, s, -1), scaled(ends, w, eta, of_rows, 1)
    dkappa = -(d_kappa + kappa * dtau) / tau
    inverse = max(steepest(ends, lam, of_s), steepest(ends, lam, of_rows), -dtau / tau, -dkappa / kappa)
    return y, z, s, product(ends, of_s, of_rows), (dtau, dkappa, inverse)


@jit
def move_inside(ends: Indices, v: Array, start: int) -> None:
    """Move the rows of v from ``start`` on into the cone if they are not well inside."""
    rows = np.empty(ends[-1])
    for i in range(len(rows)):
        rows[i] = v[start + i]
    least, size = margin(ends, rows), max(1.0, largest(rows))
    if least < INTERIOR * size:
        move = max(1.0, MOVED * largest(rows)) - least
        for i in range(ends[0]):
            v[start + i] += move
        for j in range(len(ends) - 1):
            v[start + ends[j]] += move


@inlined
def begin(data: Data, constant: tuple[Array, Array], point: tuple[Array, Array, Array]) -> None:
    """Write the first point, from the solution at W = 1."""
    (y, z, s), start = point, len(data.b) - len(data.weights) - len(data.G)
    for i in range(len(y)):
        y[i] = constant[0][i]
    for i in range(len(z)):
        z[i] = constant[1][i]
    for i in range(len(s)):
        s[i] = -z[start + i]
    move_inside(data.ends, s, 0)
    move_inside(data.ends, z, start)


@inlined
def step(
    data: Data,
    factors: Factors,
    constant: tuple[Array, Array],
    point: tuple[Array, Array, Array],
    residuals: tuple[Array, Array, Array],
    numbers: Array,
    refine: bool,
) -> None:
    """Move the point by predictor and corrector."""
    y, z, s = point
    tau, kappa = numbers[TAU], numbers[KAPPA]
    f_tau = numbers[HY] + numbers[BZ] + kappa + numbers[YPY] / tau
    mu = (numbers[SZ] + tau * kappa) / (data.ends[0] + len(data.ends))
    sigma, centre, d_kappa, second = 0.0, 0.0, kappa * tau, np.zeros(len(s))
    for phase in range(2):
        given = sigma, centre, f_tau, numbers[YPY], tau, kappa, d_kappa
        dy, dz, ds, second, ends = directed(data, factors, residuals, constant, second, given, refine)
        if phase == 0:
            sigma = (1 - min(1 / max(ends[2], FRACTION), 1.0)) ** 3
            centre = sigma * mu
            d_kappa += ends[1] * ends[0] - centre
        else:
            a = FRACTION / max(ends[2], FRACTION)
            for i in range(len(y)):
                y[i] += a * dy[i]
            for i in range(len(z)):
                z[i] += a * dz[i]
            for i in range(len(s)):
                s[i] += a * ds[i]
            numbers[TAU], numbers[KAPPA], numbers[LEFT] = tau + a * ends[0], kappa + a * ends[1], 1 - a * (1 - sigma)


@jit
def advance(
    data: Data,
    point: tuple[Array, Array, Array],
    residuals: tuple[Array, Array, Array],
    numbers: Array,
    cold: bool,
    refine: bool,
) -> None:
    """Write the first point, or take a step, and measure the point."""
    _, z, s = point
    factors = factored(data, s, z)
    constant = solution(data, factors, -data.h, data.b, refine)
    if cold:
        begin(data, constant, point)
    else:
        step(data, factors, constant, point, residuals, numbers, refine)
    measure(data, point, residuals, numbers)


_POINT = types.UniTuple(WRITTEN[1], 3)
KERNELS = Kernels(
    (__file__, rows.__file__, cones.__file__, loops.__file__, embedding.__file__),
    (
        advance,
        (
            types.NamedTuple(
                (*WRITTEN[3:] * 3, *WRITTEN[1:2] * 2, WRITTEN[2], *[WRITTEN_INDICES] * 5, *WRITTEN[1:2] * 2), Data
            ),
            *(_POINT, _POINT, WRITTEN[1], types.boolean, types.boolean),
        ),
    ),
)
