"""The pendulum on a cart: Example 1 of the paper, completed where it leaves data out."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np

from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.library.bounds import symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.bands import low_pass

CART_MASS, PENDULUM_MASS, HALF_LENGTH, GRAVITY = 2.5, 0.6, 0.25, 9.8  # kg, kg, m, m/s^2


def pendulum(
    horizon: int = 240,
    sampling_time: float = 0.01,
    parameters: str = "paper",
    cutoff: float | None = 0.8 * pi,
    initial_state: Sequence[float] = (-0.15, 0.1, 0.0, 0.0),
    terminal_state: Sequence[float] | None = (0.15, -0.1, 0.0, 0.0),
    state_bounds: Sequence[float | None] = (0.2, 20 * pi / 180, 15.0, 30.0),
    control_bound: float | None = 5.0,
) -> OptimalControlProblem:
    """Move a cart with an inverted pendulum by a low-passed force: Example 1 of the paper.

    Minimise the sum of u_t^2 (the paper's cost, without 1/2).

    Parameters
    ----------
    horizon : int
        T; the paper's 240.
    sampling_time : float
        Seconds. The paper's printed matrices have 0.01 (its text says 0.1).
    parameters : {"paper", "physical"}
        How the paper's denominator m + M - (m^2 l^2/J + m l^2) is read: literally, as its own matrices do, or as
        the physics has it, m + M - m^2 l^2/(J + m l^2).
    cutoff : float or None
        Low-pass cut-off of the force in rad/sample (4 pi/5 in the paper, itself passed); None: no frequency constraint.
    initial_state, terminal_state : (4,)
        Position [m], angle [rad], speed [m/s], angular speed [rad/s]. The paper gives none; these show all that its
        Figure 3 claims. A terminal_state of None is free.
    state_bounds : (4,)
        Symmetric bounds on the states.
    control_bound : float or None
        Symmetric bound on the force [N].
    """
    return OptimalControlProblem(
        dynamics=LinearDynamics.from_continuous(
            *_continuous_model(parameters),
            sampling_time,
            state_names=["position [m]", "angle [rad]", "speed [m/s]", "angular speed [rad/s]"],
            control_names=["force [N]"],
        ),
        horizon=horizon,
        cost=QuadraticCost(R=2.0),  # sum of u_t^2: the paper's cost has no 1/2
        control_set=symmetric("control_bound", control_bound),
        state_set=symmetric("state_bounds", state_bounds),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=None if cutoff is None else low_pass(cutoff),
        name="pendulum",
    )


def _continuous_model(parameters: str) -> tuple[np.ndarray, np.ndarray]:
    M, m, length = CART_MASS, PENDULUM_MASS, HALF_LENGTH
    J = 4 / 3 * m * length**2
    pivot = J + m * length**2
    if parameters == "paper":
        mass = m + M - ((m * length) ** 2 / J + m * length**2)
    elif parameters == "physical":
        mass = m + M - (m * length) ** 2 / pivot
    else:
        raise ProblemError("parameters", repr(parameters), "'paper' or 'physical'")
    A, B = np.zeros((4, 4)), np.zeros((4, 1))
    A[0, 2] = A[1, 3] = 1
    A[2, 1] = -((m * length) ** 2) * GRAVITY / (pivot * mass)
    A[3, 1] = m * GRAVITY * length * (m + M) / (pivot * mass)
    B[2, 0] = 1 / mass
    B[3, 0] = -m * length / (pivot * mass)
    return A, B
