"""A trajectory near a given one that satisfies every constraint, by the least change of the controls.

Values of states and controls at a bound are held, and stopped bins are zero. Residuals of the dynamics move the states;
held states and stopped bins of states are the rows of a small dense system for the change of the controls. Nothing is
minimised but that change, and no multiplier is used: the cost of the repaired trajectory is that of a feasible one.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from scipy.linalg import lapack

from lin_freq_ocp.base.arrays import Array, Indices, Mask, seal, times_vectors, to_long_double
from lin_freq_ocp.methods.structured.kkt.recursions import break_times, simulate, simulation_matrix
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.program_rows import real_rows

HELD_DISTANCE = 1e-6  # of the largest value of a component: distance to a bound from which a value is held
PIECE_GROWTH = 1e6  # of states between breaks; the square of the digits that it costs must be left
CONTRACTION = 0.1  # part of the residuals that a repair may leave
MOST_ROW_ENTRIES = 1e7  # of the rows as signals


def repair_trajectory(problem: OptimalControlProblem, trajectory: Trajectory) -> Trajectory | None:
    """Return the repaired trajectory, whose states and controls are within their bounds exactly; None without one.

    Also None where a repair needs more than controls: for a frequency response, and for constraints of other kinds
    that the repaired trajectory violates.
    """
    states, controls = problem.state_tube, problem.control_tube
    if problem.response is not None:
        return None
    repair = _Repair(problem, states.project(trajectory.x), controls.project(trajectory.u))
    size = (problem.horizon + 1) * (problem.state_dim + problem.control_dim)
    change = repair.solve() if repair.count * (repair.count + size) <= MOST_ROW_ENTRIES else None
    if change is None:
        return None
    moved = repair.x + change[0], repair.u + change[1]
    x, u = states.project(moved[0]), controls.project(moved[1])
    pairs = (x != moved[0], repair.held_states), (u != moved[1], repair.held)
    if any((beyond & ~held).any() for beyond, held in pairs):
        return None
    for term in problem.terms:
        if term.hard and (term.semi_infinite is not None or term.penalty.violation(term.map.values(x, u)).any()):
            return None
    return Trajectory(seal(x), seal(u))


class _Repair:
    """The rows that a change of the controls keeps or corrects, and the projection of changes onto passed bins.

    Rows on states are the end of a piece minus the start of the next at ``breaks``, where a simulation would otherwise
    grow beyond all digits, then held states, then stopped bins. Held controls with stopped bins are rows, too; other
    held controls do not change.
    """

    def __init__(self, problem: OptimalControlProblem, x: Array, u: Array):
        self.problem, self.x, self.u, self.stop = problem, x, u, problem.control_stop
        self.held_states, self.held = _at_bounds(problem.state_tube, x), _at_bounds(problem.control_tube, u)
        self.banded, n = self.stop.any(0), x.shape[1]
        self.unmoved = self.held & ~self.banded
        t, i = np.nonzero(self.held_states[1:])  # x_0 does not change
        self.states, self.controls = (t + 1, i), np.nonzero(self.held & self.banded)
        self.bins = [
            (j, real_rows(problem.state_samples, stop)) for j, stop in enumerate(problem.state_stop.T) if stop.any()
        ]
        self.A, self.breaks, self.matrix = _pieces(problem.linear, problem.horizon)
        self.starts = len(self.breaks) * n
        self.on_x = self.starts + len(self.states[0]) + sum(len(rows) for _, rows in self.bins)
        self.count = self.on_x + len(self.controls[0])

    def solve(self) -> tuple[Array, Array] | None:
        """Return the changes of states and controls; None if rows contradict each other, or growth hides them."""
        x, u, held, removed = self.x, self.u, self.controls, np.zeros_like(self.u)
        if self.banded.any():
            removed = np.where(self.banded, self._project_bins(u[..., None])[..., 0] - u, 0.0)
        moved = self.problem.linear.successors(to_long_double(x), to_long_double(u))
        residual = (moved - x[1:]).astype(np.float64)
        dx, values = self._simulate(residual, removed, np.zeros(self.starts))
        if not self.count:
            return dx, removed
        wanted = np.zeros(self.on_x)
        for rows, (j, waves) in zip(self._bin_rows(), self.bins, strict=True):
            wanted[rows] = -waves @ x[: waves.shape[1], j]
        missed = np.append(wanted - values, -removed[held])
        responses, of_starts = self._responses()
        of_x, of_u = (np.where(unit > 0, unit, 1.0) ** 2 for unit in (np.abs(signal).max(0) for signal in (x, u)))
        starts = np.tile(of_x, len(self.breaks))[:, None] * of_starts
        gram = self._gram(responses, of_u)
        gram[: self.on_x, : self.on_x] += of_starts.T @ starts
        scale = 1.0 / np.sqrt(np.where(gram.diagonal() > 0, gram.diagonal(), 1.0))
        lower, info = lapack.dpotrf(gram * scale * scale[:, None], lower=1)
        if info:
            return None
        weights = scale * lapack.dpotrs(lower, scale * missed, lower=1)[0]
        along = responses @ weights[: self.on_x]
        along[held] += weights[self.on_x :]
        du = removed + of_u * self._project_bins(along[..., None])[..., 0]
        dx, values = self._simulate(residual, du, starts @ weights[: self.on_x])
        left = np.append(wanted - values, -du[held])
        return (dx, du) if np.linalg.norm(left) <= CONTRACTION * np.linalg.norm(missed) else None

    def _simulate(self, residual: Array, du: Array, starts: Array) -> tuple[Array, Array]:
        """Return the changes of states, with these starts at breaks, and the values of the rows on states."""
        right, breaks = np.zeros_like(self.x), self.breaks
        right[1:] = residual + times_vectors(self.problem.linear.B, du)
        ends = right[breaks]
        right[breaks] = starts.reshape(ends.shape)
        dx = simulate(self.matrix, right, False)
        ends += times_vectors(self.A[breaks - 1], dx[breaks - 1]) - dx[breaks]
        of_bins = (waves @ dx[: waves.shape[1], j] for j, waves in self.bins)
        return dx, np.concatenate([ends.ravel(), dx[self.states], *of_bins])

    def _bin_rows(self) -> Iterator[slice]:
        """Yield the places of the rows of stopped bins, component by component."""
        first = self.starts + len(self.states[0])
        for _, waves in self.bins:
            yield slice(first, first + len(waves))
            first += len(waves)

    def _responses(self) -> tuple[Array, Array]:
        """Return the responses of the rows on states to controls, (T, m, rows), and to starts, (starts, rows).

        A row on a value depends on its own piece only: one column of a simulation backwards serves a row of each piece.
        """
        breaks, B, (t, i), values = self.breaks, self.problem.linear.B, self.states, self.starts + len(self.states[0])
        (T, m), n, every = self.u.shape, self.x.shape[1], np.full(self.on_x - values, -1)
        ends = np.repeat(breaks, n) - 1
        piece = np.concatenate([np.searchsorted(breaks, ends, "right"), np.searchsorted(breaks, t, "right"), every])
        column = np.tril(piece[:, None] == piece, -1).sum(1)
        column[values:] += column[:values].max(initial=-1) + 1
        right = np.zeros((T + 1, n, int(column.max(initial=-1)) + 1))
        right[ends, :, column[: self.starts]] = self.A[breaks - 1].reshape(-1, n)
        right[t, i, column[self.starts : values]] = 1.0
        for rows, (j, waves) in zip(self._bin_rows(), self.bins, strict=True):
            right[: waves.shape[1], j, column[rows]] = waves.T
        costates = simulate(self.matrix, right, True) if right.size else right  # LAPACK takes no empty arrays

        def of_rows(of_columns: Array, pieces: Indices) -> Array:
            return of_columns[..., column] * ((pieces[:, None] == piece) | (piece < 0))[:, None]

        through = np.einsum("ij,tik->tjk" if B.ndim == 2 else "tij,tik->tjk", B, costates[1:])
        responses = of_rows(through, np.searchsorted(breaks, np.arange(T), "right"))
        responses[ends] = 0.0  # these controls change the end of their piece alone
        responses[ends, :, np.arange(self.starts)] = np.broadcast_to(B, (T, n, m))[breaks - 1].reshape(-1, m)
        of_starts = of_rows(costates[breaks], np.arange(1, len(breaks) + 1)).reshape(self.starts, self.on_x)
        of_starts[:, : self.starts] -= np.eye(self.starts)
        return responses, of_starts

    def _gram(self, responses: Array, of_u: Array) -> Array:
        """Return what the least change of controls for one row adds to each row, (rows, rows)."""
        t, j = self.controls
        passed = of_u[:, None] * self._project_bins(responses)
        pulses = of_u * np.fft.irfft(~self.stop, len(self.u), axis=0)  # a later one is shifted, and comes in at the end
        of_controls = np.where(j[:, None] == j, pulses[(t[:, None] - t) % len(pulses), j], 0.0)
        on_x, gram = self.on_x, np.empty((self.count, self.count))
        gram[:on_x, :on_x] = responses.reshape(self.u.size, on_x).T @ passed.reshape(self.u.size, on_x)
        gram[on_x:, :on_x] = passed[t, j]
        gram[:on_x, on_x:] = gram[on_x:, :on_x].T
        gram[on_x:, on_x:] = of_controls
        return gram

    def _project_bins(self, signals: Array) -> Array:
        """Return signals (T, m, k) without stopped bins, and without changes of other held controls."""
        passed = np.where(self.unmoved[..., None], 0.0, signals) if self.unmoved.any() else signals.copy()
        if self.banded.any():
            chosen = slice(None) if self.banded.all() else self.banded
            spectra = np.fft.rfft(passed[:, chosen], axis=0)
            spectra[self.stop[:, chosen]] = 0.0
            passed[:, chosen] = np.fft.irfft(spectra, len(passed), axis=0)
        return passed


@lru_cache(maxsize=4)  # the steps of a loop have the same dynamics
def _pieces(dynamics: LinearDynamics, horizon: int) -> tuple[Array, Indices, Array]:
    """Return A_t, (T+1, n, n) with zero at T, the breaks, and the matrix of the simulation between them."""
    A = np.zeros((horizon + 1, dynamics.state_dim, dynamics.state_dim))
    A[:-1] = dynamics.A
    breaks = break_times(dynamics.A, horizon, PIECE_GROWTH)
    return A, breaks, simulation_matrix(A, breaks)


def _at_bounds(tube: Box, signal: Array) -> Mask:
    """Return which values are at a bound, or next to it."""
    near = HELD_DISTANCE * np.abs(signal).max(0)
    return (tube.upper - signal <= near) | (signal - tube.lower <= near)
