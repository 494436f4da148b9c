# ruff: noqa: D102  (a method without a docstring is described by ``ConvexSet``)
"""Controls with finitely many levels, each with its cost, and the dynamics with a mode for each combination of levels.

The convex hull of the pairs (level, cost) of a component is an interval and, as its cost, the lower convex envelope f.
Let l_0 < .. < l_k be the levels that span it, s_j the slope between l_j and l_(j+1), and l_m the level of the least
cost. On the interval, f is a sum of prices for the excess over limits, a soft half space each:

    f(u) = sum_(j >= m) (s_j - s_(j-1)) (u - l_j)+   with 0 for s_(m-1)      what rises to the right of l_m
         + sum_(j <= m) (s_j - s_(j-1)) (l_j - u)+   with 0 for s_m          what rises to the left of l_m
         + f(l_m) / (l_k - l_0) * [(u - l_0)+ + (l_k - u)+]                  the least cost, a constant
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import prod
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, Indices, assign, brief, freeze, real_array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import plural, short_name, vector
from lin_freq_ocp.problem.dynamics.base import Dynamics, signal_labels
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.affine_mode import AffineMode
from lin_freq_ocp.problem.hybrid.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.hybrid.regions import SwitchingFacet
from lin_freq_ocp.problem.sets.base import Bounds, ConvexSet, Part
from lin_freq_ocp.problem.sets.stage_rows import StageSets
from lin_freq_ocp.problem.terms.penalties import HalfSpaces

ON_ENVELOPE = 1e-12  # of the largest cost: a level this far above the line between others counts as on it (rounding)
MOST_POINTS = 256  # combinations of levels of all components: as many as there may be pieces of a piecewise-affine map


@dataclass(frozen=True, eq=False)
class Levels:
    """The levels of one component, rising, and their costs."""

    values: Array  # (levels,)
    costs: Array  # (levels,)

    @cached_property
    def spanning(self) -> list[int]:
        """The levels that span the lower convex envelope, rising."""
        kept = list[int]()
        for j in range(len(self.values)):
            while len(kept) > 1 and not self._bends(kept[-2], kept[-1], j):
                kept.pop()
            kept.append(j)
        return kept

    @property
    def above(self) -> Array:
        """Return by how much each cost is above the envelope, (levels,)."""
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
        """Return the convex weights of the levels, (times, levels): values between two that span the envelope."""
        spanned = self.values[self.spanning]
        after = np.clip(np.searchsorted(spanned, u), 1, len(spanned) - 1)
        part = np.clip((u - spanned[after - 1]) / (spanned[after] - spanned[after - 1]), 0.0, 1.0)
        weights, times, places = np.zeros((len(u), len(self.values))), np.arange(len(u)), np.array(self.spanning)
        weights[times, places[after - 1]] = 1.0 - part
        weights[times, places[after]] += part
        return weights

    def _bends(self, first: int, middle: int, last: int) -> bool:
        """Whether the middle level lies below the line between the others."""
        v, c = self.values, self.costs
        line = c[first] + (c[last] - c[first]) * (v[middle] - v[first]) / (v[last] - v[first])
        return bool(c[middle] < line - ON_ENVELOPE * np.abs(c).max()) or not c.any()


@dataclass(frozen=True, eq=False, init=False)
class FiniteSet(ConvexSet):
    """Controls with finitely many levels: a ``control_set`` for all times.

    Every sample of every component takes one of its levels; a problem with linear dynamics then has a mode for every
    combination of levels, and the search over modes proves its answer. With ``duty_cycles``, components may switch
    between levels within a sample: u_t is the mean over the sample, its cost the mean of the costs, and the problem is
    convex.

    Parameters
    ----------
    levels : sequence of float, or sequence of such sequences
        At least two different levels, in any order, in the unit of the control; one sequence for all components, or
        one for each component.
    costs : of the shape of ``levels``, optional
        What each level adds to the cost J at every sample, zero or above; nothing without.
    duty_cycles : bool
        Whether a component may switch within a sample.

    Raises
    ------
    ProblemError
        If levels are missing, not finite or equal, if costs are of another shape or below zero, or if a cost is above
        the line between those of its neighbours without ``duty_cycles``.

    References
    ----------
    docs/levels.md has the relaxation, its proof, and what holds of it.

    Examples
    --------
    >>> dynamics, on_off = lfo.LinearDynamics([[1.0]], [[1.0]]), lfo.FiniteSet([-1, 0, 1], costs=[1, 0, 1])
    >>> problem = lfo.OptimalControlProblem(dynamics, 4, lfo.QuadraticCost(), on_off, lfo.Box(-9, 9), [0], [2])
    >>> round(lfo.solve(problem).cost, 9)
    2.0
    """

    may_be_soft: ClassVar[bool] = False  # its costs are prices already

    given: tuple[Levels, ...]  # of each component, or one for all
    single: bool  # whether one sequence was given, for all components
    duty_cycles: bool

    def __init__(
        self,
        levels: ArrayLike | Sequence[ArrayLike],
        costs: ArrayLike | Sequence[ArrayLike] | None = None,
        duty_cycles: bool = False,
    ):
        rows, single = _sequences("FiniteSet.levels", levels)
        if not isinstance(duty_cycles, (bool, np.bool_)):
            raise ProblemError("FiniteSet.duty_cycles", brief(duty_cycles), "True or False")
        priced = [None] * len(rows)
        if costs is not None:
            priced, flat = _sequences("FiniteSet.costs", costs)
            if flat != single or len(priced) != len(rows):
                got = "one sequence" if flat else plural(len(priced), "sequence")
                raise ProblemError("FiniteSet.costs", got, "costs of the shape of levels")
        names = ["" if single else f"[{i}]" for i in range(len(rows))]
        found = tuple(_levels(*one) for one in zip(names, rows, priced, strict=True))
        assign(self, given=found, single=single, duty_cycles=bool(duty_cycles))
        for name, one in zip(names, found, strict=True):
            if not duty_cycles and one.above.any():
                j = int(np.argmax(one.above))
                got = (
                    f"{one.costs[j]:g} for the level {one.values[j]:g}, {one.above[j]:g} above the line between others"
                )
                advice = (
                    "With duty_cycles=True such a level is never used; search over whole levels needs convex costs."
                )
                raise ProblemError(f"FiniteSet.costs{name}", got, "costs that lie on a convex curve", advice)

    @property
    def levels(self) -> list[list[float]] | list[float]:
        """Return the levels, rising, as lists."""
        rows = [one.values.tolist() for one in self.given]
        return rows[0] if self.single else rows

    @property
    def costs(self) -> list[list[float]] | list[float] | None:
        """Return the costs of the levels, as lists; None without any."""
        rows = [one.costs.tolist() for one in self.given]
        free = not any(one.costs.any() for one in self.given)
        return None if free else rows[0] if self.single else rows

    @property
    def dimension(self) -> int | None:
        return None if self.single else len(self.given)

    @property
    def bounds(self) -> Bounds:
        ends = np.array([[one.values[0], one.values[-1]] for one in self.given]).T
        lower, upper = ends[:, 0] if self.single else ends
        return freeze(np.asarray(lower)), freeze(np.asarray(upper))

    @property
    def hull(self) -> FiniteSet:
        """Return the set with switching within samples."""
        return self._hull

    @cached_property
    def _hull(self) -> FiniteSet:
        return self if self.duty_cycles else FiniteSet(self.levels, self.costs, duty_cycles=True)

    def of(self, dimension: int) -> tuple[Levels, ...]:
        """Return the levels of each of so many components."""
        return self.given * dimension if self.single else self.given

    def points(self, dimension: int) -> Array | None:
        if self.duty_cycles:
            return None
        rows = self.levels_of(dimension)
        if prod(map(len, rows)) > MOST_POINTS:
            got = f"{prod(map(len, rows))} combinations of levels"
            raise ProblemError("control_set", got, f"at most {MOST_POINTS}: each is a mode")
        return np.array(list(product(*rows)))

    def levels_of(self, dimension: int) -> list[Array]:
        return [one.values for one in self.of(dimension)]

    def shares(self, u: Array) -> list[Array]:
        return [one.shares(u[:, i]) for i, one in enumerate(self.of(u.shape[1]))]

    def parts(self, dimension: int) -> tuple[Part, ...]:
        rows = [(i, one.hinges) for i, one in enumerate(self.of(dimension)) if one.costs.any()]
        if not rows:
            return ()
        F = np.vstack([signs[:, None] * np.eye(dimension)[i] for i, (signs, _, _) in rows])
        limits, prices = (np.concatenate([hinges[k] for _, hinges in rows]) for k in (1, 2))
        return (Part(F, np.zeros(len(F)), HalfSpaces(limits, prices)),)

    def relaxed(self, amount: float, dimension: int) -> FiniteSet:
        return self

    def describe(self, names: Sequence[str], signal: str) -> str:
        words = list[str]()
        for name, one in zip(names, self.of(len(names)), strict=True):
            costs = f" at the costs {vector(one.costs)}" if one.costs.any() else ""
            words.append(f"{short_name(name)} in {vector(one.values)}{costs}")
        return "; ".join(words) + (", switching within samples" if self.duty_cycles else "")


def _sequences(field: str, given: object) -> tuple[list[Array], bool]:
    """Return arrays of numbers, and whether one sequence was given instead of one for each component."""
    expected = "a sequence of numbers, or one sequence for each component"
    if isinstance(given, str) or not isinstance(given, (Sequence, np.ndarray)):
        raise ProblemError(field, brief(given), expected)
    entries = list(given)
    if not entries:
        raise ProblemError(field, "none", "at least two levels" if field.endswith("levels") else expected)
    nested = [isinstance(entry, (Sequence, np.ndarray)) and np.ndim(entry) > 0 for entry in entries]
    if any(nested) and not all(nested):
        raise ProblemError(field, brief(given), expected)
    rows = [real_array(f"{field}[{i}]", entry) for i, entry in enumerate(entries)] if all(nested) else []
    return (rows, False) if rows else ([real_array(field, entries)], True)


def _levels(name: str, values: Array, costs: Array | None) -> Levels:
    field = f"FiniteSet.levels{name}"
    if values.ndim != 1 or len(values) < 2:
        got = f"shape {values.shape}" if values.ndim != 1 else plural(len(values), "level")
        raise ProblemError(field, got, "at least two levels", "A single value is a Point.")
    order = np.argsort(values)
    rising = values[order]
    equal = np.flatnonzero(np.diff(rising) == 0)
    if len(equal):
        raise ProblemError(field, f"{rising[equal[0]]:g} twice", "levels that all differ")
    price = np.zeros(len(values)) if costs is None else costs
    if price.shape != values.shape:
        raise ProblemError(
            f"FiniteSet.costs{name}", f"shape {price.shape}", f"one cost for each of {len(values)} levels"
        )
    if (price < 0).any():
        advice = "The same amount added to all of them changes no solution."
        raise ProblemError(f"FiniteSet.costs{name}", f"{price.min():g}", "costs of zero or above", advice)
    return Levels(freeze(rising), freeze(price[order]))


@dataclass(frozen=True, eq=False, init=False)
class SwitchedDynamics(Dynamics):
    """x_{t+1} = A x_t + B u_t + d with u_t one of the points of a set: mode i is where u_t is point i.

    Regions need not cover anything, and meet nowhere.
    """

    dynamics: LinearDynamics
    control_set: ConvexSet
    choices: Array  # (modes, m)

    def __init__(self, dynamics: LinearDynamics, control_set: ConvexSet):
        n, m = dynamics.state_dim, dynamics.control_dim
        if control_set.dimension not in (None, m):
            raise ProblemError("control_set", f"levels of {control_set.dimension} components", f"levels of {m}")
        choices = control_set.points(m)
        assert choices is not None
        labels = signal_labels(n, m, dynamics.sampling_time, dynamics.state_names, dynamics.control_names)
        assign(self, dynamics=dynamics, control_set=control_set, choices=choices, **labels)

    @property
    def standard_form(self) -> PiecewiseAffineDynamics:
        """Return the modes, whose regions are u <= point, -u <= -point."""
        return self._modes

    @cached_property
    def _modes(self) -> PiecewiseAffineDynamics:
        A, B, d = self.dynamics.A, self.dynamics.B, self.dynamics.offset
        sides = np.vstack([np.eye(self.control_dim), -np.eye(self.control_dim)])
        modes = [AffineMode(A, B, d, H=sides, h=sides @ point, name=f"u = {_text(point)}") for point in self.choices]
        return PiecewiseAffineDynamics(modes, self.sampling_time, self.state_names, self.control_names)

    @property
    def given(self) -> tuple[Dynamics, ConvexSet | None]:
        """Return the dynamics and the control set that it was made of."""
        return self.dynamics, self.control_set

    def facts(self, labels: Sequence[str]) -> list[tuple[str, str]]:
        """Return that every point of the control set is a mode."""
        words = f"{self.control_set.describe(self.control_names, 'u')}; {plural(len(self.choices), 'mode')}"
        return [*self.dynamics.facts(labels), ("levels", words)]

    def require_sets(self, sets: StageSets) -> None:
        """Accept all sets: regions are single points."""

    def borders(self, sets: StageSets) -> tuple[SwitchingFacet, ...]:
        """Return none."""
        return ()

    @property
    def level_sizes(self) -> Array:
        """Return the largest absolute level of each control, (m,)."""
        return np.abs(self.choices).max(axis=0)

    def controls_of(self, sequence: Indices) -> Array:
        """Return the controls of a mode sequence, (T, m)."""
        return self.choices[sequence]

    def translated(self, origin: Array) -> SwitchedDynamics:
        """Return the dynamics of x - origin, with the same levels."""
        return SwitchedDynamics(self.dynamics.translated(origin), self.control_set)

    def augmented(self, A: Array, B: Array, names: Sequence[str], horizon: int) -> SwitchedDynamics:
        """Return the dynamics of (x, w) with w_{t+1} = A w_t + B u_t."""
        return SwitchedDynamics(self.dynamics.augmented(A, B, names, horizon), self.control_set)


def _text(point: Array) -> str:
    """Return "1" or "(1, 0)", different for different points."""
    numbers = ", ".join(f"{value:.17g}" for value in point)
    return numbers if len(point) == 1 else f"({numbers})"
