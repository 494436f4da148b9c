"""Example 2 of the paper: dynamics with a Euclidean norm, which has its kink at the origin."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from lin_freq_ocp.arrays import positive_integer
from lin_freq_ocp.formulas.nodes import norm
from lin_freq_ocp.library.piecewise.hybrid import control_band
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.piecewise_smooth import PiecewiseSmoothDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box


def norm_dynamics(
    initial_state: Sequence[float] = (1.0, 0.0),
    horizon: int = 10,
    control_spectrum: Any = None,
    terminal_state: Sequence[float] | None = None,
    terminal_cost: bool = False,
) -> OptimalControlProblem:
    """Steer (x1 (1 - u), |x| u) to the origin, where its norm has a kink.

    Minimise the sum of |x_t|^2 + u_t^2 (no 1/2, no terminal cost) with u in [0, 1].

    Parameters
    ----------
    initial_state, terminal_state : (2,)
        A terminal_state of None is free. From (0, anything), u = 0 reaches the kink at once.
    horizon : int
        T.
    control_spectrum : band, list of bands, list of bins, "freq" or None
        Frequency constraints on u; "freq" removes the bins max(2, ceil(T/3)) <= k <= T//2.
    terminal_cost : bool
        Whether |x_T|^2 is in the cost.

    Notes
    -----
    Example 2 of the paper, from Gruene and Pannek, Nonlinear Model Predictive Control, 2017, example 5.8. States
    have no bounds in it; none is needed: |x_{t+1}|^2 <= |x_t|^2 ((1 - u)^2 + u^2), and u is in [0, 1].
    """
    T = positive_integer("horizon", horizon)
    weight = 2.0 if terminal_cost else 0.0
    return OptimalControlProblem(
        dynamics=PiecewiseSmoothDynamics.from_formulas(
            lambda x, u: [x[0] * (1 - u[0]), norm(x) * u[0]], state_dim=2, control_dim=1
        ),
        horizon=T,
        cost=QuadraticCost(Q=2.0, R=2.0, P=weight),
        control_set=Box(0, 1),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=control_band(control_spectrum, T),
        name="norm_dynamics",
    )
