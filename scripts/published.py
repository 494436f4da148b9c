"""Compare printed values with proven intervals: docs/published.md.

python scripts/published.py [NAME ...] [--write] [--proofs FOLDER]

Each row states a problem of a source in our words and compares the printed value with an interval that contains the
optimum. The interval is that of a proof that the checker has verified, where the format states it, else that of the
judge. A printed value is *confirmed* if the interval, or the half unit of its last digit around it, meets the other;
else it is *corrected*, with a reason. Without a reason it is unexplained, and the exit status is 1.

The second way: the objective by the source's own formula, from the trajectory alone, has to lie in the interval too.
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.optimize import linprog, nnls

import lin_freq_ocp as lfo
from lin_freq_ocp.comparison.shapers import Modes, eigenvalues_of, known_shaper
from lin_freq_ocp.errors import UnsupportedError

PAGE = Path(__file__).parents[1] / "docs" / "published.md"
APART = 0.0314159  # rad between switches of the published patterns
ROUNDED = 1e-12  # relative error of an exact map of a step, which is computed, and of Gauss's rule
AGREES = 1e-11  # relative difference of two ways to compute an objective: far below the last digit that is printed


@dataclass(frozen=True)
class Found:
    """An interval that contains the value, the value in the second way, and how it is proven."""

    low: float
    high: float
    again: float | None
    proof: str


@dataclass(frozen=True)
class Row:
    """A printed value, where it is printed, and how it is computed here."""

    name: str
    source: str
    statement: str
    printed: str
    find: Callable[[Path | None, str], Found]
    reason: str = ""  # why the printed value differs, if it does
    side: str = "optimum"  # what is printed: the "optimum", or a bound "below" or "above" it


def verdict(row: Row, found: Found) -> str:
    """Return "confirmed", "corrected" or "unexplained"."""
    number = Decimal(row.printed)
    digits = number.as_tuple().exponent
    assert isinstance(digits, int)
    half = 0.5 * 10.0**digits * (1 + 1e-6)  # the last digit is rounded
    value = float(number)
    low, high = {
        "optimum": (found.low, found.high),
        "below": (-math.inf, found.low),  # a printed bound has to hold for all of the interval
        "above": (found.high, math.inf),
    }[row.side]
    agrees = low - half <= value <= high + half
    return "confirmed" if agrees else "corrected" if row.reason else "unexplained"


def proven(
    problem: lfo.OptimalControlProblem,
    formula: Callable[[np.ndarray, np.ndarray], float],
    constant: float,
    folder: Path | None,
    name: str,
) -> Found:
    """Return the interval of an optimum less a constant of the statement, and the source's formula on the optimum."""
    result = lfo.solve(problem)
    assert result.trajectory is not None
    again = formula(result.trajectory.x, result.trajectory.u)
    if problem.control_set is None:
        value = riccati(problem) - constant
        assert abs(value - again) <= AGREES * abs(value)
    try:
        interval = result.enclosure
        low, high, proof = interval.lower, interval.upper, "verified"
        if folder is not None:
            result.write_proof(folder / f"{name}.proof")
    except UnsupportedError:
        assert result.lower_bound is not None
        assert result.cost is not None
        low, high, proof = result.lower_bound, result.cost, "judge"
    return Found(low - constant, high - constant, again, proof)


def riccati(problem: lfo.OptimalControlProblem) -> float:
    """Return the optimal cost from a given start without limits, by the recursion backwards in time."""
    A, B, _ = problem.linear.at(0)
    cost, start = problem.quadratic, problem.initial_state
    assert isinstance(start, lfo.Box)
    x = start.lower
    P = cost.P
    for _ in range(problem.horizon):
        mixed = cost.S.T + B.T @ P @ A if cost.S.shape == (len(A), B.shape[1]) else cost.S + B.T @ P @ A
        P = cost.Q + A.T @ P @ A - mixed.T @ np.linalg.solve(cost.R + B.T @ P @ B, mixed)
    return float(x @ P @ x) / 2


def mpt3_control(t: int, folder: Path | None, name: str) -> Found:
    """Bound a control of the regulator: J rises by at least (u - u*)^2 from the optimum, as R = 2."""
    result = lfo.solve(regulator())
    assert result.cost is not None
    radius = math.sqrt(max(result.cost, result.enclosure.upper) - result.enclosure.lower)
    assert result.control is not None
    u = float(result.control[t, 0])
    return Found(u - radius, u + radius, None, "judge")


def mpt3(folder: Path | None, name: str) -> Found:
    """Solve the regulator; stages 0 .. 4 of the state and 0 .. 3 of the control."""
    return proven(regulator(), lambda x, u: float((x**2).sum() + (u**2).sum()), 0.0, folder, name)


def regulator() -> lfo.OptimalControlProblem:
    """Return the regulator of MPT3."""
    two = 2 * np.eye(2)
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1, 1], [0, 1]], [[1], [0.5]]),
        4,
        lfo.QuadraticCost(Q=two, R=2.0, P=two),
        lfo.Box(-1, 1),
        lfo.Box([-5, -5], [5, 5]),
        initial_state=[4, 0],
    )


def dtoc3(N: int, folder: Path | None, name: str) -> Found:
    """Solve for periods 1 .. N; the state of period 1 has no cost."""
    S = 1 / N
    weight = S * np.diag([2.0, 1.0])
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1, S], [-S, 1]], [[0], [S]]),
        N - 1,
        lfo.QuadraticCost(Q=weight, R=6 * S, P=weight),
        initial_state=[15, 5],
    )
    first = S / 2 * (2 * 15**2 + 5**2)

    def formula(x: np.ndarray, u: np.ndarray) -> float:
        return math.fsum((S / 2 * (2 * x[1:, 0] ** 2 + x[1:, 1] ** 2 + 6 * u[:, 0] ** 2)).tolist())

    return proven(problem, formula, first, folder, name)


def hager1(N: int, folder: Path | None, name: str) -> Found:
    """Solve with the trapezoidal rule, in the form of the next state."""
    h = 1 / N
    dynamics = lfo.LinearDynamics([[(1 + h / 2) / (1 - h / 2)]], [[h / (1 - h / 2)]])
    problem = lfo.OptimalControlProblem(dynamics, N, lfo.QuadraticCost(R=h, P=1.0), initial_state=[1])

    def formula(x: np.ndarray, u: np.ndarray) -> float:
        return float(x[-1, 0] ** 2 / 2 + h / 2 * (u**2).sum())

    return proven(problem, formula, 0.0, folder, name)


def hager2(N: int, folder: Path | None, name: str) -> Found:
    """Weigh both states of a step, with the next one as a x + b u."""
    h = 1 / N
    a, b, w = (1 + h / 4) / (1 - h / 4), h / (1 - h / 4), h / 6
    cost = lfo.QuadraticCost(Q=[[2 * w * (1 + a + a * a)]], S=[[w * (b + 2 * a * b)]], R=[[2 * w * b * b + h / 2]])
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics([[a]], [[b]]), N, cost, initial_state=[1])

    def formula(x: np.ndarray, u: np.ndarray) -> float:
        before, after = x[:-1, 0], x[1:, 0]
        return float((h / 6 * (after**2 + after * before + before**2) + h / 4 * u[:, 0] ** 2).sum())

    return proven(problem, formula, 0.0, folder, name)


