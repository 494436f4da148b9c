"""Random smooth problems without bounds, some with saddles, several minima, or fixed ends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import lin_freq_ocp as lfo
from helpers.published import smooth_problem

KINDS = ("quadratic", "wells", "quartic", "fixed end")


def kind_of(seed: int) -> str:
    """Return the kind of a seed's problem."""
    return KINDS[seed % len(KINDS)]


def random_problem(seed: int) -> lfo.OptimalControlProblem:
    """Return the problem of a seed: up to three states, two controls and 15 steps.

    States follow a random linear map with sines, products and squares of states and controls that stay small. Costs are
    quadratic; those of the kinds "wells" (x^4/4 - x^2/2: rest is a saddle) and "quartic" are in a further state.
    """
    rng, kind = np.random.default_rng(seed), kind_of(seed)
    n, m, T = int(rng.integers(1, 4)), int(rng.integers(1, 3)), int(rng.integers(4, 16))
    A = rng.standard_normal((n, n)) / np.sqrt(n)
    A *= rng.uniform(0.6, 1.1) / np.abs(np.linalg.eigvals(A)).max()
    B, bend, push = rng.standard_normal((n, m)), rng.uniform(-0.5, 0.5, (n, n)), rng.uniform(-0.3, 0.3, n)
    u_weight, x_weights = float(rng.uniform(0.05, 1.0)), rng.uniform(0.1, 1.0, n)
    start = np.zeros(n) if kind == "wells" else rng.uniform(-1.5, 1.5, n)

    def f(x: Any, u: Any) -> Sequence[Any]:
        linear = [sum(A[i, j] * x[j] for j in range(n)) + sum(B[i, j] * u[j] for j in range(m)) for i in range(n)]
        sines = [sum(bend[i, j] * np.sin(x[j]) for j in range(n)) for i in range(n)]
        return [linear[i] + sines[i] + push[i] * np.sin(x[0]) * u[0] for i in range(n)]

    def wells(x: Any, u: Any) -> Any:
        states = sum(float(x_weights[i]) * (x[i] ** 4 / 4 - x[i] ** 2 / 2) for i in range(n))
        return states + u_weight * sum(u[j] ** 2 for j in range(m))

    def quartic(x: Any, u: Any) -> Any:
        states = sum(float(x_weights[i]) * (x[i] - 0.25) ** 4 for i in range(n))
        return states + u_weight * sum((u[j] - 0.5) ** 4 for j in range(m))

    if kind in ("wells", "quartic"):
        return smooth_problem(f, start, m, T, wells if kind == "wells" else quartic)
    ends = {"terminal_state": rng.uniform(-0.5, 0.5, n)} if kind == "fixed end" else {}
    return smooth_problem(f, start, m, T, Q=np.diag(x_weights), R=u_weight, **ends)
