# ruff: noqa: D102
"""The protocol of convex sets, and their intersections.

A set has bounds on the components and parts {v : F v + c in the set of a penalty}. Solvers, certificates, descriptions
and the CVXPY export need nothing else. Methods without a docstring are described by ``ConvexSet``.

A new set is a subclass of ``ConvexSet`` in its own file, with ``dimension``, ``parts`` and ``describe``; a part takes
any penalty of ``problem/terms``. For problem files it needs an entry in ``files/problem_tables.py``.
``tests/helpers/own_kinds.py`` has a complete one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask, assign, brief, freeze, with_columns, with_products
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.phrases import MOST_TEXT
from lin_freq_ocp.problem.terms.penalty import Penalty
from lin_freq_ocp.problem.terms.term import Link

Bounds = tuple[Array, Array]  # lower and upper, of no, one or two dimensions


@dataclass(frozen=True, eq=False)
class Part:
    """{v : F v + c in the set of a penalty}."""

    F: Array  # (dim, n)
    c: Array  # (dim,)
    penalty: Penalty

    def values(self, v: Array) -> Array:
        """Return F v + c for points (points, n)."""
        return v @ self.F.T + self.c

    def translated(self, origin: Array) -> Part:
        """Return the part of v - origin, origin (n,)."""
        c, penalty = self.penalty.absorbing(with_products(self.c, (self.F, origin)))
        return Part(self.F, c, penalty)


class ConvexSet(ABC):
    """A convex set of vectors: bounds and parts."""

    may_be_soft: ClassVar[bool] = True  # whether ``Soft`` accepts it
    soft: ClassVar[bool] = False  # whether it may be violated at a price

    @property
    @abstractmethod
    def dimension(self) -> int | None:
        """Return n, or None if the set fits every dimension."""

    @abstractmethod
    def parts(self, dimension: int) -> tuple[Part, ...]:
        """Return the constraints on v in R^dimension, bounds apart."""

    @abstractmethod
    def describe(self, names: Sequence[str], signal: str) -> str:
        """Return a text such as "u within 2 of the origin" for a signal "x" or "u" with names of components."""

    @property
    def bounds(self) -> Bounds:
        """Return lower and upper bounds on the components."""
        return np.asarray(-np.inf), np.asarray(np.inf)

    @property
    def members(self) -> tuple[ConvexSet, ...]:
        """Return the sets whose intersection it is, without boxes."""
        return (self,)

    def links(self, dimension: int, horizon: int) -> tuple[Link, ...]:
        """Return its equations on both ends, as a terminal set."""
        return ()

    def at_names(self, names: Sequence[str]) -> ConvexSet:
        """Return the set with its bounds by name as those of components of these names."""
        return self

    @property
    def hull(self) -> ConvexSet:
        """Return the convex hull."""
        return self

    def points(self, dimension: int) -> Array | None:
        """Return the points of a finite set, (points, n); None for a convex set."""
        return None

    def levels_of(self, dimension: int) -> Sequence[Array]:
        """Return the levels of each of so many components, (levels,); empty for a set without levels."""
        return ()

    def costs_of(self, dimension: int) -> Sequence[Array]:
        """Return the costs of the levels of each of so many components, (levels,); empty for a set without levels."""
        return ()

    def shares(self, u: Array) -> Sequence[Array]:
        """Return the duty cycles of the levels of each component, (T, levels); empty for a set without levels."""
        return ()

    def soft_parts(self, dimension: int, weight: Array) -> tuple[Part, ...]:
        """Return the parts with a price per unit of violation."""
        return tuple(replace(part, penalty=part.penalty.softened(weight)) for part in self.parts(dimension))

    def augmented(self, n: int, k: int) -> ConvexSet:
        """Return the set of (x, w), w in R^k, with x in R^n in this set, without bounds."""
        parts = tuple(Part(with_columns(part.F, k), part.c, part.penalty) for part in self.parts(n))
        return PartSet(parts, n + k, self.describe([f"x[{i}]" for i in range(n)], "x"))

    def preimage(self, F: Array, share: float) -> ConvexSet:
        """Return the points z with F z in the set, without bounds; a soft one at a share of its price."""
        parts = tuple(Part(part.F @ F, part.c, part.penalty) for part in self.parts(len(F)))
        return PartSet(parts, F.shape[1], self.describe([f"x[{i}]" for i in range(len(F))], "x"))

    def relaxed(self, amount: float, dimension: int) -> ConvexSet:
        """Return the set with hard limits, bounds apart, that are higher by an amount; soft limits do not change."""
        parts = [Part(p.F, *p.penalty.relaxed(p.c, amount)) if p.penalty.hard else p for p in self.parts(dimension)]
        return PartSet(tuple(parts), dimension, f"wider by {amount:g}")

    @property
    def hard_members(self) -> tuple[ConvexSet, ...]:
        """Return its hard members."""
        return tuple(member for member in self.members if not member.soft)

    def translated(self, origin: Array) -> ConvexSet:
        """Return the set of v - origin for v in this set, origin (n,)."""
        n, (lower, upper) = len(origin), self.bounds
        parts = tuple(part.translated(origin) for part in self.parts(n))
        text = self.describe([f"x[{i}]" for i in range(n)], "x")
        return PartSet(parts, n, text, (lower - origin, upper - origin))

    def tightened(self, less: Callable[[Array], Array], dimension: int) -> ConvexSet:
        """Return the set with a margin: ``less`` maps rows F (rows, n) to the margins of F v, (rows,); bounds stay."""
        sides = np.vstack([np.eye(dimension), -np.eye(dimension)])
        if less(sides).any():
            got = f"a set of the kind {type(self).__name__}, whose values are uncertain"
            raise UnsupportedError(f"robust: got {got}; expected bounds, joint rows and polyhedra. State a polyhedron.")
        return self

    def farthest(self, dimension: int) -> tuple[Callable[[Array], Array], Array]:
        """Return the map from directions y (..., n) to points of the set with the largest y'v, and their error, (n,).

        |y|'error bounds how much larger the exact value is; infinite along components without a bound.
        """
        got, expected = f"a set of the kind {type(self).__name__}", "a Box, Ball, Ellipsoid or Polyhedron"
        raise ProblemError("disturbance.set", got, expected, "State a polyhedron, or bounds, around it.")

    def violation(self, v: Array) -> Array:
        """Return the largest violation of a constraint of the set by each v (..., n); 0 inside."""
        points = np.asarray(v, dtype=float)
        lower, upper = self.bounds
        largest = np.maximum(np.maximum(lower - points, points - upper), 0.0).max(-1)
        flat = points.reshape(-1, points.shape[-1])
        for part in self.parts(flat.shape[1]):
            largest = np.maximum(largest, part.penalty.violation(part.values(flat)).max(1).reshape(largest.shape))
        return largest

    def contains(self, v: Array, tolerance: float = 0.0) -> Mask:
        """Whether each v (..., n) violates no constraint of the set by more than ``tolerance``."""
        return np.asarray(self.violation(v) <= tolerance)

    def __and__(self, other: ConvexSet) -> Intersection:
        return Intersection([self, other])


@dataclass(frozen=True, eq=False)
class PartSet(ConvexSet):
    """A set that is derived from one of another class, by its parts."""

    given: tuple[Part, ...]
    size: int
    text: str
    box: Bounds = (np.asarray(-np.inf), np.asarray(np.inf))

    @property
    def dimension(self) -> int:
        return self.size

    @property
    def bounds(self) -> Bounds:
        return self.box

    def parts(self, dimension: int) -> tuple[Part, ...]:
        return self.given

    def describe(self, names: Sequence[str], signal: str) -> str:
        return self.text


@dataclass(frozen=True, eq=False, init=False)
class Intersection(ConvexSet):
    """The points that lie in all of several sets; also written ``a & b``.

    Parameters
    ----------
    sets : sequence of sets
        Boxes, too; at least one.

    Raises
    ------
    ProblemError
        If their dimensions differ, or no point lies within the bounds of all.

    Examples
    --------
    >>> both = lfo.Box(-1, 1) & lfo.sets.Ball(1.2)
    >>> both.contains([[1.0, 0.0], [1.0, 1.0]])
    array([ True, False])
    """

    sets: tuple[ConvexSet, ...]
    may_be_soft: ClassVar[bool] = False

    def __init__(self, sets: Sequence[ConvexSet]):
        if isinstance(sets, str) or not isinstance(sets, Sequence) or not sets:
            raise ProblemError("Intersection", brief(sets), "a list of at least one set")
        for given in sets:
            if not isinstance(given, ConvexSet):
                raise ProblemError("Intersection", brief(given), "sets such as Box, Polyhedron, Ball")
        known = {given.dimension for given in sets if given.dimension is not None}
        if len(known) > 1:
            raise ProblemError("Intersection", f"sets in {sorted(known)} dimensions", "the same dimension for all")
        assign(self, sets=tuple(sets))
        _ = self.bounds  # which must not be empty

    @property
    def dimension(self) -> int | None:
        return next((convex_set.dimension for convex_set in self.sets if convex_set.dimension is not None), None)

    @property
    def bounds(self) -> Bounds:
        lower, upper = self.sets[0].bounds
        for low, high in (convex_set.bounds for convex_set in self.sets[1:]):
            try:
                common = np.maximum(lower, low), np.minimum(upper, high)
            except ValueError:
                got = f"bounds for {len(lower)} and {len(low)} times"
                raise ProblemError("Intersection", got, "the same times for all") from None
            apart = common[0] > common[1]
            if apart.any():
                got = f"bounds {common[0][apart].flat[0]:g} <= v <= {common[1][apart].flat[0]:g} on a component"
                raise ProblemError("Intersection", got, "a point within the bounds of all sets")
            lower, upper = freeze(common[0]), freeze(common[1])
        return lower, upper

    @property
    def members(self) -> tuple[ConvexSet, ...]:
        return tuple(member for convex_set in self.sets for member in convex_set.members)

    def parts(self, dimension: int) -> tuple[Part, ...]:
        return tuple(part for convex_set in self.sets for part in convex_set.parts(dimension))

    def links(self, dimension: int, horizon: int) -> tuple[Link, ...]:
        return tuple(link for convex_set in self.sets for link in convex_set.links(dimension, horizon))

    def at_names(self, names: Sequence[str]) -> Intersection:
        return Intersection([convex_set.at_names(names) for convex_set in self.sets])

    def translated(self, origin: Array) -> Intersection:
        return Intersection([convex_set.translated(origin) for convex_set in self.sets])

    def describe(self, names: Sequence[str], signal: str) -> str:
        text = "; and ".join(convex_set.describe(names, signal) for convex_set in self.sets)
        kinds = ", ".join(dict.fromkeys(type(convex_set).__name__ for convex_set in self.sets))
        return text if len(text) <= 2 * MOST_TEXT else f"an intersection of {len(self.sets)} sets ({kinds})"
