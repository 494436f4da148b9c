"""Sets of the pairs (x_t, u_t) of a step, t = 0 .. T-1: joint rows, and the polyhedral part of all sets of a problem.

``StageRows`` are joint rows C x_t + D u_t <= e_t of a user. ``StageSets`` are the bounds and rows of all sets of a
problem, of one time or around all times; switching boundaries and lower bounds are computed over them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import (
    Array,
    Mask,
    assign,
    brief,
    positive_number,
    printable,
    real_array,
    require_rows_hold,
    times_vectors,
    to_shape,
    upper_limits,
    with_columns,
    with_fields,
    with_products,
)
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import AT_MOST, inequalities, plural, price
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.terms.maps import StageMap
from lin_freq_ocp.problem.terms.penalties import HalfSpaces
from lin_freq_ocp.problem.terms.penalty import weight_of
from lin_freq_ocp.problem.terms.term import LinearRows, Term, TermKind

UNNAMED = "stage rows", "path constraint"  # names of families that are given none


@dataclass(frozen=True, eq=False, init=False)
class StageRows:
    """C_t x_t + D_t u_t <= e_t, row by row, for t < T (x_T has no control, and no rows).

    Parameters
    ----------
    C : (rows, n), (T, rows, n), or None
        Coefficients of the state, or one matrix per time; None for zeros.
    D : (rows, m), (T, rows, m), or None
        Coefficients of the control; at least one of C and D is given.
    e : (rows,) or (T, rows)
        Upper limits, required; inf, or 1e20 and above, for no limit of a row at that time.
    name : str
        The name of the rows in messages and of their multipliers. A problem numbers several rows without a name.
    penalty : float, optional
        Makes the rows soft: penalty times the violation of each row is added to the cost.

    Raises
    ------
    ProblemError
        If shapes do not match, entries are not numbers, or neither C nor D is given.

    Notes
    -----
    A matrix that was not given has no columns until a problem completes it.

    Examples
    --------
    >>> rows = lfo.StageRows(C=[[1.0, 0.0]], D=[[1.0]], e=[2.0])
    >>> rows.name
    'stage rows'

    Methods
    -------
    values(x, u)
        C_t x_t + D_t u_t of every time.
    slack(x, u)
        Limit less value of each row.
    violation(x, u)
        Violation of each row.
    """

    C: Array
    D: Array
    e: Array
    name: str
    penalty: float | None

    def __init__(
        self,
        C: ArrayLike | None = None,
        D: ArrayLike | None = None,
        e: ArrayLike | None = None,
        name: str = UNNAMED[0],
        penalty: float | None = None,
    ):
        printable("stage_rows.name", name, empty="")
        limits = upper_limits("stage_rows.e", () if e is None else e)
        if limits.ndim not in (1, 2) or limits.shape[-1] == 0:
            got = "nothing" if e is None else f"shape {limits.shape}"
            raise ProblemError("stage_rows.e", got, "one limit per row, or (T, rows)")
        rows = limits.shape[-1]
        soft = None if penalty is None else positive_number("stage_rows.penalty", penalty)
        assign(self, C=_matrix("C", C, rows), D=_matrix("D", D, rows), e=limits, name=name, penalty=soft)
        if not self.C.shape[-1] and not self.D.shape[-1]:
            raise ProblemError("stage_rows", "neither C nor D", "at least one of them")

    def at_dimensions(self, n: int, m: int, horizon: int, field: str) -> StageRows:
        """Return the same rows with both matrices, checked against n states, m controls and T = ``horizon``."""
        if self.e.ndim == 2 and len(self.e) != horizon:
            expected = f"one for each of the {horizon} steps of the horizon"
            raise ProblemError(f"{field}.e", f"limits for {len(self.e)} times", expected)
        rows = self.e.shape[-1]
        C = to_shape(f"{field}.C", self.C if self.C.shape[-1] else np.zeros((rows, n)), (rows, n), horizon)
        D = to_shape(f"{field}.D", self.D if self.D.shape[-1] else np.zeros((rows, m)), (rows, m), horizon)
        complete = StageRows(C, D, self.e, self.name, self.penalty)
        require_rows_hold(f"{field}.e", complete._empty & (self.e < 0), self.e)
        return complete

    def translated(self, origin: Array) -> StageRows:
        """Return the rows of x - origin, origin (n,)."""
        return self.with_limits(with_products(self.e, (-self.C, origin)))

    def augmented(self, n: int, k: int) -> StageRows:
        """Return the rows on (x, w), w in R^k, for x in R^n."""
        return type(self)(with_columns(self.C, k), self.D, self.e, self.name, self.penalty)

    def linearised(self, x: Array, u: Array) -> StageRows:
        """Return the rows, which are linear; a path constraint to first order along a trajectory."""
        return self

    def term(self, horizon: int) -> Term:
        """Return the term of the rows."""
        rows = StageMap(np.arange(horizon), self.C, self.D, np.zeros(self.rows))
        limits = np.where(self.bounded(horizon), self.e, np.inf)
        return Term(self.name, TermKind.STAGE_ROWS, rows, HalfSpaces(limits, weight_of(self.penalty)))

    def pattern(self, x: Array, u: Array, sizes: tuple[Array, Array]) -> StageRows:
        """Return the rows, which are linear; of a path constraint, rows with all its coefficients and of its sizes."""
        return self

    def with_limits(self, e: Array) -> StageRows:
        """Return the rows with other limits, (rows,) or (T, rows)."""
        return StageRows(self.C, self.D, e, self.name, self.penalty)

    def free_first_state(self, horizon: int) -> StageRows:
        """Return the rows without limits on the state alone at time 0."""
        limits = np.array(np.broadcast_to(self.e, (horizon, self.rows)))
        limits[0, ~np.broadcast_to(self.D, (horizon, *self.D.shape[-2:]))[0].any(axis=-1)] = np.inf
        return self.with_limits(limits)

    def softened(self, penalty: float) -> StageRows:
        """Return the rows with a price per unit of violation, unless they have one already."""
        return self if self.penalty is not None else StageRows(self.C, self.D, self.e, self.name, penalty)

    @property
    def hard_part(self) -> StageRows | None:
        """Return the rows if they are hard, else None."""
        return self if self.penalty is None else None

    @property
    def rows(self) -> int:
        """Return the number of rows."""
        return self.e.shape[-1]

    @property
    def time_varying(self) -> bool:
        """Whether C or D depends on time."""
        return self.C.ndim == 3 or self.D.ndim == 3

    def bounded(self, horizon: int) -> Mask:
        """Return whether each row has a finite limit and a coefficient, (T, rows)."""
        return np.broadcast_to(np.isfinite(self.e) & ~self._empty, (horizon, self.rows))

    def values(self, x: Array, u: Array) -> Array:
        """Return C_t x_t + D_t u_t, shape (T, rows); x is (T+1, n) or (T, n), u is (T, m)."""
        return times_vectors(self.C, x[: len(u)]) + times_vectors(self.D, u)

    def slack(self, x: Array, u: Array) -> Array:
        """Return e_t - C_t x_t - D_t u_t, shape (T, rows): negative where a row is violated, inf without a limit."""
        return self.e - self.values(x, u)

    def violation(self, x: Array, u: Array) -> Array:
        """Return the violation of each row (0 if it holds), shape (T, rows)."""
        return np.maximum(-self.slack(x, u), 0.0)

    def describe(self, names: Sequence[str]) -> str:
        """Return a few rows as inequalities, of more rows their number; names of states, then of controls."""
        symbols = f"C x + D u {AT_MOST} e"
        if self.time_varying or (self.e.ndim == 2 and (self.e != self.e[0]).any()):
            text = f"{plural(self.rows, 'row')} {symbols}, which depend on time"
        else:
            limits = self.e if self.e.ndim == 1 else self.e[0]
            coefficients = [matrix if matrix.ndim == 2 else matrix[0] for matrix in (self.C, self.D)]
            text = inequalities(np.hstack(coefficients), limits, names, symbols)
        return f"{text}{price(self.penalty, 'excess of a row')}"

    def sizes(self, x: Array, u: Array) -> Array:
        """Return the largest value of each row, (rows,), for states within x (n,) and controls within u (m,)."""
        return (np.abs(self.C) @ x).reshape(-1, self.rows).max(0) + (np.abs(self.D) @ u).reshape(-1, self.rows).max(0)

    @property
    def _empty(self) -> Mask:
        """Whether each row has no coefficient, (rows,) or (T, rows)."""
        return np.asarray(~(self.C.any(axis=-1) | self.D.any(axis=-1)))


def row_families(given: StageRows | Sequence[StageRows] | None, n: int, m: int, horizon: int) -> tuple[StageRows, ...]:
    """Return all families of joint rows, completed; ProblemError if two share a name."""
    if given is None:
        return ()
    if isinstance(given, StageRows):
        return (given.at_dimensions(n, m, horizon, "stage_rows"),)
    if not isinstance(given, Sequence) or not all(isinstance(rows, StageRows) for rows in given):
        raise ProblemError("stage_rows", brief(given), "StageRows, PathConstraint, a sequence of them, or None")
    own = [rows.name for rows in given]
    names = [
        f"{name} {own[: i + 1].count(name)}" if name in UNNAMED and own.count(name) > 1 else name
        for i, name in enumerate(own)
    ]
    if len(set(names)) != len(names):
        raise ProblemError("stage_rows", f"the names {brief(names)}", "a different name for each", "Give name=.")
    named = (with_fields(rows, name=name) for name, rows in zip(names, given, strict=True))
    return tuple(rows.at_dimensions(n, m, horizon, f"stage_rows[{i}]") for i, rows in enumerate(named))


def _matrix(field: str, value: ArrayLike | None, rows: int) -> Array:
    matrix = np.zeros((rows, 0)) if value is None else real_array(f"stage_rows.{field}", value)
    if matrix.ndim not in (2, 3) or matrix.shape[-2] != rows:
        expected = f"a matrix with {rows} rows, as many as e has, or (T, {rows}, ...) with one per time"
        advice = "A single row is a matrix with one row: [[c_1, c_2, ...]]."
        raise ProblemError(f"stage_rows.{field}", f"shape {matrix.shape}", expected, advice)
    return matrix


@dataclass(frozen=True, eq=False)
class StageSets:
    """The sets of (x_t, u_t), t < T: bounds, rows of polyhedra and hard joint rows, without balls and cones."""

    states: Box  # bounds (T+1, n)
    controls: Box  # bounds (T, m)
    tube: Box  # the bounds of the states, with those of the ends
    rows: Sequence[LinearRows]  # without the bounds
    names: tuple[str, ...]  # of all terms of the problem

    @property
    def horizon(self) -> int:
        """Return T."""
        return len(self.controls.lower)

    def around(self) -> StageSet:
        """Return bounds around the sets of all times, with the rows that hold at all of them."""
        T = self.horizon
        lower = np.concatenate([self.states.lower[:T].min(0), self.controls.lower.min(0)])
        upper = np.concatenate([self.states.upper[:T].max(0), self.controls.upper.max(0)])
        fixed_start = T > 1 and self.tube.fixed[0].all()  # the rows of its sets are no terms
        needed = set(range(int(fixed_start), T))
        lasting = [rows for rows in self.rows if len(rows.C) == 1 and needed <= set(rows.times.tolist())]
        return _stage_set(lower, upper, [(rows.C[0], rows.e.max(0)) for rows in lasting])

    def at(self, t: int) -> StageSet:
        """Return the set of one time."""
        lower = np.append(self.tube.lower[t], self.controls.lower[t])
        upper = np.append(self.tube.upper[t], self.controls.upper[t])
        rows = [(rows.matrix(int(k)), rows.e[k]) for rows in self.rows for k in np.flatnonzero(rows.times == t)]
        return _stage_set(lower, upper, rows)

    @property
    def constant(self) -> bool:
        """Whether the sets, ends apart, are the same at all times."""
        T = self.horizon
        bounds = self.states.lower[:T], self.states.upper[:T], self.controls.lower, self.controls.upper
        rows = all(len(rows.C) == 1 and (rows.e == rows.e[0]).all() for rows in self.rows)
        return rows and all(bool((bound == bound[0]).all()) for bound in bounds)


@dataclass(frozen=True, eq=False)
class StageSet:
    """{v = (x, u) : lower <= v <= upper, matrix v <= limits}."""

    lower: Array  # (n + m,)
    upper: Array  # (n + m,)
    matrix: Array  # (rows, n + m)
    limits: Array  # (rows,)


def stage_sets(states: Box, controls: Box, tube: Box, terms: Sequence[Term]) -> StageSets:
    """Return the sets, from the bounds of states (T+1, n), of controls (T, m), of states with ends, and from terms."""
    T, rows = len(controls.lower), list[LinearRows]()
    for term in terms:
        found = term.polyhedron(states.lower.shape[1], controls.lower.shape[1])
        if found is not None and (inside := found.times < T).any():
            matrix = found.C if len(found.C) == 1 else found.C[inside]
            rows.append(LinearRows(found.name, found.times[inside], matrix, found.e[inside]))
    return StageSets(states, controls, tube, rows, tuple(term.name for term in terms))


def _stage_set(lower: Array, upper: Array, rows: Sequence[tuple[Array, Array]]) -> StageSet:
    matrix = np.vstack([np.zeros((0, len(lower))), *(matrix for matrix, _ in rows)])
    return StageSet(lower, upper, matrix, np.concatenate([np.zeros(0), *(limits for _, limits in rows)]))
