"""What a problem asks of one component over time or frequency, as lines to draw: references, bounds of rows, masks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.problem.costs.norms import CostSum
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.maps import SpectrumMap, StageMap
from lin_freq_ocp.problem.terms.penalties import Below, Norm
from lin_freq_ocp.problem.terms.term import Term


@dataclass(frozen=True, eq=False)
class Line:
    """Values over times (in steps) or frequencies (in rad/sample), both (points,); not a number where there are none.

    Attributes
    ----------
    soft : bool
        Whether it may be left at a price.
    """

    at: Array
    values: Array
    soft: bool = False


def references(problem: OptimalControlProblem, index: int, is_state: bool) -> list[Line]:
    """Return the references that a cost weighs the deviation of a state, or control, from; none where all are zero."""
    length = problem.horizon + 1 if is_state else problem.horizon
    found = list[Line]()
    for reference, weighed in _weighed(problem, index, is_state):
        if reference.any():
            values = reference[..., index] * np.ones(length)
            line = Line(np.arange(length, dtype=np.float64), np.where(weighed, values, np.nan))
            if weighed.any() and not any(np.array_equal(line.values, other.values, equal_nan=True) for other in found):
                found.append(line)
    return found


def bounds_of_rows(problem: OptimalControlProblem, index: int, is_state: bool) -> list[Line]:
    """Return the limits of rows that are about this state, or control, alone: of polyhedra, soft boxes, stage rows."""
    found = list[Line]()
    for term in problem.terms:
        if isinstance(term.map, StageMap) and isinstance(term.penalty, Below) and not term.kind.endswith("cost"):
            found += _limits(term, term.map, term.penalty, index, is_state)
    return found


def mask_levels(problem: OptimalControlProblem, kind: str, row: Array | None, other: Array | None = None) -> list[Line]:
    """Return the limits on the magnitude of the spectrum of C x + D u, of the terms of a kind with these C and D."""
    found = list[Line]()
    for term in problem.terms:
        of = term.map
        if term.kind == kind and isinstance(of, SpectrumMap) and isinstance(term.penalty, Norm) and not of.together:
            if same_row(of.C, row) and same_row(of.D, other):
                levels = np.broadcast_to(term.penalty.radius, of.bins.shape) / term.per_limit
                found.append(Line(2 * np.pi * of.bins / of.points, levels, not term.hard))
    return found


def _weighed(problem: OptimalControlProblem, index: int, is_state: bool) -> Iterator[tuple[Array, Array]]:
    """Yield references, (components,) or one per time, and at which times the deviation of the component counts."""
    horizon, cost = problem.horizon, problem.quadratic
    yield cost.x_ref if is_state else cost.u_ref, _counts(cost, index, is_state, horizon)
    for norm in problem.cost.norms if isinstance(problem.cost, CostSum) else ():
        stage = np.broadcast_to(_own(norm.x if is_state else norm.u, index) != 0, horizon)
        end = [bool(_own(norm.terminal, index))] if is_state else []
        reference = norm.x_ref if is_state else norm.u_ref
        size = problem.state_dim if is_state else problem.control_dim
        yield reference if reference.ndim else np.full(size, reference), np.append(stage, end).astype(bool)


def _counts(cost: QuadraticCost, index: int, is_state: bool, horizon: int) -> Array:
    if not is_state:
        weights = np.abs(cost.R[..., index, :]).sum(-1) + np.abs(cost.S[..., :, index]).sum(-1)
        return np.asarray(np.broadcast_to(weights > 0, horizon))
    weights = np.abs(cost.Q[..., index, :]).sum(-1) + np.abs(cost.S[..., index, :]).sum(-1)
    return np.append(np.broadcast_to(weights > 0, horizon), bool(cost.P[index].any()))


def _own(weights: Array, index: int) -> Array:
    """Return the weight of a component, () or (times,), of one for all, one each, or one each per time."""
    return weights if weights.ndim == 0 else weights[..., index]


def _limits(term: Term, of: StageMap, below: Below, index: int, is_state: bool) -> Iterator[Line]:
    own, other = (of.C, of.D) if is_state else (of.D, of.C)
    if own is None:
        return
    alone = np.count_nonzero(own, axis=-1) == 1
    if other is not None:
        alone = alone & ~other.any(axis=-1)
    coefficients = np.where(alone, own[..., index], 0.0)
    sloped = np.broadcast_to(coefficients, term.shape)
    distance = np.broadcast_to(below.limit, term.shape) - np.broadcast_to(of.constant, term.shape)
    distance = np.where(np.isfinite(distance), distance, np.nan)
    for row in map(int, np.flatnonzero(sloped.any(axis=0))):
        used = sloped[:, row] != 0
        values = np.divide(distance[:, row], sloped[:, row], out=np.full(len(sloped), np.nan), where=used)
        if np.isfinite(values).any():
            yield Line(of.times.astype(np.float64), values, not term.hard)


def same_row(one: Array | None, other: Array | None) -> bool:
    """Whether both are the same coefficients, or none."""
    return one is other or (one is not None and other is not None and bool(np.array_equal(one, other)))
