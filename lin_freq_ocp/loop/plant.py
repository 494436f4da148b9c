"""The plant of a simulated loop: a function, a model of python-control, dynamics, or the model of the problem."""

from __future__ import annotations

import inspect
from collections.abc import Callable

import numpy as np

from lin_freq_ocp.base.arrays import Array, brief, real_array
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError, first_line
from lin_freq_ocp.problem.dynamics.base import Dynamics
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem

Plant = Callable[[int, Array, Array], Array]  # from k, x (n,) and u (m,) to the next state (n,)


def plant_of(given: object, problem: OptimalControlProblem) -> Plant:
    """Return a plant as a function of the step, the state and the control; ProblemError if it is none."""
    if given is None:
        return _of_dynamics("problem.dynamics", problem.dynamics, problem)
    if isinstance(given, Dynamics):
        return _of_dynamics("plant", given, problem)
    if hasattr(given, "A") and hasattr(given, "B") and hasattr(given, "dt"):
        model = LinearDynamics.from_statespace(given, problem.sampling_time)
        return _of_dynamics("plant", model, problem)
    if not callable(given):
        expected = "a function of (x, u), a model of python-control, or dynamics"
        raise ProblemError("plant", brief(given), expected)
    return _of_function(given, problem.state_dim)


def _of_dynamics(field: str, dynamics: Dynamics, problem: OptimalControlProblem) -> Plant:
    got, expected = (dynamics.state_dim, dynamics.control_dim), (problem.state_dim, problem.control_dim)
    if got != expected:
        raise ProblemError(field, f"{got} states and controls", f"{expected}, as the problem has")
    try:
        for steps in (1, 2):
            dynamics.require_horizon(steps)
    except ProblemError:
        advice = "Give the plant that is controlled."
        raise ProblemError(field, "dynamics given per time", "a plant that does not depend on time", advice) from None
    step = dynamics.stepper(1)
    return lambda k, x, u: step(0, x, u)


def _of_function(function: Callable[..., object], n: int) -> Plant:
    try:
        takes = len(inspect.signature(function).parameters)
    except ValueError:  # a function that does not say
        takes = 2

    def step(k: int, x: Array, u: Array) -> Array:
        try:
            found = function(k, x, u) if takes == 3 else function(x, u)
        except Exception as error:
            raise UnsupportedError(f"plant: at step {k} it raised {first_line(error)}") from error
        state = np.asarray(found, dtype=float)
        if state.shape != (n,) or not np.isfinite(state).all():
            raise ProblemError("plant", f"{brief(found)} at step {k}", f"a finite state of shape {(n,)}")
        return real_array("plant", state)

    return step