def hager3(N: int, folder: Path | None, name: str) -> Found:
    """Weigh the state and its product with the control, with the next state as a x + b u."""
    h = 1 / N
    a, b, w = (1 + h / 4) / (1 - h / 4), h / (1 - h / 4), 0.625 * h / 8
    cost = lfo.QuadraticCost(
        Q=[[2 * w * (1 + a + a * a)]],
        S=[[w * b * (1 + 2 * a) + h / 8 * (1 + a)]],
        R=[[2 * (w * b * b + h / 8 * b + h / 4)]],
    )
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics([[a]], [[b]]), N, cost, initial_state=[1])

    def formula(x: np.ndarray, u: np.ndarray) -> float:
        before, after = x[:-1, 0], x[1:, 0]
        squares = 0.625 * (before**2 + before * after + after**2)
        return math.fsum((h / 8 * (squares + (before + after) * u[:, 0]) + h / 4 * u[:, 0] ** 2).tolist())

    return proven(problem, formula, 0.0, folder, name)


def hager4(N: int, folder: Path | None, name: str) -> Found:
    """Weigh each step by the file's integrals of exp(-2 t) (1, t, t^2), and limit the control."""
    h, e = 1 / N, math.e
    t = h * np.arange(N + 1)
    first = -0.5 * np.exp(-2 * t[:2])
    half = t[:2] + 0.5
    D, E, F = (
        float(np.diff(first * factor)[0]) * scale
        for factor, scale in ((1.0, 0.5), (half, 1 / h), (t[:2] ** 2 + half, 0.5 / h**2))
    )
    weight, gain = np.exp(-2 * t[:-1]), np.exp(t[1:])
    a, b = 1 / (1 - h), h / (1 - h) * gain  # x+ = a x + b u
    # D x+^2 + E x+ (x - x+) + F (x - x+)^2, in x and x+, then in x and u
    mixed, square = E - 2 * F, D - E + F
    cost = lfo.QuadraticCost(
        Q=(2 * weight * (F + mixed * a + square * a * a))[:, None, None],
        S=(weight * (mixed * b + 2 * square * a * b))[:, None, None],
        R=(2 * weight * square * b * b + h)[:, None, None],
    )
    dynamics = lfo.LinearDynamics(np.full((N, 1, 1), a), b[:, None, None])
    start = (1 + 3 * e) / (2 - 2 * e)
    problem = lfo.OptimalControlProblem(dynamics, N, cost, lfo.Box([None], [1]), initial_state=[start])

    def formula(x: np.ndarray, u: np.ndarray) -> float:
        after, change = x[1:, 0], x[:-1, 0] - x[1:, 0]
        parts = weight * (D * after**2 + E * after * change + F * change**2) + h / 2 * u[:, 0] ** 2
        return math.fsum(parts.tolist())

    return proven(problem, formula, 0.0, folder, name)


def ubh1(N: int, folder: Path | None, name: str) -> Found:
    """Take u at the start of a step as a state, and u at its end as the control."""
    K, three, zero = 1000 / N, np.eye(3), np.zeros((3, 3))
    A = np.block([[three, K * three, K**2 / 4 * three], [zero, three, K / 2 * three], [zero, zero, zero]])
    B = np.vstack([K**2 / 4 * three, K / 2 * three, three])
    start, free = [1000.0] * 3 + [-10, 10, -10], [None] * 6
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, B),
        N,
        lfo.QuadraticCost(Q=np.diag([0] * 6 + [K] * 3), R=K * three),
        lfo.Box(-1, 1),
        lfo.Box([*free, -1, -1, -1], [*free, 1, 1, 1]),
        initial_state=lfo.Box([*start, -1, -1, -1], [*start, 1, 1, 1]),
        terminal_state=lfo.Box([0] * 6 + [-1] * 3, [0] * 6 + [1] * 3),
    )

    def formula(x: np.ndarray, u: np.ndarray) -> float:
        return math.fsum((K / 2 * (x[:-1, 6:] ** 2 + u**2)).ravel().tolist())

    return proven(problem, formula, 0.0, folder, name)


