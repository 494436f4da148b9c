"""The replay of controls against the recursion."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.linear_problems import VARYING, M, N, T, at_time, dynamics_data, generator, problem
from lin_freq_ocp import Box, LinearDynamics, OptimalControlProblem, QuadraticCost, simulate
from lin_freq_ocp.errors import NumericalError, ProblemError
from lin_freq_ocp.problem import measures


@pytest.mark.parametrize("varying", VARYING)
def test_simulate_is_the_recursion(varying):
    data = dynamics_data(25, varying)
    made = OptimalControlProblem(LinearDynamics(**data), T, QuadraticCost(), initial_state=[1.0, -2.0, 0.5])
    u = generator(26).normal(size=(T, M))
    trajectory = simulate(made, u)
    x = [1.0, -2.0, 0.5]
    for t in range(T):
        np.testing.assert_allclose(trajectory.x[t], x, rtol=1e-11, atol=1e-12)
        A, B, d = at_time(data["A"], t, 2), at_time(data["B"], t, 2), at_time(data["offset"], t, 1)
        x = [sum(A[i, j] * x[j] for j in range(N)) + sum(B[i, j] * u[t, j] for j in range(M)) + d[i] for i in range(N)]
    np.testing.assert_allclose(trajectory.x[T], x, rtol=1e-11, atol=1e-12)
    np.testing.assert_array_equal(trajectory.u, u)
    np.testing.assert_allclose(measures.one_step_residual(made, trajectory), 0, atol=1e-12)
    np.testing.assert_array_equal(simulate(made, u, initial_state=[0.0, 0.0, 1.0]).x[0], [0.0, 0.0, 1.0])


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
