"""The embedding of path relaxations, compiled as a whole: nodes of a search take some ten steps of it.

minimise cost'w subject to C w = b, G w + s = 0, s in K. With multipliers p and z, and homogeneous in tau,

    r_w = C'p + G'z + cost tau,   r_p = C w - b tau,   r_s = G w + s,   r_tau = kappa + cost'w + b'p.
"""

from __future__ import annotations

import numpy as np
from numba import types

from lin_freq_ocp.arrays import Array, Indices
from lin_freq_ocp.methods.structured.algorithm import embedding
from lin_freq_ocp.methods.structured.algorithm.embedding import FRACTION, INTERIOR, MOVED
from lin_freq_ocp.methods.structured.kkt.compiled import cones, loops, path_factors, rows
from lin_freq_ocp.methods.structured.kkt.compiled.compilation import WRITTEN, WRITTEN_INDICES, Kernels, jit
from lin_freq_ocp.methods.structured.kkt.compiled.cones import margin, product, quotient, scale, scaled, steepest
from lin_freq_ocp.methods.structured.kkt.compiled.path_factors import PathData as PathData
from lin_freq_ocp.methods.structured.kkt.compiled.path_factors import (
    PathFactors,
    band_width,
    path_factored,
    path_solved,
    slopes,
)
from lin_freq_ocp.methods.structured.kkt.compiled.rows import dot, largest, weighted

OPTIMAL, DECIDED, INFEASIBLE, STALLED = range(4)
"""How ``path_run`` ends: at the tolerance; where the cutoff decides; with a ray; without any of these."""

MOST_STEPS = 60
SHORTEST = 1e-5  # a step that makes no progress
VANISHED = 1e-2  # tau, relative to kappa, below which a ray is looked for; who uses it checks it
ROUGH = 1e-6  # dual residual at an optimum: bounds are computed from the multipliers alone
RAY = 1e-7  # residual of a ray relative to -b'p

NUMBERS = 9
TAU, KAPPA, COST, BOUND, OF_PRIMAL, OF_DUAL, OF_RAY, MU, STEPS = range(NUMBERS)
"""What is known of a point: cost and bound of (w, p)/tau, relative residuals, that of (p, z) as a ray."""

Point = tuple[Array, Array, Array, Array]
"""w (E, W), p, z, s."""

Residuals = tuple[Array, Array, Array]
"""r_w (E, W), r_p, r_s."""


@jit
def rows_applied(data: PathData, w: Array, of_p: Array, of_s: Array) -> None:
    """Add C w and G w."""
    rows, places, times, coupled, _, _, G, of_edge, _ = data
    (edges, whole, size), (q, _, a) = rows.shape, coupled.shape
    count, sums = whole - a, np.zeros(coupled.shape[1:])
    for e in range(edges):
        for r in range(whole):
            value = 0.0
            for m in range(size):
                value += rows[e, r, m] * w[e, m]
            if r >= count:
                sums[times[e], r - count] += value
            elif places[e * count + r] >= 0:
                of_p[places[e * count + r]] += value
    for r in range(q):
        for t in range(len(sums)):
            for i in range(a):
                of_p[len(of_p) - q + r] += coupled[r, t, i] * sums[t, i]
    for i in range(len(of_s)):
        value, e = 0.0, of_edge[i]
        for m in range(size):
            value += G[i, m] * w[e, m]
        of_s[i] += value


@jit
def adjoint_applied(data: PathData, p: Array, z: Array, of_w: Array) -> None:
    """Add C'p + G'z."""
    rows, places, times, coupled, _, _, G, of_edge, _ = data
    (edges, whole, size), (q, _, a) = rows.shape, coupled.shape
    count, pulled = whole - a, slopes(coupled, p, len(p) - q)
    for e in range(edges):
        for r in range(whole):
            price = 0.0
            if r >= count:
                price = pulled[times[e], r - count]
            elif places[e * count + r] >= 0:
                price = p[places[e * count + r]]
            for m in range(size):
                of_w[e, m] += rows[e, r, m] * price
    for i in range(len(z)):
        e = of_edge[i]
        for m in range(size):
            of_w[e, m] += G[i, m] * z[i]


