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
class ActiveRows:
    """The rows outside cones that hold with equality at their bounds, and the cones at whose edge or apex z lies."""

    above: Mask
    below: Mask
    edges: Mask
    at_apex: Mask  # of all rows, those of cones at whose apex z lies

    @property
    def rows(self) -> Indices:
        """Return the active rows that are equations; those of the program are at both bounds."""
        return np.flatnonzero(self.above | self.below | self.at_apex)

    def same_as(self, other: ActiveRows) -> bool:
        """Whether the same rows are active."""
        return all(map(np.array_equal, vars(self).values(), vars(other).values()))


def _active_at(program: Program, z: Array, y: Array, before: ActiveRows | None) -> ActiveRows:
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
    return ActiveRows(above, below, edges & (tails > 0) & ~apexes, at_apex)


@dataclass(frozen=True, eq=False)
class ActiveSystem:
    """The conditions of active rows, linearised at a point: M z = b, with the Hessian H and their factor."""

    program: Program
    active: ActiveRows
    M: sp.csc_array
    H: sp.csc_array
    factor: SuperLU  # with the rows of curved edges, and their products with the curvature, as further unknowns
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
            step = self.factor.solve(np.append(left, np.zeros(self.factor.shape[0] - len(left))))[: len(left)]
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
    program: Program, z: Array, y: Array, active: ActiveRows, least: float
) -> tuple[Array, Array, ActiveSystem] | None:
    """Return z and y after one step on the conditions of the active rows, and the system; None if it is singular.

    Smaller proximal weights than ``least`` are not tried.
    """
    rows, edges, in_cones = active.rows, active.edges, program.in_cones
    at_edge, held = edges[program.cone_of], np.zeros_like(y)
    weights = np.maximum(-y[in_cones[program.heads]], 0.0)
    held[rows], held[in_cones[at_edge]] = y[rows], (weights[program.cone_of] * _normals(program, z)[0])[at_edge]
    M, H, _, W = map(sp.csc_array, linearised_rows(program, z, y, active))
    curved = np.flatnonzero(np.diff(W.indptr))
    # v = A z of curved edges and W v stay unknowns: rows over all times would make H dense
    W, A, minus = W[curved][:, curved], sp.csr_array(program.A)[curved], -sp.eye_array(len(curved))
    slope = program.P @ z + program.q + program.A.T @ held
    system, dz, dy = None, z, y
    for proximal in (weight for weight in PROXIMAL_WEIGHTS if weight >= least):
        try:
            K = regularised_kkt(program.P, M, proximal, proximal)
            if len(curved):
                v = sp.hstack([A, sp.csr_array((len(curved), M.shape[0]))])
                K = sp.csc_array(sp.block_array([[K, None, v.T], [None, W, minus], [v, minus, None]]))
            factor = splu(K)
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


def linearised_rows(
    program: Program, z: Array, y: Array, active: ActiveRows
) -> tuple[sp.csr_array, sp.csc_array, sp.csr_array, sp.csr_array]:
    """Return M = N A and H = P + A'W A at a point, and N and W.

    N (active rows, rows) chooses the equations and the active rows, and takes |(s_1, ...)| - s_0 of a cone at its edge.
    W is the curvature of edges, times their multipliers: the duals of all rows are N'y, and change by W A dz besides.
    """
    A, edges, in_cones, rows = sp.csr_array(program.A), active.edges, program.in_cones, active.rows
    if not edges.any():
        N = sp.csr_array((np.ones(len(rows)), rows, np.arange(len(rows) + 1)), shape=(len(rows), A.shape[0]))
        return A[rows], program.P, N, sp.csr_array((A.shape[0], A.shape[0]))
    (normals, sizes), at_edge, place = _normals(program, z), edges[program.cone_of], np.cumsum(edges) - 1
    of_edges = sp.csr_array(
        (normals[at_edge], (place[program.cone_of[at_edge]], in_cones[at_edge])), shape=(int(edges.sum()), A.shape[0])
    )
    tails = at_edge.copy()
    tails[program.heads] = False
    curvature = np.maximum(-y[in_cones[program.heads]], 0.0) / np.where(sizes > 0, sizes, 1.0)
    of_tails, across = np.zeros(A.shape[0]), of_edges.copy()
    of_tails[in_cones[tails]] = curvature[program.cone_of[tails]]
    across.data[np.isin(across.indices, in_cones[program.heads])] = 0.0
    W = sp.csr_array(sp.diags_array(of_tails) - across.T @ sp.diags_array(curvature[edges]) @ across)
    N = sp.csr_array(sp.vstack([sp.eye_array(A.shape[0], format="csr")[rows], of_edges]))
    touched = np.flatnonzero(of_tails)
    H = program.P + A[touched].T @ W[touched][:, touched] @ A[touched]
    return sp.csr_array(N @ A), sp.csc_array(H), N, W


def _normals(program: Program, z: Array) -> tuple[Array, Array]:
    """Return (-1, s_1/|s|, s_2/|s|, ...) for each cone, one after the other, and |s| = |(s_1, s_2, ...)|."""
    s, _, sizes = program.of_cones(program.A @ z - program.lower)
    normals = s / np.where(sizes > 0, sizes, 1.0)[program.cone_of]
    normals[program.heads] = -1.0
    return normals, sizes
