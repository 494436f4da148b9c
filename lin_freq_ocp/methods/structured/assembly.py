"""A linear program as stages, in deviations from an origin, and the way back.

Rows of single times become rows of stages, and their slacks entries of w after the controls; all other rows become
coupling rows.

The origin consists of the references, and of the controls whose two bounds are equal. Such a control is fixed: it has
no entry in the stage of that time, unless it is in a row that couples times. There its deviation is zero.

Duals z are a list: dynamics (T+1, n), x_0 (n,), stages (T+1, p), equations flat, inequalities (count, 1), and
(balls, 1 + dim) for each family of balls, with H y + h + A'z = 0 where A are the rows of dynamics, x_0, G, equations,
inequalities, and minus those of balls. The multiplier of a value is the sum of its rows' duals times their weights.

The stages are scaled to units in which entries of y, limits of rows and cones are of order 1, and the steepest slope of
the cost is 10:

    y = columns * y',   row' = factor * row,   cost' = factor * cost;   z = factor of the row * z' / factor of the cost
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.methods.structured.rows import (
    Columns,
    StageRowList,
    StageSlots,
    assign_slots,
    coupled_parts,
    restrict_to_channels,
    stage_equations,
    stage_rows,
)
from lin_freq_ocp.methods.structured.stages import Balls, Coupling, Equations, Inequalities, Stages, inverse_sizes
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.program import Scaling
from lin_freq_ocp.program.units import UNIT_ROUNDING, UNNOTICED, cost_factor, is_revision, point_units
from lin_freq_ocp.transform.simulation import within_reach
from lin_freq_ocp.transform.sizes import stated_sizes

WEIGHTS = ("Q", "R", "S", "q", "r", "P", "p")  # of the quadratic cost: all but its references
PARTS = ("terms", "control_tube", "state_boxes", "state_stop", "control_stop")  # of problems with the same rows


@dataclass(frozen=True, eq=False)
class Assembly:
    """The stages of a problem in the units of the method, with the maps from one to the other."""

    stages: Stages
    program: LinearProgram
    fixed: Mask  # controls that are not in the stages, (T, m)
    positions: Indices  # of the program's variables in y, flat
    used: Mask  # entries of y, (T+1, n+k)
    priced: Mask  # those that determine the size of the cost: signals, and slacks of nonsmooth costs
    units: Scaling  # columns (T+1, n+k); rows after those of the dynamics, flat
    targets: Indices  # the multiplier of each dual after those of the dynamics, flat; -1: none
    weights: Array  # of these duals

    @property
    def problem(self) -> OptimalControlProblem:
        """Return the problem whose stages these are."""
        return self.program.problem

    def point(self, trajectory: Trajectory) -> Array:
        """Return y of a trajectory, with the least slacks."""
        y = self._on_stages(self.program.point(trajectory))
        self.of_controls(y)[self.fixed] = 0.0
        return self.units.scaled_primal(y)

    def trajectory(self, y: Array) -> Trajectory:
        """Return (x, u) from y (T+1, n+k)."""
        return self.program.trajectory(self._variables(self.units.primal(y)))

    def direction(self, y: Array) -> Trajectory:
        """Return the change (dx, du) of a change of y."""
        return self.program.direction(self._variables(self.units.primal(y)))

    def multipliers(self, z: Sequence[Array], eta_C: float, y: Array | None = None) -> Multipliers:
        """Return the multipliers of the maximum principle from all duals; eta_C = 0 for a Farkas ray, without y."""
        problem, units, n = self.problem, self.units, self.problem.state_dim
        duals = units.dual(np.concatenate([part.ravel() for part in z[1:]]))
        eta = z[0][:-1] / units.columns[1:, :n] / units.cost
        multipliers = self.program.layout.multipliers(eta, self.targets, self.weights * duals, eta_C)
        if not self.fixed.any():
            return multipliers
        # for fixed controls, stationarity: nu = -(eta_C dJ/du - B'eta + (rows of stages)'lambda)
        shapes, slopes = (multipliers.mu.shape, multipliers.nu.shape), -problem.linear.pull_back(eta)[:, n:]
        for term in problem.terms:
            if term.map.stage_form(n, problem.control_dim) is not None:
                slopes += term.map.pull_back(multipliers.stage[term.name], shapes)[1]
        if eta_C:
            assert y is not None  # the cost has slopes
            trajectory = self.trajectory(y)
            slopes += eta_C * problem.quadratic.gradient(trajectory.x, trajectory.u)[1]
        return replace(multipliers, nu=np.where(self.fixed, -slopes, multipliers.nu))

    def revised(self, y: Array) -> Assembly | None:
        """Return the stages in units of the size of a solution y, or None if the present units are similar."""
        old = self.units
        columns = self._variables(old.columns)
        new = point_units(self.program, self._variables(old.primal(y)), columns)
        ratio = self._on_stages(new / columns, 1.0)
        stages, change = scale_stages(self.stages, ratio, self.priced, y)
        if not is_revision(ratio, change.cost):
            return None
        units = Scaling(old.columns * ratio, old.rows * change.rows, old.cost * change.cost)
        return replace(self, stages=fix_unused_entries(stages, self.used), units=units)

    def exchanged(self, problem: OptimalControlProblem) -> Assembly | None:
        """Return the stages of a problem with other dynamics, references and fixed ends, in the same units.

        None if anything else differs, or is not the same object (``with_ends``, ``affine_at``, ``with_references``).
        """
        old, columns = self.problem, self.units.columns
        same_parts = all(getattr(problem, name) is getattr(old, name) for name in PARTS)
        if not same_parts or any(
            getattr(problem.quadratic, name) is not getattr(old.quadratic, name) for name in WEIGHTS
        ):
            return None
        (ends, fixed), (old_ends, old_fixed) = _ends(problem), _ends(old)
        if (fixed != old_fixed).any() or (ends != old_ends)[:, ~fixed].any():
            return None
        coupling, origin, n = self.stages.coupling, self.program.origin, problem.state_dim
        program = LinearProgram(problem, origin)
        A, B, d = scale_dynamics(*_dynamics(program, self.fixed, columns.shape[1]), columns)
        if problem.linear.A is old.linear.A and problem.linear.B is old.linear.B:
            A, B = self.stages.A, self.stages.B
        deviation = (ends[0] - origin.x[[0, -1]]) / columns[[0, -1], :n]
        terminal = replace(coupling, terminal_state=deviation[1, coupling.terminal])
        initial = np.where(fixed[0], deviation[0], np.nan)
        stages = replace(self.stages, A=A, B=B, d=d, initial=initial, coupling=terminal)
        if problem.quadratic is not old.quadratic:  # other references, at the same origin
            h, (in_x, in_u) = stages.h.copy(), problem.quadratic.gradient(origin.x, origin.u)
            h[:, :n], self.of_controls(h)[:] = in_x, np.where(self.fixed, 0.0, in_u)
            h[:, : n + problem.control_dim] *= self.units.cost * columns[:, : n + problem.control_dim]
            stages = replace(stages, h=h, constant=program.constant * self.units.cost)
        stages.__dict__["coupled"] = self.stages.coupled
        return replace(self, stages=stages, program=program)

    def same_matrices(self, other: Assembly) -> bool:
        """Whether another assembly has the same arrays except for right-hand sides (``exchanged``)."""
        names = "A", "B", "H", "G", "coupled"
        return all(getattr(self.stages, name) is getattr(other.stages, name) for name in names)

    def of_controls(self, y: Array) -> Array:
        """Return a view of the entries of y that are controls, (T, m)."""
        return y[:-1, self.problem.state_dim : self.problem.state_dim + self.problem.control_dim]

    def _on_stages(self, values: Array, others: float = 0.0) -> Array:
        """Return values of the program's variables at their entries of y, and another number elsewhere."""
        y = np.full(self.stages.h.shape, others)
        y.flat[self.positions] = values
        return y

    def _variables(self, y: Array) -> Array:
        """Return the entries of y that are variables of the program, in its order."""
        return y.ravel()[self.positions]


