"""The rows of mode relaxations (see relaxation.py), and what their duals prove stage by stage.

A template has all rows that a family of programs may have; each member takes some of them. Rows come in groups, one for
each time and mode, all of a kind having the same size: so a member is chosen by masks and assembled by a few vector
operations. A search over modes asks for thousands of programs that differ in little.

Duals prove the least Lagrangian of every mode over its box. With eta of the links, lambda >= 0 of the regions and rho
of the rows F over all times, in natural units y = (x, u),

    phi_ti = min over box_ti of  c_t(y) + <eta_{t-1}, x> - <eta_t, maps y + offsets> + <rho, F_t y> + <lambda, G y - h>,
    J within the mask >= sum_t min_i phi_ti + phi_T - <rho, right>,

be the duals those of a solution or not. Mode i at t alone is above this by phi_ti - min_j phi_tj.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TypeVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.polyhedra import box_minimiser
from lin_freq_ocp.problem.hybrid.forms import piecewise_affine
from lin_freq_ocp.problem.hybrid.mode_reach import Reach
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.program.linear_program import signal_columns

Scalar = TypeVar("Scalar", bound=np.generic)


class Sense(Enum):
    """Kinds of rows: A z = b, A z <= b, or A z - b in a second-order cone."""

    EQUATION = 0
    INEQUALITY = 1
    CONE = 2


@dataclass(frozen=True, eq=False)
class Groups:
    """The groups of one kind: ``rows`` (groups, size) of the template, all in turn, and so their ``entries``."""

    rows: Indices
    entries: Indices

    def take(self, rows: Mask, chosen: Mask, within: Mask | None = None) -> None:
        """Choose ``rows`` in the ``chosen`` groups (any shape of as many), of their rows only those ``within``."""
        own = self.of(rows)
        own[:] = chosen.reshape(-1, 1)
        if within is not None:
            own &= within.reshape(own.shape)

    def of(self, rows: NDArray[Scalar]) -> NDArray[Scalar]:
        """Return what belongs to these groups, (groups, size), as a view."""
        return _view(rows, self.rows)

    def coefficients(self, values: Array) -> Array:
        """Return the coefficients of these groups, (groups, entries), as a view."""
        return _view(values, self.entries)


def _view(whole: NDArray[Scalar], places: Indices) -> NDArray[Scalar]:
    first = int(places[0, 0]) if places.size else 0
    return whole[first : first + places.size].reshape(places.shape)


@dataclass(frozen=True, eq=False)
class StandardRows:
    """The rows of a standard form (``LinearProgram.sparse``), from ``row`` of the template with these signs."""

    A: sp.csc_array
    b: Array
    equations: int
    inequalities: int
    row: Indices
    sign: Array


class RowTemplate:
    """Rows of every ``Sense``, collected kind by kind."""

    def __init__(self):
        self._rows: list[Indices] = []
        self._columns: list[Indices] = []
        self._values: list[Array] = []
        self._right: list[Array] = []
        self._senses: list[Indices] = []
        self._count = self._filled = 0

    def add(self, sense: Sense, right: Array, *entries: tuple[Indices, Indices, Array | float]) -> Groups:
        """Add groups of rows with right-hand sides b (..., size).

        Entries are the rows of coefficients within a group, (c,), their columns (..., c) and values. A value of zero is
        left out of members that do not replace it.
        """
        size = right.shape[-1]
        groups = int(np.prod(right.shape[:-1]))
        row = np.concatenate([part[0] for part in entries])
        column = np.concatenate([part[1] for part in entries], axis=-1).reshape(groups, -1)
        values = [np.broadcast_to(value, columns.shape) for _, columns, value in entries]
        value = np.concatenate(values, axis=-1).reshape(groups, -1)
        rows = self._count + np.arange(groups * size).reshape(groups, size)
        positions = self._filled + np.arange(value.size).reshape(value.shape)
        self._rows.append(rows[:, row].ravel())
        self._columns.append(column.ravel())
        self._values.append(value.ravel())
        self._right.append(right.ravel())
        self._senses.append(np.full(right.size, sense.value))
        self._count += right.size
        self._filled += value.size
        return Groups(rows, positions)

    def finished(self, columns: int) -> Assembler:
        """Return what makes members of it."""
        row, column, senses = (np.concatenate(part) for part in (self._rows, self._columns, self._senses))
        return Assembler(row, column, np.concatenate(self._values), np.concatenate(self._right), senses, columns)


class Assembler:
    """A finished template, which keeps its entries in the order of standard forms."""

    def __init__(self, row: Indices, column: Indices, values: Array, right: Array, senses: Indices, columns: int):
        self.values, self.right, self.columns = values, right, columns
        self._rows = np.argsort(senses, kind="stable")  # equations, inequalities, cones
        self._ends = np.searchsorted(senses[self._rows], [Sense.INEQUALITY.value, Sense.CONE.value])
        place = np.argsort(self._rows)[row]
        self._order = np.lexsort((place, column))
        self._place, self._column = place[self._order], column[self._order]
        self._row_sign = np.where(senses[self._rows] == Sense.CONE.value, -1.0, 1.0)
        self._sign = self._row_sign[self._place]

    def member(self, rows: Mask, columns: Mask, values: Array, right: Array) -> StandardRows:
        """Return the standard form of some rows and columns, from all coefficients in the order they were added."""
        taken = rows[self._rows]
        kept = np.flatnonzero(taken)
        numbers = np.cumsum(taken, dtype=np.int32) - np.int32(1)
        data = values[self._order]
        keep = np.flatnonzero(taken[self._place] & columns[self._column] & (data != 0))
        counts = np.bincount(self._column[keep], minlength=self.columns)[columns]
        pointers = np.append(np.int32(0), np.cumsum(counts, dtype=np.int32))
        A = sp.csc_array(
            (data[keep] * self._sign[keep], numbers[self._place[keep]], pointers), shape=(len(kept), len(counts))
        )
        row, sign = self._rows[kept], self._row_sign[kept]
        equations, unequal = (int(end) for end in np.searchsorted(kept, self._ends))
        return StandardRows(A, sign * right[row], equations, unequal - equations, row, sign)


ZERO_CURVATURE = 1e-12  # eigenvalues of a stage's Hessian below this part of the largest are zero


@dataclass(frozen=True, eq=False)
class ModeStages:
    """All modes in y = (x - x_ref, u - u_ref) / units, of k = n + m components.

    Attributes
    ----------
    units : (k,), references : (T, k), last_reference : (n,)
    maps : (T, modes, n, k), offsets : (T, modes, n)
        The next state, in deviations and units, is maps y + offsets.
    rows : (T, modes, r, k), limits : (T, modes, r), norms : (T, modes, r)
        Regions; each row was divided by ``norms``.
    """

    units: Array
    references: Array
    last_reference: Array
    maps: Array
    offsets: Array
    rows: Array
    limits: Array
    norms: Array

    def scaled(self, bounds: Array) -> Array:
        """Return bounds (T, modes, k) of (x_t, u_t) as bounds of y."""
        return (bounds - self.references[:, None]) / self.units


def mode_stages(problem: OptimalControlProblem, units: Array) -> ModeStages:
    """Return the modes in units (k,) of states and controls."""
    T, n = problem.horizon, problem.state_dim
    arrays, cost = piecewise_affine(problem).arrays(T), problem.quadratic
    states = np.broadcast_to(cost.x_ref, (T + 1, n))
    references = np.hstack([states[:-1], np.broadcast_to(cost.u_ref, (T, problem.control_dim))])
    offsets = np.einsum("tijk,tk->tij", arrays.maps, references) + arrays.offset - states[1:, None]
    limits = arrays.h - np.einsum("tirk,tk->tir", arrays.rows, references)
    norms = np.linalg.norm(arrays.rows * units, axis=-1)
    norms = np.where(norms > 0, norms, 1.0)
    return ModeStages(
        units=units,
        references=references,
        last_reference=states[-1],
        maps=arrays.maps * units / units[:n, None],
        offsets=offsets / units[:n],
        rows=arrays.rows * units / norms[..., None],
        limits=limits / norms,
        norms=norms,
    )


def symmetric_roots(hessians: Array) -> Array:
    """Return L (times, rank, k) with L'L = H; rows of zeros where the rank is lower."""
    values, vectors = np.linalg.eigh(hessians)
    kept = values > ZERO_CURVATURE * np.maximum(values.max(axis=1, keepdims=True), 0.0)
    roots = np.sqrt(np.where(kept, values, 0.0))[..., None] * np.swapaxes(vectors, 1, 2)
    rank = int(kept.sum(axis=1).max(initial=0))
    return roots[:, hessians.shape[-1] - rank :]


