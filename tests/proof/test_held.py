"""Rounded controls whose exact trajectory does not run away."""

from fractions import Fraction

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.proof import add_feedback, needs_feedback


def exact_end(problem, u):
    """Return the last state of a scalar system from 1, exactly."""
    a, b, x = Fraction(problem.linear.A[0, 0]), Fraction(problem.linear.B[0, 0]), Fraction(1)
    for one in u[:, 0].tolist():
        x = a * x + b * Fraction(one)
    return float(x)


def test_the_exact_trajectory_stays_near_the_given_one():
    dynamics = lfo.LinearDynamics([[1.7]], [[0.3]])
    problem = lfo.OptimalControlProblem(dynamics, 100, lfo.QuadraticCost(Q=1.0, R=1.0), initial_state=[1.0])
    at = lfo.solve(problem).trajectory
    held = add_feedback(problem, at)
    assert needs_feedback(problem)
    assert abs(exact_end(problem, at.u)) > 1.0
    assert abs(exact_end(problem, held.u)) < 1e-14
    assert np.abs(held.u - at.u).max() < 1e-11


def test_stable_systems_and_fixed_ends_need_none():
    assert not needs_feedback(lfo.library.pendulum())
    assert not needs_feedback(lfo.library.quarter_car())
