"""Vehicles: a quadcopter near hover, a quarter of a car that crosses a bump, and a rendezvous in an elliptic orbit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import pi

import numpy as np

from lin_freq_ocp.base.arrays import Array, positive_integer, positive_number, to_shape
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.library.common import low_pass_at, symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import notch

GRAVITATIONAL_PARAMETER = 3.986004418e14  # m^3/s^2, of the Earth
EARTH_RADIUS, SPHERE_OF_INFLUENCE = 6.371e6, 9.24e8  # m
INTEGRATION_TOLERANCE = 1e-12  # relative and absolute tolerance of the integration along the orbit


def elliptic_rendezvous(
    horizon: int = 180,
    sampling_time: float = 80.0,
    eccentricity: float = 0.7,
    perigee_radius: float = 6.9e6,
    first_anomaly: float = -0.9 * pi,
    cutoff_hz: float | None = 3e-4,
    initial_state: Sequence[float] = (0.0, -10.0, 0.0, 0.0),
    terminal_state: Sequence[float] | None = (0.0, 0.0, 0.0, 0.0),
    radial_bound: float | None = 0.8,
    thrust_bound: float | None = 0.1,
) -> OptimalControlProblem:
    """Meet a target in an elliptic orbit with a slowly changing thrust: the dynamics vary in time.

    Minimise 1/2 sum of |u_t|^2. The chaser's position relative to the target, x radial (outwards), y along the track,
    follows the in-plane equations of Tschauner and Hempel with the true anomaly f(t) of the target, w = f', r = radius:

        x'' = (w^2 + 2 mu/r^3) x + w' y + 2 w y' + u_x
        y'' = (w^2 -   mu/r^3) y - w' x - 2 w x' + u_y

    They are sampled by a zero-order hold in each period: the thrust is held still in the turning frame.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds.
    eccentricity : float
        Of the target's orbit, at least 0 and below 1.
    perigee_radius : float
        Least distance of the target from the Earth's centre [m].
    first_anomaly : float
        True anomaly of the target at time 0 [rad]; 0 is perigee.
    cutoff_hz : float or None
        Low-pass cut-off of both thrusts in Hz; None: no frequency constraint.
    initial_state, terminal_state : (4,)
        Radial and along-track distance [km], radial and along-track speed [m/s]. A terminal_state of None is free.
    radial_bound, thrust_bound : float or None
        Symmetric bounds on the radial distance [km] and on each thrust acceleration [mm/s^2].

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Tschauner and Hempel, "Rendezvous zu einem in elliptischer Bahn umlaufenden Ziel", Astronautica Acta 11(2), 1965;
    in this form in Inalhan, Tillerson and How, "Relative dynamics and control of spacecraft formations in eccentric
    orbits", J. Guidance, Control, and Dynamics 25(1), 2002. The orbit and the manoeuvre are chosen here.

    Examples
    --------
    >>> lfo.library.elliptic_rendezvous().horizon
    180
    """
    T, step = positive_integer("horizon", horizon), positive_number("sampling_time", sampling_time)
    e, start = (float(to_shape("eccentricity", eccentricity, ())), float(to_shape("first_anomaly", first_anomaly, ())))
    if not 0 <= e < 1:
        raise ProblemError("eccentricity", f"{e:g}", "0 (a circle) or more, and below 1")
    perigee = positive_number("perigee_radius", perigee_radius)
    if not EARTH_RADIUS <= perigee <= SPHERE_OF_INFLUENCE:
        known = (
            f"metres from the Earth's surface, {EARTH_RADIUS:g}, to the end of its influence, {SPHERE_OF_INFLUENCE:g}"
        )
        raise ProblemError("perigee_radius", f"{perigee:g}", known)
    orbit = _Orbit(e, perigee * (1 + e))
    A, B = _sampled_model(orbit, start, T, step)
    return OptimalControlProblem(
        dynamics=LinearDynamics(
            A,
            B,
            sampling_time=step,
            state_names=[
                *("radial distance [km]", "along-track distance [km]"),
                *("radial speed [m/s]", "along-track speed [m/s]"),
            ],
            control_names=["radial thrust [mm/s^2]", "along-track thrust [mm/s^2]"],
        ),
        horizon=T,
        cost=QuadraticCost(R=1.0),
        control_set=symmetric("thrust_bound", thrust_bound),
        state_set=symmetric("radial_bound", [radial_bound, None, None, None]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=low_pass_at(cutoff_hz),
        name="elliptic_rendezvous",
    )


@dataclass(frozen=True)
class _Orbit:
    """The target's orbit, and relative motion near it, as functions of the true anomaly [rad]."""

    eccentricity: float
    parameter: float  # p, m

    def rate(self, anomaly: Array) -> Array:
        """Return f' = sqrt(mu/p^3) (1 + e cos f)^2 in rad/s."""
        return np.sqrt(GRAVITATIONAL_PARAMETER / self.parameter**3) * (1 + self.eccentricity * np.cos(anomaly)) ** 2

    def relative_motion(self, anomaly: Array) -> Array:
        """Return the continuous state matrices, shape (..., 4, 4), in km and m/s."""
        turn = self.rate(anomaly)
        approach = 1 + self.eccentricity * np.cos(anomaly)  # p/r
        gravity = turn**2 / approach  # mu/r^3
        turn_rate = -2 * turn**2 * self.eccentricity * np.sin(anomaly) / approach
        A = np.zeros((*anomaly.shape, 4, 4))
        A[..., 0, 2] = A[..., 1, 3] = 1e-3
        A[..., 2, 0], A[..., 2, 1], A[..., 2, 3] = 1e3 * (turn**2 + 2 * gravity), 1e3 * turn_rate, 2 * turn
        A[..., 3, 1], A[..., 3, 0], A[..., 3, 2] = 1e3 * (turn**2 - gravity), -1e3 * turn_rate, -2 * turn
        return A


