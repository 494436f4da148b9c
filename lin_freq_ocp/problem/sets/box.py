"""Pointwise constraint sets. A set bound of two dimensions, (times, n), is one set per time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.arrays import Array, Bound, Mask, assign, brief, frozen, one_component, real_array
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.phrases import MOST_TEXT, intervals, plural, short_name
from lin_freq_ocp.problem.sets.base import Bounds, ConvexSet, Part
from lin_freq_ocp.problem.terms.penalties import HalfSpaces

NO_BOUND = 1e20
"""A bound from here on is none: other tools write infinity so."""

INSIDE = 1e-9
"""How far, relative to its size, an end may lie outside the set of its time: rounding."""


@dataclass(frozen=True, eq=False, init=False)
class Box(ConvexSet):
    """The set of all v with lower <= v <= upper, componentwise.

    Parameters
    ----------
    lower, upper : float, (n,) or (times, n)
        Bounds; None, the default, or -inf and inf, where there is none. A single number holds for every component. A
        bound of 1e20 or more in absolute value stands for none, and becomes infinite; two that are equal are a point,
        however large.

    Raises
    ------
    ProblemError
        If a bound is not a number, or a lower bound is above its upper bound.

    Examples
    --------
    >>> bool(lfo.Box([None, -1], [None, 1]).contains([9.0, 0.5]))
    True

    Methods
    -------
    contains(v)
        Whether points lie in the box.
    violation(v)
        By how much each component lies outside.
    project(v)
        The nearest point of the box.
    support(y)
        The largest <y, v> over the box.
    """

    lower: Array
    upper: Array

    def __init__(self, lower: Bound = None, upper: Bound = None):
        low, high = _bound("lower", lower, -np.inf), _bound("upper", upper, np.inf)
        try:
            low, high = np.broadcast_arrays(low, high)
        except ValueError:
            raise ProblemError(
                "Box", f"lower of shape {low.shape}, upper of shape {high.shape}", "the same shape"
            ) from None
        if low.ndim > 2:
            raise ProblemError("Box", f"bounds with {low.ndim} dimensions", "one bound per component, or (times, n)")
        wrong = low > high
        if wrong.any():
            i = tuple(int(k) for k in np.argwhere(wrong)[0])
            place = "".join(f"[{k}]" for k in i)
            raise ProblemError(
                f"Box.lower{place}", f"{low[i]:g} above upper{place} = {high[i]:g}", "lower <= upper", "Exchange them?"
            )
        low, high = _without_words(low, high)
        assign(self, lower=frozen(low), upper=frozen(high))

    @property
    def dimension(self) -> int | None:
        """Return n; None if a number holds for every component."""
        return self.lower.shape[-1] if self.lower.ndim else None

    @property
    def bounds(self) -> Bounds:
        """Return both bounds."""
        return self.lower, self.upper

    @property
    def members(self) -> tuple[ConvexSet, ...]:
        """Return nothing: there are bounds only."""
        return ()

    def parts(self, dimension: int) -> tuple[Part, ...]:
        """Return nothing: there are bounds only."""
        return ()

    def soft_parts(self, dimension: int, weight: Array) -> tuple[Part, ...]:
        """Return the bounds as rows with a price."""
        box, identity = self.at_dimension(dimension, "Soft"), np.eye(dimension)
        limits = np.concatenate([box.upper, -box.lower], axis=-1)
        return (Part(np.vstack([identity, -identity]), np.zeros(2 * dimension), HalfSpaces(limits, weight)),)

    def extended(self, n: int, k: int) -> Box:
        """Return the box of (x, w) with x in this one and w free."""
        box, free = self.at_dimension(n, "Box"), np.full(k, np.inf)
        return Box(np.append(box.lower, -free), np.append(box.upper, free))

    def at_dimension(self, dimension: int, field: str) -> Box:
        """Return the box with bounds of shape (dimension,) or (times, dimension)."""
        if self.lower.ndim == 0:
            return Box(np.full(dimension, self.lower), np.full(dimension, self.upper))
        if self.lower.shape[-1] != dimension:
            raise ProblemError(field, f"bounds for {self.lower.shape[-1]} components", f"bounds for {dimension}")
        return self

    def at(self, t: int) -> Box:
        """Return the box of one time, of bounds (times, n)."""
        return _checked(self.lower[t], self.upper[t])

    @property
    def fixed(self) -> Mask:
        """Where the box leaves no freedom: lower == upper."""
        return self.lower == self.upper

    def violation(self, v: Array) -> Array:
        """Return by how much v lies outside, per component (0 inside); same shape as v."""
        return np.maximum(np.maximum(self.lower - v, v - self.upper), 0.0)

    def contains(self, v: Array, tolerance: float = 0.0) -> Mask:
        """Whether each v (..., n) lies within ``tolerance`` of the box in every component."""
        return np.asarray((self.violation(v) <= tolerance).all(axis=-1))

    def project(self, v: Array) -> Array:
        """Return the nearest point of the box."""
        return np.clip(v, self.lower, self.upper)

    def support_terms(self, y: Array) -> Array:
        """Return the terms y_i * (upper_i if y_i > 0 else lower_i) of the support function; inf where unbounded."""
        bound = np.where(y > 0, self.upper, self.lower)
        return np.where(y == 0, 0.0, y * np.where(y == 0, 0.0, bound))

    def support(self, y: Array) -> Array:
        """Return sigma(y) = max over the box of <y, v>, for y (..., n)."""
        return self.support_terms(y).sum(axis=-1)

    def normal_gap_terms(self, v: Array, y: Array) -> Array:
        """Return per component sigma_i(y_i) - y_i v_i, computed as y_i (bound - v_i): zero iff y_i is normal at v_i."""
        distance = np.where(y > 0, self.upper - v, v - self.lower)
        return np.where(y == 0, 0.0, np.abs(y) * np.where(y == 0, 0.0, distance))

    def normal_gap(self, v: Array, y: Array) -> Array:
        """Return sigma(y) - <y, v>: zero iff y lies in the normal cone of the box at v (v in the box)."""
        return self.normal_gap_terms(v, y).sum(axis=-1)

    def describe(self, names: Sequence[str], signal: str) -> str:
        """Return it in words, for components of these names; see ``ConvexSet.describe``."""
        box = self.at_dimension(len(names), "names")
        bounds = np.atleast_2d(box.lower), np.atleast_2d(box.upper)
        parts = {name: intervals(*(bound[:, i] for bound in bounds)) for i, name in enumerate(names)}
        found = {name: words for name, words in parts.items() if words != "no bound"}
        if not found:
            return "no constraint"
        if len(found) == len(names) and len(set(found.values())) == 1:
            return f"every component {next(iter(found.values()))}"
        text = ", ".join(f"{short_name(name)} {words}" for name, words in found.items())
        return text if len(text) <= MOST_TEXT else f"bounds on {plural(len(found), 'component')}"


class Point(Box):
    """The set {value}; its normal cone is the whole space.

    Parameters
    ----------
    value : (n,)
        The point; a number, if it has one component.
    """

    def __init__(self, value: ArrayLike):
        point = one_component(real_array("Point", value), 1)
        if point.ndim != 1:
            raise ProblemError("Point", f"shape {point.shape}", "one number per component")
        super().__init__(point, point)

    @property
    def value(self) -> Array:
        """Return the point, shape (n,)."""
        return self.lower


class Everything(Box):
    """No constraint at all."""

    def __init__(self):
        super().__init__(None, None)


def stacked(field: str, given: Any, dimension: int, times: int) -> Box:
    """Return one box per time: bounds of shape (times, dimension), from one set, a sequence of sets, or None."""
    if isinstance(given, Sequence) and not isinstance(given, str):
        expected = f"one set, or a sequence of {times} sets, one per time"
        if len(given) != times:
            raise ProblemError(field, f"a sequence of {len(given)}", expected)
        for t, one in enumerate(given):
            if not isinstance(one, ConvexSet):
                raise ProblemError(field, f"{brief(one)} at place {t}", expected)
        boxes = [box_of(one).at_dimension(dimension, f"{field}[{t}]") for t, one in enumerate(given)]
        return Box(np.array([box.lower for box in boxes]), np.array([box.upper for box in boxes]))
    given = Everything() if given is None else given
    if not isinstance(given, ConvexSet):
        raise ProblemError(field, brief(given), "a set such as Box or Polyhedron, or a sequence with one per time")
    box = box_of(given).at_dimension(dimension, field)
    if box.lower.ndim == 2 and len(box.lower) != times:
        raise ProblemError(field, f"bounds for {len(box.lower)} times", f"bounds for {times} times")
    return Box(np.broadcast_to(box.lower, (times, dimension)), np.broadcast_to(box.upper, (times, dimension)))


def end_set(field: str, given: Any, dimension: int) -> ConvexSet:
    """Return the set of an end of the horizon, from a point, a set, or None."""
    one = Everything() if given is None else given
    one = one if isinstance(one, ConvexSet) else _point(field, one, dimension)
    box = box_of(one).at_dimension(dimension, field)
    if box.lower.ndim != 1:
        raise ProblemError(field, "one set per time", "a point or a single set")
    return one if one.members else box


def _point(field: str, given: Any, dimension: int) -> Point:
    expected = f"numbers, one for each of the {dimension} states, a set, or None"
    try:
        point = one_component(real_array(field, given), dimension)
    except ProblemError as error:
        if error.field == field:  # and not one of its entries
            error = ProblemError(field, error.got, expected)
        raise error from None
    if point.shape != (dimension,):
        raise ProblemError(field, f"shape {point.shape}", expected)
    return Point(point)


def end_within(end: Box, bounds: Box) -> tuple[Box, Mask]:
    """Return the box of an end within the bounds of its time, both (n,), and where no point is in both.

    There, and where only rounding is between them, the box is that of the end alone.
    """
    lower, upper = np.maximum(end.lower, bounds.lower), np.minimum(end.upper, bounds.upper)
    excess = np.maximum(lower - upper, 0.0)
    if not excess.any():
        return _checked(frozen(lower), frozen(upper)), np.zeros(lower.shape, dtype=bool)
    apart = excess > 0
    beyond = excess > INSIDE * np.maximum(np.abs(lower), np.abs(upper))
    kept = np.where(apart, end.lower, lower), np.where(apart, end.upper, upper)
    return _checked(*map(frozen, kept)), beyond


def box_of(one: ConvexSet) -> Box:
    """Return a box as it is, and the bounds of any other set."""
    return one if isinstance(one, Box) else _checked(*one.bounds)


def _checked(lower: Array, upper: Array) -> Box:
    """Return a box of bounds that are already known to be good, without looking at them again."""
    box = Box.__new__(Box)
    assign(box, lower=lower, upper=upper)
    return box


def _without_words(low: Array, high: Array) -> tuple[Array, Array]:
    """Return bounds that are infinite where they stand for none."""
    words = (np.abs(low) >= NO_BOUND) | (np.abs(high) >= NO_BOUND)
    if not words.any():
        return low, high
    apart = low < high
    low, high = np.where(apart & (low <= -NO_BOUND), -np.inf, low), np.where(apart & (high >= NO_BOUND), np.inf, high)
    for side, bound, impossible in (
        ("lower", low, apart & (low >= NO_BOUND)),
        ("upper", high, apart & (high <= -NO_BOUND)),
    ):
        if impossible.any():
            raise ProblemError(
                f"Box.{side}",
                f"{bound[impossible][0]:g}",
                f"a number below {NO_BOUND:g} in absolute value",
                "That is beyond what stands for no bound at all; choose other units.",
            )
    return low, high


def _bound(side: str, value: Bound, absent: float) -> Array:
    bound = real_array(f"Box.{side}", _without_none(value, absent), allow_infinite=True)
    if (bound == -absent).any():
        raise ProblemError(f"Box.{side}", f"{-absent}", f"a number, or None or {absent} for no bound")
    return bound


def _without_none(value: Any, absent: float) -> Any:
    if isinstance(value, (list, tuple)):
        return [_without_none(entry, absent) for entry in value]
    return absent if value is None else value
