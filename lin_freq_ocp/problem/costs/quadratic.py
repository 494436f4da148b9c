# ruff: noqa: D102
"""Stage and terminal costs c_t(x_t, u_t) and c_T(x_T) (paper, (DTOCPNSD-a)), and their exact convexity.

A new cost is a subclass of ``NonsmoothCost``; see ``norms``. Methods without a docstring are described by ``Cost``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import (
    Array,
    Mask,
    assign,
    brief,
    first_largest,
    one_component,
    seal,
    split_signals,
    stack_signals,
    times_vectors,
    to_shape,
    with_columns,
    with_rows,
)
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.names import ByName, arrays_or_names, fields_by_name
from lin_freq_ocp.base.phrases import datum, plural
from lin_freq_ocp.base.semidefinite import least_rise
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.problem.terms.term import Term

# Of each field, the axes of one time: n states, m controls
PREVIEWED = ("x_ref", "u_ref", "q", "r")  # what a step of a loop, and each of many problems, may have of its own
AXES = {"Q": "nn", "R": "mm", "S": "nm", "q": "n", "r": "m", "P": "nn", "p": "n", "x_ref": "n", "u_ref": "m"}
WEIGHTS = ("Q", "R", "S", "q", "r", "P", "p")
SYMMETRY_TOLERANCE = 1e-12  # largest relative asymmetry of Q, R or P that is rounding
CONVEXITY_TOLERANCE = 1e-12  # largest negative eigenvalue, relative to the largest, that is rounding


class Cost(ABC):
    """A cost; sums of costs are costs, ``sum`` of a list included. All but ``SmoothCost`` are convex.

    A new nonsmooth cost is a subclass of ``NonsmoothCost`` in a file of its own. To be written to problem files it is
    listed in ``files/problem_tables.py``. ``tests/helpers/own_kinds.py`` has a complete one.
    """

    @property
    @abstractmethod
    def quadratic(self) -> QuadraticCost:
        """Return the quadratic part."""

    @property
    @abstractmethod
    def norms(self) -> tuple[NonsmoothCost, ...]:
        """Return the nonsmooth parts."""

    def at_names(self, states: Sequence[str], controls: Sequence[str]) -> Cost:
        """Return the cost with weights and references by name as those of components of these names."""
        norms = [norm.at_names(states, controls) for norm in self.norms]
        return CostSum([self.quadratic.at_names(states, controls), *norms])

    def at_dimensions(self, n: int, m: int, horizon: int) -> Cost:
        """Return the cost with all weights and references as arrays of the right shape, checked."""
        complete = CostSum([norm.with_signals(n, m, horizon, f"cost.norms[{i}]") for i, norm in enumerate(self.norms)])
        assign(complete, smooth=self.quadratic.at_dimensions(n, m, horizon))
        return complete

    def translated(self, origin: Array) -> Cost | None:
        """Return the cost of x - origin, origin (n,), less a constant; None if a summand has no such method."""
        translated = [norm.translated(origin) for norm in self.norms]
        norms = [norm for norm in translated if norm is not None]
        return CostSum([self.quadratic.translated(origin), *norms]) if len(norms) == len(translated) else None

    def terms(self, n: int, m: int, horizon: int) -> list[Term]:
        """Return the nonsmooth terms."""
        terms, labels = list[Term](), [cost.label for cost in self.norms]
        for i, cost in enumerate(self.norms):
            before = labels[:i].count(cost.label)
            name = f"{cost.label} {before + 1}" if before else cost.label
            terms += cost.own_terms(n, m, horizon, f"cost.norms[{i}]", name)
        return terms

    @property
    def formulas(self) -> tuple[Formula | None, Formula | None]:
        """Return the formulas of the stage and of the terminal cost, None for none; in a problem."""
        return None, None

    @property
    def has_formulas(self) -> bool:
        """Whether a part of it is a formula."""
        return False

    @property
    def without_formulas(self) -> Cost:
        """Return the cost without its parts by formulas."""
        return CostSum([self.quadratic, *(norm for norm in self.norms if not norm.has_formulas)])

    def formula_values(self, x: Array, u: Array) -> Array:
        """Return the costs by formulas of every time, (T+1,), for x (T+1, n) and u (T, m)."""
        return np.zeros(len(x))

    def __add__(self, other: Cost) -> CostSum:
        return CostSum([self, other])

    def __radd__(self, other: object) -> Cost:
        costs: list[Any] = [other, self]
        return self if type(other) is int and other == 0 else CostSum(costs)  # sum() begins with 0


class NonsmoothCost(Cost):
    """A cost that is a sum of terms h(L(x, u)), or has formulas."""

    label: ClassVar[str]  # names its terms

    @property
    def quadratic(self) -> QuadraticCost:
        return QuadraticCost()

    @property
    def norms(self) -> tuple[NonsmoothCost, ...]:
        return (self,)

    def at_names(self, states: Sequence[str], controls: Sequence[str]) -> NonsmoothCost:
        return self

    def with_signals(self, n: int, m: int, horizon: int, field: str) -> NonsmoothCost:
        """Return the cost with its formulas, if it has any, as those of n states and m controls."""
        return self

    @abstractmethod
    def own_terms(self, n: int, m: int, horizon: int, field: str, name: str) -> list[Term]:
        """Return its terms under a name, checked against the problem's dimensions; errors name the field."""

    @abstractmethod
    def describe(self) -> str:
        """Return a text of the summands and their weights; empty if all are zero."""

    @abstractmethod
    def augmented(self, n: int, k: int) -> NonsmoothCost:
        """Return the cost of (x, w), w in R^k without cost."""

    def translated(self, origin: Array) -> NonsmoothCost | None:
        return None

    def references(self, index: int, is_state: bool, horizon: int) -> tuple[Array, Mask] | None:
        """Return the references of states or controls, and the times at which component ``index`` has a weight."""
        return None


