"""What a problem asks of one component over time or frequency, as lines to draw: references, bounds of rows, masks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.term import Term, TermKind


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
            values = (reference if reference.ndim == 0 else reference[..., index]) * np.ones(length)
            line = Line(np.arange(length, dtype=np.float64), np.where(weighed, values, np.nan))
            if weighed.any() and not any(np.array_equal(line.values, other.values, equal_nan=True) for other in found):
                found.append(line)
    return found


def bounds_of_rows(problem: OptimalControlProblem, index: int, is_state: bool) -> list[Line]:
    """Return the limits of rows that are about this state, or control, alone: of polyhedra, soft boxes, stage rows."""
    found, n = list[Line](), problem.state_dim
    for term in problem.terms:
        if term.penalty.polyhedral and not term.kind.is_cost:
            found += _limits(term, n, problem.control_dim, index if is_state else n + index)
    return found


def mask_levels(
    problem: OptimalControlProblem, kind: TermKind, row: Array | None, other: Array | None = None
) -> list[Line]:
    """Return the limits on the magnitude of the spectrum of C x + D u, of the terms of a kind with these C and D."""
    found = list[Line]()
    for term in problem.terms:
        frequencies = term.map.frequencies
        if term.kind == kind and len(frequencies) and term.map.spectrum_of(row, other):
            levels = term.penalty.bounds(term.shape)[1][:, 0] / term.per_limit
            found.append(Line(frequencies, levels, not term.hard))
    return found


def _weighed(problem: OptimalControlProblem, index: int, is_state: bool) -> Iterator[tuple[Array, Mask]]:
    """Yield references, (), (components,) or one per time, and at which times the deviation of the component counts."""
    horizon, cost = problem.horizon, problem.quadratic
    yield cost.x_ref if is_state else cost.u_ref, _counts(cost, index, is_state, horizon)
    for norm in problem.cost.norms:
        found = norm.references(index, is_state, horizon)
        if found is not None:
            yield found


def _counts(cost: QuadraticCost, index: int, is_state: bool, horizon: int) -> Mask:
    if not is_state:
        weights = np.abs(cost.R[..., index, :]).sum(-1) + np.abs(cost.S[..., :, index]).sum(-1)
        return np.asarray(np.broadcast_to(weights > 0, horizon))
    weights = np.abs(cost.Q[..., index, :]).sum(-1) + np.abs(cost.S[..., index, :]).sum(-1)
    return np.append(np.broadcast_to(weights > 0, horizon), bool(cost.P[index].any()))


def _limits(term: Term, n: int, m: int, column: int) -> Iterator[Line]:
    """Yield the limits of the rows that are about one column of (x_t, u_t) alone."""
    form = term.map.stage_form(n, m)
    if form is None:
        return
    alone = (np.count_nonzero(form[0], axis=-1) == 1) & (form[0][..., column] != 0)
    slopes = np.broadcast_to(np.where(alone, form[0][..., column], 0.0), term.shape)
    distance = term.penalty.bounds(term.shape)[1] - form[1]
    distance = np.where(np.isfinite(distance), distance, np.nan)
    for row in map(int, np.flatnonzero(slopes.any(axis=0))):
        used = slopes[:, row] != 0
        values = np.divide(distance[:, row], slopes[:, row], out=np.full(len(slopes), np.nan), where=used)
        if np.isfinite(values).any():
            yield Line(term.map.places.astype(np.float64), values, not term.hard)
