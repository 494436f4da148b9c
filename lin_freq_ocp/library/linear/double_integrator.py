"""The double integrator, rest to rest, under a speed limit."""

from __future__ import annotations

from collections.abc import Sequence

from lin_freq_ocp.library.bounds import symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.bands import low_pass


def double_integrator(
    horizon: int = 200,
    sampling_time: float = 0.02,
    cutoff_hz: float | None = 5.0,
    initial_state: Sequence[float] = (0.0, 0.0),
    terminal_state: Sequence[float] | None = (1.0, 0.0),
    speed_bound: float | None = 0.3,
    control_bound: float | None = 1.0,
) -> OptimalControlProblem:
    """Move a unit mass from rest to rest under a speed limit and a low pass.

    Minimise 1/2 sum of u_t^2. Without bounds the acceleration falls along a line and the speed is a parabola, which the
    speed limit cuts flat over half of the time. That needs an acceleration of exactly 0 there, which a low-passed one
    cannot have for long: it touches the limit again and again instead, and costs more.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds.
    cutoff_hz : float or None
        Low-pass cut-off of the acceleration in Hz; None: no frequency constraint.
    initial_state, terminal_state : (2,)
        Position [m], speed [m/s]. A terminal_state of None is free.
    speed_bound, control_bound : float or None
        Symmetric bounds on the speed [m/s] and the acceleration [m/s^2].

    Notes
    -----
    The plant: Rao and Bernstein, "Naive control of the double integrator", IEEE Control Systems Magazine 21(5), 2001.
    State bounds in minimum-energy problems on it: Bryson and Ho, "Applied Optimal Control", 1975, chapter 3.
    The numbers are chosen here.
    """
    return OptimalControlProblem(
        dynamics=LinearDynamics.from_continuous(
            [[0, 1], [0, 0]],
            [[0], [1]],
            sampling_time,
            state_names=["position [m]", "speed [m/s]"],
            control_names=["acceleration [m/s^2]"],
        ),
        horizon=horizon,
        cost=QuadraticCost(R=1.0),
        control_set=symmetric("control_bound", control_bound),
        state_set=symmetric("speed_bound", [None, speed_bound]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=None if cutoff_hz is None else low_pass(cutoff_hz=cutoff_hz),
        name="double_integrator",
    )
