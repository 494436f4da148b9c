"""An inverted pendulum beside an elastic wall."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lin_freq_ocp.arrays import positive_integer, positive_number
from lin_freq_ocp.library.bounds import symmetric
from lin_freq_ocp.library.piecewise.hybrid import control_band, sum_of_squares
from lin_freq_ocp.problem.dynamics.piecewise_affine import AffineMode, PiecewiseAffineDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem

GRAVITY, STIFFNESS, WALL = 10.0, 100.0, 0.1  # m/s^2, N/m, m; mass 1 kg, length 1 m
STATE_WEIGHTS = np.diag([100.0, 10.0])


def pendulum_with_wall(
    horizon: int = 6,
    sampling_time: float = 0.02,
    control_spectrum: Any = None,
    initial_state: Sequence[float] = (0.08, 0.6),
    terminal_state: Sequence[float] | None = None,
    terminal_cost: bool = True,
    state_bounds: Sequence[float] = (0.2, 1.5),
    torque_bound: float = 4.0,
) -> OptimalControlProblem:
    """Catch an inverted pendulum that falls against an elastic wall, near upright.

    Minimise the sum of 100 angle^2 + 10 rate^2 + u_t^2 (no 1/2). Linearised at the top, with mass and length 1,
    angle'' = 10 angle + u - 100 max(0, angle - 0.1), by forward Euler. The wall pushes only: the map has a kink at the
    angle 0.1 and is continuous.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds: h of forward Euler.
    control_spectrum : band, list of bands, list of bins, "freq" or None
        Frequency constraints on the torque; "freq" removes the bins max(2, ceil(T/3)) <= k <= T//2.
    initial_state, terminal_state : (2,)
        Angle [rad] and its rate [rad/s]. A terminal_state of None is free.
    terminal_cost : bool
        Whether the state at T is in the cost, with the same weights.
    state_bounds : (2,)
        Symmetric bounds on the states.
    torque_bound : float
        Symmetric bound on the torque [N m].

    Notes
    -----
    The plant is an example of T. Marcucci and R. Tedrake's on predictive control through contact; sampling time, bounds
    and weights are chosen here. Modes: "free" (angle <= 0.1), listed first, and "contact" (angle >= 0.1). Optima are
    listed in docs/hybrid_systems.md.
    """
    T, h = positive_integer("horizon", horizon), positive_number("sampling_time", sampling_time)
    return OptimalControlProblem(
        dynamics=PiecewiseAffineDynamics(
            [
                AffineMode([[1, h], [GRAVITY * h, 1]], [[0], [h]], G=[[1, 0]], h=[WALL], name="free"),
                AffineMode(
                    [[1, h], [(GRAVITY - STIFFNESS) * h, 1]],
                    [[0], [h]],
                    [0, STIFFNESS * WALL * h],
                    G=[[-1, 0]],
                    h=[-WALL],
                    name="contact",
                ),
            ],
            sampling_time=h,
            state_names=["angle [rad]", "angular speed [rad/s]"],
            control_names=["torque [N m]"],
        ),
        horizon=T,
        cost=sum_of_squares(STATE_WEIGHTS, np.eye(1), terminal_cost),
        control_set=symmetric("torque_bound", torque_bound),
        state_set=symmetric("state_bounds", state_bounds),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=control_band(control_spectrum, T),
        name="pendulum_with_wall",
    )