def _sampled_model(orbit: _Orbit, first_anomaly: float, horizon: int, step: float) -> tuple[Array, Array]:
    """Return A_t, shape (T, 4, 4), and B_t, shape (T, 4, 2); all periods are integrated side by side."""
    thrust = np.vstack([np.zeros((2, 2)), 1e-3 * np.eye(2)])

    def rates(_: float, packed: Array) -> Array:
        anomaly, A_and_B = packed[:horizon], packed[horizon:].reshape(horizon, 4, 6)
        change = orbit.relative_motion(anomaly) @ A_and_B
        change[..., 4:] += thrust
        return np.concatenate([orbit.rate(anomaly), change.ravel()])

    times = step * np.arange(horizon + 1, dtype=np.float64)
    anomaly = _integrate_rates(lambda _, anomaly: orbit.rate(anomaly), np.array([first_anomaly]), times)[0, :-1]
    packed = np.concatenate([anomaly, np.tile(np.eye(4, 6).ravel(), horizon)])
    sampled = _integrate_rates(rates, packed, np.array([step]))[horizon:, 0].reshape(horizon, 4, 6)
    return sampled[..., :4], sampled[..., 4:]


def _integrate_rates(rates: Callable[[float, Array], Array], initial: Array, times: Array) -> Array:
    """Return the solution at the given times, shape (len(initial), len(times))."""
    from scipy.integrate import solve_ivp  # slow to import

    span, tolerance = (0.0, float(times[-1])), INTEGRATION_TOLERANCE
    solution = solve_ivp(rates, span, initial, "DOP853", times, rtol=tolerance, atol=tolerance)
    return np.asarray(solution.y)


SAMPLING_TIME = 0.1  # s
HOVER = 10.5916  # of each rotor, in the source's unit
# The states are three angles, three positions and the rates of both. A pitch moves the quadcopter along x, a roll along
# -y, and a common thrust up.
EYE, TILT = np.eye(3), np.diag([1.0, -1.0, 0.0])
A = np.block(
    [
        [EYE, 0 * EYE, 0.1 * EYE, 0 * EYE],
        [0.0488 * TILT, EYE, 0.0016 * TILT, 0.0992 * EYE],
        [0 * EYE, 0 * EYE, EYE, 0 * EYE],
        [0.9734 * TILT, 0 * EYE, 0.0488 * TILT, 0.9846 * EYE],
    ]
)
PITCH, ROLL, YAW, LIFT = [0, -1, 0, 1], [-1, 0, 1, 0], [-1, 1, -1, 1], [1, 1, 1, 1]  # made by the four rotors
DIRECTIONS = np.array([PITCH, ROLL, YAW, PITCH, ROLL, LIFT] * 2)
GAINS = [0.0726, 0.0726, 0.0152, 0.0006, -0.0006, 0.0106, 1.4512, 1.4512, 0.3049, 0.0236, -0.0236, 0.2107]
B = np.array(GAINS)[:, None] * DIRECTIONS + 0.0  # without negative zeros
STATE_WEIGHTS = np.diag([0.0, 0, 10, 10, 10, 10, 0, 0, 0, 5, 5, 5])
CONTROL_WEIGHT = 0.1