def assemble_stages(
    problem: OptimalControlProblem,
    sizes: tuple[Array, Array] | None = None,
    given_slacks: Sequence[Array] | None = None,
) -> Assembly:
    """Return the stages of a problem; UnsupportedError if its dynamics are not linear, or a term does not fit.

    Units are the sizes of states (n,) and controls (m,), by default those that the data state. The origin of the slacks
    of each term is by default that of ``LinearProgram``.
    """
    origin, fixed = choose_origin(problem)
    program, (T, m), n = LinearProgram(problem, origin, given_slacks), fixed.shape, problem.state_dim
    ends, fixed_ends = _ends(problem)
    fixed_states = np.zeros((T + 1, n), dtype=bool)
    fixed_states[[0, -1]] = fixed_ends
    absent = np.concatenate([np.zeros(fixed_states.size, dtype=bool), fixed.ravel()])
    rows = stage_rows(program, np.concatenate([fixed_states.ravel(), fixed.ravel()]), absent)
    slots = assign_slots(rows)
    width = n + m + slots.slack_count
    entries = np.arange((T + 1) * width).reshape(T + 1, width)
    slacks = rows.slack_times * width + n + m + slots.slack_slot
    positions = np.concatenate([entries[:, :n].ravel(), entries[:-1, n : n + m].ravel(), slacks])
    columns = Columns(positions, entries.size, width)
    coupling_rows = [rows for rows in program.rows if rows.times is None]
    parts = [part for rows in coupling_rows for part in coupled_parts(program, rows, columns)]
    if len(slots.equations):
        parts.append(stage_equations(rows, slots.equations, columns))
    terminal = np.flatnonzero(fixed_ends[1])
    coupling = restrict_to_channels(parts, width, terminal, ends[0, 1, terminal] - origin.x[-1, terminal])
    initial = np.where(fixed_ends[0], ends[0, 0] - origin.x[0], np.nan)
    plain = _plain_stages(program, fixed, rows, slots, columns, coupling, initial)
    # the multipliers of the duals after those of the dynamics: x_0, stages, x_T, then the coupling rows by kinds
    x_0 = np.where(fixed_ends[0], program.layout.mu + np.arange(n), -1)
    x_T = program.layout.mu + T * n + terminal
    of_stages, signs = np.full((T + 1, slots.count), -1), np.ones((T + 1, slots.count))
    at = rows.times[slots.source], slots.slot
    of_stages[at], signs[at] = rows.targets[slots.source], slots.sign
    ordered = [part for kind in (Equations, Inequalities, Balls) for part in parts if isinstance(part.family, kind)]
    targets = np.concatenate([x_0, of_stages.ravel(), x_T, *(part.targets.ravel() for part in ordered)])
    of_parts = [part.weights.ravel() for part in ordered]
    weights = np.concatenate([np.ones(n), signs.ravel(), np.ones(len(x_T)), *of_parts])
    used = np.zeros(entries.shape, dtype=bool)
    used.flat[positions] = ~np.append(absent, np.zeros(len(slacks), dtype=bool))
    priced = used.copy()
    priced.flat[positions] &= program.priced
    units = np.ones(used.shape)
    units.flat[positions] = program.column_units(*(sizes or stated_sizes(problem)))
    stages, scaled = scale_stages(plain, units, priced)
    stages = fix_unused_entries(stages, used)
    return Assembly(stages, program, fixed, positions, used, priced, scaled, targets, weights)


