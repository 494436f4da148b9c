"""Derivatives of the optimum by the data of its problem, and whether they exist.

With K = [[H, M'], [M, 0]] of the active rows, L the Lagrangian and theta the data:

    jvp(delta)  =  -K^-1 (d/dtheta grad_(z,y) L) delta                           one solve
    vjp(zbar)   =  -d/ds grad_theta L(z + s p, y + s q),   K (p, q) = (zbar, 0)    one solve

Weak rows, active with multiplier zero, are inequalities of the QP that the one-sided derivative solves (Robinson 1980;
Jittorntrum 1984): lambda >= 0 minimises 1/2 lambda'S lambda - lambda'v, S = F P F'.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import nnls

from lin_freq_ocp.base.arrays import Array, Mask, brief, to_shape
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.phrases import html_table, plural
from lin_freq_ocp.certificate.hamiltonian import require_fitting
from lin_freq_ocp.derivatives.data import ByDatum, Values, Variables, data_for, data_of, slopes, with_data
from lin_freq_ocp.derivatives.equations import ChangedEquations, changed_equations
from lin_freq_ocp.derivatives.exact_point import ExactPoint, exact_point
from lin_freq_ocp.derivatives.kkt import MOST_SOLVE_ERROR
from lin_freq_ocp.problem.costs.quadratic import AXES
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

SEEN = 1e-9  # of a solution of K, relative to its size: what is less is rounding
TIED = 1e-15  # on the diagonal of S, relative, so that it has a root
SLOWEST = 1e-13  # part of the largest rate of change of a slack, below which a rate is rounding
NAMED_PART = 0.1  # of the largest entry of a vector of the null space: rows with less are not named
WEAK = "active with multiplier zero"
UNSETTLED = "the active rows did not settle"
DEPENDENT_ROWS = "active rows depend on each other, and their multipliers are not unique"
NOT_UNIQUE = "the optimum is not unique: the cost is flat along a direction"
ExistenceFields = tuple[bool, tuple[str, ...], str, float]
Reach = tuple[tuple[float, float] | None, tuple[str | None, str | None]]
NO_REACH: Reach = (None, (None, None))


@dataclass(frozen=True, eq=False)
class Existence:
    """Whether a derivative exists; if not, the rows in the way and the reason. ``error``: of its solve, relative."""

    exists: bool
    rows: tuple[str, ...]
    reason: str
    error: float

    @property
    def facts(self) -> list[tuple[str, str]]:
        """Return whether it exists and why not, in words."""
        return [
            ("exists", "yes" if self.exists else f"no: {self.reason}"),
            *([("rows", "; ".join(self.rows))] if self.rows else []),
        ]


@dataclass(frozen=True, eq=False)
class Gradient(Existence, ByDatum):
    """The derivative of <weights, optimum> by every datum, under its name.

    Attributes
    ----------
    exists : bool
        Whether it is the derivative from both sides, for every change of the data.
    rows : tuple of str
        The rows that are active with multiplier zero, and that the weights see.
    reason : str
        Why there is no derivative; empty if there is one.
    error : float
        Of the solve, relative, estimated by its last correction.

    Examples
    --------
    >>> gradient = lfo.solve(lfo.library.double_integrator()).derivatives.vjp(u=[[1.0]] * 200)
    >>> gradient.exists, gradient["A"].shape
    (True, (2, 2))
    """

    slopes: Values = field(repr=False)

    def __repr__(self) -> str:
        return f"Gradient({', '.join(f'{name} {text}' for name, text in self.facts)}, by {', '.join(self)})"

    def _repr_html_(self) -> str:
        return html_table("Derivatives of the optimum", [*self.facts, ("by", ", ".join(self))])


@dataclass(frozen=True, eq=False)
class Side:
    """The derivative of an optimum along a change of the data, on one side.

    Attributes
    ----------
    x : (T+1, n), u : (T, m)
        Of states and controls.
    multipliers : Multipliers

    Examples
    --------
    >>> step = lfo.solve(lfo.library.double_integrator()).derivatives.jvp(initial_state=[1.0, 0.0])
    >>> step.left.u.shape
    (200, 1)
    """

    x: Array
    u: Array
    multipliers: Multipliers


@dataclass(frozen=True, eq=False)
class Derivative(Existence):
    """The derivative of the optimum along a change of the data.

    Attributes
    ----------
    x, u, multipliers
        Of ``right``.
    cost : float
        Of the optimal cost, which has a derivative wherever optimum and multipliers are unique.
    left, right : Side or None
        The one-sided derivatives, equal where the derivative exists; None where none is known.
    holds : (float, float) or None
        The steps, below and above zero, up to which optimum and multipliers are affine; None where no step is known:
        matrices and weights change, a mask or an energy is active, or two sides differ.
    ends : (str or None, str or None)
        The row that ends each side of ``holds``.

    Examples
    --------
    >>> step = lfo.solve(lfo.library.double_integrator()).derivatives.jvp(initial_state=[1.0, 0.0])
    >>> step.exists, step.u.shape
    (True, (200, 1))
    """

    cost: float
    left: Side | None
    right: Side | None
    holds: tuple[float, float] | None = None
    ends: tuple[str | None, str | None] = (None, None)

    @property
    def x(self) -> Array:
        """Return the derivative of the states, (T+1, n)."""
        return self._of_right.x

    @property
    def u(self) -> Array:
        """Return the derivative of the controls, (T, m)."""
        return self._of_right.u

    @property
    def multipliers(self) -> Multipliers:
        """Return the derivative of the multipliers."""
        return self._of_right.multipliers

    @property
    def _of_right(self) -> Side:
        if self.right is None:
            raise UnsupportedError(f"derivatives: there is none: {self.reason}.")
        return self.right

    def __repr__(self) -> str:
        reach = [] if self.holds is None else [("holds", f"from {self.holds[0]:.3g} to {self.holds[1]:.3g}")]
        return (
            f"Derivative({', '.join(f'{name} {text}' for name, text in [*self.facts, *reach])}, cost {self.cost:.6g})"
        )


class SolutionDerivatives:
    """The derivatives of an optimum by the data of its problem, from one factorisation.

    Methods
    -------
    vjp(x, u, multipliers)
        The derivative of a weighted sum of the optimum by every datum.
    jvp(**change)
        The derivative of the optimum along a change of the data.
    prices_along(**change)
        The derivative along a change of ``prices``, those of the optimal cost by every datum.

    References
    ----------
    docs/derivatives.md

    Examples
    --------
    >>> lfo.solve(lfo.library.double_integrator()).derivatives.vjp(u=[[1.0]] * 200).exists
    True
    """

    def __init__(self, problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers):
        point = exact_point(problem, trajectory, multipliers)
        if point is None:
            raise UnsupportedError("derivatives: the active rows determine no point.")
        self.problem, self._point = problem, point
        self._signals = Variables.at(problem, point.trajectory, point.multipliers)

    @property
    def trajectory(self) -> Trajectory:
        """Return the exact optimum on its active rows."""
        return self._point.trajectory

    @property
    def multipliers(self) -> Multipliers:
        """Return its multipliers."""
        return self._point.multipliers

    @cached_property
    def prices(self) -> Values:
        """The derivatives of the optimal cost by every datum, at the exact optimum."""
        return slopes(self.problem, self._signals)

    def vjp(
        self, x: ArrayLike | None = None, u: ArrayLike | None = None, multipliers: Multipliers | None = None
    ) -> Gradient:
        """Return the derivative of sum(x * x*) + sum(u * u*) + <multipliers, multipliers*> by every datum.

        Parameters
        ----------
        x : (T+1, n), u : (T, m), multipliers : Multipliers, optional
            Weights; zero if absent. eta_C of the multipliers has no part.

        Returns
        -------
        Gradient

        Raises
        ------
        ProblemError
            If a weight has the wrong shape, or an entry is not a number.
        UnsupportedError
            If so many bins are removed that each derivative is a problem of its own, and no method solves it.
        """
        T, n, m = self.problem.horizon, self.problem.state_dim, self.problem.control_dim
        of_x = np.zeros((T + 1, n)) if x is None else to_shape("x", x, (T + 1, n))
        of_u = np.zeros((T, m)) if u is None else to_shape("u", u, (T, m))
        along, existence = self._adjoint(of_x, of_u, multipliers)
        values = {name: -value for name, value in slopes(self.problem, self._signals, along).items()}
        return Gradient(*existence, values)

    def _adjoint(self, of_x: Array, of_u: Array, multipliers: Multipliers | None) -> tuple[Variables, ExistenceFields]:
        """Return the solution (p, q) for weights, and the fields of ``Existence`` of its derivative."""
        point, linear, scaling = self._point, self._point.deviations.linear, self._point.deviations.scaling
        program, of_rows = point.program, np.zeros(len(point.program.lower))
        of_z = np.zeros(linear.variables)
        of_z[: linear.signals] = np.append(of_x, of_u)
        of_z *= scaling.cost * scaling.columns
        if multipliers is not None:
            require_multipliers(self.problem, multipliers)
            flat = np.append(linear.layout.flat(multipliers), 0.0)
            weighted = (flat[part.targets] * (1.0 if part.weights is None else part.weights) for part in linear.rows)
            of_rows = scaling.rows * np.concatenate([multipliers.eta.ravel(), *weighted])
            of_z += program.A.T @ (point.kkt.curvature @ of_rows)
        p, q, error = point.kkt.solve(of_z, of_rows)
        size = max(float(np.abs(p).max(initial=0.0)), float(np.abs(q).max(initial=0.0)))
        seen = np.abs(point.weak.F @ p - point.weak.choice @ of_rows) > SEEN * size
        rows = point.describe(point.weak.rows[seen], point.weak.side[seen])
        side = self._side(p, q)
        along = Variables.along(Trajectory(side.x, side.u), side.multipliers)
        return along, self._existence(rows, error, point.dependent)

    def jvp(self, **change: ArrayLike) -> Derivative:
        """Return the derivative of the optimum along a change of the data.

        Parameters
        ----------
        **change : arrays
            Changes of data by their names, those of a ``Gradient``, in the shapes of the data. What depends on time may
            be given once.

        Returns
        -------
        Derivative

        Raises
        ------
        ProblemError
            If a datum is unknown, or a change does not fit it.
        UnsupportedError
            As for ``vjp``.
        """
        given = data_for(self.problem, change)
        cost = sum(float(np.nansum((np.conj(self.prices[name]) * d).real)) for name, d in given.items())
        return self._step_along(given, cost)

    def _step_along(self, given: Values, cost: float) -> Derivative:
        """Return the derivative along a change of the data, with that of the cost."""
        point, weak = self._point, self._point.weak
        forced, active = changed_equations(point, given), point.kkt.active
        at_lower = active.below.copy()
        at_lower[point.program.in_cones] = True
        at_lower[weak.rows[weak.side < 0]] = True
        of_rows = np.where(at_lower, forced.lower, forced.upper) - forced.values
        p, q, error = point.kkt.solve(-forced.of_z, of_rows)
        if not len(weak.rows):
            side, existence = self._side(p, q), self._existence((), error)
            holds = _reach(point, forced, p, q) if existence[0] else NO_REACH
            return Derivative(*existence, cost, side, side, *holds)
        v, size = weak.F @ p - weak.choice @ of_rows, float(np.abs(p).max(initial=0.0))
        left, right = one_sided(point, p, q, v, -1.0), one_sided(point, p, q, v, 1.0)
        blocked = point.dependent & (np.abs(v) > SEEN * size if forced.affine else np.ones(len(v), dtype=bool))
        same = bool(np.abs(left[0] - right[0]).max() <= SEEN * size)
        rows = () if same else point.describe(weak.rows, weak.side)
        below, above = (
            None if (blocked & (sign * v > SEEN * size)).any() else self._side(*side)
            for sign, side in ((-1.0, left), (1.0, right))
        )
        return Derivative(*self._existence(rows, error, blocked), cost, below, above)

    def prices_along(self, step: Derivative | None = None, /, **change: ArrayLike) -> Values:
        """Return the derivative of ``prices`` along a change of the data: second derivatives of the optimal cost.

        Parameters
        ----------
        step : Derivative, optional
            The answer of ``jvp`` for this change, where there is one already.
        **change : arrays
            As for ``jvp``; on its right side at a kink.

        Raises
        ------
        ProblemError
            If a datum is unknown, or a change does not fit it.

        Examples
        --------
        >>> derivatives = lfo.solve(lfo.library.double_integrator()).derivatives
        >>> derivatives.prices_along(initial_state=[1.0, 0.0])["offset"].shape
        (200, 2)
        """
        step = self.jvp(**change) if step is None else step
        given, known = data_for(self.problem, change), data_of(self.problem)
        along = Variables.along(Trajectory(step.x, step.u), step.multipliers)
        found, of_cost = slopes(self.problem, self._signals, along), [name for name in AXES if name in given]
        for sign in (-0.5, 0.5) if of_cost else ():  # the slopes are quadratic in the cost itself: this is exact
            there = with_data(self.problem, {name: known[name] + 2 * sign * given[name] for name in of_cost})
            moved = slopes(there, Variables.at(there, self.trajectory, self.multipliers))
            found |= {name: found[name] + sign * moved[name] for name in AXES}
        return found

    def _side(self, p: Array, q: Array) -> Side:
        """Return a change of the optimum from one of z and of the duals, in scaled units."""
        linear, scaling = self._point.deviations.linear, self._point.deviations.scaling
        change = linear.direction(scaling.primal(p))
        return Side(change.x, change.u, self._point.multipliers_of(q))

    def _existence(self, rows: tuple[str, ...], error: float, dependent: Mask | None = None) -> ExistenceFields:
        """Return whether a derivative exists, the rows in the way, the reason, and the error of its solve."""
        point, reason = self._point, ""
        if not point.settled:
            reason = UNSETTLED
        elif point.kkt.singular:
            of_z, of_rows = point.kkt.weakest
            if np.linalg.norm(of_z) > np.linalg.norm(of_rows):
                reason = NOT_UNIQUE
            else:
                worst = np.flatnonzero(np.abs(of_rows) > NAMED_PART * np.abs(of_rows).max())
                rows = point.describe(worst, np.where(point.kkt.active.above[worst], 1.0, -1.0))
                reason = DEPENDENT_ROWS
        elif error > MOST_SOLVE_ERROR:
            reason = f"the active rows are nearly dependent: the relative error of the solve is {error:.0e}"
        elif len(point.corners):
            rows = point.describe(point.corners, np.ones(len(point.corners)))
            reason = "a norm is zero, with multipliers at the border of those that hold it there"
        elif dependent is not None and dependent.any():
            rows = point.describe(point.weak.rows[dependent], point.weak.side[dependent])
            reason = "rows with multiplier zero depend on the active rows"
        elif rows:
            reason = f"{WEAK}: {plural(len(rows), 'row')}"
        return not reason, rows, reason, error


def require_multipliers(problem: OptimalControlProblem, weights: object) -> None:
    """Raise ProblemError unless weights are multipliers of the problem."""
    if not isinstance(weights, Multipliers):
        raise ProblemError("multipliers", brief(weights), "Multipliers, such as those of a Derivative")
    require_fitting(problem, weights)


def one_sided(point: ExactPoint, p: Array, q: Array, v: Array, sign: float) -> tuple[Array, Array]:
    """Return the derivative along a change, from above or below, from that without weak rows and their violation v."""
    of_z, of_y, S, dependent = point.responses
    free, prices = np.flatnonzero(~dependent), np.zeros(len(v))
    if len(free):
        scale = 1 / np.sqrt(np.diag(S)[free])
        root = np.linalg.cholesky(S[np.ix_(free, free)] * np.outer(scale, scale) + TIED * np.eye(len(free))).T
        prices[free] = nnls(root, np.linalg.solve(root.T, sign * scale * v[free]))[0] * scale
    own = point.weak.choice.T @ prices
    return p - sign * (of_z @ prices), q + sign * (own - of_y @ prices)


def _reach(point: ExactPoint, forced: ChangedEquations, p: Array, q: Array) -> Reach:
    """Return the steps up to which slacks and multipliers keep their signs, and the rows there; None with cones."""
    program, active = point.program, point.kkt.active
    if len(program.cones) or not forced.affine:
        return NO_REACH
    values, moved, equal = program.A @ point.kkt.z, program.A @ p + forced.values, program.equality
    free = ~(active.above | active.below)
    sides = [  # rows, what must stay above zero, and its rate
        (free, program.upper - values, forced.upper - moved, 1.0),
        (free, values - program.lower, moved - forced.lower, -1.0),
        (active.above & ~equal, point.kkt.y, q, 1.0),
        (active.below & ~equal, -point.kkt.y, -q, -1.0),
    ]
    parts = [(np.flatnonzero(kept), room[kept], pace[kept], np.full(kept.sum(), at)) for kept, room, pace, at in sides]
    rows, slack, rate, side = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return reach(slack, rate, lambda k: point.describe(rows[[k]], side[[k]])[0])


def reach(slack: Array, rate: Array, name_row: Callable[[int], str]) -> Reach:
    """Return the steps below and above zero up to which slack + step rate >= 0, and the rows that end them."""
    slack = np.maximum(slack, 0.0)
    rate = np.where(np.abs(rate) > SLOWEST * np.abs(rate).max(initial=0.0), rate, 0.0)
    steps, ends = list[float](), list[str | None]()
    for sign in (-1.0, 1.0):
        closing = sign * rate < 0
        lengths = np.where(closing & np.isfinite(slack), slack / np.where(closing, np.abs(rate), 1.0), np.inf)
        k = int(np.argmin(lengths)) if len(lengths) else -1
        finite = k >= 0 and bool(np.isfinite(lengths[k]))
        steps.append(sign * float(lengths[k]) if finite else sign * np.inf)
        ends.append(name_row(k) if finite else None)
    return (steps[0], steps[1]), (ends[0], ends[1])
