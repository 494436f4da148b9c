"""Impact and contact: a pendulum beside a wall, a cart and a cart with a pole between walls."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np

from lin_freq_ocp.base.arrays import brief, positive_integer, positive_number, to_shape
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.library.common import Spectrum, control_band, sum_of_squares, symmetric
from lin_freq_ocp.problem.hybrid.piecewise_affine import AffineMode, PiecewiseAffineDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem

GRAVITY, STIFFNESS, DAMPING = 10.0, 100.0, 30.0  # m/s^2; N/m and N s/m of the soft walls; all masses and lengths are 1
PENDULUM_WALL, WALL, HALF_WIDTH = 0.1, 0.5, 0.1  # m: of the pendulum; of the carts, from the middle; of the first cart
TIP = np.array([1.0, -1.0])  # the tip of the pole is q - theta to the right of the middle


def pendulum_with_wall(
    horizon: int = 6,
    sampling_time: float = 0.02,
    control_spectrum: Spectrum = None,
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

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    The plant is an example of T. Marcucci and R. Tedrake's on predictive control through contact; sampling time, bounds
    and weights are chosen here. Modes: "free" (angle <= 0.1), listed first, and "contact" (angle >= 0.1). Optima are
    listed in docs/hybrid_systems.md.

    Examples
    --------
    >>> lfo.library.pendulum_with_wall().horizon
    6
    """
    T, h = positive_integer("horizon", horizon), positive_number("sampling_time", sampling_time)
    return OptimalControlProblem(
        dynamics=PiecewiseAffineDynamics(
            [
                AffineMode([[1, h], [GRAVITY * h, 1]], [[0], [h]], G=[[1, 0]], h=[PENDULUM_WALL], name="free"),
                AffineMode(
                    [[1, h], [(GRAVITY - STIFFNESS) * h, 1]],
                    [[0], [h]],
                    [0, STIFFNESS * PENDULUM_WALL * h],
                    G=[[-1, 0]],
                    h=[-PENDULUM_WALL],
                    name="contact",
                ),
            ],
            sampling_time=h,
            state_names=["angle [rad]", "angular speed [rad/s]"],
            control_names=["torque [N m]"],
        ),
        horizon=T,
        cost=sum_of_squares(np.diag([100.0, 10.0]), np.eye(1), terminal_cost),
        control_set=symmetric("torque_bound", torque_bound),
        state_set=symmetric("state_bounds", state_bounds),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=control_band(control_spectrum, T),
        name="pendulum_with_wall",
    )


