"""Smooth dynamics, sampled by one Runge-Kutta step: a pendulum, a cart with a pole, and a planar quadrotor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import pi

import numpy as np
from numpy.typing import NDArray

from lin_freq_ocp.base.arrays import positive_integer, positive_number
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.library.common import low_pass_at, symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box

GRAVITY = 9.81  # m/s^2

Signals = NDArray[np.object_]
Rates = Callable[[Sequence[Formula], Signals], Sequence[Formula]]


def _sampled_dynamics(rates: Rates, step: float, states: list[str], controls: list[str]) -> PiecewiseSmoothDynamics:
    """Return dx/dt = rates(x, u) over a period with constant u, by one step of the classical Runge-Kutta method."""

    def advance(x: Sequence[Formula], slope: Sequence[Formula], seconds: float) -> list[Formula]:
        return [a + seconds * b for a, b in zip(x, slope, strict=True)]

    def runge_kutta_step(x: Signals, u: Signals) -> list[Formula]:
        first = rates(list(x), u)
        second = rates(advance(list(x), first, step / 2), u)
        third = rates(advance(list(x), second, step / 2), u)
        fourth = rates(advance(list(x), third, step), u)
        slopes = zip(x, first, second, third, fourth, strict=True)
        return [state + (a + 2 * b + 2 * c + d) * (step / 6) for state, a, b, c, d in slopes]

    return PiecewiseSmoothDynamics.from_formulas(runge_kutta_step, len(states), len(controls), step, states, controls)


def pendulum_swing_up(
    horizon: int = 80,
    sampling_time: float = 0.05,
    cutoff_hz: float | None = None,
    torque_bound: float | None = 5.0,
    initial_state: Sequence[float] = (0.0, 0.0),
    terminal_state: Sequence[float] | None = (pi, 0.0),
    mass: float = 1.0,
    length: float = 1.0,
) -> OptimalControlProblem:
    """Swing a pendulum up with a torque too small to lift it at once.

    Minimise 1/2 sum of 0.1 u_t^2 + 0.05 (angle - pi)^2 + 0.01 rate^2. With the default bound, half of the torque that
    holds the pendulum level, it swings back first.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds.
    cutoff_hz : float or None
        Low-pass cut-off of the torque in Hz; None: no frequency constraint.
    torque_bound : float or None
        Symmetric bound on the torque [N m].
    initial_state, terminal_state : (2,)
        Angle from hanging [rad] and its rate [rad/s]. A terminal_state of None is free.
    mass, length : float
        Of a point mass [kg] on a massless rod [m].

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    Notes
    -----
    m L^2 angle'' = u - m g L sin(angle), g = 9.81 m/s^2. Weights and bounds are chosen here.

    Examples
    --------
    >>> lfo.library.pendulum_swing_up().horizon
    80
    """
    T, step = positive_integer("horizon", horizon), positive_number("sampling_time", sampling_time)
    L, m = positive_number("length", length), positive_number("mass", mass)

    def rates(x: Sequence[Formula], u: Signals) -> list[Formula]:
        return [x[1], u[0] / (m * L**2) - (GRAVITY / L) * x[0].sin()]

    return OptimalControlProblem(
        dynamics=_sampled_dynamics(rates, step, ["angle [rad]", "rate [rad/s]"], ["torque [N m]"]),
        horizon=T,
        cost=QuadraticCost(Q=np.diag([0.05, 0.01]), R=0.1, x_ref=[pi, 0.0]),
        control_set=symmetric("torque_bound", torque_bound),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=low_pass_at(cutoff_hz),
        name="pendulum_swing_up",
    )


def cart_pole(
    horizon: int = 80,
    sampling_time: float = 0.025,
    cutoff_hz: float | None = None,
    force_bound: float | None = 20.0,
    position_bound: float | None = 2.0,
    initial_state: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    terminal_state: Sequence[float] | None = (1.0, pi, 0.0, 0.0),
    cart_mass: float = 1.0,
    pole_mass: float = 0.3,
    length: float = 0.5,
) -> OptimalControlProblem:
    """Swing up the pole of a cart within two seconds while the cart moves by one metre.

    Minimise 1/2 sum of u_t^2 h, the integral of the squared force, h the sampling time.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds.
    cutoff_hz : float or None
        Low-pass cut-off of the force in Hz; None: no frequency constraint.
    force_bound, position_bound : float or None
        Symmetric bounds on the force [N] and the position [m].
    initial_state, terminal_state : (4,)
        Position [m], angle of the pole from hanging [rad], speed [m/s], rate [rad/s]. A terminal_state of None is free.
    cart_mass, pole_mass, length : float
        Masses [kg] of the cart and at the tip of the pole, and the pole's length [m].

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Kelly, "An introduction to trajectory optimization: how to do your own direct collocation", SIAM Review 59(4), 2017,
    sections 6 and appendix E: model, parameters, bounds, ends and cost; there by collocation, here sampled.

    Examples
    --------
    >>> lfo.library.cart_pole().horizon
    80
    """
    T, step = positive_integer("horizon", horizon), positive_number("sampling_time", sampling_time)
    M, m = positive_number("cart_mass", cart_mass), positive_number("pole_mass", pole_mass)
    L = positive_number("length", length)

    def rates(x: Sequence[Formula], u: Signals) -> list[Formula]:
        sine, cosine = x[1].sin(), x[1].cos()
        pull, moving = m * L * sine * x[3] ** 2 + u[0], 1 / (M + m * sine**2)
        return [
            x[2],
            x[3],
            (pull + m * GRAVITY * sine * cosine) * moving,
            -(pull * cosine + (M + m) * GRAVITY * sine) * moving / L,
        ]

    return OptimalControlProblem(
        dynamics=_sampled_dynamics(
            rates, step, ["position [m]", "angle [rad]", "speed [m/s]", "rate [rad/s]"], ["force [N]"]
        ),
        horizon=T,
        cost=QuadraticCost(R=step),
        control_set=symmetric("force_bound", force_bound),
        state_set=symmetric("position_bound", [position_bound, None, None, None]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=low_pass_at(cutoff_hz),
        name="cart_pole",
    )


def planar_quadrotor(
    horizon: int = 40,
    sampling_time: float = 0.05,
    cutoff_hz: float | None = None,
    thrust_bounds: Sequence[float] = (0.0, 4.8),
    initial_state: Sequence[float] = (-2.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    terminal_state: Sequence[float] | None = (0.0, 0.0, 2 * pi, 0.0, 0.0, 0.0),
    mass: float = 0.486,
    arm: float = 0.25,
    inertia: float = 0.00383,
) -> OptimalControlProblem:
    """Move a planar quadrotor sideways by two metres with a flip on the way.

    Minimise 1/2 sum of |u_t - hover|^2 + 0.1 |position|^2 + 0.001 rate^2.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds.
    cutoff_hz : float or None
        Low-pass cut-off of both thrusts in Hz; None: no frequency constraint.
    thrust_bounds : (2,)
        Lower and upper bound on each thrust [N]; hover takes m g/2 = 2.38 N each.
    initial_state, terminal_state : (6,)
        Position to the right and height [m], pitch [rad], their speeds [m/s] and its rate [rad/s]. A terminal_state of
        None is free.
    mass, arm, inertia : float
        Mass [kg], distance of a rotor from the centre [m], and moment of inertia [kg m^2].

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Tedrake, "Underactuated Robotics", MIT course notes, section "The planar quadrotor", with the parameters of its
    example. Ends, weights and bounds are chosen here.

    Examples
    --------
    >>> lfo.library.planar_quadrotor().horizon
    40
    """
    T, step = positive_integer("horizon", horizon), positive_number("sampling_time", sampling_time)
    m, r, J = positive_number("mass", mass), positive_number("arm", arm), positive_number("inertia", inertia)
    hover = m * GRAVITY / 2

    def rates(x: Sequence[Formula], u: Signals) -> list[Formula]:
        lift = (u[0] + u[1]) / m
        return [x[3], x[4], x[5], -lift * x[2].sin(), lift * x[2].cos() - GRAVITY, (u[0] - u[1]) * (r / J)]

    return OptimalControlProblem(
        dynamics=_sampled_dynamics(
            rates,
            step,
            ["position [m]", "height [m]", "pitch [rad]", "speed [m/s]", "climb [m/s]", "rate [rad/s]"],
            ["right thrust [N]", "left thrust [N]"],
        ),
        horizon=T,
        cost=QuadraticCost(Q=np.diag([0.1, 0.1, 0.0, 0.0, 0.0, 0.001]), R=1.0, u_ref=[hover, hover]),
        control_set=Box([thrust_bounds[0]] * 2, [thrust_bounds[1]] * 2),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=low_pass_at(cutoff_hz),
        name="planar_quadrotor",
    )
