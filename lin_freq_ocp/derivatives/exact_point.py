"""The exact optimum on its active rows, and the rows that are active with multiplier zero.

The gap of an answer is of second order in its controls. So the equations of the active rows are solved first, and rows
whose signs are wrong exchanged. These equations have one solution, and the computed one is off by the last correction
of a refinement in extended precision. If every multiplier and every slack has the right sign by more than that, the
exact solution is the optimum, and strictly complementary: its rows are the active ones. The others are weak.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.derivatives.kkt import ActiveKKT
from lin_freq_ocp.methods.correction import DeviationProgram, deviations_from
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.active_rows import EPSILON, solve_active
from lin_freq_ocp.program.program import Block, Program
from lin_freq_ocp.program.program_rows import ProgramRows

POINT_STEPS = 6  # of the exact point; without cones, the second is rounding
SAFETY = 100.0  # times the last correction: the error of the exact point
FORWARD = 1e-11  # least error of the exact point, in units of order 1
TERM_ROUNDING = 64 * EPSILON  # error of the terms of a row
DEPENDENT = 1e-10  # part of a row that active rows leave over, relative to the row: what is less is none


@dataclass(frozen=True, eq=False)
class WeakRows:
    """Rows f'z <= limit that are active with multiplier zero, in the units of the program.

    F (weak, variables), ``rows`` (weak,) the row of each, ``choice`` (weak, rows) with F = choice A, and ``side``: 1 at
    an upper limit, -1 at a lower one or in a cone.
    """

    F: sp.csr_array
    rows: Indices
    choice: sp.csr_array
    side: Array


@dataclass(frozen=True, eq=False)
class ExactPoint:
    """The optimum, K of the rows that are active for certain, and the weak rows.

    ``corners`` are rows of cones at whose apex the optimum lies, with multipliers at the border of what holds it there.
    ``settled``: no sign is wrong.
    """

    deviations: DeviationProgram
    kkt: ActiveKKT
    weak: WeakRows
    corners: Indices
    settled: bool

    @property
    def program(self) -> Program:
        """Return the program in its scaled units."""
        return self.deviations.program

    @cached_property
    def trajectory(self) -> Trajectory:
        """The optimal states and controls."""
        linear, scaling = self.deviations.linear, self.deviations.scaling
        change = linear.direction(scaling.primal(self.kkt.z))
        at = self.deviations.trajectory
        return Trajectory(at.x + change.x, at.u + change.u)

    @cached_property
    def multipliers(self) -> Multipliers:
        """The optimal multipliers."""
        return self.multipliers_of(self.kkt.y)

    def multipliers_of(self, y: Array) -> Multipliers:
        """Return multipliers, or changes of them, from duals in scaled units."""
        # those of an optimum pay for slacks; changes of them pay for changes of prices, and stay as they are
        return replace(self.deviations.linear.multipliers(self.deviations.scaling.dual(y), 0.0), eta_C=1.0)

    @cached_property
    def responses(self) -> tuple[Array, Array, Array, Mask]:
        """K^-1 F' in z and in duals, S = F P F', and which weak rows the active rows determine: F' = M'q."""
        F, none = self.weak.F, np.zeros(len(self.kkt.y))
        columns = [self.kkt.solve(row, none)[:2] for row in F.toarray()]
        of_z, of_y = (np.stack(part, axis=1) for part in zip(*columns, strict=True))
        S = F @ of_z
        left = np.abs(self.kkt.hessian @ of_z).max(0)
        return of_z, of_y, 0.5 * (S + S.T), left <= DEPENDENT * abs(F).max(axis=1).toarray().ravel()

    @property
    def dependent(self) -> Mask:
        """Return which weak rows the active rows determine."""
        return self.responses[3] if len(self.weak.rows) else np.zeros(0, dtype=bool)

    def describe(self, rows: Indices, side: Array) -> tuple[str, ...]:
        """Return the names of rows of the program, with their times and components."""
        return tuple(self._describe(int(row), at > 0) for row, at in zip(rows, side, strict=True))

    def _describe(self, row: int, upper: bool) -> str:
        linear, n = self.deviations.linear, self.deviations.linear.problem.state_dim
        first = self.program.rows[Block.DYNAMICS].stop
        if row < first:
            return f"dynamics, t = {row // n}, component {row % n}"
        for part in linear.rows:
            if row < first + len(part.lower):
                return _name_of(part, row - first, "upper" if upper else "lower")
            first += len(part.lower)
        raise IndexError(row)


def _name_of(part: ProgramRows, row: int, side: str) -> str:
    """Return the name of a row of a part, with its time or bin and its component; of a cone, that of its values."""
    for start, stop in part.cones:
        if start <= row < stop:
            row, side = min(row + 1, stop - 1) if part.entries[row] < 0 else row, "limit"
    entry, (T, n, m) = int(part.entries[row]), part.shape
    if entry < 0:
        return f"{part.name}, slack {row}"
    if part.map is None:
        first, width = (0, n) if part.block is Block.STATE_SET else ((T + 1) * n, m)
        group, component, places = entry - first, (entry - first) % width, None
        return f"{part.name}, t = {group // width}, component {component}, {side}"
    group, component = divmod(entry, part.map.shape[1])
    places = part.map.positions
    kind = "t" if part.spectrum is None and part.map.spectrum is None else "bin"
    where = f", {kind} = {places[group]}" if len(places) == part.map.shape[0] > 1 else ""
    return f"{part.name}{where}, component {component}, {side}"


def exact_point(problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers) -> ExactPoint | None:
    """Return the exact optimum near an answer of a linear problem; None if its active rows determine none.

    Raises
    ------
    UnsupportedError
        If K does not fit into memory, or takes too long.
    """
    found = None
    for point in _points(problem, trajectory, multipliers):
        found = point if found is None or point.settled else found
        if point.settled:
            break
    return found


def _points(problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers) -> Iterator[ExactPoint]:
    for deviations, z, y in deviations_from(problem, trajectory, multipliers):
        solution = solve_active(deviations.program, z, y)
        if solution is not None:
            z, y, system = solution
            near = None if system.active.edges.any() else system.factor
            yield _with_weak_rows(deviations, *_correct_point(ActiveKKT(deviations.program, system.active, z, y, near)))


def _correct_point(kkt: ActiveKKT) -> tuple[ActiveKKT, float, float]:
    """Return K at the exact point, and the last correction of z and y."""
    program, sizes = kkt.program, (np.inf, np.inf)
    for _ in range(POINT_STEPS):
        dz, dy = kkt.newton_step()
        before, sizes = sizes, (float(np.abs(dz).max(initial=0.0)), float(np.abs(dy).max(initial=0.0)))
        if max(sizes) > 0.5 * max(before):  # rounding
            return kkt, *before
        moved = replace(kkt, z=kkt.z + dz, y=kkt.y + dy)
        if not kkt.active.edges.any():  # K is the same
            moved.__dict__.update({name: kkt.__dict__[name] for name in ("_rows", "_matrix", "_factor")})
        else:  # duals at an edge are along its normal
            heads = program.in_cones[program.heads][kkt.active.edges]
            of_rows = np.append(moved.y[kkt.active.rows], -moved.y[heads])
            moved = replace(moved, y=moved.choice.T @ of_rows)
        kkt = moved
    return kkt, *sizes


def _with_weak_rows(deviations: DeviationProgram, kkt: ActiveKKT, of_z: float, of_y: float) -> ExactPoint:
    """Return the point with its weak rows: those whose slack or multiplier is zero up to the error of the point."""
    program, active, z, y = deviations.program, kkt.active, kkt.z, kkt.y
    A, values, equal = sp.csr_array(program.A), program.A @ z, program.equality
    linear, at = deviations.linear, deviations.trajectory
    sizes = np.append(np.abs(at.x), np.abs(at.u))
    terms = TERM_ROUNDING * deviations.scaling.rows * (abs(linear.sparse.A[:, : linear.signals]) @ sizes)
    norms = np.sqrt(np.asarray((A * A).sum(1)).ravel())
    error = np.maximum(FORWARD * max(1.0, float(np.abs(z).max())), SAFETY * of_z) * norms + terms
    of_y = max(FORWARD * max(1.0, float(np.abs(y).max())), SAFETY * of_y)
    over, under = program.upper - values, values - program.lower
    held = (active.above | active.below) & ~equal
    price = np.where(active.above, y, -y)
    single = program.alone & ~equal & (norms > 0)
    slack = np.minimum(over, under)
    weak = single & np.where(held, price <= of_y, slack <= error)
    wrong = single & np.where(held, price < -of_y, slack < -error)
    of_cones, corners, normals, broken = _cones(program, kkt, error, of_y)
    free = replace(
        active, above=active.above & (equal | ~weak), below=active.below & ~weak, edges=active.edges & ~of_cones
    )
    rows = np.flatnonzero(weak)
    side = np.where(over[rows] <= under[rows], 1.0, -1.0)
    chosen = sp.csr_array((side, rows, np.arange(len(rows) + 1)), shape=(len(rows), A.shape[0]))
    choice = sp.csr_array(sp.vstack([chosen, normals[np.flatnonzero(of_cones)]]))
    every = np.append(rows, program.in_cones[program.heads][of_cones])
    weak_rows = WeakRows(sp.csr_array(choice @ A), every, choice, np.append(side, -np.ones(len(every) - len(rows))))
    settled = not (wrong.any() or broken)
    if free.same_as(active):
        return ExactPoint(deviations, kkt, weak_rows, corners, settled)
    y = np.where(weak, 0.0, y)
    y[program.in_cones[of_cones[program.cone_of]]] = 0.0
    return ExactPoint(deviations, ActiveKKT(program, free, z, y), weak_rows, corners, settled)


def _cones(program: Program, kkt: ActiveKKT, error: Array, of_y: float) -> tuple[Mask, Indices, sp.csr_array, bool]:
    """Return the cones at their edge with multiplier zero, first rows of those at corners, normals, and wrong signs."""
    s, heads, tails = program.of_cones(program.A @ kkt.z - program.lower)
    places = program.in_cones[program.heads]
    normals = s / np.where(tails > 0, tails, 1.0)[program.cone_of]
    normals[program.heads] = -1.0
    N = sp.csr_array((normals, (program.cone_of, program.in_cones)), shape=(len(heads), len(program.lower)))
    _, _, weights = program.of_cones(kkt.y)
    apex, room, price = kkt.active.at_apex[places], heads - tails, -kkt.y[places]
    near = np.zeros(len(heads)) if not len(heads) else np.maximum.reduceat(error[program.in_cones], program.heads)
    inside = ~apex & ~kkt.active.edges
    weak = (inside & (room <= near)) | (kkt.active.edges & (price <= of_y))
    broken = (inside & (room < -near)) | (kkt.active.edges & (price < -of_y)) | (apex & (price < weights - of_y))
    return weak, places[apex & (price <= weights + of_y)], N, bool(broken.any())
