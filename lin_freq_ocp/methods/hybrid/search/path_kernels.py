"""The embedding of path relaxations, compiled as a whole: a node of a search takes some ten steps.

minimise cost'w subject to C w = b, G w + s = 0, s in K. With multipliers p and z, and homogeneous in tau,

    r_w = C'p + G'z + cost tau,   r_p = C w - b tau,   r_s = G w + s,   r_tau = kappa + cost'w + b'p.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import types
from numba.extending import overload, register_jitable

from lin_freq_ocp.base import cones
from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.methods.hybrid.search import path_factors, path_lengths
from lin_freq_ocp.methods.hybrid.search.path_factors import (
    PathData,
    PathFactors,
    add_adjoint,
    add_rows,
    band_width,
    edge_hessians,
    factor_path,
    solve_path,
)
from lin_freq_ocp.methods.hybrid.search.path_lengths import proven_path_bound
from lin_freq_ocp.methods.structured import embedding
from lin_freq_ocp.methods.structured.embedding import FRACTION, INTERIOR, MOVED
from lin_freq_ocp.methods.structured.kkt import dense, kernels
from lin_freq_ocp.methods.structured.kkt.compilation import FASTMATH, WRITTEN, WRITTEN_INDICES, Kernels, inlined, jit
from lin_freq_ocp.methods.structured.kkt.kernels import dot, largest


@overload(cones.inner, jit_options={"fastmath": FASTMATH, "error_model": "numpy"})
def sum_products(a: Array, b: Array) -> Callable[[Array, Array], Array]:
    """Return the compiled version of ``cones.inner``: loops, without an array of the products."""

    def inner(a: Array, b: Array) -> Array:
        out = np.zeros(a.shape[1])
        for i in range(len(a)):
            for e in range(len(out)):
                out[e] += a[i, e] * b[i, e]
        return out

    return inner


@overload(cones.largest, jit_options={"fastmath": FASTMATH, "error_model": "numpy"})
def compare_entries(v: Array) -> Callable[[Array], float]:
    """Return the compiled version of ``cones.largest``: first one maximum for each member, vectorised over members."""

    def largest_entry(v: Array) -> float:
        most, value = np.zeros(v.shape[1]), 0.0
        for i in range(len(v)):
            for e in range(len(most)):
                most[e] = max(most[e], v[i, e])
        for e in range(len(most)):
            value = max(value, most[e])
        return value

    return largest_entry


ALGEBRA = (
    *(cones.tail_norms, cones.determinants, cones.spectral_values, cones.product, cones.quotient),
    *(cones.compute_scaling, cones.apply_scaling, cones.steepest),
)
for function in ALGEBRA:  # compiled code may call these, which become part of it and stay what they are in Python
    register_jitable(fastmath=FASTMATH, error_model="numpy")(function)

OPTIMAL, DECIDED, INFEASIBLE, STALLED = range(4)
"""How ``run_path`` ends: at the tolerance; where the cutoff decides; with a ray; without any of these."""

MOST_STEPS = 60
SHORTEST_PATH_STEP = 1e-5  # a step that makes no progress
VANISHED_TAU = 1e-2  # tau, relative to kappa, below which a ray is tried; the search verifies it
PATH_RAY = 1e-7  # residual of a ray relative to -b'p
CLEAR_RESIDUAL = 1e-3  # of a point accurate enough to decide that a node must be split
BOUNDED_FROM = 4  # steps: the bounds of points before prove nothing of use

NUMBERS = 10
TAU, KAPPA, COST, BOUND, OF_PRIMAL, OF_DUAL, OF_RAY, MU, STEPS, PROVEN = range(NUMBERS)
"""Numbers of a point: cost and bound of (w, p)/tau, relative residuals, that of (p, z) as a ray, the bound that its
multipliers prove by a shortest path."""

Point = tuple[Array, Array, Array, Array]
"""w (W, E), p, z (rows, E), s."""

Residuals = tuple[Array, Array, Array]
"""r_w (W, E), r_p, r_s (rows, E)."""


@jit
def add_cone_rows(G: Array, w: Array, out: Array) -> None:
    """Add G w."""
    for i in range(G.shape[0]):
        for m in range(G.shape[1]):
            for e in range(G.shape[2]):
                out[i, e] += G[i, m, e] * w[m, e]


@jit
def subtract_cone_adjoint(G: Array, z: Array, out: Array) -> None:
    """Subtract G'z."""
    for i in range(G.shape[0]):
        for m in range(G.shape[1]):
            for e in range(G.shape[2]):
                out[m, e] -= G[i, m, e] * z[i, e]


