"""A trajectory near a given one that satisfies every constraint, by the least change of the controls.

Values of states and controls at a bound are held, and stopped bins are zero. Residuals of the dynamics move the states;
held states and stopped bins of states are the rows of a small dense system for the change of the controls. Nothing is
minimised but that change, and no multiplier is used: the cost of the repaired trajectory is that of a feasible one.
"""

from __future__ import annotations

import numpy as np
from scipy import fft
from scipy.linalg import lapack

from lin_freq_ocp.base.arrays import Array, Indices, Mask, times_vectors, to_long_double
from lin_freq_ocp.methods.structured.kkt.recursions import simulate
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.program_rows import real_rows

HELD_DISTANCE = 1e-6  # of the largest value of a component: distance to a bound from which a value is held
PIECE_GROWTH = 1e6  # of states between breaks; the square of the digits that it costs must be left
CONTRACTION = 1e-3  # part of the residuals that a repair may leave
MOST_ROW_ENTRIES = 1e7  # of the rows as signals


def repair_trajectory(problem: OptimalControlProblem, trajectory: Trajectory) -> Trajectory | None:
    """Return the repaired trajectory, whose states and controls are within their bounds exactly; None without one.

    None, too, where a repair needs more than controls: for a frequency response, and for constraints of other kinds
    that the repaired trajectory violates.
    """
    states, controls = problem.state_tube, problem.control_tube
    if problem.dynamics.response(problem.horizon) is not None:
        return None
    repair = _Repair(problem, states.project(trajectory.x), controls.project(trajectory.u))
    size = (problem.horizon + 1) * (problem.state_dim + problem.control_dim)
    change = repair.solve() if repair.count * (repair.count + size) <= MOST_ROW_ENTRIES else None
    if change is None:
        return None
    x, u = repair.x + change[0], repair.u + change[1]
    pairs = (states.violation(x), repair.held_states), (controls.violation(u), repair.held)
    if any(violation[~held].any() for violation, held in pairs):
        return None
    x, u = states.project(x), controls.project(u)
    for term in problem.terms:
        if term.hard and (term.semi_infinite is not None or term.penalty.violation(term.map.values(x, u)).any()):
            return None
    return Trajectory(x, u)