@jit
def path_measure(data: PathData, point: Point, residuals: Residuals, numbers: Array) -> None:
    """Write the residuals of a point and the numbers beside tau, kappa and the steps."""
    (w, p, z, s), (r_w, r_p, r_s), tau = point, residuals, numbers[TAU]
    r_w[:], r_p[:], r_s[:] = 0.0, 0.0, s
    rows_applied(data, w, r_p, r_s)
    adjoint_applied(data, p, z, r_w)
    cost, bound, size_w = dot(data.cost.ravel(), w.ravel()), -dot(data.b, p), largest(w.ravel())
    ray = largest(r_w.ravel())
    numbers[OF_RAY] = ray / bound if bound > 0.0 else np.inf
    for e in range(len(w)):
        for m in range(w.shape[1]):
            r_w[e, m] += tau * data.cost[e, m]
    for i in range(len(p)):
        r_p[i] -= tau * data.b[i]
    numbers[COST], numbers[BOUND] = cost / tau, bound / tau
    numbers[OF_PRIMAL] = max(largest(r_p), largest(r_s)) / (tau + size_w)
    numbers[OF_DUAL] = largest(r_w.ravel()) / (tau * (1.0 + largest(data.cost.ravel())))
    numbers[MU] = (dot(s, z) + tau * numbers[KAPPA]) / (data.ends[0] + len(data.ends))


@jit
def ended(numbers: Array, tolerance: float, cutoff: float, several: bool, clear: tuple[float, float]) -> int:
    """Return how the run ends at a point, or -1; ``clear`` is the residual and the gap from which a cutoff decides."""
    cost, bound, residual = numbers[COST], numbers[BOUND], max(numbers[OF_PRIMAL], numbers[OF_DUAL])
    gap, size = cost - bound, max(1.0, min(abs(cost), abs(bound)))
    if numbers[OF_PRIMAL] <= tolerance and abs(gap) <= tolerance * size:
        return OPTIMAL if numbers[OF_DUAL] <= ROUGH else STALLED
    if numbers[TAU] < VANISHED * min(1.0, numbers[KAPPA]) and numbers[OF_RAY] <= RAY:
        return INFEASIBLE
    if cutoff < np.inf and residual <= clear[0] and gap >= 0.0:
        split = several and gap <= clear[1] * size and cost + gap < cutoff
        if split or bound - gap > cutoff:
            return DECIDED
    return -1


@jit
def path_directed(
    data: PathData,
    factors: PathFactors,
    scaling: tuple[Array, Array, Array],
    residuals: Residuals,
    constant: tuple[Array, Array],
    second: Array,
    numbers: tuple[float, float, float, float, float, float],
) -> tuple[Array, Array, Array, Array, Array, tuple[float, float, float]]:
    """Return dw, dp, dz, ds, W^-1 ds o W dz; dtau, dkappa, and 1/a for the longest step a.

    second: what is added to the complementarity lam o lam. numbers: sigma, sigma mu, r_tau, tau, kappa, d_kappa.
    """
    (r_w, r_p, r_s), (w, eta, lam), ends = residuals, scaling, data.ends
    sigma, centre, r_tau, tau, kappa, d_kappa = numbers
    rest, d_s = 1.0 - sigma, product(ends, lam, lam)
    for i in range(len(d_s)):
        d_s[i] += second[i]
    for i in range(ends[0]):
        d_s[i] -= centre
    for j in range(len(ends) - 1):
        d_s[ends[j]] -= centre
    moved = scaled(ends, w, eta, quotient(ends, lam, d_s), 1)
    for i in range(len(moved)):
        moved[i] = rest * r_s[i] - moved[i]
    of_w, back = -rest * r_w, scaled(ends, w, eta, moved, -2)
    for i in range(len(back)):
        for m in range(of_w.shape[1]):
            of_w[data.of_edge[i], m] -= data.G[i, m] * back[i]
    dw, dp = path_solved(data, factors, of_w, -rest * r_p)
    cost, b = data.cost.ravel(), data.b
    steepness = dot(cost, constant[0].ravel()) + dot(b, constant[1]) - kappa / tau
    dtau = (-rest * r_tau + d_kappa / tau - dot(cost, dw.ravel()) - dot(b, dp)) / steepness
    dw += dtau * constant[0]
    dp += dtau * constant[1]
    of_rows, of_p = np.zeros(len(moved)), np.zeros(len(b))
    rows_applied(data, dw, of_p, of_rows)
    dz, ds = scaled(ends, w, eta, of_rows + moved, -2), -rest * r_s - of_rows
    of_s, of_z = scaled(ends, w, eta, ds, -1), scaled(ends, w, eta, dz, 1)
    dkappa = -(d_kappa + kappa * dtau) / tau
    inverse = max(steepest(ends, lam, of_s), steepest(ends, lam, of_z), -dtau / tau, -dkappa / kappa)
    return dw, dp, dz, ds, product(ends, of_s, of_z), (dtau, dkappa, inverse)


