"""Random problems with smooth costs and time by formulas, and a check of their answers by differences alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.base import Array

STEP = 1e-5  # of central differences of the cost, which are right to 1e-9 or so of it
STATIONARY = 2e-5  # largest slope that is left, relative to the largest slope of the cost along the controls


def random_problem(seed: int) -> lfo.OptimalControlProblem:
    """Return a problem of up to three states: convex with linear dynamics for every third seed, else of any shape."""
    rng = np.random.default_rng(seed)
    n, m, T = int(rng.integers(1, 4)), int(rng.integers(1, 3)), int(rng.integers(4, 14))
    A, B = rng.normal(size=(n, n)), rng.normal(size=(n, m))
    A *= 0.9 / max(np.abs(np.linalg.eigvals(A)).max(), 0.5)
    convex, gains, weights = seed % 3 == 0, rng.uniform(0.5, 1.5, T), rng.uniform(0.2, 2.0, T)
    rows, offsets, kinds = rng.normal(size=(4, n + m)), 0.5 * rng.normal(size=4), rng.integers(0, 4, 4)

    def f(t: Any, x: Any, u: Any) -> list[Any]:
        forces = [t.look_up(gains) * one for one in u] if convex else [np.sin(one) for one in u]
        after = [sum(A[i, j] * x[j] for j in range(n)) + sum(B[i, j] * forces[j] for j in range(m)) for i in range(n)]
        return after if convex else [one + 0.2 * np.tanh(x[0]) * t.look_up(gains) for one in after]

    def part(k: int, x: Any, u: Any) -> Any:
        a = sum(rows[k, i] * one for i, one in enumerate([*x, *u])) + offsets[k]
        bowls = (lambda a: a**4, lambda a: np.exp(0.5 * a), lambda a: np.sqrt(1 + a**2), lambda a: a**2)
        waves = (lambda a: np.sin(a) ** 2, lambda a: np.arctan(a) ** 2, lambda a: a**4 - a**2, lambda a: np.cos(a))
        return (bowls if convex else waves)[kinds[k]](a)

    def stage(t: Any, x: Any, u: Any) -> Any:
        return t.look_up(weights) * part(0, x, u) + part(1, x, u) + 0.1 * part(2, x, u)

    def terminal(x: Any) -> Any:
        return part(3, x, [0.0] * m)

    cost = lfo.QuadraticCost(R=0.3, Q=0.1) + lfo.costs.SmoothCost(stage=stage, terminal=terminal)
    sets: dict[str, Any] = {"control_set": lfo.Box(-1.0, 0.8)}
    if seed % 2:
        sets = {"control_spectrum": lfo.low_pass(2.0)}
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(f, n, m)
    return lfo.OptimalControlProblem(dynamics, T, cost, initial_state=rng.normal(size=n), **sets)


def slope_left(problem: lfo.OptimalControlProblem, u: Array) -> float:
    """Return the largest slope of the cost along feasible directions of the controls, relative to all of its slopes.

    By central differences of the cost of simulated trajectories: of a box, steps into it; of a low pass, steps within
    its pass band.
    """
    start = problem.initial_box.lower

    def cost(u: Array) -> float:
        trajectory = lfo.simulate(problem, u, start)
        return problem.value(trajectory.x, trajectory.u)

    slopes = np.zeros_like(u)
    for index in np.ndindex(u.shape):
        change = np.zeros_like(u)
        change[index] = STEP
        slopes[index] = (cost(u + change) - cost(u - change)) / (2 * STEP)
    tube, largest = problem.control_tube, max(1.0, float(np.abs(slopes).max()))
    near = 1e-6
    slopes = np.where((u >= tube.upper - near) & (slopes < 0), 0.0, slopes)
    slopes = np.where((u <= tube.lower + near) & (slopes > 0), 0.0, slopes)
    spectrum = np.fft.rfft(slopes, axis=0)
    spectrum[problem.control_stop] = 0.0
    return float(np.abs(np.fft.irfft(spectrum, len(u), axis=0)).max()) / largest


@dataclass(frozen=True)
class Checked:
    """The answer of a random problem."""

    seed: int
    convex: bool
    status: str
    satisfied: bool
    cost: float
    left: float  # the slope that is left

    @property
    def passed(self) -> bool:
        """Whether the answer is accepted, and stationary by differences, too."""
        return self.satisfied and self.left <= STATIONARY


def check(seed: int) -> Checked:
    """Solve a random problem without a global bound, and check its answer."""
    problem = random_problem(seed)
    result = lfo.solve(problem, "nonsmooth", throw=False)
    satisfied = result.certificate is not None and result.certificate.pmp == "satisfied"
    left = slope_left(problem, result.trajectory.u) if satisfied else np.inf
    return Checked(seed, seed % 3 == 0, result.status, satisfied, result.cost, left)
