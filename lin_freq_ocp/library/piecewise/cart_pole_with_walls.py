"""A cart with an inverted pole between two soft walls, which the pole may lean against."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from typing import Any

import numpy as np

from lin_freq_ocp.arrays import Array, positive_integer, positive_number
from lin_freq_ocp.library.bounds import symmetric
from lin_freq_ocp.library.piecewise.hybrid import control_band, sum_of_squares
from lin_freq_ocp.problem.dynamics.piecewise_affine import AffineMode, PiecewiseAffineDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem

CART_MASS, POLE_MASS, LENGTH, GRAVITY = 1.0, 1.0, 1.0, 10.0  # kg, kg, m, m/s^2
WALL, STIFFNESS, DAMPING = 0.5, 100.0, 30.0  # m from the middle, N/m, N s/m
STATE_WEIGHT, CONTROL_WEIGHT = 0.5, 0.05
TIP = np.array([1.0, -LENGTH])  # the tip of the pole is at q - l theta: what it is to the right of the middle


def cart_pole_with_walls(
    horizon: int = 30,
    sampling_time: float = 0.05,
    control_spectrum: Any = None,
    initial_state: Sequence[float] = (0.0, 0.0, 1.0, 0.0),
    terminal_state: Sequence[float] | None = None,
    terminal_cost: bool = True,
    state_bounds: Sequence[float] = (WALL, pi / 8, 2.0, 1.0),
    force_bound: float = 2.0,
) -> OptimalControlProblem:
    """Balance a pole on a cart between two soft walls that may be used to push off.

    Minimise the sum of |x_t|^2/2 + u_t^2/20 (no other 1/2). Linearised at the top, with masses and length 1,
    q'' = 10 theta + u and theta'' = 20 theta + u + f_r - f_l, by forward Euler. With the penetration p_r = q - theta -
    0.5 of the right wall, f_r = max(0, 100 p_r + 30 p_r') where p_r >= 0, else 0; likewise on the left, with p_l =
    -q + theta - 0.5.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds: h of forward Euler.
    control_spectrum : band, list of bands, list of bins, "freq" or None
        Frequency constraints on the force; "freq" removes the bins max(2, ceil(T/3)) <= k <= T//2.
    initial_state, terminal_state : (4,)
        Position q [m], angle theta [rad], speed [m/s], angular speed [rad/s]. A terminal_state of None is free.
    terminal_cost : bool
        Whether the state at T is in the cost, with the same weights.
    state_bounds : (4,)
        Symmetric bounds on the states.
    force_bound : float
        Symmetric bound on the force [N] on the cart.

    Notes
    -----
    Marcucci and Tedrake, "Warm start of mixed-integer programs for model predictive control of hybrid systems", IEEE
    Transactions on Automatic Control 66(6), 2021; bounds, weights and horizon are chosen here. With p_r + p_l = -1 only
    one wall is touched at a time. Five modes: "right wall", "left wall" (penetrated, with force), listed first because
    the force counts at p = 0, then "free" (p_r <= 0, p_l <= 0), "leaving right", "leaving left" (penetrated, but moving
    away so fast that damping would pull: no force, the same map as "free"). The force jumps by 30 p' where p = 0 is
    crossed inwards: the two borders between "free" and a wall jump, the other borders are continuous.
    """
    T, h = positive_integer("horizon", horizon), positive_number("sampling_time", sampling_time)
    into_right, into_left = np.append(TIP, [0.0, 0.0]), np.append(-TIP, [0.0, 0.0])
    push_right, push_left = np.append(STIFFNESS * TIP, DAMPING * TIP), np.append(-STIFFNESS * TIP, -DAMPING * TIP)
    free, B = _euler(h)
    pushed = STIFFNESS * WALL  # k p + nu p' = push x - k d, which is >= 0 iff push x >= k d
    regions = {
        "right wall": ([-into_right, -push_right], [-WALL, -pushed]),
        "left wall": ([-into_left, -push_left], [-WALL, -pushed]),
        "free": ([into_right, into_left], [WALL, WALL]),
        "leaving right": ([-into_right, push_right], [-WALL, pushed]),
        "leaving left": ([-into_left, push_left], [-WALL, pushed]),
    }
    forces = {"right wall": (push_right, 1.0), "left wall": (push_left, -1.0)}
    modes: list[AffineMode] = []
    for name, (G, limits) in regions.items():
        push, sign = forces.get(name, (np.zeros(4), 0.0))
        gain = sign * h / (POLE_MASS * LENGTH) * np.array([0.0, 0.0, 0.0, 1.0])
        modes.append(AffineMode(free + np.outer(gain, push), B, -pushed * gain, G=G, h=limits, name=name))
    return OptimalControlProblem(
        dynamics=PiecewiseAffineDynamics(
            modes,
            sampling_time=h,
            state_names=["position [m]", "angle [rad]", "speed [m/s]", "angular speed [rad/s]"],
            control_names=["force [N]"],
        ),
        horizon=T,
        cost=sum_of_squares(STATE_WEIGHT * np.eye(4), CONTROL_WEIGHT * np.eye(1), terminal_cost),
        control_set=symmetric("force_bound", force_bound),
        state_set=symmetric("state_bounds", state_bounds),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=control_band(control_spectrum, T),
        name="cart_pole_with_walls",
    )


def _euler(h: float) -> tuple[Array, Array]:
    """Return A and B of the cart and the pole without walls, by forward Euler."""
    rates = np.zeros((4, 4))
    rates[0, 2] = rates[1, 3] = 1.0
    rates[2, 1] = POLE_MASS * GRAVITY / CART_MASS
    rates[3, 1] = (CART_MASS + POLE_MASS) * GRAVITY / (CART_MASS * LENGTH)
    forces = np.array([[0.0], [0.0], [1 / CART_MASS], [1 / (CART_MASS * LENGTH)]])
    return np.eye(4) + h * rates, h * forces