class ModeColumns:
    """The columns of variables: x, u and slacks of the host program, then shares, weights and epigraphs of modes.

    Attributes
    ----------
    x : (T+1, n), y : (T, k)
        y_t is (x_t, u_t).
    share : (T, modes, k), delta : (T, modes), epsilon : (T, modes)
    count : int
    """

    def __init__(self, horizon: int, modes: int, n: int, m: int, host: int):
        T, k = horizon, n + m
        self.x: Indices = np.arange((T + 1) * n).reshape(T + 1, n)
        self.y = signal_columns(T, n, m)
        own = host + np.arange(T * modes * (k + 2)).reshape(T, modes, k + 2)
        self.share, self.delta, self.epsilon = own[..., :k], own[..., k], own[..., k + 1]
        self.count = host + own.size


@dataclass(frozen=True, eq=False)
class ModeRows:
    """Groups of rows, one for each (t, mode) or each t (the sums and ``share_map``); names as in relaxation.py.

    ``one_map`` and ``one_region`` are rows on (x_t, u_t), where one mode is left; BOX has three kinds.
    """

    one_map: Groups
    one_region: Groups
    share_sum: Groups
    weight_sum: Groups
    share_map: Groups
    share_region: Groups
    share_upper: Groups
    share_lower: Groups
    share_equal: Groups
    weight: Groups
    cone: Groups


