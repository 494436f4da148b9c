"""Sets beyond boxes: nearest points, support functions and normal cones against CVXPY; bad data."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest

import lin_freq_ocp as lfo

RNG = np.random.default_rng(1)
F = RNG.standard_normal((5, 3))
W = RNG.standard_normal((3, 3)) + 2 * np.eye(3)
CENTRE = np.array([0.5, -0.2, 0.1])

SETS = {  # and the same set in CVXPY
    "polyhedron": (
        lfo.Polyhedron(np.vstack([F, np.eye(3), -np.eye(3)]), np.ones(11)),
        lambda v: [F @ v <= 1, v <= 1, v >= -1],
    ),
    "ball": (lfo.Ball(1.5, CENTRE), lambda v: [cp.norm(v - CENTRE) <= 1.5]),
    "ball around zero": (lfo.Ball(2.0), lambda v: [cp.norm(v) <= 2]),
    "ellipsoid": (lfo.Ellipsoid(W, 1.2, CENTRE), lambda v: [cp.norm(W @ (v - CENTRE)) <= 1.2]),
    "cone and box": (
        lfo.SecondOrderCone(F[:2], [0.1, 0.2], [1.0, 0.0, 0.0], 0.5) & lfo.Box(-2, 2),
        lambda v: [cp.norm(F[:2] @ v + np.array([0.1, 0.2])) <= v[0] + 0.5, cp.abs(v) <= 2],
    ),
    "box and ball": (
        lfo.Box([0, None, -0.1], 1) & lfo.Ball(1.1),
        lambda v: [v[0] >= 0, v[2] >= -0.1, v <= 1, cp.norm(v) <= 1.1],
    ),
}


def oracle(constraints, objective) -> tuple[float, np.ndarray]:
    v = cp.Variable(3)
    problem = cp.Problem(objective(v), constraints(v))
    value = problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
    return value, v.value


@pytest.mark.parametrize("name", SETS)
def test_the_nearest_point_is_cvxpys(name):
    ours, theirs = SETS[name]
    for point in 3 * RNG.standard_normal((4, 3)):
        nearest = ours.project(point)
        expected = oracle(theirs, lambda v, point=point: cp.Minimize(cp.sum_squares(v - point)))[1]
        np.testing.assert_allclose(nearest, expected, atol=1e-4)  # CVXPY's: the root of its tolerance
        assert ours.contains(nearest, 1e-8)
        np.testing.assert_allclose(ours.project(nearest), nearest, atol=1e-5)


@pytest.mark.parametrize("name", SETS)
def test_the_support_function_is_cvxpys(name):
    ours, theirs = SETS[name]
    directions = RNG.standard_normal((4, 3))
    expected = [oracle(theirs, lambda v, y=y: cp.Maximize(y @ v))[0] for y in directions]
    np.testing.assert_allclose(ours.support(directions), expected, atol=1e-7)
    assert ours.support(np.zeros(3)) == 0


@pytest.mark.parametrize("name", SETS)
def test_what_points_from_the_nearest_point_outwards_is_normal_and_nothing_else(name):
    ours, _ = SETS[name]
    outside = np.array([4.0, 3.0, -5.0])
    nearest = ours.project(outside)
    assert abs(ours.normal_gap(nearest, outside - nearest)) < 1e-6
    assert ours.normal_gap(nearest, nearest - outside) > 0.1


def test_a_support_function_without_a_maximum_is_infinite():
    assert lfo.Polyhedron([[1, 0, 0]], [1]).support(np.array([0.0, 1, 0])) == np.inf
    assert lfo.Polyhedron([[1, 0, 0]], [1]).support(np.array([2.0, 0, 0])) == pytest.approx(2)


def test_an_empty_set_is_said_to_be_empty():
    empty = lfo.Polyhedron([[1.0], [-1.0]], [0.0, -1.0])
    with pytest.raises(lfo.NumericalError, match="empty"):
        empty.project(np.array([0.3]))


def test_a_ball_in_a_box_is_not_contained_where_only_one_of_them_is():
    both = lfo.Box(-1, 1) & lfo.Ball(1.2)
    points = np.array([[0.5, 0.5], [1.0, 1.0], [1.1, 0.0]])
    assert both.contains(points).tolist() == [True, False, False]
    np.testing.assert_allclose(both.violation(points), [0, np.sqrt(2) - 1.2, 0.1], atol=1e-12)


BAD = {
    "no matrix": (lambda: lfo.Polyhedron([1, 2], [1]), "Polyhedron.F"),
    "limits": (lambda: lfo.Polyhedron(np.eye(2), [1]), "Polyhedron.g"),
    "minus infinity": (lambda: lfo.Polyhedron(np.eye(2), [1, -np.inf]), "Polyhedron.g"),
    "impossible row": (lambda: lfo.Polyhedron([[0.0, 0.0]], [-1]), "Polyhedron.g"),
    "radius": (lambda: lfo.Ball(0), "Ball.radius"),
    "centre": (lambda: lfo.Ball(1, [[0]]), "Ball.centre"),
    "ellipsoid's centre": (lambda: lfo.Ellipsoid(np.eye(2), 1, [1, 2, 3]), "Ellipsoid.centre"),
    "ellipsoid's matrix": (lambda: lfo.Ellipsoid([1, 2]), "Ellipsoid.W"),
    "cone": (lambda: lfo.SecondOrderCone(np.eye(2), [0], [0, 0]), "SecondOrderCone.g"),
    "cone's slope": (lambda: lfo.SecondOrderCone(np.eye(2), [0, 0], [0]), "SecondOrderCone.h"),
    "cone's constant": (lambda: lfo.SecondOrderCone(np.eye(2), [0, 0], [0, 0], [1]), "SecondOrderCone.d"),
    "nothing": (lambda: lfo.Intersection([]), "Intersection"),
    "no set": (lambda: lfo.Intersection([3]), "Intersection"),
    "dimensions": (lambda: lfo.Polyhedron(np.eye(2), [1, 1]) & lfo.Box([0, 0, 0], 1), "Intersection"),
    "no soft cone": (lambda: lfo.Soft(SETS["cone and box"][0], 1.0), "Soft"),
    "penalty": (lambda: lfo.Soft(lfo.Ball(1), 0), "Soft.penalty"),
    "soft box per time": (lambda: lfo.Soft(lfo.Box(np.zeros((3, 1)), 1), 1.0), "Soft"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_sets_are_refused_by_the_field(name):
    make, field = BAD[name]
    with pytest.raises(lfo.ProblemError) as caught:
        make()
    assert caught.value.field == field