@inlined
def measure_path(data: PathData, point: Point, residuals: Residuals, numbers: Array) -> None:
    """Write the residuals of a point, and all its numbers except tau, kappa and the steps."""
    (w, p, z, s), (r_w, r_p, r_s), tau = point, residuals, numbers[TAU]
    r_w[:], r_p[:], r_s[:] = 0.0, 0.0, s
    add_rows(data, data.rows, w, r_p)
    add_cone_rows(data.G, w, r_s)
    subtract_cone_adjoint(data.G, z, r_w)
    add_adjoint(data, data.rows, -p, r_w)
    r_w *= -1.0
    cost, bound, size_w = dot(data.cost.ravel(), w.ravel()), -dot(data.b, p), largest(w.ravel())
    numbers[OF_RAY] = largest(r_w.ravel()) / bound if bound > 0.0 else np.inf
    r_w += tau * data.cost
    r_p -= tau * data.b
    numbers[COST], numbers[BOUND] = cost / tau, bound / tau
    numbers[OF_PRIMAL] = max(largest(r_p), largest(r_s.ravel())) / (tau + size_w)
    numbers[OF_DUAL] = largest(r_w.ravel()) / (tau * (1.0 + largest(data.cost.ravel())))
    numbers[MU] = (dot(s.ravel(), z.ravel()) + tau * numbers[KAPPA]) / ((data.linear + 1) * w.shape[1] + 1)


@inlined
def end_of_run(numbers: Array, tolerances: tuple[float, float], cutoff: float, clear: float) -> int:
    """Return how the run ends at a point, or -1; the tolerances are those of the point and of its proven bound.

    A node must be split if the bound misses the cost by less than ``clear`` times the distance to the cutoff.
    """
    cost, proven = numbers[COST], numbers[PROVEN]
    gap, size = abs(cost - numbers[BOUND]), max(1.0, min(abs(cost), abs(proven)))
    if numbers[OF_PRIMAL] <= tolerances[0] and gap <= tolerances[0] * size and cost - proven <= tolerances[1] * size:
        return OPTIMAL
    if numbers[TAU] < VANISHED_TAU * min(1.0, numbers[KAPPA]) and numbers[OF_RAY] <= PATH_RAY:
        return INFEASIBLE
    if proven > cutoff:
        return DECIDED
    split = clear > 0.0 and cutoff < np.inf and abs(cost - proven) <= clear * (cutoff - cost)
    return DECIDED if split and numbers[OF_PRIMAL] <= CLEAR_RESIDUAL else -1


@inlined
def path_direction(
    data: PathData,
    factors: PathFactors,
    inverse: tuple[Array, Array],
    lam: Array,
    residuals: Residuals,
    scaled_rows: Array,
    constant: tuple[Array, Array],
    aim: Array,
    numbers: tuple[float, float, float, float, float],
) -> tuple[Array, Array, Array, Array, Array, tuple[float, float, float]]:
    """Return dw, dp, dz, ds, W^-1 ds o W dz; dtau, dkappa, and 1/a for the longest step a.

    inverse: (w, eta) of W^-1. scaled_rows: W^-1 r_s. aim: subtracted from lam o lam. numbers: sigma, r_tau, tau,
    kappa, d_kappa.
    """
    (r_w, r_p, r_s), (w, eta), ends = residuals, inverse, (data.linear, len(data.G))
    sigma, r_tau, tau, kappa, d_kappa = numbers
    rest = 1.0 - sigma
    shifted_rows = rest * scaled_rows - cones.quotient(ends, lam, aim)
    of_w = -rest * r_w
    subtract_cone_adjoint(data.G, cones.apply_scaling(ends, w, eta, shifted_rows), of_w)
    dw, dp = solve_path(data, factors, of_w, -rest * r_p)
    cost, b = data.cost.ravel(), data.b
    steepness = dot(cost, constant[0].ravel()) + dot(b, constant[1]) - kappa / tau
    dtau = (-rest * r_tau + d_kappa / tau - dot(cost, dw.ravel()) - dot(b, dp)) / steepness
    dw += dtau * constant[0]
    dp += dtau * constant[1]
    of_rows = np.zeros(r_s.shape)
    add_cone_rows(data.G, dw, of_rows)
    of_s = cones.apply_scaling(ends, w, eta, of_rows)
    of_z = of_s + shifted_rows
    of_s = -rest * scaled_rows - of_s
    dz, ds = cones.apply_scaling(ends, w, eta, of_z), -rest * r_s - of_rows
    dkappa = -(d_kappa + kappa * dtau) / tau
    steepest = max(cones.steepest(ends, lam, of_s), cones.steepest(ends, lam, of_z), -dtau / tau, -dkappa / kappa)
    return dw, dp, dz, ds, cones.product(ends, of_s, of_z), (dtau, dkappa, steepest)