def choose_origin(problem: OptimalControlProblem) -> tuple[Trajectory, Mask]:
    """Return the origin of a problem, and which controls are fixed at it, (T, m)."""
    n, m, tube = problem.state_dim, problem.control_dim, problem.control_tube
    # controls in rows that couple times are not fixed
    coupled = problem.control_stop.any(axis=0)
    for term in problem.terms:
        if term.map.stage_form(n, m) is None:
            form = term.map.spectrum_form(n, m)
            coupled = coupled | (True if form is None else form.row[n:] != 0)
    fixed = (tube.lower == tube.upper) & ~coupled
    x = within_reach(problem, problem.quadratic.x_ref)
    return Trajectory(x, np.where(fixed, tube.lower, problem.quadratic.u_ref)), fixed


def _plain_stages(
    program: LinearProgram,
    fixed: Mask,
    rows: StageRowList,
    slots: StageSlots,
    columns: Columns,
    coupling: Coupling,
    initial: Array,
) -> Stages:
    """Return the stages in the units of the problem; unused entries of y have the Hessian 0."""
    cost, (T, m), n, width = program.problem.quadratic, fixed.shape, len(initial), columns.width
    H, h = np.zeros((T + 1, width, width)), np.zeros((T + 1, width))
    H[:-1, : n + m, : n + m], H[-1, :n, :n] = cost.stage_hessians, cost.P
    h.flat[columns.positions] = program.gradient
    time, control = np.nonzero(fixed)
    H[time, n + control], H[time, :, n + control], h[time, n + control] = 0.0, 0.0, 0.0
    G, g = np.zeros((T + 1, slots.count, width)), np.full((T + 1, slots.count), np.inf)
    time, entries = rows.times[slots.source], rows.matrix[slots.source]
    row = np.repeat(np.arange(len(time)), np.diff(entries.indptr))
    G[time[row], slots.slot[row], columns.positions[entries.indices] % width] = slots.sign[row] * entries.data
    g[time, slots.slot] = np.where(slots.sign > 0, rows.upper[slots.source], -rows.lower[slots.source])
    dynamics = _dynamics(program, fixed, width)
    return Stages(*dynamics, H, h, G, g, slots.cones, initial, coupling, program.constant)


