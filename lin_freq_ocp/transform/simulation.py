"""The trajectory of given controls, by the dynamics alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import brief, one_component, real_array
from lin_freq_ocp.base.errors import NumericalError, ProblemError
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.trajectory import Trajectory


def simulate(problem: OptimalControlProblem, u: ArrayLike, initial_state: ArrayLike | None = None) -> Trajectory:
    """Return the trajectory of the controls u from the initial state, by the dynamics alone.

    Parameters
    ----------
    problem : OptimalControlProblem
        Its sets and bands play no part.
    u : (T, m)
        Controls.
    initial_state : (n,), optional
        Default: the problem's, which must then be a point.

    Returns
    -------
    Trajectory

    Raises
    ------
    ProblemError
        If a shape is wrong or there is no single initial state.
    NumericalError
        If the state overflows, or leaves the regions of all modes.

    Examples
    --------
    >>> problem = lfo.library.double_integrator(horizon=3)
    >>> lfo.simulate(problem, [[1.0], [0.0], [0.0]], [0.0, 0.0]).x.shape
    (4, 2)
    """
    require_problem(problem)
    u = real_array("u", u)
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    if u.shape != (T, m):
        raise ProblemError("u", f"shape {u.shape}", f"shape {(T, m)}", "Time is axis 0.")
    response = problem.response
    if response is not None:
        if initial_state is not None:
            advice = "All outputs follow from the controls."
            raise ProblemError("initial_state", brief(initial_state), "None for a FrequencyResponse", advice)
        return Trajectory(response.states(u), u)
    if initial_state is None:
        if not problem.initial_box.fixed.all():
            got = "None, for a problem whose initial state is not one point"
            raise ProblemError("initial_state", got, "a state to start from")
        initial_state = problem.initial_box.lower
    start = one_component(real_array("initial_state", initial_state), n)
    if start.shape != (n,):
        raise ProblemError("initial_state", f"shape {start.shape}", f"shape {(n,)}")
    x, step = np.empty((T + 1, n)), problem.form.stepper(T)
    x[0] = start
    with np.errstate(over="ignore", invalid="ignore"):
        for t in range(T):
            x[t + 1] = step(t, x[t], u[t])
    if not np.isfinite(x).all():
        t = int(np.argmin(np.isfinite(x).all(axis=1)))
        text = f"The open-loop state overflows at t = {t}: these dynamics cannot be simulated over {T} steps."
        raise NumericalError(text)
    return Trajectory(x, u)
