# ruff: noqa: D102
"""Controls with finitely many levels and their costs, and dynamics with a mode for each combination of levels.

The convex hull of the pairs (level, cost) of a component is an interval and, as its cost, the lower convex envelope f.
Let l_0 < .. < l_k be the levels that span it, s_j the slope between l_j and l_(j+1), and l_m the level of the least
cost. On the interval, f is a sum of soft half spaces, prices on the violation of limits:

    f(u) = sum_(j >= m) (s_j - s_(j-1)) (u - l_j)+   with 0 for s_(m-1)      the rise to the right of l_m
         + sum_(j <= m) (s_j - s_(j-1)) (l_j - u)+   with 0 for s_m          the rise to the left of l_m
         + f(l_m) / (l_k - l_0) * [(u - l_0)+ + (l_k - u)+]                  the least cost, a constant
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import product
from math import gcd, lcm, prod
from operator import or_
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, assign, brief, freeze, known_entries, real_array
from lin_freq_ocp.base.errors import ProblemError, located_at
from lin_freq_ocp.base.names import ByName, index_of_name
from lin_freq_ocp.base.phrases import interval, plural, short_name, vector
from lin_freq_ocp.problem.dynamics.base import Dynamics, signal_labels
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.affine_mode import AffineMode
from lin_freq_ocp.problem.hybrid.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.hybrid.regions import SwitchingFacet
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import Bounds, ConvexSet, Part
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.sets.stage_rows import StageSets
from lin_freq_ocp.problem.terms.penalties import HalfSpaces
from lin_freq_ocp.problem.terms.term import TermKind

ON_ENVELOPE = 1e-12  # of the largest cost: a level this little above the line between others is on it (rounding)
MOST_POINTS = 256  # combinations of levels of all components: the same limit as for pieces of piecewise-affine maps


@dataclass(frozen=True, eq=False)
class Levels:
    """The increasing levels of one component, and their costs."""

    values: Array  # (levels,)
    costs: Array  # (levels,)

    @property
    def stated(self) -> list[float] | Box | None:
        """Return the levels as a list."""
        return self.values.tolist()

    def describe(self) -> str:
        """Return the levels and their costs in words, as the rest of a sentence that begins with the component."""
        return f"in {vector(self.values)}" + (f" at the costs {vector(self.costs)}" if self.costs.any() else "")

    @property
    def ends(self) -> tuple[float, float]:
        """Return the least and the largest level."""
        return float(self.values[0]), float(self.values[-1])

    @cached_property
    def spanning(self) -> list[int]:
        """The indices of the levels that span the lower convex envelope, increasing."""
        v, c, hull = self.values, self.costs, list[int]()
        for last in range(len(v)):
            while len(hull) > 1 and c.any():  # a level stays if it lies below the line between its neighbours
                first, middle = hull[-2:]
                line = c[first] + (c[last] - c[first]) * (v[middle] - v[first]) / (v[last] - v[first])
                if c[middle] < line - ON_ENVELOPE * np.abs(c).max():
                    break
                hull.pop()
            hull.append(last)
        return hull

    @property
    def above(self) -> Array:
        """Return the distance of each cost above the envelope, (levels,)."""
        above = self.costs - np.interp(self.values, self.values[self.spanning], self.costs[self.spanning])
        return np.where(above > ON_ENVELOPE * np.abs(self.costs).max(), above, 0.0)

    @property
    def hinges(self) -> tuple[Array, Array, Array]:
        """Return signs, limits and prices > 0: the cost is the sum of price * max(sign * u - limit, 0)."""
        level, cost = self.values[self.spanning], self.costs[self.spanning]
        least, slopes = int(np.argmin(cost)), np.diff(cost) / np.diff(level)
        right = np.diff(slopes[least:], prepend=0.0)
        left = np.diff(-slopes[:least][::-1], prepend=0.0)
        constant = np.full(2, cost[least] / (level[-1] - level[0]))
        signs = np.concatenate([np.ones(len(right)), -np.ones(len(left)), [1.0, -1.0]])
        limits = np.concatenate([level[least:-1], -level[1 : least + 1][::-1], [level[0], -level[-1]]])
        prices = np.concatenate([right, left, constant])
        return signs[prices > 0], limits[prices > 0], prices[prices > 0]

    def shares(self, u: Array) -> Array:
        """Return convex weights of the levels, (times, levels), of the two neighbours that span the envelope."""
        spanned = self.values[self.spanning]
        after = np.clip(np.searchsorted(spanned, u), 1, len(spanned) - 1)
        part = np.clip((u - spanned[after - 1]) / (spanned[after] - spanned[after - 1]), 0.0, 1.0)
        weights, times, columns = np.zeros((len(u), len(self.values))), np.arange(len(u)), np.array(self.spanning)
        weights[times, columns[after - 1]] = 1.0 - part
        weights[times, columns[after]] += part
        return weights


@dataclass(frozen=True, eq=False)
class NoLevels(Levels):
    """A component without levels, within a box of one component."""

    box: Box

    @property
    def stated(self) -> Box | None:
        return self.box if np.isfinite(self.box.bounds).any() else None

    def describe(self) -> str:
        return interval(*self.ends)

    @property
    def ends(self) -> tuple[float, float]:
        return float(self.box.lower), float(self.box.upper)

    @property
    def above(self) -> Array:
        return np.zeros(0)

    def shares(self, u: Array) -> Array:
        return np.zeros((len(u), 0))


@dataclass(frozen=True, eq=False, init=False)
class FiniteSet(ConvexSet):
    """Controls with finitely many levels: a ``control_set`` for all times.

    Every sample of every component is one of its levels. A problem with linear dynamics has a mode for every
    combination of levels, and the mode search proves its answer. With ``duty_cycles``, components may switch between
    levels within a sample: u_t is the mean over the sample, its cost is the mean of the costs, and the problem is
    convex.

    Parameters
    ----------
    levels : sequence of float, sequence of such sequences, or mapping of names to such sequences
        At least two different levels in any order, in the unit of the control: one sequence for all components, or a
        sequence for each. A component without levels has None, or a Box of its bounds, in place of the sequence; a
        mapping names the others: ``FiniteSet({"valve": [0, 1, 2], "pump": lfo.Box(0, 3)})``.
    costs : of the shape of ``levels``, without entries for components without levels, optional
        The cost of each level at every sample, zero or above; default zero.
    duty_cycles : bool
        Whether a component may switch within a sample.

    Raises
    ------
    ProblemError
        If levels are missing, not finite or equal, if costs have another shape or are below zero, or if without
        ``duty_cycles`` a cost lies above the line between its neighbours.

    References
    ----------
    docs/levels.md: the relaxation, its proof, and its properties.

    Examples
    --------
    >>> dynamics, on_off = lfo.LinearDynamics([[1.0]], [[1.0]]), lfo.FiniteSet([-1, 0, 1], costs=[1, 0, 1])
    >>> problem = lfo.OptimalControlProblem(dynamics, 4, lfo.QuadraticCost(), on_off, lfo.Box(-9, 9), [0], [2])
    >>> round(lfo.solve(problem).cost, 9)
    2.0
    >>> lfo.FiniteSet([lfo.Box(0, 3), [0, 1, 2]]).describe(["pump", "valve"], "u")
    'pump from 0 to 3; valve in (0, 1, 2)'
    """

    may_be_soft: ClassVar[bool] = False  # its costs are prices already

    components: tuple[Levels, ...]  # the levels of each component, or one for all
    single: bool  # whether one sequence applies to all components
    duty_cycles: bool
    names: tuple[str, ...]  # of the components, if they are stated by name

    def __init__(
        self,
        levels: ArrayLike | Sequence[object] | ByName,
        costs: ArrayLike | Sequence[object] | ByName | None = None,
        duty_cycles: bool = False,
    ):
        names = tuple(levels) if isinstance(levels, Mapping) else ()
        if isinstance(levels, Mapping):
            prices = known_entries("FiniteSet.costs", costs, names)
            levels, costs = list(levels.values()), [prices.get(name) for name in names] if prices else None
        rows, single = _sequences("FiniteSet.levels", levels)
        if not isinstance(duty_cycles, (bool, np.bool_)):
            raise ProblemError("FiniteSet.duty_cycles", brief(duty_cycles), "True or False")
        priced = [None] * len(rows)
        if costs is not None:
            priced, single_costs = _sequences("FiniteSet.costs", costs)
            if single_costs != single or len(priced) != len(rows):
                got = "one sequence" if single_costs else plural(len(priced), "sequence")
                raise ProblemError("FiniteSet.costs", got, "costs of the shape of levels")
        places = [f"[{names[i]!r}]" if names else "" if single else f"[{i}]" for i in range(len(rows))]
        components = tuple(_levels(*row) for row in zip(places, rows, priced, strict=True))
        if not any(len(component.values) for component in components):
            raise ProblemError("FiniteSet.levels", "no levels", "levels of one component at least", "A Box has bounds.")
        assign(self, components=components, single=single, duty_cycles=bool(duty_cycles), names=names)
        for name, component in zip(places, components, strict=True):
            if not duty_cycles and component.above.any():
                j = int(np.argmax(component.above))
                cost, level, above = (values[j] for values in (component.costs, component.values, component.above))
                got = f"{cost:g} for the level {level:g}, {above:g} above the line between others"
                advice = "duty_cycles=True would never use this level; a search over whole levels needs convex costs."
                raise ProblemError(f"FiniteSet.costs{name}", got, "costs that lie on a convex curve", advice)

    @property
    def levels(self) -> Sequence[object]:
        """Return the increasing levels as lists; None or a Box for a component without levels."""
        rows = [component.stated for component in self.components]
        return self.components[0].values.tolist() if self.single else rows

    @property
    def costs(self) -> Sequence[object] | None:
        """Return the costs of the levels as lists; None if all are zero."""
        rows = [component.costs.tolist() for component in self.components]
        free = not any(component.costs.any() for component in self.components)
        return None if free else rows[0] if self.single else rows

    @property
    def dimension(self) -> int | None:
        return None if self.single or self.names else len(self.components)

    @property
    def bounds(self) -> Bounds:
        ends = np.array([component.ends for component in self.components]).T
        lower, upper = ends[:, 0] if self.single else ends
        return freeze(np.asarray(lower)), freeze(np.asarray(upper))

    @property
    def hull(self) -> FiniteSet:
        """Return the convex hull: the set with switching within samples."""
        return self._hull

    @cached_property
    def _hull(self) -> FiniteSet:
        return self if self.duty_cycles else FiniteSet(self.levels, self.costs, duty_cycles=True)

    def at_names(self, names: Sequence[str]) -> FiniteSet:
        if not self.names:
            return self
        place = {index_of_name("FiniteSet.levels", name, names): i for i, name in enumerate(self.names)}
        if len(place) < len(self.names):
            raise ProblemError("FiniteSet.levels", f"{len(self.names)} names", "each component once")
        levels = [self.components[place[i]].stated if i in place else None for i in range(len(names))]
        costs = [self.components[place[i]].costs if i in place else None for i in range(len(names))]
        return FiniteSet(levels, costs, self.duty_cycles)

    def of(self, dimension: int) -> tuple[Levels, ...]:
        """Return the levels of each component, ``dimension`` of them."""
        if self.names:
            got = f"levels by name of {', '.join(map(repr, self.names))}"
            raise ProblemError("FiniteSet", got, "a problem, whose controls have names")
        return self.components * dimension if self.single else self.components

    def points(self, dimension: int) -> Array | None:
        if self.duty_cycles:
            return None
        rows = [values if len(values) else np.array([np.nan]) for values in self.levels_of(dimension)]
        if prod(map(len, rows)) > MOST_POINTS:
            got = f"{prod(map(len, rows))} combinations of levels"
            raise ProblemError("control_set", got, f"at most {MOST_POINTS}: each is a mode")
        return np.array(list(product(*rows)))

    def levels_of(self, dimension: int) -> list[Array]:
        return [component.values for component in self.of(dimension)]

    def costs_of(self, dimension: int) -> list[Array]:
        return [component.costs for component in self.of(dimension)]

    def shares(self, u: Array) -> list[Array]:
        return [component.shares(u[:, i]) for i, component in enumerate(self.of(u.shape[1]))]

    def parts(self, dimension: int) -> tuple[Part, ...]:
        rows = [(i, component.hinges) for i, component in enumerate(self.of(dimension)) if component.costs.any()]
        if not rows:
            return ()
        F = np.vstack([signs[:, None] * np.eye(dimension)[i] for i, (signs, _, _) in rows])
        limits, prices = (np.concatenate([hinges[k] for _, hinges in rows]) for k in (1, 2))
        return (Part(F, np.zeros(len(F)), HalfSpaces(limits, prices)),)

    def relaxed(self, amount: float, dimension: int) -> FiniteSet:
        return self

    def describe(self, names: Sequence[str], signal: str) -> str:
        words = list[str]()
        for name, component in zip(names, self.at_names(names).of(len(names)), strict=True):
            words.append(f"{short_name(name)} {component.describe()}")
        return "; ".join(words) + (", switching within samples" if self.duty_cycles else "")


Stated = Array | Box | Mapping[str, float] | None  # levels or costs of a component; a box or None of one without levels


def _sequences(field: str, stated: object) -> tuple[list[Stated], bool]:
    """Return what is stated of each component, sequences as arrays, and whether one sequence is for all components."""
    expected = "a sequence of numbers, or one sequence for each component"
    if isinstance(stated, str) or not isinstance(stated, (Sequence, np.ndarray)):
        raise ProblemError(field, brief(stated), expected)
    entries = list(stated)
    if not entries:
        raise ProblemError(field, "none", "at least two levels" if field.endswith("levels") else expected)
    free = [entry is None or isinstance(entry, (Box, Mapping)) for entry in entries]
    nested = [isinstance(entry, (Sequence, np.ndarray)) and np.ndim(entry) > 0 for entry in entries]
    if not any(nested) and not any(free):
        return [real_array(field, entries)], True
    if not all(map(or_, nested, free)):
        raise ProblemError(field, brief(stated), expected)
    return [entry if free[i] else real_array(f"{field}[{i}]", entry) for i, entry in enumerate(entries)], False


def _levels(name: str, values: Stated, costs: Stated) -> Levels:
    field = f"FiniteSet.levels{name}"
    if not isinstance(values, np.ndarray):
        return _no_levels(name, values, costs)
    if costs is not None and not isinstance(costs, np.ndarray):
        raise ProblemError(f"FiniteSet.costs{name}", brief(costs), f"one cost for each of {len(values)} levels")
    if values.ndim != 1 or len(values) < 2:
        got = f"shape {values.shape}" if values.ndim != 1 else plural(len(values), "level")
        raise ProblemError(field, got, "at least two levels", "A single value is a Point.")
    order = np.argsort(values)
    increasing = values[order]
    equal = np.flatnonzero(np.diff(increasing) == 0)
    if len(equal):
        raise ProblemError(field, f"{increasing[equal[0]]:g} twice", "levels that all differ")
    price = np.zeros(len(values)) if costs is None else costs
    if price.shape != values.shape:
        expected = f"one cost for each of {len(values)} levels"
        raise ProblemError(f"FiniteSet.costs{name}", f"shape {price.shape}", expected)
    if (price < 0).any():
        advice = "The same amount added to all of them changes no solution."
        raise ProblemError(f"FiniteSet.costs{name}", f"{price.min():g}", "costs of zero or above", advice)
    return Levels(freeze(increasing), freeze(price[order]))


def _no_levels(name: str, stated: Box | Mapping[str, float] | None, costs: Stated) -> NoLevels:
    """Return a component without levels, within a box of one component or the bounds of a mapping."""
    if costs is not None and not (isinstance(costs, np.ndarray) and not costs.any()):
        raise ProblemError(f"FiniteSet.costs{name}", brief(costs), "none, as the component has no levels")
    with located_at(f"FiniteSet.levels{name}", "Box"):
        if isinstance(stated, Mapping):
            known_entries("Box", stated, ("lower", "upper"))
            stated = Box(stated.get("lower"), stated.get("upper"))
        box = (Box() if stated is None else stated).at_dimension(1, "Box")
        if box.lower.ndim > 1:
            raise ProblemError("Box", "bounds over time", "one bound of each side")
        return NoLevels(np.zeros(0), np.zeros(0), Box(box.lower.item(), box.upper.item()))


def cost_unit(problem: OptimalControlProblem) -> tuple[float, float]:
    """Return the unit of which all costs are whole multiples, and their error; 0 unless levels alone have costs.

    The unit is the greatest common divisor of the costs of the levels as they are in double precision. The error is how
    much the envelope may lie below them.
    """
    levels = problem.form.levels
    alone = problem.quadratic.zero and all(term.hard or term.kind == TermKind.CONTROL_SET for term in problem.terms)
    stated = levels.costs_of(problem.control_dim) if levels is not None and alone else ()
    if not stated:
        return 0.0, 0.0
    costs = [Fraction(cost) for row in stated for cost in row.tolist()]
    whole = lcm(*(cost.denominator for cost in costs))
    unit = Fraction(gcd(*(int(cost * whole) for cost in costs)), whole)
    return float(unit), problem.horizon * problem.control_dim * ON_ENVELOPE * float(max(costs))


@dataclass(frozen=True, eq=False, init=False)
class SwitchedDynamics(Dynamics, words="LinearDynamics with levels"):
    """x_{t+1} = A x_t + B u_t + d with u_t one of the points of a set: mode i holds where u_t is point i.

    The regions are single points; no two of them meet.
    """

    dynamics: LinearDynamics
    control_set: ConvexSet
    points: Array  # (modes, m)

    def __init__(self, dynamics: LinearDynamics, control_set: ConvexSet):
        n, m = dynamics.state_dim, dynamics.control_dim
        if control_set.dimension not in (None, m):
            raise ProblemError("control_set", f"levels of {control_set.dimension} components", f"levels of {m}")
        points = control_set.points(m)
        assert points is not None
        labels = signal_labels(n, m, dynamics.sampling_time, dynamics.state_names, dynamics.control_names)
        assign(self, dynamics=dynamics, control_set=control_set, points=points, **labels)

    @property
    def levels(self) -> ConvexSet:
        """Return the control set."""
        return self.control_set

    @property
    def choices(self) -> Array:
        """Return the points of the control set, (modes, m); not a number for a control without levels."""
        return self.points

    @property
    def standard_form(self) -> PiecewiseAffineDynamics:
        """Return the modes, whose regions are u <= point, -u <= -point, for controls with levels."""
        return self._modes

    @cached_property
    def _modes(self) -> PiecewiseAffineDynamics:
        A, B, d = self.dynamics.A, self.dynamics.B, self.dynamics.offset
        at_levels = ~np.isnan(self.points[0])
        sides = np.vstack([np.eye(self.control_dim)[at_levels], -np.eye(self.control_dim)[at_levels]])
        # of all digits: they differ
        numbers = [", ".join(f"{value:.17g}" for value in point) for point in self.points[:, at_levels]]
        short = [short_name(self.control_names[j]) for j in np.flatnonzero(at_levels)]
        named = "u" if at_levels.all() else ", ".join(short)
        names = [f"{named} = {text}" if at_levels.sum() == 1 else f"{named} = ({text})" for text in numbers]
        choices = zip(self.points[:, at_levels], names, strict=True)
        modes = [AffineMode(A, B, d, H=sides, h=np.append(point, -point), name=name) for point, name in choices]
        return PiecewiseAffineDynamics(modes, self.sampling_time, self.state_names, self.control_names)

    def require_sets(self, sets: StageSets) -> None:
        """Accept all sets: regions are single points."""

    def borders(self, sets: StageSets) -> tuple[SwitchingFacet, ...]:
        """Return none."""
        return ()
