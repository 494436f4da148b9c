"""The switched rotation of Bemporad and Morari, whose map jumps where the modes meet."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, pi, sin
from typing import Any

import numpy as np

from lin_freq_ocp.arrays import positive_integer
from lin_freq_ocp.library.bounds import symmetric
from lin_freq_ocp.library.piecewise.hybrid import control_band, sum_of_squares
from lin_freq_ocp.problem.dynamics.piecewise_affine import AffineMode, PiecewiseAffineDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem

CONTRACTION, ANGLE = 0.8, pi / 3


def switched_rotation(
    horizon: int = 6,
    control_spectrum: Any = None,
    initial_state: Sequence[float] = (-6.0, 7.0),
    terminal_state: Sequence[float] | None = None,
    terminal_cost: bool = True,
    state_bounds: float | Sequence[float] = 10.0,
    control_bound: float = 1.0,
) -> OptimalControlProblem:
    """Regulate a state that turns left or right with the sign of x1: the example of Bemporad and Morari.

    Minimise the sum of |x_t|^2 + u_t^2 (no 1/2) under x+ = 0.8 Rot(+60 degrees) x + (0, u) where x1 >= 0, Rot(-60
    degrees) where x1 <= 0, Rot(a) = [[cos a, -sin a], [sin a, cos a]]. The two images of a point with x1 = 0 differ by
    0.8 sqrt(3) |x2| in x1, so the map jumps and no maximum principle applies on the border; an optimiser may choose
    either mode there, a replay takes the first listed, "+".

    Parameters
    ----------
    horizon : int
        T.
    control_spectrum : band, list of bands, list of bins, "freq" or None
        Frequency constraints on u; "freq" removes the bins max(2, ceil(T/3)) <= k <= T//2.
    initial_state, terminal_state : (2,)
        A terminal_state of None is free.
    terminal_cost : bool
        Whether |x_T|^2 is in the cost.
    state_bounds : float or (2,)
        Symmetric bounds on the states.
    control_bound : float
        Symmetric bound on u.

    Notes
    -----
    Bemporad and Morari, "Control of systems integrating logic, dynamics, and constraints", Automatica 35(3), 1999, the
    example of predictive control. Optima are listed in docs/hybrid_systems.md.
    """
    T = positive_integer("horizon", horizon)
    return OptimalControlProblem(
        dynamics=PiecewiseAffineDynamics(
            [
                AffineMode(_rotation(ANGLE), [[0], [1]], G=[[-1, 0]], h=[0], name="+"),
                AffineMode(_rotation(-ANGLE), [[0], [1]], G=[[1, 0]], h=[0], name="-"),
            ],
            state_names=["x1", "x2"],
            control_names=["u"],
        ),
        horizon=T,
        cost=sum_of_squares(np.eye(2), np.eye(1), terminal_cost),
        control_set=symmetric("control_bound", control_bound),
        state_set=symmetric("state_bounds", state_bounds),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=control_band(control_spectrum, T),
        name="switched_rotation",
    )


def _rotation(angle: float) -> list[list[float]]:
    """Return 0.8 Rot(angle)."""
    c, s = CONTRACTION * cos(angle), CONTRACTION * sin(angle)
    return [[c, -s], [s, c]]
