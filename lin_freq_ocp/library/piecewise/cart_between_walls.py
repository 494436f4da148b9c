"""A cart between two inelastic walls: impacts turn its speed at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lin_freq_ocp.arrays import brief, positive_integer, positive_number, shaped
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.library.bounds import symmetric
from lin_freq_ocp.library.piecewise.hybrid import control_band, sum_of_squares
from lin_freq_ocp.problem.dynamics.piecewise_affine import AffineMode, PiecewiseAffineDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem

MASS, RADIUS, WALL = 1.0, 0.1, 0.5  # kg, m, m from the middle
WEIGHT = 0.01


def cart_between_walls(
    horizon: int = 60,
    sampling_time: float = 0.01,
    restitution: float = 0.5,
    control_spectrum: Any = None,
    initial_state: Sequence[float] = (0.0, 2.5),
    terminal_state: Sequence[float] | None = (0.0, 0.0),
    terminal_cost: bool = True,
    speed_bound: float = 5.0,
    force_bound: float = 5.0,
) -> OptimalControlProblem:
    """Bring a fast cart to rest between two inelastic walls, with their help.

    Minimise 0.01 times the sum of |x_t|^2 + u_t^2 (no 1/2). Position q and speed v follow q+ = q + h v, v+ = v + h u;
    where q + h v would leave [-0.4, 0.4] the cart hits a wall within the step instead: q+ = q, v+ = -v/2, whatever the
    force. The map jumps at both borders, so that the maximum principle does not apply on them.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds: h.
    restitution : float
        Speed after an impact over speed before, from 0 to 1.
    control_spectrum : band, list of bands, list of bins, "freq" or None
        Frequency constraints on the force; "freq" removes the bins max(2, ceil(T/3)) <= k <= T//2.
    initial_state, terminal_state : (2,)
        Position [m] and speed [m/s]. A terminal_state of None is free.
    terminal_cost : bool
        Whether the state at T is in the cost, with the same weights.
    speed_bound, force_bound : float
        Symmetric bounds on speed [m/s] and force [N].

    Notes
    -----
    The plant, its numbers and this task are among the examples of pympc (github.com/TobiaMarcucci/pympc). Mass 1 kg,
    walls 0.5 m from the middle, half width of the cart 0.1 m. Modes: "free", listed first, "impact right", "impact
    left". No force brings this cart to rest before the wall: 2.5 m/s needs 0.6 m at 5 N.
    """
    T, h = positive_integer("horizon", horizon), positive_number("sampling_time", sampling_time)
    kept = float(shaped("restitution", restitution, ()))
    if not 0 <= kept <= 1:
        raise ProblemError("restitution", brief(restitution), "a number from 0 to 1")
    reach = WALL - RADIUS
    ahead = np.array([1.0, h])
    impact = np.array([[1.0, 0.0], [0.0, -kept]])
    return OptimalControlProblem(
        dynamics=PiecewiseAffineDynamics(
            [
                AffineMode([[1, h], [0, 1]], [[0], [h / MASS]], G=[ahead, -ahead], h=[reach, reach], name="free"),
                AffineMode(impact, [[0], [0]], G=[-ahead], h=[-reach], name="impact right"),
                AffineMode(impact, [[0], [0]], G=[ahead], h=[-reach], name="impact left"),
            ],
            sampling_time=h,
            state_names=["position [m]", "speed [m/s]"],
            control_names=["force [N]"],
        ),
        horizon=T,
        cost=sum_of_squares(WEIGHT * np.eye(2), WEIGHT * np.eye(1), terminal_cost),
        control_set=symmetric("force_bound", force_bound),
        state_set=symmetric("speed_bound", [reach, speed_bound]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=control_band(control_spectrum, T),
        name="cart_between_walls",
    )
