"""Small piecewise-affine problems: kinks and jumps of the map, several extremals."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, pi, sin

import numpy as np

from lin_freq_ocp.base.arrays import positive_integer, positive_number, to_shape
from lin_freq_ocp.library.common import Spectrum, control_band, flag, sum_of_squares, symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.hybrid.piecewise_affine import AffineMode, PiecewiseAffineDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem


def absolute_value(
    horizon: int = 2,
    preferred_control: float = 0.1,
    control_spectrum: Spectrum = None,
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
        b: the value of u_t without cost. It breaks the symmetry.
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

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    Notes
    -----
    Mode "+" is x >= 0, listed first, and mode "-" x <= 0; the map is continuous. Chosen here. Costs from x_0 = 0, if no
    bound is active (b <= 1/2): J = -T (b + 1/4), and -T (b + 1/4) + 2 b with x_1 < 0.

    Examples
    --------
    >>> lfo.library.absolute_value().horizon
    2
    """
    T = positive_integer("horizon", horizon)
    limit = positive_number("control_bound", control_bound)
    preferred = float(to_shape("preferred_control", preferred_control, ()))
    reach = float(np.abs(to_shape("initial_state", initial_state, (1,)))[0]) + T * limit
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


STATE_WEIGHT = -0.5  # of x_1 .. x_{T-1}, against 1 for x_T


def max_min_network(
    horizon: int = 2,
    load_first: bool = True,
    control_weight: float = 0.0,
    control_spectrum: Spectrum = (0,),
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

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    Notes
    -----
    Four modes around the origin: "x" (x + u <= 0, u <= 2 x), "-u" (x + u >= 0, x >= 2 u), and u - x in the rest, which
    is not convex and stands as two, "u - x, above" (x + u >= 0, x <= 2 u) and "u - x, left" (x + u <= 0, u >= 2 x). The
    map is continuous. With ``load_first`` all four are x+ = u at t = 0, so that the maps depend on time. Chosen here.

    Examples
    --------
    >>> lfo.library.max_min_network().horizon
    2
    """
    T, limit = positive_integer("horizon", horizon), positive_number("control_bound", control_bound)
    weight = float(to_shape("control_weight", control_weight, ()))
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
        A, B = np.tile(A, (horizon, 1, 1)), np.tile(B, (horizon, 1, 1))
        A[0], B[0] = 0.0, 1.0
    return AffineMode(A, B, G=region[:, :1], H=region[:, 1:], h=np.zeros(len(region)), name=name)


CONTRACTION, ANGLE = 0.8, pi / 3


def switched_rotation(
    horizon: int = 6,
    control_spectrum: Spectrum = None,
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

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Bemporad and Morari, "Control of systems integrating logic, dynamics, and constraints", Automatica 35(3), 1999, the
    example of predictive control. Optima are listed in docs/hybrid_systems.md.

    Examples
    --------
    >>> lfo.library.switched_rotation().horizon
    6
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
