"""Sets with bad data."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo

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
    "no soft cone": (
        lambda: lfo.sets.Soft(lfo.sets.SecondOrderCone(np.eye(2), [0, 0], [0, 0]) & lfo.Box(-2, 2), 1.0),
        "Soft",
    ),
    "penalty": (lambda: lfo.sets.Soft(lfo.sets.Ball(1), 0), "Soft.penalty"),
    "soft box per time": (lambda: lfo.sets.Soft(lfo.Box(np.zeros((3, 1)), 1), 1.0), "Soft"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_sets_are_refused_by_the_field(name):
    make, field = BAD[name]
    with pytest.raises(lfo.errors.ProblemError) as caught:
        make()
    assert caught.value.field == field


def test_wider_limits_of_an_intersection_are_its_hard_ones_alone():
    both = lfo.sets.Soft(lfo.sets.Ball(1.0), penalty=3.0) & lfo.sets.Ball(2.0)
    penalties = [part.penalty for part in both.relaxed(0.5, 2).parts(2)]
    assert [(float(one.radius), float(one.weight)) for one in penalties] == [(1.0, 3.0), (2.5, np.inf)]
