"""The suite of convex sets: members, bounds, parts, words and the sets that are derived from one, of every class."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.instances import classes_of
from helpers.instances.sets import CENTRE, SETS
from lin_freq_ocp.problem import ConvexSet

POINTS = 1.5 * np.random.default_rng(2).standard_normal((20, 3))
ORIGIN = np.array([0.3, -0.4, 0.7])

each_set = pytest.mark.parametrize("name", SETS)


def test_every_class_of_the_package_is_here():
    assert classes_of(ConvexSet) <= {type(instance.given) for instance in SETS.values()}


def violation(given: ConvexSet, points: np.ndarray) -> np.ndarray:
    """Return the largest violation by each point; a box states that of each component."""
    each = given.violation(points)
    return each if each.shape == points.shape[:-1] else each.max(-1)


def of_parts(given: ConvexSet, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest violation of a part by each point, and the price of all parts: bounds do not count."""
    worst, total = np.zeros(len(points)), np.zeros(len(points))
    for part in given.parts(points.shape[1]):
        v = part.values(points)
        worst, total = np.maximum(worst, part.penalty.violation(v).max(1)), total + part.penalty.cost(v)
    return worst, total


@each_set
def test_members_are_those_of_cvxpy_and_within_the_bounds(name):
    given, v = SETS[name].given, cp.Variable(3)
    constraints, theirs, points = SETS[name].constraints(v), list[float](), np.vstack([POINTS, CENTRE])
    for v.value in points:
        theirs.append(max((float(np.max(constraint.violation())) for constraint in constraints), default=0.0))
    np.testing.assert_array_equal(given.contains(points, 1e-9), np.array(theirs) <= 1e-9)
    np.testing.assert_allclose(violation(given, points), theirs, atol=1e-9)
    assert violation(given, CENTRE) == pytest.approx(theirs[-1], abs=1e-9)  # of a single point
    lower, upper = given.bounds
    assert (points[given.contains(points)] >= lower).all()
    assert (points[given.contains(points)] <= upper).all()
    assert given.dimension in (None, 3)
    names = ["position [m]", "speed", "angle"]
    assert given.at_names(names).describe(names, "x") == given.describe(names, "x") != ""


@each_set
def test_derived_sets_have_the_members_of_the_given_one(name):
    """A translated one, one in more dimensions, an intersection with a box, and a relaxed one: prices do not change."""
    given, box, further = SETS[name].given, lfo.Box(-2.0, 2.0), np.full((len(POINTS), 2), 9.0)
    worst, moved, both = violation(given, POINTS), given.translated(ORIGIN), given & box
    parts = of_parts(given, POINTS)
    np.testing.assert_allclose(violation(moved, POINTS - ORIGIN), worst, atol=1e-12)
    np.testing.assert_allclose(of_parts(moved, POINTS - ORIGIN), parts, atol=1e-12)
    np.testing.assert_allclose(of_parts(given.augmented(3, 2), np.hstack([POINTS, further])), parts, atol=1e-12)
    np.testing.assert_allclose(violation(both, POINTS), np.maximum(worst, violation(box, POINTS)))
    np.testing.assert_allclose(of_parts(both, POINTS), parts)
    assert both.members == given.members
    for member in given.members:
        (before, price), (after, same) = of_parts(member, POINTS), of_parts(member.relaxed(0.25, 3), POINTS)
        np.testing.assert_allclose(after, np.maximum(before - 0.25, 0.0), atol=1e-12)
        np.testing.assert_allclose(same, price, atol=1e-12)


@each_set
def test_a_soft_set_has_the_price_of_the_violations(name):
    given = SETS[name].given
    if not given.may_be_soft:
        with pytest.raises(lfo.errors.ProblemError, match="Soft: got"):
            lfo.sets.Soft(given, 2.0)
        return
    soft = lfo.sets.Soft(given, 2.0)
    total = of_parts(soft, POINTS)[1]
    assert not violation(soft, POINTS).any()
    np.testing.assert_array_equal(total > 1e-12, violation(given, POINTS) > 1e-12)
    assert (total >= 2.0 * violation(given, POINTS) - 1e-12).all()


def test_a_ball_in_a_box_is_not_contained_where_only_one_of_them_is():
    both = lfo.Box(-1, 1) & lfo.sets.Ball(1.2)
    points = np.array([[0.5, 0.5], [1.0, 1.0], [1.1, 0.0]])
    assert both.contains(points).tolist() == [True, False, False]
    np.testing.assert_allclose(both.violation(points), [0, np.sqrt(2) - 1.2, 0.1], atol=1e-12)
