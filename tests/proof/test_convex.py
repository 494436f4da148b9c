"""Hessians that are semidefinite up to rounding become so exactly."""

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.proof.convex import convex_problem, is_semidefinite


def problem_of(Q):
    dynamics = lfo.LinearDynamics(np.eye(3) + 0.1 * np.eye(3, k=1), np.eye(3, 1, -2))
    return lfo.OptimalControlProblem(dynamics, 12, lfo.QuadraticCost(Q=Q, R=1.0), initial_state=[1.0, 0.5, 0.0])


def test_a_product_that_was_rounded_is_raised_by_roundings():
    C = np.array([[0.1, 0.7, -0.3]])
    given = C.T @ C
    assert not is_semidefinite(given)
    found = convex_problem(problem_of(given)).quadratic.Q
    assert is_semidefinite(found)
    assert np.abs(found - given).max() < 1e-13
    result = lfo.solve(problem_of(given))
    assert result.enclosure.width < 1e-10 * result.cost


def test_what_is_semidefinite_stays_as_it_is():
    problem = problem_of([[2.0, 1.0, 0.0], [1.0, 0.5, 0.0], [0.0, 0.0, 0.0]])
    assert convex_problem(problem) is problem


def test_what_is_not_semidefinite_stays_so():
    problem = problem_of([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert convex_problem(problem) is problem
