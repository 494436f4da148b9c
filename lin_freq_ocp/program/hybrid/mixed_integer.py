"""A piecewise-affine problem as one mixed-integer program: a binary delta_{t,i} for every mode at every time.

    DYNAMICS   sum_j below_ij delta_{t,j} <= x_{t+1} - A_i x_t - B_i u_t - d_i <= sum_j above_ij delta_{t,j}
    REGIONS    G_i x_t + H_i u_t - h_i <= sum_j regions_ij delta_{t,j}
    MODES      sum_i delta_{t,i} = 1, 0 <= delta <= 1, and <= 0 for modes that cannot hold

with the bounds below, which are 0 for j = i: while mode i holds, its map and region do, and the rows of the
others are void. One M for each pair of modes is at least as tight as M (1 - delta_{t,i}) with the largest of them. A
row of several modes is written once, as an equation if all have it. Everything else is as in the linear program.

The coefficients are the least bounds on maps and regions of a mode while another mode holds. While mode j holds at t,
(x_t, u_t) lies in a domain D_tj: the region of j, the hard linear rows of the stage sets, the box of j in the forward
reach (``mode_reach``), and f_j(x_t, u_t) in that of x_{t+1}. Over it,

    below_ij <= f_j - f_i <= above_ij,      G_i x + H_i u - h_i <= regions_ij.

Every bound is a small linear program in units of the half widths of the box; those of one time are solved together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import NumericalError, UnsupportedError
from lin_freq_ocp.base.polyhedra import minimiser
from lin_freq_ocp.problem.hybrid.piecewise_affine import ModeArrays
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.linear_program import LinearProgram, signal_columns
from lin_freq_ocp.program.program import Block, Program, Scaling
from lin_freq_ocp.program.units import common_scaling
from lin_freq_ocp.transform.hybrid.forms import piecewise_affine
from lin_freq_ocp.transform.hybrid.mode_reach import LARGEST_BOUND, ModeReach
from lin_freq_ocp.transform.sizes import stated_sizes

# Of rows of a domain, in half widths: ten times the solvers' tolerances. A mode with an empty domain cannot hold.
RELAXATION = 1e-6
# Part of its range by which every bound is enlarged, for the tolerance (1e-7) of the linear program
BIG_M_MARGIN = 1e-6
LEAST_HALF_WIDTH = 1e-9  # of an interval (that of a fixed state is a point), relative to the size of its component
TERM_ROUNDING = 1e-12  # part of the absolute terms of a bound
Rows = tuple[Array, Array]  # coefficients (rows, n+m) and limits (rows,): rows y <= limits


@dataclass(frozen=True, eq=False)
class BigMBounds:
    """Bounds for mode i while mode j holds: of f_j - f_i (T, i, j, n), and of G_i x + H_i u - h_i (T, i, j, rows).

    ``possible`` (T, modes) says which modes can hold. Bounds of others are 0, as are all where only one can.
    """

    possible: Mask
    below: Array
    above: Array
    regions: Array


@dataclass(frozen=True, eq=False)
class _Stage:
    """One time and the modes that its reach leaves: maps F y + c, regions G y <= h, boxes, further rows, y = (x, u)."""

    F: Array
    c: Array
    G: Array
    h: Array
    centres: Array
    halves: Array
    rows: Array
    limits: Array
    next_lower: Array
    next_upper: Array

    @property
    def key(self) -> bytes:
        """Return the data of the stage, to find equal stages."""
        return b"".join(np.ascontiguousarray(part).tobytes() for part in vars(self).values())

    def domain(self, j: int) -> Rows:
        """Return the rows of mode j in v = (y - centre) / half widths, within [-1, 1], each of norm 1."""
        region = np.isfinite(self.h[j])
        above, below = np.abs(self.next_upper) < LARGEST_BOUND, np.abs(self.next_lower) < LARGEST_BOUND
        rows = np.vstack([self.G[j][region], self.rows, self.F[j][above], -self.F[j][below]])
        images = (self.next_upper - self.c[j])[above], (self.c[j] - self.next_lower)[below]
        limits = np.concatenate([self.h[j][region], self.limits, *images]) - rows @ self.centres[j]
        rows, limits = _normalise_rows(rows * self.halves[j], limits)
        most = 2 * np.sqrt(rows.shape[1])  # a row of norm 1 is at most half of it
        return rows, np.clip(limits, -most, most)


def require_time(end: float) -> None:
    """Raise TimeoutError if ``clock.now`` is after the end."""
    if now() > end:
        raise TimeoutError


def big_m_bounds(problem: OptimalControlProblem, end: float = np.inf) -> BigMBounds:
    """Return the big-M bounds of a problem with piecewise-affine dynamics; TimeoutError at ``end`` (``clock.now``).

    Raises UnsupportedError, naming the signal, if it has no bound at a time at which several modes are possible.
    """
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    # for every t < T, the hard rows on (x_t, u_t) other than bounds and modes
    parts: list[list[Rows]] = [[(np.zeros((0, n + m)), np.zeros(0))] for _ in range(T)]
    for term in problem.terms:
        implied = term.implied_rows(n, m)
        for group, t in enumerate(() if implied is None else implied.times):
            if implied is not None and t < T and (finite := np.isfinite(implied.e[group])).any():
                parts[t].append((implied.matrix(group)[finite], implied.e[group][finite]))
    further = [(np.vstack([rows for rows, _ in part]), np.concatenate([limit for _, limit in part])) for part in parts]
    units = np.concatenate(stated_sizes(problem))
    reached = ModeReach(_with_implied_bounds(problem, further, units))
    arrays = reached.arrays
    modes, rows = arrays.h.shape[1:]
    reach = reached.from_start(np.ones((T, modes), dtype=bool))
    bounds = BigMBounds(
        possible=np.zeros((T, modes), dtype=bool) if reach is None else reach.allowed.copy(),
        below=np.zeros((T, modes, modes, n)),
        above=np.zeros((T, modes, modes, n)),
        regions=np.zeros((T, modes, modes, rows)),
    )
    known: dict[bytes, tuple[Mask, Array, Array, Array]] = {}
    for t in map(int, np.flatnonzero(bounds.possible.sum(axis=1) > 1)):
        assert reach is not None  # a mode is possible
        modes_here = np.flatnonzero(reach.allowed[t])
        for limits, side in ((reach.mode_lower, "lower"), (reach.mode_upper, "upper")):
            unbounded = (np.abs(limits[t, modes_here]) >= LARGEST_BOUND).any(axis=0)
            if unbounded.any():
                name = (*problem.state_names, *problem.control_names)[int(np.argmax(unbounded))]
                raise UnsupportedError(
                    f"{name}: no {side} bound at t = {t}, where several modes are possible; a mixed-integer program "
                    "needs bounds that the state, control and initial sets state or imply."
                )
        lower, upper = reach.mode_lower[t, modes_here], reach.mode_upper[t, modes_here]
        stage = _Stage(
            F=arrays.maps[t, modes_here],
            c=arrays.offset[t, modes_here],
            G=arrays.rows[t, modes_here],
            h=arrays.h[t, modes_here],
            centres=(lower + upper) / 2,
            halves=np.maximum((upper - lower) / 2, LEAST_HALF_WIDTH * units),
            rows=further[t][0],
            limits=further[t][1],
            next_lower=reach.lower[t + 1],
            next_upper=reach.upper[t + 1],
        )
        if stage.key not in known:
            require_time(end)
            known[stage.key] = _stage_bounds(stage)
        bounds.possible[t, modes_here] = known[stage.key][0]
        for part, figures in zip((bounds.below, bounds.above, bounds.regions), known[stage.key][1:], strict=True):
            part[t][np.ix_(modes_here, modes_here)] = figures
    return bounds


def _stage_bounds(stage: _Stage) -> tuple[Mask, Array, Array, Array]:
    """Return possible (modes,), and below, above and regions for each pair (modes i, modes j, ...)."""
    modes, n = stage.c.shape
    domains = [stage.domain(j) for j in range(modes)]
    # the least relaxation of the rows of each domain for which it is not empty, all by one linear program
    blocks = [np.column_stack([rows, np.full(len(rows), -1.0)]) for rows, _ in domains]
    columns, limits = blocks[0].shape[1], np.concatenate([limits for _, limits in domains])
    cost = np.tile(np.append(np.zeros(columns - 1), 1.0), modes)
    lower = np.tile(np.append(-np.ones(columns - 1), 0.0), modes)
    upper = np.tile(np.append(np.ones(columns - 1), np.inf), modes)
    matrix = sp.csr_array(sp.block_diag([sp.csr_array(block) for block in blocks]))
    relaxations = _require_minimiser(minimiser(cost, matrix, limits, lower, upper))[columns - 1 :: columns]
    possible, limited = relaxations <= RELAXATION, np.isfinite(stage.h)
    below, above = np.zeros((2, modes, modes, n))
    regions = np.zeros((modes, modes, stage.h.shape[1]))
    asked: list[tuple[int, Array, tuple[sp.csr_array, Array]]] = []
    for j in np.flatnonzero(possible):
        rows, limits = domains[j]
        differences = (stage.F[j] - stage.F).reshape(-1, stage.F.shape[-1])
        objectives = np.vstack([differences, -differences, stage.G.reshape(-1, stage.G.shape[-1])])
        asked.append((int(j), objectives, (sp.csr_array(rows), limits + RELAXATION + relaxations[j])))
    if not asked:  # no mode can hold: the rows of MODES say so
        return possible, below, above, regions
    for (j, _, _), largest in zip(asked, _largest_values(stage, asked), strict=True):
        up, down, region = np.split(largest, np.cumsum([modes * n, modes * n]))
        offsets = stage.c[j] - stage.c
        above[:, j], below[:, j] = up.reshape(modes, n) + offsets, offsets - down.reshape(modes, n)
        region = region.reshape(stage.h.shape) - np.where(limited, stage.h, 0.0)
        regions[:, j] = np.where(limited, region, 0.0)
    return possible, below, above, regions


def _largest_values(stage: _Stage, asked: Sequence[tuple[int, Array, tuple[sp.csr_array, Array]]]) -> list[Array]:
    """Return the largest value of each objective'y over its domain, enlarged outward, except an exact 0."""
    scaled = np.vstack([objectives * stage.halves[j] for j, objectives, _ in asked])
    sizes, counts = np.abs(scaled).sum(axis=1), np.cumsum([len(objectives) for _, objectives, _ in asked])
    parts = np.split(sizes > 0, counts[:-1])
    blocks = [domain for (_, _, domain), live in zip(asked, parts, strict=True) for _ in range(int(live.sum()))]
    largest, live = np.zeros(len(scaled)), sizes > 0
    if blocks:
        cost, ones = -scaled[live] / sizes[live, None], np.ones(scaled[live].size)
        matrix = sp.csr_array(sp.block_diag([rows for rows, _ in blocks]))
        limits = np.concatenate([limits for _, limits in blocks])
        v = _require_minimiser(minimiser(cost.ravel(), matrix, limits, -ones, ones))
        largest[live] = -(cost * v.reshape(cost.shape)).sum(axis=1) * sizes[live]
    middles = np.concatenate([objectives @ stage.centres[j] for j, objectives, _ in asked])
    terms = np.concatenate([np.abs(objectives) @ np.abs(stage.centres[j]) for j, objectives, _ in asked])
    return np.split(largest + BIG_M_MARGIN * sizes + middles + TERM_ROUNDING * terms, counts[:-1])