def mode_rows(template: RowTemplate, stages: ModeStages, at: ModeColumns, roots: Array) -> ModeRows:
    """Add all rows that a relaxation may have; the coefficients of bounds are filled in for each member."""
    T, modes, n, k = stages.maps.shape
    limits = np.where(np.isfinite(stages.limits), stages.limits, 0.0)
    count, rank = limits.shape[2], roots.shape[1]
    y, after = (np.broadcast_to(part[:, None], (T, modes, part.shape[1])) for part in (at.y, at.x[1:]))
    of_state, of_row, of_pair = np.arange(n), np.arange(count), np.arange(k)
    of_map, of_region = np.repeat(of_state, k), np.repeat(of_row, k)
    maps, regions = stages.maps.reshape(T, modes, n * k), stages.rows.reshape(T, modes, count * k)
    shares, all_maps, all_offsets = at.share.reshape(T, -1), maps.reshape(T, -1), stages.offsets.reshape(T, -1)
    share, pair = at.share, np.stack([at.epsilon, at.delta] * 2, axis=-1)
    box, delta = np.zeros((T, modes, k)), at.delta[..., None]
    weights = of_pair, np.repeat(delta, k, axis=-1), 0.0
    add, equation, inequality = template.add, Sense.EQUATION, Sense.INEQUALITY
    return ModeRows(
        one_map=add(equation, stages.offsets, (of_state, after, 1.0), (of_map, np.tile(y, n), -maps)),
        one_region=add(inequality, limits, (of_region, np.tile(y, count), regions)),
        share_sum=add(equation, np.zeros((T, k)), (of_pair, at.y, 1.0), (np.tile(of_pair, modes), shares, -1.0)),
        weight_sum=add(equation, np.ones((T, 1)), (np.zeros(modes, dtype=np.intp), at.delta, 1.0)),
        share_map=add(
            equation,
            np.zeros((T, n)),
            (of_state, at.x[1:], 1.0),
            (np.tile(of_map, modes), np.tile(share, n).reshape(T, -1), -all_maps),
            (np.tile(of_state, modes), np.repeat(at.delta, n, axis=1), -all_offsets),
        ),
        share_region=add(
            inequality,
            np.zeros(limits.shape),
            (of_region, np.tile(share, count), regions),
            (of_row, np.repeat(delta, count, axis=-1), -limits),
        ),
        share_upper=add(inequality, box, (of_pair, share, 1.0), weights),
        share_lower=add(inequality, box, (of_pair, share, -1.0), weights),
        share_equal=add(equation, box, (of_pair, share, 1.0), weights),
        weight=add(inequality, np.zeros(delta.shape), (np.zeros(1, dtype=np.intp), delta, -1.0)),
        cone=add(  # (epsilon + delta, epsilon - delta, sqrt(2) L y)
            Sense.CONE,
            np.zeros((T, modes, rank + 2)),
            (np.array([0, 0, 1, 1]), pair, np.array([1.0, 1.0, 1.0, -1.0])),
            (np.repeat(2 + np.arange(rank), k), np.tile(share, rank), np.sqrt(2.0) * roots.reshape(T, 1, -1)),
        ),
    )


