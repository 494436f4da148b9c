"""A problem with linear dynamics as stages, in deviations from an origin, and the way back.

Boxes and terms of single times become rows of stages, their slacks entries of w after the controls. Stop bands and
terms of several times become coupling rows; their slacks are spread over the stages.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.methods.structured.recovery import (
    Origin,
    Recovery,
    Units,
    fix_unused_entries,
    multiplier_layout,
    origin_of,
    own_units,
    scale_dynamics,
    scale_stages,
)
from lin_freq_ocp.methods.structured.rows import (
    Columns,
    CoupledPart,
    StageRowList,
    assign_slots,
    box_rows,
    concatenate_rows,
    nonnegative_slacks,
    on_channels,
    stopped_parts,
    term_parts,
    term_rows,
)
from lin_freq_ocp.methods.structured.stages import Balls, Coupling, Equations, Inequalities, SparseRows, Stages
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sizes import stated_sizes
from lin_freq_ocp.problem.trajectory import Trajectory

REVISED = 100.0  # factor between a unit and the magnitude found from which a solution is worth units of its own
WEIGHTS = ("Q", "R", "S", "q", "r", "P", "p")  # of the quadratic cost: all but its references


@dataclass(frozen=True, eq=False)
class Assembly:
    """The stages of a problem in the units of the method, and the way between both."""

    stages: Stages
    recovery: Recovery
    slack_columns: tuple[Indices, ...]  # of each term: the positions of its slacks in y, flat
    used: Mask  # entries of y, (T+1, n+k)
    priced: Mask  # those that make the size of the cost: signals, and slacks of nonsmooth costs

    def point(self, trajectory: Trajectory) -> Array:
        """Return y of a trajectory, with the least slacks."""
        problem = self.recovery.problem
        x, u = trajectory.x, trajectory.u
        y, (n, m) = np.zeros(self.stages.h.shape), (problem.state_dim, problem.control_dim)
        y[:, :n], y[:-1, n : n + m] = x - self.recovery.origin.x, u - self.recovery.origin.u
        y[:, : n + m][self.recovery.origin.held] = 0.0
        for term, columns in zip(problem.terms, self.slack_columns, strict=True):
            y.flat[columns] = term.penalty.least_slacks(term.map.values(x, u))
        return y / self.recovery.units.columns

    def revised(self, y: Array) -> Assembly | None:
        """Return the same in the units of a solution y, or None if they differ little from its own."""
        old, problem = self.recovery.units, self.recovery.problem
        n, m = problem.state_dim, problem.control_dim
        sizes = old.columns[0, : n + m] * own_units(self.stages, y, m)
        ratio = _column_units(problem, sizes[:n], sizes[n:], self.slack_columns, y.shape) / old.columns
        stages, change = scale_stages(self.stages, ratio, self.priced, y)
        units = Units(old.columns * ratio, old.rows * change.rows, old.cost * change.cost)
        if np.abs(np.log(np.append(ratio, change.cost))).max() < np.log(REVISED):
            return None
        return replace(self, stages=fix_unused_entries(stages, self.used), recovery=replace(self.recovery, units=units))

    def exchanged(self, problem: OptimalControlProblem) -> Assembly | None:
        """Return the stages of a problem with other dynamics, references and fixed ends, in the same units.

        None if it differs in more, or is not made from the same objects (``with_ends``, ``affine_at``,
        ``with_references``).
        """
        old, columns = self.recovery.problem, self.recovery.units.columns
        same = [(getattr(problem.quadratic, name), getattr(old.quadratic, name)) for name in WEIGHTS]
        same += [(problem.terms, old.terms), (problem.control_tube, old.control_tube)]
        same += [(problem.state_boxes, old.state_boxes), (problem.state_stop, old.state_stop)]
        same += [(problem.control_stop, old.control_stop)]
        if not all(one is other for one, other in same):
            return None
        (ends, fixed), (old_ends, old_fixed) = _ends(problem), _ends(old)
        if (fixed != old_fixed).any() or (ends != old_ends)[:, ~fixed].any():
            return None
        coupling, origin, n = self.stages.coupling, self.recovery.origin, problem.state_dim
        A, B, d = scale_dynamics(*_dynamics(problem, origin, columns.shape[1]), columns)
        if problem.linear.A is old.linear.A and problem.linear.B is old.linear.B:
            A, B = self.stages.A, self.stages.B
        deviation = (ends[0] - origin.x[[0, -1]]) / columns[[0, -1], :n]
        terminal = replace(coupling, terminal_state=deviation[1, coupling.terminal])
        initial = np.where(fixed[0], deviation[0], np.nan)
        stages = replace(self.stages, A=A, B=B, d=d, initial=initial, coupling=terminal)
        if problem.quadratic is not old.quadratic:  # other references, at the same origin
            units, size, h = self.recovery.units, n + problem.control_dim, stages.h.copy()
            in_x, in_u = problem.quadratic.gradient(origin.x, origin.u)
            h[:, :n], h[:-1, n:size] = in_x, np.where(origin.held[:-1, n:], 0.0, in_u)
            h[:, :n] *= units.cost * units.columns[:, :n]
            h[:-1, n:size] *= units.cost * units.columns[:-1, n:size]
            stages = replace(stages, h=h, constant=problem.quadratic.value(origin.x, origin.u) * units.cost)
        stages.__dict__["coupled"] = self.stages.coupled
        return replace(self, stages=stages, recovery=replace(self.recovery, problem=problem))

    def same_matrices(self, other: Assembly) -> bool:
        """Whether another assembly is of the same arrays but for right-hand sides (``exchanged``)."""
        pairs = [(getattr(self.stages, name), getattr(other.stages, name)) for name in ("A", "B", "H", "G", "coupled")]
        return all(one is another for one, another in pairs)


def stages_of(problem: OptimalControlProblem) -> Assembly:
    """Return the stages of a problem; UnsupportedError for dynamics that are not linear, or terms that do not fit."""
    builder = _Builder(problem)
    coupling, parts = builder.coupling()
    plain, priced, used = builder.stages(coupling), builder.priced(), builder.used()
    columns = _column_units(problem, *stated_sizes(problem), builder.slack_columns, used.shape)
    stages, units = scale_stages(plain, columns, priced)
    targets, signs = builder.recovered(parts)
    recovery = Recovery(problem, builder.origin, units, builder.layout, targets, signs)
    return Assembly(fix_unused_entries(stages, used), recovery, builder.slack_columns, used, priced)


class _Builder:
    """The rows of a problem, their slots, and the arrays that follow."""

    def __init__(self, problem: OptimalControlProblem):
        T, n, m = problem.horizon, problem.state_dim, problem.control_dim
        self._problem, self._n, self._m, self._T = problem, n, m, T
        self.layout = multiplier_layout(problem)
        self.origin = origin_of(problem)
        self._fixed = _ends(problem)[1]
        free = np.ones((T + 1, n), dtype=bool)
        free[[0, -1]] = ~self._fixed
        parts = [
            box_rows(problem.state_tube, free, 0, self.origin, self.layout.mu),
            box_rows(problem.control_tube, ~self.origin.held[:-1, n:], n, self.origin, self.layout.nu),
        ]
        spread = 0
        for term, target in zip(problem.terms, self.layout.terms, strict=True):
            form = term.map.stage_form(n, m)
            if form is not None:
                parts.append(term_rows(term, form, self.origin, target))
            else:
                prices = term.penalty.conic(*term.shape).prices
                times = (spread + np.arange(len(prices))) % (T + 1)
                parts.append(nonnegative_slacks(times, prices, n + m))
                spread += len(prices)
        self._rows: StageRowList = concatenate_rows(parts)
        self._slots = assign_slots(self._rows)
        self._width = n + m + self._slots.slack_count
        firsts = np.cumsum([len(part.prices) for part in parts])[1:]
        self.slack_columns = tuple(self._flat_slacks[a:b] for a, b in pairwise(firsts.tolist()))

    def stages(self, coupling: Coupling) -> Stages:
        """Return the stages in the problem's own units; entries of y that are not used have Hessian 0."""
        problem, T, n, m, width = self._problem, self._T, self._n, self._m, self._width
        cost, origin = problem.quadratic, self.origin
        H, h = np.zeros((T + 1, width, width)), np.zeros((T + 1, width))
        H[:-1, : n + m, : n + m], H[-1, :n, :n] = cost.stage_hessians(), cost.P
        h[:, :n], h[:-1, n : n + m] = cost.gradient(origin.x, origin.u)
        time, entry = np.nonzero(origin.held)
        H[time, entry], H[time, :, entry], h[time, entry] = 0.0, 0.0, 0.0
        h.flat[self._flat_slacks] = self._rows.prices
        rows, slots, first = self._rows, self._slots, n + m
        G, g = np.zeros((T + 1, slots.count, width)), np.full((T + 1, slots.count), np.inf)
        time = rows.times[slots.source]
        G[time, slots.slot, :first] = slots.sign[:, None] * rows.matrix[slots.source]
        slacks = sp.coo_array(rows.slacks[slots.source])
        row, slack = slacks.coords
        G[time[row], slots.slot[row], first + slots.slack_slot[slack]] = slots.sign[row] * slacks.data
        g[time, slots.slot] = np.where(slots.sign > 0, rows.upper[slots.source], -rows.lower[slots.source])
        lower = problem.state_tube.lower
        initial = np.where(self._fixed[0], lower[0] - origin.x[0], np.nan)
        dynamics = _dynamics(problem, origin, width)
        return Stages(*dynamics, H, h, G, g, self._slots.cones, initial, coupling, cost.value(origin.x, origin.u))

    def coupling(self) -> tuple[Coupling, list[CoupledPart]]:
        """Return the rows that couple times, in the problem's own units, and their parts with the targets of duals."""
        problem, T, n, m = self._problem, self._T, self._n, self._m
        origin, columns = self.origin, Columns(T + 1, n, m, self._width)
        parts = [
            *stopped_parts(problem.state_stop, problem.state_samples, 0, origin.values, self._width, self.layout.rho_x),
            *stopped_parts(problem.control_stop, T, n, origin.values, self._width, self.layout.rho_u),
        ]
        rows, equal = self._rows, self._slots.equations
        if len(equal):
            matrix = columns.of_stages(rows.times[equal], rows.matrix[equal], rows.slacks[equal], self._flat_slacks)
            parts.append(CoupledPart(Equations(SparseRows(matrix), rows.lower[equal]), rows.targets[equal]))
        for term, slacks, target in zip(problem.terms, self.slack_columns, self.layout.terms, strict=True):
            if term.map.stage_form(n, m) is None:
                parts += term_parts(term, columns, slacks, term.map.values(origin.x, origin.u), target)
        terminal = np.flatnonzero(self._fixed[1])
        end = problem.state_tube.lower[-1, terminal] - origin.x[-1, terminal]
        return on_channels(parts, self._width, terminal, end), parts

    @property
    def _flat_slacks(self) -> Indices:
        return self._rows.slack_times * self._width + self._n + self._m + self._slots.slack_slot

    def used(self) -> Mask:
        """Return which entries of y are used, (T+1, n+k)."""
        used = np.zeros((self._T + 1, self._width), dtype=bool)
        used[:, : self._n], used[:-1, self._n : self._n + self._m] = True, ~self.origin.held[:-1, self._n :]
        used.flat[self._flat_slacks] = True
        return used

    def priced(self) -> Mask:
        """Return which entries of y make the size of the cost: signals, and slacks of nonsmooth costs, (T+1, n+k)."""
        priced = self.used()
        for term, flat in zip(self._problem.terms, self.slack_columns, strict=True):
            priced.flat[flat] = term.kind.is_cost
        return priced

    def recovered(self, parts: list[CoupledPart]) -> tuple[Indices, Array]:
        """Return the target and the sign of every dual after those of the dynamics, flat."""
        n, T, slots = self._n, self._T, self._slots
        initial = np.where(self._fixed[0], self.layout.mu + np.arange(n), -1)
        end = self.layout.mu + T * n + np.flatnonzero(self._fixed[1])
        of_stages, signs = np.full((T + 1, slots.count), -1), np.ones((T + 1, slots.count))
        at = self._rows.times[slots.source], slots.slot
        of_stages[at], signs[at] = self._rows.targets[slots.source], slots.sign
        ordered = [part for kind in (Equations, Inequalities, Balls) for part in parts if isinstance(part.family, kind)]
        targets = [initial, of_stages.ravel(), end, *(part.targets.ravel() for part in ordered)]
        of_parts = [np.full(part.targets.size, part.sign) for part in ordered]
        return np.concatenate(targets), np.concatenate([np.ones(n), signs.ravel(), np.ones(len(end)), *of_parts])


