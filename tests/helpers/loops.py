"""Problems of control loops for tests: what the condensed method takes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import lin_freq_ocp as lfo

NARROW = lfo.Box([-0.12, -0.06, -0.3, -1.0], [0.12, 0.06, 0.3, 1.0])


def pendulum(horizon: int, cutoff: float | None = 0.8 * np.pi, **fields) -> lfo.OptimalControlProblem:
    """Return the pendulum with a terminal cost in place of its end."""
    cost = lfo.QuadraticCost(Q=np.diag([1.0, 10.0, 0.1, 0.1]), R=0.1, P=np.diag([10.0, 100.0, 1.0, 1.0]))
    base = replace(lfo.library.pendulum(horizon=horizon, cutoff=cutoff), cost=cost, terminal_state=None)
    return replace(base, **fields)


LOOPS = {
    "low pass": lambda: pendulum(30),
    "rate limit": lambda: lfo.rate_limited(pendulum(20, None), 1.0, previous=0.0),
    "fixed end": lambda: pendulum(120, 0.5 * np.pi, terminal_state=np.zeros(4)),
    "two controls": lambda: lfo.library.mass_chain(horizon=20, terminal_state=None),
    "soft bounds": lambda: pendulum(30, state_set=lfo.sets.Soft(NARROW, 5.0)),
    "joint rows": lambda: pendulum(
        20, None, stage_rows=[lfo.StageRows([[0, 0, 1.0, 0]], [[0.1]], [0.6], name="power")]
    ),
    "offset": lambda: pendulum(20, dynamics=replace(pendulum(20).linear, offset=[0.0, 1e-3, 0.0, 2e-3])),
}


def states(problem: lfo.OptimalControlProblem, count: int, seed: int = 0) -> np.ndarray:
    """Return random states, small enough for most problems to have a solution, (count, n)."""
    rng, n = np.random.default_rng(seed), problem.state_dim
    size = np.resize([0.04, 0.02, 0.08, 0.15], n) if n < 8 else np.full(n, 0.3)
    found = size * rng.uniform(-1, 1, (count, n))
    if n == 5:
        found[:, -1] = 0.0  # the control before
    return found
