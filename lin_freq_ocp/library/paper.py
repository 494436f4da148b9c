"""Examples 1 to 3 of the paper, completed where it leaves data out."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, pi

import numpy as np
from numpy.typing import NDArray

from lin_freq_ocp.base.arrays import brief, positive_integer, positive_number
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.formulas.nodes import Formula, norm
from lin_freq_ocp.library.common import Spectrum, control_band, sampled_plant, symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics, SmoothMode
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import low_pass

Signals = NDArray[np.object_]
CART_MASS, PENDULUM_MASS, HALF_LENGTH, GRAVITY = 2.5, 0.6, 0.25, 9.8  # kg, kg, m, m/s^2


def pendulum(
    horizon: int = 240,
    sampling_time: float = 0.01,
    parameters: str = "paper",
    cutoff: float | None = 0.8 * pi,
    initial_state: Sequence[float] = (-0.15, 0.1, 0.0, 0.0),
    terminal_state: Sequence[float] | None = (0.15, -0.1, 0.0, 0.0),
    state_bounds: Sequence[float | None] = (0.2, 20 * pi / 180, 15.0, 30.0),
    control_bound: float | None = 5.0,
) -> OptimalControlProblem:
    """Move a cart with an inverted pendulum by a low-passed force: Example 1 of the paper.

    Minimise the sum of u_t^2 (the paper's cost, without 1/2).

    Parameters
    ----------
    horizon : int
        T; the paper's 240.
    sampling_time : float
        Seconds. The paper's printed matrices have 0.01 (its text says 0.1).
    parameters : {"paper", "physical"}
        How the paper's denominator m + M - (m^2 l^2/J + m l^2) is read: literally, as its own matrices do, or as
        the physics has it, m + M - m^2 l^2/(J + m l^2).
    cutoff : float or None
        Low-pass cut-off of the force in rad/sample (4 pi/5 in the paper, itself passed); None: no frequency constraint.
    initial_state, terminal_state : (4,)
        Position [m], angle [rad], speed [m/s], angular speed [rad/s]. The paper gives none; these show all that its
        Figure 3 claims. A terminal_state of None is free.
    state_bounds : (4,)
        Symmetric bounds on the states.
    control_bound : float or None
        Symmetric bound on the force [N].

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    Examples
    --------
    >>> lfo.library.pendulum().horizon
    240
    """
    M, m, length = CART_MASS, PENDULUM_MASS, HALF_LENGTH
    J = 4 / 3 * m * length**2
    pivot = J + m * length**2
    if parameters == "paper":
        mass = m + M - ((m * length) ** 2 / J + m * length**2)
    elif parameters == "physical":
        mass = m + M - (m * length) ** 2 / pivot
    else:
        raise ProblemError("parameters", repr(parameters), "'paper' or 'physical'")
    A, B = np.zeros((4, 4)), np.zeros((4, 1))
    A[0, 2] = A[1, 3] = 1
    A[2, 1] = -((m * length) ** 2) * GRAVITY / (pivot * mass)
    A[3, 1] = m * GRAVITY * length * (m + M) / (pivot * mass)
    B[2, 0] = 1 / mass
    B[3, 0] = -m * length / (pivot * mass)
    states = "position [m], angle [rad], speed [m/s], angular speed [rad/s]"
    return OptimalControlProblem(
        dynamics=sampled_plant(A, B, sampling_time, states, "force [N]"),
        horizon=horizon,
        cost=QuadraticCost(R=2.0),  # sum of u_t^2: the paper's cost has no 1/2
        control_set=symmetric("control_bound", control_bound),
        state_set=symmetric("state_bounds", state_bounds),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=None if cutoff is None else low_pass(cutoff),
        name="pendulum",
    )


def norm_dynamics(
    initial_state: Sequence[float] = (1.0, 0.0),
    horizon: int = 10,
    control_spectrum: Spectrum = None,
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

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Example 2 of the paper, from Gruene and Pannek, Nonlinear Model Predictive Control, 2017, example 5.8. States
    have no bounds in it; none is needed: |x_{t+1}|^2 <= |x_t|^2 ((1 - u)^2 + u^2), and u is in [0, 1].

    Examples
    --------
    >>> lfo.library.norm_dynamics().horizon
    10
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


def buck_converter(
    horizon: int = 8,
    v_min: float | None = 2.2,
    v_max: float | None = 6.0,
    initial_state: Sequence[float] = (0.65,),
    terminal_state: Sequence[float] | None = (0.8,),
    diode_resistance: float = 0.0,
    control_spectrum: Spectrum = None,
    resistance: float = 2.0,
    inductance: float = 1e-3,
    sampling_time: float = 2.5e-4,
    current_reference: float = 1.0,
    terminal_price: float = 0.0,
) -> OptimalControlProblem:
    """Lead the current of a buck converter from one value to another: a concave kink, and a mode that is a fraction.

    Minimise the sum of i_t^2 + v_t^2 (no 1/2, no terminal cost) within 0 <= i <= I_ref.

    Parameters
    ----------
    horizon : int
        T.
    v_min, v_max : float or None
        Bounds of the voltage [V]. The paper has none; then the second mode is never used at an optimum, because the
        first makes the same i+ of a smaller voltage. A lower bound must be above ``current_reference * resistance``,
        where the second mode has its pole.
    initial_state, terminal_state : (1,)
        Current [A]. A terminal_state of None is free.
    diode_resistance : float
        r_d [ohm]. 0: the simplified map of the paper, with r_d = 0 in its coefficients, too (otherwise it jumps on the
        border). Above 0: the map before the simplification, with its power (R + r_d)/R.
    control_spectrum : band, list of bands, list of bins, "freq" or None
        Frequency constraints on the voltage; "freq" removes the bins max(2, ceil(T/3)) <= k <= T//2.
    resistance, inductance, sampling_time, current_reference : float
        R [ohm], L [H], Tc [s], I_ref [A].
    terminal_price : float
        p of an additional cost p i_T [1/A].

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    Notes
    -----
    With the current i, the voltage v, a = exp(-R Tc/L), r = I_ref R and the border i_b(v) = (I_ref - v/R)/a + v/R,

        i+ = a i + (1 - a) v/R                                      i <= i_b(v): "on", the switch stays closed
        i+ = d ((v - R i)/(v - r))^((R + r_d)/R)                    i >= i_b(v): "off", it opens within the period

    with d = I_ref exp(-(R + r_d) Tc/L). With e = i - i_b(v) the first is I_ref + a e, and with r_d = 0 the second is
    I_ref - r a e/(v - r): a fraction. The map is continuous, I_ref on the border, for every r_d, since there
    (v - R i)/(v - r) = 1/a. The paper gives no numbers: those of the defaults are chosen here.

    Examples
    --------
    >>> lfo.library.buck_converter().horizon
    8
    """
    T, step = positive_integer("horizon", horizon), positive_number("sampling_time", sampling_time)
    R, L = positive_number("resistance", resistance), positive_number("inductance", inductance)
    reference = positive_number("current_reference", current_reference)
    diode = 0.0 if not diode_resistance else positive_number("diode_resistance", diode_resistance)
    pole, kept = reference * R, exp(-R * step / L)
    if v_min is not None and not v_min > pole:
        raise ProblemError("v_min", brief(v_min), f"a voltage above {pole:g} V, the pole of the second mode, or None")

    def excess(x: Signals, u: Signals) -> Formula:
        return x[0] - (reference - u[0] / R) / kept - u[0] / R

    def off(x: Signals, u: Signals) -> list[Formula]:
        if not diode:
            return [reference - pole * kept * excess(x, u) / (u[0] - pole)]
        # the power as exp(log): the fraction is above 1, or 1/a on the border
        falling = (R + diode) / R * ((u[0] - R * x[0]) / (u[0] - pole)).log()
        return [reference * exp(-(R + diode) * step / L) * falling.exp()]

    modes = [
        SmoothMode(lambda x, u: [reference + kept * excess(x, u)], lambda x, u: [excess(x, u)], name="on"),
        SmoothMode(off, lambda x, u: [-excess(x, u)], domain=lambda x, u: [u[0] - pole], name="off"),
    ]
    return OptimalControlProblem(
        dynamics=PiecewiseSmoothDynamics(
            modes, 1, 1, sampling_time=step, state_names=["current [A]"], control_names=["voltage [V]"]
        ),
        horizon=T,
        cost=QuadraticCost(Q=2.0, R=2.0, p=[terminal_price]),
        control_set=Box([v_min], [v_max]),
        state_set=Box([0.0], [reference]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=control_band(control_spectrum, T),
        name="buck_converter",
    )
