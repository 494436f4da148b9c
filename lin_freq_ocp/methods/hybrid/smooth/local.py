"""The barrier problem at a point: residuals, the step of Newton's method, and trial points along it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.methods.hybrid.smooth.filter import Measure
from lin_freq_ocp.methods.hybrid.smooth.interior import inverse, log_determinant
from lin_freq_ocp.methods.hybrid.smooth.model import Derivatives, SmoothModel
from lin_freq_ocp.methods.structured.cones import Cone
from lin_freq_ocp.methods.structured.kkt.recursions import Loops
from lin_freq_ocp.methods.structured.kkt.system import DYNAMICS, STAGES, StepSystem, System, Values, largest
from lin_freq_ocp.methods.structured.kkt.system import KKTSolver as Side

NEAR = 0.1  # infeasibility, in units of order 1, from which it is worth a second side to know that a step is convex
FRACTION = 0.99  # of the way to the boundary, at least


@dataclass(frozen=True, eq=False)
class Point:
    """Variables, duals of all rows, and slacks of those in cones."""

    y: Array
    z: Values
    s: dict[int, Array]


class Trial(NamedTuple):
    """A point along a step."""

    y: Array
    s: dict[int, Array]
    measure: Measure
    defects: Array


@dataclass(frozen=True, eq=False)
class Objective:
    """1/2 y'H y + h'y + constant, and whether the curvature of the dynamics counts."""

    H: Array
    h: Array
    constant: float
    curved: bool


class Local:
    """A barrier problem near a point."""

    def __init__(self, model: SmoothModel, objective: Objective, loops: Loops, point: Point, found: Derivatives):
        self._model, self._objective, self._loops, self.point, self._found = model, objective, loops, point, found
        self.system = System(model.linearised(point.y, found), loops)
        rows = zip(self.system.rows(point.y), self.system.b, strict=True)
        self.left: Values = [values - right for values, right in rows]
        for i, s in point.s.items():
            self.left[i] = (self.left[i] + s) * self.cones[i].present
        self._gradient = loops.times(objective.H, point.y) + objective.h
        self._dual = self._gradient + self.system.adjoint(point.z)
        self.theta = sum(float(np.abs(part).sum()) for part in self.left)

    @property
    def cones(self) -> dict[int, Cone]:
        """Return the cones by the index of their rows."""
        return self.system.cones

    def error(self, mu: float) -> float:
        """Return the largest relative residual of the barrier problem."""
        point, dual = self.point, largest([self._dual]) / (1 + largest([self._gradient]))
        products = [cone.product(point.s[i], point.z[i]) - mu * cone.identity for i, cone in self.cones.items()]
        return max(dual, largest(self.left), largest(products))

    def phi(self, y: Array, s: dict[int, Array], mu: float) -> float:
        """Return the objective with the barrier."""
        objective = self._objective
        cost = 0.5 * float(np.vdot(y, self._loops.times(objective.H, y))) + float(np.vdot(objective.h, y))
        return cost + objective.constant - mu * sum(log_determinant(cone, s[i]) for i, cone in self.cones.items())

    def measure(self, mu: float) -> Measure:
        """Return the infeasibility and the objective here."""
        return Measure(self.theta, self.phi(self.point.y, self.point.s, mu))

    def factor(self, mu: float, sides: Sequence[Side]) -> None:
        """Factor the system of a step, with the curvature of the dynamics if the problem stays convex.

        Convexity is that on the dynamics or, where a side sees it, on the rows that couple times. The first side is
        taken unless only another one sees it.
        """
        stages, self.mu = self.system.stages, mu
        for i, own in self.cones.items():
            own.scale(self.point.s[i], self.point.z[i])
        if not (self._objective.curved and self.point.z[DYNAMICS].any() and self._exact(sides)):
            stages.H[:] = self._objective.H
            self._factored(sides[0])
        squares = {i: own.product(own.lam, own.lam) - mu * own.identity for i, own in self.cones.items()}
        self._centred = {i: own.scaled(own.quotient(squares[i]), 1) for i, own in self.cones.items()}

    def _exact(self, sides: Sequence[Side]) -> bool:
        """Factor the system with the curvature of the dynamics; return whether the problem is convex with it."""
        if self._with_curvature():
            self._factored(sides[0])
            return True
        return self.theta <= NEAR and any(side.indefinite and self._factored(side) for side in sides)

    def _with_curvature(self) -> bool:
        """Add the curvature of the dynamics to the Hessian; return whether the problem is convex on the dynamics."""
        stages, cone = self.system.stages, self.cones[STAGES]
        curved = -np.einsum("ti,tijk->tjk", self.point.z[DYNAMICS][:-1], self._found.curvatures)
        count = curved.shape[1]
        stages.H[:-1, :count, :count] += curved
        Phi = self._loops.gram(stages.H, stages.G, *cone.inverse_squares, stages.cones)
        return self._loops.is_convex(stages.A, stages.B, Phi, stages.fixed)

    def _factored(self, side: Side) -> bool:
        """Factor the system by a side; return what it sees of convexity."""
        self._step = StepSystem(self.system, side.exchanged(self.system.stages))
        return self._step.factor()

    def step(self, left: Values | None = None) -> tuple[Array, Values, dict[int, Array]]:
        """Return the change of y, z and s that takes away residuals of the rows, by default those here."""
        left = self.left if left is None else left
        right = [-part for part in left]
        for i, centred in self._centred.items():
            right[i] = right[i] + centred
        y, z = self._step.solve(-self._dual, right)
        rows = self.system.rows(y)
        return y, z, {i: (-left[i] - rows[i]) * cone.present for i, cone in self.cones.items()}

    def slope(self, y: Array, s: dict[int, Array]) -> float:
        """Return the derivative of the objective along a step."""
        barrier = sum(float(np.vdot(inverse(cone, self.point.s[i]), s[i])) for i, cone in self.cones.items())
        return float(np.vdot(self._gradient, y)) - self.mu * barrier

    def longest(self, change: dict[int, Array], power: int) -> float:
        """Return the part of a step of slacks (power -1) or duals (1) that stays inside, at most 1."""
        lengths = [cone.longest(cone.scaled(change[i], power)) for i, cone in self.cones.items()]
        return min([1.0, *(max(FRACTION, 1 - self.mu) * length for length in lengths)])

    def trial(self, y: Array, s: dict[int, Array], length: float) -> Trial | None:
        """Return the point at a part of a step; None if the map is not defined there."""
        after, slacks = self.point.y + length * y, {i: own + length * s[i] for i, own in self.point.s.items()}
        defects = self._model.defects(after)
        if not np.isfinite(defects).all():
            return None
        linear = self.theta - float(np.abs(self.left[DYNAMICS]).sum())
        theta = float(np.abs(defects).sum()) + (1 - length) * linear
        return Trial(after, slacks, Measure(theta, self.phi(after, slacks, self.mu)), defects)
