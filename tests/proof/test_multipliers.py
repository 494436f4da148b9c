"""Multipliers exactly in the domain of the conjugates, and points on the bounds that they belong to."""

from fractions import Fraction

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.problem import HalfSpaces, NormBall, StandardCone
from lin_freq_ocp.proof import project_on_bounds, shrink


def exact_square(vector):
    return sum(Fraction(one) ** 2 for one in vector.tolist())


def test_what_a_price_limits_is_below_it_exactly():
    ball = NormBall(2, np.asarray(1.0), np.asarray(0.7))
    given = np.random.default_rng(0).normal(size=(200, 3))
    found = shrink(ball, ball.subgradient(10 * given, 1.0))
    assert all(exact_square(one) < Fraction(0.7) ** 2 for one in found)
    assert np.allclose(np.linalg.norm(found, axis=1), 0.7, rtol=1e-14)


def test_multipliers_of_cones_are_in_the_dual_cone_exactly():
    cone = StandardCone()
    found = shrink(cone, cone.subgradient(np.random.default_rng(1).normal(size=(200, 3)), 1.0))
    assert all(one[0] <= 0 and exact_square(one[1:]) <= Fraction(one[0]) ** 2 for one in found)


def test_prices_of_single_values_are_kept():
    rows = HalfSpaces(np.zeros((1, 2)), np.full(2, 0.3))
    assert shrink(rows, rows.subgradient(np.array([[5.0, 0.1]]), 1.0)).tolist() == [[0.3, 0.1]]


def test_signals_move_to_bounds_and_what_does_not_fit_is_dropped():
    tube = lfo.Box(np.array([[-1.0, -1.0, -np.inf]]), np.array([[1.0, 1.0, np.inf]]))
    signal, normals = np.array([[0.9, 0.9, 0.9]]), np.array([[2.0, 3.0, 4.0]])
    found, kept = project_on_bounds(tube, signal, normals, np.array([[False, True, False]]))
    assert found.tolist() == [[1.0, 0.9, 0.9]]
    assert kept.tolist() == [[2.0, 0.0, 0.0]]
