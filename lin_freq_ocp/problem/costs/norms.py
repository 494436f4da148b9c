"""Nonsmooth costs: sums of absolute values and largest absolute values, and their sums with a quadratic cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, Mask, assign, brief, to_shape, with_columns
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.names import ByName, arrays_or_names, fields_by_name
from lin_freq_ocp.base.phrases import datum, join_words, span, vector
from lin_freq_ocp.problem.costs.quadratic import NonsmoothCost
from lin_freq_ocp.problem.terms.maps import StageMap
from lin_freq_ocp.problem.terms.penalties import NormBall
from lin_freq_ocp.problem.terms.term import Term, TermKind


@dataclass(frozen=True, eq=False, init=False)
class _NormCost(NonsmoothCost):
    """The base of L1Cost and LInfCost: weights of deviations from references."""

    x: Array
    u: Array
    terminal: Array
    x_ref: Array
    u_ref: Array
    kind: ClassVar[str]
    order: ClassVar[float]

    def __init__(
        self,
        x: ArrayLike | ByName = 0.0,
        u: ArrayLike | ByName = 0.0,
        terminal: ArrayLike | ByName = 0.0,
        x_ref: ArrayLike | ByName = 0.0,
        u_ref: ArrayLike | ByName = 0.0,
    ):
        values = {"x": x, "u": u, "terminal": terminal, "x_ref": x_ref, "u_ref": u_ref}
        arrays = arrays_or_names(type(self).__name__, values)
        for field in ("x", "u", "terminal"):
            weights = arrays[field]
            if not isinstance(weights, Mapping) and (weights < 0).any():
                raise ProblemError(f"{type(self).__name__}.{field}", brief(values[field]), "weights of zero or above")
        assign(self, **arrays)

    def describe(self) -> str:
        weighted = (("states", self.x), ("controls", self.u), ("terminal state", self.terminal))
        parts = list[str]()
        for what, weights in weighted:
            if weights.ndim == 2 and (weights != weights[0]).any():
                parts.append(f"{what} with weights that depend on time,{span(weights)}")
            elif weights.any():
                parts.append(f"{what} with weights {vector(weights[0] if weights.ndim == 2 else weights)}")
        if not parts:
            return ""
        used = {"x_ref": self.x.any() or self.terminal.any(), "u_ref": self.u.any()}
        stated = {"x_ref": self.x_ref, "u_ref": self.u_ref}
        references = [datum(name, values, 1) for name, values in stated.items() if used[name] and values.any()]
        deviations = f" of deviations from {join_words(references)}" if references else ""
        return f"{self.kind}{deviations} at each time: {join_words(parts)}"

    def at_names(self, states: Sequence[str], controls: Sequence[str]) -> Self:
        names = {"x": states, "u": controls, "terminal": states, "x_ref": states, "u_ref": controls}
        fields = {field: getattr(self, field) for field in names}
        return type(self)(**fields | fields_by_name(type(self).__name__, self, names))

    def augmented(self, n: int, k: int) -> Self:
        x, terminal, x_ref = (
            with_columns(np.full(n, values) if values.ndim == 0 else values, k)
            for values in (self.x, self.terminal, self.x_ref)
        )
        return type(self)(x, self.u, terminal, x_ref, self.u_ref)

    def translated(self, origin: Array) -> Self:
        return type(self)(self.x, self.u, self.terminal, self.x_ref - origin, self.u_ref)

    def references(self, index: int, is_state: bool, horizon: int) -> tuple[Array, Mask]:
        weights, reference = (self.x, self.x_ref) if is_state else (self.u, self.u_ref)
        end = [_component(self.terminal, index) != 0] if is_state else []
        counts = np.append(np.broadcast_to(_component(weights, index) != 0, horizon), end).astype(bool)
        return reference, counts

    def own_terms(self, n: int, m: int, horizon: int, field: str, name: str) -> list[Term]:
        T, arrays = horizon, dict[str, Array]()
        shapes = {"x": (n, T), "u": (m, T), "terminal": (n, None), "x_ref": (n, T + 1), "u_ref": (m, T)}
        for entry, (size, times) in shapes.items():
            value: Array = getattr(self, entry)
            complete = np.full(size, value) if value.ndim == 0 else value
            arrays[entry] = to_shape(f"{field}.{entry}", complete, (size,), times)
        x, u, terminal, x_ref, u_ref = arrays.values()
        x_ref, u_ref = np.broadcast_to(x_ref, (T + 1, n)), np.broadcast_to(u_ref, (T, m))
        norm, stages = NormBall(self.order, np.zeros(()), np.ones(())), np.arange(T)
        terms: list[Term] = []
        for weights, reference, times, kind, of_state, signal in (
            (x, x_ref[:-1], stages, TermKind.STAGE_COST, True, "states"),
            (u, u_ref, stages, TermKind.STAGE_COST, False, "controls"),
            (terminal, x_ref[-1:], np.array([T]), TermKind.TERMINAL_COST, True, "terminal state"),
        ):
            if weights.any():
                scale = weights[..., None] * np.eye(weights.shape[-1])
                matrices = (scale, None) if of_state else (None, scale)
                terms.append(Term(f"{name} of {signal}", kind, StageMap(times, *matrices, -weights * reference), norm))
        return terms


class L1Cost(_NormCost):
    """sum_{t<T} sum_i x_i |x_t,i - x_ref,i| + sum_j u_j |u_t,j - u_ref,j|, plus sum_i terminal_i |x_T,i - x_ref,i|.

    A weight on u makes controls sparse: zero at most times.

    Parameters
    ----------
    x : float, (n,) or (T, n); u : float, (m,) or (T, m); terminal : float or (n,)
        Weights, zero or above; a number stands for all components, a mapping has weights by their names.
    x_ref : float, (n,) or (T+1, n); u_ref : float, (m,) or (T, m)
        References.

    Raises
    ------
    ProblemError
        If a weight is below zero, or a shape does not fit the problem.

    Examples
    --------
    >>> cost = lfo.QuadraticCost(Q=1.0) + lfo.costs.L1Cost(u=[0.1, 0.2])
    >>> [norm.label for norm in cost.norms]
    ['L1 cost']
    """

    label = "L1 cost"
    kind = "the sum of absolute values"
    order = 1


class LInfCost(_NormCost):
    """sum_{t<T} max_i x_i |x_t,i - x_ref,i| + max_j u_j |u_t,j - u_ref,j|, plus max_i terminal_i |x_T,i - x_ref,i|.

    Parameters
    ----------
    x, u, terminal, x_ref, u_ref
        As for ``L1Cost``.

    Examples
    --------
    >>> lfo.costs.LInfCost(u=1.0).describe()
    'the largest absolute value at each time: controls with weights 1'
    """

    label = "Linf cost"
    kind = "the largest absolute value"
    order = np.inf


def _component(values: Array, index: int) -> Array:
    """Return the entry of a component, () or (times,), from a number for all, one entry each, or these per time."""
    return values if values.ndim == 0 else values[..., index]
