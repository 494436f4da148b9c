"""The rows of mode relaxations (see relaxation.py), and the bound that their duals prove stage by stage.

A template has all rows that a family of programs may have; each member takes some of them. Rows come in groups, one for
each time and mode, all of a kind having the same size: so a member is chosen by masks and assembled by a few vector
operations. A search over modes solves thousands of programs that differ little.

Any duals, of a solution or not, prove a shortest path through the modes, as in path_relaxation.py. Duals of shares do
not depend on the mode that follows: the length of an edge is then the least Lagrangian of its mode over its box.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TypeVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.polyhedra import box_minimiser
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.linear_program import LinearProgram, signal_columns
from lin_freq_ocp.program.program import StandardForm
from lin_freq_ocp.transform.hybrid.forms import piecewise_affine
from lin_freq_ocp.transform.simulation import within_reach

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
        rows_of_groups = self.view(rows)
        rows_of_groups[:] = chosen.reshape(-1, 1)
        if within is not None:
            rows_of_groups &= within.reshape(rows_of_groups.shape)

    def view(self, rows: NDArray[Scalar]) -> NDArray[Scalar]:
        """Return the values of these groups, (groups, size), as a view."""
        return _view(rows, self.rows)

    def coefficients(self, values: Array) -> Array:
        """Return the coefficients of these groups, (groups, entries), as a view."""
        return _view(values, self.entries)


def _view(whole: NDArray[Scalar], places: Indices) -> NDArray[Scalar]:
    first = int(places[0, 0]) if places.size else 0
    return whole[first : first + places.size].reshape(places.shape)


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
        """Return the assembler of its members."""
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

    def member(
        self,
        rows: Mask,
        columns: Mask,
        values: Array,
        right: Array,
        cost: tuple[sp.csc_array, Array],
        cones: tuple[int, ...],
    ) -> StandardForm:
        """Return the standard form of some rows and columns, from all coefficients in the order they were added.

        The cost is (P, q) of these columns; ``cones`` are the sizes of those among the rows.
        """
        taken = rows[self._rows]
        chosen = np.flatnonzero(taken)
        numbers = np.cumsum(taken, dtype=np.int32) - np.int32(1)
        data = values[self._order]
        keep = np.flatnonzero(taken[self._place] & columns[self._column] & (data != 0))
        counts = np.bincount(self._column[keep], minlength=self.columns)[columns]
        pointers = np.append(np.int32(0), np.cumsum(counts, dtype=np.int32))
        A = sp.csc_array(
            (data[keep] * self._sign[keep], numbers[self._place[keep]], pointers), shape=(len(chosen), len(counts))
        )
        row, sign = self._rows[chosen], self._row_sign[chosen]
        equations, unequal = (int(end) for end in np.searchsorted(chosen, self._ends))
        return StandardForm(*cost, A, sign * right[row], equations, unequal - equations, cones, row, sign)


THIN = 1e-9  # rows that differ by less from zero on the whole box, in natural units, are dropped: they have no interior
ZERO_CURVATURE = 1e-12  # eigenvalues of a stage's Hessian below this part of the largest are zero


@dataclass(frozen=True, eq=False)
class ModeStages:
    """All modes in deviations y from the references, within reach, in units; k = n + m components.

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


def mode_programs(problem: OptimalControlProblem) -> list[LinearProgram]:
    """Return the linear programs of each mode at all times, in deviations from the references, within reach."""
    dynamics, (T, m), cost = piecewise_affine(problem), (problem.horizon, problem.control_dim), problem.quadratic
    x, u = within_reach(problem, cost.x_ref), np.broadcast_to(cost.u_ref, (T, m))
    along = (problem.with_dynamics(dynamics.along(np.full(T, mode))) for mode in range(len(dynamics.modes)))
    return [LinearProgram(one, Trajectory(x, u)) for one in along]


