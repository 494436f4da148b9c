"""Random linear problems of every shape, in any units: ``random_linear(seed)``.

One to six states, one to three controls, 3 to 40 steps. Dynamics have Jordan blocks at the frequencies of the DFT,
nilpotent, unstable and uncontrollable blocks, or vary in time; R may be zero or of rank one; boxes are open on some
sides, and some of what is open is written as a bound of 1e6, 1e9, 1e20 or 1e30; ends are free, partly free, intervals
or points; there are stop bands and joint rows. Most problems are built around a trajectory that satisfies them.

Every problem comes twice: in units in which its numbers are of order 1, and in units that are 1e-9 to 1e9 of those.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

import lin_freq_ocp as lfo
from helpers.random.lti import least_cost
from lin_freq_ocp.base import Array

SPOILT = 0.06
"""Share of the problems with an end moved away; most of these are infeasible."""

WORDS_FOR_NONE = (1e6, 1e9, 1e20, 1e30)
"""Bounds that stand for none, in good units."""

ROUNDING = 1e-14
"""Signals below this are zero: a mode that no control moves may have to start far away to be anywhere else."""

OVERGROWN = 1e5
"""A trajectory beyond this is not of order 1: its dynamics are replaced by damped ones."""


@dataclass(frozen=True)
class Units:
    """How large one unit is, in good units.

    Attributes
    ----------
    x : (n,), u : (m,)
        Of states and controls: x_good = x * x_units.
    cost : float
        Costs are those in good units, divided by this.
    """

    x: Array
    u: Array
    cost: float


@dataclass(frozen=True)
class Sample:
    """A problem in good units, and the same in random ones."""

    good: lfo.OptimalControlProblem
    problem: lfo.OptimalControlProblem
    units: Units


def random_linear(seed: int) -> Sample:
    """Return a convex problem with linear dynamics; feasible or not, bounded or not."""
    rng = np.random.default_rng(seed)
    n, m, T = int(rng.integers(1, 7)), int(rng.integers(1, 4)), int(rng.integers(3, 41))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lfo.errors.BandWarning)
        good = _around_trajectory(rng, n, m, T)
        good = replace(good, name=f"random linear {seed}")
        units = _units(rng, n, m)
        return Sample(good, in_units(good, units), units)


def in_units(problem: lfo.OptimalControlProblem, units: Units) -> lfo.OptimalControlProblem:
    """Return a problem of boxes, stop bands and joint rows in other units of its states, controls and costs."""
    x, u, old, cost = units.x, units.u, problem.linear, problem.quadratic
    rows = [lfo.StageRows(one.C * x, one.D * u, one.e, one.name) for one in problem.stage_rows]
    scaled = {
        "q": x,
        "p": x,
        "r": u,
        "Q": x[:, None] * x,
        "P": x[:, None] * x,
        "R": u[:, None] * u,
        "S": x[:, None] * u,
    }
    terms = {field: getattr(cost, field) * factor / units.cost for field, factor in scaled.items()}
    return replace(
        problem,
        dynamics=lfo.LinearDynamics(old.A / x[:, None] * x, old.B / x[:, None] * u, old.offset / x, old.sampling_time),
        cost=lfo.QuadraticCost(**terms, x_ref=cost.x_ref / x, u_ref=cost.u_ref / u),
        stage_rows=rows or None,
        **{field: _box_in(getattr(problem, field), x) for field in ("state_set", "initial_state", "terminal_state")},
        control_set=_box_in(problem.control_set, u),
    )


def _box_in(box: object, units: Array) -> lfo.Box | None:
    """Return a box in other units; what stands for no bound keeps its number."""
    if box is None:
        return None
    assert isinstance(box, lfo.Box)
    kept = np.abs(np.stack([box.lower, box.upper])) >= 1e20
    lower, upper = (np.where(one, side, side / units) for one, side in zip(kept, (box.lower, box.upper), strict=True))
    return lfo.Box(lower, upper)


def _units(rng: np.random.Generator, n: int, m: int) -> Units:
    decades = float(rng.choice([0.0, 3.0, 9.0]))
    x, u, cost = (10.0 ** rng.uniform(-decades, decades, size) for size in (n, m, 1))
    if rng.random() < 0.3:  # one unit for all states, and one for all controls
        x, u = np.full(n, x[0]), np.full(m, u[0])
    return Units(x, u, float(cost[0]))


def _around_trajectory(rng: np.random.Generator, n: int, m: int, T: int) -> lfo.OptimalControlProblem:
    bare, near = _with_trajectory(rng, n, m, T)
    problem = replace(
        bare,
        cost=_cost(rng, n, m, T, near),
        control_set=_box(rng, near.u, 0.8),
        state_set=_box(rng, near.x, 0.4),
        stage_rows=_rows(rng, near) if rng.random() < 0.25 else None,
    )
    kind = rng.integers(0, 6, 2)
    ends = [_end(rng, x, code, np.abs(near.x).max(0)) for x, code in zip(near.x[[0, -1]], kind, strict=True)]
    if rng.random() < SPOILT:
        away = rng.standard_normal(n) * 10.0 ** rng.uniform(-3, 1)
        ends[1] = None if ends[1] is None else lfo.Box(ends[1].lower + away, ends[1].upper + away)
    return replace(problem, initial_state=ends[0], terminal_state=ends[1])


def _with_trajectory(
    rng: np.random.Generator, n: int, m: int, T: int
) -> tuple[lfo.OptimalControlProblem, lfo.Trajectory]:
    """Return dynamics with bands, and a trajectory of order 1."""
    for damped in (False, True):
        dynamics = _dynamics(rng, n, m, T, damped)
        bare = _with_bands(lfo.OptimalControlProblem(dynamics, T, lfo.QuadraticCost(R=1.0)), rng)
        liked = lfo.QuadraticCost(
            Q=0.1, R=1.0, P=0.1, x_ref=rng.standard_normal((T + 1, n)), u_ref=rng.standard_normal((T, m))
        )
        near = least_cost(replace(bare, cost=liked))
        near = lfo.Trajectory(*(np.where(np.abs(one) < ROUNDING, 0.0, one) for one in (near.x, near.u)))
        if np.abs(near.x).max() < OVERGROWN:
            break
    return bare, near


def _dynamics(rng: np.random.Generator, n: int, m: int, T: int, damped: bool) -> lfo.LinearDynamics:
    A, B, first = np.zeros((n, n)), rng.standard_normal((n, m)), 0
    while first < n:
        block = _block(rng, n - first, T, damped)
        last = first + len(block)
        A[first:last, first:last] = block
        if rng.random() < 0.15:
            B[first:last] = 0.0  # no control reaches it
        first = last
    if rng.random() < 0.5:
        left, right = (np.linalg.qr(rng.standard_normal((n, n)))[0] for _ in range(2))
        V = left * 2.0 ** rng.uniform(-1, 1, n) @ right
        A, B = V @ A @ np.linalg.inv(V), V @ B
    if rng.random() < 0.1:
        B[:, 0] = 0.0
    if rng.random() < 0.15:
        A, B = A * rng.uniform(0.8, 1.0, (T, 1, 1)), B * rng.uniform(0.5, 1.5, (T, 1, 1))
    offset = [None, 0.1 * rng.standard_normal(n), 0.1 * rng.standard_normal((T, n))][rng.integers(3)]
    return lfo.LinearDynamics(A, B, offset, sampling_time=0.1)


def _block(rng: np.random.Generator, room: int, T: int, damped: bool) -> Array:
    """Return a real Jordan block of at most ``room`` states."""
    kind = "stable" if damped else str(rng.choice(["stable", "bin", "nilpotent", "unstable", "any"]))
    size = int(rng.integers(1, 4))
    if kind == "nilpotent":
        return np.eye(min(size, room), k=1)
    if kind == "any":
        return 0.9 * rng.standard_normal((min(size, room),) * 2)
    if kind == "bin":
        k = int(rng.integers(0, T // 2 + 1))
        angle = 2 * np.pi * k / (T + rng.integers(0, 2))
        radius, real = 1.0, k == 0 or 2 * k == T
    else:
        angle, radius = rng.uniform(0, np.pi), rng.uniform(0.1, 0.98) if kind == "stable" else rng.uniform(1, 1.3)
        real = rng.random() < 0.5
    if real or room < 2:
        count = min(size, room)
        return radius * (1 if angle < 1.5 else -1) * np.eye(count) + np.eye(count, k=1)
    count = min(size, room // 2)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.kron(np.eye(count), radius * turn) + np.kron(np.eye(count, k=1), np.eye(2))


def _with_bands(problem: lfo.OptimalControlProblem, rng: np.random.Generator) -> lfo.OptimalControlProblem:
    """Return a problem with stop bands of some controls, and now and then of a state."""
    n, m, T = problem.state_dim, problem.control_dim, problem.horizon
    makers = [
        lambda j: lfo.low_pass(rng.uniform(0.8, 3.0), component=j),
        lambda j: lfo.stop_band(bins=rng.integers(0, T // 2 + 1, size=rng.integers(1, 4)), component=j),
        lambda j: lfo.stop_band(bins=[0], component=j),
    ]
    bands = dict[str, object]()
    if rng.random() < 0.4:
        bands["control_spectrum"] = [makers[rng.integers(3)](j) for j in range(m) if rng.random() < 0.7] or None
    if rng.random() < 0.1 and T > 10:
        bands["state_spectrum"] = lfo.stop_band(bins=[int(rng.integers(0, T // 3))], component=int(rng.integers(n)))
    return replace(problem, **bands)


def _cost(rng: np.random.Generator, n: int, m: int, T: int, near: lfo.Trajectory) -> lfo.QuadraticCost:
    """Return a convex cost: Q = G G', S = G W', R = W W' + D, with D zero, of rank one or diagonal."""
    rank = int(rng.choice([0, 1, n]))
    G, W = rng.standard_normal((n, rank)), 0.5 * rng.standard_normal((m, rank)) * (rng.random() < 0.4)
    one = rng.standard_normal(m)
    D = [np.zeros((m, m)), np.outer(one, one), np.diag(rng.uniform(0.1, 1, m)), np.diag(10.0 ** rng.uniform(-4, 1, m))]
    R = W @ W.T + D[rng.choice(4, p=[0.25, 0.15, 0.4, 0.2])]
    end = rng.standard_normal((n, int(rng.choice([0, 1, n]))))
    linear = rng.random(3) < 0.35
    q = rng.standard_normal((T, n) if rng.random() < 0.3 else n) * linear[0]
    r = rng.standard_normal((T, m) if rng.random() < 0.3 else m) * linear[1]
    x_ref = rng.standard_normal((T + 1, n)) if rng.random() < 0.3 else rng.standard_normal(n) * (rng.random() < 0.3)
    u_ref = rng.standard_normal(m) * (rng.random() < 0.3)
    return lfo.QuadraticCost(
        Q=(G @ G.T + (G @ G.T).T) / 2,
        R=(R + R.T) / 2,
        S=G @ W.T,
        q=q,
        r=r,
        P=(end @ end.T + (end @ end.T).T) / 2,
        p=rng.standard_normal(n) * linear[2],
        x_ref=x_ref * max(1.0, float(np.abs(near.x).max())) ** 0.5,
        u_ref=u_ref,
    )


