"""Convex sets beyond boxes: polyhedra, balls, ellipsoids, second-order cones, their intersections, and soft sets.

A set is a Box and parts {v : F v + c in a standard set}. What is asked of a single set (the nearest point, the support
function) is a small conic program, solved by Clarabel.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.arrays import Array, Mask, assign, brief, frozen, positive_number, real_array
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.phrases import AT_MOST, MOST_ROWS, MOST_TEXT, combination, datum, inequalities, number, price, vector
from lin_freq_ocp.problem.sets import projections as set_geometry
from lin_freq_ocp.problem.sets.box import NO_BOUND, Box, Everything
from lin_freq_ocp.problem.terms.penalties import Below, Cone, Norm, Penalty

HARD = np.asarray(np.inf)
"""The weight of a constraint that must hold."""


@dataclass(frozen=True, eq=False)
class Part:
    """{v : F v + c in the set of a penalty} of a set.

    Attributes
    ----------
    F : (dim, n)
    c : (dim,)
    penalty : Penalty
    """

    F: Array
    c: Array
    penalty: Penalty


class ConvexSet(ABC):
    """What all sets of this page share; ``box`` and ``parts`` say what they are."""

    @property
    @abstractmethod
    def dimension(self) -> int | None:
        """Return n, or None if the set fits every dimension."""

    @property
    def box(self) -> Box:
        """Return the bounds among its constraints."""
        return Everything()

    @abstractmethod
    def parts(self, dimension: int) -> tuple[Part, ...]:
        """Return what remains."""

    @abstractmethod
    def describe(self, names: Sequence[str], signal: str) -> str:
        """Return the set in words that stand alone, such as "within 2 of the origin".

        Parameters
        ----------
        names : sequence of str
            Of the components, with their units.
        signal : str
            The letter of the vector: "x" or "u".
        """

    def violation(self, v: Array) -> Array:
        """Return the largest excess over a constraint of the set, for each v (..., n); 0 inside."""
        points = np.asarray(v, dtype=float)
        of_box = self.box.at_dimension(points.shape[-1], "v").violation(points).max(-1)
        return np.maximum(of_box, self.violation_of_parts(points))

    def violation_of_parts(self, v: Array) -> Array:
        """Return the same without the bounds."""
        flat = v.reshape(-1, v.shape[-1])
        excess = [np.zeros(len(flat))]
        for part in self.parts(flat.shape[1]):
            excess.append(part.penalty.violation(flat @ part.F.T + part.c).max(1))
        return np.max(excess, axis=0).reshape(v.shape[:-1])

    def contains(self, v: Array, tolerance: float = 0.0) -> Mask:
        """Whether each v (..., n) violates no constraint of the set by more than ``tolerance``."""
        return np.asarray(self.violation(v) <= tolerance)

    def project(self, v: Array) -> Array:
        """Return the nearest point of the set, for each v (..., n).

        Raises
        ------
        NumericalError
            If the set is empty, or the solver fails.
        """
        return self._each(v, set_geometry.nearest)

    def support(self, y: Array) -> Array:
        """Return sigma(y) = max over the set of <y, v>, for each y (..., n); inf where there is none.

        Raises
        ------
        NumericalError
            If the set is empty, or the solver fails.
        """
        return self._each(y, set_geometry.support)

    def normal_gap(self, v: Array, y: Array) -> Array:
        """Return sigma(y) - <y, v>: zero iff y lies in the normal cone of the set at v (v in the set)."""
        return self.support(y) - (np.asarray(v) * np.asarray(y)).sum(-1)

    def __and__(self, other: Any) -> Intersection:
        return Intersection([self, other])

    def _each(self, vectors: Array, ask: Any) -> Array:
        given = np.asarray(vectors, dtype=float)
        flat = given.reshape(-1, given.shape[-1])
        n = flat.shape[1]
        answers = [ask(self.box.at_dimension(n, "v"), self.parts(n), one) for one in flat]
        return np.array(answers).reshape((*given.shape[:-1], *np.shape(answers[0])))


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
    """

    F: Array
    g: Array

    def __init__(self, F: ArrayLike, g: ArrayLike):
        matrix, limits = real_array("Polyhedron.F", F), real_array("Polyhedron.g", g, allow_infinite=True)
        if matrix.ndim != 2 or 0 in matrix.shape:
            advice = "One set per time is a list of sets."
            raise ProblemError("Polyhedron.F", f"shape {matrix.shape}", "a matrix (rows, n)", advice)
        if limits.shape != matrix.shape[:1]:
            expected = f"one limit for each of the {len(matrix)} rows of F"
            raise ProblemError("Polyhedron.g", f"shape {limits.shape}", expected)
        if (limits == -np.inf).any():
            raise ProblemError("Polyhedron.g", "-inf", "a number, or inf for no limit")
        limits = frozen(np.where(limits >= NO_BOUND, np.inf, limits))
        impossible = ~matrix.any(axis=1) & (limits < 0)
        if impossible.any():
            row = int(np.argmax(impossible))
            raise ProblemError("Polyhedron.g", f"a limit below 0 for row {row} of zeros", "a row that can hold")
        assign(self, F=matrix, g=limits)

    @property
    def dimension(self) -> int:
        """Return n."""
        return self.F.shape[-1]

    def parts(self, dimension: int) -> tuple[Part, ...]:
        """Return the rows."""
        return (Part(self.F, np.zeros(len(self.F)), Below(self.g, HARD)),)

    def describe(self, names: Sequence[str], signal: str) -> str:
        """Return its rows."""
        return inequalities(self.F, self.g, names, f"F {signal} {AT_MOST} g")


