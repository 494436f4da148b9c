"""Rendezvous with a target in an elliptic orbit: linear relative motion that varies in time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import pi

import numpy as np

from lin_freq_ocp.base.arrays import Array, positive_integer, positive_number, shaped
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.library.common import symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.bands import low_pass

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
    """Meet a target in an elliptic orbit, slowly throttling the thrust: the dynamics vary in time.

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
    e, start = float(shaped("eccentricity", eccentricity, ())), float(shaped("first_anomaly", first_anomaly, ()))
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
        control_spectrum=None if cutoff_hz is None else low_pass(cutoff_hz=cutoff_hz),
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
