"""A piecewise-affine problem as one mixed-integer program: a binary delta_{t,i} for every mode at every time.

    DYNAMICS   sum_j below_ij delta_{t,j} <= x_{t+1} - A_i x_t - B_i u_t - d_i <= sum_j above_ij delta_{t,j}
    REGIONS    G_i x_t + H_i u_t - h_i <= sum_j regions_ij delta_{t,j}
    MODES      sum_i delta_{t,i} = 1, 0 <= delta <= 1, and <= 0 for modes that cannot hold

with the bounds of big_m.py, which are 0 for j = i: while mode i holds, its map and region do, and the rows of the
others are void. One M for each pair of modes is at least as tight as M (1 - delta_{t,i}) with the largest of them. A
row of several modes is written once, as an equation if all have it. Everything else is as in the linear transcription.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.problem.hybrid.forms import piecewise_affine
from lin_freq_ocp.problem.hybrid.piecewise_affine import ModeArrays
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.hybrid.big_m import Excesses, excesses, require_time
from lin_freq_ocp.program.program import Block, Program, Scaling
from lin_freq_ocp.program.transcription import LinearTranscription
from lin_freq_ocp.program.units import common_scaling

Row = tuple[Indices, Array, float, float]  # columns, their coefficients, lower and upper limit


@dataclass(frozen=True, eq=False)
class MixedInteger:
    """The mixed-integer program of a piecewise-affine problem in natural units, with its inverse.

    ``host`` is the transcription with the map of mode 0 alone and no regions, whose variables come first; ``possible``
    (T, modes) says which modes can hold.
    """

    program: Program
    scaling: Scaling
    host: LinearTranscription
    possible: Mask

    def sequence(self, z: Array) -> Indices:
        """Return the mode with the largest delta at every time, (T,)."""
        return np.argmax(z[self.program.binaries].reshape(self.possible.shape), axis=1)

    def trajectory(self, z: Array) -> Trajectory:
        """Return (x, u) from a point of the program."""
        return self.host.trajectory(self.scaling.primal(z))

    def point(self, trajectory: Trajectory, sequence: Indices) -> Array:
        """Return the point of the program of a trajectory in these modes."""
        return np.concatenate([self.host.point(trajectory), self.deltas(sequence)]) / self.scaling.columns

    def deltas(self, sequence: Indices) -> Array:
        """Return the binaries of a mode sequence, (T * modes,)."""
        deltas = np.zeros(self.possible.shape)
        deltas[np.arange(len(sequence)), sequence] = 1.0
        return deltas.ravel()

    def cost(self, objective: float) -> float:
        """Return the cost J of a value of the program's objective."""
        return objective / self.scaling.cost


@dataclass(frozen=True, eq=False)
class _Columns:
    """The columns of x_t, u_t and delta_t."""

    horizon: int
    n: int
    m: int
    host: int
    modes: int

    def stage(self, t: int) -> Indices:
        """Return the columns of (x_t, u_t)."""
        u = (self.horizon + 1) * self.n + t * self.m
        return np.concatenate([self.state(t), np.arange(u, u + self.m)])

    def state(self, t: int) -> Indices:
        """Return the columns of x_t."""
        return np.arange(t * self.n, (t + 1) * self.n)

    def delta(self, t: int, modes: Indices) -> Indices:
        """Return the columns of delta_{t,i} of some modes."""
        return self.host + t * self.modes + modes

    @property
    def count(self) -> int:
        """Return how many variables there are."""
        return self.host + self.horizon * self.modes


def big_m_program(problem: OptimalControlProblem, end: float = np.inf) -> MixedInteger:
    """Return the mixed-integer program of a problem with piecewise-affine dynamics; raises as ``excesses``."""
    dynamics, T = piecewise_affine(problem), problem.horizon
    arrays, found = dynamics.arrays(T), excesses(problem, end)
    hosts = [
        LinearTranscription(replace(problem, dynamics=dynamics.along(np.full(T, i))))
        for i in range(len(dynamics.modes))
    ]
    columns = _Columns(T, problem.state_dim, problem.control_dim, len(hosts[0].program.q), len(hosts))
    rows = {
        Block.DYNAMICS: list(_dynamics_rows(arrays, found, columns)),
        Block.REGIONS: list(_region_rows(arrays, found, columns)),
        Block.MODES: list(_mode_rows(found, columns)),
    }
    require_time(end)
    own = _joined(rows, hosts[0], columns)
    scaling = _scaling(own, common_scaling(hosts))
    return MixedInteger(own.scaled(scaling), scaling, hosts[0], found.possible)


def _dynamics_rows(arrays: ModeArrays, found: Excesses, columns: _Columns) -> Iterator[Row]:
    for t, possible in enumerate(found.possible):
        holding = np.flatnonzero(possible)
        for k in range(columns.n):
            for same in _equal_groups(holding, arrays.A[t, :, k], arrays.B[t, :, k], arrays.offset[t, :, k, None]):
                i, others = same[0], np.setdiff1d(holding, same)
                at = np.concatenate([columns.state(t + 1)[k : k + 1], columns.stage(t), columns.delta(t, others)])
                map_row, offset = [1.0, *-arrays.A[t, i, k], *-arrays.B[t, i, k]], float(arrays.offset[t, i, k])
                if not len(others):
                    yield at, np.array(map_row), offset, offset
                    continue
                yield at, np.append(map_row, -found.above[t, i, others, k]), -np.inf, offset
                yield at, np.append(map_row, -found.below[t, i, others, k]), offset, np.inf


