"""Random linear time-invariant problems of the whole class that the Fourier-domain method takes: ``random_lti(seed)``.

Every problem is built around trajectories that obey its dynamics and stop bands to rounding: a moderate one that gives
the ends, one that the cost would like best, and a calm one with the same ends. Bounds lie between the last two, so that
most problems are feasible with active bounds, however unstable their dynamics are; about one in five is then spoilt. Of
every fourth problem, bounds and rows are soft, at prices far below, near and far above their multipliers.
"""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

import lin_freq_ocp as lfo
from lin_freq_ocp.base import Array, Indices
from lin_freq_ocp.loop import soften
from lin_freq_ocp.program import LinearProgram

KINDS = ("stable", "marginal", "integrators", "unstable", "slow", "mixed")
# Share of the problems with an end moved away or with bounds made too tight; most of these are infeasible
SPOILT = 0.18
SOFT_EVERY = 4  # seeds per problem with soft bounds or rows
HARMLESS_GROWTH = 1e3  # open-loop growth over the horizon from which the end of the horizon must not be left to itself
FAR = 100.0  # multiple of a moderate trajectory that linear costs may ask for: integrators follow them a long way
FREE, BOXED, FIXED = 0, 1, 2  # what an end of the horizon says of one state component


def kind_of(seed: int) -> str:
    """Return the kind of dynamics of a seed."""
    return KINDS[seed % len(KINDS)]


def random_lti(seed: int) -> lfo.OptimalControlProblem:
    """Return a convex problem with linear time-invariant dynamics, bounded from below, feasible or not."""
    return with_witness(seed)[0]


def with_witness(seed: int) -> tuple[lfo.OptimalControlProblem, lfo.Trajectory | None]:
    """Return the problem, and a trajectory that satisfies its constraints to rounding; None if it was spoilt."""
    rng = np.random.default_rng(seed)
    n, m, T = int(rng.integers(1, 9)), int(rng.integers(1, 4)), int(np.exp(rng.uniform(np.log(5), np.log(401))))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lfo.errors.BandWarning)
        problem, calm = _around_trajectories(rng, kind_of(seed), n, m, T)
        problem = replace(problem, name=f"random LTI {seed}, {kind_of(seed)}")
        spoilt = rng.random() < SPOILT
        problem = _spoilt(rng, problem, calm) if spoilt else problem
        soft = _with_prices(rng, problem, calm) if seed % SOFT_EVERY == SOFT_EVERY - 1 else problem
        return soft, None if spoilt else calm


def _around_trajectories(
    rng: np.random.Generator, kind: str, n: int, m: int, T: int
) -> tuple[lfo.OptimalControlProblem, lfo.Trajectory]:
    """Return a feasible problem and its calm trajectory."""
    bare = lfo.OptimalControlProblem(random_dynamics(rng, kind, n, m, T), T, lfo.QuadraticCost(R=1.0))
    bare = _with_bands(rng, bare)
    moderate = least_cost(replace(bare, cost=_moderate_cost(rng, n, m, T)))
    codes = _end_codes(rng, bare)
    ends = [_end(rng, bare, code, x) for code, x in zip(codes, moderate.x[[0, -1]], strict=True)]
    held = [
        lfo.Box(np.where(code > FREE, x, -np.inf), np.where(code > FREE, x, np.inf))
        for code, x in zip(codes, moderate.x[[0, -1]], strict=True)
    ]
    problem = replace(bare, initial_state=held[0], terminal_state=held[1])
    cost = random_cost(rng, moderate, bounded_start=bool(np.isfinite([ends[0].lower, ends[0].upper]).all()))
    problem, liked = _asked(problem, cost, moderate)
    calm = least_cost(replace(problem, cost=_calming_cost(liked)))
    problem = _with_bounds(rng, problem, calm, liked)
    return replace(problem, initial_state=ends[0], terminal_state=ends[1]), calm


