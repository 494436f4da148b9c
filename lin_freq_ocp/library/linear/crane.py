"""A gantry crane that moves its payload without swing."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

from lin_freq_ocp.arrays import positive_number
from lin_freq_ocp.library.bounds import notch_at, symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem

GRAVITY = 9.81  # m/s^2


def crane(
    horizon: int = 150,
    sampling_time: float = 0.1,
    cable_length: float = 5.0,
    notch_width_hz: float | None = 0.1,
    initial_state: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    terminal_state: Sequence[float] | None = (6.0, 0.0, 0.0, 0.0),
    speed_bound: float | None = 0.6,
    swing_bound: float | None = 0.025,
    acceleration_bound: float | None = 0.15,
) -> OptimalControlProblem:
    """Move a crane's payload from rest to rest: a robust input shaper as a stop band on the acceleration.

    Minimise 1/2 sum of u_t^2. The trolley follows its commanded acceleration u, and the payload, a small pendulum of
    length L, L phi'' = -g phi - u. To end without swing, the transform of u must be zero at the pendulum's frequency
    sqrt(g/L): that alone is a zero-vibration shaper, and it fails with any other cable. The stop band around the
    frequency does what the robust shapers do: the payload stays nearly at rest with a cable longer or shorter by a
    fifth, and all limits hold.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds.
    cable_length : float
        L [m]; the stop band moves with it.
    notch_width_hz : float or None
        Width in Hz of the band removed from the acceleration around the pendulum's frequency; None: no frequency
        constraint.
    initial_state, terminal_state : (4,)
        Position [m] and speed [m/s] of the trolley, swing angle [rad] and its rate [rad/s]. A terminal_state of None
        is free.
    speed_bound, swing_bound, acceleration_bound : float or None
        Symmetric bounds on the trolley's speed [m/s], the swing angle [rad] and the trolley's acceleration [m/s^2].

    Notes
    -----
    Input shaping: Singer and Seering, "Preshaping command inputs to reduce system vibration", J. Dynamic Systems,
    Measurement, and Control 112(1), 1990; on cranes: Singhose, Porter, Kenison and Kriikku, "Effects of hoisting on the
    input shaping control of gantry cranes", Control Engineering Practice 8(10), 2000. The idea is theirs; all numbers
    are chosen here, and a stop band over one horizon is not a shaper, which is a filter for any command.
    """
    length = positive_number("cable_length", cable_length)
    swing_frequency = sqrt(GRAVITY / length)  # rad/s
    return OptimalControlProblem(
        dynamics=LinearDynamics.from_continuous(
            [[0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1], [0, 0, -(swing_frequency**2), 0]],
            [[0], [1], [0], [-1 / length]],
            sampling_time,
            state_names=["position [m]", "speed [m/s]", "swing [rad]", "swing rate [rad/s]"],
            control_names=["acceleration [m/s^2]"],
        ),
        horizon=horizon,
        cost=QuadraticCost(R=1.0),
        control_set=symmetric("acceleration_bound", acceleration_bound),
        state_set=symmetric("speed_bound, swing_bound", [None, speed_bound, swing_bound, None]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=notch_at(swing_frequency, notch_width_hz),
        name="crane",
    )
