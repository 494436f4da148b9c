"""Rows that couple times, in a problem's own units: stop bands, and the terms of spectra and of several times.

Rows are on all entries of y at first, and on the channels only in the end (``on_channels``). A spectrum stays one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.structured.model.coupling import (
    Balls,
    Coupling,
    Equations,
    Inequalities,
    Rows,
    SparseRows,
    SpectrumRows,
)
from lin_freq_ocp.methods.structured.model.stage_rows import cone_members, cone_rows
from lin_freq_ocp.problem.terms.maps import SpectrumForm
from lin_freq_ocp.problem.terms.penalty import ConicForm
from lin_freq_ocp.problem.terms.term import Term

Family = Equations | Inequalities | Balls


@dataclass(frozen=True, eq=False)
class CoupledPart:
    """A family of rows, each ``sign`` times one value, plus slacks, with the multipliers of these values (-1: none)."""

    family: Family
    targets: Indices  # one for each entry of its dual: rows, or (balls, 1 + dim)
    sign: float = 1.0


@dataclass(frozen=True, eq=False)
class Columns:
    """Where signals stand in y, flat: entry i of time t at t * width + i."""

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
        right = -rows.forward(_padded(reference, width)[:, :, None])[:, 0]
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
    alone = ~signs(form)
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


def signs(form: ConicForm) -> Mask:
    """Return which rows say only that a slack is not negative."""
    single = (form.entries < 0) & (np.diff(form.slacks.indptr) == 1) & (form.lower == 0) & np.isinf(form.upper)
    single[cone_members(cone_rows(form))[0]] = False
    return single


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
        tuple(replace(one, rows=one.rows.narrowed(used)) for one in families if isinstance(one, Equations)),
        tuple(replace(one, rows=one.rows.narrowed(used)) for one in families if isinstance(one, Inequalities)),
        tuple(
            replace(one, rows=one.rows.narrowed(used), heads=None if one.heads is None else one.heads.narrowed(used))
            for one in families
            if isinstance(one, Balls)
        ),
    )


def _spectrum(form: SpectrumForm, kept: Mask, width: int) -> SpectrumRows:
    row = np.append(form.row, np.zeros(width - len(form.row)))
    return SpectrumRows(row, form.window, form.points, form.bins, np.ones(len(form.bins)), kept)


def _padded(reference: Array, width: int) -> Array:
    return np.pad(reference, ((0, 0), (0, width - reference.shape[1])))
