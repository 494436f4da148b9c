"""Example 3 of the paper: the buck converter, its two modes as they are.

With the current i, the voltage v, a = exp(-R Tc/L), r = I_ref R and the border i_b(v) = (I_ref - v/R)/a + v/R,

    i+ = a i + (1 - a) v/R                                      i <= i_b(v): the switch stays closed
    i+ = d ((v - R i)/(v - r))^((R + r_d)/R)                    i >= i_b(v): it opens within the period

with d = I_ref exp(-(R + r_d) Tc/L). With e = i - i_b(v) the first is I_ref + a e, and with r_d = 0 the second is
I_ref - r a e/(v - r): a fraction. The map is continuous, I_ref on the border, for every r_d, since there
(v - R i)/(v - r) = 1/a.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp
from typing import Any

from lin_freq_ocp.arrays import brief, positive_integer, positive_number
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.library.piecewise.hybrid import control_band
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.piecewise_smooth import PiecewiseSmoothDynamics, SmoothMode
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box


def buck_converter(
    horizon: int = 8,
    v_min: float | None = 2.2,
    v_max: float | None = 6.0,
    initial_state: Sequence[float] = (0.65,),
    terminal_state: Sequence[float] | None = (0.8,),
    diode_resistance: float = 0.0,
    control_spectrum: Any = None,
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

    Notes
    -----
    The paper gives no numbers: those of the defaults are chosen here. Modes: "on", listed first, and "off".
    """
    T, step = positive_integer("horizon", horizon), positive_number("sampling_time", sampling_time)
    R, L = positive_number("resistance", resistance), positive_number("inductance", inductance)
    reference = positive_number("current_reference", current_reference)
    diode = 0.0 if not diode_resistance else positive_number("diode_resistance", diode_resistance)
    pole, kept = reference * R, exp(-R * step / L)
    if v_min is not None and not v_min > pole:
        raise ProblemError("v_min", brief(v_min), f"a voltage above {pole:g} V, the pole of the second mode, or None")

    def excess(x: Any, u: Any) -> Any:
        return x[0] - (reference - u[0] / R) / kept - u[0] / R

    def off(x: Any, u: Any) -> list[Any]:
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
