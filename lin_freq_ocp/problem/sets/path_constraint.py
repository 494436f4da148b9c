"""Path constraints h(t, x_t, u_t) <= upper by formulas (paper, (DTOCPNSD-a)), which need not be convex.

At a trajectory, a path constraint is to first order a family of joint rows: h and the slopes of h at every time.
Solvers and the judge take these rows, so that grad h with a multiplier mu >= 0 counts as that of a joint row does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import (
    Array,
    Indices,
    Mask,
    assign,
    brief,
    positive_number,
    printable,
    require_bool,
    require_rows_hold,
    times_vectors,
    upper_limits,
)
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.phrases import AT_MOST, MOST_TEXT, number, plural, price
from lin_freq_ocp.formulas.jets import Jets, interval_jets, jets_of, values_of
from lin_freq_ocp.formulas.nodes import (
    Formula,
    evaluate,
    kinks,
    nodes_in_order,
    rebuild,
    require_times,
    text_of,
    translate_formulas,
    with_states,
)
from lin_freq_ocp.formulas.operations import MAXIMUM, MINIMUM, SUM, TIME, VARIABLE
from lin_freq_ocp.formulas.text import Formulas, formula_from_text, listed_formulas, read_definitions
from lin_freq_ocp.problem.sets.box import END_TOLERANCE
from lin_freq_ocp.problem.sets.stage_rows import UNNAMED, StageRows
from lin_freq_ocp.problem.terms.maps import AffineMap, Shapes, StageMap
from lin_freq_ocp.problem.terms.penalties import HalfSpaces
from lin_freq_ocp.problem.terms.penalty import weight_of
from lin_freq_ocp.problem.terms.term import Term, TermKind

EIGENVALUE_ROUNDING = 1e-12  # of a Hessian, relative to its largest eigenvalue


@dataclass(frozen=True, eq=False, init=False)
class PathConstraint(StageRows):
    """h(t, x_t, u_t) <= upper, component by component, by formulas that need not be convex.

    It holds for t < T, and without controls also for x_T. Solvers get the exact first and second derivatives.
    Dynamics are linear or piecewise smooth.

    Parameters
    ----------
    h : Formula, str, list of them, function or DifferentiableFunction
        Formulas of signals, their texts, or a function of (x, u) or (t, x, u) that returns them when it is called with
        signals. A maximum of smooth formulas is several components; other kinks than norms are refused.
    name : str
        In messages, and of the multipliers.
    upper : number, (components,), (T, components) or (T + 1, components)
        Upper limits, in the units of h; inf for no limit. The last of T + 1 is for x_T.
    price : float, optional
        Makes the constraint soft: the cost has price times max(h - upper, 0) of each component.
    convex : bool
        Declares that h is convex in (x, u) where that cannot be proven: bounds that rest on it are not rigorous.
    let : table of str, optional
        Named formulas that the texts may use; each may use those before it.

    Raises
    ------
    ProblemError
        If a limit or the price is no number; in a problem, if h is no formula, has other kinks, or does not fit it.

    Examples
    --------
    >>> disc = lfo.sets.PathConstraint("1 - x_0**2 - x_1**2", name="outside a disc")
    >>> disc.name
    'outside a disc'
    """

    h: object  # tuple of Formula in a problem
    convex: bool
    let: object

    def __init__(
        self,
        h: Formulas,
        name: str = UNNAMED[1],
        upper: ArrayLike = 0.0,
        price: float | None = None,
        convex: bool = False,
        let: Mapping[str, str] | None = None,
    ):
        printable("stage_rows.name", name, empty="")
        require_bool("stage_rows.convex", convex)
        limits = upper_limits("stage_rows.upper", upper)
        if limits.ndim > 2 or not limits.size:
            expected = "a number, one for each component, or (T, components)"
            raise ProblemError("stage_rows.upper", f"shape {limits.shape}", expected)
        soft = None if price is None else positive_number("stage_rows.price", price)
        none = np.zeros((limits.shape[-1] if limits.ndim else 1, 0))
        assign(self, C=none, D=none, e=limits, name=name, penalty=soft, h=h, convex=convex, let=let)

    @property
    def price(self) -> float | None:
        """Return the price per unit of violation; None for a hard constraint."""
        return self.penalty

    @property
    def formulas(self) -> tuple[Formula, ...]:
        """Return the components of h, in a problem."""
        return self.h if isinstance(self.h, tuple) else ()

    def at_dimensions(self, n: int, m: int, horizon: int, field: str) -> PathConstraint:
        """Return the constraint with formulas of n states and m controls, checked; errors name the field."""
        known = read_definitions(f"{field}.let", {} if self.let is None else self.let, (n, m))
        listed = [self.h] if isinstance(self.h, (str, Formula)) else self.h
        if isinstance(listed, (list, tuple)):
            listed = [
                formula_from_text(f"{field}.h[{i}]", one, (n, m), known) if isinstance(one, str) else one
                for i, one in enumerate(listed)
            ]
        given = listed_formulas(f"{field}.h", listed, (n, m))
        limits = np.broadcast_to(self.e, (len(given),)) if self.e.ndim == 0 else self.e
        if not given or limits.shape[-1] != len(given):
            got = f"{plural(len(given), 'formula')} and {plural(limits.shape[-1], 'limit')}"
            raise ProblemError(f"{field}.h", got, "at least one formula, and as many limits")
        parts = [smooth_parts(f"{field}.h", formula) for formula in given]
        formulas = tuple(part for one in parts for part in one)
        groups = horizon + _of_states(formulas)
        if limits.ndim == 2 and len(limits) not in (horizon, groups):
            expected = f"one for each of the {horizon} steps" + (f", or {groups} with x_T" if groups > horizon else "")
            raise ProblemError(f"{field}.upper", f"limits for {len(limits)} times", expected)
        require_times(f"{field}.h", formulas, groups)
        fixed = np.array([-np.inf if one.constant is None else one.constant for one in given])
        require_rows_hold(f"{field}.upper", fixed > limits, limits)
        limits = np.repeat(limits, [len(one) for one in parts], axis=-1)
        complete = PathConstraint(formulas, self.name, limits, self.penalty, self.convex)
        assign(complete, C=np.zeros((len(formulas), n)), D=np.zeros((len(formulas), m)), h=formulas)
        complete.__dict__["map"] = FormulaMap(formulas, np.arange(groups))
        return complete

    @cached_property
    def map(self) -> FormulaMap:
        """The map from a trajectory to h at all times; in a problem."""
        raise ProblemError("stage_rows", f"{self.name!r} outside of a problem", "problem.stage_rows, which is complete")

    @property
    def used(self) -> Mask:
        """Return which states and controls each component has, (components, n + m)."""
        used = np.zeros((self.rows, self.C.shape[1] + self.D.shape[1]), dtype=bool)
        for i, formula in enumerate(self.formulas):
            used[i, [int(node.data[0]) for node in kinks([formula], VARIABLE)]] = True
        return used

    def limits(self) -> Array:
        """Return the limits of all times, (groups, components); inf at x_T if none are given there."""
        groups, missing = self.map.shape, np.full((1, self.rows), np.inf)
        if self.e.ndim == 1:
            return np.broadcast_to(self.e, groups)
        return self.e if len(self.e) == groups[0] else np.vstack([self.e, missing])

    def values(self, x: Array, u: Array) -> Array:
        """Return h of every time, (T, components), and of x_T without controls."""
        return self.map.values(x, u)

    @property
    def is_steady(self) -> bool:
        """Whether formulas and limits are the same at all times but the last."""
        limits = self.limits()[:-1]  # x_T may have none
        return bool((limits == limits[:1]).all()) and next(kinks(self.formulas, TIME), None) is None

    def slack(self, x: Array, u: Array) -> Array:
        """Return upper - h: negative where a component is violated, inf without a limit."""
        return self.limits() - self.values(x, u)

    def sizes(self, x: Array, u: Array) -> Array:
        """Return rough sizes of the components, for states within x (n,) and controls within u (m,)."""
        y = np.append(x, u)
        return np.nan_to_num(np.abs(jets_of(self.formulas, np.stack([y, -y])).slopes) @ y).max(0)

    def term(self, horizon: int) -> Term:
        """Return the term, whose values are those of h."""
        return Term(self.name, TermKind.STAGE_ROWS, self.map, HalfSpaces(self.limits(), weight_of(self.penalty)))

    def linearised(self, x: Array, u: Array) -> TangentRows:
        """Return h to first order along a trajectory, as rows; ProblemError where h or its slopes are no numbers.

        Values of h are the least that their enclosures allow: rounding inside of a formula violates nothing.
        """
        at, groups = self.map.jets_along(x, u), self.map.times
        for t, i in np.argwhere(~(np.isfinite(at.values) & np.isfinite(at.slopes).all(axis=2)))[:1]:
            got = f"{at.values[t, i]:g} and slopes {brief(at.slopes[t, i].tolist())} at t = {t}"
            expected = "finite numbers along the trajectory"
            raise ProblemError(f"{self.name!r}, component {i}", got, expected, "Constrain its arguments by a set.")
        C, D = np.split(at.slopes, [self.C.shape[1]], axis=2)
        y = self.map.signals(x, u)
        enclosed = least_values(self.formulas, y, y, groups)
        e = self.limits() - np.where(np.isfinite(enclosed), enclosed, at.values) + times_vectors(at.slopes, y)
        return TangentRows(C, D[: len(u)], e, self.name, self.penalty)

    def excludes(self, t: int, x: Array) -> bool:
        """Whether the constraint is hard and no control satisfies it at a time near a state, (n,), by enclosures."""
        if self.hard_part is None or len(self.map.times) <= t or self.used[:, self.C.shape[1] :].any():
            return False
        y = np.append(x, np.zeros(self.D.shape[1]))[None]
        near, limits = END_TOLERANCE * np.abs(y), self.limits()[t]
        least = least_values(self.formulas, y - near, y + near, t)[0]
        return bool((least > limits + END_TOLERANCE * np.abs(limits)).any())

    def bends_down(self, x: Array, u: Array) -> bool:
        """Whether a Hessian of h along a trajectory has an eigenvalue below zero: h is not convex."""
        values = np.linalg.eigvalsh(np.nan_to_num(self.map.jets_along(x, u).curvatures))
        return bool((values[..., 0] < -EIGENVALUE_ROUNDING * np.abs(values).max(axis=-1)).any())

    def pattern(self, x: Array, u: Array, sizes: tuple[Array, Array]) -> TangentRows:
        """Return rows that hold along a trajectory, with coefficients wherever h may have slopes near it.

        ``sizes`` are those of states (n,) and controls (m,): h changes by so much within them, at most.
        """
        at, units = self.map.jets_along(x, u), np.concatenate(sizes)
        steep = np.abs(at.slopes) + np.abs(at.curvatures) @ units
        steepest = np.nan_to_num(steep, nan=0.0, posinf=0.0).max(axis=0)
        largest = (steepest * units).max(axis=1, keepdims=True)
        rows = np.where(self.used & (steepest == 0), np.where(largest > 0, largest, 1.0) / units, steepest)
        groups = len(self.map.times)
        C, D = (np.broadcast_to(part, (groups, *part.shape)) for part in np.split(rows, [x.shape[1]], axis=1))
        tangents = TangentRows(C, D[: len(u)], self.limits(), self.name, self.penalty)
        return tangents.with_limits(np.where(np.isfinite(tangents.e), tangents.values(x, u), np.inf))

    def translated(self, origin: Array) -> PathConstraint:
        """Return the constraint on x - origin, origin (n,)."""
        return self._replace_parts(translate_formulas(self.formulas, origin))

    def augmented(self, n: int, k: int) -> PathConstraint:
        """Return the constraint on (x, w), w in R^k."""
        return self._replace_parts(with_states(self.formulas, k))

    def with_limits(self, e: Array) -> PathConstraint:
        """Return the constraint with other limits."""
        return self._replace_parts(self.formulas, limits=e)

    def free_first_state(self, horizon: int) -> PathConstraint:
        """Return the constraint without limits on the state alone at time 0."""
        limits = self.limits().copy()
        limits[0, ~self.used[:, self.C.shape[1] :].any(axis=1)] = np.inf
        return self.with_limits(limits)

    def softened(self, penalty: float) -> PathConstraint:
        """Return the constraint with a price per unit of violation, unless it has one already."""
        return self if self.penalty is not None else self._replace_parts(self.formulas, penalty)

    def describe(self, names: Sequence[str]) -> str:
        """Return the components as inequalities; names of states, then of controls."""
        limits = self.e if self.e.ndim == 1 else [np.nan] * self.rows
        texts = [
            f"{text_of(one, names)} {AT_MOST} {'limits over time' if np.isnan(limit) else number(float(limit))}"
            for one, limit in zip(self.formulas, limits, strict=True)
        ]
        text = ", ".join(texts)
        text = text if len(text) <= MOST_TEXT else f"{texts[0]} and {plural(len(texts) - 1, 'more')}"
        return f"{text}{price(self.penalty, 'excess of a component')}"

    def _replace_parts(
        self, formulas: Sequence[Formula], penalty: float | None = None, limits: Array | None = None
    ) -> PathConstraint:
        soft = self.penalty if penalty is None else penalty
        changed = PathConstraint(list(formulas), self.name, self.e if limits is None else limits, soft, self.convex)
        (n, m), horizon = formulas[0].dimensions, len(self.map.times) - _of_states(formulas)
        return changed.at_dimensions(n, m, horizon, "stage_rows")


@dataclass(frozen=True, eq=False)
class TangentRows(StageRows):
    """A path constraint to first order along a trajectory: rows C_t x_t + D_t u_t <= e_t, if D is zero also for x_T."""

    def at_dimensions(self, n: int, m: int, horizon: int, field: str) -> TangentRows:
        """Return the rows, which are complete."""
        return self

    def with_limits(self, e: Array) -> TangentRows:
        """Return the rows with other limits."""
        return TangentRows(self.C, self.D, e, self.name, self.penalty)

    def values(self, x: Array, u: Array) -> Array:
        """Return C_t x_t + D_t u_t of every time that has rows."""
        return self._map.values(x, u)

    def term(self, horizon: int) -> Term:
        """Return the term of the rows."""
        return Term(self.name, TermKind.STAGE_ROWS, self._map, HalfSpaces(self.e, weight_of(self.penalty)))

    def sizes_along(self, x: Array, u: Array) -> Array:
        """Return the sums of the absolute values of the terms of each row and its limit, (groups, rows)."""
        return self._map.sizes(x, u) + np.where(np.isfinite(self.e), np.abs(self.e), 0.0)

    @property
    def _map(self) -> StageMap:
        of_states = len(self.C) > len(self.D)
        return StageMap(np.arange(len(self.C)), self.C, None if of_states else self.D, np.zeros(self.rows))


@dataclass(frozen=True, eq=False)
class FormulaMap(AffineMap):
    """The values of formulas along a trajectory, which are not affine: rows are those of a linearisation."""

    formulas: tuple[Formula, ...]
    times: Indices  # (groups,): 0 .. T of formulas of states, else 0 .. T-1

    @property
    def shape(self) -> tuple[int, int]:
        """Return (groups, components)."""
        return len(self.times), len(self.formulas)

    @property
    def positions(self) -> Indices:
        """Return the times."""
        return self.times

    @property
    def additions(self) -> float:
        """Return the number of operations."""
        return float(len(nodes_in_order(self.formulas)))

    def signals(self, x: Array, u: Array) -> Array:
        """Return (x_t, u_t) at the times, (groups, n + m), with zeros for u_T."""
        controls = np.pad(u, ((0, len(self.times) - len(u)), (0, 0)))
        return np.hstack([x[self.times], controls]).astype(np.float64)

    def jets_along(self, x: Array, u: Array) -> Jets:
        """Return the formulas with derivatives along a trajectory."""
        return jets_of(self.formulas, self.signals(x, u), times=self.times)

    def form_at_origin(self, n: int, m: int) -> tuple[Array, Array] | None:
        """Return slopes and values at the origin, the least that enclosures allow; None where they are no numbers."""
        origin = np.zeros((len(self.times), n + m))
        at, least = (
            jets_of(self.formulas, origin, times=self.times),
            least_values(self.formulas, origin, origin, self.times),
        )
        form = at.slopes, np.where(np.isfinite(least), least, at.values)
        return form if all(np.isfinite(part).all() for part in form) else None

    def values(self, x: Array, u: Array) -> Array:
        """Return the values, (groups, components)."""
        return values_of(self.formulas, self.signals(x, u), self.times)

    def sizes(self, x: Array, u: Array) -> Array:
        """Return the slopes times the signals."""
        y = self.signals(x, u)
        return np.einsum("tij,tj->ti", np.abs(self.jets_along(x, u).slopes), np.abs(y))

    def pull_back(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        """Raise UnsupportedError: there is no adjoint."""
        raise self._unfit_error()

    def rows(self, horizon: int, n: int, m: int) -> tuple[sp.csr_array, Array]:
        """Raise UnsupportedError: there are no rows."""
        raise self._unfit_error()

    def pulled_sizes(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        """Raise UnsupportedError: there is no adjoint."""
        raise self._unfit_error()

    def _unfit_error(self) -> UnsupportedError:
        text = brief(text_of(self.formulas[0]))
        return UnsupportedError(f"stage_rows: got the path constraint {text} {AT_MOST} ...; expected linear rows.")


def least_values(formulas: Sequence[Formula], lower: Array, upper: Array, times: int | Indices) -> Array:
    """Return lower bounds of formulas over boxes at times, (boxes, formulas); -inf of functions without enclosures."""
    try:
        return interval_jets(formulas, lower, upper, curved=False, time=times).values[0]
    except UnsupportedError:
        return np.full((len(lower), len(formulas)), -np.inf)


def path_constraints(rows: Sequence[StageRows]) -> tuple[PathConstraint, ...]:
    """Return the path constraints among families of joint rows."""
    return tuple(family for family in rows if isinstance(family, PathConstraint))


def _of_states(formulas: Sequence[Formula]) -> bool:
    """Whether no control is in formulas."""
    return not any(node.data[0] >= node.dimensions[0] for node in kinks(formulas, VARIABLE))


def smooth_parts(field: str, formula: Formula) -> list[Formula]:
    """Return smooth formulas that are at most a number if and only if the formula is: the arguments of its maxima."""

    def parts_of(node: Formula, parts: list[list[Formula]]) -> list[Formula]:
        if node.kind == MAXIMUM:
            return [one for part in parts for one in part]
        split = [i for i, part in enumerate(parts) if len(part) > 1]
        falls = node.kind != SUM or any(node.data[i] < 0 for i in split)
        if node.kind == MINIMUM or (split and falls):
            advice = "max(a, b) <= 0 is a <= 0 and b <= 0; a minimum is a choice: state one of its arguments at a time."
            expected = "smooth formulas, norms, and sums of maxima of them"
            raise ProblemError(field, f"a kink, {brief(text_of(node))}", expected, advice)
        kinked, choices = [node.arguments[i] for i in split], product(*(parts[i] for i in split))
        return [rebuild([node], dict(zip(kinked, choice, strict=True)))[0] for choice in choices]

    return evaluate([formula], parts_of)[0]
