"""Dynamics of every class, each with a start, controls, and the next state by the definition."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import lin_freq_ocp as lfo
from helpers.linear_problems import VARYING, at_time, dynamics_data
from helpers.linear_problems import T as VARYING_T
from helpers.own_kinds import Bilinear, DelayedInput
from lin_freq_ocp.problem import Dynamics

T = VARYING_T
Step = Callable[[int, np.ndarray, np.ndarray], Any]  # from t, x_t and u_t to x_{t+1}


@dataclass(frozen=True)
class Instance:
    """Dynamics in a problem of T steps, with a trajectory by the definition."""

    dynamics: Dynamics
    x: np.ndarray  # (T+1, n)
    u: np.ndarray  # (T, m)
    fields: dict[str, object] = field(default_factory=dict)
    moves: Any = 1.0  # the controls (m,) that may change a little without another mode
    has_no_zero: bool = True  # whether states may be counted from elsewhere

    @property
    def problem(self) -> lfo.OptimalControlProblem:
        cost = lfo.QuadraticCost(Q=np.eye(self.x.shape[1]), R=0.1)
        return lfo.OptimalControlProblem(self.dynamics, T, cost, **self.fields)


def stepped(
    dynamics: Dynamics,
    step: Step,
    x_0: list[float],
    u: np.ndarray,
    moves: Any = 1.0,
    has_no_zero: bool = True,
    **fields: object,
) -> Instance:
    """Return an instance with the states of a recursion."""
    x = [np.array(x_0)]
    for t in range(T):
        x.append(np.asarray(step(t, x[-1], u[t]), dtype=float))
    return Instance(dynamics, np.array(x), u, {"initial_state": x_0} | fields, moves, has_no_zero)


def linear(varying: str) -> Instance:
    data, u = dynamics_data(25, varying), np.random.default_rng(26).normal(size=(T, 2))

    def step(t: int, x: np.ndarray, u: np.ndarray) -> list[float]:
        A, B, d = at_time(data["A"], t, 2), at_time(data["B"], t, 2), at_time(data["offset"], t, 1)
        return [sum(A[i, j] * x[j] for j in range(3)) + sum(B[i, j] * u[j] for j in range(2)) + d[i] for i in range(3)]

    return stepped(lfo.LinearDynamics(**data, sampling_time=0.1), step, [1.0, -2.0, 0.5], u)


def response(mode: str) -> Instance:
    """Return a response of random kernels that decay; its outputs are convolutions with the kernels of one record."""
    rng, N = np.random.default_rng(0), T if mode == "periodic" else 2 * T
    kernel = rng.standard_normal((N, 2, 3)) * np.exp(-np.arange(N) / 3)[:, None, None]
    u = rng.standard_normal((T, 3))
    x = np.array([sum(kernel[(t - s) % N] @ u[s] for s in range(T)) for t in range(T + 1)])
    return Instance(lfo.FrequencyResponse(np.fft.rfft(kernel, axis=0), mode=mode), x, u)


U = np.array([[0.7], [-0.4], [0.3], [-0.9], [0.2]])
A, B = np.array([[1.0, 0.2], [-0.1, 0.9]]), np.array([[0.0], [0.2]])
LEVELS = lfo.FiniteSet([-1, 0, 1])
WALL = [
    lfo.AffineMode([[1.0]], [[1.0]], G=[[-1.0]], h=[0.0], name="above"),
    lfo.AffineMode([[-0.5]], [[1.0]], G=[[1.0]], h=[0.0], name="below"),
]
DELAYED, BILINEAR = DelayedInput(A, B, 0.1), Bilinear(A, [[0.0, 0.1], [-0.1, 0.0]], B[:, 0])
TURNS = np.column_stack([[0.4, 0.3, 0.5, 0.2, 0.1], [1.0, -1.0, 1.0, 1.0, -1.0]])


def pulses(t: int, x: np.ndarray, u: np.ndarray) -> list[float]:
    """Return the state after a dwell: angle, level, its integral, its energy, and the first harmonic."""
    theta, level, current, energy, first = x
    tau, new = u[0], level + (0.5 if u[1] > 0 else -0.5)
    square = current**2 * tau + current * level * tau**2 + level**2 * tau**3 / 3
    wave = np.cos(theta) - np.cos(theta + tau)
    return [theta + tau, new, current + level * tau, energy + 4 / np.pi * square, first + 4 / np.pi * level * wave]


INSTANCES = {
    **{f"linear, varying {names or 'nothing'}": linear(names) for names in VARYING},
    "periodic response": response("periodic"),
    "response at rest": response("zero-padded"),
    "piecewise affine": stepped(
        lfo.PiecewiseAffineDynamics(WALL), lambda t, x, u: [(x[0] if x[0] >= 0 else -0.5 * x[0]) + u[0]], [0.2], U
    ),
    "piecewise smooth": stepped(
        lfo.PiecewiseSmoothDynamics.from_formulas(["sin(x_0) + max(u_0, x_0)", "x_1*u_0 + abs(x_0)"], 2, 1),
        lambda t, x, u: [np.sin(x[0]) + max(u[0], x[0]), x[1] * u[0] + abs(x[0])],
        [0.3, -0.5],
        U,
    ),
    "levels": stepped(
        lfo.LinearDynamics(A, B), lambda t, x, u: A @ x + B @ u, [1.0, 0.0], np.sign(U), 0.0, control_set=LEVELS
    ),
    "pulse train": stepped(
        lfo.dynamics.PulseTrain(0.5, [1]), pulses, [0.1, 0.5, 0.0, 0.0, 0.0], TURNS, np.array([1.0, 0.0]), False
    ),
    "delayed input of a user": stepped(DELAYED, lambda t, x, u: [*(A @ x[:2] + B @ x[2:]), *u], [1.0, -0.5, 0.0], U),
    "bilinear of a user": stepped(
        BILINEAR, lambda t, x, u: (BILINEAR.A + u[0] * BILINEAR.N) @ x + BILINEAR.B * u[0], [1.0, -0.5], U
    ),
}
