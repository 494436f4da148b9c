"""The convex relaxation of a piecewise-affine problem whose modes are restricted to a mask (T, modes).

Where one mode is left, its map and region are rows on (x_t, u_t). Where several are, y_{t,i} is the share of mode i in
(x_t, u_t) and delta_{t,i} >= 0 its weight (the perspective formulation: Moehle and Boyd 2015, Marcucci and Tedrake
2019), in the boxes of ``mode_reach``:

    SUM     x_t = sum_i y_x,  u_t = sum_i y_u,  sum_i delta_i = 1
    MAP     x_{t+1} = sum_i A_i y_x + B_i y_u + d_i delta_i
    REGION  G_i y_x + H_i y_u <= h_i delta_i
    BOX     lower_i delta_i <= y_i <= upper_i delta_i
    CONE    cost sum_i delta_i c_t(y_i / delta_i) by epigraphs: 2 epsilon_i delta_i >= |L y_i|^2, L'L the Hessian

It is the convex hull of graph and cost of each stage.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self, TypeVar

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.problem.hybrid.mode_tree import ModeMultipliers, PathMultipliers
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.hybrid.rows import (
    Duals,
    Groups,
    ModeColumns,
    PathBounds,
    PathModel,
    RowTemplate,
    Sense,
    mode_programs,
    mode_rows,
    mode_stages,
    symmetric_roots,
)
from lin_freq_ocp.program.program import Block, StandardForm
from lin_freq_ocp.program.units import common_scaling
from lin_freq_ocp.transform.hybrid.mode_reach import LARGEST_BOUND, ModeReach, Reach
from lin_freq_ocp.transform.sizes import stated_sizes

Number = TypeVar("Number", float, Array)

COST_SHARE = 0.1  # of the cost in common units: bounds are asked to a part of the cost, and a larger cost iterates more
FIXED = 1e-9  # a box narrower than this, in natural units, is an equation: interior-point methods need an interior


@dataclass(frozen=True, eq=False)
class Member:
    """The relaxation of one reach, with its columns of the template; the rows are those of the form."""

    form: StandardForm
    reach: Reach
    columns: Indices


class ModeRelaxation:
    """The relaxations of one problem with piecewise-affine dynamics and a convex cost.

    A ``level`` is a cost below which the search is: solvers end at errors relative to the objective or to 1, and a cost
    of the level is at least 1 in the units of the objective.
    """

    bounds_where_several = False  # whether (x_t, u_t) also has its own bounds where shares have them

    def __init__(self, problem: OptimalControlProblem, level: float = np.inf):
        self.problem, self.reach = problem, ModeReach(problem)
        T, n, m, hosts = problem.horizon, problem.state_dim, problem.control_dim, mode_programs(problem)
        self._host, units = hosts[0], common_scaling(hosts, stated_sizes(problem))
        self._scaling = replace(units, cost=max(COST_SHARE * units.cost, 1 / (level or np.inf)))
        self._program = self._host.sparse.scaled(self._scaling)
        states = (T + 1) * n
        sizes = np.concatenate([units.columns[:n], units.columns[states : states + m]])
        self._stages, self._n = mode_stages(problem, sizes), n
        self._at = ModeColumns(T, len(hosts), n, m, len(self._program.q))
        template = RowTemplate()
        # the rows of the host program other than dynamics and boxes: spectra and terms
        others = np.ones(len(self._program.lower), dtype=bool)
        for block in (Block.DYNAMICS, Block.STATE_SET, Block.CONTROL_SET):
            others[self._program.rows[block]] = False
        lower, upper = self._program.lower, self._program.upper
        lower, upper = np.where(others, lower, -np.inf), np.where(others, upper, np.inf)
        self._shared = replace(self._program, lower=lower, upper=upper)
        form = self._sides = self._shared.standard()
        ends = form.equations, form.equations + form.inequalities
        A, b = sp.csr_array(form.A), np.split(form.b, ends)
        parts = (Sense.EQUATION, A[: ends[0]]), (Sense.INEQUALITY, A[ends[0] : ends[1]]), (Sense.CONE, -A[ends[1] :])
        groups: list[Groups] = []
        for (sense, matrix), right in zip(parts, (b[0], b[1], -b[2]), strict=True):
            entries = sp.coo_array(matrix)
            row, column = (np.asarray(part, dtype=np.intp) for part in entries.coords)
            groups.append(template.add(sense, right[None], (row, column[None], entries.data[None])))
        self._host_rows = tuple(groups)
        self._x_boxes, self._u_boxes = _box_rows(template, self._at.x), _box_rows(template, self._at.y[:, n:])
        stage_hessians = np.broadcast_to(problem.quadratic.stage_hessians, (T, n + m, n + m))
        roots = np.sqrt(units.cost) * symmetric_roots(stage_hessians * np.outer(sizes, sizes))
        self._rows = mode_rows(template, self._stages, self._at, roots)
        mode_cones, host_sizes = self._rows.cone.rows, np.array(form.cones, dtype=np.intp)
        host_heads = groups[2].rows.ravel()[np.cumsum(host_sizes) - host_sizes]
        self._cone_heads = np.append(host_heads, mode_cones[:, 0])
        self._cone_sizes = np.append(host_sizes, np.full(len(mode_cones), mode_cones.shape[1]))
        self._template = template.finished(self._at.count)
        hessian = sp.coo_array(sp.csc_array(sp.triu(self._program.P)))
        self._hessian = hessian.data, *(np.asarray(part, dtype=np.int32) for part in hessian.coords)
        self._price = np.zeros(self._at.count)
        self._price[: len(self._program.q)] = self._program.q
        self._price[self._at.epsilon] = self._scaling.cost / units.cost
        self._stage = np.full(self._at.count, -1)
        self._stage[self._at.y] = np.arange(T)[:, None]

    def member(self, reach: Reach) -> Member:
        """Return the relaxation of the modes that a reach allows; UnsupportedError if a signal is not bounded."""
        groups, stages, n = self._rows, self._stages, self._n
        single = reach.allowed.sum(axis=1) == 1
        many, only = reach.allowed & ~single[:, None], reach.allowed & single[:, None]
        values, right = self._template.values.copy(), self._template.right.copy()
        rows, columns = np.zeros(len(right), dtype=bool), np.ones(self._at.count, dtype=bool)
        for part in self._host_rows:
            part.view(rows)[:] = True
        # the bounds of x_t and u_t where shares do not have them, and of x_T
        bounded, tube, allowed = single | self.bounds_where_several, self.problem.control_tube, reach.allowed[..., None]
        implied = np.where(allowed, reach.mode_lower[..., n:], np.inf).min(axis=1)
        u_lower = np.where(np.isfinite(tube.lower), tube.lower, implied)
        implied = np.where(allowed, reach.mode_upper[..., n:], -np.inf).max(axis=1)
        u_upper = np.where(np.isfinite(tube.upper), tube.upper, implied)
        x_ref = np.vstack([stages.references[:, :n], stages.last_reference])
        u_ref, of_x, of_u = stages.references[:, n:], stages.units[:n], stages.units[n:]
        for boxes, low, high, times in (
            (self._x_boxes, (reach.lower - x_ref) / of_x, (reach.upper - x_ref) / of_x, np.append(bounded, True)),
            (self._u_boxes, (u_lower - u_ref) / of_u, (u_upper - u_ref) / of_u, bounded),
        ):
            equal = high - low <= FIXED
            limits = high, -low, (low + high) / 2
            masks = ~equal & (high < LARGEST_BOUND), ~equal & (low > -LARGEST_BOUND), equal
            for group, limit, mask in zip(boxes, limits, masks, strict=True):
                group.view(rows)[:] = mask & times[:, None]
                group.view(right)[:] = limit
        groups.one_map.take(rows, only)
        groups.one_region.take(rows, only, np.isfinite(stages.limits))
        groups.weight_sum.take(rows, ~single)
        groups.weight.take(rows, many)
        self._take_several(rows, values, right, reach, many)
        columns[self._at.delta] = columns[self._at.epsilon] = many
        columns[self._at.share] = many[..., None]
        kept_columns = np.flatnonzero(columns)
        # the cost of variables without shares; the columns of the host come first, and all belong to it
        hessian, row, column = self._hessian
        stage = self._stage[row]
        cost = (stage < 0) | single[stage]
        counts = np.bincount(column[cost], minlength=len(kept_columns))
        pointers = np.append(np.int32(0), np.cumsum(counts, dtype=np.int32))
        P = sp.csc_array((hessian[cost], row[cost], pointers), shape=(len(kept_columns), len(kept_columns)))
        cones = tuple(self._cone_sizes[rows[self._cone_heads]].tolist())  # all rows of a cone are taken, or none
        form = self._template.member(rows, columns, values, right, (P, self._price[kept_columns]), cones)
        return Member(form, reach, kept_columns)

    def _take_several(self, rows: Mask, values: Array, right: Array, reach: Reach, many: Mask) -> None:
        """Take the rows of shares and epigraphs of the modes ``many`` (T, modes), in the boxes of the reach."""
        groups, several = self._rows, np.asarray(many.any(axis=1))
        lower, upper = self._require_bounds(reach.mode_lower, many), self._require_bounds(reach.mode_upper, many)
        equal, k = upper - lower <= FIXED, lower.shape[-1]
        groups.share_sum.take(rows, several)
        groups.share_map.take(rows, several)
        groups.share_region.take(rows, many, np.isfinite(self._stages.limits))
        for group, bound, mask in (
            (groups.share_upper, -upper, ~equal),
            (groups.share_lower, lower, ~equal),
            (groups.share_equal, -(lower + upper) / 2, equal),
        ):
            group.take(rows, many, mask)
            group.coefficients(values)[:, k:] = bound.reshape(-1, k)
        groups.cone.take(rows, many)

    def moved(self, problem: OptimalControlProblem) -> Self:
        """Return the relaxations of a problem that differs in the point where it starts alone."""
        shifted = copy(self)
        shifted.problem, shifted.reach = problem, ModeReach(problem)
        return shifted

    @property
    def state_curvature(self) -> Array:
        """Return the largest diagonal of the cost's Hessian for each state, (n,)."""
        stage = np.abs(self.problem.quadratic.stage_hessians).max(axis=0).diagonal()[: self._n]
        return np.maximum(stage, np.abs(np.diagonal(self.problem.quadratic.P)))

    @cached_property
    def _bounds(self) -> PathBounds | None:
        """What duals prove; None for a problem with terms that are not rows of x and u."""
        program, form, at, stages = self._program, self._sides, self._at, self._stages
        (T, k), n, units = at.y.shape, self._n, stages.units
        if form.cones or len(program.q) > at.x.size + T * (k - n):
            return None
        dense, cost = form.A.toarray(), self.problem.quadratic
        rows, price, hessians = np.zeros((len(dense), T + 1, k)), np.zeros((T + 1, k)), np.zeros((T + 1, k, k))
        for part, of_host in ((rows, dense), (price, self._price)):
            part[..., :T, :], part[..., T, :n] = of_host[..., at.y], of_host[..., at.x[T]]
        hessians[:T] = self._scaling.cost * (np.broadcast_to(cost.stage_hessians, (T, k, k)) * np.outer(units, units))
        hessians[T, :n, :n] = self._scaling.cost * cost.P * np.outer(units[:n], units[:n])

        def with_end(part: Array, filled: float = 0.0) -> Array:
            return np.concatenate([part, np.full((1, *part.shape[1:]), filled)])

        model = PathModel(
            maps=with_end(stages.maps),
            offsets=with_end(stages.offsets),
            rows=with_end(stages.rows),
            limits=with_end(stages.limits, np.inf),
            roots=symmetric_roots(hessians),
            price=price,
            coupled=rows,
            right=form.b,
            equations=form.equations,
        )
        return PathBounds(model, hessians)

    def _boxes(self, model: PathModel, reaches: Sequence[Reach]) -> tuple[Mask, Array, Array]:
        """Return the edges (count, T, modes, modes) and boxes (count, T+1, modes, k) of reaches."""
        (T, modes), (n, stages), count = reaches[0].allowed.shape, (self._n, self._stages), len(reaches)
        allowed = np.zeros((count, T + 1, modes), dtype=bool)
        allowed[:, :-1], allowed[:, -1, 0] = [reach.allowed for reach in reaches], True
        low, high = np.zeros((2, count, T + 1, modes, len(stages.units)))
        lower = [reach.mode_lower for reach in reaches], [reach.lower[-1] for reach in reaches]
        upper = [reach.mode_upper for reach in reaches], [reach.upper[-1] for reach in reaches]
        for part, (inner, last) in ((low, lower), (high, upper)):
            part[:, :-1] = np.where(allowed[:, :-1, :, None], stages.scaled(np.array(inner)), 0.0)
            part[:, -1, 0, :n] = (np.array(last) - stages.last_reference) / stages.units[:n]
        return model.pairs(allowed, low, high), low, high

    @property
    def proves(self) -> bool:
        """Whether duals of any kind give a bound."""
        return self._bounds is not None

    def proven(self, reach: Reach, duals: Duals) -> float:
        """Return the bound on the cost within a reach that any duals prove; inf if it has no trajectory."""
        return float(self.proven_each([(reach, duals)])[0])

    def proven_each(self, claims: Sequence[tuple[Reach, Duals]]) -> Array:
        """Return the bounds that duals prove, each within its reach."""
        found, groups = np.full(len(claims), -np.inf), dict[tuple[float, bool], list[int]]()
        if self._bounds is None:
            return found
        for index, (_, duals) in enumerate(claims):
            groups.setdefault((duals.eta_C, duals.vertices is None), []).append(index)
        for (eta_C, _), group in groups.items():
            boxes = self._boxes(self._bounds.model, [claims[index][0] for index in group])
            bounds = self._bounds.bounds(*boxes, [claims[index][1] for index in group])
            found[group] = self.cost(bounds) if eta_C else np.where(bounds > 0, np.inf, -np.inf)
        return found

    def objective(self, cost: float) -> float:
        """Return the objective of a member of a cost."""
        return (cost - self._host.sparse.constant) * self._scaling.cost

    def cost(self, objective: Number) -> Number:
        """Return the cost of an objective of a member."""
        return objective / self._scaling.cost + self._host.sparse.constant

    def point(self, member: Member, z: Array) -> tuple[Trajectory, Array]:
        """Return (x, u), in which x need not follow from u, and the weights delta, (T, modes)."""
        full = np.zeros(self._at.count)
        full[member.columns] = z
        host = self._scaling.primal(full[: len(self._program.q)])
        weights = np.where((member.reach.allowed.sum(axis=1) == 1)[:, None], member.reach.allowed, full[self._at.delta])
        return self._host.trajectory(host), weights

    def violation(self, trajectory: Trajectory, sequence: Indices) -> float:
        """Return the largest violation of a constraint by a trajectory in a mode sequence (T,).

        It is in natural units, and relative to the largest signal if that is above 1.
        """
        z, stages, problem = self._scaling.scaled_primal(self._host.point(trajectory)), self._stages, self.problem
        at, y = (np.arange(len(sequence)), sequence), z[self._at.y][..., None]
        defects = (stages.maps[at] @ y)[..., 0] + stages.offsets[at] - z[self._at.x[1:]]
        beyond = (stages.rows[at] @ y)[..., 0] - stages.limits[at]
        of_x = problem.state_tube.violation(trajectory.x) / stages.units[: self._n]
        of_u = problem.control_tube.violation(trajectory.u) / stages.units[self._n :]
        others = self._shared.residuals(z, np.zeros(len(self._shared.lower))).primal
        largest = max(np.abs(defects).max(), beyond.max(initial=0.0), of_x.max(), of_u.max())
        return float(max(largest / max(1.0, np.abs(z[: self._host.signals]).max()), others))

    def duals(self, member: Member, y: Array, z: Array | None) -> Duals:
        """Return the duals of a member's standard form, P z + q + A'y = 0, or those of a ray."""
        full, rows = np.zeros(len(self._template.right)), self._rows
        full[member.form.row] = member.form.sign * y
        adjoint = rows.one_map.view(full).reshape(self._stages.offsets.shape).sum(axis=1) + rows.share_map.view(full)
        regions = np.maximum(rows.one_region.view(full) + rows.share_region.view(full), 0.0)
        of_equations, of_inequalities, of_cones = (part.view(full).ravel() for part in self._host_rows)
        sides = np.concatenate([of_equations, of_inequalities, -of_cones])
        return Duals(adjoint, sides, regions.reshape(self._stages.limits.shape), 0.0 if z is None else 1.0)

    def multipliers(self, duals: Duals) -> ModeMultipliers:
        """Return the multipliers of duals."""
        program = self._program
        host = self._sides.dual(len(program.lower), duals.sides)
        host[program.rows[Block.DYNAMICS]] = duals.adjoint.ravel()
        host_multipliers = self._host.multipliers(self._scaling.dual(host), duals.eta_C)
        if duals.vertices is None or duals.images is None:
            return ModeMultipliers(host_multipliers, duals.regions / self._stages.norms / self._scaling.cost)
        vertex_changes = duals.vertices - duals.adjoint[:, None]
        vertex_changes[-1] = 0.0  # a single vertex: its adjoint is the average
        units = self._adjoint_units
        region = duals.regions / self._stages.norms[:, :, None] / self._scaling.cost
        paths = PathMultipliers(vertex_changes * units[:, None], duals.images * units[:, None, None])
        return ModeMultipliers(host_multipliers, region, paths)

    def adjoint(self, duals: Duals) -> Array:
        """Return eta alone, (T, n)."""
        return duals.adjoint * self._adjoint_units

    @property
    def _adjoint_units(self) -> Array:
        of_dynamics = self._scaling.rows[self._program.rows[Block.DYNAMICS]]
        return of_dynamics.reshape(self.problem.horizon, self._n) / self._scaling.cost

    def require_bounds(self, reach: Reach) -> None:
        """Raise UnsupportedError if a signal has no bounds where the reach has several modes."""
        several = reach.allowed & (reach.allowed.sum(axis=1, keepdims=True) > 1)
        for bounds in (reach.mode_lower, reach.mode_upper):
            self._require_bounds(bounds, several)

    def _require_bounds(self, bounds: Array, needed: Mask) -> Array:
        """Return bounds (T, modes, k) in natural units; UnsupportedError where one is needed and missing."""
        bounded = np.abs(bounds) < LARGEST_BOUND
        missing = ~bounded & needed[..., None]
        if missing.any():
            t, _, j = (int(i) for i in np.argwhere(missing)[0])
            name = (*self.problem.state_names, *self.problem.control_names)[j]
            raise UnsupportedError(
                f"{name}: no Box bounds it at t = {t}, where several modes are possible; the search over modes needs "
                "one, alone, in an Intersection or in a FiniteSet, unless the initial state implies bounds."
            )
        return self._stages.scaled(np.where(bounded, bounds, 0.0))


def _box_rows(template: RowTemplate, columns: Indices) -> tuple[Groups, ...]:
    """Add upper, lower and equal rows for signals (times, components)."""
    row = np.arange(columns.shape[1])
    return tuple(
        template.add(sense, np.zeros(columns.shape), (row, columns, sign))
        for sense, sign in ((Sense.INEQUALITY, 1.0), (Sense.INEQUALITY, -1.0), (Sense.EQUATION, 1.0))
    )
