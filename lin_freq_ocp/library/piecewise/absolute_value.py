"""The absolute value as dynamics: the smallest problem with a convex kink, and two extremals of different cost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lin_freq_ocp.arrays import positive_integer, positive_number, shaped
from lin_freq_ocp.library.bounds import symmetric
from lin_freq_ocp.library.piecewise.hybrid import control_band, flag
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.piecewise_affine import AffineMode, PiecewiseAffineDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem


def absolute_value(
    horizon: int = 2,
    preferred_control: float = 0.1,
    control_spectrum: Any = None,
    initial_state: Sequence[float] = (0.0,),
    terminal_state: Sequence[float] | None = None,
    terminal_cost: bool = True,
    control_bound: float = 1.0,
    state_bound: float | None = None,
) -> OptimalControlProblem:
    """Grow under x+ = |x| + u: two mode sequences are extremal, one is optimal.

    Minimise the sum of (u_t - b)^2, minus x_T. From x_0 = 0 the first control may go up or down: with T >= 2 the
    absolute value turns a negative x_1 into the same gain. Both signs of x_1 satisfy the maximum principle: every other
    control is b + 1/2, u_0 = b + 1/2 is optimal, and u_0 = b - 1/2 costs 2 b more (0 <= b < 1/2). Between them, at the
    kink, u_0 = 0 satisfies the joint inclusion of Clarke, too, with eta_0 = -2 b, and is a local maximum in u_0: not
    flip-stationary. With T = 1 and b = 0 it is the smallest case in which the printed, directional form of the paper's
    theorem has no solution at the optimum u = 1/2, J = -1/4.

    Parameters
    ----------
    horizon : int
        T.
    preferred_control : float
        b: what u_t costs nothing at. It breaks the symmetry.
    control_spectrum : band, list of bands, list of bins, "freq" or None
        Frequency constraints on u; "freq" removes the bins max(2, ceil(T/3)) <= k <= T//2.
    initial_state, terminal_state : (1,)
        A terminal_state of None is free.
    terminal_cost : bool
        Whether -x_T is in the cost; without, nothing is to be gained.
    control_bound : float
        Symmetric bound on u.
    state_bound : float or None
        Symmetric bound on x; None: the smallest that no trajectory reaches beyond, |x_0| + T control_bound.

    Notes
    -----
    Mode "+" is x >= 0, listed first, and mode "-" x <= 0; the map is continuous. Chosen here. Costs from x_0 = 0, if no
    bound is active (b <= 1/2): J = -T (b + 1/4), and -T (b + 1/4) + 2 b with x_1 < 0.
    """
    T = positive_integer("horizon", horizon)
    limit = positive_number("control_bound", control_bound)
    preferred = float(shaped("preferred_control", preferred_control, ()))
    reach = float(np.abs(shaped("initial_state", initial_state, (1,)))[0]) + T * limit
    return OptimalControlProblem(
        dynamics=PiecewiseAffineDynamics(
            [
                AffineMode([[1.0]], [[1.0]], G=[[-1.0]], h=[0.0], name="+"),
                AffineMode([[-1.0]], [[1.0]], G=[[1.0]], h=[0.0], name="-"),
            ],
            state_names=["x"],
            control_names=["u"],
        ),
        horizon=T,
        cost=QuadraticCost(R=2.0, u_ref=[preferred], p=[-1.0] if flag("terminal_cost", terminal_cost) else 0.0),
        control_set=symmetric("control_bound", limit),
        state_set=symmetric("state_bound", [reach if state_bound is None else state_bound]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=control_band(control_spectrum, T),
        name="absolute_value",
    )
