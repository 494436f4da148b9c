"""Problems of control loops: pendulums, a cart-pole between walls, random plants; bounds, bands and windows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import solve_discrete_are
from scipy.optimize import linprog

import lin_freq_ocp as lfo
from lin_freq_ocp.transform.hybrid.forms import piecewise_affine

ROUNDING = 1e-9  # of a linear program, by which a row may cut nothing off
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


def elastic_wall(horizon: int = 20, sampling_time: float = 0.01) -> lfo.OptimalControlProblem:
    """Return the pendulum beside an elastic wall of pympc's examples (hybrid_mpc), with its terminal polyhedron.

    Cost and set of x_T are those of the linear regulator without the wall: Riccati's, and the largest set from which it
    satisfies all bounds at all times, of 28 facets.
    """
    h, gravity, stiffness, wall = sampling_time, 10.0, 100.0, 0.1
    A, B = np.array([[1.0, h], [gravity * h, 1.0]]), np.array([[0.0], [h]])
    P = solve_discrete_are(A, B, np.eye(2), np.eye(1))
    K = -np.linalg.solve(np.eye(1) + B.T @ P @ B, B.T @ P @ A)
    rows = np.vstack([np.eye(2), -np.eye(2), K, -K])
    limits = np.array([wall, 1.5, 2 * wall, 1.5, 4.0, 4.0])
    at_wall = A - stiffness * h * np.array([[0.0, 0.0], [1.0, 0.0]])
    modes = [
        lfo.AffineMode(A, B, G=[[1, 0]], h=[wall], name="free"),
        lfo.AffineMode(at_wall, B, [0, stiffness * wall * h], G=[[-1, 0]], h=[-wall], name="contact"),
    ]
    return lfo.OptimalControlProblem(
        lfo.PiecewiseAffineDynamics(modes, sampling_time=h),
        horizon,
        lfo.QuadraticCost(np.eye(2), np.eye(1), P=P),
        control_set=lfo.Box(-4, 4),
        state_set=lfo.Box([-2 * wall, -1.5], [2 * wall, 1.5]),
        initial_state=[0.0, 0.8],
        terminal_state=lfo.sets.Polyhedron(*admissible_set(A + B @ K, rows, limits)),
    )


def admissible_set(A: np.ndarray, rows: np.ndarray, limits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest set of x_0 for which x_{t+1} = A x_t satisfies rows x_t <= limits at all times.

    Rows of later times are added until none of a whole step cuts anything off (Gilbert and Tan 1991); those that others
    imply are left out.
    """

    def largest(row: np.ndarray, matrix: np.ndarray, right: np.ndarray) -> float:
        found = linprog(-row, matrix, right, bounds=(None, None))
        return -found.fun if found.status == 0 else np.inf

    matrix, right, after = rows, limits, rows @ A
    while cuts := [i for i, row in enumerate(after) if largest(row, matrix, right) > limits[i] + ROUNDING]:
        matrix, right, after = np.vstack([matrix, after[cuts]]), np.append(right, limits[cuts]), after @ A
    kept = list(range(len(right)))
    for i in range(len(right)):
        others = [j for j in kept if j != i]
        if largest(matrix[i], matrix[others], right[others]) <= right[i] + ROUNDING:
            kept = others
    return matrix[kept], right[kept]


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
