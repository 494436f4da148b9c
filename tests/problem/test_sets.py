"""Sets beyond boxes: membership against CVXPY; bad data."""

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
        lfo.sets.Polyhedron(np.vstack([F, np.eye(3), -np.eye(3)]), np.ones(11)),
        lambda v: [F @ v <= 1, v <= 1, v >= -1],
    ),
    "ball": (lfo.sets.Ball(1.5, CENTRE), lambda v: [cp.norm(v - CENTRE) <= 1.5]),
    "ball around zero": (lfo.sets.Ball(2.0), lambda v: [cp.norm(v) <= 2]),
    "ellipsoid": (lfo.sets.Ellipsoid(W, 1.2, CENTRE), lambda v: [cp.norm(W @ (v - CENTRE)) <= 1.2]),
    "cone and box": (
        lfo.sets.SecondOrderCone(F[:2], [0.1, 0.2], [1.0, 0.0, 0.0], 0.5) & lfo.Box(-2, 2),
        lambda v: [cp.norm(F[:2] @ v + np.array([0.1, 0.2])) <= v[0] + 0.5, cp.abs(v) <= 2],
    ),
    "box and ball": (
        lfo.Box([0, None, -0.1], 1) & lfo.sets.Ball(1.1),
        lambda v: [v[0] >= 0, v[2] >= -0.1, v <= 1, cp.norm(v) <= 1.1],
    ),
}


@pytest.mark.parametrize("name", SETS)
def test_membership_and_violation_agree_with_cvxpy(name):
    ours, constraints = SETS[name]
    for point in 1.5 * RNG.standard_normal((20, 3)):
        v = cp.Variable(3, value=point)
        theirs = max(float(np.max(constraint.violation())) for constraint in constraints(v))
        assert ours.contains(point, 1e-9) == (theirs <= 1e-9)
        assert ours.violation(point) == pytest.approx(theirs, abs=1e-9)


def test_a_ball_in_a_box_is_not_contained_where_only_one_of_them_is():
    both = lfo.Box(-1, 1) & lfo.sets.Ball(1.2)
    points = np.array([[0.5, 0.5], [1.0, 1.0], [1.1, 0.0]])
    assert both.contains(points).tolist() == [True, False, False]
    np.testing.assert_allclose(both.violation(points), [0, np.sqrt(2) - 1.2, 0.1], atol=1e-12)


BAD = {
    "no matrix": (lambda: lfo.sets.Polyhedron([1, 2], [1]), "Polyhedron.F"),
    "limits": (lambda: lfo.sets.Polyhedron(np.eye(2), [1]), "Polyhedron.g"),
    "minus infinity": (lambda: lfo.sets.Polyhedron(np.eye(2), [1, -np.inf]), "Polyhedron.g[1]"),
    "impossible row": (lambda: lfo.sets.Polyhedron([[0.0, 0.0]], [-1]), "Polyhedron.g"),
    "radius": (lambda: lfo.sets.Ball(0), "Ball.radius"),
    "centre": (lambda: lfo.sets.Ball(1, [[0]]), "Ball.centre"),
    "ellipsoid's centre": (lambda: lfo.sets.Ellipsoid(np.eye(2), 1, [1, 2, 3]), "Ellipsoid.centre"),
    "ellipsoid's matrix": (lambda: lfo.sets.Ellipsoid([1, 2]), "Ellipsoid.W"),
    "cone": (lambda: lfo.sets.SecondOrderCone(np.eye(2), [0], [0, 0]), "SecondOrderCone.g"),
    "cone's slope": (lambda: lfo.sets.SecondOrderCone(np.eye(2), [0, 0], [0]), "SecondOrderCone.h"),
    "cone's constant": (lambda: lfo.sets.SecondOrderCone(np.eye(2), [0, 0], [0, 0], [1]), "SecondOrderCone.d"),
    "nothing": (lambda: lfo.sets.Intersection([]), "Intersection"),
    "no set": (lambda: lfo.sets.Intersection([3]), "Intersection"),
    "dimensions": (lambda: lfo.sets.Polyhedron(np.eye(2), [1, 1]) & lfo.Box([0, 0, 0], 1), "Intersection"),
    "no soft cone": (lambda: lfo.sets.Soft(SETS["cone and box"][0], 1.0), "Soft"),
    "penalty": (lambda: lfo.sets.Soft(lfo.sets.Ball(1), 0), "Soft.penalty"),
    "soft box per time": (lambda: lfo.sets.Soft(lfo.Box(np.zeros((3, 1)), 1), 1.0), "Soft"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_sets_are_refused_by_the_field(name):
    make, field = BAD[name]
    with pytest.raises(lfo.errors.ProblemError) as caught:
        make()
    assert caught.value.field == field
