"""A ball between a paddle and a ceiling, to be turned by friction: contact by time-stepping, with Coulomb's law.

The ball (mass m, radius r, inertia j) has the position (x_b, y_b) and the angle theta, counterclockwise; the paddle has
(x_p, y_p) and is moved by its accelerations u. Heights are measured so that the ball touches the paddle where
y_b = y_p, and the ceiling where y_b = d - 2 r: d is the gap between paddle and ceiling when y_p = 0. One step of length
h takes the velocities first, with the impulses of a contact, normal N >= 0 and tangential P, and then the positions
with the new velocities. Without contact the velocities x', y', theta' of the ball become x', y' - h g, theta', and
those of the paddle x_p' + h u_x, y_p' + h u_y. Let, after this free step,

    gap_p = y_b - y_p,   gap_c = d - 2 r - y_b,   slip_p = x' + r theta' - x_p',   slip_c = x' - r theta'.         (1)

If a gap would be negative there is an impulse, which closes it: N = -m gap/h (the impact is perfectly inelastic). It
acts on the ball as x' += P/m, and on the paddle y' += N/m, theta' += r P/j, at the ceiling y' -= N/m, theta' -= r P/j;
the paddle is driven and does not feel it. The slip then becomes slip + (1/m + r^2/j) P, and Coulomb's law says

    stick         P = P_0 = -slip / (1/m + r^2/j)   if |P_0| <= mu N,
    slide right   P = -mu N                         if P_0 <= -mu N,
    slide left    P = +mu N                         if P_0 >= mu N.                                               (2)

N and P are affine in (x, u), so this is a piecewise-affine map, and it is continuous: P is P_0 clipped to [-mu N, mu N]
and N is max(0, -m gap/h).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np

from lin_freq_ocp.arrays import Array, positive_integer, positive_number
from lin_freq_ocp.library.common import Spectrum, control_band, flag, sum_of_squares, symmetric
from lin_freq_ocp.problem.dynamics.piecewise_affine import AffineMode, PiecewiseAffineDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.convex import Polyhedron

MASS, RADIUS, GRAVITY, FRICTION = 1.0, 0.1, 10.0, 0.2  # kg, m, m/s^2, none
INERTIA = 0.4 * MASS * RADIUS**2  # kg m^2
GAP, HALF_WIDTH = 0.4, 0.3  # m: d between paddle at rest and ceiling; of the paddle
CLEARANCE = GAP - 2 * RADIUS
BY_IMPULSE = 1 / MASS + RADIUS**2 / INERTIA  # 1/kg: slip made by a tangential impulse
STATE_WEIGHTS = np.diag([1.0, 1.0, 0.01, 1.0, 1.0, 1.0, 1.0, 0.01, 1.0, 1.0])
CONTROL_WEIGHTS = np.diag([0.01, 0.001])
STATES, CONTROLS = 10, 2


def ball_and_paddle(
    horizon: int = 20,
    sampling_time: float = 0.05,
    keep_over_paddle: bool = True,
    control_spectrum: Spectrum = None,
    initial_state: Sequence[float] = (0.0, 0.0, pi, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    terminal_state: Sequence[float] | None = (0.0,) * STATES,
    terminal_cost: bool = True,
    state_bounds: Sequence[float] = (0.3, 0.2, 1.2 * pi, 0.3, 0.15, 2.0, 2.0, 10.0, 2.0, 2.0),
    acceleration_bounds: Sequence[float] = (30.0, 30.0),
) -> OptimalControlProblem:
    """Turn a ball by half a turn between a paddle and a ceiling, by stick and slip: a hard one.

    Minimise the sum of x_t'Q x_t + u_t'R u_t (no 1/2), Q = diag(1, 1, 0.01, 1, 1, 1, 1, 0.01, 1, 1), R = diag(0.01,
    0.001), from an angle of pi to rest in the middle, at an angle of zero.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds: h of the time-stepping.
    keep_over_paddle : bool
        Whether |x_b - x_p| <= 0.3 m, the half width of the paddle, at all times; without, the paddle has no end.
    control_spectrum : band, list of bands, list of bins, "freq" or None
        Frequency constraints on the accelerations; "freq" removes the bins max(2, ceil(T/3)) <= k <= T//2.
    initial_state, terminal_state : (10,)
        x and y [m] and angle [rad] of the ball, x and y [m] of the paddle, then their rates in the same order. A
        terminal_state of None is free.
    terminal_cost : bool
        Whether x_T'Q x_T is in the cost.
    state_bounds : (10,)
        Symmetric bounds on the states.
    acceleration_bounds : (2,)
        Symmetric bounds on the accelerations of the paddle in x and y [m/s^2].

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Marcucci and Tedrake, "Mixed-integer formulations for optimal control of piecewise-affine systems", Hybrid Systems:
    Computation and Control, 2019. Numbers, states, weights and bounds are theirs. The paper prints no matrices; those
    here are derived in this module, and the contact law agrees with that of the paper's public code
    (github.com/TobiaMarcucci/pympc) but in three points. (a) There the regions leave out the ball squeezed between
    paddle and ceiling; regions must cover the bounds here, and the paddle comes first. So the map jumps between
    contacts with the paddle and with the ceiling, where y_b+ = y_p+ > 0.2 m, which the bounds exclude. (b) There the
    ball must be over the paddle only while they touch; a constraint of some modes only would leave a gap in the
    regions, so ``keep_over_paddle`` demands it at all times. (c) There friction at the ceiling drives a sliding ball
    on, so that regions overlap; here it brakes.

    Modes: "free", then "stick", "slide right", "slide left" on the paddle, and the same at the ceiling; right and left
    say where the ball's lowest, or highest, point slides to.

    Examples
    --------
    >>> lfo.library.ball_and_paddle().horizon
    20
    """
    T, h = positive_integer("horizon", horizon), positive_number("sampling_time", sampling_time)
    bounds = symmetric("state_bounds", state_bounds)
    over = np.zeros((2, STATES))
    over[:, [0, 3]] = [[1.0, -1.0], [-1.0, 1.0]]
    ends = Polyhedron(over, [HALF_WIDTH, HALF_WIDTH])
    return OptimalControlProblem(
        dynamics=PiecewiseAffineDynamics(
            _modes(h),
            sampling_time=h,
            state_names=[
                *("ball x [m]", "ball y [m]", "angle [rad]", "paddle x [m]", "paddle y [m]"),
                *("ball speed x [m/s]", "ball speed y [m/s]", "angular speed [rad/s]"),
                *("paddle speed x [m/s]", "paddle speed y [m/s]"),
            ],
            control_names=["acceleration x [m/s^2]", "acceleration y [m/s^2]"],
        ),
        horizon=T,
        cost=sum_of_squares(STATE_WEIGHTS, CONTROL_WEIGHTS, terminal_cost),
        control_set=symmetric("acceleration_bounds", acceleration_bounds),
        state_set=bounds & ends if flag("keep_over_paddle", keep_over_paddle) else bounds,
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=control_band(control_spectrum, T),
        name="ball_and_paddle",
    )


def _modes(h: float) -> list[AffineMode]:
    rows = np.eye(STATES + CONTROLS + 1)  # coefficients of (x, u, 1)
    positions, velocities, one = rows[:5], rows[5:10].copy(), rows[-1]
    velocities[1] -= h * GRAVITY * one
    velocities[3] += h * rows[10]
    velocities[4] += h * rows[11]
    after = positions + h * velocities
    gap_paddle, gap_ceiling = after[1] - after[4], CLEARANCE * one - after[1]
    slip_paddle = velocities[0] + RADIUS * velocities[2] - velocities[3]
    slip_ceiling = velocities[0] - RADIUS * velocities[2]

    def mode(name: str, velocities: Array, region: list[Array]) -> AffineMode:
        """Return the step that ends with these velocities, where all rows of the region are <= 0."""
        A, B, offset = np.split(np.vstack([positions + h * velocities, velocities]), [STATES, -1], axis=1)
        G, H, constant = np.split(np.array(region), [STATES, -1], axis=1)
        return AffineMode(A, B, offset[:, 0], G, H, -constant[:, 0], name)

    modes = [mode("free", velocities, [-gap_paddle, -gap_ceiling])]
    for where, side, gap, slip, others in (
        ("on paddle", 1.0, gap_paddle, slip_paddle, []),
        ("at ceiling", -1.0, gap_ceiling, slip_ceiling, [-gap_paddle]),
    ):
        normal, stick = -MASS / h * gap, -slip / BY_IMPULSE
        limit = FRICTION * normal
        laws = {  # P, and the rows <= 0 of the region; those of stick imply that the gap is closed
            "stick": (stick, [stick - limit, -stick - limit]),
            "slide right": (-limit, [stick + limit, gap]),
            "slide left": (limit, [limit - stick, gap]),
        }
        for law, (tangential, region) in laws.items():
            changed = velocities.copy()
            changed[0] += tangential / MASS
            changed[1] += side * normal / MASS
            changed[2] += side * RADIUS * tangential / INERTIA
            modes.append(mode(f"{law} {where}", changed, [*region, *others]))
    return modes
