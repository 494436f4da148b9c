"""A satellite with flexible panels, turned about one axis."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np
from scipy.linalg import eigh

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.library.bounds import symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.bands import notch

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

    Notes
    -----
    Di Gennaro, "Output stabilization of flexible spacecraft with active vibration suppression", IEEE Transactions on
    Aerospace and Electronic Systems 39(3), 2003; here its roll axis alone, with the first two modes: inertia
    350 kg m^2, couplings 6.45637 and -1.25819 sqrt(kg) m, frequencies 0.7681 and 1.1038 rad/s, damping ratios
    0.005607 and 0.00862. The move and the bounds are chosen here.
    """
    return OptimalControlProblem(
        dynamics=LinearDynamics.from_continuous(
            *_continuous_model(),
            sampling_time,
            state_names=[
                *("angle [rad]", "mode 1 [sqrt(kg) m]", "mode 2 [sqrt(kg) m]"),
                *("rate [rad/s]", "mode 1 rate [sqrt(kg) m/s]", "mode 2 rate [sqrt(kg) m/s]"),
            ],
            control_names=["torque [N m]"],
        ),
        horizon=horizon,
        cost=QuadraticCost(R=1.0),
        control_set=symmetric("torque_bound", torque_bound),
        state_set=symmetric("rate_bound", [None, None, None, rate_bound, None, None]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        state_spectrum=None
        if notch_width_hz is None
        else [
            notch(centre_hz=frequency / (2 * pi), width_hz=notch_width_hz, component=f"mode {i}")
            for i, frequency in enumerate(_free_frequencies(), start=1)
        ],
        name="flexible_satellite",
    )


def _continuous_model() -> tuple[Array, Array]:
    A, B = np.zeros((6, 6)), np.zeros((6, 1))
    A[:3, 3:] = np.eye(3)
    A[3:, :3] = -np.linalg.solve(MASS, STIFFNESS)
    A[3:, 3:] = -np.linalg.solve(MASS, DAMPING)
    B[3:, 0] = np.linalg.solve(MASS, [1, 0, 0])
    return A, B


def _free_frequencies() -> Array:
    """Return the two frequencies of the undamped satellite, hub free, in rad/s; its third is 0."""
    squared = np.asarray(eigh(STIFFNESS, MASS, eigvals_only=True))
    return np.sqrt(squared[1:])