def _require_minimiser(minimiser: Array | None) -> Array:
    if minimiser is None:
        raise NumericalError("A linear program about the domains of modes was not solved.")
    return minimiser


def _normalise_rows(rows: Array, limits: Array) -> Rows:
    """Return rows of norm 1, or 0."""
    norms = np.linalg.norm(rows, axis=1)
    sizes = np.where(norms > 0, norms, np.where(limits != 0, np.abs(limits), 1.0))
    return rows / sizes[:, None], limits / sizes


def _with_implied_bounds(
    problem: OptimalControlProblem, further: Sequence[Rows], units: Array
) -> OptimalControlProblem:
    """Return the problem with the bounds implied by further rows where none are stated; for the reach alone."""
    n, boxes, controls = problem.state_dim, problem.state_boxes, problem.control_tube
    lower = np.hstack([problem.state_tube.lower[:-1], controls.lower])
    upper = np.hstack([problem.state_tube.upper[:-1], controls.upper])
    unbounded = ~np.isfinite(lower) | ~np.isfinite(upper)
    if not any(unbounded[t].any() and len(further[t][1]) for t in range(problem.horizon)):
        return problem
    for t in map(int, np.flatnonzero(unbounded.any(axis=1))):
        low, high = lower[t] / units, upper[t] / units
        rows, limits = _normalise_rows(further[t][0] * units, further[t][1])
        for sign, side in ((1.0, upper[t]), (-1.0, lower[t])):
            for k in np.flatnonzero(~np.isfinite(side)):
                point = minimiser(np.where(np.arange(len(units)) == k, -sign, 0.0), rows, limits, low, high)
                if point is not None:
                    side[k] = units[k] * (point[k] + sign * BIG_M_MARGIN * max(1.0, abs(float(point[k]))))
    state_set = Box(np.vstack([lower[:, :n], boxes.lower[-1]]), np.vstack([upper[:, :n], boxes.upper[-1]]))
    return replace(problem, dynamics=problem.form, state_set=state_set, control_set=Box(lower[:, n:], upper[:, n:]))


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
    """Return the mixed-integer program of a problem with piecewise-affine dynamics; raises as ``big_m_bounds``."""
    dynamics, T = piecewise_affine(problem), problem.horizon
    arrays, bounds = dynamics.arrays(T), big_m_bounds(problem, end)
    hosts = [LinearProgram(problem.with_dynamics(dynamics.along(np.full(T, i)))) for i in range(len(dynamics.modes))]
    n, m = problem.state_dim, problem.control_dim
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
    require_time(end)
    joined, of_signals = _join_rows(rows, hosts[0], columns), common_scaling(hosts, stated_sizes(problem))
    # the units of the signals, 1 for binaries, and those of rows that make their largest coefficient 1
    units = np.append(of_signals.columns, np.ones(len(joined.q) - len(of_signals.columns)))
    largest = abs(joined.A @ sp.diags_array(units)).max(axis=1).toarray().ravel()
    of_rows = 1.0 / np.where(largest > 0, largest, 1.0)  # rows of zeros are in cones only
    for cone in joined.cones:
        of_rows[cone] = of_rows[cone].min()
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