def mode_stages(problem: OptimalControlProblem, units: Array) -> ModeStages:
    """Return the modes in units (k,) of states and controls."""
    T, n = problem.horizon, problem.state_dim
    arrays, cost = piecewise_affine(problem).arrays(T), problem.quadratic
    states = within_reach(problem, cost.x_ref)
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
    positive = values > ZERO_CURVATURE * np.maximum(values.max(axis=1, keepdims=True), 0.0)
    roots = np.sqrt(np.where(positive, values, 0.0))[..., None] * np.swapaxes(vectors, 1, 2)
    rank = int(positive.sum(axis=1).max(initial=0))
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
        columns = host + np.arange(T * modes * (k + 2)).reshape(T, modes, k + 2)
        self.share, self.delta, self.epsilon = columns[..., :k], columns[..., k], columns[..., k + 1]
        self.count = host + columns.size


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


class Quadratic:
    """1/2 y'H y for Hessians (..., k, k), to be minimised over boxes with slopes."""

    def __init__(self, hessians: Array):
        self._hessians, self._diagonal = hessians, np.diagonal(hessians, axis1=-2, axis2=-1)
        sizes = np.sqrt(np.where(self._diagonal > 0, self._diagonal, 1.0))
        normed = hessians / (sizes[..., None] * sizes[..., None, :])
        convex = np.maximum(np.linalg.eigvalsh(normed)[..., :1], 0.0)
        self._least = convex * self._diagonal  # H - diag(least) is positive semidefinite
        self._coupled = bool((hessians - self._diagonal[..., None] * np.eye(hessians.shape[-1])).any())

    def least(self, slope: Array, low: Array, high: Array) -> Array:
        """Return lower bounds of slope'y + 1/2 y'H y over boxes, (...)."""
        if not self._coupled:
            return _box_minimum(slope, self._diagonal, low, high)
        y = box_minimiser(slope, self._hessians, low, high)
        gradient = (self._hessians * y[..., None, :]).sum(axis=-1)
        there = ((slope + 0.5 * gradient) * y).sum(axis=-1)
        return there + _box_minimum(slope + gradient, self._least, low - y, high - y)


@dataclass(frozen=True, eq=False)
class PathModel:
    """What the relaxations of one problem share, in natural units y; at T there is only mode 0, without map and region.

    maps (T+1, modes, n, k), offsets (T+1, modes, n), rows (T+1, modes, r, k) and limits (T+1, modes, r) of regions,
    roots (T+1, rank, k) of Hessians, price (T+1, k), coupled (q, T+1, k) and right (q,) of rows over all times; the
    first of these are ``equations``, the others coupled y <= right.
    """

    maps: Array
    offsets: Array
    rows: Array
    limits: Array
    roots: Array
    price: Array
    coupled: Array
    right: Array
    equations: int

    @property
    def of_end(self) -> bool:
        """Whether all inequalities are those of x_T."""
        return not self.coupled[self.equations :, :-1].any()

    def pairs(self, allowed: Mask, low: Array, high: Array) -> Mask:
        """Return which modes can follow each other, (..., T, modes, modes), as far as boxes (..., T+1, modes, k) tell.

        ``allowed`` (..., T+1, modes): which vertices there are.
        """
        n = self.maps.shape[2]
        of_stages = (low + high)[..., :-1, :, :, None] / 2, (high - low)[..., :-1, :, :, None] / 2
        centre = (self.maps[:-1] @ of_stages[0])[..., 0] + self.offsets[:-1]
        radius = (np.abs(self.maps[:-1]) @ of_stages[1])[..., 0] + THIN
        above, below = (centre + radius)[..., :, None, :], (centre - radius)[..., :, None, :]
        meets = ((above >= low[..., 1:, None, :, :n]) & (below <= high[..., 1:, None, :, :n])).all(axis=-1)
        edges = allowed[..., :-1, :, None] & allowed[..., 1:, None, :] & meets
        while True:  # a vertex needs an edge in and an edge out
            live = np.ones(allowed.shape, dtype=bool)
            live[..., :-1, :] &= edges.any(axis=-1)
            live[..., 1:, :] &= edges.any(axis=-2)
            less = edges & live[..., :-1, :, None] & live[..., 1:, None, :]
            if (less == edges).all():
                return edges
            edges = less


