"""The double integrator of HiroIshida/robust-tube-mpc, and simulations under loads that know nothing of margins."""

from __future__ import annotations

from typing import Any

import numpy as np

import lin_freq_ocp as lfo

A, B = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.5], [1.0]])
FAR, NEAR = [-10.0, -2.0], [2.0, 2.0]


def tube(horizon: int = 10, **changes: Any) -> lfo.OptimalControlProblem:
    """Return the example, example_tubeMPC.m, whose loads are 0.15 in both states."""
    cost = lfo.QuadraticCost(Q=np.eye(2), R=0.1, P=3 * np.eye(2))
    fields = {"control_set": lfo.Box(-1, 1), "state_set": lfo.Box(FAR, NEAR), "initial_state": [-7.0, -2.0]}
    return lfo.OptimalControlProblem(lfo.LinearDynamics(A, B), horizon, cost, **(fields | changes))


def simulate(
    problem: lfo.OptimalControlProblem, K: np.ndarray, plan: lfo.Trajectory, E: np.ndarray, w: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return states and controls of u = v + K (x - z) for loads (cases, T, k), step by step."""
    x, u = [np.broadcast_to(plan.x[0], (len(w), problem.state_dim))], []
    for t in range(problem.horizon):
        A_t, B_t, d_t = problem.dynamics.at(t)
        E_t = E if E.ndim == 2 else E[t]
        u.append(plan.u[t] + (x[-1] - plan.x[t]) @ K.T)
        x.append(x[-1] @ A_t.T + u[-1] @ B_t.T + d_t + w[:, t] @ E_t.T)
    return np.stack(x, 1), np.stack(u, 1)


def excess(problem: lfo.OptimalControlProblem, x: np.ndarray, u: np.ndarray) -> float:
    """Return the largest violation of a bound after the start; negative inside."""
    of_x, of_u = problem.state_boxes, problem.control_tube
    over_x = np.maximum(of_x.lower - x, x - of_x.upper)[:, 1:].max()
    return float(max(over_x, np.maximum(of_u.lower - u, u - of_u.upper).max()))
