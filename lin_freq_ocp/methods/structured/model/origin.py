"""The point that y is measured from: the references, and the value of a control where its bounds are equal.

A control that is fixed at some times leaves the stages there, unless it is in a row that couples times: its deviation
is zero. Its multiplier follows from stationarity, nu = -(eta_C dJ/du - B'eta + (rows of stages)'lambda).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory


@dataclass(frozen=True, eq=False)
class Origin:
    """Values of states and controls, those of u_T being zero, and which of them are held, (T+1, n+m)."""

    values: Array
    held: Mask
    states: int

    @property
    def x(self) -> Array:
        """Return the states, (T+1, n)."""
        return self.values[:, : self.states]

    @property
    def u(self) -> Array:
        """Return the controls, (T, m)."""
        return self.values[:-1, self.states :]


def origin_of(problem: OptimalControlProblem) -> Origin:
    """Return the origin of a problem."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    values, held, tube = np.zeros((T + 1, n + m)), np.zeros((T + 1, n + m), dtype=bool), problem.control_tube
    fixed = (tube.lower == tube.upper) & ~_coupled_controls(problem)
    values[:, :n] = problem.quadratic.x_ref
    values[:-1, n:] = np.where(fixed, tube.lower, problem.quadratic.u_ref)
    held[:-1, n:] = fixed
    return Origin(values, held, n)


def held_multipliers(
    problem: OptimalControlProblem, origin: Origin, found: Multipliers, trajectory: Trajectory | None
) -> Array:
    """Return nu, (T, m), with those of the held controls; at eta_C = 0, no trajectory is needed."""
    held, n, m = origin.held[:-1, origin.states :], problem.state_dim, problem.control_dim
    shapes = (problem.horizon + 1, n), (problem.horizon, m)
    slopes = -problem.linear.pull_back(found.eta)[1]
    for term in problem.terms:
        if term.map.stage_form(n, m) is not None:
            slopes += term.map.pull_back(found.stage[term.name], shapes)[1]
    if found.eta_C:
        assert trajectory is not None  # the cost has slopes
        slopes += found.eta_C * problem.quadratic.gradient(trajectory.x, trajectory.u)[1]
    return np.where(held, -slopes, found.nu)


def _coupled_controls(problem: OptimalControlProblem) -> Mask:
    """Return which controls are in rows that couple times, (m,)."""
    n, m = problem.state_dim, problem.control_dim
    coupled = problem.control_stop.any(axis=0)
    for term in problem.terms:
        if term.map.stage_form(n, m) is None:
            form = term.map.spectrum_form(n, m)
            coupled = coupled | (True if form is None else form.row[n:] != 0)
    return np.asarray(coupled)