@dataclass(frozen=True, eq=False, init=False)
class Ellipsoid(ConvexSet):
    """{v : |W (v - centre)| <= radius}, in the Euclidean norm.

    Parameters
    ----------
    W : (rows, n)
        What measures v; with fewer independent rows than n, the set is a cylinder. {v : v'P v <= 1} has W'W = P.
    radius : float
        Above zero.
    centre : float or (n,)
    """

    W: Array
    radius: float
    centre: Array

    def __init__(self, W: ArrayLike, radius: float = 1.0, centre: ArrayLike = 0.0):
        matrix = real_array("Ellipsoid.W", W)
        if matrix.ndim != 2 or 0 in matrix.shape:
            raise ProblemError("Ellipsoid.W", f"shape {matrix.shape}", "a matrix (rows, n)")
        middle = _centre("Ellipsoid.centre", centre, matrix.shape[1])
        assign(self, W=matrix, radius=positive_number("Ellipsoid.radius", radius), centre=middle)

    @property
    def dimension(self) -> int:
        """Return n."""
        return self.W.shape[1]

    def parts(self, dimension: int) -> tuple[Part, ...]:
        """Return |W v - W centre| <= radius."""
        return (Part(self.W, -self.W @ np.broadcast_to(self.centre, dimension), _ball(self.radius)),)

    def describe(self, names: Sequence[str], signal: str) -> str:
        """Return what measures it, its radius and its centre."""
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
    """

    radius: float
    centre: Array

    def __init__(self, radius: float, centre: ArrayLike = 0.0):
        middle = _centre("Ball.centre", centre, None)
        assign(self, radius=positive_number("Ball.radius", radius), centre=middle)

    @property
    def dimension(self) -> int | None:
        """Return n, if the centre says it."""
        return len(self.centre) if self.centre.ndim else None

    def parts(self, dimension: int) -> tuple[Part, ...]:
        """Return |v - centre| <= radius."""
        return (Part(np.eye(dimension), -np.broadcast_to(self.centre, dimension), _ball(self.radius)),)

    def describe(self, names: Sequence[str], signal: str) -> str:
        """Return its radius and its centre."""
        centre = vector(self.centre) if self.centre.any() else "the origin"
        return f"{signal} within {number(self.radius)} of {centre} (Euclidean norm)"


@dataclass(frozen=True, eq=False, init=False)
class SecondOrderCone(ConvexSet):
    """{v : |F v + g| <= h'v + d}, in the Euclidean norm.

    Parameters
    ----------
    F : (rows, n), g : (rows,)
    h : (n,), d : float
    """

    F: Array
    g: Array
    h: Array
    d: float

    def __init__(self, F: ArrayLike, g: ArrayLike, h: ArrayLike, d: float = 0.0):
        matrix, inner, slope = (
            real_array(f"SecondOrderCone.{name}", value) for name, value in (("F", F), ("g", g), ("h", h))
        )
        if matrix.ndim != 2 or 0 in matrix.shape:
            raise ProblemError("SecondOrderCone.F", f"shape {matrix.shape}", "a matrix (rows, n)")
        rows, n = matrix.shape
        for name, value, shape in (("g", inner, (rows,)), ("h", slope, (n,))):
            if value.shape != shape:
                raise ProblemError(f"SecondOrderCone.{name}", f"shape {value.shape}", f"shape {shape}")
        constant = real_array("SecondOrderCone.d", d)
        if constant.ndim:
            raise ProblemError("SecondOrderCone.d", brief(d), "one number")
        assign(self, F=matrix, g=inner, h=slope, d=float(constant))

    @property
    def dimension(self) -> int:
        """Return n."""
        return self.F.shape[1]

    def parts(self, dimension: int) -> tuple[Part, ...]:
        """Return (h'v + d, F v + g) in the standard cone."""
        return (Part(np.vstack([self.h, self.F]), np.append(self.d, self.g), Cone()),)

    def describe(self, names: Sequence[str], signal: str) -> str:
        """Return both sides of its inequality."""
        inner = f"|F {signal}{' + g' if self.g.any() else ''}|"
        outer = combination(self.h, names) if np.count_nonzero(self.h) <= MOST_ROWS else f"h' {signal}"
        constant = f" + {number(self.d)}" if self.d else ""
        return f"a second-order cone: {inner} {AT_MOST} {outer}{constant} with {datum('F', self.F, 2)}"


@dataclass(frozen=True, eq=False, init=False)
class Intersection(ConvexSet):
    """The points that lie in all of several sets; also written ``a & b``.

    Parameters
    ----------
    sets : sequence of sets
        Boxes, too; at least one.
    """

    sets: tuple[Any, ...]

    def __init__(self, sets: Sequence[Any]):
        if isinstance(sets, str) or not isinstance(sets, Sequence) or not sets:
            raise ProblemError("Intersection", brief(sets), "a list of at least one set")
        wrong = [one for one in sets if not isinstance(one, (Box, ConvexSet))]
        if wrong:
            raise ProblemError("Intersection", brief(wrong[0]), "sets such as Box, Polyhedron, Ball")
        known = {size for one in sets if (size := dimension_of(one)) is not None}
        if len(known) > 1:
            raise ProblemError("Intersection", f"sets in {sorted(known)} dimensions", "the same dimension for all")
        assign(self, sets=tuple(sets))
        _ = self.box  # which must not be empty

    @property
    def dimension(self) -> int | None:
        """Return n, if one of the sets says it."""
        return next((size for one in self.sets if (size := dimension_of(one)) is not None), None)

    @property
    def box(self) -> Box:
        """Return the bounds of all sets together."""
        return reduce(_common, (one if isinstance(one, Box) else one.box for one in self.sets))

    def parts(self, dimension: int) -> tuple[Part, ...]:
        """Return the parts of all sets."""
        return tuple(part for one in self.sets if isinstance(one, ConvexSet) for part in one.parts(dimension))

    def describe(self, names: Sequence[str], signal: str) -> str:
        """Return all sets one by one; of many, how many there are."""
        text = "; and ".join(one.describe(names, signal) for one in self.sets)
        kinds = ", ".join(dict.fromkeys(type(one).__name__ for one in self.sets))
        return text if len(text) <= 2 * MOST_TEXT else f"an intersection of {len(self.sets)} sets ({kinds})"


@dataclass(frozen=True, eq=False, init=False)
class Soft(ConvexSet):
    """A set that may be left, at a price: penalty times the excess over each of its constraints is added to the cost.

    For a Box and a Polyhedron, the excess over every bound and row; for a Ball and an Ellipsoid, that of the norm over
    the radius. If the set can be kept and the penalty exceeds its multipliers, it is kept exactly.

    Parameters
    ----------
    soft_set : Box, Polyhedron, Ball or Ellipsoid
    penalty : float
        Above zero, in units of cost per unit of excess.
    """

    soft_set: Any
    penalty: float

    def __init__(self, soft_set: Any, penalty: float):
        if not isinstance(soft_set, (Box, Polyhedron, Ball, Ellipsoid)):
            raise ProblemError("Soft", brief(soft_set), "a Box, Polyhedron, Ball or Ellipsoid")
        if isinstance(soft_set, Box) and soft_set.lower.ndim > 1:
            raise ProblemError("Soft", "a box with one bound per time", "one box", "Give a list of Soft sets.")
        assign(self, soft_set=soft_set, penalty=positive_number("Soft.penalty", penalty))

    @property
    def dimension(self) -> int | None:
        """Return n, if the set says it."""
        return dimension_of(self.soft_set)

    def parts(self, dimension: int) -> tuple[Part, ...]:
        """Return the parts of the set, with a finite weight."""
        weight = np.asarray(self.penalty)
        if isinstance(self.soft_set, Box):
            box, identity = self.soft_set.at_dimension(dimension, "Soft"), np.eye(dimension)
            limits = np.concatenate([box.upper, -box.lower], axis=-1)
            return (Part(np.vstack([identity, -identity]), np.zeros(2 * dimension), Below(limits, weight)),)
        return tuple(Part(part.F, part.c, _softened(part.penalty, weight)) for part in self.soft_set.parts(dimension))

    def describe(self, names: Sequence[str], signal: str) -> str:
        """Return the set, and the price of leaving it."""
        return f"{self.soft_set.describe(names, signal)}{price(self.penalty)}"


def dimension_of(one: Any) -> int | None:
    """Return the dimension of a set, or None if it fits every one."""
    if isinstance(one, Box):
        return one.lower.shape[-1] if one.lower.ndim else None
    return one.dimension


def _common(one: Box, other: Box) -> Box:
    try:
        lower, upper = np.maximum(one.lower, other.lower), np.minimum(one.upper, other.upper)
    except ValueError:
        got = f"bounds for {len(one.lower)} and {len(other.lower)} times"
        raise ProblemError("Intersection", got, "the same times for all") from None
    apart = lower > upper
    if apart.any():
        got = f"bounds {lower[apart].flat[0]:g} <= v <= {upper[apart].flat[0]:g} on a component"
        raise ProblemError("Intersection", got, "a point within the bounds of all sets")
    return Box(lower, upper)


def _softened(penalty: Penalty, weight: Array) -> Penalty:
    if isinstance(penalty, Below):
        return Below(penalty.limit, weight)
    assert isinstance(penalty, Norm)  # of the sets that Soft takes
    return Norm(penalty.order, penalty.radius, weight)


def _ball(radius: float) -> Norm:
    return Norm(2, np.asarray(radius), HARD)


def _centre(field: str, centre: ArrayLike, n: int | None) -> Array:
    middle = real_array(field, centre)
    if middle.ndim > 1 or (middle.ndim and n is not None and len(middle) != n):
        raise ProblemError(field, f"shape {middle.shape}", "one number" + (f", or {n}" if n else " per component"))
    return middle