@dataclass(frozen=True, eq=False, init=False)
class QuadraticCost(Cost):
    """sum_{t<T} 1/2 a'Q a + 1/2 b'R b + a'S b + q'x_t + r'u_t, plus 1/2 a'P a + p'x_T at T.

    Here a = x_t - x_ref and b = u_t - u_ref. The 1/2 is part of the definition. Q, R, S, q, r may be given one per
    time (T of them); x_ref per time has T+1 rows.

    Parameters
    ----------
    Q : float or (n, n), R : float or (m, m), S : (n, m)
        Stage Hessian; a number stands for that multiple of the identity. Symmetric.
    q : (n,), r : (m,)
        Linear terms; they act on x_t and u_t, not on the deviations from the references.
    P : float or (n, n), p : (n,)
        Terminal terms.
    x_ref : (n,) or (T+1, n), u_ref : (m,) or (T, m)
        References; a number, for a single component.

    Each but S may be a mapping from names of components to numbers, or to one number per time: of a matrix it states
    the diagonal, and what it does not name is zero.

    Raises
    ------
    ProblemError
        If an entry is not a number; in a problem, if dimensions do not match or a matrix is not symmetric.

    Examples
    --------
    >>> lfo.QuadraticCost(Q=[[1.0, 0.0], [0.0, 0.0]], R=2.0)
    QuadraticCost(...)

    Methods
    -------
    value(x, u)
        The total cost.
    stage_values(x, u)
        The cost of every time.
    gradient(x, u)
        Its gradients in x and in u.
    """

    Q: Array
    R: Array
    S: Array
    q: Array
    r: Array
    P: Array
    p: Array
    x_ref: Array
    u_ref: Array

    _over_time: ClassVar[Mapping[str, list[str]]] = {}  # by field, the components that have one value per time

    def __init__(
        self,
        Q: ArrayLike | ByName = 0.0,
        R: ArrayLike | ByName = 0.0,
        S: ArrayLike | ByName = 0.0,
        q: ArrayLike | ByName = 0.0,
        r: ArrayLike | ByName = 0.0,
        P: ArrayLike | ByName = 0.0,
        p: ArrayLike | ByName = 0.0,
        x_ref: ArrayLike | ByName = 0.0,
        u_ref: ArrayLike | ByName = 0.0,
    ):
        given = {"Q": Q, "R": R, "S": S, "q": q, "r": r, "P": P, "p": p, "x_ref": x_ref, "u_ref": u_ref}
        assign(self, **arrays_or_names("cost", given))

    @property
    def quadratic(self) -> QuadraticCost:
        return self

    @property
    def norms(self) -> tuple[NonsmoothCost, ...]:
        return ()

    @property
    def zero(self) -> bool:
        """Whether all its terms are zero."""
        return self._nonzero.isdisjoint(WEIGHTS)

    @cached_property
    def _nonzero(self) -> frozenset[str]:
        """The names of the fields that are not zero."""
        return frozenset(name for name in AXES if np.any(getattr(self, name)))

    def describe(self) -> str:
        """Return the nonzero terms as a formula; empty if there are none."""
        x = "(x - x_ref)" if self.x_ref.any() else "x"
        u = "(u - u_ref)" if self.u_ref.any() else "u"
        half = "\N{VULGAR FRACTION ONE HALF}"
        stage = [
            (self.Q, f"{half} {x}' Q {x}"),
            (self.R, f"{half} {u}' R {u}"),
            (self.S, f"{x}' S {u}"),
            (self.q, "q' x"),
            (self.r, "r' u"),
        ]
        terminal = [(self.P, f"{half} {x}' P {x} at the end"), (self.p, "p' x at the end")]
        summed = [text for values, text in stage if values.any()]
        parts = [f"the sum of {' + '.join(summed)}"] if summed else []
        return " + ".join([*parts, *(text for values, text in terminal if values.any())])

    def describe_data(self) -> list[str]:
        """Return the value of every letter of the formula."""
        used = {"x_ref": self.Q.any() or self.P.any() or self.S.any(), "u_ref": self.R.any() or self.S.any()}
        return [
            datum(field, getattr(self, field), len(AXES[field]))
            for field in ("Q", "R", "S", "P", "q", "r", "p", "x_ref", "u_ref")
            if getattr(self, field).any() and used.get(field, True)
        ]

    def at_names(self, states: Sequence[str], controls: Sequence[str]) -> QuadraticCost:
        names = {field: states if axes[0] == "n" else controls for field, axes in AXES.items()}
        named = fields_by_name("cost", self, names)
        if "S" in named:
            raise ProblemError("cost.S", "a mapping", "a matrix (n, m)")
        diagonals = {field: named[field][..., None] * np.eye(len(names[field])) for field in named if field in "QRP"}
        if not named:
            return self
        changed, given = replace(self, **named | diagonals), {field: getattr(self, field).items() for field in named}
        over_time = {field: [name for name, value in each if np.ndim(value)] for field, each in given.items()}
        assign(changed, _over_time=over_time)
        return changed

    def at_dimensions(self, n: int, m: int, horizon: int) -> QuadraticCost:
        sizes, complete = {"n": n, "m": m}, dict[str, Array]()
        for field, axes in AXES.items():
            shape, value = tuple(sizes[axis] for axis in axes), np.asarray(getattr(self, field))
            times = {"P": None, "p": None, "x_ref": horizon + 1}.get(field, horizon)
            square, reference = len(set(axes)) < len(axes), field.endswith("_ref")
            if (over_time := self._over_time.get(field)) and len(value) != times:
                expected = "a number" if times is None else f"a number, or {times}, one per time"
                raise ProblemError(f"cost.{field}[{over_time[0]!r}]", plural(len(value), "number"), expected)
            if square and value.ndim == 0:
                value = value * np.eye(shape[0])
            elif value.ndim == 0 and value == 0:
                value = np.zeros(shape)
            elif reference:
                value = one_component(value, shape[0])
            complete[field] = value = to_shape(f"cost.{field}", value, shape, times)
            if square:
                require_symmetric(f"cost.{field}", value)
        return _cost_of_checked(**complete)

    @cached_property
    def weighs(self) -> tuple[Mask, Mask]:
        """Which states (n,) and controls (m,) cost something by their deviation from the reference."""
        Q, S, P, R = (np.any(part.reshape(-1, *part.shape[-2:]), axis=0) for part in (self.Q, self.S, self.P, self.R))
        return np.any(np.hstack([Q, S, P]), axis=1), np.any(np.vstack([R, S]), axis=0)

    def translated(self, origin: Array) -> QuadraticCost:
        return replace(self, x_ref=np.where(self.weighs[0], self.x_ref - origin, 0.0))

    def augmented(self, k: int, weight: float) -> QuadraticCost:
        """Return the cost of (x, w), with weight/2 |w_t|^2 for w in R^k and t < T."""
        n, m = self.S.shape[-2:]
        return QuadraticCost(
            Q=with_rows(with_columns(self.Q, k), weight * np.eye(k, n + k, n)),
            R=self.R,
            S=with_rows(self.S, np.zeros((k, m))),
            q=with_columns(self.q, k),
            r=self.r,
            P=with_rows(with_columns(self.P, k), np.zeros((k, n + k))),
            p=with_columns(self.p, k),
            x_ref=with_columns(self.x_ref, k),
            u_ref=self.u_ref,
        )

    def deviations(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Return x - x_ref, (..., T+1, n), and u - u_ref, (..., T, m)."""
        return x - self.x_ref if "x_ref" in self._nonzero else x, u - self.u_ref if "u_ref" in self._nonzero else u

    def references(self, horizon: int) -> Array | None:
        """Return the references of all times, stacked, (T+1, n + m); None if they are zero."""
        if self._nonzero.isdisjoint(("x_ref", "u_ref")):
            return None
        T, n, m = horizon, *self.S.shape[-2:]
        return stack_signals(np.broadcast_to(self.x_ref, (T + 1, n)), np.broadcast_to(self.u_ref, (T, m)))

    def deviations_of(self, z: Array) -> Array:
        """Return stacked signals (..., T+1, n + m) less the references."""
        references = self.references(z.shape[-2] - 1)
        return z if references is None else z - references

    def bend(self, deviations: Array) -> Array:
        """Return the slopes of the quadratic part at stacked deviations from the references, (..., T+1, n + m)."""
        H, n = self.stage_hessians, self.S.shape[-2]
        slopes = times_vectors(H[0] if len(H) == 1 else np.concatenate([H, H[-1:]]), deviations)
        slopes[..., -1, :n], slopes[..., -1, n:] = deviations[..., -1, :n].dot(self.P), 0.0
        return slopes

    def linear_slopes(self, horizon: int) -> Array | None:
        """Return q and r of all times, and p, stacked, (T+1, n + m); None if they are zero."""
        if self._nonzero.isdisjoint("qrp"):
            return None
        T, n, m = horizon, *self.S.shape[-2:]
        in_x = np.concatenate([np.broadcast_to(self.q, (T, n)), np.broadcast_to(self.p, (1, n))])
        return stack_signals(in_x, np.broadcast_to(self.r, (T, m)))

    def terms_at(self, z: Array) -> tuple[Array, Array | None]:
        """Return the quadratic part of every time, (..., T+1), and the linear terms by component, None without."""
        of_deviations, linear = self.deviations_of(z), self.linear_slopes(z.shape[-2] - 1)
        return 0.5 * (of_deviations * self.bend(of_deviations)).sum(-1), None if linear is None else linear * z

    def stage_values(self, x: Array, u: Array) -> Array:
        """Return c_t(x_t, u_t) for t < T and c_T(x_T): shape (..., T+1)."""
        quadratic, linear = self.terms_at(stack_signals(x, u))
        return quadratic if linear is None else quadratic + linear.sum(-1)

    def products(self, z: Array) -> float:
        """Return |d|'|H||d|/2 for deviations d of z from the references, the sum of the terms of the quadratic part."""
        sizes = np.abs(self.deviations_of(z))
        return float(0.5 * (sizes * self.magnitudes.bend(sizes)).sum())

    def value(self, x: Array, u: Array) -> float:
        """Return the total cost."""
        return float(self.stage_values(x, u).sum())

    def gradient(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Return the gradients in x, (..., T+1, n), and in u, (..., T, m)."""
        slopes, linear = self.bend(self.deviations_of(stack_signals(x, u))), self.linear_slopes(u.shape[-2])
        return split_signals(slopes if linear is None else slopes + linear, self.S.shape[-2])

    @cached_property
    def magnitudes(self) -> QuadraticCost:
        """The cost with the absolute values of all data, without references."""
        weights = {field: np.abs(getattr(self, field)) for field in WEIGHTS}
        return _cost_of_checked(**weights, x_ref=np.zeros(()), u_ref=np.zeros(()))

    def slope_magnitudes(self, z: Array) -> Array:
        """Return the sums of the absolute values of the terms of the gradient at stacked signals, (T+1, n + m)."""
        references, linear = self.references(len(z) - 1), self.magnitudes.linear_slopes(len(z) - 1)
        slopes = self.magnitudes.bend(np.abs(z) if references is None else np.abs(z) + np.abs(references))
        return slopes if linear is None else slopes + linear

    @cached_property
    def stage_hessians(self) -> Array:
        """[[Q, S], [S', R]], read-only, (1, n+m, n+m) if constant in time, else (T, n+m, n+m)."""
        Q, R, S = (part[None] if part.ndim == 2 else part for part in (self.Q, self.R, self.S))
        times = max(len(Q), len(R), len(S))
        n, m = S.shape[1:]
        hessian = np.empty((times, n + m, n + m))
        hessian[:, :n, :n], hessian[:, n:, n:] = Q, R
        hessian[:, :n, n:], hessian[:, n:, :n] = S, np.swapaxes(S, 1, 2)
        return seal(hessian)

    @cached_property
    def rises(self) -> tuple[Array, float]:
        """Return the ``least_rise`` of the stage Hessians, (1,) if constant in time, else (T,), and that of P."""
        return np.array([least_rise(hessian) for hessian in self.stage_hessians]), least_rise(self.P)

    def nonconvexity(self) -> tuple[int, float] | None:
        """Return (time, smallest eigenvalue) of the worst indefinite Hessian, or None if the cost is convex."""
        stage, terminal = _eigenvalues(self.stage_hessians), _eigenvalues(self.P)
        smallest = np.append(stage[:, 0], terminal[0])
        rounding = CONVEXITY_TOLERANCE * np.append(np.abs(stage).max(1), np.abs(terminal).max())
        smallest = np.where(smallest < -rounding, smallest, 0.0)
        (worst,) = first_largest(-smallest)
        if smallest[worst] == 0:
            return None
        return (worst if worst < len(stage) else -1), float(smallest[worst])


def require_symmetric(field: str, matrices: Array) -> None:
    """Raise ProblemError if a weight (..., k, k) is asymmetric by more than rounding."""
    asymmetry, name = np.abs(matrices - np.swapaxes(matrices, -1, -2)).max(), field.rpartition(".")[2]
    if asymmetry > SYMMETRY_TOLERANCE * np.abs(matrices).max():
        got = f"a matrix that differs from its transpose by {asymmetry:g}"
        advice = f"Only the symmetric part counts: pass ({name} + {name}')/2."
        raise ProblemError(field, got, "a symmetric matrix", advice)


def _cost_of_checked(**fields: Array) -> QuadraticCost:
    """Return a cost of arrays that need no check."""
    cost = object.__new__(QuadraticCost)
    assign(cost, **fields)
    return cost


@dataclass(frozen=True, eq=False, init=False)
class CostSum(Cost):
    """The sum of costs; written ``QuadraticCost(R=1) + L1Cost(u=0.1)``.

    Parameters
    ----------
    costs : list of costs
        At most one of them quadratic.

    Raises
    ------
    ProblemError
        If an entry is no cost, or two are quadratic.

    Examples
    --------
    >>> total = lfo.costs.CostSum([lfo.QuadraticCost(R=1.0), lfo.costs.L1Cost(u=0.1), lfo.costs.LInfCost(x=1.0)])
    >>> len(total.norms)
    2
    """

    smooth: QuadraticCost
    nonsmooth: tuple[NonsmoothCost, ...]

    def __init__(self, costs: Sequence[Cost]):
        if not isinstance(costs, (list, tuple)):
            raise ProblemError("cost", brief(costs), "a list of costs")
        for cost in costs:
            if not isinstance(cost, Cost):
                raise ProblemError("cost", brief(cost), "QuadraticCost, L1Cost, LInfCost, SmoothCost, or a sum of them")
        quadratic = [cost.quadratic for cost in costs if not cost.quadratic.zero]
        if len(quadratic) > 1:
            raise ProblemError("cost", "a sum of two quadratic costs", "at most one", "Add their matrices.")
        norms = tuple(norm for cost in costs for norm in cost.norms)
        assign(self, smooth=quadratic[0] if quadratic else QuadraticCost(), nonsmooth=norms)

    @property
    def quadratic(self) -> QuadraticCost:
        return self.smooth

    @property
    def norms(self) -> tuple[NonsmoothCost, ...]:
        return self.nonsmooth

    @property
    def formulas(self) -> tuple[Formula | None, Formula | None]:
        pairs = [norm.formulas for norm in self.nonsmooth if norm.has_formulas]
        stage, terminal = ([pair[i] for pair in pairs if pair[i] is not None] for i in range(2))
        return _total(stage), _total(terminal)

    @property
    def has_formulas(self) -> bool:
        return any(norm.has_formulas for norm in self.nonsmooth)

    def formula_values(self, x: Array, u: Array) -> Array:
        return sum((norm.formula_values(x, u) for norm in self.nonsmooth), np.zeros(len(x)))


def _total(formulas: Sequence[Formula | None]) -> Formula | None:
    """Return the sum of formulas, None for none."""
    total: Formula | None = None
    for formula in formulas:
        total = formula if total is None or formula is None else total + formula
    return total


def _eigenvalues(matrices: Array) -> Array:
    """Return the eigenvalues of symmetric matrices, increasing along the last axis."""
    diagonals = np.diagonal(matrices, axis1=-2, axis2=-1)
    if np.count_nonzero(matrices) == np.count_nonzero(diagonals):
        return np.sort(diagonals)
    return np.asarray(np.linalg.eigvalsh(matrices), dtype=np.float64)
