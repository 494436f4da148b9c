"""The rows of a problem: boxes, stop bands and terms, of single times and of several.

Rows on the state and the control of single times are

    lower_i <= m_i'(x_t, u_t) + (slacks of time t) <= upper_i,   or rows less their lower limits in second-order cones.

A stage has the same number of slots at every time: first the single inequalities, then cones by their size. Rows fill
them in their order; the slots that remain have no limit.

Rows that couple times are on all entries of y at first, and on the channels only in the end (``on_channels``); a
spectrum stays a spectrum. All are in the problem's own units.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.structured.recovery import Origin
from lin_freq_ocp.methods.structured.stages import (
    Balls,
    Coupling,
    Equations,
    Inequalities,
    Rows,
    SparseRows,
    SpectrumRows,
)
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.terms.maps import SpectrumForm
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
    cones: Indices  # (cones, 2): first row, and the one after the last
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
    times, slack_times = _row_times(term, form, np.where(valued, positions[group], -1))
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


def _row_times(term: Term, form: ConicForm, of_values: Indices) -> tuple[Indices, Indices]:
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


def concatenate_rows(parts: Sequence[StageRowList]) -> StageRowList:
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


def _block_diagonal(blocks: Sequence[sp.csr_array]) -> sp.csr_array:
    """Return the blocks on a diagonal; ``sp.block_diag`` takes several times as long."""
    columns, entries = (np.cumsum([0, *sizes]) for sizes in zip(*((b.shape[1], b.nnz) for b in blocks), strict=True))
    indices = np.concatenate([block.indices + first for block, first in zip(blocks, columns, strict=False)])
    pointers = [block.indptr[1:] + first for block, first in zip(blocks, entries, strict=False)]
    pointers = np.concatenate([np.zeros(1, dtype=int), *pointers])
    shape = len(pointers) - 1, int(columns[-1])
    return sp.csr_array((np.concatenate([block.data for block in blocks]), indices, pointers), shape=shape)


@dataclass(frozen=True, eq=False)
class StageSlots:
    """The slots of rows and slacks: row ``source`` times ``sign`` at (time, slot), <= its limit or in a cone."""

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


def assign_slots(rows: StageRowList) -> StageSlots:
    """Return the slots of the rows and slacks in the stages; satisfied rows 0 <= limit, and 0 = 0, have none."""
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
    return StageSlots(sources, sign, np.concatenate(slot), count, tuple(cones), equations, _ranks(rows.slack_times))


def _ranks(keys: Indices) -> Indices:
    """Return how many equal keys stand before each."""
    order = np.argsort(keys, kind="stable")
    in_order = keys[order]
    ranks = np.empty(len(keys), dtype=int)
    ranks[order] = np.arange(len(keys)) - np.searchsorted(in_order, in_order)
    return ranks


Family = Equations | Inequalities | Balls


@dataclass(frozen=True, eq=False)
class CoupledPart:
    """A family of rows, each ``sign`` times one value, plus slacks, with the multipliers of these values (-1: none)."""

    family: Family
    targets: Indices  # one for each entry of its dual: rows, or (balls, 1 + dim)
    sign: float = 1.0


@dataclass(frozen=True, eq=False)
class Columns:
    """The positions of signals in y, flat: entry i of time t at t * width + i."""

    times: int  # T + 1
    states: int
    controls: int
    width: int

    def of_signals(self, matrix: sp.csr_array) -> sp.csr_array:
        """Return rows on y from rows on x_0 .. x_T, u_0 .. u_{T-1}."""
        last, column = self.times * self.states, matrix.indices.astype(np.intp)
        of_x = column // self.states * self.width + column % self.states
        u = column - last
        of_u = u // self.controls * self.width + self.states + u % self.controls
        return self.rows(matrix.data, np.where(column < last, of_x, of_u), matrix.indptr.astype(np.intp))

    def of_stages(self, times: Indices, matrix: Array, slacks: sp.csr_array, slack_columns: Indices) -> sp.csr_array:
        """Return rows on y from rows (rows, n + m) on single times and their slacks."""
        row, entry = np.nonzero(matrix)
        shape = len(matrix), self.times * self.width
        signals = sp.csr_array((matrix[row, entry], (row, times[row] * self.width + entry)), shape=shape)
        return sp.csr_array(signals + self.of_slacks(slacks, slack_columns))

    def of_slacks(self, slacks: sp.csr_array, slack_columns: Indices) -> sp.csr_array:
        """Return rows on y from rows on slacks that stand in these columns."""
        return self.rows(slacks.data, slack_columns[slacks.indices], slacks.indptr.astype(np.intp))

    def rows(self, data: Array, indices: Indices, pointers: Indices) -> sp.csr_array:
        """Return rows on y."""
        return sp.csr_array((data, indices, pointers), shape=(len(pointers) - 1, self.times * self.width))


def stopped_parts(stop: Mask, length: int, first: int, reference: Array, width: int, target: int) -> list[CoupledPart]:
    """Return the equations of the stopped bins (bins, components) of components ``first`` and the following.

    From ``target`` on come the multipliers of (Re, Im) of every bin of each component.
    """
    parts: list[CoupledPart] = []
    for j in np.flatnonzero(stop.any(axis=0)):
        row = np.eye(1, width, first + int(j))[0]
        bins = np.flatnonzero(stop[:, j])
        form = SpectrumForm(row, np.ones(length), length, bins, np.ones(2 * len(bins), dtype=bool))
        rows = _spectrum(form, ~form.zero, width)
        signals = np.pad(reference, ((0, 0), (0, width - reference.shape[1])))
        right = -rows.forward(signals[:, :, None])[:, 0]
        pairs = (2 * bins[:, None] + [0, 1]).ravel()[rows.kept]
        parts.append(CoupledPart(Equations(rows, right), target + int(j) * 2 * len(stop) + pairs))
    return parts


def term_parts(term: Term, columns: Columns, slack_columns: Indices, at: Array, target: int) -> Iterator[CoupledPart]:
    """Yield the parts of a term; its slacks stand in these columns, and at y = 0 its values are ``at``."""
    form = term.penalty.conic(*term.shape)
    targets = np.where(form.entries >= 0, target + form.entries, -1)
    select = _Selection(term, form, columns, slack_columns)
    shift = np.where(form.entries >= 0, at.ravel()[form.entries], 0.0)
    lower, upper, cones = form.lower - shift, form.upper - shift, cone_rows(form)
    # rows that say only that a slack is not negative are rows of stages
    alone = (form.entries >= 0) | (np.diff(form.slacks.indptr) != 1) | (form.lower != 0) | np.isfinite(form.upper)
    alone[cone_members(cones)[0]] = False
    equal = alone & (form.lower == form.upper)
    rows = np.flatnonzero(equal & ~(select.empty & (lower == 0)))
    if len(rows):
        yield CoupledPart(Equations(select.rows(rows), lower[rows]), targets[rows])
    for sign, limits in ((1.0, upper), (-1.0, -lower)):
        rows = np.flatnonzero(alone & ~equal & np.isfinite(limits))
        if len(rows):
            yield CoupledPart(Inequalities(select.rows(rows, sign), limits[rows]), targets[rows], sign)
    sizes = cones[:, 1] - cones[:, 0]
    for size in np.unique(sizes):
        members = cones[sizes == size, :1] + np.arange(size)
        values = members[:, 1:].ravel()
        ball = Balls(select.rows(values), -lower[members[:, 0]], select.heads(members[:, 0]), -lower[members[:, 1:]])
        yield CoupledPart(ball, targets[members], -1.0)


class _Selection:
    """Rows of the conic form of a term, as a spectrum or sparse."""

    def __init__(self, term: Term, form: ConicForm, columns: Columns, slack_columns: Indices):
        n, m = columns.states, columns.controls
        self._name, self._form, self._width = term.name, form, columns.width
        self._spectrum = term.map.spectrum_form(n, m)
        self._slacks = columns.of_slacks(form.slacks, slack_columns)
        no_slack = np.diff(form.slacks.indptr) == 0
        if self._spectrum is not None:
            self._places = np.flatnonzero(self._spectrum.kept)
            self.empty = no_slack & (self._spectrum.zero[self._places[form.entries]] | (form.entries < 0))
            return
        L = columns.of_signals(term.map.rows(columns.times - 1, n, m)[0])
        valued = np.flatnonzero(form.entries >= 0)
        chosen = sp.csr_array(
            (np.ones(len(valued)), (valued, form.entries[valued])), shape=(len(form.entries), L.shape[0])
        )
        self._matrix = sp.csr_array(chosen @ L + self._slacks)
        self.empty = np.diff(self._matrix.indptr) == 0

    def rows(self, rows: Indices, sign: float = 1.0) -> Rows:
        if self._spectrum is None:
            return SparseRows(sp.csr_array(sign * self._matrix[rows]))
        entries = self._form.entries[rows]
        if (entries < 0).any() or (np.diff(entries) <= 0).any() or self._slacks[rows].nnz:
            raise UnsupportedError(f"method 'structured': {self._name!r} is no band, mask or energy of a spectrum.")
        kept = np.zeros(len(self._spectrum.kept), dtype=bool)
        kept[self._places[entries]] = True
        used = kept.reshape(-1, 2).any(axis=1)
        form = replace(self._spectrum, bins=self._spectrum.bins[used], row=sign * self._spectrum.row)
        return _spectrum(form, kept[np.repeat(used, 2)], self._width)

    def heads(self, rows: Indices) -> Rows | None:
        if self._spectrum is not None and (self._form.entries[rows] >= 0).any():
            raise UnsupportedError(f"method 'structured': {self._name!r} is no band, mask or energy of a spectrum.")
        matrix = sp.csr_array((self._slacks if self._spectrum is not None else self._matrix)[rows])
        return SparseRows(matrix) if matrix.nnz else None


def _spectrum(form: SpectrumForm, kept: Mask, width: int) -> SpectrumRows:
    row = np.append(form.row, np.zeros(width - len(form.row)))
    return SpectrumRows(row, form.window, form.points, form.bins, np.ones(len(form.bins)), kept)


def on_channels(parts: Sequence[CoupledPart], width: int, terminal: Indices, terminal_state: Array) -> Coupling:
    """Return all parts on the entries of y that they depend on."""
    families = [part.family for part in parts]
    used = np.zeros(width, dtype=bool)
    for family in families:
        used |= family.rows.used(width)
        if isinstance(family, Balls) and family.heads is not None:
            used |= family.heads.used(width)
    return Coupling(
        np.flatnonzero(used),
        terminal,
        terminal_state,
        tuple(replace(part, rows=part.rows.narrowed(used)) for part in families if isinstance(part, Equations)),
        tuple(replace(part, rows=part.rows.narrowed(used)) for part in families if isinstance(part, Inequalities)),
        tuple(
            replace(part, rows=part.rows.narrowed(used), heads=part.heads and part.heads.narrowed(used))
            for part in families
            if isinstance(part, Balls)
        ),
    )


def cone_rows(form: ConicForm) -> Indices:
    """Return the first row of each cone and the one after its last, (cones, 2)."""
    return np.array([(cone.start, cone.stop) for cone in form.cones], dtype=int).reshape(-1, 2)


def cone_members(cones: Indices) -> tuple[Indices, Indices]:
    """Return the rows of all cones (first, after the last), and the cone of each of them."""
    sizes = cones[:, 1] - cones[:, 0]
    cone = np.repeat(np.arange(len(cones)), sizes)
    return np.arange(len(cone)) + np.repeat(cones[:, 0] - np.cumsum(sizes) + sizes, sizes), cone
