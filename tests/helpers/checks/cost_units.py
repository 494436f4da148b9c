"""The unit of the cost, 1e-9 to 1e9, and a constant of 1e6 times its variation change no status, and no answer.

Quadratic costs have the constant as the price of a state that is always 1, costs by formulas in the formula.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.base import Array

CONSTANT = 1e6  # times the variation of the cost
KINDS = ("linear", "formulas", "smooth dynamics", "hybrid")
APART = 1e-6  # of the costs of two answers, relative to the variation of the cost
FORMULAS = (
    "(x_0 - 0.3)**2 + 0.37*u_0",
    "sqrt(1 + x_0**2) + 0.1*u_0**4",
    "exp(0.5*x_0) + exp(-x_0) + u_0**2",
    "x_0**4 - x_0**2 + 0.2*u_0**2",
    "sin(x_0)**2 + u_0 - 0.2*u_0**2",
    "cos(2*x_0) + 0.3*x_0*u_0 + 0.4*u_0**2",
)


@dataclass(frozen=True)
class Outcome:
    """The statuses in the unit 1, in another one, with a constant, and with both; how far the answers are apart."""

    seed: int
    kind: str
    unit: float
    statuses: tuple[str, ...]
    apart: float

    @property
    def passed(self) -> bool:
        """Whether all statuses are the first, and all answers cost the same."""
        return len(set(self.statuses)) == 1 and self.apart <= APART


def random_problem(seed: int, unit: float, constant: float) -> lfo.OptimalControlProblem:
    """Return a problem with its cost times ``unit``, and a constant in it before that."""
    rng, kind = np.random.default_rng([seed, 45]), KINDS[seed % len(KINDS)]
    n, T = int(rng.integers(1, 3)), int(rng.integers(2, 7))
    A, B = rng.standard_normal((n, n)), rng.choice([-1.0, 0.5, 1.0], (n, 1))
    A *= rng.choice([0.7, 1.0]) / np.abs(np.linalg.eigvals(A)).max()
    start, bound, formula = rng.uniform(-1, 1, n), float(rng.uniform(0.3, 1.0)), str(rng.choice(FORMULAS))
    if kind in ("linear", "hybrid"):
        return _with_constant_state(rng, kind, T, A, B, start, bound, unit, constant / T)
    dynamics: Any = lfo.LinearDynamics(A, B)
    if kind == "smooth dynamics":
        dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(
            lambda x, u: [sum(A[i, j] * np.sin(x[j]) for j in range(n)) + B[i, 0] * u[0] for i in range(n)], n, 1
        )
    cost = lfo.costs.SmoothCost(stage=f"{unit!r}*({constant / T!r} + {formula})")
    sets = {"control_set": lfo.Box(-bound, bound), "state_set": lfo.Box(np.full(n, -9.0), np.full(n, 9.0))}
    return lfo.OptimalControlProblem(dynamics, T, lfo.QuadraticCost() + cost, initial_state=start, **sets)


def _with_constant_state(
    rng: np.random.Generator,
    kind: str,
    T: int,
    A: Array,
    B: Array,
    start: Array,
    bound: float,
    unit: float,
    price: float,
) -> lfo.OptimalControlProblem:
    n = len(A)
    weights, reference = rng.uniform(0, 1, n), rng.standard_normal(n)

    def larger(M: Array) -> Array:
        return np.block([[M, np.zeros((n, 1))], [np.zeros((1, n)), 1.0]])

    dynamics: Any = lfo.LinearDynamics(larger(A), np.vstack([B, [[0.0]]]))
    if kind == "hybrid":
        across = np.append(rng.standard_normal(n), 0.0)
        other = larger(A + np.outer(0.7 * rng.standard_normal(n), across[:n]))
        sides = ((larger(A), across), (other, -across))
        dynamics = lfo.PiecewiseAffineDynamics(
            [lfo.AffineMode(M, np.vstack([B, [[0.0]]]), G=side[None], h=[0.0]) for M, side in sides]
        )
    cost = lfo.QuadraticCost(
        Q=unit * np.diag(np.append(weights, 0.0)),
        R=unit * rng.uniform(0.1, 1),
        q=unit * np.append(np.zeros(n), price),
        x_ref=np.append(reference, 0.0),
    )
    states = lfo.Box(np.append(np.full(n, -9.0), 1.0), np.append(np.full(n, 9.0), 1.0))
    return lfo.OptimalControlProblem(dynamics, T, cost, lfo.Box(-bound, bound), states, np.append(start, 1.0))


def check(seed: int) -> Outcome:
    """Solve a random problem in four ways."""
    rng, plain = np.random.default_rng([seed, 46]), random_problem(seed, 1.0, 0.0)
    unit = float(10.0 ** rng.uniform(-9, 9))
    bound = plain.control_tube.upper[0, 0]

    def value(u: Array) -> float:
        trajectory = lfo.simulate(plain, u)
        return plain.value(trajectory.x, trajectory.u)

    values = [value(rng.uniform(-bound, bound, (plain.horizon, 1))) for _ in range(5)]
    constant = CONSTANT * (max(values) - min(values))
    options = {} if KINDS[seed % len(KINDS)] in ("linear", "hybrid") else {"global_bound": False}  # which takes seconds
    statuses, costs = list[str](), list[float]()
    for changes in ((1.0, 0.0), (unit, 0.0), (1.0, constant), (unit, constant)):
        result = lfo.solve(random_problem(seed, *changes), throw=False, **options)
        statuses.append(str(result.status))
        costs.append(np.inf if result.trajectory is None else value(result.control))
    apart = (max(costs) - min(costs)) / (max(values) - min(values)) if np.isfinite(costs).all() else 0.0
    return Outcome(seed, KINDS[seed % len(KINDS)], unit, tuple(statuses), apart)
