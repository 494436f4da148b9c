"""Small piecewise-affine problems for tests: random continuous maps with one or two kinks, and simple known ones."""

from __future__ import annotations

from itertools import product

import numpy as np

import lin_freq_ocp as lfo


def kinked(rng, n=2, m=1, kinks=1):
    """Return modes of x+ = F y + c + sum_j g_j max(0, h_j'y - d_j), y = (x, u), with kinks near the origin."""
    F = np.hstack([np.linalg.qr(rng.normal(size=(n, n)))[0] * rng.uniform(0.6, 1.0), rng.normal(size=(n, m))])
    c = 0.1 * rng.normal(size=n)
    rows, limits, gains = (
        rng.normal(size=(kinks, n + m)),
        0.2 * rng.normal(size=kinks),
        0.7 * rng.normal(size=(kinks, n)),
    )
    modes = []
    for signs in product((0, 1), repeat=kinks):
        s = np.array(signs)
        maps, offset = F + (s[:, None, None] * gains[:, :, None] * rows[:, None]).sum(0), c - (s * limits) @ gains
        side = np.where(s, -1.0, 1.0)
        G, h = side[:, None] * rows, side * limits
        modes.append(lfo.AffineMode(maps[:, :n], maps[:, n:], offset, G=G[:, :n], H=G[:, n:], h=h))
    return lfo.PiecewiseAffineDynamics(modes)


def random_problem(seed, horizon=4, n=2, m=1, kinks=1, **fields):
    rng = np.random.default_rng(seed)
    dynamics = kinked(rng, n, m, kinks)
    given = {
        "cost": lfo.QuadraticCost(
            Q=np.diag(rng.uniform(0.1, 2, n)), R=np.diag(rng.uniform(0.1, 1, m)), P=np.eye(n), x_ref=rng.normal(size=n)
        ),
        "control_set": lfo.Box(np.full(m, -1.5), np.full(m, 1.5)),
        "state_set": lfo.Box(np.full(n, -4.0), np.full(n, 4.0)),
        "initial_state": rng.uniform(-1, 1, n),
    }
    return lfo.OptimalControlProblem(dynamics, horizon, **{**given, **fields})


def two_sides():
    """Return x+ = x + u from 0 over one step: a mode for x <= 1, and one of the same map for x >= 1."""
    sides = [lfo.AffineMode([[1.0]], [[1.0]], G=[[side]], h=[side]) for side in (1.0, -1.0)]
    given = {"control_set": lfo.Box(-1, 1), "state_set": lfo.Box(-2, 2), "initial_state": [0.0]}
    return lfo.OptimalControlProblem(lfo.PiecewiseAffineDynamics(sides), 1, lfo.QuadraticCost(R=1.0), **given)


def brute_force(problem):
    """Return the least cost over all mode sequences, each solved as a linear problem, and its sequence."""
    best, which = np.inf, None
    for sequence in product(range(len(problem.dynamics.modes)), repeat=problem.horizon):
        result = lfo.solve(problem.with_modes(sequence), method="convex", throw=False)
        if result.status == "optimal" and result.cost < best:
            best, which = result.cost, sequence
    return best, which
