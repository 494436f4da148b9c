"""A small network of maxima and minima as dynamics: only the joint inclusion holds at its optimum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lin_freq_ocp.arrays import Array, positive_integer, positive_number, shaped
from lin_freq_ocp.library.bounds import symmetric
from lin_freq_ocp.library.piecewise.hybrid import control_band, flag
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.piecewise_affine import AffineMode, PiecewiseAffineDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem

STATE_WEIGHT = -0.5  # of x_1 .. x_{T-1}, against 1 for x_T


def max_min_network(
    horizon: int = 2,
    load_first: bool = True,
    control_weight: float = 0.0,
    control_spectrum: Any = (0,),
    initial_state: Sequence[float] = (0.0,),
    terminal_state: Sequence[float] | None = None,
    terminal_cost: bool = True,
    control_bound: float = 1.0,
    state_bound: float = 3.0,
) -> OptimalControlProblem:
    """Steer x+ = max(min(x, -u), u - x) by controls whose sum is zero: kinks in x and u at once.

    Minimise the sum of -x_t/2 over t = 1 .. T-1, plus x_T (plus w u_t^2). The first step loads the state, x_1 = u_0;
    after it the network acts. With T = 2 and the mean of u removed, (x_1, u_1) lies on the line x + u = 0, and the
    optimum 0 is where all pieces meet. The frequency constraint ties u_1 to u_0: there only the inclusion that is joint
    in x and u is necessary, separate ones in x and in u fail.

    Parameters
    ----------
    horizon : int
        T.
    load_first : bool
        Whether x_1 = u_0; without, the network acts on the initial state, too.
    control_weight : float
        w >= 0; with 0 every mode sequence is a linear program.
    control_spectrum : band, list of bands, list of bins, "freq" or None
        Frequency constraints on u; default: bin 0, the sum of all u_t, is removed. "freq" removes the bins
        max(2, ceil(T/3)) <= k <= T//2.
    initial_state, terminal_state : (1,)
        A terminal_state of None is free.
    terminal_cost : bool
        Whether x_T is in the cost.
    control_bound, state_bound : float
        Symmetric bounds on u and x.

    Notes
    -----
    Four modes around the origin: "x" (x + u <= 0, u <= 2 x), "-u" (x + u >= 0, x >= 2 u), and u - x in the rest, which
    is not convex and stands as two, "u - x, above" (x + u >= 0, x <= 2 u) and "u - x, left" (x + u <= 0, u >= 2 x). The
    map is continuous. With ``load_first`` all four are x+ = u at t = 0, so that the maps depend on time. Chosen here.
    """
    T, limit = positive_integer("horizon", horizon), positive_number("control_bound", control_bound)
    weight = float(shaped("control_weight", control_weight, ()))
    sums = np.full((T, 1), STATE_WEIGHT)
    sums[0] = 0.0
    load = flag("load_first", load_first)
    return OptimalControlProblem(
        dynamics=PiecewiseAffineDynamics(
            [
                _mode("x", (1.0, 0.0), [(1.0, 1.0), (-2.0, 1.0)], T, load),
                _mode("-u", (0.0, -1.0), [(-1.0, -1.0), (-1.0, 2.0)], T, load),
                _mode("u - x, above", (-1.0, 1.0), [(-1.0, -1.0), (1.0, -2.0)], T, load),
                _mode("u - x, left", (-1.0, 1.0), [(1.0, 1.0), (2.0, -1.0)], T, load),
            ],
            state_names=["x"],
            control_names=["u"],
        ),
        horizon=T,
        cost=QuadraticCost(R=2 * weight, q=sums, p=[1.0] if flag("terminal_cost", terminal_cost) else 0.0),
        control_set=symmetric("control_bound", limit),
        state_set=symmetric("state_bound", [positive_number("state_bound", state_bound)]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=control_band(control_spectrum, T),
        name="max_min_network",
    )


def _mode(
    name: str, slopes: tuple[float, float], rows: list[tuple[float, float]], horizon: int, load_first: bool
) -> AffineMode:
    """Return x+ = slopes . (x, u) where every row . (x, u) <= 0; at t = 0 x+ = u with ``load_first``."""
    A, B, region = np.array([[slopes[0]]]), np.array([[slopes[1]]]), np.array(rows)
    if load_first:
        A, B = _loaded(A, 0.0, horizon), _loaded(B, 1.0, horizon)
    return AffineMode(A, B, G=region[:, :1], H=region[:, 1:], h=np.zeros(len(region)), name=name)


def _loaded(slope: Array, first: float, horizon: int) -> Array:
    """Return the slope (1, 1) for every time, (T, 1, 1), with another one at t = 0."""
    slopes = np.repeat(slope[None], horizon, axis=0)
    slopes[0] = first
    return slopes
