"""The reduced system of the null-space solver, M v + E'nu = r, E v - C nu = e: dense, or by conjugate gradients.

Very large weights would swamp the digits of the others in M. So weights are clipped, and the rest of a large weight
becomes a row with the compliance 1/weight. All rows are B = (Y, E), where Y are the directions of these weights, with
the compliance (D^-1, C).

A weight on a direction a of y_t counts as a'S a, where S is the covariance of y_t under white noise in the stopped
coefficients, relative to the weight of the control: a weight on a position hardly couples free and stopped
coefficients, a weight on the control does. White noise in all coefficients has a small share in S, so that very large
weights on a state do not swamp the digits of the others either.

On long horizons, projected conjugate gradients (Gould, Hribar and Nocedal, 2001; for C > 0 Dollar et al., 2006) need no
matrix larger than the unknowns times the rows B. Their preconditioner is the same system with a regulator in the place
of M, in which all coefficients are free and weights are clipped, Phi_c. The Hessian H of y'Phi_c y in all samples of u
couples the free coefficients k with the stopped ones s only as far as weights vary over time, and M_c = H_kk, while
the inverse of the regulator gives

    N' H^-1 N = (H_kk - H_ks H_ss^-1 H_sk)^-1.

If the weights are within a ratio q, both differ by 1 - ((q - 1)/(q + 1))^2 at most (Wielandt's inequality); hence the
clip. Jumps of the state, with a price of rho, stand for the starts: (starts - ends)^2 rho is added to H.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.linalg as la

from lin_freq_ocp.base.arrays import Array, Indices, times_vectors
from lin_freq_ocp.methods.structured.kkt.dense import Cholesky, OpenLoop
from lin_freq_ocp.methods.structured.kkt.null_space import NullSpace
from lin_freq_ocp.methods.structured.kkt.recursions import break_times
from lin_freq_ocp.methods.structured.kkt.system import largest

WEIGHT = 10.0  # of E'E, relative to the mean diagonal of M: of order 1, for both to keep their digits
RAISED = (1.0, 1e2, 1e4)  # factors of the weight, for an M that is definite only on the null space of the rows
COLUMNS = 128  # of M at once
CACHED_BYTES = 3e8  # of the signals of the coefficients, which are cached between steps
PROJECTIONS = 2  # on the rows: large weights magnify the error of the first
CLIP = 5.0  # of a'S a: (4/6)^2, so the approximation is within a factor of 2; 2 to 100 cost the same
LEAST_REST = 0.5  # of a weight after the clip, relative to the clip, from which its direction becomes a row
MOST_DIRECTIONS = 300  # with weights above the clip: the largest
NOISES = 4  # signals for a covariance
NOISE_GROWTH = 10.0  # of states between restarts: slower motion belongs to the free coefficients
SHARE = 1e-3  # of the noise in all coefficients: it clips weights above CLIP/SHARE times those of the control
REDUCTION = 1e-9  # of the residual in one solution, so that a second is seldom needed
MOST_ITERATIONS = 100  # 5 to 15 are common
PATIENCE = 10  # iterations without a smaller residual, after which it is rounding
JUMP_WEIGHT = 10.0  # rho relative to the weight of the control: of order 1, for both to keep their digits
BLOCK_BYTES = 3e7  # of the signals of one block: they stay in the cache
MOST_COLUMNS = 64


class DenseReduced:
    """Cholesky factors of M + rho E'E and of the Schur complement of the rows.

    A forward and a backward sweep give each column of M. Adding E'E for the rows with C = 0 does not change the
    solution, and makes M definite if only these rows determine the starts.
    """

    def __init__(self, space: NullSpace):
        self._space, self._E, self._noise = space, space.rows(), Noise(space)
        count = space.coefficients.count
        self._blocks = [slice(a, min(count, a + COLUMNS)) for a in range(0, count, COLUMNS)]
        cached = 8 * (space.horizon + 1) * space.controls * count <= CACHED_BYTES
        self._signals = [self._signals_of(block) for block in self._blocks] if cached else None

    def factor(self, Phi: Array, C: Array) -> bool:
        """Factor for Phi (T+1, nz, nz) and C (rows, rows)."""
        clipped, large = self._noise.clipped(Phi)
        space, free, E = self._space, self._space.coefficients.count, self._E
        # M column by column: a forward and a backward sweep for the coefficients, simulations for the other unknowns
        M = np.empty((space.size, space.size))
        sweeps = OpenLoop(space.A, space.B, clipped, space.breaks)
        for i, block in enumerate(self._blocks):
            W = self._signals[i] if self._signals is not None else self._signals_of(block)
            starts = np.zeros((*space.zero.shape, W.shape[2]))
            GW, of_starts, _, _ = sweeps.columns(starts, W)
            M[block, :free] = space.coefficients.analysis(GW)
            M[block, free : free + space.continuity] = of_starts.reshape(-1, W.shape[2]).T
        for i in range(free, space.size):
            M[i] = space.curvature(clipped, np.eye(1, space.size, i)[0])
            M[:free, i] = M[i, :free]
        self._exact = ~C.any(axis=1)
        exact = E[self._exact]
        size = WEIGHT * float(np.abs(np.diag(M)).sum()) / max(space.size, 1)  # no unknowns where no bin passes
        size /= 1 + float((exact * exact).sum(0).max(initial=0.0))
        for raised in RAISED:
            self._weight = raised * size
            self._M = Cholesky(M + self._weight * (exact.T @ exact))
            if self._M.definite or not len(exact):
                break
        self._rows = _Projection(self._space, large, E, C, lambda rows: self._M.solve(rows.T).T)
        return self._M.definite

    def solve(self, r: Array, e: Array) -> tuple[Array, Array]:
        """Return v and nu."""
        v = self._M.solve(r + self._weight * (self._E[self._exact].T @ e[self._exact]))
        v, nu = self._rows.project(v, self._rows.right(e))
        return v, nu[self._rows.directions :]

    def _signals_of(self, block: slice) -> Array:
        coefficients = self._space.coefficients
        return coefficients.synthesis(np.eye(block.stop - block.start, coefficients.count, block.start))


class LargeWeights(NamedTuple):
    """Directions a of y_t and their weights."""

    times: Indices
    directions: Array  # (directions, nz)
    weights: Array


class _Projection:
    """The rows B = (Y, E) on v, and the projection of a solution onto them."""

    def __init__(self, space: NullSpace, large: LargeWeights, E: Array, C: Array, inverse: Callable[[Array], Array]):
        """Factor their Schur complement; ``inverse`` gives M^-1 of rows (count, size), as rows."""
        self.directions = len(large.times)
        Y, of_y = np.empty((self.directions, space.size)), np.zeros((space.horizon + 1, space.states + space.controls))
        for row, t, direction in zip(Y, large.times, large.directions, strict=True):
            of_y[t] = direction
            row[:] = space.gradient(of_y)
            of_y[t] = 0.0
        self._B, self._C = np.concatenate([Y, E]), la.block_diag(np.diag(1 / large.weights), C)
        self._MB = inverse(self._B)
        self._schur = Cholesky(self._B @ self._MB.T + self._C)

    def right(self, e: Array) -> Array:
        """Return the right-hand sides of all rows."""
        return np.concatenate([np.zeros(self.directions), e])

    def project(self, v: Array, right: Array) -> tuple[Array, Array]:
        """Return v, nu of M v + B'nu = r, B v - C nu = right, from v = M^-1 r."""
        nu = np.zeros(len(right))
        for _ in range(PROJECTIONS if len(nu) else 0):
            more = self._schur.solve(self._B @ v - self._C @ nu - right)
            v, nu = v - more @ self._MB, nu + more
        return v, nu


