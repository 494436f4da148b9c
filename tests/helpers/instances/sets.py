"""Sets in R^3 of every class, each with its constraints in CVXPY."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cvxpy as cp
import numpy as np

import lin_freq_ocp as lfo
from helpers.own_kinds import RoundedSimplex
from lin_freq_ocp.problem import ConvexSet

RNG = np.random.default_rng(1)
F = RNG.standard_normal((5, 3))
W = RNG.standard_normal((3, 3)) + 2 * np.eye(3)
CENTRE = np.array([0.5, -0.2, 0.1])


@dataclass(frozen=True)
class Instance:
    """A set, and its hard constraints on a variable of CVXPY."""

    given: ConvexSet
    constraints: Callable[[cp.Variable], Sequence[cp.Constraint]]


def free(v: cp.Variable) -> list[cp.Constraint]:
    return []


POLYHEDRON = Instance(
    lfo.sets.Polyhedron(np.vstack([F, np.eye(3), -np.eye(3)]), np.ones(11)), lambda v: [F @ v <= 1, v <= 1, v >= -1]
)
BALL = Instance(lfo.sets.Ball(1.5, CENTRE), lambda v: [cp.norm(v - CENTRE) <= 1.5])
SETS = {
    "box": Instance(
        lfo.Box([-1, None, 0.2], [1, 0.5, None]), lambda v: [v[0] >= -1, v[0] <= 1, v[1] <= 0.5, v[2] >= 0.2]
    ),
    "point": Instance(lfo.sets.Point(CENTRE), lambda v: [v == CENTRE]),
    "everything": Instance(lfo.sets.Everything(), free),
    "polyhedron": POLYHEDRON,
    "ball": BALL,
    "ball around zero": Instance(lfo.sets.Ball(2.0), lambda v: [cp.norm(v) <= 2]),
    "ellipsoid": Instance(lfo.sets.Ellipsoid(W, 1.2, CENTRE), lambda v: [cp.norm(W @ (v - CENTRE)) <= 1.2]),
    "cone and box": Instance(
        lfo.sets.SecondOrderCone(F[:2], [0.1, 0.2], [1.0, 0.0, 0.0], 0.5) & lfo.Box(-2, 2),
        lambda v: [cp.norm(F[:2] @ v + np.array([0.1, 0.2])) <= v[0] + 0.5, cp.abs(v) <= 2],
    ),
    "cone": Instance(
        lfo.sets.SecondOrderCone(F[:2], [0.1, 0.2], [1.0, 0.0, 0.0], 0.5),
        lambda v: [cp.norm(F[:2] @ v + np.array([0.1, 0.2])) <= v[0] + 0.5],
    ),
    "box and ball": Instance(
        lfo.Box([0, None, -0.1], 1) & lfo.sets.Ball(1.1), lambda v: [v[0] >= 0, v[2] >= -0.1, v <= 1, cp.norm(v) <= 1.1]
    ),
    "soft ball": Instance(lfo.sets.Soft(BALL.given, 0.3), free),
    "soft and hard": Instance(lfo.sets.Soft(BALL.given, 0.3) & POLYHEDRON.given, POLYHEDRON.constraints),
    "translated": Instance(BALL.given.translated(CENTRE), lambda v: [cp.norm(v) <= 1.5]),
    "linked ends": Instance(lfo.sets.LinkedEnds(F[:2], np.eye(2, 3), [0.1, 0.2]), free),
    "periodic": Instance(lfo.Periodic(), free),
    "levels": Instance(lfo.FiniteSet([-1, 0, 2], [1.0, 0.0, 0.5]), lambda v: [v >= -1, v <= 2]),
    "of a user": Instance(
        RoundedSimplex(W, 2.0), lambda v: [v >= 0, cp.sum(v) <= 2, cp.norm(W @ v) <= cp.sum(v) + 0.1]
    ),
}
