"""A local optimum of one mode sequence of piecewise-smooth dynamics, by sequential quadratic programming.

Each program has the dynamics and regions of the modes and the path constraints linearised at the last trajectory, and
the frequency constraints, sets and costs as they are. The curvature of -<eta_t, f_t> + <mu_t, h_t> is added to that of
the cost as far as a stage stays convex, so that the last steps are Newton's. Steps are limited to a trust region, and
violations of dynamics, regions and path constraints have a price, so that every program has a solution. A step is taken
if it improves the merit

    cost + price * (sum |x_{t+1} - f_t(x_t, u_t)| + sum of violations of regions and h),     all in natural units.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.methods.candidate import Reason
from lin_freq_ocp.problem.hybrid.affine_mode import REGION
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.problem_data import replace_fields
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.backends.base import Claim, backend
from lin_freq_ocp.program.linear_program import LinearProgram, signal_columns
from lin_freq_ocp.program.program import Program, Scaling
from lin_freq_ocp.program.units import natural_scaling
from lin_freq_ocp.transform.hybrid.forms import piecewise_smooth
from lin_freq_ocp.transform.sizes import stated_sizes

PRICES = (1e2, 1e4, 1e6)  # of violations, one after the other while some are left; slopes of the cost are of order 10
FIRST_RADIUS, LARGEST_RADIUS, SMALLEST_RADIUS = 1.0, 1e3, 1e-9  # of the trust region, in natural units
ACCEPTED, GOOD = 1e-4, 0.7  # shares of the predicted improvement for a step to be taken, and for the region to grow
SMALLEST_STEP = 1e-9  # in natural units: the accuracy of the programs' solver
VIOLATION = 1e-8  # violations of order-1 rows up to which a point is feasible
SLACK_PRICE = 1e-3  # of slacks of costs and soft constraints, in the projection on the sets
MERIT_ROUNDING = 16 * float(np.finfo(np.float64).eps)  # part of the merit
MOST_STEPS = 60
QP_TOLERANCE = 1e-10


@dataclass(frozen=True, eq=False)
class LocalOptimum:
    """The end of a sequence of programs; ``violation`` is that of dynamics and regions in natural units.

    The multipliers are those of the linearised problem of the mode sequence, with those of regions under REGION. If it
    has not ``converged``, a limit of steps ended the iteration before its residuals were small.
    """

    sequence: Indices
    trajectory: Trajectory
    multipliers: Multipliers
    cost: float
    violation: float
    converged: bool = True

    @property
    def feasible(self) -> bool:
        """Whether it is a trajectory of its mode sequence."""
        return self.violation <= VIOLATION

    @property
    def reason(self) -> Reason:
        """Return why another start may be tried after it."""
        solved = Reason.LOCALLY_OPTIMAL if self.converged else Reason.FEASIBLE
        return solved if self.feasible else Reason.FAILED


def local_optimum(
    problem: OptimalControlProblem, start: Trajectory, sequence: Indices, below: float = np.inf, end: float = np.inf
) -> LocalOptimum | None:
    """Return the local optimum of a mode sequence from a trajectory, which need not be feasible, or the last point.

    A higher price raises the cost: it is tried only while that is less than ``below``. None if no program could be
    solved, as where a piece is not defined; ``end`` is by ``clock.now``.
    """
    best: LocalOptimum | None = None
    for price in PRICES:
        optimum = _solve_at_price(problem, start if best is None else best.trajectory, sequence, price, end)
        if optimum is None:
            return best
        best = optimum
        if best.feasible or best.cost >= below or now() > end:
            break
    return best


def neighbouring_sequences(problem: OptimalControlProblem, local: LocalOptimum) -> Iterator[Indices]:
    """Yield the sequences with one mode changed, first where the multipliers of regions are largest."""
    T, modes = problem.horizon, len(piecewise_smooth(problem).modes)
    largest = local.multipliers.stage.get(REGION, np.zeros((T, 1))).max(axis=1, initial=0.0)
    for t in np.argsort(-largest, kind="stable"):
        for i in range(modes):
            if i != local.sequence[t]:
                changed = local.sequence.copy()
                changed[t] = i
                yield changed


def _solve_at_price(
    problem: OptimalControlProblem, start: Trajectory, sequence: Indices, price: float, end: float
) -> LocalOptimum | None:
    fixed = _SequenceProgram.build(problem, start, sequence)
    z = None if fixed is None else fixed.within_sets(start)
    point = None if fixed is None or z is None else fixed.at(z, None)
    radius, steps = FIRST_RADIUS, 0
    multipliers: Multipliers | None = None
    while point is not None and steps < MOST_STEPS and radius > SMALLEST_RADIUS:
        if now() > end:
            break
        steps += 1
        step = _trust_region_step(point, price, radius)
        if step is None:
            break
        z, y, predicted = step
        length = float(np.abs(z - point.z).max())
        multipliers_after = point.fixed.multipliers(y)
        after = point.fixed.at(z, multipliers_after)
        gained = -np.inf if after is None else point.merit(price) - after.merit(price)
        if length <= SMALLEST_STEP or predicted <= MERIT_ROUNDING * abs(point.merit(price)):
            point, multipliers = after if after is not None and gained >= 0 else point, multipliers_after
            break
        if after is not None and gained >= ACCEPTED * predicted:
            point, multipliers = after, multipliers_after
            radius = min(2 * radius, LARGEST_RADIUS) if gained >= GOOD * predicted else radius
        else:
            radius = 0.25 * min(radius, length)
            point = replace(point, multipliers=multipliers_after)
            multipliers = multipliers or multipliers_after  # of a start that no step improves
    if point is None or multipliers is None:
        return None
    cost = problem.value(point.trajectory.x, point.trajectory.u)
    return LocalOptimum(sequence, point.trajectory, multipliers, cost, point.violation)


@dataclass(frozen=True, eq=False)
class _SequenceProgram:
    """The program of a mode sequence in natural units, without the derivatives of maps and regions.

    ``signals`` (T, n + m) are the variables of (x_t, u_t), ``maps`` (T, n) and ``regions`` (T, rows) rows of the
    program; -1 where there is no row. ``paths`` are those of the values of each path constraint, (groups, components).
    """

    problem: OptimalControlProblem
    sequence: Indices
    linear: LinearProgram
    scaling: Scaling
    program: Program
    signals: Indices
    maps: Indices
    regions: Indices
    paths: tuple[Indices, ...]

    @classmethod
    def build(cls, problem: OptimalControlProblem, start: Trajectory, sequence: Indices) -> _SequenceProgram | None:
        """Return the program in the natural units at the start; None if a piece is not defined there."""
        T, n, m = problem.horizon, problem.state_dim, problem.control_dim
        dynamics = piecewise_smooth(problem)
        y = np.hstack([start.x[:T], start.u])
        rows = problem.path_constraints
        at_start = [one.map.jets_along(start.x, start.u) for one in rows]
        finite = all(np.isfinite(at.values).all() and np.isfinite(at.slopes).all() for at in at_start)
        if not dynamics.jets_at(y).defined()[np.arange(T), sequence].all() or not finite:
            return None
        affine = problem.affine_at(start)
        if rows:
            sizes = stated_sizes(problem)
            patterns = tuple(one.pattern(start.x, start.u, sizes) for one in problem.stage_rows)
            affine = replace_fields(affine, stage_rows=patterns)
        linear = LinearProgram(affine.with_modes(sequence))
        scaling = natural_scaling(linear)
        program = linear.sparse.scaled(scaling)
        numbers = linear.multipliers(np.arange(1.0, 1.0 + len(program.lower)), 1.0)
        maps, regions = (part.astype(np.intp) - 1 for part in (numbers.eta, numbers.stage[REGION]))
        paths = tuple(numbers.stage[one.name].astype(np.intp) - 1 for one in rows)
        signals = signal_columns(T, n, m)
        entries = sp.coo_array(program.A)
        row, column = entries.coords
        of_maps, of_regions = np.isin(row, maps), np.isin(row, regions[regions >= 0])
        of_regions |= np.isin(row, np.concatenate([maps[:0, 0], *map(np.ravel, paths)])) & (column < linear.signals)
        after = np.full(len(program.lower), -1)
        after[maps] = np.arange(n, (T + 1) * n).reshape(T, n)
        constant = np.where(of_maps, after[row] == column, ~of_regions)
        A = sp.csc_array((entries.data[constant], (row[constant], column[constant])), shape=program.A.shape)
        program = replace(program, A=A)
        return cls(problem, sequence, linear, scaling, program, signals, maps, regions, paths)

    @cached_property
    def path_rows(self) -> Indices:
        """The rows of all path constraints that have limits, one after the other, (rows,)."""
        rows = np.concatenate([self.maps[:0, 0], *map(np.ravel, self.paths)])
        return rows[rows >= 0]

    @cached_property
    def inequalities(self) -> Indices:
        """The rows of regions and of hard path constraints, which may be violated at a price, (rows,)."""
        pairs = zip(self.problem.path_constraints, self.paths, strict=True)
        hard = [rows.ravel() for one, rows in pairs if one.hard_part is not None]
        rows = np.concatenate([self.regions.ravel(), *hard])
        return rows[rows >= 0]

    def path_jets(self, trajectory: Trajectory) -> tuple[Array, Array, Indices]:
        """Return of path constraints values less limits (rows,), slopes (rows, n+m) and variables (rows, n+m)."""
        n = self.problem.state_dim
        last = np.append(self.signals[-1, :n] + n, self.signals[-1, n:])  # of x_T, with those of u_{T-1}, unused
        values, slopes, columns = [np.zeros(0)], [np.zeros((0, len(last)))], [self.signals[:0]]
        for one, rows in zip(self.problem.path_constraints, self.paths, strict=True):
            at, limited = one.map.jets_along(trajectory.x, trajectory.u), rows >= 0
            values.append((at.values - one.limits())[limited])
            slopes.append(at.slopes[limited])
            columns.append(np.vstack([self.signals, last])[np.nonzero(limited)[0]])
        return np.concatenate(values), np.concatenate(slopes), np.concatenate(columns)

    def trajectory(self, z: Array) -> Trajectory:
        """Return the trajectory of a point of the program."""
        return self.linear.trajectory(self.scaling.primal(z))

    def multipliers(self, y: Array) -> Multipliers:
        """Return the multipliers of duals that begin with those of the program."""
        return self.linear.multipliers(self.scaling.dual(y[: len(self.program.lower)]), 1.0)

    def within_sets(self, trajectory: Trajectory) -> Array | None:
        """Return the nearest point that satisfies all but maps and regions; None if it was not found."""
        z, program = self.scaling.scaled_primal(self.linear.point(trajectory)), self.program
        other_rows = np.ones(len(program.lower), dtype=bool)
        other_rows[self.maps] = other_rows[self.regions[self.regions >= 0]] = other_rows[self.path_rows] = False
        lower, upper = np.where(other_rows, program.lower, -np.inf), np.where(other_rows, program.upper, np.inf)
        sets = replace(program, lower=lower, upper=upper)
        if sets.residuals(z, np.zeros(len(lower))).primal <= VIOLATION:
            return z
        near = np.zeros(len(z))
        near[: self.linear.signals] = 1.0
        P, q = sp.csc_array(sp.diags_array(near)), SLACK_PRICE * (1 - near) - near * z
        solution = backend("clarabel")(replace(sets, P=P, q=q), QP_TOLERANCE, None)
        return solution.z if solution.claim is Claim.SOLVED else None

    def at(self, z: Array, multipliers: Multipliers | None) -> _Linearised | None:
        """Return the linearised program at a point; None if a piece is not defined there."""
        problem, T = self.problem, self.problem.horizon
        trajectory, times = self.trajectory(z), np.arange(T)
        mode_jets = piecewise_smooth(problem).jets_at(np.hstack([trajectory.x[:T], trajectory.u]))
        if not mode_jets.defined()[times, self.sequence].all():
            return None
        values, slopes, curvatures = mode_jets.maps_of(self.sequence, times)
        most = self.regions.shape[1]
        switching, facets = np.full((T, most), -np.inf), np.zeros((T, most, self.signals.shape[1]))
        for i, region in enumerate(mode_jets.regions):
            in_mode, rows = self.sequence == i, region.values.shape[1]
            switching[in_mode, :rows], facets[in_mode, :rows] = region.values[in_mode], region.slopes[in_mode]
        path_values, normals, path_columns = self.path_jets(trajectory)
        if not (np.isfinite(path_values).all() and np.isfinite(normals).all()):
            return None
        scale, base, chosen = self.scaling.rows, self.program, self.regions >= 0
        maps, regions = self.maps.ravel(), np.append(self.regions[chosen], self.path_rows)
        rows = np.concatenate([maps, regions])
        stage = np.concatenate([np.repeat(times, self.maps.shape[1]), np.nonzero(chosen)[0]])
        column = np.vstack([self.signals[stage], path_columns])
        entries = np.vstack([-slopes.reshape(-1, column.shape[1]), facets[chosen], normals])
        entries = entries * scale[rows, None] * self.scaling.columns[column]
        row = np.broadcast_to(rows[:, None], column.shape).ravel()
        changed = sp.csc_array((entries.ravel(), (row, column.ravel())), shape=base.A.shape)
        A = sp.csc_array(base.A + changed)
        Az, lower, upper = A @ z, base.lower.copy(), base.upper.copy()
        Az[self.path_rows] = np.asarray(changed @ z)[self.path_rows]  # without slacks
        defects = scale[maps] * (trajectory.x[1:] - values).ravel()
        outside = scale[regions] * np.append(switching[chosen], path_values)
        lower[maps] = upper[maps] = Az[maps] - defects
        upper[regions] = Az[regions] - outside
        program = replace(base, A=A, lower=lower, upper=upper)
        outside = np.maximum(outside[np.isin(regions, self.inequalities)], 0.0)
        return _Linearised(self, trajectory, program, z, defects, outside, curvatures, multipliers)


@dataclass(frozen=True, eq=False)
class _Linearised:
    """A trajectory with the program of the mode sequence linearised there, in natural units.

    ``defects`` are x_{t+1} - f_t(x_t, u_t), ``outside`` the positive parts of the switching functions and of hard path
    constraints, ``curvatures`` (T, n, n + m, n + m) those of the maps in the problem's units.
    """

    fixed: _SequenceProgram
    trajectory: Trajectory
    program: Program
    z: Array
    defects: Array
    outside: Array
    curvatures: Array
    multipliers: Multipliers | None

    @property
    def violation(self) -> float:
        """Return the largest violation of a row of maps or regions."""
        return max(float(np.abs(self.defects).max()), float(self.outside.max(initial=0.0)))

    def merit(self, price: float) -> float:
        """Return the cost with the price of violations, in the units of the program."""
        cost = self.fixed.scaling.cost * self.fixed.problem.value(self.trajectory.x, self.trajectory.u)
        return cost + price * float(np.abs(self.defects).sum() + self.outside.sum())

    def added_curvature(self) -> sp.csc_array:
        """Return the curvature of -<eta_t, f_t> + <mu_t, h_t> for t < T, as far as every stage stays convex."""
        shape, fixed, x, u = (len(self.z), len(self.z)), self.fixed, self.trajectory.x, self.trajectory.u
        if self.multipliers is None:
            return sp.csc_array(shape)
        hessians = np.broadcast_to(fixed.problem.quadratic.stage_hessians(), self.curvatures[:, 0].shape)
        bent = hessians - np.einsum("ti,tijk->tjk", self.multipliers.eta, self.curvatures)
        for one in fixed.problem.path_constraints:
            prices, bends = self.multipliers.stage[one.name], one.map.jets_along(x, u).curvatures
            bent += np.einsum("ti,tijk->tjk", prices, bends)[: len(bent)]
        values, vectors = np.linalg.eigh(bent)
        added = np.einsum("tij,tj,tkj->tik", vectors, np.maximum(values, 0.0), vectors) - hessians
        units = fixed.scaling.columns[fixed.signals]
        scaled = fixed.scaling.cost * added * units[:, :, None] * units[:, None, :]
        row = np.broadcast_to(fixed.signals[:, :, None], scaled.shape).ravel()
        column = np.broadcast_to(fixed.signals[:, None, :], scaled.shape).ravel()
        return sp.csc_array(sp.coo_array((scaled.ravel(), (row, column)), shape=shape))


def _trust_region_step(point: _Linearised, price: float, radius: float) -> tuple[Array, Array, float] | None:
    """Solve the program in the trust region; return the point, its duals, and the predicted improvement."""
    program, fixed, count = point.program, point.fixed, len(point.z)
    maps, regions = fixed.maps.ravel(), fixed.inequalities
    relaxed = np.concatenate([maps, maps, regions])
    signs = np.concatenate([np.ones(len(maps)), -np.ones(len(maps) + len(regions))])
    slacks, curvature, signals = len(relaxed), point.added_curvature(), fixed.linear.signals
    bounded = np.concatenate([np.arange(signals), np.arange(count, count + slacks)])
    rows = np.arange(len(bounded)) + len(program.lower)
    entries = sp.coo_array(program.A)
    A = sp.csc_array(
        (
            np.concatenate([entries.data, signs, np.ones(len(bounded))]),
            (
                np.concatenate([entries.coords[0], relaxed, rows]),
                np.concatenate([entries.coords[1], np.arange(count, count + slacks), bounded]),
            ),
        ),
        shape=(len(program.lower) + len(bounded), count + slacks),
    )
    P = sp.coo_array(program.P + curvature)
    penalised = Program(
        P=sp.csc_array((P.data, (P.coords[0], P.coords[1])), shape=(count + slacks, count + slacks)),
        q=np.append(np.asarray(program.q - curvature @ point.z), np.full(slacks, price)),
        constant=0.0,
        A=A,
        lower=np.concatenate([program.lower, point.z[:signals] - radius, np.zeros(slacks)]),
        upper=np.concatenate([program.upper, point.z[:signals] + radius, np.full(slacks, np.inf)]),
        rows=program.rows,
        cones=program.cones,
    )
    solution = backend("clarabel")(penalised, QP_TOLERANCE, None)
    if solution.z is None or solution.y is None or solution.claim not in (Claim.SOLVED, Claim.FAILED):
        return None
    slacks_before = np.concatenate([np.maximum(-point.defects, 0.0), np.maximum(point.defects, 0.0), point.outside])
    before = penalised.objective(np.append(point.z, slacks_before))
    return solution.z[:count], solution.y, before - penalised.objective(solution.z)
