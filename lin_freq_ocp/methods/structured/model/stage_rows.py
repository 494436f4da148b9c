"""Rows on the state and the control of single times, from boxes and terms, and their places in the stages.

    lower_i <= m_i'(x_t, u_t) + (slacks of time t) <= upper_i,   or rows less their lower limits in second-order cones

A stage has the same number of places at every time: first the single inequalities, then cones by their size. Rows fill
them in their order; what is left over has no limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.structured.model.origin import Origin
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.terms.penalty import ConicForm
from lin_freq_ocp.problem.terms.term import Term

ROUNDING = 1e-12  # of a row that is left without coefficients, relative to its terms
NO_CONES = np.zeros((0, 2), dtype=int)


@dataclass(frozen=True, eq=False)
class StageRowList:
    """Rows of single times one after the other, with their slacks."""

    targets: Indices  # (rows,): the multiplier that a row's dual belongs to; -1: none
    times: Indices  # (rows,)
    matrix: Array  # (rows, n + m)
    slacks: sp.csr_array  # (rows, slacks)
    lower: Array  # (rows,)
    upper: Array  # (rows,)
    rounding: Array  # (rows,), of the limits
    cones: Indices  # (cones, 2): first row, and the one behind the last
    slack_times: Indices  # (slacks,)
    prices: Array  # (slacks,)

    @property
    def alone(self) -> Mask:
        """Return which rows are in no cone."""
        change = np.zeros(len(self.lower) + 1, dtype=int)
        np.add.at(change, self.cones.ravel(), np.tile([1, -1], len(self.cones)))
        return np.cumsum(change[:-1]) == 0

    @property
    def empty(self) -> Mask:
        """Return which rows have no coefficient."""
        return np.asarray(~self.matrix.any(axis=1) & (np.diff(self.slacks.indptr) == 0))


@dataclass(frozen=True, eq=False)
class StagePlaces:
    """Where rows and slacks stand: row ``source`` times ``sign`` at (time, slot), <= its limit or in a cone."""

    source: Indices
    sign: Array
    slot: Indices
    count: int  # of slots of a stage
    cones: tuple[int, ...]  # sizes, of the last slots
    equations: Indices  # rows lower = upper
    slack_slot: Indices  # (slacks,)

    @property
    def slack_count(self) -> int:
        """Return how many slacks a stage has."""
        return int(self.slack_slot.max(initial=-1)) + 1


def joined(parts: Sequence[StageRowList]) -> StageRowList:
    """Return all rows in one list."""
    firsts = np.cumsum([0, *(len(part.lower) for part in parts)])
    return StageRowList(
        np.concatenate([part.targets for part in parts]),
        np.concatenate([part.times for part in parts]),
        np.concatenate([part.matrix for part in parts]),
        _block_diagonal([part.slacks for part in parts]),
        np.concatenate([part.lower for part in parts]),
        np.concatenate([part.upper for part in parts]),
        np.concatenate([part.rounding for part in parts]),
        np.concatenate([part.cones + first for part, first in zip(parts, firsts, strict=False)]),
        np.concatenate([part.slack_times for part in parts]),
        np.concatenate([part.prices for part in parts]),
    )


def box_rows(tube: Box, free: Mask, first: int, origin: Origin, target: int) -> StageRowList:
    """Return the bounds (times, components) where ``free``, on component ``first`` and the following."""
    times, component = np.nonzero(free & (np.isfinite(tube.lower) | np.isfinite(tube.upper)))
    matrix = np.zeros((len(times), origin.values.shape[1]))
    matrix[np.arange(len(times)), first + component] = 1.0
    at = origin.values[times, first + component]
    return StageRowList(
        target + times * free.shape[1] + component,
        times,
        matrix,
        sp.csr_array((len(times), 0)),
        tube.lower[times, component] - at,
        tube.upper[times, component] - at,
        np.zeros(len(times)),
        NO_CONES,
        np.zeros(0, dtype=int),
        np.zeros(0),
    )


def nonnegative_slacks(times: Indices, prices: Array, columns: int) -> StageRowList:
    """Return slacks >= 0 at these times, for rows that couple times."""
    count = len(times)
    return StageRowList(
        np.full(count, -1),
        times,
        np.zeros((count, columns)),
        sp.csr_array(sp.eye_array(count)),
        np.zeros(count),
        np.full(count, np.inf),
        np.zeros(count),
        NO_CONES,
        times,
        prices,
    )


def term_rows(term: Term, stage_form: tuple[Array, Array], origin: Origin, target: int) -> StageRowList:
    """Return the rows of a term of single times, in deviations from the origin."""
    form, positions = term.penalty.conic(*term.shape), term.map.positions
    M, c = stage_form
    group, entry = np.divmod(form.entries, term.shape[1])
    valued = form.entries >= 0
    times, slack_times = _times(term, form, np.where(valued, positions[group], -1))
    matrix = np.where(valued[:, None], M[group if len(M) > 1 else 0, entry], 0.0)
    constant = np.where(valued, c[group, entry], 0.0)
    parts = matrix * origin.values[times]
    at = constant + parts.sum(1)
    matrix = np.where(origin.held[times], 0.0, matrix)
    return StageRowList(
        np.where(valued, target + form.entries, -1),
        times,
        matrix,
        form.slacks,
        form.lower - at,
        form.upper - at,
        ROUNDING * (np.abs(constant) + np.abs(parts).sum(1)),
        cone_rows(form),
        slack_times,
        form.prices,
    )


def cone_rows(form: ConicForm) -> Indices:
    """Return the first row of each cone and the one behind its last, (cones, 2)."""
    return np.array([(cone.start, cone.stop) for cone in form.cones], dtype=int).reshape(-1, 2)


def places(rows: StageRowList) -> StagePlaces:
    """Return where the rows and slacks stand in the stages; rows 0 <= limit that hold, and 0 = 0, are left out."""
    alone, empty = rows.alone, rows.empty
    equal = alone & (rows.lower == rows.upper)
    above = alone & ~equal & np.isfinite(rows.upper) & ~(empty & (rows.upper >= -rows.rounding))
    below = alone & ~equal & np.isfinite(rows.lower) & ~(empty & (rows.lower <= rows.rounding))
    single = np.concatenate([np.flatnonzero(above), np.flatnonzero(below)])
    source, slot = [single], [_ranks(rows.times[single])]
    count, sizes = int(slot[0].max(initial=-1)) + 1, np.diff(rows.cones, axis=1)[:, 0]
    cones: list[int] = []
    for size in np.unique(sizes):
        first = rows.cones[sizes == size, 0]
        rank = _ranks(rows.times[first])
        source.append((first[:, None] + np.arange(size)).ravel())
        slot.append((count + rank[:, None] * size + np.arange(size)).ravel())
        cones += [int(size)] * (int(rank.max()) + 1)
        count += (int(rank.max()) + 1) * int(size)
    sources = np.concatenate(source)
    sign = np.where(np.arange(len(sources)) < int(above.sum()), 1.0, -1.0)
    equations = np.flatnonzero(equal & ~(empty & (np.abs(rows.lower) <= rows.rounding)))
    return StagePlaces(sources, sign, np.concatenate(slot), count, tuple(cones), equations, _ranks(rows.slack_times))


def _block_diagonal(blocks: Sequence[sp.csr_array]) -> sp.csr_array:
    """Return the blocks on a diagonal; ``sp.block_diag`` takes several times as long."""
    columns, entries = (np.cumsum([0, *sizes]) for sizes in zip(*((b.shape[1], b.nnz) for b in blocks), strict=True))
    indices = np.concatenate([block.indices + first for block, first in zip(blocks, columns, strict=False)])
    pointers = [block.indptr[1:] + first for block, first in zip(blocks, entries, strict=False)]
    pointers = np.concatenate([np.zeros(1, dtype=int), *pointers])
    shape = len(pointers) - 1, int(columns[-1])
    return sp.csr_array((np.concatenate([block.data for block in blocks]), indices, pointers), shape=shape)


def _times(term: Term, form: ConicForm, of_values: Indices) -> tuple[Indices, Indices]:
    """Return the time of each row and of each slack, from those of the values in them (-1: no value)."""
    times, cones = of_values.copy(), cone_rows(form)
    in_cones, cone = cone_members(cones)
    of_cones = np.full(len(cones), -1)
    np.maximum.at(of_cones, cone, times[in_cones])
    times[in_cones] = of_cones[cone]
    entries = sp.coo_array(form.slacks)
    row, slack = entries.coords
    slack_times = np.full(form.slacks.shape[1], -1)
    np.maximum.at(slack_times, slack, times[row])
    np.maximum.at(times, row, slack_times[slack])
    split = (of_values >= 0) & (of_values != times)
    if split.any() or (times[row] != slack_times[slack]).any() or (times < 0).any() or (slack_times < 0).any():
        raise UnsupportedError(f"method 'structured': the slacks or cones of {term.name!r} join several times.")
    return times, slack_times


def cone_members(cones: Indices) -> tuple[Indices, Indices]:
    """Return the rows of all cones (first, behind the last), and the cone of each of them."""
    sizes = cones[:, 1] - cones[:, 0]
    cone = np.repeat(np.arange(len(cones)), sizes)
    return np.arange(len(cone)) + np.repeat(cones[:, 0] - np.cumsum(sizes) + sizes, sizes), cone


def _ranks(keys: Indices) -> Indices:
    """Return how many equal keys stand before each."""
    order = np.argsort(keys, kind="stable")
    in_order = keys[order]
    ranks = np.empty(len(keys), dtype=int)
    ranks[order] = np.arange(len(keys)) - np.searchsorted(in_order, in_order)
    return ranks