def _box(rng: np.random.Generator, signal: Array, share: float) -> lfo.Box | None:
    """Return bounds that the signal keeps, some just so, or None; each absent, or a word for that, in one of three."""
    if rng.random() > share:
        return None
    size = np.maximum(np.abs(signal).max(0), 1e-3)
    per_time = rng.random() < 0.25
    lowest, highest = (signal, signal) if per_time else (signal.min(0), signal.max(0))
    room = size * rng.choice([0.0, 1e-3, 0.1, 1.0], (2, *lowest.shape), p=[0.1, 0.2, 0.4, 0.3])
    bounds = np.stack([lowest - room[0], highest + room[1]])
    none = np.where(rng.random(bounds.shape) < 0.5, np.inf, rng.choice(WORDS_FOR_NONE, bounds.shape))
    absent = rng.random((2, bounds.shape[-1]) if not per_time else bounds.shape) < 1 / 3
    lower, upper = np.where(absent, np.stack([-none[0], none[1]]), bounds)
    return lfo.Box(lower, upper)


def _end(rng: np.random.Generator, x: Array, code: int, size: Array) -> lfo.Box | None:
    """Return the set of an end around x: nothing, a point, a point in some components, or intervals."""
    if code == 0:
        return None
    if code <= 2:
        return lfo.Box(x, x)
    held = rng.random((2, len(x))) < 0.5
    width = 0.0 if code <= 4 else rng.uniform(0, 0.3, (2, len(x))) * size
    if code <= 4:
        held[1] = held[0]
    width = np.where(held, width, np.inf)
    return lfo.Box(x - width[0], x + width[1])


def _rows(rng: np.random.Generator, near: lfo.Trajectory) -> lfo.StageRows:
    count, n, m = int(rng.integers(1, 4)), near.x.shape[1], near.u.shape[1]
    C = rng.standard_normal((count, n)) * (rng.random() < 0.7)
    D = rng.standard_normal((count, m))
    values = near.x[:-1] @ C.T + near.u @ D.T
    limit = values.max(0) + 0.1 * rng.random(count) * np.abs(values).max(0)
    return lfo.StageRows(C, D, limit)