def local_optimum(
    step: Callable[..., Any], stage: Callable[..., Any], horizon: int, start: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the states (T+1,) and controls (T,) of an optimum that is proven to be local only."""
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(step, state_dim=1, control_dim=1)
    cost = lfo.QuadraticCost() + lfo.costs.SmoothCost(stage=stage)
    problem = lfo.OptimalControlProblem(dynamics, horizon, cost, initial_state=[start])
    result = lfo.solve(problem, global_bound=False)
    assert result.trajectory is not None
    return result.trajectory.x[:, 0], result.trajectory.u[:, 0]


def dtoc6(N: int, folder: Path | None, name: str) -> Found:
    """Bound the optimum from a local one: J is convex in d = exp(u) <= 1.

    A control above zero is never better than zero, so that d <= 1, where (log d)^2 / 2 has the second derivative
    (1 - log d) / d^2 >= 1. J is at most |gradient|^2 / 2 above the optimum.
    """
    _, u = local_optimum(
        lambda x, u: [x[0] + np.exp(u[0])], lambda t, x, u: u[0] ** 2 / 2 + (np.exp(u[0]) + x[0]) ** 2 / 2, N - 1, 0.0
    )
    d = np.exp(np.minimum(u, 0.0))
    y = np.cumsum(d)
    J = math.fsum((np.log(d) ** 2 / 2 + y**2 / 2).tolist())
    gradient = np.log(d) / d + np.cumsum(y[::-1])[::-1]
    x = np.append(0.0, y[:-1])
    again = math.fsum([float((x[t] + math.exp(u[t])) ** 2 + u[t] ** 2) / 2 for t in range(N - 1)])
    return Found(J - float(gradient @ gradient) / 2, J, again, "convex")


def dtoc5(N: int, folder: Path | None, name: str) -> Found:
    """Bound the optimum from a local one: h sum (x^2 + max(u, 0)^2) is convex in x, and no larger than J.

    u = (x - x+)/h + x^2 is convex in x, and so is the square of its positive part. With u >= 0 both values are the
    same. The last u is zero, and x_2 .. x_{N-1} have the modulus 2 h: J is at most |gradient|^2 / (4 h) above the
    optimum.
    """
    h = 1 / N
    x, _ = local_optimum(
        lambda x, u: [x[0] - h * u[0] + h * x[0] ** 2], lambda t, x, u: h * (x[0] ** 2 + u[0] ** 2), N - 1, 1.0
    )
    x = np.append(1.0, x[1:-1])  # the last state has no cost
    v = (x[:-1] - x[1:]) / h + x[:-1] ** 2
    assert v.min() >= 0
    J = h * math.fsum([*(x**2).tolist(), *(v**2).tolist()])
    by_before, by_after = np.append(2 * h * v * (1 / h + 2 * x[:-1]), 0.0), np.append(0.0, -2 * v)
    gradient = (2 * h * x + by_before + by_after)[1:]
    y = 1.0
    again = 0.0
    for control in [*v, 0.0]:  # by the transition of the file
        again += h * (y * y + control**2)
        y += -h * control + h * y * y
    return Found(J - float(gradient @ gradient) / (4 * h), J, float(again), "convex")


def dtoc1l(N: int, controls: int, states: int, folder: Path | None, name: str) -> Found:
    """Bound a convex problem by the Lagrangian, whose minimum is explicit: of z^4 - a z it is -3 (a/4)^(4/3)."""
    A = np.diag([0.5] * states) + np.diag([0.25] * (states - 1), 1) - np.diag([0.25] * (states - 1), -1)
    B = (np.arange(states)[:, None] - np.arange(controls)) / (controls + states)
    cost = lfo.QuadraticCost() + lfo.costs.SmoothCost(
        stage=lambda t, x, u: sum((z - 0.25) ** 4 for z in x) + sum((z - 0.5) ** 4 for z in u),
        terminal=lambda x: sum((z - 0.25) ** 4 for z in x),
    )
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics(A, B), N - 1, cost, initial_state=np.zeros(states))
    result = lfo.solve(problem, global_bound=False, throw=False)
    assert result.trajectory is not None
    assert result.cost is not None
    u = result.trajectory.u
    x = np.zeros((N, states))
    for t in range(N - 1):
        x[t + 1] = A @ x[t] + B @ u[t]
    price, low = np.zeros(states), []
    for t in reversed(range(1, N)):
        # x_t has the coefficient -a, where a is the slope at x_t: its minimum is attained there
        z = x[t] - 0.25
        low += [*(z**4 - 4 * z**3 * x[t]).tolist()]
        price = 4 * z**3 + A.T @ price
        a = -(B.T @ price)
        low += [*(-3 * (np.abs(a) / 4) ** (4 / 3) - a / 2).tolist()]
    low += [states * 0.25**4]
    J = math.fsum([*((x - 0.25) ** 4).ravel().tolist(), *((u - 0.5) ** 4).ravel().tolist()])
    return Found(math.fsum(low), J, result.cost, "convex")


def bends_of(c: np.ndarray) -> np.ndarray:
    """Return where the convex sequence that is nearest to c bends.

    Hinges max(t - t_k, 0) with weights that are not negative; those join at which the multiplier is the least.
    """
    n = len(c)
    t = np.arange(n) / (n - 1)
    line, _ = np.linalg.qr(np.column_stack([np.ones(n), t]))
    bends = np.arange(1, n - 1, max(1, n // 100))
    for _ in range(100):
        hinges = np.maximum(t[:, None] - t[bends], 0.0)
        hinges -= line @ (line.T @ hinges)
        hinges /= np.linalg.norm(hinges, axis=0)
        q, upper = np.linalg.qr(hinges)
        weights, _ = nnls(upper, q.T @ c, maxiter=100 * len(bends))
        miss = hinges @ weights - c
        multipliers = np.cumsum(np.cumsum(miss - line @ (line.T @ miss)))[: n - 2]
        bends = bends[weights > 0]
        beside = np.concatenate([[np.inf], multipliers, [np.inf]])
        least = (multipliers <= beside[:-2]) & (multipliers < beside[2:])
        found = np.flatnonzero(least & (multipliers < -1e-9 * np.abs(multipliers).max()))
        wider = np.union1d(bends, found[np.argsort(multipliers[found])][:40] + 1)
        if len(wider) == len(bends):
            break
        bends = wider
    return bends


def convex_sequence(
    g: Callable[[np.ndarray], np.ndarray], N: int, constant: float | None, folder: Path | None, name: str
) -> Found:
    """Solve for the value and the slope at each bend, and bound all convex sequences by the multipliers.

    A constant is that of Maros and Meszaros, whose file rounds c to nine digits and then to six.
    """
    n = N + 2
    t = np.arange(n) / (n - 1)
    c = g(t) + 0.1 * np.sin(np.arange(1, n + 1))
    if constant is None:
        constant = math.fsum((c**2 / 2).tolist())
    else:
        c = np.array([float(f"{float(f'{value:.8e}'):.5e}") for value in c])
    edges = [0, *bends_of(c).tolist(), n - 1]
    T = len(edges) - 1
    A, Q, q = np.zeros((T, 2, 2)), np.zeros((T, 2, 2)), np.zeros((T, 2))
    for k, (first, last) in enumerate(itertools.pairwise(edges)):
        basis = np.column_stack([np.ones(last - first), t[: last - first]])
        A[k] = [[1.0, t[last - first]], [0.0, 1.0]]
        Q[k], q[k] = basis.T @ basis, -c[first:last] @ basis
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, np.array([[0.0], [1.0]])),
        T,
        lfo.QuadraticCost(Q=Q, q=q, P=np.diag([1.0, 0.0]), p=[-c[-1], 0.0]),
        lfo.Box([0], [None]),
    )
    result = lfo.solve(problem)
    assert result.trajectory is not None
    assert result.cost is not None
    x, u = result.trajectory.x, np.maximum(result.trajectory.u[:, 0], 0.0)
    y = x[0, 0] + x[0, 1] * t
    for k in range(T - 1):
        y += u[k] * np.maximum(t - t[edges[k + 1]], 0.0)
    J = constant + math.fsum([*(y**2 / 2).tolist(), *(-c * y).tolist()])
    line, _ = np.linalg.qr(np.column_stack([np.ones(n), t]))
    miss = (y - c) - line @ (line.T @ (y - c))
    multipliers = np.maximum(np.cumsum(np.cumsum(miss))[: n - 2], 0.0)
    push = np.diff(np.concatenate([[0.0, 0.0], multipliers, [0.0, 0.0]]), 2)  # y - c, where all is exact
    low = constant - math.fsum(((push + c) ** 2 / 2).tolist())  # the least of J - push y over all y
    wider = ROUNDED * constant
    return Found(low - wider, J + wider, result.cost + constant, "convex")


def pulse_pattern(M: float, k: int, folder: Path | None, name: str) -> Found:
    """Bound the distortion of a pattern that is of the published class: k switches, unipolar, none close together."""
    result = lfo.solve(lfo.library.pulse_pattern(kind="opp", modulation=M, switches=k), gap=1e-4)
    assert result.trajectory is not None
    assert result.cost is not None
    assert result.lower_bound is not None
    dwells, levels = result.trajectory.u[:, 0], result.trajectory.x[:, 1]
    assert 2 * dwells[0] >= APART
    assert 2 * dwells[-1] >= APART
    assert dwells[1:-1].min() >= APART
    assert levels.min() >= -1e-9
    angles = np.cumsum(dwells)[:-1]
    steps = np.diff(levels[: len(dwells)])
    n = np.arange(1, 200001, 2)
    b = 4 / (np.pi * n) * (np.cos(np.multiply.outer(n, angles)) @ steps)  # by the series, cut off
    tail = (4 / np.pi * np.abs(steps).sum()) ** 2 / (6 * 2e5**3)
    again = math.sqrt(float(((b[1:] / n[1:]) ** 2).sum()))
    assert again <= math.sqrt(result.cost) * (1 + 1e-6)
    assert result.cost <= again**2 + tail + 1e-9
    return Found(math.sqrt(result.lower_bound), math.sqrt(result.cost), None, "judge")


def least_energy(A: np.ndarray, B: np.ndarray, h: float) -> tuple[lfo.LinearDynamics, np.ndarray]:
    """Return x+ = exp(A h) x + L w, where |w|^2 is the least integral of |u|^2 on the way, and inv(L).

    L L' is the integral of exp(A s) B B' exp(A' s): a problem with limits at samples only is the same in w.
    """
    n = len(A)
    both = expm(h * np.block([[-A, B @ B.T], [np.zeros((n, n)), A.T]]))
    Phi = both[n:, n:].T
    L = np.linalg.cholesky(Phi @ both[:n, n:])
    return lfo.LinearDynamics(Phi, L), np.linalg.inv(L)


def energy(A: np.ndarray, B: np.ndarray, h: float, inverse: np.ndarray, w: np.ndarray) -> float:
    """Return the integral of |u|^2 by Gauss's rule, where u = B' exp(A' (h - s)) inv(L)' w on each step of w."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    maps = [B.T @ expm(A.T * h * (1 - node) / 2) @ inverse.T for node in nodes]
    return h / 2 * math.fsum(float(b) * float(((w @ M.T) ** 2).sum()) for M, b in zip(maps, weights, strict=True))


TIGHTER = 1e-8  # of a limit at samples: where it holds at every time, too
DOUBLE = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])  # x'' = u
OSCILLATOR = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([[0.0], [1.0]])  # x'' = u - x


def bryson_denham(samples: int, folder: Path | None, name: str) -> Found:
    """Limit x at samples only, for the lower end; below the limit by TIGHTER, and then at every time, for the upper."""
    A, B = DOUBLE
    h, points = 1 / samples, 20001
    dynamics, inverse = least_energy(A, B, h)
    highest = 1 / 9 if samples == 9 else 0.1

    def problem(limit: float) -> lfo.OptimalControlProblem:
        return lfo.OptimalControlProblem(
            dynamics,
            samples,
            lfo.QuadraticCost(R=1.0),
            state_set=lfo.Box([None, None], [limit, None]),
            initial_state=[0, 1],
            terminal_state=[0, -1],
        )

    found = proven_apart(problem(highest), lambda x, w: energy(A, B, h, inverse, w) / 2, folder, name)
    inside = lfo.solve(problem(highest * (1 - TIGHTER)))
    assert inside.trajectory is not None
    assert inside.cost is not None
    s = np.linspace(0, h, points)
    for x, w in zip(inside.trajectory.x[:-1], inside.trajectory.u, strict=True):
        slope, last = inverse.T @ w  # u = slope (h - s) + last
        path = x[0] + x[1] * s + last * s**2 / 2 + slope * (h * s**2 / 2 - s**3 / 6)
        steepest = max(abs(last), abs(slope * h + last))
        assert path.max() + steepest * (h / (points - 1)) ** 2 / 8 <= highest
    return Found(found.low, inside.cost, found.again, found.proof)


def least_energy_to(
    system: tuple[np.ndarray, np.ndarray],
    seconds: float,
    steps: int,
    start: list[float],
    end: dict[str, Any],
    folder: Path | None,
    name: str,
) -> Found:
    """Take half the integral of |u|^2, and a cost of the end or the end itself, by steps of equal length."""
    A, B = system
    h = seconds / steps
    dynamics, inverse = least_energy(A, B, h)
    cost = lfo.QuadraticCost(R=1.0, **{key: end[key] for key in ("P", "p") if key in end})
    problem = lfo.OptimalControlProblem(
        dynamics, steps, cost, initial_state=start, terminal_state=end.get("terminal_state")
    )
    P, p = end.get("P", np.zeros_like(A)), end.get("p", np.zeros(len(A)))

    def formula(x: np.ndarray, w: np.ndarray) -> float:
        return energy(A, B, h, inverse, w) / 2 + float(x[-1] @ P @ x[-1]) / 2 + float(p @ x[-1])

    return proven_apart(problem, formula, folder, name)


def scalar_regulator(
    a: float,
    b: float,
    q: float,
    r: float,
    ends: tuple[float, float | None],
    m: float,
    seconds: float,
    folder: Path | None,
    name: str,
) -> Found:
    """Take the integral of q x^2 + r u^2 and m x^2 at the end, where x' = a x + b u.

    With a root p of b^2 p^2 / r = 2 a p + q and v = u + b p x / r, it is that of r v^2, less the change of p x^2. Where
    the end is free, p is the negative root, so that the cost of the end is convex.
    """
    start, end = ends
    rate = math.sqrt(a**2 + q * b**2 / r) * (1 if end is None else -1)  # x' = rate x + b v
    p = (a - rate) * r / b**2
    reach = b * math.sqrt(math.expm1(2 * rate * seconds) / (2 * rate))  # w^2 is the least integral of v^2
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[math.exp(rate * seconds)]], [[reach]]),
        1,
        lfo.QuadraticCost(R=2 * r, P=2 * (m - p) if end is None else 0.0),
        initial_state=[start],
        terminal_state=None if end is None else [end],
    )

    def formula(x: np.ndarray, w: np.ndarray) -> float:
        panels = max(1, math.ceil(2 * seconds))
        nodes, weights = np.polynomial.legendre.leggauss(20)
        length = seconds / panels
        s = ((np.arange(panels)[:, None] + (1 + nodes) / 2) * length).ravel()
        v = b * np.exp(rate * (seconds - s)) * (float(w[0, 0]) / reach)
        up, down = np.exp(rate * (seconds + s)), np.exp(rate * (seconds - s))
        path = np.exp(rate * s) * x[0, 0] + b**2 * (float(w[0, 0]) / reach) * (up - down) / (2 * rate)
        parts = q * path**2 + r * (v - b * p / r * path) ** 2
        return float(m * x[-1, 0] ** 2) + length / 2 * math.fsum((np.tile(weights, panels) * parts).tolist())

    change = p * (start**2 - (end or 0.0) ** 2)
    found = proven_apart(problem, lambda x, w: formula(x, w) - change, folder, name)
    assert found.again is not None
    return Found(found.low + change, found.high + change, found.again + change, found.proof)


