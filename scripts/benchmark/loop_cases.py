"""Problems of control loops: the pendulum, a cart-pole between walls, random plants; bounds, bands and windows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import solve_discrete_are

import lin_freq_ocp as lfo
from lin_freq_ocp.problem.hybrid.forms import piecewise_affine

ARRIVAL = np.diag([10.0, 100.0, 1.0, 1.0])  # the pendulum's terminal weights


def pendulum(horizon: int, low_pass: bool = False) -> lfo.OptimalControlProblem:
    """Return the pendulum with a terminal cost in place of its end, with its bounds and, if asked, its low pass."""
    base = lfo.library.pendulum(horizon=horizon)
    cost = lfo.QuadraticCost(Q=np.diag([1.0, 10.0, 0.1, 0.1]), R=0.1, P=ARRIVAL)
    spectrum = base.control_spectrum if low_pass else None
    return replace(base, cost=cost, terminal_state=None, control_spectrum=spectrum)


def cart_pole(horizon: int = 20, sampling_time: float = 0.05) -> lfo.OptimalControlProblem:
    """Return the cart with a pole between soft walls of Marcucci and Tedrake (IEEE TAC 66(6), 2021), section VII."""
    base = lfo.library.cart_pole_with_walls(
        horizon, sampling_time, damping=10.0, state_bounds=(0.5, np.pi / 10, 1.0, 1.0), force_bound=1.0
    )
    free = next(mode.linear for mode in piecewise_affine(base).modes if mode.name == "free")
    Q, R = sampling_time**2 * np.eye(4), sampling_time**2 * np.eye(1)
    return replace(base, cost=lfo.QuadraticCost(Q, R, P=solve_discrete_are(free.A, free.B, Q, R)))


def soft_pendulum(horizon: int) -> lfo.OptimalControlProblem:
    """Return the pendulum with its low pass, and soft bounds on the states that its first half second exceeds."""
    narrow = lfo.Box([-0.12, -0.06, -0.3, -1.0], [0.12, 0.06, 0.3, 1.0])
    return replace(pendulum(horizon, low_pass=True), state_set=lfo.sets.Soft(narrow, 5.0))


def windowed(horizon: int) -> lfo.OptimalControlProblem:
    """Return a double integrator with bounded windows of its control."""
    mask = lfo.MagnitudeBound(0.4, band=lfo.low_pass(1.2), window="hann")
    dynamics = lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]], sampling_time=0.1)
    return lfo.OptimalControlProblem(
        dynamics,
        horizon,
        lfo.QuadraticCost(Q=np.diag([1.0, 0.1]), R=0.1, P=np.diag([10.0, 5.0])),
        control_set=lfo.Box(-1, 1),
        initial_state=[1.0, 0.0],
        control_spectrum=lfo.spectrum.Spectrogram(mask, length=16, hop=4, past=np.zeros((16, 1))),
    )


def random_plant(seed: int, horizon: int) -> lfo.OptimalControlProblem:
    """Return a random stable or slightly unstable plant with bounds on controls and states."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 5)), int(rng.integers(1, 3))
    A = rng.standard_normal((n, n))
    A *= rng.uniform(0.7, 1.05) / np.abs(np.linalg.eigvals(A)).max()
    units = 10.0 ** rng.uniform(-3, 3, n)
    dynamics = lfo.LinearDynamics(units[:, None] * A / units, units[:, None] * rng.standard_normal((n, m)))
    weights = rng.uniform(0.1, 1.0, n) / units**2
    return lfo.OptimalControlProblem(
        dynamics,
        horizon,
        lfo.QuadraticCost(Q=np.diag(weights), R=0.1, P=np.diag(10 * weights)),
        control_set=lfo.Box(-0.5, 0.5),
        state_set=lfo.Box(-3 * units, 3 * units),
        initial_state=units * rng.uniform(-1, 1, n),
    )
