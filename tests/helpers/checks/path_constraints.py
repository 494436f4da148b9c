"""Random problems with path constraints, and a check of the conditions of their answers by differences alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.base import Array

STEP = 1e-5  # of central differences of the Lagrangian
STATIONARY = 5e-5  # largest slope of the Lagrangian that is left, relative to the largest slope of the cost
ACTIVE = 1e-3  # multipliers of inactive constraints are some 1e-8
WITHIN = 1e-6  # violation, and part of the cost that multipliers times slacks may be


@dataclass(frozen=True)
class RandomPath:
    """A random problem with its constraint as a function of numbers, h(t, x, u) <= 0."""

    problem: lfo.OptimalControlProblem
    h: Callable[[Any, Any, Any], list[Any]]
    convex: bool
    of_states: bool
    data: dict[str, Array]


def random_path(seed: int) -> RandomPath:
    """Return a problem of two or four states: convex for every third seed, else around an obstacle or a curved wall."""
    rng = np.random.default_rng(seed)
    axes, T, step = int(rng.integers(1, 3)), int(rng.integers(8, 16)), 0.2
    n, m, convex, kind = 2 * axes, axes, seed % 3 == 0, int(rng.integers(0, 3))
    A, B = np.eye(n) + step * np.eye(n, k=axes), np.vstack([step**2 / 2 * np.eye(m), step * np.eye(m)])
    start, end = np.append(-1 - rng.random(axes), np.zeros(axes)), np.append(1 + rng.random(axes), np.zeros(axes))
    middle, size = 0.3 * rng.normal(size=axes), rng.uniform(0.2, 0.5)
    speed = (1.2 + 0.2 * rng.random() + 0.2 * (seed % 5 == 0)) * np.linalg.norm((end - start)[:axes]) / (step * T)
    drift, slope = 0.1 * rng.normal(size=axes) / T, rng.uniform(0.5, 1.5, T)
    data = {"A": A, "B": B, "start": start, "end": end, "slope": slope, "size": np.array(speed)}

    def h(t: Any, x: Any, u: Any) -> list[Any]:
        if convex:  # limits on the speed and, for every other problem, on the force
            fast = sum(x[axes + i] ** 2 for i in range(axes)) - speed**2
            return [fast] if kind else [fast, sum(0.1 * one**4 for one in u) + 0.3 * u[0] - 1e4]
        apart = sum((x[i] - middle[i] - drift[i] * t) ** 2 for i in range(axes))
        if axes == 1 or kind == 0:  # a limit on the speed that depends on the position, or on the force
            return [x[axes] ** 2 - speed**2 * (1 + 0.3 * np.sin(2 * x[0] + 0.1 * t))]
        return [size**2 - apart] if kind == 1 else [size - np.sqrt(apart + 1e-6), np.cos(x[0]) - 1.4 - 0.3 * x[1]]

    def f(x: Any, u: Any) -> list[Any]:
        after = [sum(A[i, j] * x[j] for j in range(n)) + sum(B[i, j] * u[j] for j in range(m)) for i in range(n)]
        return [*after[:axes], *(one - 0.05 * step * np.sin(x[axes]) for one in after[axes:])]

    smooth = bool(seed % 4 == 1)
    cost: Any = lfo.QuadraticCost(R=1.0, Q=np.diag([0.1] * axes + [0.2] * axes))
    if smooth:
        cost = cost + lfo.costs.SmoothCost(stage=lambda t, x, u: t.look_up(slope) * np.exp(0.2 * u[0]))
    linear = convex or seed % 2 == 0
    dynamics: Any = lfo.LinearDynamics(A, B) if linear else lfo.PiecewiseSmoothDynamics.from_formulas(f, n, m)
    sets: dict[str, Any] = (
        {"control_set": lfo.Box(-40.0, 40.0)} if seed % 5 else {"control_spectrum": lfo.low_pass(2.5)}
    )
    rows = lfo.sets.PathConstraint(h, name="path")
    problem = lfo.OptimalControlProblem(
        dynamics, T, cost, initial_state=start, terminal_state=end, stage_rows=rows, **sets
    )
    of_states = problem.terms[0].shape[0] > T
    data |= {"smooth": np.array(smooth), "force": np.array(kind == 0)}
    return RandomPath(problem, h, convex, of_states, data)


def slope_left(random: RandomPath, result: Any) -> float:
    """Return the largest slope of the Lagrangian in the controls, relative to the slopes of the cost.

    By central differences along simulated trajectories, in single shooting: the multipliers of the path constraint and
    of the end are those of the answer, and slopes towards bounds and at removed bins do not count.
    """
    problem, u = random.problem, result.trajectory.u
    T, start, end = problem.horizon, problem.initial_box.lower, problem.terminal_box.lower
    prices, of_end = result.multipliers.stage["path"], result.multipliers.mu[-1]

    def lagrangian(u: Array) -> Array:
        trajectory = lfo.simulate(problem, u, start)
        x, total = trajectory.x, 0.0
        for t in range(T + random.of_states):
            total += float(prices[t] @ np.array(random.h(t, x[t], u[min(t, T - 1)]), dtype=float))
        cost = problem.value(x, u)
        return np.array([cost, cost + total + float(of_end @ (x[-1] - end))])

    slopes = np.zeros((2, *u.shape))
    for index in np.ndindex(u.shape):
        change = np.zeros_like(u)
        change[index] = STEP
        slopes[(slice(None), *index)] = (lagrangian(u + change) - lagrangian(u - change)) / (2 * STEP)
    tube, (of_cost, left) = problem.control_tube, slopes
    left = np.where((u >= tube.upper - WITHIN) & (left < 0), 0.0, left)
    left = np.where((u <= tube.lower + WITHIN) & (left > 0), 0.0, left)
    spectrum = np.fft.rfft(left, axis=0)
    spectrum[problem.control_stop] = 0.0
    return float(np.abs(np.fft.irfft(spectrum, T, axis=0)).max()) / max(1.0, float(np.abs(of_cost).max()))


@dataclass(frozen=True)
class Checked:
    """The answer of a random problem, with the worst violations of its conditions by numbers."""

    seed: int
    convex: bool
    status: str
    satisfied: bool
    cost: float
    gap: float  # not a number without a bound
    left: float  # the slope that is left
    violation: float
    active: bool  # whether a multiplier of the path constraint is not zero
    slackness: float  # multipliers times slacks, relative to the cost; infinite if a multiplier is negative

    @property
    def passed(self) -> bool:
        """Whether the answer is accepted, and its conditions hold by differences; a convex one has a bound."""
        holds = self.left <= STATIONARY and self.violation <= WITHIN and self.slackness <= WITHIN
        return self.satisfied and holds and (not self.convex or self.status == "optimal")


def check(seed: int) -> Checked:
    """Solve a random problem without a search for a global bound, and check its answer."""
    random = random_path(seed)
    method = "auto" if random.convex else "nonsmooth"
    result = lfo.solve(random.problem, method, throw=False)
    satisfied = result.certificate is not None and result.certificate.pmp == "satisfied"
    if not satisfied:
        return Checked(seed, random.convex, result.status, False, np.nan, np.nan, np.inf, np.inf, False, np.inf)
    x, u, prices = result.trajectory.x, result.trajectory.u, result.multipliers.stage["path"]
    times = range(len(prices))
    values = np.array([random.h(t, x[t], u[min(t, len(u) - 1)]) for t in times], dtype=float)
    slack = float(np.abs(prices * values).sum()) / max(1.0, abs(result.cost))
    slack = np.inf if prices.min() < 0 else slack
    gap = np.nan if result.gap is None else float(result.gap)
    violation = float(np.maximum(values, 0.0).max())
    left = slope_left(random, result)
    active, cost = bool(prices.max() > ACTIVE), float(result.cost)
    return Checked(seed, random.convex, result.status, True, cost, gap, left, violation, active, slack)


def cost_by_cvxpy(random: RandomPath) -> float:
    """Return the optimal cost of a convex problem with a quadratic cost by CVXPY's own atoms."""
    import cvxpy as cp  # slow to import

    data, T = random.data, random.problem.horizon
    axes = data["B"].shape[1]
    x, u = cp.Variable((2 * axes, T + 1)), cp.Variable((axes, T))
    fast = cp.sum(cp.square(x[axes:]), axis=0) <= data["size"] ** 2
    limits = [fast, x[:, 0] == data["start"], x[:, T] == data["end"]]
    limits += [x[:, t + 1] == data["A"] @ x[:, t] + data["B"] @ u[:, t] for t in range(T)]
    if data["force"]:
        limits.append(0.1 * cp.sum(cp.power(u, 4), axis=0) + 0.3 * u[0] <= 1e4)
    if random.problem.control_stop.any():
        kernel = np.exp(-2j * np.pi * np.outer(np.arange(T // 2 + 1), np.arange(T)) / T)
        for i in range(axes):
            rows = kernel[random.problem.control_stop[:, i]]
            limits += [rows.real @ u[i] == 0, rows.imag @ u[i] == 0]
    else:
        limits.append(cp.abs(u) <= 40.0)
    weights = np.append(0.1 * np.ones(axes), 0.2 * np.ones(axes))
    cost = 0.5 * (cp.sum_squares(u) + cp.sum(weights[:, None].T @ cp.square(x[:, :T])))
    return float(cp.Problem(cp.Minimize(cost), limits).solve(solver="CLARABEL"))