@jit
def path_step(data: PathData, point: Point, residuals: Residuals, numbers: Array, width: int) -> float:
    """Move the point by predictor and corrector; return the length of the step."""
    (w, p, z, s), tau, kappa, ends = point, numbers[TAU], numbers[KAPPA], data.ends
    of_scaling, eta = np.empty(len(s)), np.empty(len(ends) - 1)
    scale(ends, s, z, of_scaling, eta)
    scaling = of_scaling, eta, scaled(ends, of_scaling, eta, z, 1)
    edges, size = data.cost.shape
    Phi = weighted(np.zeros((edges, size, size)), data.G, data.of_edge, ends, of_scaling, eta)
    factors = path_factored(data, Phi, width)
    constant = path_solved(data, factors, -data.cost, data.b)
    r_tau = kappa + tau * (numbers[COST] - numbers[BOUND])
    sigma, centre, d_kappa, second, a = 0.0, 0.0, kappa * tau, np.zeros(len(s)), 0.0
    for phase in range(2):
        given = sigma, centre, r_tau, tau, kappa, d_kappa
        dw, dp, dz, ds, second, found = path_directed(data, factors, scaling, residuals, constant, second, given)
        if phase == 0:
            sigma = (1 - min(1 / max(found[2], FRACTION), 1.0)) ** 3
            centre = sigma * numbers[MU]
            d_kappa += found[1] * found[0] - centre
        else:
            a = FRACTION / max(found[2], FRACTION)
            w += a * dw
            p += a * dp
            z += a * dz
            s += a * ds
            numbers[TAU], numbers[KAPPA] = tau + a * found[0], kappa + a * found[1]
    return a


@jit
def move_within(ends: Indices, unit: Array, v: Array) -> None:
    """Move v well inside the cone if it is not."""
    least, size = margin(ends, v), max(1.0, largest(v))
    if least < INTERIOR * size:
        v += (max(1.0, MOVED * size) - least) * unit


@jit
def path_begin(data: PathData, point: Point, width: int) -> None:
    """Write the first point, from the solution at W = 1."""
    (w, p, z, s), ends = point, data.ends
    edges, size = data.cost.shape
    unit, eta = np.ones(len(s)), np.ones(len(ends) - 1)
    for i in range(ends[0], len(s)):
        unit[i] = 0.0
    for j in range(len(ends) - 1):
        unit[ends[j]] = 1.0
    Phi = weighted(np.zeros((edges, size, size)), data.G, data.of_edge, ends, unit, eta)
    first = path_solved(data, path_factored(data, Phi, width), -data.cost, data.b)
    w[:], p[:], z[:], of_p = first[0], first[1], 0.0, np.zeros(len(p))
    rows_applied(data, w, of_p, z)
    s[:] = -z
    move_within(ends, unit, s)
    move_within(ends, unit, z)


@jit
def path_run(
    data: PathData,
    point: Point,
    numbers: Array,
    cold: bool,
    tolerance: float,
    cutoff: float,
    several: bool,
    clear: tuple[float, float],
) -> int:
    """Run from the first point, or from the given, until it ends; return how."""
    width = band_width(data.places, len(data.cost))
    residuals = np.empty(data.cost.shape), np.empty(len(data.b)), np.empty(len(data.G))
    if cold:
        numbers[TAU], numbers[KAPPA], numbers[STEPS] = 1.0, 1.0, 0.0
        path_begin(data, point, width)
    while numbers[STEPS] <= MOST_STEPS:
        path_measure(data, point, residuals, numbers)
        end = ended(numbers, tolerance, cutoff, several, clear)
        if end >= 0:
            return end
        if not (path_step(data, point, residuals, numbers, width) > SHORTEST and numbers[TAU] > 0.0):
            return STALLED
        numbers[STEPS] += 1
    return STALLED


_DATA = types.NamedTuple(
    (
        *(WRITTEN[3], WRITTEN_INDICES, WRITTEN_INDICES, WRITTEN[3], WRITTEN[1], WRITTEN[2], WRITTEN[2]),
        *(WRITTEN_INDICES, WRITTEN_INDICES),
    ),
    PathData,
)
_POINT = types.Tuple((WRITTEN[2], WRITTEN[1], WRITTEN[1], WRITTEN[1]))
KERNELS = Kernels(
    (__file__, path_factors.__file__, rows.__file__, cones.__file__, loops.__file__, embedding.__file__),
    (
        path_run,
        (
            *(_DATA, _POINT, WRITTEN[1], types.boolean, types.float64, types.float64, types.boolean),
            types.UniTuple(types.float64, 2),
        ),
    ),
)
