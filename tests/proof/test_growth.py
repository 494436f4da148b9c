"""By how much recursions through the dynamics enlarge an error."""

import numpy as np

from lin_freq_ocp.proof import growth, precision


def test_powers_of_one_matrix_and_products_grow_alike():
    A = np.array([[1.2, 0.3], [0.0, 0.9]])
    exact = np.log2(np.linalg.norm(np.linalg.matrix_power(A, 64)))
    assert exact <= growth(A, 64) <= exact + 1
    assert abs(growth(np.broadcast_to(A, (64, 2, 2)), 64) - exact) < 1


def test_a_product_that_overflows_has_its_logarithm():
    assert abs(growth(np.array([[2.0]]), 5000) - 5000) <= 1
    assert growth(np.array([[0.5]]), 5000) == 0


def test_radii_of_balls_grow_where_the_motion_does_not():
    turn = np.array([[np.cos(1.0), np.sin(1.0)], [-np.sin(1.0), np.cos(1.0)]])
    assert growth(turn, 1000) < 2
    assert precision(turn, 1000) > 2 * 1000 * np.log2(np.cos(1.0) + np.sin(1.0))
