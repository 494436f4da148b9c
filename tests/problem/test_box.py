"""Boxes, points and ends against linear programming and their definition."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from helpers.checks.spectral import normal_gap_terms
from helpers.linear_problems import generator
from lin_freq_ocp import Box
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem import end_within
from lin_freq_ocp.sets import Everything, Point

# ------------------------------------------------------------------------------------------------------------ sets


BOXES = {
    "bounded": Box([-1.0, 0.0, 2.0], [1.0, 0.5, 2.0]),
    "half spaces": Box([None, 0.0, None], [1.0, None, None]),
    "point": Point([0.3, -0.2, 1.0]),
    "everything": Everything().at_dimension(3, "set"),
    "one number": Box(-2, None).at_dimension(3, "set"),
}


def oracle_support(box: Box, y: np.ndarray) -> float:
    """Return max <y, v> over the box by HiGHS, which knows nothing of closed forms."""
    answer = linprog(-y, bounds=list(zip(box.lower, box.upper, strict=True)), method="highs")
    assert answer.status in (0, 3)
    return np.inf if answer.status == 3 else -answer.fun


@pytest.mark.parametrize("box", BOXES.values(), ids=BOXES.keys())
def test_support_and_normal_gap_against_linear_programming(box):
    rng = generator(11)
    directions = [rng.normal(size=3) * rng.integers(0, 2, size=3) for _ in range(12)]
    for y in [*directions, *np.eye(3), *-np.eye(3), np.zeros(3)]:
        expected = oracle_support(box, y)
        v = box.project(rng.normal(size=3))
        assert box.support(y) == pytest.approx(expected, abs=1e-12)
        assert normal_gap_terms(box, v, y).sum() == pytest.approx(expected - y @ v, abs=1e-12)
        assert normal_gap_terms(box, v, y).sum() >= 0


@pytest.mark.parametrize("box", BOXES.values(), ids=BOXES.keys())
def test_normal_gap_is_zero_exactly_on_the_normal_cone(box):
    rng = generator(12)
    for _ in range(20):
        w = 3 * rng.normal(size=3)
        v = box.project(w)
        assert box.contains(v)
        assert normal_gap_terms(box, v, w - v).sum() == pytest.approx(0, abs=1e-12)  # w - P(w) is normal at P(w)
        for i in np.flatnonzero((v > box.lower) & (v < box.upper)):
            for sign in (1, -1):
                assert (
                    normal_gap_terms(box, v, sign * np.eye(3)[i]).sum() > 0
                )  # nothing is normal where the box leaves room


@pytest.mark.parametrize("box", BOXES.values(), ids=BOXES.keys())
def test_projection_is_the_nearest_point(box):
    rng = generator(13)
    for _ in range(20):
        w = 3 * rng.normal(size=3)
        nearest = box.project(w)
        np.testing.assert_array_equal(box.project(nearest), nearest)
        np.testing.assert_allclose(box.violation(w), np.abs(w - nearest), atol=1e-15)
        for other in (box.project(3 * rng.normal(size=3)) for _ in range(5)):
            assert (w - nearest) @ (other - nearest) <= 1e-12  # the variational inequality


def test_contains_is_the_definition_in_every_row():
    box = Box([0.0, -np.inf], [1.0, 2.0])
    points = np.array([[0.0, 2.0], [1.0, -1e300], [1.0 + 1e-9, 0.0], [0.5, 2.1], [-0.1, 0.0]])
    np.testing.assert_array_equal(box.contains(points), [True, True, False, False, False])
    np.testing.assert_array_equal(box.contains(points, tolerance=1e-8), [True, True, True, False, False])
    np.testing.assert_allclose(box.violation(points)[:, 0], [0, 0, 1e-9, 0, 0.1], rtol=1e-6)


def test_a_box_per_time_is_a_box_at_each_time():
    lower, upper = np.array([[0.0, -1.0], [-np.inf, 2.0]]), np.array([[1.0, 1.0], [5.0, 2.0]])
    tube, y = Box(lower, upper), np.array([[1.0, -2.0], [-0.5, 3.0]])
    for t in range(2):
        alone = Box(lower[t], upper[t])
        assert tube.support(y)[t] == alone.support(y[t])
        np.testing.assert_array_equal(tube.fixed[t], alone.fixed)
    np.testing.assert_array_equal(tube.fixed, [[False, False], [False, True]])


def test_a_direction_without_bound_and_a_zero_direction():
    box = Box([None, 0.0], [None, 1.0])
    assert box.support(np.array([0.0, 1.0])) == 1.0
    assert box.support(np.zeros(2)) == 0.0  # not NaN from 0 * inf
    assert box.support(np.array([1e-300, 0.0])) == np.inf
    assert normal_gap_terms(box, np.array([5.0, 1.0]), np.array([0.0, 3.0])).sum() == 0.0
    assert normal_gap_terms(box, np.array([5.0, 1.0]), np.array([0.0, -3.0])).sum() == 3.0


def test_an_end_within_bounds_is_membership_in_both_and_keeps_itself_where_there_is_no_point():
    one, other = Box([-1.0, -np.inf], [1.0, 3.0]), Box([0.0, -2.0], [np.inf, 5.0])
    both, beyond = end_within(one, other)
    points = 4 * generator(14).normal(size=(200, 2))
    np.testing.assert_array_equal(both.contains(points), one.contains(points) & other.contains(points))
    assert not beyond.any()
    kept, beyond = end_within(Point([2.0, 0.0]), one)
    np.testing.assert_array_equal(beyond, [True, False])
    np.testing.assert_array_equal(kept.lower, [2.0, 0.0])
    assert not end_within(Point([1.0 + 1e-12, 0.0]), one)[1].any()  # rounding


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Box([1.0, 0.0], [0.0, 1.0]), "Box.lower[0]"),
        (lambda: Box(np.zeros((2, 2)), [[0.0, 0.0], [0.0, -1.0]]), "Box.lower[1][1]"),
        (lambda: Box(np.inf, None), "Box.lower"),
        (lambda: Box(None, -np.inf), "Box.upper"),
        (lambda: Box(np.nan, 1.0), "Box.lower"),
        (lambda: Box([0.0, 0.0], [1.0, 1.0, 1.0]), "Box"),
        (lambda: Box(np.zeros((1, 2, 3)), 1.0), "Box"),
        (lambda: Box("a", 1.0), "Box.lower"),
        (lambda: Box(1j, 2.0), "Box.lower"),
        (lambda: Point([np.inf]), "Point[0]"),
        (lambda: Box([0.0, 0.0], 1.0).at_dimension(3, "control_set"), "control_set"),
    ],
)
def test_sets_that_are_none_are_refused_by_name(make, field):
    with pytest.raises(ProblemError) as caught:
        make()
    assert caught.value.field == field


# -------------------------------------------------------------------------------------------------------- measures


def test_bounds_per_time_may_have_none():
    box = Box([[None, -1], [0, None]], None)
    assert box.lower.tolist() == [[-np.inf, -1], [0, -np.inf]]
    assert box.upper.tolist() == [[np.inf, np.inf], [np.inf, np.inf]]