def random_dynamics(rng: np.random.Generator, kind: str, n: int, m: int, T: int) -> lfo.LinearDynamics:
    """Return dynamics with modes of a kind, in random well-conditioned or in modal coordinates, with any offset."""
    A, near_one, used = np.zeros((n, n)), 0, set[int]()
    first = 0
    while first < n:
        mode = (
            str(rng.choice(KINDS[:-1])) if kind == "mixed" else kind if first == 0 or rng.random() < 0.4 else "stable"
        )
        crowded = mode in ("integrators", "slow") and near_one >= m  # equal eigenvalues need a control each
        block = _block(rng, "stable" if crowded else mode, n - first, T, used)
        near_one += mode in ("integrators", "slow")
        A[first : first + len(block), first : first + len(block)] = block
        first += len(block)
    if rng.random() < 0.75:
        left, right = (np.linalg.qr(rng.standard_normal((n, n)))[0] for _ in range(2))
        V = left * 2.0 ** rng.uniform(-1, 1, n) @ right
        A = V @ A @ np.linalg.inv(V)
    offset = [np.zeros(n), 0.1 * rng.standard_normal(n), 0.1 * rng.standard_normal((T, n))][rng.integers(3)]
    return lfo.LinearDynamics(A, rng.standard_normal((n, m)), offset=offset, sampling_time=0.1)


