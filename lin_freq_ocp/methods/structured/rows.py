"""The rows of a linear program in the structured method: slots of stages, and families of rows that couple times.

Rows on the state and the control of single times are

    lower_i <= m_i'(x_t, u_t) + (slacks of time t) <= upper_i,   or rows less their lower limits in second-order cones.

Every stage has the same number of slots: first for single inequalities, then for cones by their size. Rows fill the
slots in their order; the remaining slots have no limit. The slacks of rows that couple times are spread over the
stages; rows of these stages keep them from being negative.

Rows that couple times are first formulated on all entries of y, and then restricted to the channels
(``restrict_to_channels``); a spectrum stays a spectrum. All rows are in the units of the problem.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.structured.stages import (
    Balls,
    CoupledRows,
    Coupling,
    Equations,
    Inequalities,
    SparseRows,
    SpectrumRows,
)
from lin_freq_ocp.problem.terms.maps import SpectrumForm
from lin_freq_ocp.program.linear_program import LinearProgram, stack_rows
from lin_freq_ocp.program.program_rows import ProgramRows, cone_members


@dataclass(frozen=True, eq=False)
class StageRowList:
    """Rows of single times one after the other; ``slack_times`` are those of all slacks of the program."""

    targets: Indices  # (rows,): the multiplier of the dual of each row; -1: none
    times: Indices  # (rows,)
    matrix: sp.csr_array  # (rows, variables of the program)
    lower: Array  # (rows,)
    upper: Array  # (rows,)
    cones: Indices  # (cones, 2): first row, and the one after the last
    slack_times: Indices  # (slacks,)


def stage_rows(program: LinearProgram, fixed: Mask, absent: Mask) -> StageRowList:
    """Return the rows of single times, without rows 0 = 0 and 0 <= limit that are satisfied.

    ``fixed`` signals (signals,) need no bounds; those that are ``absent`` from the stages have the deviation zero.
    """
    parts = [rows for rows in program.rows if rows.times is not None]
    times, slack_times, loose = list[Indices](), list[Indices](), list[Mask]()
    for rows in program.rows:
        if rows.times is None:
            spread = sum(int(part.sum()) for part in loose) + np.arange(len(rows.prices))
            slack_times.append(spread % (program.problem.horizon + 1))
        else:
            of_rows, of_slacks = _row_times(rows, rows.times)
            times.append(of_rows)
            slack_times.append(of_slacks)
        loose.append(np.full(len(rows.prices), rows.times is None))
    matrix = program.matrix(parts)
    if absent.any():
        matrix.data[np.append(absent, np.zeros(len(program.prices), dtype=bool))[matrix.indices]] = 0.0
        matrix.eliminate_zeros()
    lower, upper = np.concatenate([rows.lower for rows in parts]), np.concatenate([rows.upper for rows in parts])
    firsts = np.cumsum([0, *(len(rows.lower) for rows in parts)])
    cones = np.concatenate([rows.cones + first for rows, first in zip(parts, firsts, strict=False)])
    needed = ~np.concatenate(
        [fixed[rows.entries] if rows.map is None else np.full(len(rows.lower), False) for rows in parts]
    )
    empty = np.diff(matrix.indptr) == 0
    empty[cone_members(cones)[0]] = False
    if empty.any():
        rounding = np.concatenate([rows.rounding(program.origin) for rows in parts])
        needed &= ~(empty & (lower <= rounding) & (upper >= -rounding))
    chosen, numbers = np.flatnonzero(needed), np.cumsum(needed) - 1
    # rows that keep the slacks of rows that couple times from being negative
    of_slacks, slacks = np.concatenate(slack_times), np.flatnonzero(np.concatenate(loose))
    if len(chosen) < len(needed):
        matrix = sp.csr_array(matrix[chosen])
    if len(slacks):
        ones = np.ones(len(slacks)), program.signals + slacks, np.arange(len(slacks) + 1)
        signs = sp.csr_array(ones, shape=(len(slacks), program.variables))
        matrix = stack_rows([(matrix, 0), (signs, 0)], program.variables)
    return StageRowList(
        np.append(np.concatenate([rows.targets for rows in parts])[chosen], np.full(len(slacks), -1)),
        np.append(np.concatenate(times)[chosen], of_slacks[slacks]),
        matrix,
        np.append(lower[chosen], -np.concatenate([rows.origin for rows in program.rows])[slacks]),
        np.append(upper[chosen], np.full(len(slacks), np.inf)),
        cones - cones[:, :1] + numbers[cones[:, :1]],
        of_slacks,
    )


def _row_times(rows: ProgramRows, of_values: Indices) -> tuple[Indices, Indices]:
    """Return the time of each row and of each slack, from those of the values in them (-1: no value)."""
    if not (len(rows.prices) or len(rows.cones)):
        return of_values, np.zeros(0, dtype=int)
    times = of_values.copy()
    in_cones, cone = cone_members(rows.cones)
    of_cones = np.full(len(rows.cones), -1)
    np.maximum.at(of_cones, cone, times[in_cones])
    times[in_cones] = of_cones[cone]
    entries = sp.coo_array(rows.slacks)
    row, slack = entries.coords
    slack_times = np.full(rows.slacks.shape[1], -1)
    np.maximum.at(slack_times, slack, times[row])
    np.maximum.at(times, row, slack_times[slack])
    split = (of_values >= 0) & (of_values != times)
    if split.any() or (times[row] != slack_times[slack]).any() or (times < 0).any() or (slack_times < 0).any():
        raise UnsupportedError(f"method 'structured': the slacks or cones of {rows.name!r} couple several times.")
    return times, slack_times


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
    """Return the slots of the rows and slacks in the stages; equations have none."""
    alone = np.ones(len(rows.lower), dtype=bool)
    alone[cone_members(rows.cones)[0]] = False
    equal = alone & (rows.lower == rows.upper)
    above, below = (alone & ~equal & np.isfinite(limits) for limits in (rows.upper, rows.lower))
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
    slots, equations = np.concatenate(slot), np.flatnonzero(equal)
    return StageSlots(sources, sign, slots, count, tuple(cones), equations, _ranks(rows.slack_times))


def _ranks(keys: Indices) -> Indices:
    """Return the number of equal keys before each key."""
    order = np.argsort(keys, kind="stable")
    in_order = keys[order]
    ranks = np.empty(len(keys), dtype=int)
    ranks[order] = np.arange(len(keys)) - np.searchsorted(in_order, in_order)
    return ranks


Family = Equations | Inequalities | Balls


@dataclass(frozen=True, eq=False)
class CoupledPart:
    """A family of rows, each of them one value times a weight, plus slacks, with the multipliers of the values."""

    family: Family
    targets: Indices  # the multiplier of each entry of the dual, (rows,) or (balls, 1 + dim); -1: none
    weights: Array  # by which each dual counts in its multiplier


@dataclass(frozen=True, eq=False)
class Columns:
    """The positions of the program's variables in y, flat: entry i of time t at t * width + i."""

    positions: Indices  # (variables,)
    size: int  # of y
    width: int

    def of_variables(self, matrix: sp.csr_array) -> sp.csr_array:
        """Return rows on y from rows on the variables of the program."""
        shape = matrix.shape[0], self.size
        return sp.csr_array((matrix.data, self.positions[matrix.indices], matrix.indptr.astype(np.intp)), shape=shape)