def _dynamics(program: LinearProgram, fixed: Mask, width: int) -> tuple[Array, Array, Array]:
    """Return A, B and d in deviations from the origin, for y of this width."""
    linear, (T, n, m) = program.problem.linear, program.layout.shape
    A, B, d = np.zeros((T + 1, n, n)), np.zeros((T + 1, n, width - n)), np.zeros((T + 1, n))
    A[:-1], d[:-1] = linear.A, program.drift
    B[:-1, :, :m] = np.where(fixed[:, None], 0.0, linear.B)
    return A, B, d


def _ends(problem: OptimalControlProblem) -> tuple[Array, Mask]:
    """Return the bounds of both ends, (2, 2, n), lower ones first, and which are equal, (2, n)."""
    tube = problem.state_tube
    bounds = np.stack([tube.lower[[0, -1]], tube.upper[[0, -1]]])
    return bounds, bounds[0] == bounds[1]


def scale_stages(stages: Stages, columns: Array, priced: Mask, y: Array | None = None) -> tuple[Stages, Scaling]:
    """Return the stages with y in units ``columns`` (T+1, n+k), and the change of units.

    Its factors of rows are flat: x_0, stages, equations, inequalities, balls. The cost is scaled by its slopes in the
    priced entries at y; without y, at the point whose entries are one unit.
    """
    n = stages.states
    G = stages.G * columns[:, None]
    of_stages = _stage_factors(G, stages.g, stages.cones)
    before, units = stages.coupling, columns[:, stages.coupling.channels]
    equations = [part.scaled(units) for part in before.equations]
    inequalities = [part.scaled(units) for part in before.inequalities]
    balls = [part.scaled(units) for part in before.balls]
    end = columns[-1, before.terminal]
    coupling = replace(
        before,
        terminal_state=before.terminal_state / end,
        equations=tuple(part for part, _ in equations),
        inequalities=tuple(part for part, _ in inequalities),
        balls=tuple(part for part, _ in balls),
    )
    of_coupling = [1 / end, *(factors for _, factors in (*equations, *inequalities, *balls))]
    H, h = stages.H * columns[:, :, None] * columns[:, None, :], stages.h * columns
    typical = np.ones(h.shape)
    if y is not None:  # in the new units; a component that moves is floored at the smallest change that affects others
        size = np.abs(y)
        typical = np.where(size.max(axis=0) > UNIT_ROUNDING, np.maximum(size / columns, UNNOTICED), 0.0)
    slopes = np.einsum("tij,tj->ti", np.abs(H), typical) + np.abs(h)
    cost = cost_factor(slopes, priced)
    A, B, d = scale_dynamics(stages.A, stages.B, stages.d, columns)
    changed = replace(
        stages,
        A=A,
        B=B,
        d=d,
        H=H * cost,
        h=h * cost,
        G=G * of_stages[:, :, None],
        g=stages.g * of_stages,
        initial=stages.initial / columns[0, :n],
        coupling=coupling,
        constant=stages.constant * cost,
    )
    return changed, Scaling(columns, np.concatenate([1 / columns[0, :n], of_stages.ravel(), *of_coupling]), cost)


def scale_dynamics(A: Array, B: Array, d: Array, columns: Array) -> tuple[Array, Array, Array]:
    """Return A, B and d with y in units ``columns``."""
    n = A.shape[1]
    after = np.concatenate([columns[1:, :n], np.ones((1, n))])
    return A * columns[:, None, :n] / after[:, :, None], B * columns[:, None, n:] / after[:, :, None], d / after


def _stage_factors(G: Array, g: Array, cones: tuple[int, ...]) -> Array:
    """Return the factor of every row, (T+1, p), that makes the larger one of its norm and its (cone's) limit 1."""
    norms, limits = np.sqrt((G**2).sum(2)), np.where(np.isfinite(g), np.abs(g), 0.0)
    sizes, first = np.maximum(norms, limits), g.shape[1] - sum(cones)
    for size in cones:
        cone = slice(first, first + size)
        head = sizes[:, first, None]
        sizes[:, cone] = np.where(head > 0, head, norms[:, cone].max(axis=1, keepdims=True))
        first += size
    return inverse_sizes(sizes)


def fix_unused_entries(stages: Stages, used: Mask) -> Stages:
    """Return the stages with the Hessian 1 in place of 0 for unused entries of y; ``used`` is (T+1, n+k)."""
    H, (time, entry) = stages.H.copy(), np.nonzero(~used)
    H[time, entry, entry] = 1.0
    return replace(stages, H=H)