def quadcopter(
    horizon: int = 60,
    cutoff_hz: float | None = 1.5,
    reference: Sequence[float] = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    initial_state: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    terminal_state: Sequence[float] | None = None,
    tilt_bound: float | None = pi / 6,
    lowest_height: float | None = -1.0,
    rotor_bounds: Sequence[float] = (9.6, 13.0),
) -> OptimalControlProblem:
    """Turn a hovering quadcopter by 1 rad with low-passed rotors: the MPC example of OSQP.

    Minimise the sum of (x_t - r)'Q(x_t - r) + 0.1 |u_t|^2 and (x_T - r)'Q(x_T - r), Q = diag(0, 0, 10, 10, 10, 10, 0,
    0, 0, 5, 5, 5), as the source has it, without 1/2. To yaw, two rotors speed up and two slow down, and these meet
    their lower bound at once. Free rotors make up for it with the other two, which lifts the quadcopter a little;
    low-passed ones turn later and lift it half as much. The DFT sees the horizon as a period, so that the rotors move
    again before its end. References elsewhere move all twelve states.

    Parameters
    ----------
    horizon : int
        T; the source's is 10.
    cutoff_hz : float or None
        Low-pass cut-off of all rotors in Hz; None: no frequency constraint.
    reference : (12,)
        r: the state to hold; the source's is a yaw of 1 rad.
    initial_state, terminal_state : (12,)
        Pitch, roll, yaw [rad], positions x, y and height [m], the rates of the angles [rad/s], the speeds [m/s]. A
        terminal_state of None is free.
    tilt_bound, lowest_height : float or None
        Symmetric bound on pitch and roll [rad], and lower bound on the height [m].
    rotor_bounds : (2,)
        Lower and upper bound on each rotor; the controls are the deviations from hover, 10.5916.

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    The sampled matrices, bounds, weights and reference are those of "Model predictive control (MPC)" among the examples
    of OSQP (osqp.org), which has them from the collection mpcBenchmarking (github.com/ferreau/mpcBenchmarking), and
    that from the demos of MPT 3: see Kouzoupis, Zanelli, Peyrl and Ferreau, "Towards proper assessment of QP algorithms
    for embedded model predictive control", European Control Conference, 2015. The collection states the sampling time,
    0.1 s. Neither names the states or gives units: those here are read off the matrices, which are a rigid body with
    drag, sampled, under a gravity of 9.81 m/s^2. What the rotors are measured in remains unknown. The horizon and the
    cut-off are chosen here.

    Examples
    --------
    >>> lfo.library.quadcopter().horizon
    60
    """
    lowest, highest = to_shape("rotor_bounds", rotor_bounds, (2,)) - HOVER
    tilt, lower, upper = symmetric("tilt_bound", tilt_bound), np.full(len(A), -np.inf), np.full(len(A), np.inf)
    lower[:2], upper[:2] = tilt.lower, tilt.upper
    if lowest_height is not None:
        lower[5] = to_shape("lowest_height", lowest_height, ())
    return OptimalControlProblem(
        dynamics=LinearDynamics(
            A,
            B,
            sampling_time=SAMPLING_TIME,
            state_names=[
                *("pitch [rad]", "roll [rad]", "yaw [rad]", "position x [m]", "position y [m]", "height [m]"),
                *("pitch rate [rad/s]", "roll rate [rad/s]", "yaw rate [rad/s]"),
                *("speed x [m/s]", "speed y [m/s]", "climb rate [m/s]"),
            ],
            control_names=[f"rotor {i}" for i in range(1, 5)],
        ),
        horizon=horizon,
        cost=QuadraticCost(  # twice the weights: the source's cost has no 1/2
            Q=2 * STATE_WEIGHTS,
            R=2 * CONTROL_WEIGHT,
            P=2 * STATE_WEIGHTS,
            x_ref=to_shape("reference", reference, (len(A),)),
        ),
        control_set=Box(lowest, highest),
        state_set=Box(lower, upper),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=low_pass_at(cutoff_hz),
        name="quadcopter",
    )


