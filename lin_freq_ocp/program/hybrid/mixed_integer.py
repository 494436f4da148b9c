"""A piecewise-affine problem as one mixed-integer program: a binary delta_{t,i} for every mode at every time.

    DYNAMICS   sum_j below_ij delta_{t,j} <= x_{t+1} - A_i x_t - B_i u_t - d_i <= sum_j above_ij delta_{t,j}
    REGIONS    G_i x_t + H_i u_t - h_i <= sum_j regions_ij delta_{t,j}
    MODES      sum_i delta_{t,i} = 1, 0 <= delta <= 1, and <= 0 for modes that cannot hold

with the bounds below, which are 0 for j = i: while mode i holds, its map and region do, and the rows of the
others are void. One M for each pair of modes is at least as tight as M (1 - delta_{t,i}) with the largest of them. A
row of several modes is written once, as an equation if all have it. Everything else is as in the linear program.

While mode j holds at t, (x_t, u_t) lies in the box of j in the forward reach (``mode_reach``). Interval arithmetic over
it gives

    below_ij <= f_j - f_i <= above_ij,      G_i x + H_i u - h_i <= regions_ij.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.problem.hybrid.piecewise_affine import ModeArrays
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.hybrid.rows import mode_programs
from lin_freq_ocp.program.linear_program import LinearProgram, signal_columns
from lin_freq_ocp.program.program import Block, Program, Scaling
from lin_freq_ocp.program.units import common_scaling
from lin_freq_ocp.transform.hybrid.forms import piecewise_affine
from lin_freq_ocp.transform.hybrid.mode_reach import LARGEST_BOUND, ModeReach
from lin_freq_ocp.transform.sizes import stated_sizes

LEAST_HALF_WIDTH = 1e-9  # of an interval (that of a fixed state is a point), relative to the size of its component
TERM_ROUNDING = 1e-12  # part of the absolute terms of a bound


@dataclass(frozen=True, eq=False)
class BigMBounds:
    """Bounds for mode i while mode j holds: of f_j - f_i (T, i, j, n), and of G_i x + H_i u - h_i (T, i, j, rows).

    ``possible`` (T, modes) says which modes can hold. Bounds of others are 0, as are all where only one can.
    """

    possible: Mask
    below: Array
    above: Array
    regions: Array


def big_m_bounds(problem: OptimalControlProblem) -> BigMBounds:
    """Return the big-M bounds of a problem with piecewise-affine dynamics.

    Raises UnsupportedError, naming the signal, if it has no bound at a time at which several modes are possible.
    """
    k = problem.state_dim + problem.control_dim
    units, reached = np.concatenate(stated_sizes(problem)), ModeReach(problem)
    arrays = reached.arrays
    possible = np.zeros(arrays.h.shape[:2], dtype=bool)
    reach = reached.from_start(~possible)
    lower = upper = np.zeros((*possible.shape, k))
    if reach is not None:
        possible, lower, upper = reach.allowed.copy(), reach.mode_lower, reach.mode_upper
    several = possible & (possible.sum(axis=1, keepdims=True) > 1)
    for t in map(int, np.flatnonzero(several.any(axis=1))):
        for limits, side in ((lower, "lower"), (upper, "upper")):
            unbounded = (np.abs(limits[t, several[t]]) >= LARGEST_BOUND).any(axis=0)
            if unbounded.any():
                name = (*problem.state_names, *problem.control_names)[int(np.argmax(unbounded))]
                raise UnsupportedError(
                    f"{name}: no {side} bound at t = {t}, where several modes are possible; a mixed-integer program "
                    "needs bounds that the state, control and initial sets state or imply."
                )
    lower, upper = (np.where(several[..., None], side, 0.0)[:, None, ..., None] for side in (lower, upper))
    centre, half = (lower + upper) / 2, np.maximum((upper - lower) / 2, LEAST_HALF_WIDTH * units[:, None])
    pairs = (several[:, :, None] & several[:, None])[..., None]

    def largest(rows: Array) -> Array:
        """Return the largest rows y (T, modes i, modes j, ...) over the boxes of modes j."""
        return (rows @ centre + np.abs(rows) @ (half + TERM_ROUNDING * np.abs(centre)))[..., 0]

    maps, offsets = (part[:, None] - part[:, :, None] for part in (arrays.maps, arrays.offset))  # f_j - f_i
    limited = np.isfinite(arrays.h)[:, :, None]
    regions = largest(arrays.rows[:, :, None]) - np.where(limited, arrays.h[:, :, None], 0.0)
    return BigMBounds(
        possible=possible,
        below=np.where(pairs, offsets - largest(-maps), 0.0),
        above=np.where(pairs, offsets + largest(maps), 0.0),
        regions=np.where(pairs & limited, regions, 0.0),
    )


Row = tuple[Indices, Array, float, float]  # columns, their coefficients, lower and upper limit


@dataclass(frozen=True, eq=False)
class MixedIntegerForm:
    """The mixed-integer program of a piecewise-affine problem in natural units, with its inverse.

    ``host`` is the linear program with the map of mode 0 alone and no regions, whose variables come first; ``possible``
    (T, modes) says which modes can hold.
    """

    program: Program
    scaling: Scaling
    host: LinearProgram
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
    """The columns of x_t (T+1, n), (x_t, u_t) (T, n+m) and delta_t (T, modes); those of the binaries come last."""

    x: Indices
    y: Indices
    delta: Indices


def big_m_program(problem: OptimalControlProblem, end: float = np.inf) -> MixedIntegerForm:
    """Return the mixed-integer program of a problem with piecewise-affine dynamics.

    Raises as ``big_m_bounds``, and TimeoutError if ``clock.now`` is after the end when the rows are known.
    """
    dynamics, T = piecewise_affine(problem), problem.horizon
    arrays, bounds = dynamics.arrays(T), big_m_bounds(problem)
    hosts, n, m = mode_programs(problem), problem.state_dim, problem.control_dim
    columns = _Columns(
        x=np.arange((T + 1) * n).reshape(T + 1, n),
        y=signal_columns(T, n, m),
        delta=len(hosts[0].sparse.q) + np.arange(T * len(hosts)).reshape(T, len(hosts)),
    )
    mode_rows = list[Row]()
    for deltas, possible in zip(columns.delta, bounds.possible, strict=True):
        mode_rows.append((deltas, np.ones(len(deltas)), 1.0, 1.0))
        mode_rows += [(deltas[i : i + 1], np.ones(1), 0.0, float(holds)) for i, holds in enumerate(possible)]
    rows = {
        Block.DYNAMICS: list(_dynamics_rows(arrays, bounds, columns)),
        Block.REGIONS: list(_region_rows(arrays, bounds, columns)),
        Block.MODES: mode_rows,
    }
    if now() > end:
        raise TimeoutError
    joined, of_signals = _join_rows(rows, hosts[0], columns), common_scaling(hosts, stated_sizes(problem))
    # the units of the signals, 1 for binaries, and those of rows that make their largest coefficient 1
    units = np.append(of_signals.columns, np.ones(len(joined.q) - len(of_signals.columns)))
    largest = abs(joined.A @ sp.diags_array(units)).max(axis=1).toarray().ravel()
    for cone in joined.cones:  # rows of zeros in it have limits
        largest[cone] = max(largest[cone].max(), np.abs(joined.lower[cone]).max())
    of_rows = 1.0 / np.where(largest > 0, largest, 1.0)
    scaling = Scaling(columns=units, rows=of_rows, cost=of_signals.cost)
    return MixedIntegerForm(joined.scaled(scaling), scaling, hosts[0], bounds.possible)


def _dynamics_rows(arrays: ModeArrays, bounds: BigMBounds, columns: _Columns) -> Iterator[Row]:
    for t, possible in enumerate(bounds.possible):
        holding = np.flatnonzero(possible)
        for k in range(columns.x.shape[1]):
            for same in _equal_groups(holding, arrays.maps[t, :, k], arrays.offset[t, :, k, None]):
                i, others = same[0], np.setdiff1d(holding, same)
                at = np.concatenate([columns.x[t + 1, k : k + 1], columns.y[t], columns.delta[t, others]])
                map_row, offset = [1.0, *-arrays.maps[t, i, k]], float(arrays.offset[t, i, k])
                if not len(others):
                    yield at, np.array(map_row), offset, offset
                    continue
                yield at, np.append(map_row, -bounds.above[t, i, others, k]), -np.inf, offset
                yield at, np.append(map_row, -bounds.below[t, i, others, k]), offset, np.inf


def _region_rows(arrays: ModeArrays, bounds: BigMBounds, columns: _Columns) -> Iterator[Row]:
    modes, count = arrays.h.shape[1:]
    for t, possible in enumerate(bounds.possible):
        rows, h = (part[t].reshape(modes * count, -1) for part in (arrays.rows, arrays.h))
        written = np.isfinite(h[:, 0]) & rows.any(axis=1)
        asked = np.flatnonzero(written & np.repeat(possible, count))
        for same in _equal_groups(asked, rows, h):
            i, r = divmod(int(same[0]), count)
            others = np.setdiff1d(np.flatnonzero(possible), same // count)
            at = np.concatenate([columns.y[t], columns.delta[t, others]])
            row = np.append(arrays.rows[t, i, r], -bounds.regions[t, i, others, r])
            yield at, row, -np.inf, float(arrays.h[t, i, r])


def _equal_groups(chosen: Indices, *parts: Array) -> Iterator[Indices]:
    """Yield groups of chosen indices whose rows in all parts are equal."""
    if len(chosen):
        rows = np.concatenate([part[chosen] for part in parts], axis=1)
        _, first, group = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        for g in np.argsort(first):
            yield chosen[group.ravel() == g]


def _join_rows(rows: dict[Block, list[Row]], host: LinearProgram, columns: _Columns) -> Program:
    """Return the rows with all of the host's but its dynamics, in the host's deviations from the references."""
    program, count, binaries = host.sparse, len(host.sparse.q) + columns.delta.size, columns.delta.size
    listed = [row for block in rows.values() for row in block]
    of_column = np.concatenate([row[0] for row in listed])
    of_row = np.repeat(np.arange(len(listed)), [len(row[0]) for row in listed])
    values = np.concatenate([row[1] for row in listed])
    mode_matrix = sp.csr_array((values, (of_row, of_column)), (len(listed), count))
    origin = np.zeros(count)
    origin[: host.signals] = np.append(host.origin.x, host.origin.u)
    limits = np.array([row[2:] for row in listed]).T - mode_matrix @ origin
    first = program.rows[Block.DYNAMICS].stop  # the host's first rows
    of_host = sp.hstack([program.A[first:], sp.csc_array((len(program.lower) - first, binaries))])
    A = sp.csc_array(sp.vstack([mode_matrix, of_host]))
    A.eliminate_zeros()
    ends = np.cumsum([0, *(len(block) for block in rows.values())])
    blocks = {block: slice(int(a), int(b)) for block, a, b in zip(rows, ends[:-1], ends[1:], strict=True)}
    shift = len(listed) - first
    return Program(
        P=sp.csc_array(sp.block_diag([program.P, sp.csc_array((binaries, binaries))])),
        q=np.append(program.q, np.zeros(binaries)),
        constant=program.constant,
        A=A,
        lower=np.append(limits[0], program.lower[first:]),
        upper=np.append(limits[1], program.upper[first:]),
        rows={block: _shift_slice(part, shift) for block, part in program.rows.items()} | blocks,
        cones=tuple(_shift_slice(cone, shift) for cone in program.cones),
        binaries=columns.delta.ravel(),
    )


def _shift_slice(rows: slice, by: int) -> slice:
    return slice(rows.start + by, rows.stop + by)
