"""The equations behind the piecewise-affine problems of the library, written once more and without modes."""

from __future__ import annotations

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp import library


def switched_rotation(x, u):
    c, s = np.cos(np.pi / 3), np.sin(np.pi / 3) * (1 if x[0] >= 0 else -1)
    return [0.8 * (c * x[0] - s * x[1]), 0.8 * (s * x[0] + c * x[1]) + u[0]]


def pendulum_with_wall(x, u):
    return x + 0.02 * np.array([x[1], 10 * x[0] - 100 * max(0.0, x[0] - 0.1) + u[0]])


def buck_affine(x, u):
    a = np.exp(-0.5)
    excess = x[0] - ((1 - u[0] / 2) / a + u[0] / 2)
    return [1 + min(a * excess, -2 * a / 0.35 * excess)]


def cart_between_walls(x, u):
    ahead = x[0] + 0.01 * x[1]
    return [x[0], -x[1] / 2] if abs(ahead) > 0.4 else [ahead, x[1] + 0.01 * u[0]]


def cart_pole_with_walls(x, u):
    def force(penetration, rate):
        return max(0.0, 100 * penetration + 30 * rate) if penetration >= 0 else 0.0

    tip, rate = x[0] - x[1], x[2] - x[3]
    right, left = force(tip - 0.5, rate), force(-tip - 0.5, -rate)
    return x + 0.05 * np.array([x[2], x[3], 10 * x[1] + u[0], 20 * x[1] + u[0] + right - left])


def ball_and_paddle(x, u, h=0.05, m=1.0, r=0.1, mu=0.2):
    j, place, speed = 0.4 * m * r**2, x[:5], x[5:] + h * np.array([0, -10, 0, *u])

    def hit(normal, slip, side):
        tangential = np.clip(-slip / (1 / m + r**2 / j), -mu * normal, mu * normal)
        speed[:3] += tangential / m, side * normal / m, side * r * tangential / j

    free = place + h * speed
    if free[1] < free[4]:
        hit(m * (free[4] - free[1]) / h, speed[0] + r * speed[2] - speed[3], 1)
    elif free[1] > 0.2:
        hit(m * (free[1] - 0.2) / h, speed[0] - r * speed[2], -1)
    return np.concatenate([place + h * speed, speed])


STEPS = {
    "absolute_value": lambda x, u: np.abs(x) + u,
    "max_min_network": lambda x, u: np.maximum(np.minimum(x, -u), u - x),
    "switched_rotation": switched_rotation,
    "pendulum_with_wall": pendulum_with_wall,
    "buck_affine": buck_affine,
    "cart_between_walls": cart_between_walls,
    "cart_pole_with_walls": cart_pole_with_walls,
    "ball_and_paddle": ball_and_paddle,
}
ALWAYS = {"max_min_network": {"load_first": False}}  # what makes the map the same at all times


def single_step(name: str) -> lfo.OptimalControlProblem:
    return library.by_name(name)(horizon=1, control_spectrum=None, **ALWAYS.get(name, {}))


def random_points(problem: lfo.OptimalControlProblem, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    boxes = problem.state_boxes, problem.control_tube
    x, u = (rng.uniform(box.lower[0], box.upper[0], size=(count, box.lower.shape[1])) for box in boxes)
    return x, u


def outside(problem: lfo.OptimalControlProblem, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return by how much (x, u) breaks the rows of each region, (points, modes); a map that does not depend on time."""
    arrays = problem.dynamics.arrays(1)
    G, H, h = arrays.G[0], arrays.H[0], arrays.h[0]
    return np.max(np.einsum("kri,pi->pkr", G, x) + np.einsum("kri,pi->pkr", H, u) - h, axis=2)


def successors(problem: lfo.OptimalControlProblem, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return where the modes lead, (points, n)."""
    arrays = problem.dynamics.arrays(1)
    A, B, offset = arrays.A[0], arrays.B[0], arrays.offset[0]
    modes = outside(problem, x, u).argmin(axis=1)
    return np.einsum("pij,pj->pi", A[modes], x) + np.einsum("pij,pj->pi", B[modes], u) + offset[modes]
