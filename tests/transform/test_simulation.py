"""The replay of controls against the recursion."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.linear_problems import problem
from lin_freq_ocp import Box, LinearDynamics, OptimalControlProblem, QuadraticCost, simulate
from lin_freq_ocp.errors import NumericalError, ProblemError


def test_simulate_refuses_what_overflows():
    made = OptimalControlProblem(LinearDynamics([[1e100]], [[1.0]]), 6, QuadraticCost(), initial_state=[1.0])
    with pytest.raises(NumericalError, match="t = 4"):  # 1, 1e100, 1e200, 1e300, overflow
        simulate(made, np.zeros((6, 1)))
    simulate(made, np.zeros((6, 1)), initial_state=[0.0])


@pytest.mark.parametrize(
    ("u", "start", "field"),
    [
        (np.zeros((5, 1)), [0.0, 0.0], "u"),
        (np.zeros(4), [0.0, 0.0], "u"),
        (np.full((4, 1), np.inf), [0.0, 0.0], "u[0][0]"),
        (np.zeros((4, 1)), [0.0], "initial_state"),
        (np.zeros((4, 1)), None, "initial_state"),  # the problem has none
    ],
)
def test_simulate_refuses_what_it_cannot_replay(u, start, field):
    with pytest.raises(ProblemError) as caught:
        simulate(problem(initial_state=Box([0, 0], [0, 1])), u, start)
    assert caught.value.field == field


def test_dynamics_alone_are_no_problem():
    with pytest.raises(ProblemError, match=r"problem: got .* expected an OptimalControlProblem"):
        simulate(problem().dynamics, np.zeros((4, 1)))