def _column_units(
    problem: OptimalControlProblem, x: Array, u: Array, slacks: tuple[Indices, ...], shape: tuple[int, ...]
) -> Array:
    """Return units of y, (T+1, n+k), from those of states (n,) and controls (m,)."""
    columns, n, m, T = np.ones(shape), problem.state_dim, problem.control_dim, problem.horizon
    columns[:, :n], columns[:, n : n + m] = x, u
    signals = np.broadcast_to(x, (T + 1, n)), np.broadcast_to(u, (T, m))
    for term, flat in zip(problem.terms, slacks, strict=True):
        if len(flat):
            paid = term.penalty.conic(*term.shape).paid
            sizes = term.map.sizes(*signals).ravel()[paid].max(axis=1, initial=0.0)
            columns.flat[flat] = np.where(sizes > 0, sizes, 1.0)
    return columns


def _dynamics(problem: OptimalControlProblem, origin: Origin, width: int) -> tuple[Array, Array, Array]:
    """Return A, B and d in deviations from the origin, with so many entries of y."""
    linear, (T, n, m) = problem.linear, (problem.horizon, problem.state_dim, problem.control_dim)
    A, B, d = np.zeros((T + 1, n, n)), np.zeros((T + 1, n, width - n)), np.zeros((T + 1, n))
    A[:-1], d[:-1] = linear.A, linear.successors(origin.x, origin.u) - origin.x[1:]
    B[:-1, :, :m] = np.where(origin.held[:-1, None, n:], 0.0, linear.B)
    return A, B, d


def _ends(problem: OptimalControlProblem) -> tuple[Array, Mask]:
    """Return the bounds of both ends, (2, 2, n), lower ones first, and which are equal, (2, n)."""
    tube = problem.state_tube
    bounds = np.stack([tube.lower[[0, -1]], tube.upper[[0, -1]]])
    return bounds, bounds[0] == bounds[1]