def ubh1_continuous(folder: Path | None, name: str) -> Found:
    """Solve the three axes without limits in continuous time; u is a line on each axis, within its limits."""
    A, B = (np.kron(M, np.eye(3)) for M in DOUBLE)
    dynamics, inverse = least_energy(A, B, 1000.0)
    start = [1000.0] * 3 + [-10, 10, -10]
    problem = lfo.OptimalControlProblem(
        dynamics, 1, lfo.QuadraticCost(R=2.0), initial_state=start, terminal_state=np.zeros(6)
    )
    result = lfo.solve(problem)
    assert result.control is not None
    w = result.control[0]
    ends = [B.T @ expm(A.T * s) @ inverse.T @ w for s in (0.0, 1000.0)]
    assert np.abs(ends).max() <= 1
    return proven_apart(problem, lambda x, w: energy(A, B, 1000.0, inverse, w), folder, name)


def proven_apart(
    problem: lfo.OptimalControlProblem,
    formula: Callable[[np.ndarray, np.ndarray], float],
    folder: Path | None,
    name: str,
) -> Found:
    """Return the interval of an optimum, widened by the rounding of the exact map and of Gauss's rule."""
    result = lfo.solve(problem)
    assert result.trajectory is not None
    again = formula(result.trajectory.x, result.trajectory.u)
    interval = result.enclosure
    if folder is not None:
        result.write_proof(folder / f"{name}.proof")
    wider = ROUNDED * max(abs(interval.upper), float(np.sum(result.trajectory.u**2)))
    return Found(interval.lower - wider, interval.upper + wider, again, "verified")


