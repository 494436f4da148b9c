"""Whole levels near a relaxed control: noise-shaped rounding, then single and double flips.

With levels, a mode sequence fixes u, and a constraint sees u through a response, the rows R of R u + c. Rounding every
sample to its nearest level adds errors d_t, whose sum R d can be large. A delta-sigma modulator keeps them out of the
limited band (Schreier and Temes, Understanding Delta-Sigma Data Converters, 2005): it feeds back the errors so far,

    e_t = R_0 d_0 + .. + R_{t-1} d_{t-1},   u_t = the level with the least |e_t + R_t (u_t - v_t)|.                (1)

The loop filter of (1) resonates at every frequency at which a row limits a magnitude, so that the noise transfer
function has a zero there; the row of a terminal state is an integrator. (1) is the converter with horizon one of
Quevedo and Goodwin (Multistep optimal analog-to-digital conversion, IEEE TCAS-I 52(3), 2005).

A local search removes the rest of the violation. A flip moves one component at one time to the next level. The best
single flip is made as long as one helps, else the first pair of flips that does: first to decrease the sum of squared
violations to zero, then to decrease the cost with all rows satisfied.

Nothing is proven here: the search solves the sequence again, and the judge checks it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.program import Block, Program
from lin_freq_ocp.transform.hybrid.forms import piecewise_affine
from lin_freq_ocp.transform.simulation import simulate

MOST_RESPONSE_ENTRIES = 2e7  # of the response of x and u to u (160 MB): nothing is rounded if there are more
MOST_PAIR_WORK = 1e9  # flips^2 times rows, some seconds: with more, only single flips are made
FLIPS_PER_SAMPLE = 4  # at most: descents ended by themselves after fewer than one
SATISFIED = 1e-9  # violation of a row, relative to its response to all levels: the rounding error of the sum
LEAST_GAIN = 1e-9  # relative decrease of violation or cost that counts: steps of rounding errors could cycle
NEAREST = 1e-12  # weight of |u_t - v_t|^2 in (1): it decides where rows do not distinguish levels


@dataclass(frozen=True, eq=False)
class ResponseRows:
    """Hard constraints on R u + c; rows and cones are divided by the size of their response to all levels.

    Attributes
    ----------
    matrix : (rows, T * m)
        R.
    signals : sparse (rows, signals)
        The same rows as functions of x and u.
    lower, upper : (rows,)
        Bounds of single rows, infinite in cones.
    shifts : (rows,)
        s - values of the rows of a cone; zero for single rows.
    cones : tuple of (cones, size)
        Rows s of second-order cones, s_0 >= |(s_1, ...)|, one array for each size.
    """

    matrix: Array
    signals: sp.csr_array
    lower: Array
    upper: Array
    shifts: Array
    cones: tuple[Indices, ...]

    def violation(self, values: Array) -> Array:
        """Return the sum of squared violations of values (..., rows)."""
        single = np.maximum(np.maximum(values - self.upper, self.lower - values), 0.0)
        total = np.square(np.where(single > SATISFIED, single, 0.0)).sum(axis=-1)
        for cone in self.cones:
            s = (values + self.shifts)[..., cone]
            violation = np.linalg.norm(s[..., 1:], axis=-1) - s[..., 0]
            total += np.square(np.where(violation > SATISFIED, violation, 0.0)).sum(axis=-1)
        return total


def response_rows(program: Program, response: Array, spans: Array) -> ResponseRows:
    """Return the hard constraints of a program other than dynamics and levels.

    ``response`` (signals, T * m) is that of x and u to u; ``spans`` (T * m,) are the distances of the outermost levels.
    """
    A, signals = sp.csr_array(program.A), len(response)
    matrix = np.asarray(A[:, :signals] @ response)
    size = np.linalg.norm(matrix * spans, axis=1)
    with_slacks = np.diff(sp.csr_array(A[:, signals:]).indptr) > 0  # soft constraints and costs
    single = program.alone & ~with_slacks & (np.isfinite(program.lower) | np.isfinite(program.upper))
    for block in (Block.DYNAMICS, Block.CONTROL_SET):
        single[program.rows[block]] = False
    single &= size > 0  # no level changes the others
    chosen, by_size = list(np.flatnonzero(single)), dict[int, list[Indices]]()
    first = len(chosen)
    for cone in program.cones:
        if not with_slacks[cone].any() and size[cone].any():
            size[cone] = size[cone].max()
            rows = np.arange(cone.start, cone.stop)
            by_size.setdefault(len(rows), []).append(len(chosen) + np.arange(len(rows)))
            chosen += list(rows)
    alone, size = np.arange(len(chosen)) < first, size[chosen]
    lower, upper = program.lower[chosen] / size, program.upper[chosen] / size
    return ResponseRows(
        matrix=matrix[chosen] / size[:, None],
        signals=sp.csr_array(sp.diags_array(1.0 / size) @ A[chosen, :signals]),
        lower=np.where(alone, lower, -np.inf),
        upper=np.where(alone, upper, np.inf),
        shifts=np.where(alone, 0.0, -lower),
        cones=tuple(np.array(cones) for cones in by_size.values()),
    )


@dataclass(frozen=True, eq=False)
class Flips:
    """All flips of a sequence: times, new modes and changes of u in the column t * m + i of the response, each (K,).

    ``values`` (K, rows) are those of the rows after each flip, ``gains`` (K,) the changes of the cost; ``violation`` is
    that of the sequence before.
    """

    times: Indices
    modes: Indices
    columns: Indices
    changes: Array
    values: Array
    gains: Array
    violation: float
    rows: ResponseRows
    hessian: Array

    def best(self) -> Indices | None:
        """Return the best single flip; None if no flip helps."""
        return self._best_of(self.values, self.gains, np.arange(len(self.times))[:, None])

    def pair(self, end: float) -> Indices | None:
        """Return the first two flips at different times that help together; None if there are none until ``end``."""
        if len(self.times) ** 2 * self.values.shape[1] > MOST_PAIR_WORK:
            return None
        for first in range(len(self.times)):
            if now() > end:
                return None
            others = np.flatnonzero(self.times > self.times[first])
            columns, changes = self.columns[others], self.changes[others]
            values = self.values[first] + self.rows.matrix.T[columns] * changes[:, None]
            curved = self.hessian[self.columns[first], columns] * self.changes[first] * changes
            gains = self.gains[first] + self.gains[others] + curved
            improvement = self._best_of(values, gains, np.column_stack([np.full(len(others), first), others]))
            if improvement is not None:
                return improvement
        return None

    def _best_of(self, values: Array, gains: Array, flips: Indices) -> Indices | None:
        """Return the flips (moves, flips of each) with the largest decrease of the violation, or else of the cost."""
        if not len(flips):
            return None
        after = self.rows.violation(values)
        if self.violation > 0:
            change, size = after - self.violation, self.violation
        else:
            change, size = np.where(after > 0, np.inf, gains), float(np.abs(self.gains).max())
        best = int(np.argmin(change))
        return flips[best] if change[best] < -LEAST_GAIN * size else None


class LevelRounding:
    """The rounding of relaxed controls of a problem whose control set ``levels`` has the points ``choices``."""

    def __init__(self, problem: OptimalControlProblem, levels: ConvexSet, choices: Array):
        T, m, n = problem.horizon, problem.control_dim, problem.state_dim
        self._problem, self._choices, self._next = problem, choices, neighbouring_levels(choices)
        self._spans = np.ptp(choices, axis=0)
        self._improved: dict[tuple[bytes, bytes], tuple[Indices, float, float]] = {}
        relaxed = problem.with_dynamics(piecewise_affine(problem).along(np.zeros(T, dtype=np.intp)))
        self._linear = linear = LinearProgram(relaxed)  # all modes have the same map
        signals, dynamics = linear.signals, sp.csc_array(linear.dynamics)
        response = np.zeros((signals, T * m))  # from a given initial state
        response[linear.states :] = np.eye(T * m)
        of_u = -dynamics[:, linear.states : signals].toarray()
        response[n : linear.states] = sp.linalg.splu(sp.csc_array(dynamics[:, n : linear.states])).solve(of_u)
        program = linear.sparse
        self._rows = response_rows(program, response, np.tile(self._spans, T))
        # the quadratic cost and that of levels: the search adds other costs when it solves the sequence
        self._P, self._q, self._slopes = program.P[:signals, :signals], program.q[:signals], response.T
        self._hessian = np.asarray(response.T @ (self._P @ response))
        self._prices = np.zeros(len(choices))
        for part in levels.hull.parts(m):
            self._prices += part.penalty.cost(part.values(choices))

    def sequence_near(self, u: Array, initial_state: Array, end: float) -> Indices:
        """Return the better of two sequences (T,): noise-shaped and nearest levels, each improved until ``end``."""
        nearest = np.abs((u[:, None] - self._choices) / self._spans).sum(axis=2).argmin(axis=1)
        improved = list[tuple[Indices, float, float]]()
        for start in (self.shape(u), nearest):
            key = start.tobytes(), initial_state.tobytes()
            if key not in self._improved:  # neighbouring nodes often have the same start
                self._improved[key] = self.improve(start, initial_state, end)
            improved.append(self._improved[key])
        return min(improved, key=lambda result: result[1:])[0]

    def shape(self, u: Array) -> Indices:
        """Return the mode sequence (T,) of a relaxed control (T, m) by error feedback, equation (1)."""
        rows = self._rows.matrix.reshape(len(self._rows.matrix), *u.shape)
        error, sequence = np.zeros(len(rows)), np.zeros(len(u), dtype=np.intp)
        for t in range(len(u)):
            added = self._choices - u[t]
            errors = error + added @ rows[:, t].T
            size = np.square(errors).sum(axis=1) + NEAREST * np.square(added / self._spans).sum(axis=1)
            sequence[t] = np.argmin(size)
            error = errors[sequence[t]]
        return sequence

    def improve(self, sequence: Indices, initial_state: Array, end: float) -> tuple[Indices, float, float]:
        """Return a sequence after flips, its squared violation and its cost; stop at the time ``end``."""
        sequence, rows = sequence.copy(), self._rows
        for _ in range(FLIPS_PER_SAMPLE * len(sequence)):
            z, (t, side) = self._point(sequence, initial_state), np.nonzero(self._next[sequence] >= 0)
            modes, i, values = self._next[sequence[t], side], side // 2, rows.signals @ z
            columns, changes = t * self._choices.shape[1] + i, self._choices[modes, i] - self._choices[sequence[t], i]
            curved = 0.5 * self._hessian[columns, columns] * changes**2
            slope = (self._slopes @ (self._P @ z + self._q))[columns]
            flips = Flips(
                times=t,
                modes=modes,
                columns=columns,
                changes=changes,
                values=values + rows.matrix.T[columns] * changes[:, None],
                gains=slope * changes + curved + self._prices[modes] - self._prices[sequence[t]],
                violation=float(rows.violation(values)),
                rows=rows,
                hessian=self._hessian,
            )
            chosen = flips.best()
            chosen = flips.pair(end) if chosen is None else chosen
            if chosen is None:
                break
            sequence[t[chosen]] = modes[chosen]
            if now() > end:
                break
        trajectory = simulate(self._problem, self._choices[sequence], initial_state)
        violation = rows.violation(rows.signals @ self._point(sequence, initial_state))
        return sequence, float(violation), self._problem.value(trajectory.x, trajectory.u)

    def _point(self, sequence: Indices, initial_state: Array) -> Array:
        """Return x and u of a sequence as variables of the linear program."""
        trajectory = simulate(self._problem, self._choices[sequence], initial_state)
        return self._linear.point(trajectory)[: self._linear.signals]


def level_rounding(problem: OptimalControlProblem) -> LevelRounding | None:
    """Return the rounding of a problem with levels of all controls; None of others, or if it takes too much memory."""
    levels, choices, T, m = problem.form.levels, problem.form.choices, problem.horizon, problem.control_dim
    if levels is None or choices is None or np.isnan(choices).any():
        return None
    if ((T + 1) * problem.state_dim + T * m) * T * m > MOST_RESPONSE_ENTRIES:
        return None
    return LevelRounding(problem, levels, choices)


def neighbouring_levels(choices: Array) -> Indices:
    """Return the modes with the next lower and the next higher level of each component, (modes, 2m); -1 for none."""
    modes, m = choices.shape
    neighbours = np.full((modes, 2 * m), -1)
    for mode, side in np.ndindex(*neighbours.shape):
        i, sign = side // 2, 2 * (side % 2) - 1
        same = (np.delete(choices, i, axis=1) == np.delete(choices[mode], i)).all(axis=1)
        distance = sign * (choices[:, i] - choices[mode, i])
        further = np.flatnonzero(same & (distance > 0))
        if len(further):
            neighbours[mode, side] = further[np.argmin(distance[further])]
    return neighbours