@inlined
def take_path_step(data: PathData, point: Point, residuals: Residuals, numbers: Array, width: int) -> float:
    """Move the point by predictor and corrector; return the length of the step."""
    (w, p, z, s), tau, kappa = point, numbers[TAU], numbers[KAPPA]
    ends = data.linear, len(data.G)
    inverse = cones.compute_scaling(ends, z, s)
    lam = cones.apply_scaling(ends, inverse[0], inverse[1], s)
    scaled_rows, square = cones.apply_scaling(ends, inverse[0], inverse[1], residuals[2]), cones.product(ends, lam, lam)
    factors = factor_path(data, edge_hessians(data.G, data.linear, inverse), width)
    constant = solve_path(data, factors, -data.cost, data.b)
    r_tau = kappa + tau * (numbers[COST] - numbers[BOUND])
    sigma, d_kappa, aim, a = 0.0, kappa * tau, square, 0.0
    for phase in range(2):
        parameters = sigma, r_tau, tau, kappa, d_kappa
        dw, dp, dz, ds, second, scalars = path_direction(
            data, factors, inverse, lam, residuals, scaled_rows, constant, aim, parameters
        )
        if phase == 0:
            sigma = (1 - min(1 / max(scalars[2], FRACTION), 1.0)) ** 3
            aim = square + second
            aim[: data.linear + 1] -= sigma * numbers[MU]
            d_kappa += scalars[1] * scalars[0] - sigma * numbers[MU]
        else:
            a = FRACTION / max(scalars[2], FRACTION)
            w += a * dw
            p += a * dp
            z += a * dz
            s += a * ds
            numbers[TAU], numbers[KAPPA] = tau + a * scalars[0], kappa + a * scalars[1]
    return a


@jit
def move_within(linear: int, v: Array) -> None:
    """Move v well inside the cone if it is not."""
    least, size = cones.spectral_values((linear, len(v)), v).min(), max(1.0, largest(v.ravel()))
    if least < INTERIOR * size:
        v[: linear + 1] += max(1.0, MOVED * size) - least


@inlined
def start_path(data: PathData, point: Point, width: int) -> None:
    """Write the first point, from the solution at W = 1."""
    (w, p, z, s), linear = point, data.linear
    unit = np.zeros(s.shape)
    unit[: linear + 1] = 1.0
    factors = factor_path(data, edge_hessians(data.G, linear, (unit, np.ones((1, s.shape[1])))), width)
    first = solve_path(data, factors, -data.cost, data.b)
    w[:], p[:], z[:] = first[0], first[1], 0.0
    add_cone_rows(data.G, w, z)
    s[:] = -z
    move_within(linear, s)
    move_within(linear, z)


@jit
def run_path(
    rows: Array,
    places: Indices,
    times: Indices,
    coupled: Array,
    b: Array,
    cost: Array,
    G: Array,
    linear: int,
    shares: Array,
    leaves: Indices,
    enters: Indices,
    images: int,
    w: Array,
    p: Array,
    z: Array,
    s: Array,
    numbers: Array,
    tolerance: float,
    proven: float,
    cutoff: float,
    clear: float,
) -> int:
    """Run from the first point until it ends; return how. ``PathData``, ``Point``, and ``end_of_run``.

    Arguments are flat, as it takes numba long to look into tuples.
    """
    data = PathData(rows, places, times, coupled, b, cost, G, linear, shares, leaves, enters, images)
    point, width = (w, p, z, s), band_width(places)
    residuals = np.empty(cost.shape), np.empty(len(b)), np.empty(s.shape)
    numbers[TAU], numbers[KAPPA], numbers[STEPS], numbers[PROVEN] = 1.0, 1.0, 0.0, -np.inf
    start_path(data, point, width)
    while numbers[STEPS] <= MOST_STEPS:
        measure_path(data, point, residuals, numbers)
        if numbers[STEPS] >= BOUNDED_FROM:
            numbers[PROVEN] = proven_path_bound(data, w, p, z, numbers[TAU])
        end = end_of_run(numbers, (tolerance, proven), cutoff, clear)
        if end >= 0:
            return end
        if not (take_path_step(data, point, residuals, numbers, width) > SHORTEST_PATH_STEP and numbers[TAU] > 0.0):
            return STALLED
        numbers[STEPS] += 1
    return STALLED


_ONE, _TWO, _THREE = WRITTEN[1:]
_PLACES, _REAL = types.Array(types.intp, 2, "C"), types.float64
_DATA = (_THREE, _PLACES, WRITTEN_INDICES, _THREE, _ONE, _TWO, _THREE, types.intp)
_DATA += _TWO, WRITTEN_INDICES, WRITTEN_INDICES, types.intp
_POINT = _TWO, _ONE, _TWO, _TWO, _ONE
_SOURCES = __file__, cones.__file__, path_factors.__file__, path_lengths.__file__
_SOURCES += kernels.__file__, dense.__file__, embedding.__file__
KERNELS = Kernels(_SOURCES, (run_path, (*_DATA, *_POINT, _REAL, _REAL, _REAL, _REAL)))