def unreachable(
    A: np.ndarray, B: np.ndarray, start: np.ndarray, end: np.ndarray, free: list[int], bound: float, T: float
) -> bool:
    """Return whether a multiplier proves that no control |u(t)| <= bound of any form reaches the end at T.

    Every control has eta' (x(T) - exp(A T) x(0)) <= bound times the integral of |eta' exp(A s) B|. The multiplier is
    that of a linear program on some points. Its integral is that of many cells, with the error that a slope allows.
    """
    d = end - expm(A * T) @ start
    n, few, many = len(A), 1500, 400_000

    def waves(points: int) -> np.ndarray:
        step = expm(A * T / points)
        g = np.empty((points, n))
        column = expm(A * T / points / 2) @ B[:, 0]
        for i in range(points):
            g[i] = column
            column = step @ column
        return g

    g = waves(few)
    rows = np.vstack([np.hstack([sign * g, -np.eye(few)]) for sign in (1, -1)])
    limits = [(0, 0) if i in free else (-1, 1) for i in range(n)] + [(0, None)] * few
    found = linprog(np.append(-d, np.full(few, bound * T / few)), rows, np.zeros(2 * few), bounds=limits)
    assert found.x is not None
    eta = np.where(np.isin(np.arange(n), free), 0.0, found.x[:n])
    cell = T / many
    f = waves(many) @ eta
    slope = 1.01 * np.abs(np.diff(f)).max() / cell  # f is smooth: differences of neighbours are slopes
    integral = math.fsum((cell * np.abs(f)).tolist()) + T * slope * cell / 4
    return float(eta @ d) > bound * integral


def least_time(
    system: tuple[np.ndarray, np.ndarray],
    ends: tuple[list[float], list[float | None]],
    bound: float,
    times: tuple[float, float],
    folder: Path | None,
    name: str,
) -> Found:
    """Bracket the least time: a multiplier excludes all controls at the first; a held one does it at the second."""
    (A, B), (start, end), (low, high), steps = system, ends, times, 400
    free = [i for i, value in enumerate(end) if value is None]
    target = np.array([value or 0.0 for value in end])
    assert unreachable(A, B, np.array(start), target, free, bound, low)
    dynamics = lfo.LinearDynamics.from_continuous(A, B, high / steps)
    problem = lfo.OptimalControlProblem(
        dynamics,
        steps,
        lfo.QuadraticCost(R=1.0),
        lfo.Box(-bound, bound),
        initial_state=start,
        terminal_state=lfo.Box(end, end),
    )
    result = lfo.solve(problem)
    assert result.certificate is not None
    assert result.certificate.feasible
    return Found(low, high, None, "multiplier, judge")


