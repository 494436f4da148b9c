"""Nonsmooth costs: sums of absolute values and largest absolute values, and their sums with a quadratic cost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.arrays import Array, assign, brief, real_array, shaped
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.phrases import datum, listed, span, vector
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost, Summable
from lin_freq_ocp.problem.terms.maps import StageMap
from lin_freq_ocp.problem.terms.penalties import Norm
from lin_freq_ocp.problem.terms.term import Term


@dataclass(frozen=True, eq=False, init=False)
class _NormCost(Summable):
    """What L1Cost and LInfCost share: weights of deviations from references."""

    x: Array
    u: Array
    terminal: Array
    x_ref: Array
    u_ref: Array

    def __init__(
        self,
        x: ArrayLike = 0.0,
        u: ArrayLike = 0.0,
        terminal: ArrayLike = 0.0,
        x_ref: ArrayLike = 0.0,
        u_ref: ArrayLike = 0.0,
    ):
        given = {"x": x, "u": u, "terminal": terminal, "x_ref": x_ref, "u_ref": u_ref}
        arrays = {field: real_array(f"{type(self).__name__}.{field}", value) for field, value in given.items()}
        for field in ("x", "u", "terminal"):
            if (arrays[field] < 0).any():
                raise ProblemError(f"{type(self).__name__}.{field}", brief(given[field]), "weights of zero or above")
        assign(self, **arrays)

    def describe(self) -> str:
        """Return in words what is summed, and with which weights; nothing if all are zero."""
        weighted = (("states", self.x), ("controls", self.u), ("terminal state", self.terminal))
        parts = [_weighted(what, weights) for what, weights in weighted if weights.any()]
        if not parts:
            return ""
        kind = "the sum of absolute values" if isinstance(self, L1Cost) else "the largest absolute value"
        references = [
            datum(field, values, 1)
            for field, values, used in (
                ("x_ref", self.x_ref, self.x.any() or self.terminal.any()),
                ("u_ref", self.u_ref, self.u.any()),
            )
            if used and values.any()
        ]
        deviations = f" of deviations from {listed(references)}" if references else ""
        return f"{kind}{deviations} at each time: {listed(parts)}"

    def terms(self, n: int, m: int, horizon: int, place: str, name: str) -> list[Term]:
        """Return its terms with v = weight * deviation, checked against the problem's dimensions."""
        T, order = horizon, (1 if isinstance(self, L1Cost) else np.inf)

        def array(field: str, size: int, times: int | None) -> Array:
            value: Array = getattr(self, field)
            complete = np.full(size, value) if value.ndim == 0 else value
            return shaped(f"{place}.{field}", complete, (size,), times)

        x, u, terminal = array("x", n, T), array("u", m, T), array("terminal", n, None)
        x_ref = np.broadcast_to(array("x_ref", n, T + 1), (T + 1, n))
        u_ref = np.broadcast_to(array("u_ref", m, T), (T, m))
        norm, stages = Norm(order, np.zeros(()), np.ones(())), np.arange(T)
        found: list[Term] = []
        for weights, reference, times, kind, of_state, what in (
            (x, x_ref[:-1], stages, "stage cost", True, "states"),
            (u, u_ref, stages, "stage cost", False, "controls"),
            (terminal, x_ref[-1:], np.array([T]), "terminal cost", True, "terminal state"),
        ):
            if weights.any():
                scale = weights[..., None] * np.eye(weights.shape[-1])
                matrices = (scale, None) if of_state else (None, scale)
                found.append(Term(f"{name} of {what}", kind, StageMap(times, *matrices, -weights * reference), norm))
        return found


class L1Cost(_NormCost):
    """sum_{t<T} sum_i x_i |x_t,i - x_ref,i| + sum_j u_j |u_t,j - u_ref,j|, plus sum_i terminal_i |x_T,i - x_ref,i|.

    A weight on u makes controls sparse: zero at most times.

    Parameters
    ----------
    x : float, (n,) or (T, n); u : float, (m,) or (T, m); terminal : float or (n,)
        Weights, zero or above; a number stands for all components.
    x_ref : float, (n,) or (T+1, n); u_ref : float, (m,) or (T, m)
        References.

    Raises
    ------
    ProblemError
        If a weight is below zero, or, when it meets a problem, a shape does not fit.
    """


class LInfCost(_NormCost):
    """sum_{t<T} max_i x_i |x_t,i - x_ref,i| + max_j u_j |u_t,j - u_ref,j|, plus max_i terminal_i |x_T,i - x_ref,i|.

    Parameters are those of ``L1Cost``.
    """


@dataclass(frozen=True, eq=False, init=False)
class CostSum(Summable):
    """The sum of costs; written ``QuadraticCost(R=1) + L1Cost(u=0.1)``.

    Parameters
    ----------
    costs : list of costs
        At most one of them quadratic.

    Raises
    ------
    ProblemError
        If one is no cost, or two are quadratic.
    """

    quadratic: QuadraticCost
    norms: tuple[_NormCost, ...]

    def __init__(self, costs: list[Any]):
        if not isinstance(costs, (list, tuple)):
            raise ProblemError("cost", brief(costs), "a list of costs")
        quadratic: list[QuadraticCost] = []
        norms: list[_NormCost] = []
        for cost in costs:
            if not isinstance(cost, (QuadraticCost, _NormCost, CostSum)):
                raise ProblemError("cost", brief(cost), "QuadraticCost, L1Cost, LInfCost, or a sum of them")
            if isinstance(cost, CostSum):
                quadratic.append(cost.quadratic)
                norms.extend(cost.norms)
            elif isinstance(cost, QuadraticCost):
                quadratic.append(cost)
            else:
                norms.append(cost)
        quadratic = [cost for cost in quadratic if not cost.zero]
        if len(quadratic) > 1:
            raise ProblemError("cost", "a sum of two quadratic costs", "at most one", "Add their matrices.")
        assign(self, quadratic=quadratic[0] if quadratic else QuadraticCost(), norms=tuple(norms))

    def at_dimensions(self, n: int, m: int, horizon: int) -> CostSum:
        """Return the same cost with the quadratic part completed, checked."""
        complete = CostSum(list(self.norms))
        assign(complete, quadratic=self.quadratic.at_dimensions(n, m, horizon))
        return complete

    def terms(self, n: int, m: int, horizon: int) -> list[Term]:
        """Return the nonsmooth terms."""
        found: list[Term] = []
        for i, cost in enumerate(self.norms):
            kind = "L1 cost" if isinstance(cost, L1Cost) else "Linf cost"
            before = sum(type(other) is type(cost) for other in self.norms[:i])
            found += cost.terms(n, m, horizon, f"cost.norms[{i}]", kind + (f" {before + 1}" if before else ""))
        return found


def _weighted(what: str, weights: Array) -> str:
    if weights.ndim == 2 and (weights != weights[0]).any():
        return f"{what} with weights that depend on time,{span(weights)}"
    return f"{what} with weights {vector(weights[0] if weights.ndim == 2 else weights)}"


def as_cost(cost: Any) -> QuadraticCost | CostSum | None:
    """Return a quadratic cost or a sum, or None if it is neither."""
    if isinstance(cost, _NormCost):
        return CostSum([cost])
    return cost if isinstance(cost, (QuadraticCost, CostSum)) else None
