"""Two masses and a spring: the benchmark of Wie and Bernstein."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

from lin_freq_ocp.arrays import positive_number
from lin_freq_ocp.library.bounds import notch_at, symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem

MASS_1, MASS_2 = 1.0, 1.0  # kg


def two_mass_spring(
    horizon: int = 200,
    sampling_time: float = 0.05,
    stiffness: float = 1.0,
    notch_width_hz: float | None = 0.2,
    initial_state: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    terminal_state: Sequence[float] | None = (9.0, 0.0, 0.0, 0.0),
    deflection_bound: float | None = 1.0,
    force_bound: float | None = 1.0,
) -> OptimalControlProblem:
    """Push one of two masses joined by a spring, and keep the spring's own frequency still.

    Minimise 1/2 sum of u_t^2. The stop band lies on a *state*, the deflection of the spring, around the frequency
    sqrt(k (1/m1 + 1/m2)) at which the masses swing against each other; for k = 1 N/m it is sqrt(2) rad/s. The
    deflection is 0 at both ends, so that its DFT shows the vibration and not a ramp.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds.
    stiffness : float
        Of the spring [N/m]; the benchmark's nominal value is 1, its uncertainty 0.5 to 2.
    notch_width_hz : float or None
        Width in Hz of the band removed from the deflection; None: no frequency constraint.
    initial_state, terminal_state : (4,)
        Position of body 1 [m], deflection x2 - x1 [m], speed of body 1 [m/s], rate of the deflection [m/s]. A
        terminal_state of None is free.
    deflection_bound, force_bound : float or None
        Symmetric bounds on the deflection [m] and the force [N].

    Notes
    -----
    Wie and Bernstein, "Benchmark problems for robust control design", J. Guidance, Control, and Dynamics 15(5), 1992:
    m1 = m2 = 1 kg, k = 1 N/m, force on body 1. The move, its time and the bounds are chosen here.
    """
    k = positive_number("stiffness", stiffness)
    flexible = sqrt(k * (1 / MASS_1 + 1 / MASS_2))  # rad/s
    return OptimalControlProblem(
        dynamics=LinearDynamics.from_continuous(
            [[0, 0, 1, 0], [0, 0, 0, 1], [0, k / MASS_1, 0, 0], [0, -(flexible**2), 0, 0]],
            [[0], [0], [1 / MASS_1], [-1 / MASS_1]],
            sampling_time,
            state_names=["position [m]", "deflection [m]", "speed [m/s]", "deflection rate [m/s]"],
            control_names=["force [N]"],
        ),
        horizon=horizon,
        cost=QuadraticCost(R=1.0),
        control_set=symmetric("force_bound", force_bound),
        state_set=symmetric("deflection_bound", [None, deflection_bound, None, None]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        state_spectrum=notch_at(flexible, notch_width_hz, "deflection"),
        name="two_mass_spring",
    )
