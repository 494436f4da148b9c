"""A trajectory near a given one that satisfies every constraint, by the least change of controls and of a free x_0.

Values of states and controls at a bound are held, stopped bins are zero, and hard terms at their limits do not exceed
them. Residuals of the dynamics move the states; held states, stopped bins of states, and terms are the rows of a small
dense system for the change of controls and x_0. Nothing is minimised but that change, and no multiplier is used: the
cost of the repaired trajectory is that of a feasible one.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import islice

import numpy as np
from scipy.linalg import lapack

from lin_freq_ocp.base.arrays import Array, Indices, Mask, seal, times_vectors, to_long_double
from lin_freq_ocp.methods.correction import CONTRACTION, ROW_ULPS
from lin_freq_ocp.methods.structured.kkt.dense import LEAST_SHIFT
from lin_freq_ocp.methods.structured.kkt.recursions import break_times, simulate, simulation_matrix
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.terms.penalty import Penalty
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.active_rows import EPSILON
from lin_freq_ocp.program.program_rows import real_rows

HELD_DISTANCE = 1e-6  # of the largest value of a component: distance to a bound from which a value is held
# A change is refined until its rows leave this part of what they ask for: where two limits touch in a point, their rows
# are nearly parallel, and the shift of the factors hides what tells them apart
RESIDUAL_LEFT, REFINEMENTS = 1e-3, 30
PIECE_GROWTH = 1e6  # of states between breaks; the square of the digits that it costs must be left
SURPLUSES = 0.0, 1.0, 1.0  # of the excess of terms that a change corrects: norms near zero are not linear in it
MOST_ROW_ENTRIES = 1e7  # of the rows as signals, and of the slopes of a term


def repair_trajectory(problem: OptimalControlProblem, trajectory: Trajectory) -> Trajectory | None:
    """Return the repaired trajectory, whose states and controls are within their bounds exactly; None without one.

    None, too, if the repaired trajectory, repaired again, violates a term by more than ROW_ULPS rounding errors of its
    values. A semi-infinite constraint is exceeded between its points; the judge finds by how much.
    """
    states, controls = problem.state_tube, problem.control_tube
    hard = [term for term in problem.terms if term.hard and term.semi_infinite is None]
    x, u = trajectory.x, trajectory.u
    for surplus in SURPLUSES:
        repair = _Repair(problem, states.project(x), controls.project(u), surplus)
        entries = repair.count**2 + repair.on_x * (repair.x.size + repair.u.size)
        change = repair.solve() if entries <= MOST_ROW_ENTRIES else None
        if change is None:
            return None
        moved = repair.x + change[0], repair.u + change[1]
        x, u = states.project(moved[0]), controls.project(moved[1])
        if ((x != moved[0]) & ~repair.held_states).any() or ((u != moved[1]) & ~repair.held).any():
            return None
        rounded = np.abs(x)
        if hard:  # a state is no more exact than the terms of its equation
            rounded[1:] = np.maximum(rounded[1:], problem.equations.successor_sizes(x, u))
        exceeded = (term.violation(x, u) > ROW_ULPS * EPSILON * term.map.sizes(rounded, u) for term in hard)
        if not any(map(np.any, exceeded)):
            return Trajectory(seal(x), seal(u))
    return None


def _coupled_rows(
    problem: OptimalControlProblem, x: Array, u: Array, surplus: float
) -> Iterator[tuple[Array, Array, float]]:
    """Yield gradients on x and u, and the wanted change, of stopped bins of states, and of hard terms at their limits.

    The gradient of a term is that of its excess.
    """
    for j, stop in enumerate(problem.state_stop.T):
        for wave in real_rows(problem.state_samples, stop) if stop.any() else ():
            of_x = np.zeros_like(x)
            of_x[: len(wave), j] = wave
            yield of_x, np.zeros_like(u), -float(of_x[:, j] @ x[:, j])
    for term in problem.terms:
        values, penalty = term.map.values(x, u), term.penalty
        excess, dim, largest = penalty.excess(values), values.shape[1], np.abs(values).max(axis=0, initial=0.0)
        near = HELD_DISTANCE * (largest if excess.shape[1] == dim else largest.max())
        active = np.argwhere(np.isinf(penalty.weights) & (excess >= -near))
        if len(active) and dim * values.size <= MOST_ROW_ENTRIES:
            at_zero = np.abs(values) <= HELD_DISTANCE * term.map.sizes(x, u)
            slopes = _slopes(penalty, values, np.where(at_zero, 0.0, values))
            for group, k in active:
                weights = np.zeros_like(values)
                weights[group] = slopes[:, group, k]
                change = -(1 + surplus) * max(float(excess[group, k]), 0.0)
                yield *term.map.pull_back(weights, (x.shape, u.shape)), change


def _slopes(penalty: Penalty, values: Array, rounded: Array) -> Array:
    """Return the slopes of the excess by each component, (dim, groups, entries).

    They are zero by components of rounded values at which the excess has a kink: no change lowers a norm at zero. Where
    that leaves nothing, they are those at the values.
    """
    units, shape = np.eye(values.shape[1]), values.shape
    up, down, own = (
        np.array([penalty.excess_slope(v, np.broadcast_to(sign * unit, shape), 0.0) for unit in units])
        for v, sign in ((rounded, 1.0), (rounded, -1.0), (values, 1.0))
    )
    smooth = np.where(up + down > 0, 0.0, up)
    return np.where(smooth.any(axis=0), smooth, own)


class _Repair:
    """The rows that a change of the controls keeps or corrects, and the projection of changes onto passed bins.

    The first rows are the end of a piece minus the start of the next at ``breaks``, where a simulation would otherwise
    grow beyond all digits, then held states, then the coupled rows. Held controls with stopped bins are rows, too;
    other held controls do not change. The outputs of a frequency response have no breaks.
    """

    def __init__(self, problem: OptimalControlProblem, x: Array, u: Array, surplus: float):
        self.x, self.u, self.stop, (T, n) = x, u, problem.control_stop, (len(u), x.shape[1])
        self.held_states, self.held = _at_bounds(problem.state_tube, x), _at_bounds(problem.control_tube, u)
        self.free_start = ~self.held_states[0] & x.any(axis=0) & (problem.response is None)
        self.held_states[0] = False  # no row holds x_0: what is at a bound does not change
        self.banded, self.response = self.stop.any(0), problem.response
        self.unmoved, self.residual = self.held & ~self.banded, np.zeros_like(x)
        if self.response is None:
            (self.A, self.breaks, self.matrix), self.B = _pieces(problem.linear, T), problem.linear.B
            self.residual[1:] = problem.linear.successors(to_long_double(x), to_long_double(u)) - x[1:]
        else:
            self.A, self.B, self.breaks = np.zeros((1, n, n)), np.zeros((n, u.shape[1])), np.arange(0)
            self.residual += self.response.states(u) - x
        self.states, self.controls = np.nonzero(self.held_states), np.nonzero(self.held & self.banded)
        rows = list(islice(_coupled_rows(problem, x, u, surplus), int(MOST_ROW_ENTRIES / (x.size + u.size)) + 1))
        self.of_x = np.array([row[0] for row in rows]).reshape(-1, *x.shape)
        self.of_u = np.array([row[1] for row in rows]).reshape(-1, *u.shape)
        self.starts = len(self.breaks) * n
        self.values = self.starts + len(self.states[0])
        self.wanted = np.append(np.zeros(self.values), [row[2] for row in rows])
        self.on_x, self.count = len(self.wanted), len(self.wanted) + len(self.controls[0])

    def solve(self) -> tuple[Array, Array] | None:
        """Return the changes of states and controls; None if rows contradict each other, or growth hides them."""
        x, u, held = self.x, self.u, self.controls
        removed = np.where(self.banded, self._project_bins(u[..., None])[..., 0] - u, 0.0)
        dx, values = self._simulate(removed, np.zeros(len(self.free_start) + self.starts))
        missed = np.append(self.wanted - values, -removed[held])
        if not missed.any():  # whether or not any controls could change these rows
            return dx, removed
        responses, of_starts = self._responses()
        of_x, of_u = (np.where(unit > 0, unit, 1.0) ** 2 for unit in (np.abs(signal).max(0) for signal in (x, u)))
        starts = np.append(of_x * self.free_start, np.tile(of_x, len(self.breaks)))[:, None] * of_starts
        gram = self._gram(responses, of_u)
        gram[: self.on_x, : self.on_x] += of_starts.T @ starts
        scale = 1.0 / np.sqrt(np.where(gram.diagonal() > 0, gram.diagonal(), 1.0))
        # coupled rows may depend on others, such as atoms around a peak, and x_T - x_0 of a periodic response is zero
        shift = np.repeat([0.0, LEAST_SHIFT, 0.0], [self.values, len(self.of_x), len(held[0])])
        lower, info = lapack.dpotrf(gram * scale * scale[:, None] + np.diag(shift), lower=1)
        if info:
            return None
        weights, left, du = np.zeros(len(missed)), missed, removed
        for _ in range(REFINEMENTS):
            weights += scale * lapack.dpotrs(lower, scale * left, lower=1)[0]
            along = responses @ weights[: self.on_x]
            along[held] += weights[self.on_x :]
            du = removed + of_u * self._project_bins(along[..., None])[..., 0]
            dx, values = self._simulate(du, starts @ weights[: self.on_x])
            left = np.append(self.wanted - values, -du[held])
            if np.linalg.norm(left) <= RESIDUAL_LEFT * np.linalg.norm(missed):
                break
        return (dx, du) if np.linalg.norm(left) <= CONTRACTION * np.linalg.norm(missed) else None

    def _simulate(self, du: Array, starts: Array) -> tuple[Array, Array]:
        """Return the changes of states, with these starts at 0 and at breaks, and the values of the rows on states."""
        (right, breaks), (first, others) = (self.residual.copy(), self.breaks), np.split(starts, [len(self.free_start)])
        right[0] += first
        right[1:] += times_vectors(self.B, du)
        ends = right[breaks]
        right[breaks] = others.reshape(ends.shape)
        dx = simulate(self.matrix, right, False) if self.response is None else right + self.response.linear(du)
        ends += times_vectors(self.A[breaks - 1], dx[breaks - 1]) - dx[breaks]
        coupled = np.tensordot(self.of_x, dx) + np.tensordot(self.of_u, du)
        return dx, np.concatenate([ends.ravel(), dx[self.states], coupled])

    def _responses(self) -> tuple[Array, Array]:
        """Return the responses of the rows on states to controls, (T, m, rows), and to x_0 and starts."""
        breaks, B, (T, m), n = self.breaks, self.B, self.u.shape, self.x.shape[1]
        ends, right = np.repeat(breaks, n) - 1, np.zeros((T + 1, n, self.on_x))
        right[ends, :, np.arange(self.starts)] = self.A[breaks - 1].reshape(-1, n)
        right[(*self.states, np.arange(self.starts, self.values))] = 1.0
        right[..., self.values :] = np.moveaxis(self.of_x, 0, -1)
        if self.response is None:
            costates = simulate(self.matrix, right, True) if right.size else right  # LAPACK takes no empty arrays
            responses = np.einsum("ij,tik->tjk" if B.ndim == 2 else "tij,tik->tjk", B, costates[1:])
        else:
            costates, responses = right, np.zeros((T, m, self.on_x))
            for k in range(self.on_x):
                responses[..., k] = self.response.pull_back(right[..., k])
        responses[ends] = 0.0  # these controls change the end of their piece alone
        responses[ends, :, np.arange(self.starts)] = np.broadcast_to(B, (T, n, m))[breaks - 1].reshape(-1, m)
        responses[..., self.values :] += np.moveaxis(self.of_u, 0, -1)
        of_starts = costates[np.append(0, breaks)].reshape(n + self.starts, self.on_x)
        of_starts[n:, : self.starts] -= np.eye(self.starts)
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
            spectra = np.fft.rfft(passed[:, self.banded], axis=0)
            spectra[self.stop[:, self.banded]] = 0.0
            passed[:, self.banded] = np.fft.irfft(spectra, len(passed), axis=0)
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
