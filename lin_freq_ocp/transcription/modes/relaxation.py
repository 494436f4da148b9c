"""The convex relaxation of a piecewise-affine problem whose modes are restricted to a mask (T, modes).

Where one mode is left, its map and region are rows on (x_t, u_t). Where several are, y_{t,i} is the share of mode i in
(x_t, u_t) and delta_{t,i} >= 0 its weight (the perspective formulation: Moehle and Boyd 2015, Marcucci and Tedrake
2019), in the boxes of ``problem.mode_reach``:

    SUM     x_t = sum_i y_x,  u_t = sum_i y_u,  sum_i delta_i = 1
    MAP     x_{t+1} = sum_i A_i y_x + B_i y_u + d_i delta_i
    REGION  G_i y_x + H_i y_u <= h_i delta_i
    BOX     lower_i delta_i <= y_i <= upper_i delta_i
    CONE    cost sum_i delta_i c_t(y_i / delta_i) by epigraphs: 2 epsilon_i delta_i >= |L y_i|^2, L'L the Hessian

It is the convex hull of graph and cost of each stage. Two weaker ones, to compare with: "hull" has the cost of
(x_t, u_t) itself, and "big_m" no shares, but the rows of each mode within M (1 - delta_i), with M from the same boxes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.analysis.mode_reach import ENDLESS, UNBOUNDED, ModeReach, Reach
from lin_freq_ocp.analysis.mode_tree import ModeMultipliers
from lin_freq_ocp.arrays import Array, Indices, Mask
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transcription.linear.transcription import LinearTranscription
from lin_freq_ocp.transcription.linear.units import common_scaling
from lin_freq_ocp.transcription.modes.row_template import Groups, RowTemplate, Sense
from lin_freq_ocp.transcription.modes.rows import ModeColumns, mode_rows
from lin_freq_ocp.transcription.modes.stages import hessian_roots, mode_stages
from lin_freq_ocp.transcription.program import Block
from lin_freq_ocp.transcription.standard_form import StandardForm

RELAXATIONS = ("perspective", "hull", "big_m")

FIXED = 1e-9
"""A box narrower than this, in natural units, is an equation: interior-point methods need an interior."""


@dataclass(frozen=True, eq=False)
class Member:
    """The relaxation of one reach, and which rows and columns of the template it has."""

    form: StandardForm
    reach: Reach
    rows: Indices
    columns: Indices


class ModeRelaxation:
    """The relaxations of one problem.

    Parameters
    ----------
    problem : OptimalControlProblem
        With piecewise-affine dynamics and a convex cost.
    kind : {"perspective", "hull", "big_m"}
    """

    def __init__(self, problem: OptimalControlProblem, kind: str = "perspective"):
        self.problem, self.kind, self.reach = problem, kind, ModeReach(problem)
        T, n, m = problem.horizon, problem.state_dim, problem.control_dim
        sequences = [np.full(T, mode, dtype=np.intp) for mode in range(len(problem.piecewise.modes))]
        hosts = [LinearTranscription(replace(problem, dynamics=problem.piecewise.along(one))) for one in sequences]
        self._host, self._scaling = hosts[0], common_scaling(hosts)
        self._program = self._scaling.apply(self._host.program)
        states = (T + 1) * n
        units = np.concatenate([self._scaling.columns[:n], self._scaling.columns[states : states + m]])
        self._stages, self._n = mode_stages(problem, units), n
        self._at = ModeColumns(T, len(problem.piecewise.modes), n, m, len(self._program.q))
        template = RowTemplate()
        self._add_host_rows(template)
        self._x_boxes, self._u_boxes = self._add_boxes(template)
        roots = np.sqrt(self._scaling.cost) * hessian_roots(problem.quadratic, units, T)
        self._rows = mode_rows(template, self._stages, self._at, roots)
        self._template = template.finished(self._at.count)
        self._hessian = sp.coo_array(sp.triu(self._program.P))
        self._price = np.zeros(self._at.count)
        self._price[: len(self._program.q)] = self._program.q
        self._price[self._at.epsilon] = 1.0
        self._stage = np.full(self._at.count, -1)
        self._stage[self._at.y] = np.arange(T)[:, None]

    def member(self, reach: Reach) -> Member:
        """Return the relaxation of the modes that a reach allows.

        Raises
        ------
        UnsupportedError
            If a state or control is not bounded.
        """
        single = reach.allowed.sum(axis=1) == 1
        many = reach.allowed & ~single[:, None]
        values, right = self._template.values.copy(), self._template.right.copy()
        rows, columns = np.zeros(len(right), dtype=bool), np.ones(self._at.count, dtype=bool)
        for part in self._host_rows:
            rows[part.rows] = True
        self._take_boxes(rows, right, reach, ~single)
        one, finite = reach.allowed & single[:, None], np.isfinite(self._stages.limits)
        _take(rows, self._rows.one_map, one)
        _take(rows, self._rows.one_region, one, finite)
        _take(rows, self._rows.weight_sum, ~single)
        _take(rows, self._rows.weight, many)
        if self.kind == "big_m":
            self._take_far_rows(rows, values, right, reach, many, finite)
        else:
            self._take_shares(rows, values, reach, many, finite)
        columns[self._at.delta] = many
        columns[self._at.share] = many[..., None] & (self.kind != "big_m")
        columns[self._at.epsilon] = many & (self.kind == "perspective")
        assembled = self._template.member(rows, columns, values, right)
        kept = np.flatnonzero(columns)
        rank = self._rows.cone.rows.shape[1]
        own = int(many.sum()) if self.kind == "perspective" else 0
        cones = (*(cone.stop - cone.start for cone in self._program.cones), *[rank] * own)
        equations, inequalities = assembled.senses[Sense.EQUATION], assembled.senses[Sense.INEQUALITY]
        P = self._hessian_of(single, columns, kept)
        form = StandardForm(P, self._price[kept], assembled.A, assembled.b, equations, inequalities, cones)
        return Member(form, reach, assembled.rows, kept)

    @property
    def state_curvature(self) -> Array:
        """Return the largest diagonal of the cost's Hessian for each state, (n,)."""
        stage = np.abs(self.problem.quadratic.stage_hessians()).max(axis=0).diagonal()[: self._n]
        return np.maximum(stage, np.abs(np.diagonal(self.problem.quadratic.P)))

    def cost(self, objective: float) -> float:
        """Return the cost that the objective of a member stands for."""
        return objective / self._scaling.cost + self._host.program.constant

    def point(self, member: Member, z: Array) -> tuple[Trajectory, Array]:
        """Return (x, u), in which x need not follow from u, and the weights delta, (T, modes)."""
        full = np.zeros(self._at.count)
        full[member.columns] = z
        host = self._scaling.primal(full[: len(self._program.q)])
        weights = np.where((member.reach.allowed.sum(axis=1) == 1)[:, None], member.reach.allowed, full[self._at.delta])
        return self._host.trajectory(host), weights

    def multipliers(self, kept: Indices, y: Array, eta_C: float) -> ModeMultipliers:
        """Return the multipliers of duals y of the rows that a member kept, P z + q + A'y = 0."""
        full = np.zeros(len(self._template.right))
        full[kept] = y
        rows, shape = self._rows, self._stages.offsets.shape
        eta = full[rows.one_map.rows].reshape(shape).sum(axis=1) + full[rows.share_map.rows]
        if self.kind == "big_m":
            above, below = (
                full[part.rows].reshape(self._stages.offsets.shape) for part in (rows.far_above, rows.far_below)
            )
            eta = eta + (above - below).sum(axis=1)
        of_regions = (full[part.rows] for part in (rows.one_region, rows.share_region, rows.far_region))
        region = sum(of_regions, np.zeros(rows.one_region.rows.shape)).reshape(self._stages.limits.shape)
        program = self._program
        host = self._sides.dual(len(program.lower), *(full[part.rows].ravel() for part in self._host_rows[:2]))
        host[program.in_cones] = -full[self._host_rows[2].rows].ravel()
        host[program.rows[Block.DYNAMICS]] = self._scaled_adjoint(full).ravel()
        own = self._host.multipliers(self._scaling.dual(host), eta_C)
        return ModeMultipliers(own, region / self._stages.norms / self._scaling.cost)

    def adjoint(self, kept: Indices, y: Array) -> Array:
        """Return eta alone, (T, n)."""
        of_dynamics = self._scaling.rows[self._program.rows[Block.DYNAMICS]]
        eta = self._scaled_adjoint(self._filled(kept, y))
        return eta * of_dynamics.reshape(eta.shape) / self._scaling.cost

    def _filled(self, kept: Indices, y: Array) -> Array:
        full = np.zeros(len(self._template.right))
        full[kept] = y
        return full

    def _scaled_adjoint(self, full: Array) -> Array:
        rows, shape = self._rows, self._stages.offsets.shape
        eta = full[rows.one_map.rows].reshape(shape).sum(axis=1) + full[rows.share_map.rows]
        if self.kind == "big_m":
            above, below = (full[part.rows].reshape(shape) for part in (rows.far_above, rows.far_below))
            eta = eta + (above - below).sum(axis=1)
        return eta

    def _add_host_rows(self, template: RowTemplate) -> None:
        """Add what the host program has beyond dynamics and boxes: spectra and terms."""
        program, others = self._program, np.ones(len(self._program.lower), dtype=bool)
        for block in (Block.DYNAMICS, Block.STATE_SET, Block.CONTROL_SET):
            others[program.rows[block]] = False
        lower, upper = np.where(others, program.lower, -np.inf), np.where(others, program.upper, np.inf)
        self._sides, curved = replace(program, lower=lower, upper=upper).one_sided(), program.in_cones
        self._host_rows = tuple(
            _added(template, sense, matrix, right)
            for sense, matrix, right in (
                (Sense.EQUATION, self._sides.A, self._sides.b),
                (Sense.INEQUALITY, self._sides.G, self._sides.h),
                (Sense.CONE, -program.A[curved], -program.lower[curved]),
            )
        )

    def _add_boxes(self, template: RowTemplate) -> tuple[tuple[Groups, ...], tuple[Groups, ...]]:
        """Add upper, lower and equal rows for x, (T+1, n), and for u, (T, m)."""
        signs = (Sense.INEQUALITY, 1.0), (Sense.INEQUALITY, -1.0), (Sense.EQUATION, 1.0)

        def rows(at: Indices) -> tuple[Groups, ...]:
            nothing, row = np.zeros(at.shape), np.arange(at.shape[1])
            return tuple(template.add(sense, nothing, row, at, nothing + sign) for sense, sign in signs)

        return rows(self._at.x), rows(self._at.y[:, self._n :])

    def _take_boxes(self, rows: Mask, right: Array, reach: Reach, several: Mask) -> None:
        """Take the bounds of x_t and u_t where shares do not have them."""
        stages, n, tube = self._stages, self._n, self.problem.control_tube
        u_lower, u_upper = np.maximum(tube.lower, -ENDLESS), np.minimum(tube.upper, ENDLESS)
        references = np.vstack([stages.references[:, :n], stages.last_reference])
        wanted = np.append(~several | (self.kind == "big_m"), True)
        for groups, lower, upper, units, taken in (
            (self._x_boxes, reach.lower - references, reach.upper - references, stages.units[:n], wanted),
            (
                self._u_boxes,
                u_lower - stages.references[:, n:],
                u_upper - stages.references[:, n:],
                stages.units[n:],
                wanted[:-1],
            ),
        ):
            low, high = lower / units, upper / units
            equal = high - low <= FIXED
            for group, value, mask in zip(
                groups,
                (high, -low, (low + high) / 2),
                (~equal & (high < UNBOUNDED), ~equal & (low > -UNBOUNDED), equal),
                strict=True,
            ):
                mask = mask & taken[:, None]
                rows[group.rows[mask]] = True
                right[group.rows[mask]] = value[mask]

    def _take_shares(self, rows: Mask, values: Array, reach: Reach, many: Mask, finite: Mask) -> None:
        several, groups = np.asarray(many.any(axis=1)), self._rows
        lower, upper = self._bounded(reach.mode_lower, many), self._bounded(reach.mode_upper, many)
        equal = upper - lower <= FIXED
        for part in (groups.share_sum, groups.share_map):
            _take(rows, part, several)
        _take(rows, groups.share_region, many, finite)
        k = lower.shape[-1]
        for part, bound, mask in (
            (groups.share_upper, -upper, ~equal),
            (groups.share_lower, lower, ~equal),
            (groups.share_equal, -(lower + upper) / 2, equal),
        ):
            _take(rows, part, many, mask)
            values[part.entries[:, k:]] = bound.reshape(-1, k)
        if self.kind == "perspective":
            _take(rows, groups.cone, many)

    def _take_far_rows(self, rows: Mask, values: Array, right: Array, reach: Reach, many: Mask, finite: Mask) -> None:
        """Take the rows of modes with M, the most by which any point of the boxes violates them."""
        stages, groups, n = self._stages, self._rows, self._n
        lower, upper = self._bounded(reach.mode_lower, many), self._bounded(reach.mode_upper, many)
        low = np.where(many[..., None], lower, np.inf).min(axis=1, keepdims=True)
        high = np.where(many[..., None], upper, -np.inf).max(axis=1, keepdims=True)
        low, high = (np.where(np.isfinite(bound), bound, 0.0) for bound in (low, high))
        references = np.vstack([stages.references[1:, :n], stages.last_reference])
        next_low, next_high = (
            ((bound[1:] - references) / stages.units[:n])[:, None] for bound in (reach.lower, reach.upper)
        )
        least, most = _range(stages.maps, low, high)
        reached = _range(stages.rows, low, high)[1]
        limits = np.where(finite, stages.limits, 0.0)
        above, below = next_high - least - stages.offsets, most + stages.offsets - next_low
        for part, excess, limit, mask in (
            (groups.far_above, above, stages.offsets, np.ones_like(above, dtype=bool)),
            (groups.far_below, below, -stages.offsets, np.ones_like(below, dtype=bool)),
            (groups.far_region, reached - limits, limits, finite),
        ):
            M = np.maximum(excess, 0.0).reshape(part.rows.shape)
            _take(rows, part, many, mask)
            values[part.entries[:, -part.rows.shape[1] :]] = M
            right[part.rows] = limit.reshape(M.shape) + M

    def _bounded(self, bounds: Array, needed: Mask) -> Array:
        """Return bounds (T, modes, k) in natural units."""
        bounded = np.abs(bounds) < UNBOUNDED
        endless = ~bounded & needed[..., None]
        if endless.any():
            t, _, j = (int(i) for i in np.argwhere(endless)[0])
            name = (*self.problem.state_names, *self.problem.control_names)[j]
            raise UnsupportedError(
                f"{name}: unbounded at t = {t}, where several modes are possible; the search over modes needs bounds "
                "that states and controls, or the reach from the initial state, have."
            )
        return self._stages.scaled(np.where(bounded, bounds, 0.0))

    def _hessian_of(self, single: Mask, columns: Mask, kept: Indices) -> sp.csc_matrix:
        row, column = self._hessian.coords
        stage = self._stage[row]
        keep = (stage < 0) | single[stage] if self.kind == "perspective" else np.ones(len(row), dtype=bool)
        shape = (len(kept), len(kept))
        return sp.csc_matrix((self._hessian.data[keep], (row[keep], column[keep])), shape=shape)


def _take(rows: Mask, groups: Groups, chosen: Mask, within: Mask | None = None) -> None:
    """Take the groups where ``chosen`` (any shape of as many), and of their rows those ``within`` (groups, size)."""
    mask = np.broadcast_to(chosen.reshape(-1, 1), groups.rows.shape)
    if within is not None:
        mask = mask & within.reshape(groups.rows.shape)
    rows[groups.rows[mask]] = True


def _added(template: RowTemplate, sense: Sense, matrix: sp.csc_array, right: Array) -> Groups:
    entries = sp.coo_array(matrix)
    row, column = (np.asarray(part, dtype=np.intp) for part in entries.coords)
    return template.add(sense, right[None], row, column[None], entries.data[None])


def _range(matrices: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Return the least and largest value of every row of (T, modes, rows, k) over boxes (T, 1, k)."""
    ends = matrices * low[:, :, None], matrices * high[:, :, None]
    return np.minimum(*ends).sum(axis=-1), np.maximum(*ends).sum(axis=-1)
