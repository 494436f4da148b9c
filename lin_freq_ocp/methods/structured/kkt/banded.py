"""The loops over stages by NumPy and LAPACK. What they compute: recursions.py.

A single solution comes from the LU factors of the banded matrix of all stages; its unknowns are, stage by stage, lam_t,
x_t and w_t, where lam_0 = lam0 and lam_t = eta_{t-1}. Many responses at once come from the Riccati recursion.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from lin_freq_ocp.arrays import Array, Indices, Mask

PIVOT = 1e-14
"""Least pivot relative to the diagonal entry before elimination: below it there is rounding only."""


def banded_matrix(A: Array, B: Array, Phi: Array, fixed: Mask) -> Array:
    """Return the matrix of all stages as LAPACK stores it for an LU factorisation, with 2n + k - 1 diagonals a side."""
    stages, n, k = B.shape
    nz, size = n + k, 2 * n + k
    band = size - 1
    entries = np.zeros((stages, size, 3 * band + 1))  # column by column; row i of a column j is at 2 band + i - j
    for j in range(nz):
        entries[:, n + j, 2 * band - j : 2 * band - j + nz] = Phi[:, :, j]
    for j in range(n):
        entries[:, j, 2 * band + n] = 1.0
        entries[:, n + j, 2 * band - n] = 1.0
    AB = -np.concatenate([A, B], axis=2)[:-1]
    for j in range(nz):
        first = 2 * band + size - n - j
        entries[:-1, n + j, first : first + n] = AB[:, :, j]
    for i in range(n):
        first = 2 * band + n - size - i
        entries[1:, i, first : first + nz] = AB[:, i, :]
    for i in np.flatnonzero(~fixed):
        entries[0, i, 2 * band], entries[0, i, 2 * band + n], entries[0, n + i, 2 * band - n] = 1.0, 0.0, 0.0
    return entries.reshape(stages * size, -1).T


def solve_positive(S: Array, right: Array) -> Array:
    """Return S^-1 right for a positive semidefinite matrix; a pivot below the rounding is raised."""
    _, found, info = lapack.dposv(S, right, lower=1)
    if info:
        diagonal = np.diag(S)
        floor = np.where(diagonal > 0, diagonal, diagonal.max(initial=0.0) or 1.0) * PIVOT
        while info:
            _, found, info = lapack.dposv(S + np.diag(floor), right, lower=1)
            floor *= 10
    return found


class BandedRegulator:
    """LU factors of all stages, and the gains of the Riccati recursion when they are first needed."""

    def __init__(self, A: Array, B: Array, Phi: Array, fixed: Mask):
        """Factor the stages."""
        self._A, self._B, self._Phi, self._fixed = A, B, Phi, fixed
        self._band = 2 * A.shape[1] + B.shape[2] - 1
        matrix = banded_matrix(A, B, Phi, fixed)
        self._lu, self._pivots, info = lapack.dgbtrf(matrix, self._band, self._band)
        if info > 0:
            self._lu, self._pivots, _ = lapack.dgbtrf(self._raised(matrix), self._band, self._band)

    def _raised(self, matrix: Array) -> Array:
        """Return the matrix with diagonal entries of y raised to what rounding leaves of the others."""
        n = self._A.shape[1]
        diagonal = matrix.T.reshape(len(self._A), -1, 3 * self._band + 1)[:, n:, 2 * self._band]
        diagonal += PIVOT * np.where(diagonal > 0, diagonal, diagonal.max(initial=0.0) or 1.0)
        return matrix

    def solve(self, r: Array, c: Array, x0: Array) -> tuple[Array, Array, Array]:
        """Return y, eta and lam0."""
        stages, n = c.shape
        right = np.empty((stages, 2 * n + self._B.shape[2]))
        right[0, :n], right[1:, :n], right[:, n:] = x0, c[:-1], -r
        found, _ = lapack.dgbtrs(self._lu, self._band, self._band, right.ravel(), self._pivots)
        found = found.reshape(right.shape)
        eta = np.zeros((stages, n))
        eta[:-1] = found[1:, :n]
        return found[:, n:].copy(), eta, np.where(self._fixed, found[0, :n], 0.0)

    def _gains(self) -> None:
        """Fill K, S and A_c, and P_0."""
        A, B, Phi = self._A, self._B, self._Phi
        stages, n, k = B.shape
        P = np.zeros((n, n))
        self._K, self._S = np.empty((stages, k, n)), np.empty((stages, k, k))
        for t in range(stages - 1, -1, -1):
            BP = B[t].T @ P
            self._S[t] = Phi[t, n:, n:] + BP @ B[t]
            self._K[t] = -solve_positive(self._S[t], Phi[t, n:, :n] + BP @ A[t])
            closed = A[t] + B[t] @ self._K[t]
            root = np.concatenate([np.eye(n), self._K[t]])
            P = root.T @ Phi[t] @ root + closed.T @ P @ closed
            P = (P + P.T) / 2
        self._P0 = P
        self._Ac = A + B @ self._K

    def responses(self, channels: Indices, R: Array, E: Array) -> tuple[Array, Array]:
        """Return the responses on the channels, and x_T."""
        if not hasattr(self, "_P0"):
            self._gains()
        A, B = self._A, self._B
        stages, n, k = B.shape
        r = np.zeros((stages, n + k, R.shape[2]))
        r[:, channels] = R
        r[-1, :n] += E
        p, w, y = np.zeros((n, R.shape[2])), np.empty((stages, k, R.shape[2])), np.empty_like(r)
        for t in range(stages - 1, -1, -1):
            w[t] = -solve_positive(self._S[t], r[t, n:] + B[t].T @ p)
            p = r[t, :n] + self._K[t].T @ r[t, n:] + self._Ac[t].T @ p
        free = np.flatnonzero(~self._fixed)
        x = np.zeros_like(p)
        x[free] = -solve_positive(self._P0[np.ix_(free, free)], p[free]) if len(free) else 0.0
        for t in range(stages):
            y[t, :n] = x
            y[t, n:] = self._K[t] @ x + w[t]
            x = A[t] @ x + B[t] @ y[t, n:]
        return y[:, channels], y[-1, :n].copy()


class BandedLoops:
    """All loops by NumPy and LAPACK."""

    def factor(self, A: Array, B: Array, Phi: Array, fixed: Mask) -> BandedRegulator:
        """Factor the stages."""
        return BandedRegulator(A, B, Phi, fixed)

    def gram(self, H: Array, G: Array, weights: Array, points: Array, cones: tuple[int, ...]) -> Array:
        """Return H + G'W^-2 G."""
        linear = G.shape[1] - sum(cones)
        rows = G[:, :linear]
        out = H + rows.swapaxes(1, 2) @ (weights[:, :linear, None] * rows)
        first = linear
        for weight, size in zip(weights[:, linear:].T, cones, strict=True):
            rows, w = G[:, first : first + size].copy(), points[:, first - linear : first - linear + size].copy()
            w[:, 1:] *= -1
            q = np.einsum("tp,tpi->ti", w, rows)
            signed = rows.copy()
            signed[:, 0] *= -1
            term = 2 * q[:, :, None] * q[:, None, :] + rows.swapaxes(1, 2) @ signed
            out += np.where(weight == 0, 0.0, weight)[:, None, None] * term
            first += size
        return out

    def forward(self, A: Array, B: Array, c: Array, breaks: Indices, starts: Array, y: Array) -> Array:
        """Write the states of y, and return the ends."""
        n = A.shape[1]
        ends, restart = np.empty_like(starts), {int(t): i for i, t in enumerate(breaks)}
        for t in range(len(A) - 1):
            y[t + 1, :n] = A[t] @ y[t, :n] + B[t] @ y[t, n:] + c[t]
            if t + 1 in restart:
                ends[restart[t + 1]] = y[t + 1, :n]
                y[t + 1, :n] = starts[restart[t + 1]]
        return ends

    def backward(
        self, A: Array, B: Array, gradient: Array, breaks: Indices, prices: Array
    ) -> tuple[Array, Array, Array]:
        """Return the costates, and the gradients in w and in the starts."""
        n = A.shape[1]
        costates, gw, gstarts = np.empty((len(A), n)), np.empty((len(A), B.shape[2])), np.empty_like(prices)
        p, restart = np.zeros(n), {int(t): i for i, t in enumerate(breaks)}
        for t in range(len(A) - 1, -1, -1):
            gw[t] = gradient[t, n:] + B[t].T @ p
            p = gradient[t, :n] + A[t].T @ p
            if t in restart:
                gstarts[restart[t]] = p
                p = -prices[restart[t]]
            costates[t] = p
        return costates, gw, gstarts

    def columns(
        self, A: Array, B: Array, Phi: Array, breaks: Indices, starts: Array, W: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Return the gradients in w and in the starts, the ends, and x_T."""
        n, m = A.shape[1], W.shape[2]
        Y, ends = np.zeros((len(A), n + W.shape[1], m)), np.empty_like(starts)
        Y[:, n:] = W
        restart = {int(t): i for i, t in enumerate(breaks)}
        for t in range(len(A) - 1):
            Y[t + 1, :n] = A[t] @ Y[t, :n] + B[t] @ W[t]
            if t + 1 in restart:
                ends[restart[t + 1]] = Y[t + 1, :n]
                Y[t + 1, :n] = starts[restart[t + 1]]
        gradient = Phi @ Y
        p, gstarts = np.zeros((n, m)), np.empty_like(starts)
        for t in range(len(A) - 1, -1, -1):
            gradient[t, n:] += B[t].T @ p
            p = gradient[t, :n] + A[t].T @ p
            if t in restart:
                gstarts[restart[t]], p = p, np.zeros((n, m))
        return gradient[:, n:].copy(), gstarts, ends, Y[-1, :n].copy()