class _Repair:
    """The rows that a change of the controls keeps or corrects, and the projection of changes onto passed bins.

    Rows on states are held states, stopped bins, and at ``breaks`` the difference of a new start from the end of the
    simulation before, which would otherwise grow beyond all digits. Held controls with stopped bins are rows, too;
    other held controls do not change.
    """

    def __init__(self, problem: OptimalControlProblem, x: Array, u: Array):
        self.problem, self.x, self.u, self.stop = problem, x, u, problem.control_stop
        self.held_states, self.held = _at_bounds(problem.state_tube, x), _at_bounds(problem.control_tube, u)
        self.banded, n = self.stop.any(0), x.shape[1]
        t, i = np.nonzero(self.held_states[1:])  # x_0 does not change
        self.states, self.controls = (t + 1, i), np.nonzero(self.held & self.banded)
        self.bins = [
            (j, real_rows(problem.state_samples, stop)) for j, stop in enumerate(problem.state_stop.T) if stop.any()
        ]
        T, linear = problem.horizon, problem.linear
        self.A = np.zeros((T + 1, n, n))
        self.A[:-1] = linear.A
        self.breaks = break_times(linear.A, T, PIECE_GROWTH)
        self.starts = len(self.breaks) * n
        self.on_x = self.starts + len(self.states[0]) + sum(len(rows) for _, rows in self.bins)
        self.count = self.on_x + len(self.controls[0])

    def solve(self) -> tuple[Array, Array] | None:
        """Return the changes of states and controls; None if rows contradict each other, or growth hides them."""
        problem, x, u, breaks, held = self.problem, self.x, self.u, self.breaks, self.controls
        B, forced, removed = problem.linear.B, np.zeros_like(x), np.zeros_like(u)
        forced[1:] = problem.linear.successors(to_long_double(x), to_long_double(u)) - x[1:]
        if self.banded.any():
            removed = np.where(self.banded, self._project_bins(u[..., None])[..., 0] - u, 0.0)
        if not self.count:
            forced[1:] += times_vectors(B, removed)
            return self._simulate(forced, False), removed
        rows, wanted = self._rows()
        costates = self._simulate(rows, True) if self.on_x else rows  # LAPACK takes no empty arrays
        of_starts = costates[breaks].reshape(self.starts, self.on_x)
        costates[breaks] = -np.eye(self.starts, self.on_x).reshape(len(breaks), x.shape[1], self.on_x)
        responses = np.einsum("ij,tik->tjk" if B.ndim == 2 else "tij,tik->tjk", B, costates[1:])
        of_x, of_u = (np.where(unit > 0, unit, 1.0) ** 2 for unit in (np.abs(signal).max(0) for signal in (x, u)))
        starts = np.tile(of_x, len(breaks))[:, None] * of_starts
        gram = self._gram(responses, of_u)
        gram[: self.on_x, : self.on_x] += of_starts.T @ starts
        missed = np.append(wanted - self._row_values(costates, forced), np.zeros(len(held[0])))
        missed -= np.append(self._row_values(responses, removed), removed[held])
        scale = 1.0 / np.sqrt(np.where(gram.diagonal() > 0, gram.diagonal(), 1.0))
        lower, info = lapack.dpotrf(gram * scale * scale[:, None], lower=1)
        if info:
            return None
        weights = scale * lapack.dpotrs(lower, scale * missed, lower=1)[0]
        along = responses @ weights[: self.on_x]
        along[held] += weights[self.on_x :]
        du = removed + of_u * self._project_bins(along[..., None])[..., 0]
        forced[1:] += times_vectors(B, du)
        ends = forced[breaks]
        forced[breaks] = (starts @ weights[: self.on_x]).reshape(ends.shape)
        dx = self._simulate(forced, False)
        reached = self._row_values(rows, dx)
        reached[: self.starts] -= ends.ravel()
        left = np.append(wanted - reached, -du[held])
        if not np.linalg.norm(left) <= CONTRACTION * np.linalg.norm(missed):
            return None
        return dx, du

    def _gram(self, responses: Array, of_u: Array) -> Array:
        """Return what the least change of controls for one row adds to each row, (rows, rows)."""
        t, j = self.controls
        passed = of_u[:, None] * self._project_bins(responses)
        pulse = np.zeros((*self.u.shape, 1))
        pulse[0] = 1.0
        pulses = of_u * self._project_bins(pulse)[..., 0]  # a later one is shifted: what leaves at the end comes in
        of_controls = np.where(j[:, None] == j, pulses[(t[:, None] - t) % len(pulses), j], 0.0)
        on_states = np.tensordot(responses, passed, axes=((0, 1), (0, 1)))
        return np.block([[on_states, passed[t, j].T], [passed[t, j], of_controls]])

    @staticmethod
    def _row_values(rows: Array, signal: Array) -> Array:
        """Return the values of rows, (times, components, rows), of a signal."""
        return signal.ravel() @ rows.reshape(signal.size, -1)

    def _rows(self) -> tuple[Array, Array]:
        """Return the coefficients of the rows on changes of states, (T+1, n, rows), and their wanted values."""
        rows, first, breaks = np.zeros((*self.x.shape, self.on_x)), self.starts, self.breaks
        n = self.x.shape[1]
        of_starts = rows[..., :first].reshape(*self.x.shape, len(breaks), n)
        at = np.arange(len(breaks))
        of_starts[breaks, :, at] = np.eye(n)
        of_starts[breaks - 1, :, at] -= self.A[breaks - 1].swapaxes(1, 2)
        rows[..., :first] = of_starts.reshape(*self.x.shape, first)
        rows[*self.states, first + np.arange(len(self.states[0]))] = 1.0
        wanted = np.zeros(self.on_x)
        first += len(self.states[0])
        for j, waves in self.bins:
            last = first + len(waves)
            rows[: waves.shape[1], j, first:last] = waves.T
            wanted[first:last] = -waves @ self.x[: waves.shape[1], j]
            first = last
        return rows, wanted

    def _project_bins(self, signals: Array) -> Array:
        """Return signals (T, m, k) without stopped bins, and without changes of other held controls."""
        passed = np.where((self.held & ~self.banded)[..., None], 0.0, signals)
        if self.banded.any():
            spectra = fft.rfft(passed[:, self.banded], axis=0)
            spectra[self.stop[:, self.banded]] = 0.0
            passed[:, self.banded] = fft.irfft(spectra, len(passed), axis=0)
        return passed

    def _simulate(self, right: Array, transposed: bool) -> Array:
        """Return x_{t+1} = A_t x_t + right_{t+1}, or p_t = A_t'p_{t+1} + right_t, for (T+1, n) or (T+1, n, k)."""
        return simulate(self.A, self.breaks, right, transposed)


def break_times(A: Array, horizon: int, growth: float) -> Indices:
    """Return the times at which a simulation begins anew: the states grow by no more than ``growth`` between them."""
    if A.ndim == 2:
        steps, power = 1, A
        while steps < horizon and np.abs(power).max() <= growth:
            steps, power = 2 * steps, power @ power
        first = max(steps // 2, 1) if steps < horizon else horizon
        return np.arange(first, horizon, first)
    times, product = list[int](), np.eye(A.shape[1])
    for t in range(horizon - 1):
        product = A[t] @ product
        if np.abs(product).max() > growth:
            times.append(t + 1)
            product = np.eye(A.shape[1])
    return np.array(times, dtype=np.intp)


def _at_bounds(tube: Box, signal: Array) -> Mask:
    """Return which values are at a bound, or next to it."""
    near = HELD_DISTANCE * np.abs(signal).max(0)
    return (tube.upper - signal <= near) | (signal - tube.lower <= near)
