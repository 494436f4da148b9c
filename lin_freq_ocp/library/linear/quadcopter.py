"""A quadcopter near hover: the model predictive control example of OSQP, with slow rotors."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np

from lin_freq_ocp.arrays import shaped
from lin_freq_ocp.library.bounds import symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import low_pass

SAMPLING_TIME = 0.1  # s
HOVER = 10.5916  # of each rotor, in the source's unit
A = np.array(
    [
        [1, 0, 0, 0, 0, 0, 0.1, 0, 0, 0, 0, 0],
        [0, 1, 0, 0, 0, 0, 0, 0.1, 0, 0, 0, 0],
        [0, 0, 1, 0, 0, 0, 0, 0, 0.1, 0, 0, 0],
        [0.0488, 0, 0, 1, 0, 0, 0.0016, 0, 0, 0.0992, 0, 0],
        [0, -0.0488, 0, 0, 1, 0, 0, -0.0016, 0, 0, 0.0992, 0],
        [0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0.0992],
        [0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0],
        [0.9734, 0, 0, 0, 0, 0, 0.0488, 0, 0, 0.9846, 0, 0],
        [0, -0.9734, 0, 0, 0, 0, 0, -0.0488, 0, 0, 0.9846, 0],
        [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0.9846],
    ]
)
B = np.array(
    [
        [0, -0.0726, 0, 0.0726],
        [-0.0726, 0, 0.0726, 0],
        [-0.0152, 0.0152, -0.0152, 0.0152],
        [0, -0.0006, 0, 0.0006],
        [0.0006, 0, -0.0006, 0],
        [0.0106, 0.0106, 0.0106, 0.0106],
        [0, -1.4512, 0, 1.4512],
        [-1.4512, 0, 1.4512, 0],
        [-0.3049, 0.3049, -0.3049, 0.3049],
        [0, -0.0236, 0, 0.0236],
        [0.0236, 0, -0.0236, 0],
        [0.2107, 0.2107, 0.2107, 0.2107],
    ]
)
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

    Notes
    -----
    The sampled matrices, bounds, weights and reference are those of "Model predictive control (MPC)" among the examples
    of OSQP (osqp.org), which has them from the collection mpcBenchmarking (github.com/ferreau/mpcBenchmarking), and
    that from the demos of MPT 3: see Kouzoupis, Zanelli, Peyrl and Ferreau, "Towards proper assessment of QP algorithms
    for embedded model predictive control", European Control Conference, 2015. The collection states the sampling time,
    0.1 s. Neither names the states or gives units: those here are read off the matrices, which are a rigid body with
    drag, sampled, under a gravity of 9.81 m/s^2. What the rotors are measured in remains unknown. The horizon and the
    cut-off are chosen here.
    """
    lowest, highest = shaped("rotor_bounds", rotor_bounds, (2,)) - HOVER
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
            x_ref=shaped("reference", reference, (len(A),)),
        ),
        control_set=Box(lowest, highest),
        state_set=_state_set(tilt_bound, lowest_height),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=None if cutoff_hz is None else low_pass(cutoff_hz=cutoff_hz),
        name="quadcopter",
    )


def _state_set(tilt_bound: float | None, lowest_height: float | None) -> Box:
    tilt = symmetric("tilt_bound", tilt_bound)
    lower, upper = np.full(len(A), -np.inf), np.full(len(A), np.inf)
    lower[:2], upper[:2] = tilt.lower, tilt.upper
    if lowest_height is not None:
        lower[5] = shaped("lowest_height", lowest_height, ())
    return Box(lower, upper)
