"""The convex relaxation of a piecewise-affine problem whose modes are restricted to a mask (T, modes).

Where one mode is left, its map and region are rows on (x_t, u_t). Where several are, y_{t,i} is the share of mode i in
(x_t, u_t) and delta_{t,i} >= 0 its weight (the perspective formulation: Moehle and Boyd 2015, Marcucci and Tedrake
2019), in the boxes of ``problem.mode_reach``:

    SUM     x_t = sum_i y_x,  u_t = sum_i y_u,  sum_i delta_i = 1
    MAP     x_{t+1} = sum_i A_i y_x + B_i y_u + d_i delta_i
    REGION  G_i y_x + H_i y_u <= h_i delta_i
    BOX     lower_i delta_i <= y_i <= upper_i delta_i
    CONE    cost sum_i delta_i c_t(y_i / delta_i) by epigraphs: 2 epsilon_i delta_i >= |L y_i|^2, L'L the Hessian

It is the convex hull of graph and cost of each stage.
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
from lin_freq_ocp.transcription.program import Block, Program

# Of the cost in common units, so that its slopes are of order 1: bounds are asked for to a part of the cost, and a
# larger cost takes more iterations
COST_SHARE = 0.1
FIXED = 1e-9  # A box narrower than this, in natural units, is an equation: interior-point methods need an interior


@dataclass(frozen=True, eq=False)
class Member:
    """The relaxation of one reach, and which rows and columns of the template it has."""

    program: Program
    reach: Reach
    rows: Indices
    columns: Indices


class ModeRelaxation:
    """The relaxations of one problem.

    Parameters
    ----------
    problem : OptimalControlProblem
        With piecewise-affine dynamics and a convex cost.
    """

    bounds_where_several = False
    """Whether (x_t, u_t) has its own bounds where shares have them, too."""

    def __init__(self, problem: OptimalControlProblem):
        self.problem, self.reach = problem, ModeReach(problem)
        T, n, m = problem.horizon, problem.state_dim, problem.control_dim
        sequences = [np.full(T, mode, dtype=np.intp) for mode in range(len(problem.piecewise.modes))]
        hosts = [LinearTranscription(replace(problem, dynamics=problem.piecewise.along(one))) for one in sequences]
        self._host, units = hosts[0], common_scaling(hosts)
        self._scaling = replace(units, cost=COST_SHARE * units.cost)
        self._program = self._host.program.scaled(self._scaling)
        states = (T + 1) * n
        sizes = np.concatenate([units.columns[:n], units.columns[states : states + m]])
        self._stages, self._n = mode_stages(problem, sizes), n
        self._at = ModeColumns(T, len(problem.piecewise.modes), n, m, len(self._program.q))
        template = RowTemplate()
        self._add_host_rows(template)
        self._x_boxes, self._u_boxes = self._add_boxes(template)
        roots = np.sqrt(units.cost) * hessian_roots(problem.quadratic, sizes, T)
        self._add_rows(template, roots)
        self._template = template.finished(self._at.count)
        self._hessian = sp.coo_array(self._program.P)
        self._price = np.zeros(self._at.count)
        self._price[: len(self._program.q)] = self._program.q
        self._price[self._at.epsilon] = COST_SHARE
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
        self._take_boxes(rows, right, reach, ~single & (not self.bounds_where_several))
        one, finite = reach.allowed & single[:, None], np.isfinite(self._stages.limits)
        take(rows, self._rows.one_map, one)
        take(rows, self._rows.one_region, one, finite)
        take(rows, self._rows.weight_sum, ~single)
        take(rows, self._rows.weight, many)
        self._take_several(rows, values, right, reach, many)
        self._several_columns(columns, many)
        A, lower, upper = self._template.member(rows, columns, values, right)
        kept = np.flatnonzero(columns)
        program = Program(
            self._hessian_of(single, kept), self._price[kept], 0.0, A, lower, upper, {}, self._cones(rows)
        )
        return Member(program, reach, np.flatnonzero(rows), kept)

    def _cones(self, taken: Mask) -> tuple[slice, ...]:
        """Return the rows of the cones of a member: all rows of a cone are taken, or none."""
        host, own = self._host_rows[2].rows.ravel(), self._rows.cone.rows
        firsts = np.concatenate([host[self._host_cones[:, 0]], own[:, 0]])
        sizes = np.append(self._host_cones[:, 1], np.full(len(own), own.shape[1]))
        chosen = taken[firsts]
        starts = (np.cumsum(taken) - 1)[firsts[chosen]]
        return tuple(slice(int(a), int(a) + int(size)) for a, size in zip(starts, sizes[chosen], strict=True))

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
        full, rows, program = self._filled(kept, y), self._rows, self._program
        region = full[rows.one_region.rows] + full[rows.share_region.rows]
        of_equations, of_inequalities, of_cones = (full[part.rows].ravel() for part in self._host_rows)
        host = self._sides.dual(len(program.lower), np.concatenate([of_equations, of_inequalities, -of_cones]))
        host[program.rows[Block.DYNAMICS]] = self._scaled_adjoint(full).ravel()
        own = self._host.multipliers(self._scaling.dual(host), eta_C)
        region = region.reshape(self._stages.limits.shape) / self._stages.norms / self._scaling.cost
        return ModeMultipliers(own, region)

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
        return full[rows.one_map.rows].reshape(shape).sum(axis=1) + full[rows.share_map.rows]

    def _add_host_rows(self, template: RowTemplate) -> None:
        """Add what the host program has beyond dynamics and boxes: spectra and terms."""
        program, others = self._program, np.ones(len(self._program.lower), dtype=bool)
        for block in (Block.DYNAMICS, Block.STATE_SET, Block.CONTROL_SET):
            others[program.rows[block]] = False
        lower, upper = np.where(others, program.lower, -np.inf), np.where(others, program.upper, np.inf)
        form = self._sides = replace(program, lower=lower, upper=upper).standard()
        ends = form.equations, form.equations + form.inequalities
        A, b = sp.csr_array(form.A), np.split(form.b, ends)
        self._host_rows = (
            _added(template, Sense.EQUATION, A[: ends[0]], b[0]),
            _added(template, Sense.INEQUALITY, A[ends[0] : ends[1]], b[1]),
            _added(template, Sense.CONE, -A[ends[1] :], -b[2]),
        )
        sizes = np.array(form.cones, dtype=np.intp)
        self._host_cones = np.column_stack([np.cumsum(sizes) - sizes, sizes])

    def _add_rows(self, template: RowTemplate, roots: Array) -> None:
        self._rows = mode_rows(template, self._stages, self._at, roots)

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
        wanted = np.append(~several, True)
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

    def _several_columns(self, columns: Mask, many: Mask) -> None:
        """Take the variables of modes where several are left."""
        columns[self._at.delta] = columns[self._at.epsilon] = many
        columns[self._at.share] = many[..., None]

    def _take_several(self, rows: Mask, values: Array, right: Array, reach: Reach, many: Mask) -> None:
        """Take the rows of modes where several are left, and fill in what depends on the reach."""
        several, groups, finite = np.asarray(many.any(axis=1)), self._rows, np.isfinite(self._stages.limits)
        lower, upper = self._bounded(reach.mode_lower, many), self._bounded(reach.mode_upper, many)
        equal = upper - lower <= FIXED
        for part in (groups.share_sum, groups.share_map):
            take(rows, part, several)
        take(rows, groups.share_region, many, finite)
        k = lower.shape[-1]
        for part, bound, mask in (
            (groups.share_upper, -upper, ~equal),
            (groups.share_lower, lower, ~equal),
            (groups.share_equal, -(lower + upper) / 2, equal),
        ):
            take(rows, part, many, mask)
            values[part.entries[:, k:]] = bound.reshape(-1, k)
        take(rows, groups.cone, many)

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

    def _hessian_of(self, single: Mask, kept: Indices) -> sp.csc_array:
        """Return the cost of what has no shares; the columns of the host come first, and are all kept."""
        row, column = self._hessian.coords
        stage = self._stage[row]
        keep = (stage < 0) | single[stage]
        return sp.csc_array((self._hessian.data[keep], (row[keep], column[keep])), shape=(len(kept), len(kept)))


def take(rows: Mask, groups: Groups, chosen: Mask, within: Mask | None = None) -> None:
    """Take the groups where ``chosen`` (any shape of as many), and of their rows those ``within`` (groups, size)."""
    mask = np.broadcast_to(chosen.reshape(-1, 1), groups.rows.shape)
    if within is not None:
        mask = mask & within.reshape(groups.rows.shape)
    rows[groups.rows[mask]] = True


def _added(template: RowTemplate, sense: Sense, matrix: sp.csr_array, right: Array) -> Groups:
    entries = sp.coo_array(matrix)
    row, column = (np.asarray(part, dtype=np.intp) for part in entries.coords)
    return template.add(sense, right[None], row, column[None], entries.data[None])