def _block(rng: np.random.Generator, mode: str, room: int, T: int, used: set[int]) -> Array:
    """Return one real Jordan block of at most ``room`` states; ``used`` are the bins of marginal modes so far."""
    if mode == "integrators":
        size = min(room, int(rng.integers(1, 4)))
        return np.eye(size) + np.eye(size, k=1)
    if mode == "marginal":
        k = int(rng.integers(0, T // 2 + 1))
        single = k == 0 or 2 * k == T
        if k not in used and (single or room >= 2):
            used.add(k)
            return np.array([[1.0 if k == 0 else -1.0]]) if single else _rotation(1.0, 2 * np.pi * k / T)
        mode = "stable"
    radius = {
        "stable": rng.uniform(0.2, 0.97),
        "unstable": 1 + 0.3 * rng.uniform() ** 2,
        "slow": 1 - 10.0 ** rng.uniform(-8, -2),
    }[mode]
    if room >= 2 and rng.random() < 0.5:
        return _rotation(radius, rng.uniform(0.05, 3.1))
    return np.array([[radius if mode == "slow" else radius * rng.choice([-1, 1])]])


def _rotation(radius: float, angle: float) -> Array:
    return radius * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _with_bands(rng: np.random.Generator, problem: lfo.OptimalControlProblem) -> lfo.OptimalControlProblem:
    """Return the problem with a stop band or none per control, and with a few stopped bins of a state in one of 8."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    top = T // 2
    makers = [
        lambda j: lfo.low_pass(rng.uniform(0.5, 2.8), component=j),
        lambda j: lfo.spectrum.notch(rng.uniform(0.3, 2.8), rng.uniform(0.1, 0.6), component=j),
        lambda j: lfo.stop_band(bins=rng.integers(0, top + 1, size=rng.integers(1, 6)), component=j),
        lambda j: lfo.stop_band(bins=[0, int(rng.integers(0, top + 1))], component=j),
    ]
    bands = [makers[rng.choice(4, p=[0.35, 0.25, 0.25, 0.15])](j) for j in range(m) if rng.random() < 0.75]
    with_bands = replace(problem, control_spectrum=bands)
    if _freedom(with_bands) < n + 4:  # too few controls are left to reach anything
        with_bands = problem
    if rng.random() < 0.12 and T > 20:
        bins = rng.integers(0, T // 4, size=rng.integers(1, 4))
        both = replace(with_bands, state_spectrum=lfo.stop_band(bins=bins, component=int(rng.integers(n))))
        with_bands = both if _freedom(both) >= n + 4 else with_bands
    return with_bands


def _freedom(problem: lfo.OptimalControlProblem) -> int:
    """Return the number of real coordinates of band-limited controls, less those that state bands take."""
    T = problem.horizon
    stopped = 0
    for stop, length in ((problem.control_stop, T), (problem.state_stop, T + 1)):
        k = np.arange(len(stop))
        stopped += int((stop * np.where((k == 0) | (2 * k == length), 1, 2)[:, None]).sum())
    return T * problem.control_dim - stopped


def _end_codes(rng: np.random.Generator, problem: lfo.OptimalControlProblem) -> Indices:
    """Return FREE, BOXED or FIXED for every component of both ends, (2, n), as far as the controls can serve them."""
    n = problem.state_dim
    patterns = [(FIXED, FIXED), (FIXED, FREE), (FREE, FREE), (FIXED, BOXED), (BOXED, BOXED)]
    choice = int(rng.choice(6, p=[0.3, 0.15, 0.1, 0.15, 0.1, 0.2]))
    codes = rng.integers(0, 3, (2, n)) if choice == 5 else np.repeat(np.array(patterns[choice])[:, None], n, axis=1)
    if _growth(problem) > HARMLESS_GROWTH:
        codes[1] = np.where(codes[1] == FREE, BOXED, codes[1])
    elif _freedom(problem) < n + 2:
        codes[1] = FREE
    return codes


def _growth(problem: lfo.OptimalControlProblem) -> float:
    """Return how much the open loop amplifies over the horizon."""
    return float(np.linalg.norm(np.linalg.matrix_power(problem.linear.A, problem.horizon)))


def _end(rng: np.random.Generator, problem: lfo.OptimalControlProblem, code: Array, x: Array) -> lfo.Box:
    """Return the set of one end around x: points, intervals (some of them open to one side) and nothing."""
    width = rng.uniform(0.02, 0.3, (2, len(x))) * np.abs(x).max()
    width = np.where(code == FIXED, 0.0, np.where(code == FREE, np.inf, width))
    side, opened = rng.integers(2), rng.random(len(x)) < 0.2
    if _growth(problem) <= HARMLESS_GROWTH:
        width[side] = np.where((code == BOXED) & opened, np.inf, width[side])
    return lfo.Box(x - width[0], x + width[1])


def _moderate_cost(rng: np.random.Generator, n: int, m: int, T: int) -> lfo.QuadraticCost:
    """Return the cost of a trajectory of order 1 that goes from one random state to another."""
    start, end = rng.standard_normal((2, n))
    line = start + np.linspace(0, 1, T + 1)[:, None] * (end - start)
    return lfo.QuadraticCost(Q=1.0, R=1.0, P=1.0, x_ref=line, u_ref=0.5 * rng.standard_normal((T, m)))


def random_cost(rng: np.random.Generator, moderate: lfo.Trajectory, bounded_start: bool) -> lfo.QuadraticCost:
    """Return a convex cost with a lower bound: R positive definite, any Q and S with it, linear terms, references.

    Q = G G', S = G W', R = W W' + a positive definite matrix. If x_0 has a free component, the linear terms of the
    states lie in the range of Q and of P.
    """
    (T, m), n = moderate.u.shape, moderate.x.shape[1]
    x_size, u_size = (np.abs(signal).max() for signal in (moderate.x, moderate.u))
    rank = int(rng.choice([0, 1, n], p=[0.35, 0.25, 0.4]))
    G = 10.0 ** rng.uniform(-1.5, 0.5) * rng.standard_normal((n, rank))
    W = 0.5 * rng.standard_normal((m, rank)) * (rng.random() < 0.4)
    R = W @ W.T + np.diag(10.0 ** rng.uniform(-1, 1, m))
    if rng.random() < 0.5:
        factor = rng.standard_normal((m, m))
        R += factor @ factor.T
    end = rng.standard_normal((n, int(rng.choice([0, 1, n])))) * 10.0 ** rng.uniform(-1, 1)
    Q, P = G @ G.T, end @ end.T
    q = rng.standard_normal((T, n) if rng.random() < 0.5 else n) * (rng.random() < 0.4) * 0.3 * x_size
    p = rng.standard_normal(n) * (rng.random() < 0.3) * x_size
    r = rng.standard_normal((T, m) if rng.random() < 0.5 else m) * (rng.random() < 0.4) * u_size
    q, p = (q, p) if bounded_start else (q @ Q, P @ p)
    x_ref = rng.standard_normal((T + 1, n) if rng.random() < 0.5 else n) * (rng.random() < 0.5) * x_size
    u_ref = rng.standard_normal((T, m) if rng.random() < 0.5 else m) * (rng.random() < 0.4) * u_size
    scale = 10.0 ** rng.uniform(-2, 2)
    terms = {"Q": (Q + Q.T) / 2, "R": (R + R.T) / 2, "P": (P + P.T) / 2, "S": G @ W.T, "q": q, "r": r, "p": p}
    return lfo.QuadraticCost(**{field: scale * value for field, value in terms.items()}, x_ref=x_ref, u_ref=u_ref)


def _asked(
    problem: lfo.OptimalControlProblem, cost: lfo.QuadraticCost, moderate: lfo.Trajectory
) -> tuple[lfo.OptimalControlProblem, lfo.Trajectory]:
    """Return the problem with its cost, and what that asks for; linear terms are reduced if that is far away."""
    liked = least_cost(replace(problem, cost=cost))
    beyond = np.abs(liked.x).max() / (FAR * np.abs(moderate.x).max())
    if beyond > 1:
        reduced = {field: getattr(cost, field) / beyond for field in ("q", "r", "p", "u_ref")}
        cost = lfo.QuadraticCost(Q=cost.Q, R=cost.R, S=cost.S, P=cost.P, x_ref=cost.x_ref, **reduced)
        liked = least_cost(replace(problem, cost=cost))
    return replace(problem, cost=cost), liked


def _calming_cost(liked: lfo.Trajectory) -> lfo.QuadraticCost:
    """Return a cost that is high where a trajectory is large: its optimum has smaller peaks."""
    weights = [
        scale * (0.02 + (np.abs(signal) / np.maximum(np.abs(signal).max(0), 1e-9)) ** 4)
        for signal, scale in ((liked.x, 0.1), (liked.u, 1.0))
    ]
    x_size, u_size = (np.maximum(np.abs(signal).max(0), 1e-9) for signal in (liked.x, liked.u))
    Q, R = (weight[:, :, None] * np.diag(size**-2.0) for weight, size in zip(weights, (x_size, u_size), strict=True))
    return lfo.QuadraticCost(Q=Q[:-1], R=R, P=Q[-1])


def _with_bounds(
    rng: np.random.Generator, problem: lfo.OptimalControlProblem, calm: lfo.Trajectory, liked: lfo.Trajectory
) -> lfo.OptimalControlProblem:
    """Return the problem with bounds that hold the calm trajectory, and often not the one that the cost likes."""
    changes = {}
    if rng.random() < 0.85:
        changes["control_set"] = _box_between(rng, calm.u, liked.u)
    if rng.random() < 0.35:
        changes["state_set"] = (_box_between if rng.random() < 0.7 else _tube_around)(rng, calm.x, liked.x)
    if rng.random() < 0.2:
        rows = int(rng.integers(1, 4))
        C = rng.standard_normal((rows, problem.state_dim)) * (rng.random() < 0.8)
        D = rng.standard_normal((rows, problem.control_dim)) * (rng.random() < 0.8)
        held, wished = (one.x[:-1] @ C.T + one.u @ D.T for one in (calm, liked))
        box = (_box_between if rng.random() < 0.7 else _tube_around)(rng, held, wished, absent=0.0)
        if C.any() or D.any():
            changes["stage_rows"] = lfo.StageRows(C, D, box.upper)
    return replace(problem, **changes)


def _box_between(rng: np.random.Generator, calm: Array, liked: Array, absent: float = 0.2) -> lfo.Box:
    """Return bounds for all times that cut off a part of what ``liked`` has beyond ``calm``."""
    span = np.maximum(calm.max(0) - calm.min(0), 0.1 * np.abs(calm).max(0)) + 1e-3
    beyond = np.maximum([calm.min(0) - liked.min(0), liked.max(0) - calm.max(0)], 0.0)
    width = 10.0 ** rng.uniform(-3, -1) * span + rng.uniform(0.05, 0.9, beyond.shape) * beyond
    width = np.where(rng.random(width.shape) < absent, np.inf, width)
    return lfo.Box(calm.min(0) - width[0], calm.max(0) + width[1])


def _tube_around(rng: np.random.Generator, calm: Array, liked: Array, absent: float = 0.2) -> lfo.Box:
    """Return bounds per time around ``calm``, wide enough for a part of the way to ``liked``."""
    width = rng.uniform(0.2, 1.0, (2, calm.shape[1])) * (np.abs(liked - calm).max(0) + 0.02 * np.abs(calm).max(0))
    width = np.where(rng.random(width.shape) < absent, np.inf, width) + 1e-3
    return lfo.Box(calm - width[0], calm + width[1])


def _spoilt(
    rng: np.random.Generator, problem: lfo.OptimalControlProblem, calm: lfo.Trajectory
) -> lfo.OptimalControlProblem:
    """Return the problem with bounded controls that cannot do what the ends, or the states at two times, ask for."""
    middle, half = (calm.u.max(0) + calm.u.min(0)) / 2, (calm.u.max(0) - calm.u.min(0)) / 2 + 1e-3
    if problem.state_tube.fixed[[0, -1]].all() and rng.random() < 0.5:
        half = rng.uniform(0.1, 0.7) * half
        return replace(problem, control_set=lfo.Box(middle - half, middle + half))
    tube, T = problem.state_tube, problem.horizon
    lower, upper = tube.lower.copy(), tube.upper.copy()
    late = T if tube.fixed[-1].all() and _growth(problem) <= HARMLESS_GROWTH else int(rng.integers(1, min(20, T) + 1))
    size = np.abs(calm.x).max(0) + 1e-3
    away = rng.uniform(1, 5, len(size)) * rng.choice([-1, 1], len(size)) * size
    for t, centre in ((0, calm.x[0]), (late, calm.x[late] + away)):
        width = np.where(tube.fixed[t], 0.0, 0.1 * size)
        lower[t], upper[t] = centre - width, centre + width
    return replace(
        problem,
        control_set=lfo.Box(middle - half, middle + half),
        state_set=lfo.Box(lower, upper),
        initial_state=None,
        terminal_state=None,
    )


def _with_prices(
    rng: np.random.Generator, problem: lfo.OptimalControlProblem, calm: lfo.Trajectory
) -> lfo.OptimalControlProblem:
    """Return the problem with soft bounds or rows, two thirds of what it has, at prices from 1e-3 to 1e3."""
    level = float(np.trace(problem.quadratic.R)) / problem.control_dim * max(float(np.abs(calm.u).max()), 1e-3)
    prices = {
        field: float(level * 10.0 ** rng.uniform(-3, 3))
        for field in ("state_set", "control_set", "stage_rows")
        if getattr(problem, field) and rng.random() < 2 / 3
    }
    price = prices.pop("control_set", None)
    if price is not None:
        problem = replace(problem, control_set=lfo.sets.Soft(problem.control_tube.at(0), price))
    return soften(problem, prices)


def least_cost(problem: lfo.OptimalControlProblem) -> lfo.Trajectory:
    """Return the trajectory of least cost under the equations alone: dynamics, fixed ends and stop bands.

    Equations that depend on one another are met to rounding if they can be met: one factorisation of the proximal
    method of multipliers, and a few of its steps.
    """
    linear = LinearProgram(problem)
    program = linear.sparse
    rows = np.flatnonzero(program.equality)
    A, b = program.A[rows], program.upper[rows]
    unit = program.P.diagonal().mean()
    P, q = program.P / unit, program.q / unit
    proximal, regularisation = 1e-7 * sp.eye_array(len(q)), -1e-9 * sp.eye_array(len(rows))
    factor = splu(sp.csc_array(sp.block_array([[P + proximal, A.T], [A, regularisation]])))
    z, y = np.zeros(len(q)), np.zeros(len(rows))
    for _ in range(6):
        step = factor.solve(np.concatenate([-(P @ z + q + A.T @ y), b - A @ z]))
        z, y = z + step[: len(q)], y + step[len(q) :]
    return linear.trajectory(z)
