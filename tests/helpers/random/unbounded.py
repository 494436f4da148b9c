"""Random convex problems without a finite optimum, and neighbours with one: ``random_unbounded(seed)``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import lin_freq_ocp as lfo


def random_unbounded(seed: int) -> tuple[lfo.OptimalControlProblem, lfo.OptimalControlProblem]:
    """Return a problem whose cost falls without bound along a free initial state, and one with bounds on it.

    The cost is linear in the states and curved in the controls. Some controls are bounded or zero, and a band may
    remove all of their bins.
    """
    rng = np.random.default_rng(seed)
    n, m, T = int(rng.integers(1, 5)), int(rng.integers(1, 3)), int(rng.integers(4, 24))
    A = rng.standard_normal((n, n))
    A *= rng.uniform(0.7, 1.0) / np.abs(np.linalg.eigvals(A)).max()
    reach, start = rng.uniform(0.5, 2.0, m) * rng.integers(0, 2, m), rng.standard_normal(n)
    far = rng.choice([0.0, 0.5, np.inf], n)  # x_0 is fixed, in an interval, or free
    far[0] = np.inf
    cost = lfo.QuadraticCost(
        R=np.diag(rng.uniform(0.1, 2.0, m)), q=rng.standard_normal(n), p=rng.standard_normal(n) * rng.integers(0, 2)
    )
    first = int(rng.integers(0, T // 2 + 1))
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, rng.standard_normal((n, m)), 0.1 * rng.standard_normal(n)),
        T,
        cost,
        control_set=lfo.Box(-reach, reach) if rng.random() < 0.7 else None,
        control_spectrum=lfo.stop_band(bins=range(first, T // 2 + 1)) if rng.random() < 0.5 else None,
        initial_state=lfo.Box(start - far, start + far),
    )
    near = np.minimum(far, 2.0)
    return problem, replace(problem, initial_state=lfo.Box(start - near, start + near))


def with_cost_times(problem: lfo.OptimalControlProblem, factor: float) -> lfo.OptimalControlProblem:
    """Return the problem with a multiple of its quadratic cost."""
    cost = problem.cost
    assert isinstance(cost, lfo.QuadraticCost)
    scaled = {field: factor * getattr(cost, field) for field in ("Q", "R", "S", "q", "r", "P", "p")}
    return replace(problem, cost=replace(cost, **scaled))
