# ruff: noqa: D102
"""Convex sets other than boxes: polyhedra, balls, ellipsoids, second-order cones, and soft sets.

Methods without a docstring are described by ``ConvexSet``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import (
    Array,
    assign,
    brief,
    positive_number,
    real_array,
    require_rows_hold,
    row_matrix,
    to_shape,
    upper_limits,
    with_columns,
)
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import AT_MOST, MOST_ROWS, combination, datum, inequalities, number, price, vector
from lin_freq_ocp.base.polyhedra import vertices
from lin_freq_ocp.problem.sets.base import ConvexSet, Intersection, Part, PartSet
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.terms.penalties import HalfSpaces, NormBall, StandardCone
from lin_freq_ocp.problem.terms.penalty import HARD


@dataclass(frozen=True, eq=False, init=False)
class Polyhedron(ConvexSet):
    """{v : F v <= g}, row by row.

    Parameters
    ----------
    F : (rows, n)
        Coefficients.
    g : (rows,)
        Limits; inf, or 1e20 and above, where there is none.

    Raises
    ------
    ProblemError
        If shapes do not match or entries are not numbers.

    Examples
    --------
    >>> triangle = lfo.sets.Polyhedron([[1.0, 1.0], [-1.0, 0.0], [0.0, -1.0]], [1.0, 0.0, 0.0])
    >>> float(triangle.violation([1.0, 1.0]))
    1.0
    """

    F: Array
    g: Array

    def __init__(self, F: ArrayLike, g: ArrayLike):
        matrix = row_matrix("Polyhedron.F", F, "One set per time is a list of sets.")
        limits = upper_limits("Polyhedron.g", g)
        if limits.shape != matrix.shape[:1]:
            expected = f"one limit for each of the {len(matrix)} rows of F"
            raise ProblemError("Polyhedron.g", f"shape {limits.shape}", expected)
        require_rows_hold("Polyhedron.g", ~matrix.any(axis=1) & (limits < 0), limits)
        assign(self, F=matrix, g=limits)

    @property
    def dimension(self) -> int:
        return self.F.shape[-1]

    def parts(self, dimension: int) -> tuple[Part, ...]:
        return (Part(self.F, np.zeros(len(self.F)), HalfSpaces(self.g, HARD)),)

    def tightened(self, less: Callable[[Array], Array], dimension: int) -> Polyhedron:
        return Polyhedron(self.F, self.g - less(self.F))

    def farthest(self, dimension: int) -> tuple[Callable[[Array], Array], Array]:
        points, error = vertices(self.F, self.g)
        return lambda y: points[(y @ points.T).argmax(axis=-1)], error

    def augmented(self, n: int, k: int) -> Polyhedron:
        return Polyhedron(with_columns(self.F, k), self.g)

    def describe(self, names: Sequence[str], signal: str) -> str:
        return inequalities(self.F, self.g, names, f"F {signal} {AT_MOST} g")


@dataclass(frozen=True, eq=False, init=False)
class Ellipsoid(ConvexSet):
    """{v : |W (v - centre)| <= radius}, in the Euclidean norm.

    Parameters
    ----------
    W : (rows, n)
        With fewer independent rows than n, the set is a cylinder. {v : v'P v <= 1} has W'W = P.
    radius : float
        Above zero.
    centre : float or (n,)

    Raises
    ------
    ProblemError
        If shapes do not match, or the radius is not above zero.

    Examples
    --------
    >>> bool(lfo.sets.Ellipsoid([[0.5, 0.0], [0.0, 1.0]]).contains([2.0, 0.0]))
    True
    """

    W: Array
    radius: float
    centre: Array

    def __init__(self, W: ArrayLike, radius: float = 1.0, centre: ArrayLike = 0.0):
        matrix = row_matrix("Ellipsoid.W", W)
        middle = _centre("Ellipsoid.centre", centre, matrix.shape[1])
        assign(self, W=matrix, radius=positive_number("Ellipsoid.radius", radius), centre=middle)

    @property
    def dimension(self) -> int:
        return self.W.shape[1]

    def parts(self, dimension: int) -> tuple[Part, ...]:
        return (Part(self.W, -self.W @ np.broadcast_to(self.centre, dimension), _ball(self.radius)),)

    def farthest(self, dimension: int) -> tuple[Callable[[Array], Array], Array]:
        if self.W.shape != (dimension, dimension) or np.linalg.matrix_rank(self.W) < dimension:
            expected = f"a regular matrix ({dimension}, {dimension})"
            raise ProblemError("disturbance.set.W", f"shape {self.W.shape}", expected)
        inverse = np.linalg.inv(self.W)  # W^-1 = inverse (I - R)^-1 with the residual R = I - W inverse
        rounding = dimension * np.finfo(float).eps * np.abs(self.W) @ np.abs(inverse)
        residual = float(np.linalg.norm(np.abs(np.eye(dimension) - self.W @ inverse) + rounding))
        reach = self.radius * np.linalg.norm(inverse, axis=1)

        def point(y: Array) -> Array:
            turned = y @ inverse
            length = np.linalg.norm(turned, axis=-1, keepdims=True)
            return self.centre + self.radius * (turned / np.where(length > 0, length, 1.0)) @ inverse.T

        return point, reach * residual / (1 - residual) if residual < 1 else np.full(dimension, np.inf)

    def augmented(self, n: int, k: int) -> Ellipsoid:
        return Ellipsoid(with_columns(self.W, k), self.radius, with_columns(np.broadcast_to(self.centre, n), k))

    def describe(self, names: Sequence[str], signal: str) -> str:
        inside = f"({signal} - {vector(self.centre)})" if self.centre.any() else signal
        return f"an ellipsoid: |W {inside}| {AT_MOST} {number(self.radius)} with {datum('W', self.W, 2)}"


@dataclass(frozen=True, eq=False, init=False)
class Ball(ConvexSet):
    """{v : |v - centre| <= radius}, in the Euclidean norm.

    Parameters
    ----------
    radius : float
        Above zero, in the unit of all components.
    centre : float or (n,)

    Raises
    ------
    ProblemError
        If the radius is not above zero, or the centre is no vector.

    Examples
    --------
    >>> float(lfo.sets.Ball(5.0).violation([6.0, 8.0]))
    5.0
    """

    radius: float
    centre: Array

    def __init__(self, radius: float, centre: ArrayLike = 0.0):
        middle = _centre("Ball.centre", centre, None)
        assign(self, radius=positive_number("Ball.radius", radius), centre=middle)

    @property
    def dimension(self) -> int | None:
        return len(self.centre) if self.centre.ndim else None

    def parts(self, dimension: int) -> tuple[Part, ...]:
        return (Part(np.eye(dimension), -np.broadcast_to(self.centre, dimension), _ball(self.radius)),)

    def augmented(self, n: int, k: int) -> Ellipsoid:
        return Ellipsoid(np.eye(n), self.radius, self.centre).augmented(n, k)

    def farthest(self, dimension: int) -> tuple[Callable[[Array], Array], Array]:
        return Ellipsoid(np.eye(dimension), self.radius, self.centre).farthest(dimension)

    def describe(self, names: Sequence[str], signal: str) -> str:
        centre = vector(self.centre) if self.centre.any() else "the origin"
        return f"{signal} within {number(self.radius)} of {centre} (Euclidean norm)"


@dataclass(frozen=True, eq=False, init=False)
class SecondOrderCone(ConvexSet):
    """{v : |F v + g| <= h'v + d}, in the Euclidean norm.

    Parameters
    ----------
    F : (rows, n), g : (rows,)
    h : (n,), d : float

    Raises
    ------
    ProblemError
        If shapes do not match.

    Examples
    --------
    >>> cone = lfo.sets.SecondOrderCone(F=[[1.0, 0.0]], g=[0.0], h=[0.0, 2.0])
    >>> cone.contains([[2.0, 1.0], [2.1, 1.0]])
    array([ True, False])
    """

    F: Array
    g: Array
    h: Array
    d: float
    may_be_soft: ClassVar[bool] = False

    def __init__(self, F: ArrayLike, g: ArrayLike, h: ArrayLike, d: float = 0.0):
        matrix = row_matrix("SecondOrderCone.F", F)
        inner, slope = (
            to_shape(f"SecondOrderCone.{name}", value, (size,))
            for name, value, size in zip("gh", (g, h), matrix.shape, strict=True)
        )
        constant = real_array("SecondOrderCone.d", d)
        if constant.ndim:
            raise ProblemError("SecondOrderCone.d", brief(d), "one number")
        assign(self, F=matrix, g=inner, h=slope, d=float(constant))

    @property
    def dimension(self) -> int:
        return self.F.shape[1]

    def parts(self, dimension: int) -> tuple[Part, ...]:
        return (Part(np.vstack([self.h, self.F]), np.append(self.d, self.g), StandardCone()),)

    def augmented(self, n: int, k: int) -> SecondOrderCone:
        return SecondOrderCone(with_columns(self.F, k), self.g, with_columns(self.h, k), self.d)

    def describe(self, names: Sequence[str], signal: str) -> str:
        inner = f"|F {signal}{' + g' if self.g.any() else ''}|"
        outer = combination(self.h, names) if np.count_nonzero(self.h) <= MOST_ROWS else f"h' {signal}"
        constant = f" + {number(self.d)}" if self.d else ""
        return f"a second-order cone: {inner} {AT_MOST} {outer}{constant} with {datum('F', self.F, 2)}"


@dataclass(frozen=True, eq=False, init=False)
class Soft(ConvexSet):
    """A set that may be violated at a price: the cost has a penalty times the violation of each of its constraints.

    The violation is that of every bound and row of a Box or Polyhedron, and the norm less the radius of a Ball or
    Ellipsoid. If the set can be satisfied and the penalty exceeds its multipliers, it is satisfied exactly.

    Parameters
    ----------
    soft_set : Box, Polyhedron, Ball or Ellipsoid
    penalty : float
        Above zero, in units of cost per unit of violation.

    Raises
    ------
    ProblemError
        If the set cannot be soft, or the penalty is not above zero.

    Examples
    --------
    >>> lfo.sets.Soft(lfo.Box(-1, 1), penalty=10.0).soft
    True
    """

    soft_set: ConvexSet
    penalty: float
    may_be_soft: ClassVar[bool] = False
    soft: ClassVar[bool] = True

    def __init__(self, soft_set: ConvexSet, penalty: float):
        if not isinstance(soft_set, ConvexSet) or not soft_set.may_be_soft:
            raise ProblemError("Soft", brief(soft_set), "a Box, Polyhedron, Ball or Ellipsoid")
        if soft_set.bounds[0].ndim > 1:
            raise ProblemError("Soft", "a box with one bound per time", "one box", "Give a list of Soft sets.")
        assign(self, soft_set=soft_set, penalty=positive_number("Soft.penalty", penalty))

    @property
    def dimension(self) -> int | None:
        return self.soft_set.dimension

    def parts(self, dimension: int) -> tuple[Part, ...]:
        return self.soft_set.soft_parts(dimension, np.asarray(self.penalty))

    def preimage(self, F: Array, share: float) -> Soft:
        hard = tuple(Part(part.F @ F, part.c, part.penalty) for part in self.soft_set.soft_parts(len(F), HARD))
        return Soft(PartSet(hard, F.shape[1], "a soft set"), self.penalty * share)

    def augmented(self, n: int, k: int) -> Soft:
        return Soft(self.soft_set.augmented(n, k), self.penalty)

    def at_names(self, names: Sequence[str]) -> Soft:
        return Soft(self.soft_set.at_names(names), self.penalty)

    def relaxed(self, amount: float, dimension: int) -> Soft:
        return self

    def tightened(self, less: Callable[[Array], Array], dimension: int) -> ConvexSet:
        (part,) = self.parts(dimension)
        if not part.penalty.polyhedral:
            return super().tightened(less, dimension)
        limits = part.penalty.bounds((1, len(part.F)))[1].reshape(-1)
        return Soft(Polyhedron(part.F, limits - less(part.F)), self.penalty)

    def translated(self, origin: Array) -> Soft:
        return Soft(self.soft_set.translated(origin), self.penalty)

    def describe(self, names: Sequence[str], signal: str) -> str:
        return f"{self.soft_set.describe(names, signal)}{price(self.penalty)}"


def softened_set(penalty: float, given: ConvexSet) -> ConvexSet:
    """Return a set with its bounds and hard members softened by a penalty per unit of violation."""
    lower, upper = given.bounds
    bounds = [Box(lower, upper)] if np.isfinite(lower).any() or np.isfinite(upper).any() else []
    soft = [member for member in given.members if member.soft]
    members = [*soft, *(Soft(hard, penalty) for hard in (*bounds, *given.hard_members))]
    return Intersection(members) if members else given


def _ball(radius: float) -> NormBall:
    return NormBall(2, np.asarray(radius), HARD)


def _centre(field: str, centre: ArrayLike, n: int | None) -> Array:
    middle = real_array(field, centre)
    if middle.ndim > 1 or (middle.ndim and n is not None and len(middle) != n):
        raise ProblemError(field, f"shape {middle.shape}", "one number" + (f", or {n}" if n else " per component"))
    return middle