def spring(derivative: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return two masses and a spring; with the derivative of the states by its stiffness."""
    K = np.array([[-1.0, 1], [1, -1]])
    A, B = np.block([[np.zeros((2, 2)), np.eye(2)], [K, np.zeros((2, 2))]]), np.array([[0.0], [0], [1], [0]])
    if not derivative:
        return A, B
    Z, T = np.zeros((4, 4)), np.eye(8)
    D = Z.copy()
    D[2:, :2] = K
    T[4, 5], T[6, 7] = -1, -1  # the derivative of the spring's length, and its rate
    return T @ np.block([[A, Z], [D, A]]) @ np.linalg.inv(T), T @ np.vstack([B, np.zeros((4, 1))])


def shaper_range(shaper: str, signs: tuple[float, ...], folder: Path | None, name: str) -> Found:
    """Bracket how far a mode may be from the frequency of a shaper, in percent of it, within 5 % of the vibration.

    The shaper is made for a damping ratio of 0.1, and the modes have 0.05 to 0.2. The lower end is proven for all modes
    in between, the upper one by a mode that exceeds the limit; both are zero if a mode at the frequency does.
    """
    made = known_shaper(shaper, 1.0, 0.1)
    damping = np.linspace(0.05, 0.2, 31)

    def vibration(r: float) -> float:
        edges = np.concatenate([np.full(31, 1 + sign * r) for sign in signs])
        return float(np.abs(made.response(eigenvalues_of(edges, np.tile(damping, len(signs))))).max())

    steps = int(np.argmax([vibration(i / 1000) > 0.05 for i in range(1000)]))
    if steps == 0:
        return Found(0.0, 0.0, None, "proven peak")
    ends = [1.0, *(1 + sign * (steps - 1) / 1000 for sign in signs)]
    peak = Modes(((min(ends), max(ends)),), (0.05, 0.2)).proven_vibration(made, made.duration / 200_000)
    assert peak <= 0.05
    return Found((steps - 1) / 10, steps / 10, None, "proven peak")


def gropt(folder: Path | None, name: str) -> Found:
    """Search samples of 10 us: the number is exact, one sample less is proven infeasible."""
    found = lfo.minimum_time(lfo.library.mri_gradient, horizons=(100, 200))
    assert found.proven
    assert found.horizon is not None
    assert found.result is not None
    assert found.result.control is not None
    g = found.result.control[:, 0]
    moment = 0.01 * float(np.sum(g * 0.01 * np.arange(len(g))))
    assert abs(moment - 11.74) <= 1e-3 + 1e-8
    return Found(found.horizon / 100, found.horizon / 100, len(g) / 100, "ray, judge")


def phase_filter(n: int, ripple_db: float, stop_db: float) -> lfo.OptimalControlProblem:
    """Return the problem of h_0 + 2 sum h_k cos kw by its 2 n + 1 coefficients, control 0.

    Control 1 is control 0 less a pulse c at the centre. H is real, so that both sides of the passband are |H - c| <= d:
    a mask at every frequency.
    """
    N, up = 2 * n + 1, 10 ** (ripple_db / 20)
    c, d = (up + 1 / up) / 2, (up - 1 / up) / 2
    E = np.zeros((N, n + N, 2))
    for t in range(n):  # symmetric
        E[t, t, 0], E[N - 1 - t, t, 0] = 1, -1
    E[np.arange(N), n + np.arange(N)] = [1, -1]
    mask, notch = lfo.MagnitudeBound, lfo.spectrum.notch
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.0]], [[0.0, 0.0]], sampling_time=1.0),
        N,
        lfo.QuadraticCost(R=1e-3 * np.eye(2)),
        lfo.Box(-2, 2),
        initial_state=[0],
        control_spectrum=[
            mask(d, band=notch(centre_hz=0.03, width_hz=0.06), every_frequency=True, component=1),
            mask(10 ** (stop_db / 20), band=notch(centre_hz=0.31, width_hz=0.38), every_frequency=True, component=0),
            lfo.spectrum.LinearConstraint(E, -c * np.eye(n + N)[2 * n]),
        ],
    )


def filter_is_feasible(n: int, ripple_db: float, stop_db: float) -> bool:
    """Return what is proven: True by a filter that holds its limits on a dense grid too, False by a ray."""
    result = lfo.solve(phase_filter(n, ripple_db, stop_db), throw=False)
    if result.status == lfo.results.Status.INFEASIBLE:
        assert result.bound == "rigorous"
        return False
    assert result.control is not None
    h = result.control[:, 0]
    for low, high, least, most in ((0, 0.12, -ripple_db, ripple_db), (0.24, 1, -np.inf, stop_db)):
        w = np.pi * np.linspace(low, high, 20001)
        dB = 20 * np.log10(np.abs(np.exp(-1j * np.outer(w, np.arange(len(h)))) @ h))
        assert least - 1e-4 <= dB.min()
        assert dB.max() <= most + 1e-4
    return True


def cvx_attenuation(folder: Path | None, name: str) -> Found:
    """Bracket the attenuation: one level is feasible, the next is not."""
    assert filter_is_feasible(10, 1, -34.526)
    assert not filter_is_feasible(10, 1, -34.527)
    return Found(-34.527, -34.526, None, "ray, judge")


def cvx_order(folder: Path | None, name: str) -> Found:
    """Find the least order: one is feasible, the one before is not."""
    assert filter_is_feasible(13, 0.5, -35)
    assert not filter_is_feasible(12, 0.5, -35)
    return Found(13, 13, None, "ray, judge")


DTOC3 = "DTOC3: y1+ = y1 + S y2, y2+ = y2 - S y1 + S x, S = 1/N, (15, 5); sum of S/2 (2 y1² + y2² + 6 x²); N = "
HAGER1 = "HAGER1: trapezoids of x' = x/2 + u, x = 1 at 0; x²/2 at 1 and half the integral of u²; N = "
HAGER2 = "HAGER2: trapezoids of x' = x/2 + u; sum of h/6 (x² + x x+ + x+²) + h/4 u²; N = "
EXCLUDED = "the proof excludes it, and a Riccati recursion has our digits"
OUTSIDE = "a proof excludes it"
CONVEX = "convexity excludes it, by a bound from the gradient or the Lagrangian"
HAGER3 = "HAGER3: trapezoids of x' = x/2 + u; sum of h/8 (.625 (x² + x x+ + x+²) + (x + x+) u) + h/4 u²; N = "
HAGER4 = "HAGER4: x' = x + exp(t) u by implicit Euler, u ≤ 1; exact integrals of exp(-2 t) x² of lines, and u²/2; N = "
UBH1 = "UBH1: y'' = u in three axes, 1000 s to rest at 0, |u| ≤ 1; integral of |u|², all by trapezoids; N = "
DTOC5 = "DTOC5: y+ = y - h x + h y², h = 1/N, y = 1 first; h times the sum of x² + y²; N = "
DTOC6 = "DTOC6: y+ = y + exp(x), y = 0 first; sum of x²/2 + (exp(x) + y)²/2; N = "
DTOC1L = "DTOC1L: linear, from 0; sum of (x - 1/2)^4 and (y - 1/4)^4; N, controls, states = "
PATTERNS = "Miller, Karamanakos, Geyer, arXiv 2512.08201, public data"
PATTERN = "Least distortion of five levels, exactly k switches .0314159 rad apart, unipolar, |b3| ≤ .01; "
DTQP = "DT QP Project, examples"
MAROS = "Maros, Meszaros, QP test set, {0}"
LISWET = "{0}: half the squares from {1} + .1 sin i to a convex sequence, t = (i - 1)/(N + 1), i to N + 2; N = {2}"
FOSSEE = "FOSSEE Optimization Toolbox, tests/general_tests/CUTEst/{0}.sce"
BELOW = "below the proven bound: its sequence is convex only within the tolerance of the solver"
BRYSON = "Bryson-Denham: x'' = u in continuous time, x: 0 to 0, v: 1 to -1, x ≤ l; half the integral of u²; l = "
SPRING = "Two masses and a spring, |u| ≤ 1, 0 to 1 at rest, any u(t): least time in s"
KLIPPER = "Klipper, docs/Resonance_Compensation.md"
APPROXIMATE = "a mode in the range exceeds 5 %; the source says that its ranges are approximate"
SHAPER = "Modes that a shaper leaves at most 5 % of, damping .05 to .2, from its frequency in percent; "
CUTEST = "CUTEst, {0}.SIF"
MPT3 = "MPT3, mpt3.org; python-control, optimal_test.py"
ROWS = [
    *(
        Row(f"mpt3_u{t}", MPT3, f"The same regulator: its control at the step {t}", printed, partial(mpt3_control, t))
        for t, printed in ((0, "-1"), (1, "-1"), (2, ".1393"), (3, ".3361"))
    ),
    Row(
        "mpt3",
        "MPT3, mpt3.org; python-control, optimal_test.py",
        "Regulator of a double integrator, x0 = (4, 0), T = 4",
        "32.4898",
        mpt3,
    ),
    *(
        Row(f"dtoc3_{N}", CUTEST.format("DTOC3"), DTOC3 + str(N), printed, partial(dtoc3, N), EXCLUDED)
        for N, printed in (
            (10, "224.590381002"),
            (100, "234.286202920"),
            (1000, "235.182824435"),
            (5000, "235.154640099"),
        )
    ),
    Row("dtoc3_maros", "Maros, Meszaros, QP test set, DTOC3", DTOC3 + "5000", "235.262481", partial(dtoc3, 5000)),
    *(
        Row(f"hager1_{N}", CUTEST.format("HAGER1"), HAGER1 + str(N), printed, partial(hager1, N), EXCLUDED)
        for N, printed in ((10, ".88097222455"), (100, ".88079882866"))
    ),
    *(
        Row(f"hager2_{N}", CUTEST.format("HAGER2"), HAGER2 + str(N), printed, partial(hager2, N), EXCLUDED)
        for N, printed in ((10, ".4325699689"), (100, ".4320871769"))
    ),
    Row(
        "gropt",
        "GrOpt, demo of flow encoding",
        "Shortest bipolar gradient, 10 us, 40 mT/m, 200 T/m/s, in ms",
        "1.32",
        gropt,
    ),
    Row(
        "cvx_attenuation",
        "CVX, gallery of filter design",
        "Linear phase, n = 10, 1 dB ripple to .12 pi: least stop band from .24 pi in dB",
        "-35.15",
        cvx_attenuation,
        "printed on a grid of 300 points without the edges of the bands",
    ),
    Row(
        "cvx_order",
        "CVX, gallery of filter design",
        "Linear phase, .5 dB ripple to .12 pi, -35 dB from .24 pi: least n",
        "12",
        cvx_order,
        "printed on a grid of 300 points; over all frequencies 12 is proven infeasible",
    ),
    *(
        Row(f"hager3_{N}", CUTEST.format("HAGER3"), HAGER3 + str(N), printed, partial(hager3, N), EXCLUDED)
        for N, printed in (
            (10, ".14103316577"),
            (50, ".14096413824"),
            (100, ".14096197328"),
            (500, ".14096128049"),
            (1000, ".14096125887"),
        )
    ),
    *(
        Row(f"hager4_{N}", CUTEST.format("HAGER4"), HAGER4 + str(N), printed, partial(hager4, N), OUTSIDE)
        for N, printed in (
            (10, "2.833914199"),
            (50, "2.799810928"),
            (100, "2.796761851"),
            (500, "2.794513229"),
            (1000, "2.794244187"),
        )
    ),
    *(
        Row(f"ubh1_{N}", CUTEST.format("UBH5"), UBH1 + str(N), printed, partial(ubh1, N), OUTSIDE)
        for N, printed in (
            (10, "1.14735202967"),
            (100, "1.11631518169"),
            (1000, "1.11598643493"),
            (2000, "1.11587382445"),
        )
    ),
    Row("ubh1_maros", "Maros, Meszaros, QP test set, UBH1", UBH1 + "2000", "1.11600082", partial(ubh1, 2000)),
    *(
        Row(f"dtoc5_{N}", CUTEST.format("DTOC5"), DTOC5 + str(N), printed, partial(dtoc5, N), CONVEX)
        for N, printed in ((10, "1.451893900588"), (50, "1.528586458855"), (100, "1.532552633518"))
    ),
    *(
        Row(f"dtoc6_{N}", CUTEST.format("DTOC6"), DTOC6 + str(N), printed, partial(dtoc6, N), CONVEX)
        for N, printed in (
            (11, "19.80411526774"),
            (21, "62.49481326823"),
            (31, "119.0328455446"),
            (51, "261.1131573312"),
            (101, "727.9505731659"),
        )
    ),
    *(
        Row(
            f"dtoc1l_{N}_{m}_{n}",
            CUTEST.format("DTOC1L"),
            f"{DTOC1L}{N}, {m}, {n}",
            printed,
            partial(dtoc1l, N, m, n),
            CONVEX,
        )
        for N, m, n, printed in (
            (10, 2, 4, ".0735931360"),
            (50, 2, 4, ".2299411960"),
            (100, 2, 4, ".4253681120"),
            (10, 5, 10, "1.1498579294"),
            (50, 5, 10, "6.1678479713"),
        )
    ),
    *(
        Row(
            f"pattern_{M}_{k}_{side}",
            PATTERNS,
            f"{PATTERN}M = {M}, k = {k}: {words}",
            printed,
            partial(pulse_pattern, M, k),
            side=side,
        )
        for M, k, lower, upper in (
            (0.05, 8, ".01353", ".013543"),
            (0.05, 12, ".009637", ".009648"),
            (0.8, 12, ".023661", ".023664"),
            (0.9, 8, ".042201", ".042206"),
            (1.0, 8, ".029132", ".02916"),
        )
        for side, words, printed in (("below", "a lower bound", lower), ("above", "an upper bound", upper))
    ),
    Row("bryson_9", DTQP, BRYSON + "1/9", "4", partial(bryson_denham, 9)),
    Row("bryson_10", DTQP, BRYSON + ".1", "4.4444", partial(bryson_denham, 10)),
    *(
        Row(name, DTQP, f"{words}; half the integral of u²{cost}", printed, partial(least_energy_to, *given))
        for name, words, cost, printed, given in (
            (
                "cart",
                "Cart: x'' = u - x', from rest, 1 s",
                " less x(1)",
                "-0.0840456204",
                ((np.array([[0.0, 1.0], [0.0, -1.0]]), DOUBLE[1]), 1.0, 1, [0, 0], {"p": np.array([-1.0, 0.0])}),
            ),
            (
                "bryson_ho_153",
                "Bryson, Ho, 153: x' = u from 1, 1 s",
                " and x² at the end",
                "0.3333333333",
                ((np.zeros((1, 1)), np.ones((1, 1))), 1.0, 1, [1], {"P": np.array([[2.0]])}),
            ),
            (
                "bryson_ho_154",
                "Bryson, Ho, 154: x'' = u from (100, 1), 100 s",
                " and of 100 x² + v² at the end",
                "0.1369230615",
                (DOUBLE, 100.0, 10, [100, 1], {"P": np.diag([100.0, 1.0])}),
            ),
            (
                "bryson_ho_156",
                "Bryson, Ho, 156: x'' = u - x from (10, 1), 10 s",
                " and of x² at the end",
                "6.9155217445",
                (OSCILLATOR, 10.0, 4, [10, 1], {"P": np.diag([1.0, 0.0])}),
            ),
            (
                "bryson_ho_166",
                "Bryson, Ho, 166: x'' = u - x from (-.5, 1) to rest at 0, 20 s",
                "",
                "0.0598424760",
                (OSCILLATOR, 20.0, 8, [-0.5, 1], {"terminal_state": [0.0, 0.0]}),
            ),
        )
    ),
    *(
        Row(name, DTQP, words, printed, partial(scalar_regulator, *given))
        for name, words, printed, given in (
            (
                "lqr_scalar",
                "x' = u - x from 10, 1 s; integral of x² + 11 u², and 10 x² at the end",
                "135.3340749602",
                (-1.0, 1.0, 1.0, 11.0, (10.0, None), 10.0, 1.0),
            ),
            (
                "lqr_transfer",
                "x' = u - x from 1.5 to 1, 10000 s; integral of x² + u²",
                "3.3461940777",
                (-1.0, 1.0, 1.0, 1.0, (1.5, 1.0), 0.0, 10000.0),
            ),
            (
                "anderson_moore",
                "Anderson, Moore, 64: x' = x/2 + u from 5, 10 s; integral of exp(-t) (x²/2 + 2 u²), in exp(-t/2) x",
                "24.9977301066",
                (0.0, 1.0, 0.5, 2.0, (5.0, None), 0.0, 10.0),
            ),
        )
    ),
    Row(
        "ubh1_continuous",
        "Betts, Huffman, Journal of Guidance 16(1), 1993",
        "UBH1 in continuous time",
        "1.116",
        ubh1_continuous,
    ),
    Row(
        "spring",
        "Liu, Wie, Journal of Guidance 15(3), 1992",
        SPRING,
        "4.21786651",
        partial(least_time, spring(False), ([0.0] * 4, [1.0, 1.0, 0.0, 0.0]), 1.0, (4.2177, 4.2182)),
    ),
    Row(
        "spring_robust",
        "Singh, Vadali, Journal of Guidance 17(2), 1994",
        SPRING + ", where the end does not depend on the stiffness, to first order",
        "5.86595844",
        partial(
            least_time, spring(True), ([0.0] * 8, [1.0, 1.0, 0.0, 0.0, 0.0, None, 0.0, None]), 1.0, (5.8657, 5.8664)
        ),
    ),
    Row(
        "cushioned",
        "mintoc.de, cushioned oscillation",
        "5 x'' + 10 x = u, |u| ≤ 5, from (2, 5) to rest at 0, any u(t): least time in s",
        "8.98",
        partial(
            least_time,
            (np.array([[0.0, 1], [-2, 0]]), np.array([[0.0], [0.2]])),
            ([2.0, 5.0], [0.0, 0.0]),
            5.0,
            (8.9914, 8.9922),
        ),
        "a multiplier proves that no control reaches the end at this time",
    ),
    *(
        Row(label, KLIPPER, f"{SHAPER}{words}", printed, partial(shaper_range, shaper, signs), APPROXIMATE, "below")
        for label, shaper, words, signs, printed in (
            ("mzv", "MZV", "MZV, both sides", (-1.0, 1.0), "4"),
            ("zvd", "ZVD", "ZVD, both sides", (-1.0, 1.0), "15"),
            ("ei", "EI", "EI, both sides", (-1.0, 1.0), "20"),
            ("2hump", "2HUMP_EI", "2HUMP_EI, both sides", (-1.0, 1.0), "35"),
            ("3hump_below", "3HUMP_EI", "3HUMP_EI, below", (-1.0,), "45"),
            ("3hump_above", "3HUMP_EI", "3HUMP_EI, above", (1.0,), "50"),
        )
    ),
    *(
        Row(
            f"liswet{case}",
            MAROS.format(f"LISWET{case}"),
            LISWET.format(f"LISWET{case}", words, 10000) + f", c to six digits, the constant as {constant}",
            printed,
            partial(convex_sequence, g, 10000, constant),
            "its exponent is one too large" if case == 8 else "",
        )
        for case, words, g, constant, printed in (
            (1, "√t", np.sqrt, 2525.41, "36.122402"),
            (2, "t", lambda t: t, 1691.99, "24.998076"),
            (7, "sin πt", lambda t: np.sin(math.pi * t), 2525.26, "498.84089"),
            (8, "sin 2πt", lambda t: np.sin(2 * math.pi * t), 2525.26, "7144.7006"),
            (9, "sin 4πt", lambda t: np.sin(4 * math.pi * t), 2525.26, "1963.2513"),
            (10, "cos πt", lambda t: np.cos(math.pi * t), 2525.95, "49.485785"),
            (11, "cos 2πt", lambda t: np.cos(2 * math.pi * t), 2525.75, "49.523957"),
            (12, "cos 4πt", lambda t: np.cos(4 * math.pi * t), 2525.75, "1736.9274"),
        )
    ),
    *(
        Row(
            f"fossee_liswet10_{N}{by}",
            FOSSEE.format("liswet10"),
            LISWET.format("LISWET10", "cos 3.1415 t", N) + who,
            printed,
            partial(convex_sequence, lambda t: np.cos(3.1415 * t), N, None),
            reason,
        )
        for N, by, who, printed, reason in (
            (10, "", "", ".0219117", "a convex sequence has a smaller value"),
            (1000, "", "", "4.9316211", BELOW),
            (1000, "_neos", ", by NEOS", "4.9311300941879574", BELOW),
        )
    ),
    *(
        Row(f"fossee_{name}", FOSSEE.format(name.partition("_")[0]), words, printed, partial(solve, *given), reason)
        for name, words, printed, solve, given, reason in (
            ("hager1_500", HAGER1 + "500", ".8807972", hager1, (500,), EXCLUDED),
            ("hager1_1000", HAGER1 + "1000", ".8807971", hager1, (1000,), ""),
            ("hager4_50", HAGER4 + "50", "2.7998374", hager4, (50,), OUTSIDE),
            ("hager4_500", HAGER4 + "500", "2.7945138", hager4, (500,), OUTSIDE),
            ("ubh1_5", UBH1 + "5", "1.2444444", ubh1, (5,), ""),
            ("dtoc1l_20", DTOC1L + "20, 2, 4", ".1126860", dtoc1l, (20, 2, 4), CONVEX),
            ("dtoc1l_6_minos", DTOC1L + "6, 3, 3, by MINOS", ".1554865896", dtoc1l, (6, 3, 3), CONVEX),
        )
    ),
]


def lines_of(rows: Iterable[Row], folder: Path | None) -> Iterable[tuple[Row, Found, str, float]]:
    """Yield each row with what is found, its verdict and the seconds of processor time."""
    for row in rows:
        start = time.process_time()
        found = row.find(folder, row.name)
        scale = max(abs(found.high), 1e-300)
        if found.again is not None and not found.low - AGREES * scale <= found.again <= found.high + AGREES * scale:
            yield row, found, "unexplained", time.process_time() - start
        else:
            yield row, found, verdict(row, found), time.process_time() - start


def table(found: Iterable[tuple[Row, Found, str, float]]) -> list[str]:
    """Return the lines of the table."""
    lines = ["| row | source | statement | printed | ours | verdict | proof | s |", "|---|---|---|---|---|---|---|---|"]
    for row, one, said, seconds in found:
        ours = f"{one.low:.12g}" if one.low == one.high else f"[{one.low:.12g}, {one.high:.12g}]"
        reason = f": {row.reason}" if said == "corrected" else ""
        cells = [row.name, row.source, row.statement.replace("|", "\\|"), row.printed, ours, said + reason, one.proof]
        lines.append(f"| {' | '.join(cells)} | {seconds:.1f} |")
    return lines


def main(arguments: list[str] | None = None) -> int:
    """Print the table, or write the page; return 1 if a difference is unexplained."""
    parser = argparse.ArgumentParser(description="Compare printed values with proven intervals.")
    parser.add_argument("names", nargs="*", choices=[[], *(row.name for row in ROWS)], metavar="NAME")
    parser.add_argument("--write", action="store_true", help="write docs/published.md")
    parser.add_argument("--proofs", type=Path, metavar="FOLDER", help="write a .proof of each row that has one")
    given = parser.parse_args(arguments)
    if given.proofs is not None:
        given.proofs.mkdir(parents=True, exist_ok=True)
    found = list(lines_of([row for row in ROWS if not given.names or row.name in given.names], given.proofs))
    counts = {said: sum(one[2] == said for one in found) for said in ("confirmed", "corrected", "unexplained")}
    summary = ", ".join(f"{count} {said}" for said, count in counts.items())
    lines = table(found)
    print("\n".join([*lines, "", summary]))
    if given.write and not given.names:
        head, _, _ = PAGE.read_text(encoding="utf-8").partition("| row |")
        PAGE.write_text(head + "\n".join(lines) + f"\n\n{summary}.\n", encoding="utf-8")
    return int(counts["unexplained"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
