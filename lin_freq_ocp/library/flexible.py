"""Flexible structures moved without vibration: crane, elastic joint, satellite."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, sqrt

import numpy as np
from scipy.linalg import eigh

from lin_freq_ocp.base.arrays import positive_number
from lin_freq_ocp.library.common import notch_at, sampled_plant, symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
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

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Input shaping: Singer and Seering, "Preshaping command inputs to reduce system vibration", J. Dynamic Systems,
    Measurement, and Control 112(1), 1990; on cranes: Singhose, Porter, Kenison and Kriikku, "Effects of hoisting on the
    input shaping control of gantry cranes", Control Engineering Practice 8(10), 2000. The idea is theirs; all numbers
    are chosen here, and a stop band over one horizon is not a shaper, which is a filter for any command.

    Examples
    --------
    >>> lfo.library.crane().horizon
    150
    """
    length = positive_number("cable_length", cable_length)
    swing_frequency = sqrt(GRAVITY / length)  # rad/s
    A = [[0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1], [0, 0, -(swing_frequency**2), 0]]
    B = [[0], [1], [0], [-1 / length]]
    states = "position [m], speed [m/s], swing [rad], swing rate [rad/s]"
    return OptimalControlProblem(
        dynamics=sampled_plant(A, B, sampling_time, states, "acceleration [m/s^2]"),
        horizon=horizon,
        cost=QuadraticCost(R=1.0),
        control_set=symmetric("acceleration_bound", acceleration_bound),
        state_set=symmetric("speed_bound, swing_bound", [None, speed_bound, swing_bound, None]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=notch_at(swing_frequency, notch_width_hz),
        name="crane",
    )


STIFFNESS_PER_MOTOR, STIFFNESS_PER_LINK = 48.6, 19.5  # 1/s^2: of the joint, over the inertia of motor and of link
FRICTION_PER_MOTOR = 1.25  # 1/s: viscous, over the inertia of the motor


def flexible_joint_arm(
    horizon: int = 120,
    sampling_time: float = 0.02,
    stiffness_ratio: float = 1.0,
    notch_width_hz: float | None = 1.0,
    initial_state: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    terminal_state: Sequence[float] | None = (pi / 2, 0.0, 0.0, 0.0),
    torsion_bound: float | None = 5 * pi / 180,
    torque_bound: float | None = 6.3,
) -> OptimalControlProblem:
    """Swing an arm with an elastic joint: bounds on torque and torsion, and a notch at the resonance.

    Minimise 1/2 sum of u_t^2, where u is the torque of the motor over its inertia. The angles of motor and link follow

        theta_m'' = u - 1.25 theta_m' - 48.6 s,   theta_l'' = 19.5 s,   with the torsion s = theta_m - theta_l

    in rad and s, so that motor and link swing against each other at about sqrt(48.6 + 19.5) = 8.25 rad/s. To stop at
    rest, the torque avoids that frequency anyway; the stop band around it, as wide as the stiffness is uncertain,
    leaves less vibration in an arm that is softer or stiffer than its model. It acts together with both bounds.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds.
    stiffness_ratio : float
        Stiffness of the joint relative to the source's; the stop band moves with it.
    notch_width_hz : float or None
        Width in Hz of the band removed from the torque around the resonance; None: no frequency constraint.
    initial_state, terminal_state : (4,)
        Angle of the link [rad], torsion [rad], and their rates [rad/s]. A terminal_state of None is free.
    torsion_bound, torque_bound : float or None
        Symmetric bounds on the torsion [rad] and on the torque over the inertia of the motor [rad/s^2].

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    The model: Spong, "Modeling and control of elastic joint robots", J. Dynamic Systems, Measurement, and Control
    109(4), 1987; its numbers, 48.6, 1.25 and 19.5: Raghavan and Hedrick, "Observer design for a class of nonlinear
    systems", International Journal of Control 59(2), 1994. There the arm turns in a vertical plane; here in a
    horizontal one, so that gravity has no part and the model is linear. The move, its time, the band and the bounds
    are chosen here.

    Examples
    --------
    >>> lfo.library.flexible_joint_arm().horizon
    120
    """
    ratio = positive_number("stiffness_ratio", stiffness_ratio)
    of_motor, of_link = ratio * STIFFNESS_PER_MOTOR, ratio * STIFFNESS_PER_LINK
    resonance = sqrt(of_motor + of_link)  # rad/s, without friction
    friction = FRICTION_PER_MOTOR
    A = [[0, 0, 1, 0], [0, 0, 0, 1], [0, of_link, 0, 0], [0, -of_motor - of_link, -friction, -friction]]
    B = [[0], [0], [0], [1]]
    states = "link angle [rad], torsion [rad], link speed [rad/s], torsion rate [rad/s]"
    return OptimalControlProblem(
        dynamics=sampled_plant(A, B, sampling_time, states, "torque [rad/s^2]"),
        horizon=horizon,
        cost=QuadraticCost(R=1.0),
        control_set=symmetric("torque_bound", torque_bound),
        state_set=symmetric("torsion_bound", [None, torsion_bound, None, None]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=notch_at(resonance, notch_width_hz),
        name="flexible_joint_arm",
    )


INERTIA = 350.0  # kg m^2, about the roll axis, panels included
COUPLING = (6.45637, -1.25819)  # sqrt(kg) m, of each mode with the roll axis
FREQUENCIES = (0.7681, 1.1038)  # rad/s, of each mode with the hub held still
DAMPING_RATIOS = (0.005607, 0.00862)
MASS = np.array([[INERTIA, *COUPLING], [COUPLING[0], 1, 0], [COUPLING[1], 0, 1]])
STIFFNESS = np.diag(np.square([0, *FREQUENCIES]))
DAMPING = 2 * np.diag(np.multiply([0, *DAMPING_RATIOS], [0, *FREQUENCIES]))


def flexible_satellite(
    horizon: int = 250,
    sampling_time: float = 0.2,
    notch_width_hz: float | None = 0.05,
    initial_state: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    terminal_state: Sequence[float] | None = (pi / 3, 0.0, 0.0, 0.0, 0.0, 0.0),
    rate_bound: float | None = 0.032,
    torque_bound: float | None = 1.0,
) -> OptimalControlProblem:
    """Turn a satellite by 60 degrees without ringing its panels: one stop band for each of two modes.

    Minimise 1/2 sum of u_t^2. The hub's angle theta and the modal coordinates q of the panels (hybrid coordinates)
    follow M (theta, q)'' + D (theta, q)' + K (theta, q) = (u, 0, 0). Each mode loses the bins around its frequency
    with the hub free to turn, which is higher than with the hub held still.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds.
    notch_width_hz : float or None
        Width in Hz of the band removed from each modal coordinate; None: no frequency constraint.
    initial_state, terminal_state : (6,)
        Angle [rad], two modal coordinates [sqrt(kg) m], and the rates of these three. A terminal_state of None is free.
    rate_bound, torque_bound : float or None
        Symmetric bounds on the hub's rate [rad/s] and the torque [N m].

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Di Gennaro, "Output stabilization of flexible spacecraft with active vibration suppression", IEEE Transactions on
    Aerospace and Electronic Systems 39(3), 2003; here its roll axis alone, with the first two modes: inertia
    350 kg m^2, couplings 6.45637 and -1.25819 sqrt(kg) m, frequencies 0.7681 and 1.1038 rad/s, damping ratios
    0.005607 and 0.00862. The move and the bounds are chosen here.

    Examples
    --------
    >>> lfo.library.flexible_satellite().horizon
    250
    """
    A, B = np.zeros((6, 6)), np.zeros((6, 1))
    A[:3, 3:] = np.eye(3)
    A[3:, :3] = -np.linalg.solve(MASS, STIFFNESS)
    A[3:, 3:] = -np.linalg.solve(MASS, DAMPING)
    B[3:, 0] = np.linalg.solve(MASS, [1, 0, 0])
    positions = "angle [rad], mode 1 [sqrt(kg) m], mode 2 [sqrt(kg) m]"
    rates = "rate [rad/s], mode 1 rate [sqrt(kg) m/s], mode 2 rate [sqrt(kg) m/s]"
    # The two frequencies of the undamped satellite, hub free, in rad/s; its third is 0
    frequencies = np.sqrt(np.asarray(eigh(STIFFNESS, MASS, eigvals_only=True))[1:])
    bands = [notch_at(frequency, notch_width_hz, f"mode {i}") for i, frequency in enumerate(frequencies, start=1)]
    return OptimalControlProblem(
        dynamics=sampled_plant(A, B, sampling_time, f"{positions}, {rates}", "torque [N m]"),
        horizon=horizon,
        cost=QuadraticCost(R=1.0),
        control_set=symmetric("torque_bound", torque_bound),
        state_set=symmetric("rate_bound", [None, None, None, rate_bound, None, None]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        state_spectrum=[band for band in bands if band is not None] or None,
        name="flexible_satellite",
    )