class Noise:
    """For every control, the mean covariance of y under unit white noise in its coefficients."""

    def __init__(self, space: NullSpace):
        """Simulate the noise, with restarts of its own."""
        n, m, T = space.states, space.controls, space.horizon
        random, still = np.random.default_rng(0), np.zeros((T + 1, n))
        breaks = break_times(space.A, len(space.A) - 1, NOISE_GROWTH)
        starts = np.zeros((len(breaks), n))
        self._states, self._covariances = n, np.zeros((m, n + m, n + m))
        for j, banded in enumerate(space.coefficients.banded):
            noise = random.standard_normal((NOISES, T))
            for share, signals in ((1.0, space.coefficients.stopped(j, noise)), (SHARE, noise)):
                covariance = np.zeros((n + m, n + m))
                for signal in signals:
                    y = np.zeros((T + 1, n + m))
                    y[:-1, n + j] = signal
                    space.loops.forward(space.A, space.B, still, breaks, starts, y)
                    covariance += y[:-1].T @ y[:-1] / (NOISES * T)
                if not banded:  # weights on single unknowns swamp no others
                    covariance[n + j], covariance[:, n + j] = 0.0, 0.0
                self._covariances[j] += share * covariance

    def clipped(self, Phi: Array) -> tuple[Array, LargeWeights]:
        """Return Phi (T+1, nz, nz) with clipped weights, and the rest of the weights."""
        return clip(Phi, np.einsum("j,jab->ab", 1 / control_weights(Phi, self._states), self._covariances))


