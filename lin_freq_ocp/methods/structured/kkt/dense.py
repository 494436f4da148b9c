"""Dense linear algebra: Cholesky factors, and sweeps for many columns, where b stages become one product of matrices.

The outputs of a block of stages are linear in its inputs. The matrix of that map is computed once, in b steps for all
blocks together, and serves any number of columns. Only one n x n product a block remains sequential. If the stages do
not fill all blocks, stages that leave x unchanged precede the first. At t = T, the identity in the place of A_T = 0
carries x_T out of the last block, and the gradient in x_T into it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from math import ceil, sqrt

import numpy as np
from scipy.linalg import blas, lapack

from lin_freq_ocp.base.arrays import Array, Indices, Mask

LEAST_SHIFT = 1e-14  # of the diagonal of ones: the first shift of a matrix that rounding errors make indefinite
PIVOT = 1e-14
"""Least pivot relative to the diagonal entry before elimination: smaller ones are rounding errors."""
CURVED = 1e-9
"""Least pivot of a strictly convex problem, relative to the curvature of the stage alone."""
NARROW = 8
"""Number of columns up to which each is solved for alone: the matrices of the blocks would cost more."""
CALL = 500
"""The overhead of a call of a product of dense matrices, in multiplications a column; measured."""
ROWS = 512
"""Rows of N in one product of a Gram matrix: enough for fast products, few enough for the cache."""


class Cholesky:
    """M = D^-1 L L' D^-1, with M shifted until it is definite; it reads the lower triangle of M, and overwrites M.

    The factor of a matrix with infinite or undefined entries also has such entries. ``definite`` says that the least
    shift sufficed.
    """

    def __init__(self, M: Array):
        self._scale = 1 / np.sqrt(np.maximum(np.diag(M), np.finfo(float).tiny))
        M *= self._scale
        M *= self._scale[:, None]
        shift = LEAST_SHIFT
        while True:
            shifted = M.copy(order="C")
            shifted.flat[:: len(M) + 1] += shift
            self._upper, failed = lapack.dpotrf(shifted.T, lower=0, overwrite_a=1, clean=0)  # L'
            if not failed or not np.isfinite(shift):
                self.definite = not failed and shift == LEAST_SHIFT
                break
            shift *= 100

    def solve(self, right: Array) -> Array:
        """Return M^-1 right, for right (rows,) or (rows, k)."""
        if not right.size:
            return right.copy()
        scale = self._scale if right.ndim == 1 else self._scale[:, None]
        return scale * lapack.dpotrs(self._upper, scale * right, lower=0)[0]

    def rooted(self, rows: Array) -> Array:
        """Return rows R with R R' = M, (count, rows of M)."""
        return blas.dtrmm(1.0, self._upper, (rows / self._scale).T, overwrite_b=1).T

    def whitened(self, right: Array) -> Array:
        """Return L^-1 D right, (rows, k): its Gram matrix is right' M^-1 right."""
        if not right.size:
            return right.copy()
        return blas.dtrsm(1.0, self._upper, self._scale[:, None] * right, trans_a=1)


def gram(rows: Array, total: Array | None = None) -> Array:
    """Return the lower triangle of rows'rows, added to that of a total, which is overwritten."""
    if total is None:
        total = np.zeros((rows.shape[1], rows.shape[1]))
    return blas.dsyrk(1.0, rows.T, beta=1.0, c=total.T, overwrite_c=1).T if rows.size else total


