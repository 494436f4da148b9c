# ruff: noqa: D102
"""Boxes and points. Bounds of two dimensions, (times, n), are one box per time.

Methods without a docstring are described by ``ConvexSet``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import NO_BOUND, Array, Bound, Mask, assign, brief, freeze, one_component, real_array
from lin_freq_ocp.base.errors import ProblemError, located_at
from lin_freq_ocp.base.names import ByName, stack_components, values_by_name
from lin_freq_ocp.base.phrases import MOST_TEXT, intervals, plural, short_name
from lin_freq_ocp.problem.sets.base import Bounds, ConvexSet, Part
from lin_freq_ocp.problem.terms.penalties import HalfSpaces

End = ConvexSet | ByName | ArrayLike | None  # of the horizon: a set, a point, or no constraint
SetOrSets = ConvexSet | Sequence[ConvexSet] | None  # one set for all times, one per time, or no constraint

END_TOLERANCE = 1e-9  # largest relative distance of an end from the set of its time that is rounding


@dataclass(frozen=True, eq=False, init=False)
class Box(ConvexSet):
    """The set of all v with lower <= v <= upper, componentwise.

    Parameters
    ----------
    lower, upper : float, (n,), (times, n), or mapping
        Bounds; None, the default, -inf and inf stand for no bound. A single number holds for every component. A bound
        of 1e20 or more in absolute value stands for none, and becomes infinite; two equal bounds are a point, however
        large. A mapping has the bounds by the names of components, with or without their units:
        ``Box(lower={"speed": -1})``. A problem then knows which components are meant.
    pairs : mapping
        In place of both: ``Box({"speed [m/s]": (-1, 1)})``. Else the first argument is ``lower``.

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
        The distance of each component from the box.
    project(v)
        The nearest point of the box.
    support(y)
        The largest <y, v> over the box.
    """

    lower: Array
    upper: Array

    components: tuple[str, ...] = field(default=(), repr=False)  # names, if it is stated by name

    def __init__(self, pairs: Bound | ByName = None, /, upper: Bound | ByName = None, *, lower: Bound | ByName = None):
        if pairs is not None and lower is not None:
            raise ProblemError("Box.lower", "two values", "one")
        if isinstance(pairs, Mapping) and upper is None:
            lower, upper = _sides(pairs)
        elif pairs is not None:
            lower = pairs
        if isinstance(lower, Mapping) or isinstance(upper, Mapping):
            components, low, high = _bounds_by_name(lower, upper)
            assign(self, components=components)
        else:
            low, high = _bound("lower", lower, -np.inf), _bound("upper", upper, np.inf)
        try:
            shape = np.broadcast_shapes(low.shape, high.shape)
        except ValueError:
            got = f"lower of shape {low.shape}, upper of shape {high.shape}"
            raise ProblemError("Box", got, "the same shape") from None
        low, high = np.broadcast_to(low, shape), np.broadcast_to(high, shape)
        if low.ndim > 2:
            raise ProblemError("Box", f"bounds with {low.ndim} dimensions", "one bound per component, or (times, n)")
        wrong = low > high
        if wrong.any():
            i = tuple(int(k) for k in np.argwhere(wrong)[0])
            entry = f"[{self.components[i[-1]]!r}]" if self.components else "".join(f"[{k}]" for k in i)
            got = f"{low[i]:g} above upper{entry} = {high[i]:g}"
            raise ProblemError(f"Box.lower{entry}", got, "lower <= upper", "Exchange them?")
        if ((np.abs(low) >= NO_BOUND) | (np.abs(high) >= NO_BOUND)).any():  # for no bound
            apart = low < high
            low = np.where(apart & (low <= -NO_BOUND), -np.inf, low)
            high = np.where(apart & (high >= NO_BOUND), np.inf, high)
            for side, bound, sign in (("lower", low, 1), ("upper", high, -1)):
                impossible = apart & (sign * bound >= NO_BOUND)
                if impossible.any():
                    expected = f"a number below {NO_BOUND:g} in absolute value"
                    advice = "A number of that size stands for no bound; choose other units."
                    raise ProblemError(f"Box.{side}", f"{bound[impossible][0]:g}", expected, advice)
        assign(self, lower=freeze(low), upper=freeze(high))

    @property
    def dimension(self) -> int | None:
        return self.lower.shape[-1] if self.lower.ndim and not self.components else None

    @property
    def bounds(self) -> Bounds:
        return super().bounds if self.components else (self.lower, self.upper)

    def at_names(self, names: Sequence[str]) -> Box:
        if not self.components:
            return self
        lower, upper = (
            values_by_name("Box", dict(zip(self.components, side.T, strict=True)), names, absent, allow_infinite=True)
            for side, absent in ((self.lower, -np.inf), (self.upper, np.inf))
        )
        return Box(lower, upper)

    @property
    def members(self) -> tuple[ConvexSet, ...]:
        return ()

    def parts(self, dimension: int) -> tuple[Part, ...]:
        self.at_dimension(dimension, "Box")
        return ()

    def soft_parts(self, dimension: int, weight: Array) -> tuple[Part, ...]:
        box, identity = self.at_dimension(dimension, "Soft"), np.eye(dimension)
        limits = np.concatenate([box.upper, -box.lower], axis=-1)
        return (Part(np.vstack([identity, -identity]), np.zeros(2 * dimension), HalfSpaces(limits, weight)),)

    def augmented(self, n: int, k: int) -> Box:
        box, free = self.at_dimension(n, "Box"), np.full(k, np.inf)
        return Box(np.append(box.lower, -free), np.append(box.upper, free))

    def translated(self, origin: Array) -> Box:
        return Box(self.lower - origin, self.upper - origin)

    def farthest(self, dimension: int) -> tuple[Callable[[Array], Array], Array]:
        box = self.at_dimension(dimension, "disturbance.set")
        if box.lower.ndim > 1:
            raise ProblemError("disturbance.set", "bounds that depend on time", "one box for all times")
        return lambda y: np.where(y > 0, box.upper, box.lower), np.zeros(dimension)

    def at_dimension(self, dimension: int, field: str) -> Box:
        """Return the box with bounds of shape (dimension,) or (times, dimension)."""
        if self.components:
            expected = "a problem, whose signals have names"
            raise ProblemError(field, f"bounds by name on {', '.join(map(repr, self.components))}", expected)
        if self.lower.ndim == 0:
            return _box_of_checked(*(freeze(np.full(dimension, side)) for side in self.bounds))
        if self.lower.shape[-1] != dimension:
            got = plural(self.lower.shape[-1], "component")
            raise ProblemError(field, f"bounds for {got}", f"bounds for {dimension}")
        return self

    def at(self, t: int) -> Box:
        """Return the box of one time, of bounds (times, n)."""
        return _box_of_checked(self.lower[t], self.upper[t])

    def with_ends(self, first: Box, last: Box) -> Box:
        """Return the box, of bounds (times, n), with those of other boxes at the first and at the last time."""
        lower, upper = self.lower.copy(), self.upper.copy()
        lower[0], upper[0], lower[-1], upper[-1] = *first.bounds, *last.bounds
        return _box_of_checked(freeze(lower), freeze(upper))

    @cached_property
    def fixed(self) -> Mask:
        """Where the box leaves no freedom: lower == upper."""
        return freeze(self.lower == self.upper)

    def violation(self, v: Array) -> Array:
        """Return the distance of each component of v from the box (0 inside); same shape as v."""
        return np.maximum(np.maximum(self.lower - v, v - self.upper), 0.0)

    def contains(self, v: Array, tolerance: float = 0.0) -> Mask:
        """Whether each v (..., n) lies within ``tolerance`` of the box in every component."""
        return np.asarray((self.violation(v) <= tolerance).all(axis=-1))

    def project(self, v: Array) -> Array:
        """Return the nearest point of the box."""
        return np.clip(v, self.lower, self.upper)

    def support(self, y: Array) -> Array:
        """Return sigma(y) = max over the box of <y, v>, for y (..., n); inf where unbounded."""
        bound = np.where(y > 0, self.upper, np.where(y < 0, self.lower, 0.0))
        return (y * bound).sum(axis=-1)

    def describe(self, names: Sequence[str], signal: str) -> str:
        box = self.at_dimension(len(names), "names")
        bounds = np.atleast_2d(box.lower), np.atleast_2d(box.upper)
        parts = {name: intervals(*(bound[:, i] for bound in bounds)) for i, name in enumerate(names)}
        bounded = {name: words for name, words in parts.items() if words != "no bound"}
        if not bounded:
            return "no constraint"
        if len(bounded) == len(names) and len(set(bounded.values())) == 1:
            return f"every component {next(iter(bounded.values()))}"
        text = ", ".join(f"{short_name(name)} {words}" for name, words in bounded.items())
        return text if len(text) <= MOST_TEXT else f"bounds on {plural(len(bounded), 'component')}"


class Point(Box):
    """The set {value}; its normal cone is the whole space.

    Parameters
    ----------
    value : (n,)
        The point; a number, if it has one component.

    Examples
    --------
    >>> lfo.sets.Point([1.0, 2.0]).fixed
    array([ True,  True])
    """

    def __init__(self, value: ArrayLike):
        point = one_component(real_array("Point", value), 1)
        if point.ndim != 1:
            raise ProblemError("Point", f"shape {point.shape}", "one number per component")
        assign(self, lower=freeze(point), upper=freeze(point))

    @property
    def value(self) -> Array:
        """Return the point, shape (n,)."""
        return self.lower


class Everything(Box):
    """No constraint at all.

    Examples
    --------
    >>> bool(lfo.sets.Everything().contains([1e9, -1e9]))
    True
    """

    def __init__(self):
        assign(self, lower=freeze(np.array(-np.inf)), upper=freeze(np.array(np.inf)))


def at_names(field: str, given: SetOrSets, names: Sequence[str]) -> SetOrSets:
    """Return one set, a sequence of sets, or None, with bounds by name as those of components of these names."""
    if isinstance(given, (list, tuple)):
        each = enumerate(given)
        return type(given)(
            _at_names(f"{field}[{t}]", one, names) if isinstance(one, ConvexSet) else one for t, one in each
        )
    return _at_names(field, given, names) if isinstance(given, ConvexSet) else given


def _at_names(field: str, given: ConvexSet, names: Sequence[str]) -> ConvexSet:
    with located_at(field, type(given).__name__):
        return given.at_names(names)


def bounds_over_time(field: str, given: SetOrSets, dimension: int, times: int) -> Box:
    """Return the bounds of each time, (times, dimension), of one set, a sequence of sets, or None."""
    if isinstance(given, Sequence) and not isinstance(given, str):
        expected = f"one set, or a sequence of {times} sets, one per time"
        if len(given) != times:
            raise ProblemError(field, f"a sequence of {len(given)}", expected, "Bounds are lfo.Box(lower, upper).")
        for t, convex_set in enumerate(given):
            if not isinstance(convex_set, ConvexSet):
                raise ProblemError(field, f"{brief(convex_set)} at place {t}", expected)
        boxes = [box_of(convex_set).at_dimension(dimension, f"{field}[{t}]") for t, convex_set in enumerate(given)]
        return Box(np.array([box.lower for box in boxes]), np.array([box.upper for box in boxes]))
    given = Everything() if given is None else given
    if not isinstance(given, ConvexSet):
        raise ProblemError(field, brief(given), "a set such as Box or Polyhedron, or a sequence with one per time")
    box = box_of(given).at_dimension(dimension, field)
    if box.lower.ndim == 2 and len(box.lower) != times:
        raise ProblemError(field, f"bounds for {len(box.lower)} times", f"bounds for {times} times")
    return Box(np.broadcast_to(box.lower, (times, dimension)), np.broadcast_to(box.upper, (times, dimension)))


def end_set(field: str, given: End, names: Sequence[str]) -> ConvexSet:
    """Return the set of an end of the horizon, from a point, a set, or None, for states of these names."""
    dimension = len(names)
    if isinstance(given, Mapping):
        convex_set = Point(values_by_name(field, given, names, absent=None))
    elif given is None or isinstance(given, ConvexSet):
        named = at_names(field, given, names)
        convex_set = named if isinstance(named, ConvexSet) else Everything()
    else:
        expected = f"numbers, one for each of the {dimension} states, a set, or None"
        try:
            point = one_component(real_array(field, given), dimension)
        except ProblemError as error:
            if error.field == field:  # and not one of its entries
                error = ProblemError(field, error.got, expected)
            raise error from None
        if point.shape != (dimension,):
            raise ProblemError(field, f"shape {point.shape}", expected)
        convex_set = Point(point)
    box = box_of(convex_set).at_dimension(dimension, field)
    if box.lower.ndim != 1:
        raise ProblemError(field, "one set per time", "a point or a single set")
    return convex_set if convex_set.members else box


def end_within(end: Box, bounds: Box) -> tuple[Box, Mask]:
    """Return the box of an end within the bounds of its time, both (n,), and the components in which they are disjoint.

    In these, and in those that only rounding separates, the box is that of the end alone.
    """
    lower, upper = np.maximum(end.lower, bounds.lower), np.minimum(end.upper, bounds.upper)
    distance = np.maximum(lower - upper, 0.0)
    if distance.any():
        outside = distance > END_TOLERANCE * np.maximum(np.abs(lower), np.abs(upper))
        lower, upper = np.where(distance > 0, end.lower, lower), np.where(distance > 0, end.upper, upper)
    else:
        outside = np.zeros(lower.shape, dtype=bool)
    return _box_of_checked(freeze(lower), freeze(upper)), outside


def fix_values(given: SetOrSets, values: Array | None) -> SetOrSets:
    """Return a set whose bounds are the values (times, n), where they are numbers; without values, the given set."""
    if values is None:
        return given
    box = Box(*(np.where(np.isnan(values), absent, values) for absent in (-np.inf, np.inf)))
    return given & box if isinstance(given, ConvexSet) else box


def box_of(convex_set: ConvexSet) -> Box:
    """Return a box itself, and the bounds of any other set."""
    return convex_set if isinstance(convex_set, Box) else _box_of_checked(*convex_set.bounds)


def _box_of_checked(lower: Array, upper: Array) -> Box:
    """Return a box of bounds that need no check."""
    box = Box.__new__(Box)
    assign(box, lower=lower, upper=upper)
    return box


def _bound(side: str, value: object, absent: float) -> Array:
    bound = real_array(f"Box.{side}", _without_none(value, absent), allow_infinite=True)
    if (bound == -absent).any():
        raise ProblemError(f"Box.{side}", f"{-absent}", f"a number, or None or {absent} for no bound")
    return bound


def _sides(pairs: ByName) -> tuple[ByName, ByName]:
    """Return the lower and the upper bounds of a mapping that has both of each component."""
    lower, upper = dict[str, object](), dict[str, object]()
    for name, pair in pairs.items():
        if not isinstance(pair, (list, tuple)) or len(pair) != 2:
            advice = "For one bound, the other is None."
            raise ProblemError(f"Box[{name!r}]", brief(pair), "a pair (lower, upper)", advice)
        lower[name], upper[name] = pair
    return lower, upper


def _bounds_by_name(lower: Bound | ByName, upper: Bound | ByName) -> tuple[tuple[str, ...], Array, Array]:
    """Return names and their bounds, (names,) or (times, names)."""
    components = tuple(dict.fromkeys(name for side in (lower, upper) if isinstance(side, Mapping) for name in side))
    if not components:
        raise ProblemError("Box", "a mapping without names", "bounds of at least one component")
    sides = list[Array]()
    for side, bound, absent in (("lower", lower, -np.inf), ("upper", upper, np.inf)):
        entries = bound if isinstance(bound, Mapping) else dict.fromkeys(components, bound)
        columns = [_bound(f"{side}[{name!r}]", entries.get(name), absent) for name in components]
        sides.append(stack_components(f"Box.{side}", columns))
    return components, sides[0], sides[1]


def _without_none(value: object, absent: float) -> object:
    if isinstance(value, (list, tuple)):
        return [_without_none(entry, absent) for entry in value]
    return absent if value is None else value


def map_sets(given: SetOrSets, change: Callable[[ConvexSet], ConvexSet]) -> SetOrSets:
    """Return a changed set, or one for each time; None stays."""
    return [one and change(one) for one in given] if isinstance(given, Sequence) else given and change(given)
