"""The optimality conditions of the active rows of a convex program, and Newton's method for them.

M z = b are the equations and the active rows, g and H the slope and the Hessian of the cost at z. A step solves

    [H M'] [dz]       [g + M'y]
    [M 0 ] [dy]  =  - [M z - b]

The edge of a cone at which z lies is one row; its curvature, times its multiplier, adds to H.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.program.program import Program, regularised_kkt

PROXIMAL_WEIGHTS = (1e-13, 1e-10, 1e-7)  # on the diagonal, tried in turn: dependent rows and flat directions
SOLVE_REFINEMENTS = 12  # of a solve
ACTIVE_ROUNDS = 10  # of changes of the active rows, and of the curvature of cones; most problems need one
ZERO_GAP = 1e-11  # violations and multipliers, in a program scaled to order 1, that count as zero
LAST_REFINEMENT = 1e-9  # last refinement, relative to the solution, of a solve that counts


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
class ActiveSystem:
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


def solve_active(program: Program, z: Array, y: Array) -> tuple[Array, Array, ActiveSystem] | None:
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


def _newton_step(program: Program, z: Array, y: Array, active: _Active) -> tuple[Array, Array, ActiveSystem] | None:
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
    found: tuple[ActiveSystem, Array, Array] | None = None
    for proximal in PROXIMAL_WEIGHTS:
        try:
            factor = splu(regularised_kkt(H, M, proximal, proximal))
        except RuntimeError:  # exactly singular
            continue
        system = ActiveSystem(program, active, tuple(normals), M, H, factor)
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