BODY_MASS, WHEEL_MASS = 290.0, 59.0  # kg
SPRING, TYRE = 16812.0, 190000.0  # N/m
DAMPER = 1000.0  # N s/m
BUMP_START, BUMP_END = 0.5, 0.75  # s
TYRE_WEIGHT, FORCE_WEIGHT = 1000.0, 0.1  # 1/s^4 and (m/s^2)^2/kN^2, against 1 for the squared acceleration of the body


def quarter_car(
    horizon: int = 300,
    sampling_time: float = 0.01,
    bump_height: float = 0.08,
    stop_band_hz: Sequence[float] | None = (4.0, 8.0),
    initial_state: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    terminal_state: Sequence[float] | None = None,
    travel_bound: float | None = 0.075,
    force_bound: float | None = 2.0,
) -> OptimalControlProblem:
    """Cross a bump with an active suspension, without vertical motion of the body at 4 to 8 Hz.

    Minimise 1/2 sum of a_t^2 + 1000 (tyre deflection)^2 + 0.1 u_t^2, where the acceleration a_t of the body depends on
    state and force, so the cost has a cross term. The known road enters as an offset d_t, and the end is free. People
    feel vertical vibration most between 4 and 8 Hz.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds.
    bump_height : float
        Height h [m] of the road h/2 (1 - cos(8 pi t)), 0.5 s <= t <= 0.75 s, taken straight between samples.
    stop_band_hz : (2,) or None
        Edges in Hz of the band removed from the body's speed; None: no frequency constraint.
    initial_state, terminal_state : (4,)
        Travel (body minus wheel) [m], speed of the body [m/s], deflection of the tyre (wheel minus road) [m], speed of
        the wheel [m/s], from rest under gravity. A terminal_state of None is free.
    travel_bound, force_bound : float or None
        Symmetric bounds on the travel of the suspension [m] and the force of the actuator [kN].

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Model and parameters: Lin and Kanellakopoulos, "Nonlinear design of active suspensions", IEEE Control Systems
    Magazine 17(3), 1997: body 290 kg, wheel 59 kg, spring 16812 N/m, damper 1000 N s/m, tyre 190000 N/m. The band:
    ISO 2631-1:1997, frequency weighting W_k. The weights and bounds are chosen here.

    Examples
    --------
    >>> lfo.library.quarter_car().horizon
    300
    """
    T, step = positive_integer("horizon", horizon), positive_number("sampling_time", sampling_time)
    height = float(to_shape("bump_height", bump_height, ()))
    A = np.array(
        [
            [0, 1, 0, -1],
            [-SPRING / BODY_MASS, -DAMPER / BODY_MASS, 0, DAMPER / BODY_MASS],
            [0, 0, 0, 1],
            [SPRING / WHEEL_MASS, DAMPER / WHEEL_MASS, -TYRE / WHEEL_MASS, -DAMPER / WHEEL_MASS],
        ]
    )
    # Of the force [kN], and of the road's vertical speed [m/s] in each period
    B = np.array([[0, 0.0], [1000 / BODY_MASS, 0.0], [0, -1.0], [-1000 / WHEEL_MASS, 0.0]])
    comfort = None
    if stop_band_hz is not None:
        low, high = to_shape("stop_band_hz", stop_band_hz, (2,))
        comfort = notch(centre_hz=(low + high) / 2, width_hz=high - low, component="body speed")
    t = step * np.arange(T + 1)
    on_bump = (t >= BUMP_START) & (t <= BUMP_END)
    road_speed = np.diff(np.where(on_bump, height / 2 * (1 - np.cos(8 * pi * t)), 0.0)) / step
    sampled = LinearDynamics.from_continuous(A, B, step)
    acceleration = np.append(A[1], B[1, 0])
    weights = np.outer(acceleration, acceleration) + np.diag([0, 0, TYRE_WEIGHT, 0, FORCE_WEIGHT])
    return OptimalControlProblem(
        dynamics=LinearDynamics(
            sampled.A,
            sampled.B[:, :1],
            offset=np.outer(road_speed, sampled.B[:, 1]),
            sampling_time=step,
            state_names=["travel [m]", "body speed [m/s]", "tyre deflection [m]", "wheel speed [m/s]"],
            control_names=["force [kN]"],
        ),
        horizon=T,
        cost=QuadraticCost(Q=weights[:4, :4], S=weights[:4, 4:], R=weights[4:, 4:]),
        control_set=symmetric("force_bound", force_bound),
        state_set=symmetric("travel_bound", [travel_bound, None, None, None]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        state_spectrum=comfort,
        name="quarter_car",
    )
