"""A robot arm of one link behind an elastic joint."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, sqrt

from lin_freq_ocp.arrays import positive_number
from lin_freq_ocp.library.bounds import notch_at, symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem

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

    Notes
    -----
    The model: Spong, "Modeling and control of elastic joint robots", J. Dynamic Systems, Measurement, and Control
    109(4), 1987; its numbers, 48.6, 1.25 and 19.5: Raghavan and Hedrick, "Observer design for a class of nonlinear
    systems", International Journal of Control 59(2), 1994. There the arm turns in a vertical plane; here in a
    horizontal one, so that gravity has no part and the model is linear. The move, its time, the band and the bounds
    are chosen here.
    """
    ratio = positive_number("stiffness_ratio", stiffness_ratio)
    of_motor, of_link = ratio * STIFFNESS_PER_MOTOR, ratio * STIFFNESS_PER_LINK
    resonance = sqrt(of_motor + of_link)  # rad/s, without friction
    friction = FRICTION_PER_MOTOR
    return OptimalControlProblem(
        dynamics=LinearDynamics.from_continuous(
            [[0, 0, 1, 0], [0, 0, 0, 1], [0, of_link, 0, 0], [0, -of_motor - of_link, -friction, -friction]],
            [[0], [0], [0], [1]],
            sampling_time,
            state_names=["link angle [rad]", "torsion [rad]", "link speed [rad/s]", "torsion rate [rad/s]"],
            control_names=["torque [rad/s^2]"],
        ),
        horizon=horizon,
        cost=QuadraticCost(R=1.0),
        control_set=symmetric("torque_bound", torque_bound),
        state_set=symmetric("torsion_bound", [None, torsion_bound, None, None]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=notch_at(resonance, notch_width_hz),
        name="flexible_joint_arm",
    )