def control_weights(Phi: Array, n: int) -> Array:
    """Return the median weight of every control, above zero."""
    level = np.median(np.einsum("tii->ti", Phi[:-1, n:, n:]), axis=0)
    return np.maximum(level, np.finfo(float).eps * max(float(level.max()), np.finfo(float).tiny))


def clip(Phi: Array, S: Array, most: int = MOST_DIRECTIONS) -> tuple[Array, LargeWeights]:
    """Return Phi with clipped weights, and the rest of the largest ones with their directions, ``most`` at most.

    Directions are columns of Cholesky factors, the noisiest diagonal entry first, so that large weights on single
    entries, such as bounds, do not swamp the others.
    """
    rest, noise, every = Phi[:-1].copy(), np.diag(S), np.arange(len(Phi) - 1)
    times, directions, weights, limits = [every[:0]], [rest[:0, 0]], [rest[:0, 0, 0]], [rest[:0, 0, 0]]
    for _ in noise:
        diagonal = np.einsum("tii->ti", rest[every]) * noise
        every, pivot = every[diagonal.max(1) > CLIP], diagonal.argmax(1)[diagonal.max(1) > CLIP]
        columns = rest[every, :, pivot]
        weight = columns[np.arange(len(every)), pivot]
        columns = columns / weight[:, None]
        rest[every] -= weight[:, None, None] * columns[:, :, None] * columns[:, None, :]
        rest[every, pivot], rest[every, :, pivot] = 0.0, 0.0
        times.append(every)
        directions.append(columns)
        weights.append(weight)
        limits.append(np.minimum(weight, CLIP / np.einsum("ta,ab,tb->t", columns, S, columns)))
    peeled = LargeWeights(np.concatenate(times), np.concatenate(directions), np.concatenate(weights))
    limit = np.concatenate(limits)
    chosen = np.argsort(limit / peeled.weights)[:most]
    chosen = np.sort(chosen[peeled.weights[chosen] > limit[chosen] * (1 + LEAST_REST)])
    clipped_weights = peeled.weights.copy()
    clipped_weights[chosen] = limit[chosen]
    clipped = Phi.copy()
    clipped[:-1] = rest
    np.add.at(clipped, peeled.times, np.einsum("k,ka,kb->kab", clipped_weights, peeled.directions, peeled.directions))
    return clipped, LargeWeights(
        peeled.times[chosen], peeled.directions[chosen], (peeled.weights - clipped_weights)[chosen]
    )


class TwoLevel:
    """Projected conjugate gradients on the reduced system."""

    def __init__(self, space: NullSpace):
        self._space, self._E, self._noise = space, space.rows(), Noise(space)
        ends = self._E[: space.continuity + len(space.terminal)]
        self._second = SecondLevel(space, float((ends * ends).sum(0).max(initial=0.0)))
        self.iterations: list[int] = []

    def factor(self, Phi: Array, C: Array) -> bool:
        """Factor for Phi (T+1, nz, nz) and C (rows, rows)."""
        self._clipped, self._large = self._noise.clipped(Phi)
        self._second.factor(self._clipped)
        self._rows = _Projection(self._space, self._large, self._E, C, self._second.solve_many)
        return False

    def solve(self, r: Array, e: Array) -> tuple[Array, Array]:
        """Return v and nu."""
        right = self._rows.right(e)
        zero = np.zeros_like(right)
        v, nu = self._rows.project(np.zeros_like(r), right) if e.any() else (np.zeros_like(r), zero.copy())
        residual = r - self._apply(v, nu) if nu.any() else r.copy()
        target, direction, of_rows = REDUCTION * largest([r]), np.zeros_like(r), zero
        slope, least, since, iterations = 1.0, np.inf, 0, 0
        while (error := largest([residual])) > target and iterations < MOST_ITERATIONS:
            least, since = (error, iterations) if error < least else (least, since)
            if iterations - since > PATIENCE:
                break
            step, prices = self._rows.project(self._second.solve(residual), zero)
            slope, before = float(residual @ step), slope
            beta = slope / before if iterations else 0.0
            direction, of_rows = step + beta * direction, prices + beta * of_rows
            bent = self._apply(direction, of_rows)
            curvature = float(direction @ bent)
            if not (slope > 0 and curvature > 0):
                break
            v += slope / curvature * direction
            nu += slope / curvature * of_rows
            residual -= slope / curvature * bent
            iterations += 1
        self.iterations.append(iterations)
        return v, nu[self._rows.directions :]

    def _apply(self, v: Array, nu: Array) -> Array:
        """Return M v, of clipped weights, plus nu times all rows."""
        space, large = self._space, self._large
        y, _ = space.simulate(v)
        of_large, of_rows = np.split(nu, [len(large.times)])
        of_y, prices = space.price_rows(of_rows)
        of_y += times_vectors(self._clipped, y)
        np.add.at(of_y, large.times, of_large[:, None] * large.directions)
        return space.gradient(of_y, prices)