def stage_equations(rows: StageRowList, chosen: Indices, columns: Columns) -> CoupledPart:
    """Return the chosen rows of single times as equations."""
    family = Equations(SparseRows(columns.of_variables(rows.matrix[chosen])), rows.lower[chosen])
    return CoupledPart(family, rows.targets[chosen], np.ones(len(chosen)))


def coupled_parts(program: LinearProgram, rows: ProgramRows, columns: Columns) -> Iterator[CoupledPart]:
    """Yield the families of rows that couple times."""
    sparse: sp.csr_array | None = None
    if rows.spectrum is None:
        sparse = columns.of_variables(program.matrix([rows]))
    elif len(rows.prices):  # of a spectrum, the slacks alone are sparse
        sparse = columns.of_variables(program.slack_matrix([rows]))

    def family_rows(chosen: Indices, sign: float = 1.0) -> CoupledRows:
        if rows.spectrum is not None:
            return _spectrum_rows(rows, rows.spectrum, chosen, sign, columns.width)
        assert sparse is not None
        return SparseRows(sp.csr_array(sign * sparse[chosen]))

    weights = np.ones(len(rows.lower)) if rows.weights is None else rows.weights
    # rows that only keep a slack from being negative are rows of stages
    alone = (rows.entries >= 0) | (np.diff(rows.slacks.indptr) != 1) | np.isfinite(rows.upper)
    alone |= rows.lower != -(rows.slacks @ rows.origin)
    alone[cone_members(rows.cones)[0]] = False
    equal = alone & (rows.lower == rows.upper)
    chosen = np.flatnonzero(equal)
    if len(chosen):
        yield CoupledPart(Equations(family_rows(chosen), rows.lower[chosen]), rows.targets[chosen], weights[chosen])
    for sign, limits in ((1.0, rows.upper), (-1.0, -rows.lower)):
        chosen = np.flatnonzero(alone & ~equal & np.isfinite(limits))
        if len(chosen):
            family = Inequalities(family_rows(chosen, sign), limits[chosen])
            yield CoupledPart(family, rows.targets[chosen], sign * weights[chosen])
    sizes = rows.cones[:, 1] - rows.cones[:, 0]
    for size in np.unique(sizes):
        members = rows.cones[sizes == size, :1] + np.arange(size)
        radius, offset = -rows.lower[members[:, 0]], -rows.lower[members[:, 1:]]
        if rows.spectrum is not None and (rows.entries[members[:, 0]] >= 0).any():
            raise _unfit_error(rows)
        heads = None if sparse is None else sp.csr_array(sparse[members[:, 0]])
        of_slacks = SparseRows(heads) if heads is not None and heads.nnz else None
        ball = Balls(family_rows(members[:, 1:].ravel()), radius, of_slacks, offset)
        yield CoupledPart(ball, rows.targets[members], -weights[members])