class Regulator(ABC):
    """The factored stages (recursions.py); many responses at once are computed by blocks of stages."""

    _closed: RegulatorMap | None = None

    @abstractmethod
    def solve(self, r: Array, c: Array, x0: Array) -> tuple[Array, Array, Array]:
        """Return y (T+1, nz), eta (T+1, n) with eta_T = 0, and lam0 (n,).

        r is (T+1, nz), c (T+1, n) with c_T = 0, x0 (n,) with zero where x_0 is free.
        """

    @abstractmethod
    def gains(self) -> Gains:
        """Return the gains and factors of the Riccati recursion."""

    def responses(self, channels: Indices, R: Array, E: Array) -> tuple[Array, Array]:
        """Return the entries ``channels`` of y, (T+1, channels, m), and x_T, (n, m), for m gradients; c = 0, x0 = 0.

        R (T+1, channels, m) are gradients on these entries, each of them named once; E (n, m) is added on x_T.
        """
        if R.shape[2] <= NARROW:
            return self._solve_one_by_one(channels, R, E)
        return self._closed_loop(channels).responses(R, E)

    def gram(self, channels: Indices, R: Array, E: Array) -> Array:
        """Return the lower triangle of minus the gradients times their responses, (m, m), positive semidefinite."""
        if R.shape[2] <= NARROW:
            Y, X = self._solve_one_by_one(channels, R, E)
            return -(np.tensordot(R, Y, ((0, 1), (0, 1))) + E.T @ X)
        return self._closed_loop(channels).gram(R, E)

    def _closed_loop(self, channels: Indices) -> RegulatorMap:
        if self._closed is None or not np.array_equal(self._closed.channels, channels):
            self._closed = RegulatorMap(self.gains(), channels)
        return self._closed

    def _solve_one_by_one(self, channels: Indices, R: Array, E: Array) -> tuple[Array, Array]:
        gains = self.gains()
        stages, n, k = gains.B.shape
        Y, X = np.empty_like(R), np.empty_like(E)
        for j in range(R.shape[2]):
            r = np.zeros((stages, n + k))
            r[:, channels] = R[:, :, j]
            r[-1, :n] += E[:, j]
            y, _, _ = self.solve(r, np.zeros((stages, n)), np.zeros(n))
            Y[:, :, j], X[:, j] = y[:, channels], y[-1, :n]
        return Y, X


@dataclass(frozen=True, eq=False)
class Gains:
    """Gains and factors of the Riccati recursion."""

    B: Array  # (T+1, n, k)
    K: Array  # (T+1, k, n): w = K x + ...
    L: Array  # (T+1, k, k): S = L L'
    Ac: Array  # (T+1, n, n): A + B K
    P0: Array  # (n, n): the cost-to-go of x_0
    fixed: Mask  # (n,): which entries of x_0 are given


