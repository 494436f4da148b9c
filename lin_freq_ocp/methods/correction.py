"""Correction of a point: one Newton step on the optimality conditions of its active rows, in deviations from it.

M z = b are the equations and the active rows, g and H the slope and the Hessian of the cost at the point:

    [H M'] [dz]       [g + M'y]
    [M 0 ] [dy]  =  - [M z - b]

Differences such as M z - b are formed once, in extended precision. All that follows has the size of the correction,
wherever the origin is. The units are those of deviations: of a control its own size, of a state what controls move in
a few steps. They condition the matrix, and nothing else depends on them.

Rounding of z + dz leaves r = M (z + dz) - b. A further solve with [0; -r] leads to a trajectory that satisfies every
row, and prices r: the optimal cost is at most that of the corrected point plus the price.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.reformulations import at_frequencies
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.backends.base import DEFAULT_TOLERANCE, Claim, backend
from lin_freq_ocp.program.linear_program import LinearProgram, dense_rows
from lin_freq_ocp.program.program import Program, Scaling, regularised_kkt, scale_matrix

PROXIMAL_WEIGHTS = (1e-13, 1e-10, 1e-7)  # on the diagonal, tried in turn: dependent rows and flat directions
SOLVE_REFINEMENTS = 12  # of a solve
ACTIVE_ROUNDS = 10  # of changes of the active rows, and of the curvature of cones; most problems need one
ZERO_GAP = 1e-11  # violations and multipliers, in units of the correction, that count as zero
LAST_REFINEMENT = 1e-9  # last refinement, relative to the solution, of a solve that counts
CONTRACTION = 1e-3  # part of the residual that the solve which prices it may leave
LONGEST_FACTOR = 2.0  # seconds of a factorisation, estimated
MOVED_STEPS = 4  # steps per state in which controls move the states by their units
EPSILON = float(np.finfo(float).eps)
ROW_ULPS = 64.0  # rounding errors of its own terms that a row may miss where equations depend on each other
DATA_ROUNDING = 4 * EPSILON  # of the terms of a row
SIGN_VECTORS = 3  # random signs of the rounding of rows


@dataclass(frozen=True, eq=False)
class Correction:
    """A corrected point with its multipliers; its bounds on states and controls hold exactly.

    Attributes
    ----------
    price : float
        The change of cost to a trajectory nearby that satisfies every constraint; inf if none is known.
    """

    trajectory: Trajectory
    multipliers: Multipliers
    price: float
    _system: _System
    _terms: Array  # sums of the absolute terms of each row
    _cost: float  # factor of the cost in the units of the system
    _hessian_rounding: float

    @cached_property
    def data_rounding(self) -> float:
        """The change of the optimal cost if active rows and the Hessian change by DATA_ROUNDING of their terms."""
        rng, size = np.random.default_rng(0), self._system.gaps(DATA_ROUNDING * self._terms)
        changes = (self._system.change(size * rng.choice([-1.0, 1.0], len(size))) for _ in range(SIGN_VECTORS))
        return max(self._system.price(change) for change, _ in changes) / self._cost + self._hessian_rounding


def correct(problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers) -> Correction | None:
    """Return the corrected point of a linear problem; None if the active rows determine none.

    If the active rows of the point lead to no trajectory that satisfies every row, those of the optimal deviations do,
    which one more solve finds. UnsupportedError if the program does not fit into memory, or would take too long.
    """
    needed = dense_rows(problem).factorisation_seconds
    if needed > LONGEST_FACTOR:
        raise UnsupportedError(f"a correction needs about {needed:.2g} s for one factorisation.")
    problem = at_frequencies(problem, multipliers.frequencies)
    trajectory = _within_bounds(problem, trajectory.x, trajectory.u)
    linear = LinearProgram(problem, trajectory.extended)
    scaling = _deviation_scaling(linear, trajectory)
    deviations = _Deviations(linear, trajectory, scaling, linear.sparse.scaled(scaling), multipliers.frequencies)
    z, y = scaling.scaled_primal(linear.point(trajectory)), scaling.scaled_dual(linear.duals(multipliers))
    corrected = deviations.corrected(z, y)
    if corrected is not None and np.isfinite(corrected.price):
        return corrected
    solution = backend("clarabel")(deviations.program, DEFAULT_TOLERANCE, None)
    if solution.claim is not Claim.SOLVED or solution.z is None or solution.y is None:
        return corrected
    return deviations.corrected(solution.z, solution.y) or corrected


@dataclass(frozen=True, eq=False)
class _Deviations:
    """The program of the deviations from a trajectory, in their units."""

    linear: LinearProgram
    trajectory: Trajectory
    scaling: Scaling
    program: Program
    frequencies: Mapping[str, Array]

    def corrected(self, z: Array, y: Array) -> Correction | None:
        """Return the correction from a point with its duals, which tell the active rows."""
        linear, scaling, problem = self.linear, self.scaling, self.linear.problem
        newton = _newton(self.program, z, y)
        if newton is None:
            return None
        z, y, system = newton
        change = linear.direction(scaling.primal(z))
        corrected = _within_bounds(problem, self.trajectory.x + change.x, self.trajectory.u + change.u)
        after = LinearProgram(problem, corrected.extended)
        after.share_matrices(linear)
        point = after.point(corrected)
        system = replace(system, program=after.sparse.scaled(scaling))
        sizes = np.abs(np.concatenate([corrected.x.ravel(), corrected.u.ravel(), point[linear.signals :]]))
        terms = scaling.rows * (abs(linear.sparse.A) @ sizes)
        return Correction(
            corrected,
            replace(linear.multipliers(scaling.dual(y), 1.0), frequencies=self.frequencies),
            system.repair_price(scaling.scaled_primal(point), terms) / scaling.cost,
            system,
            terms,
            scaling.cost,
            DATA_ROUNDING * problem.quadratic.products(corrected.x, corrected.u),
        )


@dataclass(frozen=True, eq=False)
class _Active:
    """The rows outside cones that hold with equality at their bounds, and the cones at whose edge a point lies."""

    above: Mask
    below: Mask
    edges: Mask

    @property
    def rows(self) -> Indices:
        """Return the active rows outside cones; equations are at both bounds."""
        return np.flatnonzero(self.above | self.below)

    def same_as(self, other: _Active) -> bool:
        """Whether the same rows are active."""
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in ("above", "below", "edges"))


def _active_at(program: Program, z: Array, y: Array, before: _Active | None) -> _Active:
    """Return the rows whose multipliers exceed their slacks; after a step, violated ones, and those that press."""
    values, equal = program.A @ z, program.equality & program.alone
    over, under = values - program.upper, program.lower - values
    cones = [(program.A[cone] @ z - program.lower[cone], -y[cone.start]) for cone in program.cones]
    excess = np.array([float(np.linalg.norm(s[1:]) - s[0]) for s, _ in cones])
    price = np.array([w for _, w in cones])
    if before is None:
        above, below, edges = y > -over, -y > -under, price > -excess
    else:
        above = np.where(before.above, y > -ZERO_GAP, over > ZERO_GAP)
        below = np.where(before.below, y < ZERO_GAP, under > ZERO_GAP)
        edges = np.where(before.edges, price > -ZERO_GAP, excess > ZERO_GAP)
    above = equal | (program.alone & above & np.isfinite(program.upper))
    return _Active(above, program.alone & ~above & below & np.isfinite(program.lower), edges)


@dataclass(frozen=True, eq=False)
class _System:
    """The conditions of active rows, linearised at a point: M z = b, with the Hessian H and their factor."""

    program: Program
    active: _Active
    normals: tuple[tuple[slice, Array], ...]  # of the cones at whose edge the point lies
    M: sp.csc_array
    H: sp.csc_array
    factor: SuperLU

    def gaps(self, of_rows: Array) -> Array:
        """Return one number for each row of M from one of each row of the program."""
        return np.append(of_rows[self.active.rows], [of_rows[cone].max() for cone, _ in self.normals])

    def residual(self, z: Array) -> Array:
        """Return b - M z."""
        program, rows = self.program, self.active.rows
        limits = np.where(self.active.above, program.upper, program.lower)[rows]
        slacks = [program.A[cone] @ z - program.lower[cone] for cone, _ in self.normals]
        of_cones = [s[0] - np.linalg.norm(s[1:]) for s in slacks]
        return np.append(limits - program.A[rows] @ z, of_cones)

    def solve(self, of_z: Array, of_rows: Array) -> tuple[Array, Array, bool]:
        """Return the solution (dz, dy) for a right-hand side, refined, and whether it converges."""
        count, last = len(of_z), np.inf
        solution, size = np.zeros(count + len(of_rows)), np.inf
        for _ in range(SOLVE_REFINEMENTS):
            z, y = np.split(solution, [count])
            left = np.concatenate([of_z - self.H @ z - self.M.T @ y, of_rows - self.M @ z])
            step = self.factor.solve(left)
            if not np.isfinite(step).all():
                break
            solution, size = solution + step, float(np.abs(step[:count]).max())
            longest = float(np.abs(step).max())
            if not longest < 0.5 * last:
                break
            last = longest
        z, y = np.split(solution, [count])
        return z, y, size <= LAST_REFINEMENT * (1.0 + float(np.abs(z).max()))

    def change(self, of_rows: Array) -> tuple[Array, float]:
        """Return the least costly change of z that changes the rows so, and the part of that which it leaves."""
        size, change = float(np.linalg.norm(of_rows)), self.solve(np.zeros(self.H.shape[0]), of_rows)[0]
        return change, float(np.linalg.norm(of_rows - self.M @ change)) / size if size > 0 else 0.0

    def price(self, change: Array) -> float:
        """Return by how much a change of z can change the cost."""
        return abs(float(self.program.q @ change)) + 0.5 * float(change @ (self.program.P @ change))

    def repair_price(self, z: Array, terms: Array) -> float:
        """Return the price of a change that satisfies all rows of the program; inf if the system gives none.

        Equations that depend on each other contradict each other by rounding, which is no more than ROW_ULPS rounding
        errors of the terms of each row.
        """
        residual = self.residual(z)
        change, left = self.change(residual)
        rounded = bool((np.abs(residual) <= ROW_ULPS * EPSILON * self.gaps(terms)).all())
        program, values = self.program, self.program.A @ (z + change)
        outside = np.maximum(values - program.upper, program.lower - values)[program.alone & ~self._active_mask]
        of_cones = [np.linalg.norm(s[1:]) - s[0] for s in (values[c] - program.lower[c] for c in program.cones)]
        holds = max(outside.max(initial=0.0), *of_cones, 0.0) <= ZERO_GAP
        return self.price(change) if (left <= CONTRACTION or rounded) and holds else np.inf

    @property
    def _active_mask(self) -> Mask:
        return self.active.above | self.active.below


def _newton(program: Program, z: Array, y: Array) -> tuple[Array, Array, _System] | None:
    """Return the point that satisfies the conditions of its active rows, its multipliers, and the last system."""
    active, system = _active_at(program, z, y, None), None
    for _ in range(ACTIVE_ROUNDS):
        step = _newton_step(program, z, y, active)
        if step is None:
            return None
        moved = float(np.abs(step[0] - z).max())
        z, y, system = step
        after = _active_at(program, z, y, active)
        if after.same_as(active) and (not active.edges.any() or moved <= ZERO_GAP):
            break
        active = after
    assert system is not None
    signs = np.where(system.active.above & ~program.equality, np.maximum(y, 0.0), y)
    return z, np.where(system.active.below, np.minimum(signs, 0.0), signs), system


def _newton_step(program: Program, z: Array, y: Array, active: _Active) -> tuple[Array, Array, _System] | None:
    """Return z and y after one step on the conditions of the active rows, and the system; None if none converges."""
    rows = active.rows
    held, weights = np.zeros_like(y), np.array([max(-y[cone.start], 0.0) for cone in program.cones])
    held[rows] = y[rows]
    parts, normals, curved = [sp.csr_array(program.A[rows])], list[tuple[slice, Array]](), list[sp.csr_array]()
    for cone, weight, at_edge in zip(program.cones, weights, active.edges, strict=True):
        s = program.A[cone] @ z - program.lower[cone]
        size = float(np.linalg.norm(s[1:]))
        if not at_edge or size == 0:
            continue
        tail = s[1:] / size
        normal = np.append(-1.0, tail)
        normals.append((cone, normal))
        held[cone] = weight * normal
        parts.append(sp.csr_array(normal[None] @ program.A[cone]))
        bend = np.sqrt(weight / size) * (np.eye(len(tail)) - np.outer(tail, tail))
        curved.append(sp.csr_array(bend @ program.A[cone][1:]))
    M = sp.csc_array(sp.vstack(parts))
    C = sp.csc_array(sp.vstack(curved)) if curved else None
    H = program.P if C is None else sp.csc_array(program.P + C.T @ C)
    slope = program.P @ z + program.q + program.A.T @ held
    found: tuple[_System, Array, Array] | None = None
    for proximal in PROXIMAL_WEIGHTS:
        try:
            factor = splu(regularised_kkt(H, M, proximal, proximal))
        except RuntimeError:  # exactly singular
            continue
        system = _System(program, active, tuple(normals), M, H, factor)
        *step, converged = system.solve(-slope, system.residual(z))
        found = system, step[0], step[1]
        if converged:
            break
    if found is None:
        return None
    system, dz, dy = found
    z, held[rows] = z + dz, held[rows] + dy[: len(rows)]
    for (cone, normal), change in zip(normals, dy[len(rows) :], strict=True):
        s = program.A[cone] @ z - program.lower[cone]
        size = float(np.linalg.norm(s[1:]))
        weight = -held[cone.start] + change
        held[cone] = weight * (np.append(-1.0, s[1:] / size) if size > 0 else normal)
    return z, held, system


def _within_bounds(problem: OptimalControlProblem, x: Array, u: Array) -> Trajectory:
    """Return the nearest states and controls within their bounds."""
    return Trajectory(problem.state_tube.project(x), problem.control_tube.project(u))


def _deviation_scaling(linear: LinearProgram, trajectory: Trajectory) -> Scaling:
    """Return the units in which deviations, rows, and the slope of the cost are of order 1."""
    program = linear.sparse
    columns = linear.column_units(*_deviation_units(linear.problem, trajectory))
    squares = scale_matrix(program.A, np.ones(program.A.shape[0]), columns).power(2).sum(1)
    rows = 1.0 / np.sqrt(np.where(squares > 0, squares, 1.0))
    for cone in program.cones:
        rows[cone] = rows[cone].min()
    steepest = float(np.maximum(columns * np.abs(program.q), columns**2 * program.P.diagonal()).max(initial=0.0))
    return Scaling(columns, rows, 1.0 / steepest if steepest > 0 else 1.0)


def _deviation_units(problem: OptimalControlProblem, trajectory: Trajectory) -> tuple[Array, Array]:
    """Return the units of states, (n,), what controls of their units move in some steps, and of controls, (m,)."""
    x, u, tube = trajectory.x, np.abs(trajectory.u).max(0), problem.control_tube
    width = tube.upper - tube.lower
    of_u = np.where(u > 0, u, np.where(np.isfinite(width), width, 0.0).max(0))
    of_u = np.where(of_u > 0, of_u, 1.0)
    reach = np.ptp(x, axis=0)
    if problem.dynamics.response(problem.horizon) is None:
        steps = min(problem.horizon, MOVED_STEPS * problem.state_dim)
        responses, reach = np.zeros((problem.state_dim, problem.control_dim)), np.zeros(problem.state_dim)
        for t in range(steps):
            A, B, _ = problem.linear.at(t)
            responses = np.hstack([A @ responses, B * of_u])
            reach = np.maximum(reach, np.abs(responses).max(1))
    reach = np.where((reach > 0) & np.isfinite(reach), reach, np.ptp(x, axis=0))
    size = np.abs(x).max(0)
    return np.where(reach > 0, reach, np.where(size > 0, size, 1.0)), of_u
