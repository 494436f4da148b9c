"""Margins of random systems against all extreme points of their loads, one by one, at every time."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

import lin_freq_ocp as lfo
from helpers.tubes import simulate

ROUNDING = 1e-9  # of margins, whose bounds of rounding are added


@dataclass(frozen=True)
class Outcome:
    """How far margins are from the largest values over all extreme points, relative to these."""

    seed: int
    below: float  # by which a margin is below the largest value
    away: float  # by which it differs from it
    unattained: float  # by which a simulation with the returned loads does

    @property
    def passed(self) -> bool:
        """Whether margins are never below, and attained."""
        return self.below <= 1e-15 and max(self.away, self.unattained) <= ROUNDING


def random_case(seed: int):
    """Return a problem, loads with their extreme points, an input and a gain."""
    rng = np.random.default_rng(seed)
    n, m, k, T = (int(rng.integers(1, most)) for most in (5, 3, 3, 7))
    T = min(T, 4) if seed % 4 == 3 else T  # the bound of rounding of varying dynamics takes the worst of all times
    varying = (T,) if seed % 4 == 3 else ()
    A, B = 0.7 * rng.standard_normal((*varying, n, n)), rng.standard_normal((*varying, n, m))
    E = rng.standard_normal((*((T,) if seed % 8 == 7 else ()), n, k))
    K = None if seed % 5 == 0 else 0.3 * rng.standard_normal((m, n))
    if K is not None and not varying:
        shrunk = 1.0 / max(1.0, 1.05 * np.abs(np.linalg.eigvals(A + B @ K)).max())
        A, B = shrunk * A, shrunk * B
    lower, upper = -rng.random(k), rng.random(k)
    corners = np.array(list(product(*zip(lower, upper, strict=True))))
    samples = rng.standard_normal((4, k))
    box = np.vstack([np.eye(k), -np.eye(k)]), np.concatenate([upper, -lower])
    sets = [(lfo.Box(lower, upper), corners), (samples, samples), (lfo.sets.Polyhedron(*box), corners)]
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics(A, B), T, lfo.QuadraticCost(R=np.eye(m)))
    return problem, *sets[seed % 3], E, K, rng


def check(seed: int) -> Outcome:
    """Compare the margins of a random case with its largest values over all sequences of extreme points."""
    problem, loads, points, E, K, rng = random_case(seed)
    loop = lfo.Disturbance(loads, E, K).error_loop(problem)
    n, m, T = problem.state_dim, problem.control_dim, problem.horizon
    C, D = rng.standard_normal((2, n)), rng.standard_normal((2, m))
    margins = loop.margins(C, D)
    w = points[np.array(list(product(range(len(points)), repeat=T)))]
    rest = lfo.Trajectory(np.zeros((T + 1, n)), np.zeros((T, m)))
    x, u = simulate(problem, loop.K, rest, E, w)
    below, away, unattained = [], [], []
    for t in range(T):
        values = (x[:, t] @ C.T + u[:, t] @ D.T).max(axis=0)
        size = 1 + np.abs(values).max()
        below.append((values - margins[t]).max() / size)
        away.append(np.abs(margins[t] - values).max() / size)
        start, worst = loop.worst(C[0], D[0], t)
        assert not start.any()
        x_w, u_w = simulate(problem, loop.K, rest, E, worst[None])
        unattained.append(abs(x_w[0, t] @ C[0] + u_w[0, t] @ D[0] - margins[t, 0]) / size)
    return Outcome(seed, float(max(below)), float(max(away)), float(max(unattained)))