def _region_rows(arrays: ModeArrays, found: Excesses, columns: _Columns) -> Iterator[Row]:
    modes, count = arrays.h.shape[1:]
    for t, possible in enumerate(found.possible):
        G, H, h = (part[t].reshape(modes * count, -1) for part in (arrays.G, arrays.H, arrays.h))
        written = np.isfinite(h[:, 0]) & (np.abs(G).sum(axis=1) + np.abs(H).sum(axis=1) > 0)
        asked = np.flatnonzero(written & np.repeat(possible, count))
        for same in _equal_groups(asked, G, H, h):
            i, r = divmod(int(same[0]), count)
            others = np.setdiff1d(np.flatnonzero(possible), same // count)
            at = np.concatenate([columns.stage(t), columns.delta(t, others)])
            yield (
                at,
                np.concatenate([arrays.G[t, i, r], arrays.H[t, i, r], -found.regions[t, i, others, r]]),
                -np.inf,
                float(arrays.h[t, i, r]),
            )


def _mode_rows(found: Excesses, columns: _Columns) -> Iterator[Row]:
    for t, possible in enumerate(found.possible):
        deltas = columns.delta(t, np.arange(columns.modes))
        yield deltas, np.ones(columns.modes), 1.0, 1.0
        for delta, can_hold in zip(deltas, possible, strict=True):
            yield np.array([delta]), np.ones(1), 0.0, float(can_hold)


def _equal_groups(chosen: Indices, *parts: Array) -> Iterator[Indices]:
    """Yield groups of chosen indices whose rows in all parts are equal."""
    if len(chosen):
        rows = np.concatenate([part[chosen] for part in parts], axis=1)
        _, first, group = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        for g in np.argsort(first):
            yield chosen[group.ravel() == g]


def _joined(rows: dict[Block, list[Row]], host: LinearTranscription, columns: _Columns) -> Program:
    """Return the rows with all of the host's but its dynamics, in the host's deviations from the references."""
    program, binaries = host.program, columns.count - columns.host
    listed = [row for block in rows.values() for row in block]
    of_column = np.concatenate([row[0] for row in listed])
    of_row = np.repeat(np.arange(len(listed)), [len(row[0]) for row in listed])
    values = np.concatenate([row[1] for row in listed])
    own = sp.csr_array((values, (of_row, of_column)), (len(listed), columns.count))
    limits = np.array([row[2:] for row in listed]).T - own @ _origin(host, columns)
    first = program.rows[Block.DYNAMICS].stop  # the host's first rows
    of_host = sp.hstack([program.A[first:], sp.csc_array((len(program.lower) - first, binaries))])
    A = sp.csc_array(sp.vstack([own, of_host]))
    A.eliminate_zeros()
    ends = np.cumsum([0, *(len(block) for block in rows.values())])
    blocks = {block: slice(int(a), int(b)) for block, a, b in zip(rows, ends[:-1], ends[1:], strict=True)}
    moved = len(listed) - first
    return Program(
        P=sp.csc_array(sp.block_diag([program.P, sp.csc_array((binaries, binaries))])),
        q=np.append(program.q, np.zeros(binaries)),
        constant=program.constant,
        A=A,
        lower=np.append(limits[0], program.lower[first:]),
        upper=np.append(limits[1], program.upper[first:]),
        rows={block: _shifted(part, moved) for block, part in program.rows.items()} | blocks,
        cones=tuple(_shifted(cone, moved) for cone in program.cones),
        binaries=np.arange(columns.host, columns.count),
    )


def _origin(host: LinearTranscription, columns: _Columns) -> Array:
    """Return the references: states and controls minus the variables of the program."""
    zero = Trajectory(np.zeros((columns.horizon + 1, columns.n)), np.zeros((columns.horizon, columns.m)))
    origin = np.zeros(columns.count)
    origin[: host.signals] = -host.point(zero)[: host.signals]
    return origin


def _shifted(rows: slice, by: int) -> slice:
    return slice(rows.start + by, rows.stop + by)


def _scaling(program: Program, of_signals: Scaling) -> Scaling:
    """Return the units of the signals, 1 for binaries, and those of rows that make their largest coefficient 1."""
    columns = np.append(of_signals.columns, np.ones(len(program.q) - len(of_signals.columns)))
    largest = abs(program.A @ sp.diags_array(columns)).max(axis=1).toarray().ravel()
    rows = 1.0 / np.where(largest > 0, largest, 1.0)  # rows of zeros are in cones only
    for cone in program.cones:
        rows[cone] = rows[cone].min()
    return Scaling(columns=columns, rows=rows, cost=of_signals.cost)