def _spectrum_rows(rows: ProgramRows, form: SpectrumForm, chosen: Indices, sign: float, width: int) -> SpectrumRows:
    """Return chosen rows times a sign as a spectrum of signals on y."""
    entries = rows.entries[chosen]
    if (entries < 0).any() or (np.diff(entries) <= 0).any() or np.diff(rows.slacks.indptr)[chosen].any():
        raise _unfit_error(rows)
    kept, scale = np.zeros(len(form.kept), dtype=bool), np.ones(len(form.kept))
    kept[np.flatnonzero(form.kept)[entries]] = True
    if rows.weights is not None:
        scale[kept] = rows.weights[chosen]
    used = kept.reshape(-1, 2).any(axis=1)
    row = np.append(sign * form.row, np.zeros(width - len(form.row)))
    # weights of (Re, Im) are equal
    return SpectrumRows(row, form.window, form.points, form.bins[used], scale[0::2][used], kept[np.repeat(used, 2)])


def _unfit_error(rows: ProgramRows) -> UnsupportedError:
    return UnsupportedError(f"method 'structured': {rows.name!r} is not a stop band, mask or energy of a spectrum.")


def restrict_to_channels(
    parts: Sequence[CoupledPart], width: int, terminal: Indices, terminal_state: Array
) -> Coupling:
    """Return all parts on the channels: the entries of y that they depend on."""
    used = np.zeros(width, dtype=bool)
    for part in parts:
        used |= part.family.used(width)
    families = [part.family.narrowed(used) for part in parts]
    return Coupling(
        np.flatnonzero(used),
        terminal,
        terminal_state,
        tuple(family for family in families if isinstance(family, Equations)),
        tuple(family for family in families if isinstance(family, Inequalities)),
        tuple(family for family in families if isinstance(family, Balls)),
    )