class SecondLevel:
    """The clipped regulator of a space, restricted to v."""

    def __init__(self, space: NullSpace, height: float):
        self._space, n, m, T = space, space.states, space.controls, space.horizon
        self._height = height  # largest squared column of the rows of starts and x_T
        per = -(-n // m)  # stages for a jump, of m components each
        jumps = np.zeros(T + 1, dtype=np.intp)
        jumps[space.breaks] = per
        self._at = np.arange(T + 1) + np.cumsum(jumps)
        self._starts = self._at[space.breaks]
        stages = T + 1 + per * len(space.breaks)
        self._jumps = np.setdiff1d(np.arange(stages), self._at)
        self._A, self._B = np.tile(np.eye(n), (stages, 1, 1)), np.zeros((stages, n, m))
        self._A[self._at], self._B[self._at] = space.A, space.B
        for i in range(n):
            self._B[self._starts - per + i // m, i, i % m] = 1.0
        self._still = np.zeros((stages, n))
        self._entries = np.arange(n + m) if len(space.breaks) or len(space.free) else np.arange(n, n + m)
        per_column = 8 * stages * len(self._entries)
        self._block = int(np.clip(BLOCK_BYTES / per_column, 8, MOST_COLUMNS))

    def factor(self, clipped: Array) -> None:
        """Factor the regulator of clipped weights (T+1, nz, nz)."""
        space, n, m = self._space, self._space.states, self._space.controls
        clipped, level = clipped.copy(), float(control_weights(clipped, n).mean())
        rho = JUMP_WEIGHT * level / (1 + self._height)
        clipped[-1, space.terminal, space.terminal] += rho
        expanded = np.zeros((len(self._A), n + m, n + m))
        expanded[self._at] = clipped
        expanded[self._jumps[:, None], np.arange(n, n + m), np.arange(n, n + m)] = rho
        self._regulator = space.loops.factor(self._A, self._B, expanded, space.fixed)

    def solve(self, r: Array) -> Array:
        """Return the approximate M^-1 r."""
        space, n, count = self._space, self._space.states, self._space.coefficients.count
        gradient = np.zeros((len(self._A), n + space.controls))
        gradient[self._at, n:] = -space.coefficients.synthesis(r[None, :count])[:, :, 0]
        starts, first = np.split(-r[count:], [space.continuity])
        gradient[self._starts, :n] = starts.reshape(-1, n)
        gradient[0, space.free] += first
        y, _, _ = self._regulator.solve(gradient, self._still, self._still[0])
        z = space.coefficients.analysis(y[self._at, n:, None])[0]
        return np.concatenate([z, y[self._starts, :n].ravel(), y[0, space.free]])

    def solve_many(self, rows: Array) -> Array:
        """Return the approximate M^-1 of rows (count, size), as rows."""
        space, n, count = self._space, self._space.states, self._space.coefficients.count
        solutions = np.empty_like(rows)
        controls, states = slice(-space.controls, None), slice(0, n)
        for a in range(0, len(rows), self._block):
            part = rows[a : a + self._block]
            R = np.zeros((len(self._A), len(self._entries), len(part)))
            R[self._at, controls] = space.coefficients.synthesis(part[:, :count])
            if len(self._entries) > space.controls:
                R[self._starts, states] = part[:, count : count + space.continuity].T.reshape(-1, n, len(part))
                R[0, space.free] += part[:, count + space.continuity :].T
            Y, _ = self._regulator.responses(self._entries, R, np.zeros((n, len(part))))
            solution = solutions[a : a + self._block]
            solution[:, :count] = -space.coefficients.analysis(Y[self._at, controls])
            if len(self._entries) > space.controls:
                solution[:, count : count + space.continuity] = -Y[self._starts, states].reshape(-1, len(part)).T
                solution[:, count + space.continuity :] = -Y[0, space.free].T
        return solutions
