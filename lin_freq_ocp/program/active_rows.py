"""The optimality conditions of the active rows of a convex program, and Newton's method for them.

M z = b are the equations and the active rows, g and H the slope and the Hessian of the cost at z. A step solves

    [H M'] [dz]       [g + M'y]
    [M 0 ] [dy]  =  - [M z - b]

The edge of a cone at which z lies is one row; its curvature, times its multiplier, adds to H. At the apex, all rows of
the cone are equations.
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
INSIDE = 1e-13  # distance of an active row from its bound, after a step, that its solve may leave
EPSILON = float(np.finfo(float).eps)
LAST_REFINEMENT = 1e-9  # last refinement, relative to the solution, of a solve that counts


@dataclass(frozen=True, eq=False)
class _Active:
    """The rows outside cones that hold with equality at their bounds, and the cones at whose edge or apex z lies."""

    above: Mask
    below: Mask
    edges: Mask
    at_apex: Mask  # of all rows, those of cones at whose apex z lies

    @property
    def rows(self) -> Indices:
        """Return the active rows that are equations; those of the program are at both bounds."""
        return np.flatnonzero(self.above | self.below | self.at_apex)

    def same_as(self, other: _Active) -> bool:
        """Whether the same rows are active."""
        return all(map(np.array_equal, vars(self).values(), vars(other).values()))


def _active_at(program: Program, z: Array, y: Array, before: _Active | None) -> _Active:
    """Return the rows whose multipliers exceed their slacks; after a step, violated ones, and those that press."""
    values, equal = program.A @ z, program.equality & program.alone
    over, under = values - program.upper, program.lower - values
    (_, heads, tails), price = program.of_cones(-under), -y[program.in_cones[program.heads]]
    excess, apexes = tails - heads, np.zeros(len(heads), dtype=bool)
    if before is None:
        above, below, edges = y > -over, -y > -under, price > -excess
    else:
        # rows that depend on others share their prices in any way, and cannot all be reached: one row goes at a time,
        # that with the worst price, or that which the step leaves farthest inside its bound
        held = np.flatnonzero((before.above | before.below) & ~equal)
        prices = np.append(np.where(before.above, y, -y)[held], price[before.edges])
        slacks = np.append(np.where(before.above, over, under)[held], excess[before.edges])
        least = min(-ZERO_GAP, float(prices.min(initial=0.0)))
        farthest = min(-INSIDE, float(slacks.min(initial=0.0))) if least == -ZERO_GAP else -np.inf
        above = np.where(before.above, (y > least) & (over > farthest), over > ZERO_GAP)
        below = np.where(before.below, (-y > least) & (under > farthest), under > ZERO_GAP)
        edges = np.where(before.edges, (price > least) & (excess > farthest), excess > ZERO_GAP)
        # a step along an edge has passed the apex where s_0 < 0; of other points, it is the nearest in the polar cone
        beyond = heads < -np.maximum(np.where(before.edges, 0.0, tails), ZERO_GAP)
        stays = price > program.of_cones(y)[2] - ZERO_GAP
        apexes = np.where(before.at_apex[program.in_cones[program.heads]], stays, beyond)
    above = equal | (program.alone & above & np.isfinite(program.upper))
    below, at_apex = program.alone & ~above & below & np.isfinite(program.lower), np.zeros_like(equal)
    at_apex[program.in_cones] = apexes[program.cone_of]
    return _Active(above, below, edges & (tails > 0) & ~apexes, at_apex)


@dataclass(frozen=True, eq=False)
class ActiveSystem:
    """The conditions of active rows, linearised at a point: M z = b, with the Hessian H and their factor."""

    program: Program
    active: _Active
    M: sp.csc_array
    H: sp.csc_array
    factor: SuperLU
    proximal: float

    def gaps(self, of_rows: Array) -> Array:
        """Return one number for each row of M from one of each row of the program."""
        of_cones = np.maximum.reduceat(of_rows[self.program.in_cones], self.program.heads)
        return np.append(of_rows[self.active.rows], of_cones[self.active.edges])

    def residual(self, z: Array) -> Array:
        """Return b - M z."""
        program, values = self.program, self.program.A @ z
        limits = np.where(self.active.above, program.upper, program.lower)
        _, heads, tails = program.of_cones(values - program.lower)
        return np.append((limits - values)[self.active.rows], (heads - tails)[self.active.edges])

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

    def nearest_change(self, of_rows: Array, errors: Array) -> Array:
        """Return the change of z that leaves the least of these changes of rows, each relative to its error."""
        count, weights = self.H.shape[0], np.maximum(errors / errors.max(), EPSILON) ** 2
        system = regularised_kkt(sp.csc_array(self.H.shape), self.M, PROXIMAL_WEIGHTS[-1], weights)
        return splu(system).solve(np.append(np.zeros(count), of_rows))[:count]


def solve_active(program: Program, z: Array, y: Array) -> tuple[Array, Array, ActiveSystem] | None:
    """Return the point that satisfies the conditions of its active rows, its multipliers, and the last system."""
    active, system = _active_at(program, z, y, None), None
    for _ in range(ACTIVE_ROUNDS):
        step = _newton_step(program, z, y, active, 0.0 if system is None else system.proximal)
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


def _newton_step(
    program: Program, z: Array, y: Array, active: _Active, least: float
) -> tuple[Array, Array, ActiveSystem] | None:
    """Return z and y after one step on the conditions of the active rows, and the system; None if it is singular.

    Smaller proximal weights than ``least`` are not tried.
    """
    rows, edges, in_cones = active.rows, active.edges, program.in_cones
    at_edge, held, A = edges[program.cone_of], np.zeros_like(y), sp.csr_array(program.A)
    weights, (normals, sizes) = np.maximum(-y[in_cones[program.heads]], 0.0), _normals(program, z)
    held[rows], held[in_cones[at_edge]] = y[rows], (weights[program.cone_of] * normals)[at_edge]
    M, H = A[rows], program.P
    if edges.any():
        tails = at_edge.copy()
        tails[program.heads] = False
        cone = (np.cumsum(edges) - 1)[program.cone_of[tails]]
        N = sp.csr_array((normals[tails], (cone, np.arange(len(cone)))), shape=(int(edges.sum()), len(cone)))
        along, across = N @ A[in_cones[tails]], A[in_cones[tails]]
        across = across - N.T @ along
        M = sp.vstack([M, along - A[in_cones[program.heads[edges]]]])
        H = program.P + across.T @ sp.diags_array((weights[edges] / sizes[edges])[cone]) @ across
    M, H = sp.csc_array(M), sp.csc_array(H)
    slope = program.P @ z + program.q + program.A.T @ held
    system, dz, dy = None, z, y
    for proximal in (weight for weight in PROXIMAL_WEIGHTS if weight >= least):
        try:
            factor = splu(regularised_kkt(H, M, proximal, proximal))
        except RuntimeError:  # exactly singular
            continue
        system = ActiveSystem(program, active, M, H, factor, proximal)
        dz, dy, converged = system.solve(-slope, system.residual(z))
        if converged:
            break
    if system is None:
        return None
    z, held[rows] = z + dz, held[rows] + dy[: len(rows)]
    weights[edges] += dy[len(rows) :]
    held[in_cones[at_edge]] = (weights[program.cone_of] * _normals(program, z)[0])[at_edge]
    return z, held, system


def _normals(program: Program, z: Array) -> tuple[Array, Array]:
    """Return (-1, s_1/|s|, s_2/|s|, ...) for each cone, one after the other, and |s| = |(s_1, s_2, ...)|."""
    s, _, sizes = program.of_cones(program.A @ z - program.lower)
    normals = s / np.where(sizes > 0, sizes, 1.0)[program.cone_of]
    normals[program.heads] = -1.0
    return normals, sizes
