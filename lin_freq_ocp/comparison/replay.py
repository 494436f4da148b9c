"""Feeding a control to the dynamics from the initial state, where that means anything."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.analysis.measures import Measures, amplification, measure, one_step_residual, replay_is_meaningful
from lin_freq_ocp.arrays import Array
from lin_freq_ocp.errors import NumericalError
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.simulation import simulate
from lin_freq_ocp.problem.trajectory import Trajectory

STOPPED = "leave the regions of all modes"
"""What the states of a replay do that ended early."""


@dataclass(frozen=True, eq=False)
class Replay:
    """What a control does.

    Attributes
    ----------
    trajectory : Trajectory
        The replayed one; where a replay means nothing, the planned states with this control.
    meaningful : bool
        Whether the states are a replay: false where rounding errors would be amplified beyond use.
    measures : Measures
        Without a replay, all that depends on the states is None.
    one_step_residual : (n,)
        Largest |x_{t+1} - f_t(x_t, u_t)| over time, per state: how far the control misses the planned states each step.
    stopped : str
        Why the replay came to no end, where the dynamics have modes and none holds any more; else empty.
    """

    trajectory: Trajectory
    meaningful: bool
    measures: Measures
    one_step_residual: Array
    stopped: str = ""


def replay(problem: OptimalControlProblem, u: Array, planned: Trajectory) -> Replay:
    """Replay u, shape (T, m), from the first state of the planned trajectory."""
    with_plan = Trajectory(planned.x, u)
    residual = np.abs(one_step_residual(problem, with_plan)).max(0)
    stopped = ""
    if replay_is_meaningful(amplification(problem.dynamics_along(planned), problem.horizon)):
        try:
            trajectory = simulate(problem, u, planned.x[0])
            return Replay(trajectory, True, measure(problem, trajectory), residual)
        except NumericalError as error:
            if isinstance(problem.dynamics, LinearDynamics):
                raise
            stopped = str(error)
    unknown = {"cost": None, "state_violation": None, "stage_violation": None, "terminal_error": None}
    of_states = {"terminal_errors": None, "state_stopband_energy": None, "state_stopband_peak": None}
    return Replay(with_plan, False, replace(measure(problem, with_plan), **unknown, **of_states), residual, stopped)