class RegulatorMap:
    """A factored regulator as a map of gradients on ``channels`` to the solution there, c = 0.

    The map is -N'N: the sweep from the end backwards gives N_t = U_t (r_w + B'p_{t+1}) in the entries of w that are
    driven, where U_t'U_t is their block of S_t^-1, and a last row for free entries of x_0.
    """

    def __init__(self, gains: Gains, channels: Indices):
        """Compute the matrices of the blocks of the backward sweep."""
        self._gains, self.channels = gains, channels
        self._free_cost = Cholesky(gains.P0[np.ix_(~gains.fixed, ~gains.fixed)])
        B, K = gains.B, gains.K
        stages, n, k = B.shape
        count = len(channels)
        self._entries = np.zeros((n + k, count))
        self._entries[channels, np.arange(count)] = 1.0
        driven = np.flatnonzero(self._entries[n:].any(axis=1) | B.any(axis=(0, 1)))
        root = np.linalg.inv(gains.L)
        of_w, of_x, U, self._W = self._entries[n:], self._entries[:n], root[:, :, driven], -root.swapaxes(1, 2)
        if len(driven) < k:
            Q, U = np.linalg.qr(U)
            self._W = self._W @ Q
        self._b = b = min(stages, block_length(n, sqrt(max(1, len(driven) * count))))
        self._times = np.arange(-(-stages % b), stages).reshape(-1, b)
        down = np.concatenate([U @ B[:, :, driven].swapaxes(1, 2), carry_last_state(gains.Ac).swapaxes(1, 2)], axis=1)
        inputs = np.concatenate([U @ of_w[driven], of_x + K.swapaxes(1, 2) @ of_w], axis=1)
        self._N, self._p = self._lift(down, inputs, len(driven), range(b)[::-1])
        self._inputs: Array | None = None

    def _lift(self, step: Array, inputs: Array, outputs: int, order: range) -> tuple[Array, Array]:
        """Return the maps from the state before a block, and its inputs, to all its outputs and the state after it."""
        n, each = step.shape[2], inputs.shape[2]
        blocks, b = self._times.shape
        filling = np.concatenate([np.zeros((outputs, n)), np.eye(n)])
        step, inputs = (
            pad_blocks(step, self._times, filling),
            pad_blocks(inputs, self._times, np.zeros(inputs.shape[1:])),
        )
        state, maps = np.zeros((blocks, n, n + b * each)), np.empty((blocks, b, outputs, n + b * each))
        state[:, :, :n] = np.eye(n)
        for s in order:
            both = step[:, s] @ state
            both[:, :, n + s * each : n + (s + 1) * each] += inputs[:, s]
            maps[:, s], state = both[:, :outputs], both[:, outputs:]
        return maps.reshape(blocks, b * outputs, n + b * each), state.copy()

    def _backward(self, R: Array, E: Array) -> tuple[Array, Array]:
        """Return the inputs of each block, (blocks, n + b channels, m), and p_0, (n, m)."""
        n, m = E.shape
        blocks, size = self._p.shape[::2]
        if self._inputs is None or self._inputs.shape[2] != m:
            self._inputs = np.zeros((blocks, size, m))
        inputs, first, count = self._inputs, self._b - (self._times.size - len(R)), R.shape[1]
        inputs[0, size - first * count :] = R[:first].reshape(first * count, m)
        inputs[1:, n:] = R[first:].reshape(blocks - 1, size - n, m)
        p = E
        for i in range(blocks - 1, -1, -1):
            inputs[i, :n] = p
            p = self._p[i] @ inputs[i]
        return inputs, p

    def gram(self, R: Array, E: Array) -> Array:
        """Return the lower triangle of N'N, (m, m), for gradients R (T+1, channels, m), and E (n, m) on x_T."""
        inputs, p = self._backward(R, E)
        total = gram(self._free_cost.whitened(p[~self._gains.fixed]))
        per = -(-ROWS // max(1, self._N.shape[1]))
        for first in range(0, len(inputs), per):
            part = slice(first, first + per)
            total = gram((self._N[part] @ inputs[part]).reshape(-1, inputs.shape[2]), total)
        return total

    def responses(self, R: Array, E: Array) -> tuple[Array, Array]:
        """Return the solution on the channels, and x_T, for gradients R (T+1, channels, m), and E (n, m) on x_T."""
        of_y, of_x = self._upward
        inputs, p = self._backward(R, E)
        n, m = E.shape
        x, free = np.zeros((n, m)), ~self._gains.fixed
        x[free] = -self._free_cost.solve(p[free])
        up = np.empty((len(inputs), of_x.shape[2], m))
        np.matmul(self._N, inputs, out=up[:, n:])
        for i in range(len(up)):
            up[i, :n] = x
            x = of_x[i] @ up[i]
        return (of_y @ up).reshape(self._times.size, -1, m)[self._times.size - len(R) :], x

    @cached_property
    def _upward(self) -> tuple[Array, Array]:
        """Return the matrices of the blocks of the forward sweep, whose inputs are those of N."""
        B, K, W = self._gains.B, self._gains.K, self._W
        of_w, of_x = self._entries[B.shape[1] :].T, self._entries[: B.shape[1]].T
        up = np.concatenate([of_x + of_w @ K, carry_last_state(self._gains.Ac)], axis=1)
        return self._lift(up, np.concatenate([of_w @ W, B @ W], axis=1), len(of_w), range(self._b))


class OpenLoop:
    """The gradient of 1/2 y'Phi y in w and in the restarts as a linear map; x_0 = 0.

    The states start anew at ``breaks``, (K,) increasing times within 1 .. T.
    """

    def __init__(self, A: Array, B: Array, Phi: Array, breaks: Indices):
        """Compute the matrices of the blocks; no block contains a break."""
        stages, n, k = B.shape
        self._times, self._first = self._partition(np.concatenate([[0], breaks, [stages]]), n, k)
        blocks, b = self._times.shape
        AB = pad_blocks(np.concatenate([carry_last_state(A), B], axis=2), self._times, np.eye(n, n + k))
        Phi = pad_blocks(Phi, self._times, np.zeros((n + k, n + k)))
        Y, x = np.zeros((blocks, b, n + k, n + b * k)), np.zeros((blocks, n, n + b * k))
        x[:, :, :n] = np.eye(n)
        for s in range(b):
            Y[:, s, :n] = x
            Y[:, s, n:, n + s * k : n + (s + 1) * k] = np.eye(k)
            x = AB[:, s] @ Y[:, s]
        gradient, p = Phi @ Y, np.zeros((blocks, n, 2 * n + b * k))
        p[:, :, n + b * k :] = np.eye(n)
        gw = np.empty((blocks, b, k, 2 * n + b * k))
        for s in range(b - 1, -1, -1):
            both = AB[:, s].swapaxes(1, 2) @ p
            both[:, :, : n + b * k] += gradient[:, s]
            gw[:, s], p = both[:, n:], both[:, :n]
        self._x, self._p, self._gw = x.copy(), p.copy(), gw.reshape(blocks, b * k, 2 * n + b * k)
        self._inputs: Array | None = None

    @staticmethod
    def _partition(bounds: Indices, n: int, k: int) -> tuple[Indices, Indices]:
        """Return the times of the blocks, and the first block of every segment between two bounds."""
        sizes = np.diff(bounds)
        lengths = np.arange(1, min(block_length(n, k), int(sizes.max())) + 1)
        counts = -(-sizes // lengths[:, None])
        best = int(np.argmin(counts.sum(axis=1) * ((2 * n + lengths * k) ** 2 + CALL)))
        b, counts = int(lengths[best]), counts[best]
        first = np.concatenate([[0], np.cumsum(counts)[:-1]])
        times = np.full(int(counts.sum()) * b, -1)
        shift = np.repeat((first + counts) * b - bounds[1:], sizes)
        times[np.arange(bounds[-1]) + shift] = np.arange(bounds[-1])
        return times.reshape(-1, b), first

    def columns(self, starts: Array, W: Array) -> tuple[Array, Array, Array, Array]:
        """Return the gradients in w (T+1, k, m) and the starts (K, n, m), the ends (K, n, m), and x_T (n, m).

        Column j has w = W[:, :, j], (T+1, k, m), and restarts from starts[:, :, j], (K, n, m). Its end at a break is
        the state there before it is replaced.
        """
        n, (_, k, m) = self._x.shape[1], W.shape
        blocks, _, size = self._p.shape
        if self._inputs is None or self._inputs.shape[2] != m:
            self._inputs = np.zeros((blocks, size, m))
        inputs, present = self._inputs, self._times >= 0
        of_w = inputs[:, n:-n].reshape(*present.shape, k, m)
        of_w[present] = W
        segment = {int(block): i for i, block in enumerate(self._first[1:])}
        gstarts, ends = np.empty_like(starts), np.empty_like(starts)
        x, p = np.zeros((n, m)), np.zeros((n, m))
        for i in range(blocks):
            if i in segment:
                ends[segment[i]], x = x, starts[segment[i]]
            inputs[i, :n] = x
            x = self._x[i] @ inputs[i, :-n]
        for i in range(blocks - 1, -1, -1):
            inputs[i, -n:] = p
            p = self._p[i] @ inputs[i]
            if i in segment:
                gstarts[segment[i]], p = p, np.zeros((n, m))
        gw = (self._gw @ inputs).reshape(*present.shape, k, m)
        return gw[present], gstarts, ends, x


def block_length(n: int, inputs: float) -> int:
    """Return the number of stages a block that makes sweeps cheapest, by the inputs and outputs a stage."""
    return ceil(sqrt(4 * n * n + CALL) / inputs)


def pad_blocks(values: Array, times: Indices, filling: Array) -> Array:
    """Return values[times], (blocks, b, ...), with the filling where times is negative."""
    blocks = values[times]
    blocks[times < 0] = filling
    return blocks


def carry_last_state(A: Array) -> Array:
    """Return A (T+1, n, n) with the identity as A_T."""
    return np.concatenate([A[:-1], np.eye(A.shape[1])[None]])