def cart_between_walls(
    horizon: int = 60,
    sampling_time: float = 0.01,
    restitution: float = 0.5,
    control_spectrum: Spectrum = None,
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

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    The plant, its numbers and this task are among the examples of pympc (github.com/TobiaMarcucci/pympc). Mass 1 kg,
    walls 0.5 m from the middle, half width of the cart 0.1 m. Modes: "free", listed first, "impact right", "impact
    left". No force brings this cart to rest before the wall: 2.5 m/s needs 0.6 m at 5 N.

    Examples
    --------
    >>> lfo.library.cart_between_walls().horizon
    60
    """
    T, h = positive_integer("horizon", horizon), positive_number("sampling_time", sampling_time)
    kept = float(to_shape("restitution", restitution, ()))
    if not 0 <= kept <= 1:
        raise ProblemError("restitution", brief(restitution), "a number from 0 to 1")
    reach = WALL - HALF_WIDTH
    ahead = np.array([1.0, h])
    impact = np.array([[1.0, 0.0], [0.0, -kept]])
    return OptimalControlProblem(
        dynamics=PiecewiseAffineDynamics(
            [
                AffineMode([[1, h], [0, 1]], [[0], [h]], G=[ahead, -ahead], h=[reach, reach], name="free"),
                AffineMode(impact, [[0], [0]], G=[-ahead], h=[-reach], name="impact right"),
                AffineMode(impact, [[0], [0]], G=[ahead], h=[-reach], name="impact left"),
            ],
            sampling_time=h,
            state_names=["position [m]", "speed [m/s]"],
            control_names=["force [N]"],
        ),
        horizon=T,
        cost=sum_of_squares(0.01 * np.eye(2), 0.01 * np.eye(1), terminal_cost),
        control_set=symmetric("force_bound", force_bound),
        state_set=symmetric("speed_bound", [reach, speed_bound]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=control_band(control_spectrum, T),
        name="cart_between_walls",
    )


def cart_pole_with_walls(
    horizon: int = 30,
    sampling_time: float = 0.05,
    control_spectrum: Spectrum = None,
    initial_state: Sequence[float] = (0.0, 0.0, 1.0, 0.0),
    terminal_state: Sequence[float] | None = None,
    terminal_cost: bool = True,
    state_bounds: Sequence[float] = (WALL, pi / 8, 2.0, 1.0),
    force_bound: float = 2.0,
    damping: float = DAMPING,
) -> OptimalControlProblem:
    """Balance a pole on a cart between two soft walls that may be used to push off.

    Minimise the sum of |x_t|^2/2 + u_t^2/20 (no other 1/2). Linearised at the top, with masses and length 1,
    q'' = 10 theta + u and theta'' = 20 theta + u + f_r - f_l, by forward Euler. With the penetration p_r = q - theta -
    0.5 of the right wall, f_r = max(0, 100 p_r + damping p_r') where p_r >= 0, else 0; likewise on the left, with p_l =
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
    damping : float
        Of the walls [N s/m].

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Marcucci and Tedrake, "Warm start of mixed-integer programs for model predictive control of hybrid systems", IEEE
    Transactions on Automatic Control 66(6), 2021; bounds, weights and horizon are chosen here. With p_r + p_l = -1 only
    one wall is touched at a time. Five modes: "right wall", "left wall" (penetrated, with force), listed first because
    the force counts at p = 0, then "free" (p_r <= 0, p_l <= 0), "leaving right", "leaving left" (penetrated, but moving
    away so fast that damping would pull: no force, the same map as "free"). The force jumps by damping p' where p = 0
    is crossed inwards: the two borders between "free" and a wall jump, the other borders are continuous.

    Examples
    --------
    >>> lfo.library.cart_pole_with_walls().horizon
    30
    """
    T, h = positive_integer("horizon", horizon), positive_number("sampling_time", sampling_time)
    damping = positive_number("damping", damping)
    into_right, into_left = np.append(TIP, [0.0, 0.0]), np.append(-TIP, [0.0, 0.0])
    push_right, push_left = np.append(STIFFNESS * TIP, damping * TIP), np.append(-STIFFNESS * TIP, -damping * TIP)
    rates = np.zeros((4, 4))  # of the cart and the pole without walls
    rates[0, 2] = rates[1, 3] = 1.0
    rates[2, 1], rates[3, 1] = GRAVITY, 2 * GRAVITY
    free, B = np.eye(4) + h * rates, h * np.array([[0.0], [0.0], [1.0], [1.0]])  # by forward Euler
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
        gain = sign * h * np.array([0.0, 0.0, 0.0, 1.0])
        modes.append(AffineMode(free + np.outer(gain, push), B, -pushed * gain, G=G, h=limits, name=name))
    return OptimalControlProblem(
        dynamics=PiecewiseAffineDynamics(
            modes,
            sampling_time=h,
            state_names=["position [m]", "angle [rad]", "speed [m/s]", "angular speed [rad/s]"],
            control_names=["force [N]"],
        ),
        horizon=T,
        cost=sum_of_squares(0.5 * np.eye(4), 0.05 * np.eye(1), terminal_cost),
        control_set=symmetric("force_bound", force_bound),
        state_set=symmetric("state_bounds", state_bounds),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=control_band(control_spectrum, T),
        name="cart_pole_with_walls",
    )