@dataclass(frozen=True, eq=False)
class Lagrangian:
    """Hessians (T, k, k) and (n, n), prices (T+1, k), rows over all times (q, T+1, k) and right (q,), natural units."""

    hessians: Array
    last: Array
    price: Array
    rows: Array
    right: Array


class Quadratic:
    """1/2 y'H y for Hessians (..., k, k), to be minimised over boxes with slopes."""

    def __init__(self, hessians: Array):
        self._hessians, self._diagonal = hessians, np.diagonal(hessians, axis1=-2, axis2=-1)
        sizes = np.sqrt(np.where(self._diagonal > 0, self._diagonal, 1.0))
        normed = hessians / (sizes[..., None] * sizes[..., None, :])
        off = hessians - self._diagonal[..., None] * np.eye(hessians.shape[-1])
        convex = np.maximum(np.linalg.eigvalsh(normed)[..., :1], 0.0)
        self._least = convex * self._diagonal  # H - diag(least) is positive semidefinite
        self._coupled = np.asarray(off.any(axis=tuple(range(1, off.ndim)) if off.ndim > 2 else None))  # at which times

    def least(self, slope: Array, low: Array, high: Array) -> Array:
        """Return lower bounds of slope'y + 1/2 y'H y over boxes, (...), times first where H depends on them."""
        at = self._coupled
        if not at.any():
            return _box_minimum(slope, self._diagonal, low, high)
        if at.all():
            return _coupled_minimum(slope, self._hessians, self._least, low, high)
        found = _box_minimum(slope, self._diagonal, low, high)
        found[at] = _coupled_minimum(slope[at], self._hessians[at], self._least[at], low[at], high[at])
        return found


class StageBounds:
    """Bounds of one problem whose only terms beyond boxes are linear equations over all times."""

    def __init__(self, stages: ModeStages, parts: Lagrangian):
        price, rows, self._n = parts.price, parts.rows, len(parts.last)
        self._stages, self._price, self._right = stages, price, parts.right
        self._rows = rows.reshape(len(rows), price.size)
        self._cost, self._last = Quadratic(parts.hessians[:, None]), Quadratic(parts.last)
        finite = np.isfinite(stages.limits)
        self._limits = np.where(finite, stages.limits, 0.0)

    def phi(self, reach: Reach, eta: Array, rho: Array, regions: Array) -> tuple[Array, float]:
        """Return phi (T, modes), inf for modes that are not allowed, and the rest of the bound.

        The duals are eta (T, n), rho (q,) and lambda (T, modes, r) of the regions, in natural units.
        """
        stages, n = self._stages, self._n
        slope = self._price + (rho @ self._rows).reshape(self._price.shape)
        slope[1:, :n] += eta
        own = slope[:-1, None] - (eta[:, None, None] @ stages.maps)[:, :, 0]
        own += (regions[:, :, None] @ stages.rows)[:, :, 0]
        constant = -(stages.offsets @ eta[..., None])[..., 0] - (regions * self._limits).sum(axis=-1)
        low, high = (stages.scaled(bounds) for bounds in (reach.mode_lower, reach.mode_upper))
        found = np.where(reach.allowed, constant + self._cost.least(own, low, high), np.inf)
        units = stages.units[:n]
        ends = ((bounds[-1] - stages.last_reference) / units for bounds in (reach.lower, reach.upper))
        return found, float(self._last.least(slope[-1, :n], *ends)) - float(rho @ self._right)


def _coupled_minimum(slope: Array, hessians: Array, least: Array, low: Array, high: Array) -> Array:
    """Return lower bounds where H is not diagonal, H - diag(least) being positive semidefinite."""
    y = box_minimiser(slope, hessians, low, high)
    moved = (hessians * y[..., None, :]).sum(axis=-1)
    there = ((slope + 0.5 * moved) * y).sum(axis=-1)
    return there + _box_minimum(slope + moved, least, low - y, high - y)


def _box_minimum(slope: Array, curvature: Array, low: Array, high: Array) -> Array:
    """Return the least slope'v + 1/2 sum_j curvature_j v_j^2 over boxes."""
    curved = curvature > 0
    v = np.where(curved, -slope / np.where(curved, curvature, 1.0), np.where(slope > 0, low, high))
    v = np.clip(v, low, high)
    return ((slope + 0.5 * curvature * v) * v).sum(axis=-1)
