"""The active suspension of a quarter of a car, crossing a bump."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np

from lin_freq_ocp.arrays import Array, positive_integer, positive_number, shaped
from lin_freq_ocp.library.bounds import symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.bands import Band, notch

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
    """Cross a bump with an active suspension, sparing the passengers the band of 4 to 8 Hz.

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

    Notes
    -----
    Model and parameters: Lin and Kanellakopoulos, "Nonlinear design of active suspensions", IEEE Control Systems
    Magazine 17(3), 1997: body 290 kg, wheel 59 kg, spring 16812 N/m, damper 1000 N s/m, tyre 190000 N/m. The band:
    ISO 2631-1:1997, frequency weighting W_k. The weights and bounds are chosen here.
    """
    T, step = positive_integer("horizon", horizon), positive_number("sampling_time", sampling_time)
    height = float(shaped("bump_height", bump_height, ()))
    A, B, E = _continuous_model()
    sampled = LinearDynamics.from_continuous(A, np.hstack([B, E]), step)
    acceleration = np.append(A[1], B[1])
    weights = np.outer(acceleration, acceleration) + np.diag([0, 0, TYRE_WEIGHT, 0, FORCE_WEIGHT])
    return OptimalControlProblem(
        dynamics=LinearDynamics(
            sampled.A,
            sampled.B[:, :1],
            offset=np.outer(_road_speed(height, T, step), sampled.B[:, 1]),
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
        state_spectrum=None if stop_band_hz is None else _comfort_band(stop_band_hz),
        name="quarter_car",
    )


def _continuous_model() -> tuple[Array, Array, Array]:
    """Return the matrices of the state, of the force [kN] and of the road's vertical speed [m/s]."""
    A = np.array(
        [
            [0, 1, 0, -1],
            [-SPRING / BODY_MASS, -DAMPER / BODY_MASS, 0, DAMPER / BODY_MASS],
            [0, 0, 0, 1],
            [SPRING / WHEEL_MASS, DAMPER / WHEEL_MASS, -TYRE / WHEEL_MASS, -DAMPER / WHEEL_MASS],
        ]
    )
    B = np.array([[0], [1000 / BODY_MASS], [0], [-1000 / WHEEL_MASS]])
    E = np.array([[0.0], [0.0], [-1.0], [0.0]])
    return A, B, E


def _road_speed(height: float, horizon: int, step: float) -> Array:
    """Return the vertical speed of the road in each period, shape (T,)."""
    t = step * np.arange(horizon + 1)
    on_bump = (t >= BUMP_START) & (t <= BUMP_END)
    return np.diff(np.where(on_bump, height / 2 * (1 - np.cos(8 * pi * t)), 0.0)) / step


def _comfort_band(edges_hz: Sequence[float]) -> Band:
    lower, upper = shaped("stop_band_hz", edges_hz, (2,))
    return notch(centre_hz=(lower + upper) / 2, width_hz=upper - lower, component="body speed")