@dataclass(frozen=True, eq=False)
class Duals:
    """Duals of a relaxation in natural units; eta_C = 0 for a proof that there is no trajectory.

    adjoint (T, n): eta of the dynamics; sides: those of the rows over all times, spectra and terms; regions (T, modes,
    r): lambda >= 0. Duals of paths depend on the mode that follows: vertices (T, modes, n), eta_tj, those of T - 1 in
    mode 0, with their average as the adjoint; regions (T, modes, modes, r); images (T, modes, modes, n): nu.
    """

    adjoint: Array
    sides: Array
    regions: Array
    eta_C: float
    vertices: Array | None = None
    images: Array | None = None


class PathBounds:
    """Bounds of one problem; Hessians (T+1, k, k) in natural units."""

    def __init__(self, model: PathModel, hessians: Array):
        self.model, self._n = model, model.maps.shape[2]
        self._cost, self._feasible = (
            (Quadratic(factor * hessians[:-1, None, None]), Quadratic(factor * hessians[-1])) for factor in (1.0, 0.0)
        )
        self._limits = np.where(np.isfinite(model.limits), model.limits, 0.0)

    def bounds(self, pairs: Mask, low: Array, high: Array, duals: Sequence[Duals]) -> Array:
        """Return the bound of each of several duals, all of one kind: of paths or shares, with one eta_C; inf: no path.

        Edges are (count, T, modes, modes), boxes (count, T+1, modes, k). Duals of shares are the same whichever mode
        follows: the axis of that mode then has a length of 1.
        """
        model, (count, T, modes), n = self.model, pairs.shape[:3], self._n
        of_paths, eta_C = duals[0].vertices is not None, duals[0].eta_C
        eta = np.array([one.adjoint[:, None] if one.vertices is None else one.vertices for one in duals])
        regions = np.array([one.regions if of_paths else one.regions[:, :, None] for one in duals])
        images = np.array([np.zeros(()) if one.images is None else one.images for one in duals])
        ahead = eta[:, :, None] + (images if of_paths else 0.0)
        sides = np.array([one.sides for one in duals])
        sides[:, model.equations :] = np.maximum(sides[:, model.equations :], 0.0)  # those of inequalities
        slope = eta_C * model.price + np.tensordot(sides, model.coupled, axes=1)
        slopes = np.zeros((count, T, modes, regions.shape[3], slope.shape[-1]))
        slopes += slope[:, :-1, None, None]
        slopes[:, 1:, ..., :n] += eta[:, :-1, :, None]
        slopes -= ahead @ model.maps[:-1]
        slopes += regions @ model.rows[:-1]
        constant = -(ahead @ model.offsets[:-1, :, :, None])[..., 0]
        constant = constant - (regions @ self._limits[:-1, :, :, None])[..., 0]
        if of_paths:
            ends = (side[:, 1:, None, :, :n] for side in (low, high))
            constant += np.where(images > 0, *(images * end for end in ends)).sum(axis=-1)
        stages, last = self._cost if eta_C else self._feasible
        lengths = constant + stages.least(slopes, low[:, :-1, :, None], high[:, :-1, :, None])
        lengths = np.where(pairs, lengths, np.inf)
        of_end = slope[:, -1]
        of_end[:, :n] += eta[:, -1, 0]
        value = np.zeros((count, modes))  # of x_T, in mode 0 alone
        value[:, 0] = last.least(of_end, low[:, -1, 0], high[:, -1, 0])
        for t in range(T - 1, -1, -1):
            value = (lengths[:, t] + value[:, None]).min(axis=2)
        return value.min(axis=1) - sides @ model.right


def _box_minimum(slope: Array, curvature: Array, low: Array, high: Array) -> Array:
    """Return the least slope'v + 1/2 sum_j curvature_j v_j^2 over boxes."""
    curved = curvature > 0
    v = np.where(curved, -slope / np.where(curved, curvature, 1.0), np.where(slope > 0, low, high))
    v = np.clip(v, low, high)
    return ((slope + 0.5 * curvature * v) * v).sum(axis=-1)
