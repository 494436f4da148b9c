"""The loops over stages, and factors of small symmetric matrices, compiled by numba. Their interface: recursions.py.

Riccati recursion in Joseph form, from P_{T+1} = 0, p_{T+1} = 0; nothing is subtracted from P:

    S = Phi_ww + B'P B,   K = -S^-1 (Phi_wx + B'P A),   A_c = A + B K,
    P_t = Phi_xx + K'Phi_ww K + Phi_xw K + K'Phi_wx + A_c'P_{t+1} A_c,
    v = p_{t+1} + P_{t+1} c,   p_t = r_x + K'r_w + A_c'v,   w_t = K x_t - S^-1 (r_w + B'v),   eta_t = -(P x + p)_{t+1}.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.methods.structured.kkt import dense
from lin_freq_ocp.methods.structured.kkt.compilation import INDICES, REALS, WRITTEN, Kernels, jit
from lin_freq_ocp.methods.structured.kkt.dense import CURVED, PIVOT, Gains, Regulator


@jit
def cholesky(M: Array, size: int) -> None:
    """Replace the leading block by its lower factor; the largest diagonal entry sets the pivot of a zero row."""
    largest = 0.0
    for j in range(size):
        largest = max(largest, M[j, j])
    if largest == 0.0:
        largest = 1.0
    for j in range(size):
        own = M[j, j] if M[j, j] > 0.0 else largest
        pivot = M[j, j]
        for i in range(j):
            pivot -= M[j, i] * M[j, i]
        pivot = np.sqrt(max(pivot, PIVOT * own))
        M[j, j] = pivot
        for i in range(j + 1, size):
            value = M[i, j]
            for m in range(j):
                value -= M[i, m] * M[j, m]
            M[i, j] = value / pivot


@jit
def cholesky_solve(L: Array, size: int, b: Array) -> None:
    """Replace b by (L L')^-1 b."""
    for i in range(size):
        value = b[i]
        for m in range(i):
            value -= L[i, m] * b[m]
        b[i] = value / L[i, i]
    for i in range(size - 1, -1, -1):
        value = b[i]
        for m in range(i + 1, size):
            value -= L[m, i] * b[m]
        b[i] = value / L[i, i]


@jit
def gains(A: Array, B: Array, Phi: Array, P: Array, K: Array, L: Array, Ac: Array, PB: Array) -> None:
    """One stage: fill the factor of S, K and A_c from P_{t+1}."""
    n, k = B.shape
    for i in range(n):
        for j in range(k):
            value = 0.0
            for m in range(n):
                value += P[i, m] * B[m, j]
            PB[i, j] = value
    for i in range(k):
        for j in range(i + 1):
            value = Phi[n + i, n + j]
            for m in range(n):
                value += B[m, i] * PB[m, j]
            L[i, j] = value
    cholesky(L, k)
    for j in range(n):
        for i in range(k):
            value = Phi[n + i, j]
            for m in range(n):
                value += PB[m, i] * A[m, j]
            K[i, j] = -value
        cholesky_solve(L, k, K[:, j])
    for i in range(n):
        for j in range(n):
            value = A[i, j]
            for m in range(k):
                value += B[i, m] * K[m, j]
            Ac[i, j] = value


@jit
def cost_to_go(Phi: Array, P: Array, K: Array, Ac: Array, UK: Array, PA: Array, out: Array) -> None:
    """One stage: fill P_t from P_{t+1}."""
    k, n = K.shape
    for i in range(n):
        for j in range(n):
            value = 0.0
            for m in range(n):
                value += P[i, m] * Ac[m, j]
            PA[i, j] = value
    for i in range(k):
        for j in range(n):
            value = Phi[n + i, j]
            for m in range(k):
                value += Phi[n + i, n + m] * K[m, j]
            UK[i, j] = value
    for i in range(n):
        for j in range(i + 1):
            value = Phi[i, j]
            for m in range(n):
                value += Ac[m, i] * PA[m, j]
            for m in range(k):
                value += K[m, i] * UK[m, j] + Phi[n + m, i] * K[m, j]
            out[i, j] = value
            out[j, i] = value


@jit
def first_factor(P: Array, free: Indices) -> Array:
    """Return the factor of the free block of P_0."""
    P0 = np.zeros((len(free), len(free)))
    for i in range(len(free)):
        for j in range(i + 1):
            P0[i, j] = P[free[i], free[j]]
    cholesky(P0, len(free))
    return P0


@jit
def factor(A: Array, B: Array, Phi: Array, free: Indices) -> tuple[Array, Array, Array, Array, Array]:
    """Return K, the factors of S, A_c, P (T+2, n, n), and the factor of the free block of P_0."""
    stages, n, k = B.shape
    K, L, Ac = np.empty((stages, k, n)), np.zeros((stages, k, k)), np.empty((stages, n, n))
    P, PA, PB, UK = np.zeros((stages + 1, n, n)), np.empty((n, n)), np.empty((n, k)), np.empty((k, n))
    for t in range(stages - 1, -1, -1):
        gains(A[t], B[t], Phi[t], P[t + 1], K[t], L[t], Ac[t], PB)
        cost_to_go(Phi[t], P[t + 1], K[t], Ac[t], UK, PA, P[t])
    P0 = first_factor(P[0], free)
    return K, L, Ac, P, P0


@jit
def is_convex(A: Array, B: Array, Phi: Array, free: Indices) -> bool:
    """Whether all pivots of the recursion are above rounding."""
    stages, n, k = B.shape
    K, L, Ac = np.empty((k, n)), np.zeros((k, k)), np.empty((n, n))
    P, after, PA, PB, UK = np.zeros((n, n)), np.zeros((n, n)), np.empty((n, n)), np.empty((n, k)), np.empty((k, n))
    for t in range(stages - 1, -1, -1):
        gains(A[t], B[t], Phi[t], after, K, L, Ac, PB)
        for j in range(k):
            if not L[j, j] * L[j, j] > CURVED * abs(Phi[t, n + j, n + j]):
                return False
        cost_to_go(Phi[t], after, K, Ac, UK, PA, P)
        after[:] = P
    P0 = first_factor(P, free)
    for i in range(len(free)):
        if not P0[i, i] * P0[i, i] > CURVED * abs(Phi[0, free[i], free[i]]):
            return False
    return True


@jit
def first_state(P: Array, p: Array, P0: Array, free: Indices, x0: Array) -> tuple[Array, Array]:
    """Return x_0 and lam0 from the cost-to-go of the first stage."""
    n = len(x0)
    x, lam0, v = x0.copy(), np.ones(n), np.empty(len(free))
    for f in range(len(free)):
        value = p[free[f]]
        for j in range(n):
            value += P[free[f], j] * x0[j]
        v[f] = -value
    cholesky_solve(P0, len(free), v)
    for f in range(len(free)):
        x[free[f]] = v[f]
        lam0[free[f]] = 0.0
    for i in range(n):
        value = p[i]
        for j in range(n):
            value += P[i, j] * x[j]
        lam0[i] *= -value
    return x, lam0


@jit
def solve(
    A: Array, B: Array, K: Array, L: Array, Ac: Array, P: Array, P0: Array, free: Indices, r: Array, c: Array, x0: Array
) -> tuple[Array, Array, Array]:
    """Return y, eta and lam0."""
    stages, n, k = B.shape
    p, w, v = np.zeros((stages + 1, n)), np.empty((stages, k)), np.empty(n)
    y, eta = np.empty((stages, n + k)), np.empty((stages, n))
    for t in range(stages - 1, -1, -1):
        for i in range(n):
            value = p[t + 1, i]
            for m in range(n):
                value += P[t + 1, i, m] * c[t, m]
            v[i] = value
        for i in range(k):
            value = r[t, n + i]
            for m in range(n):
                value += B[t, m, i] * v[m]
            w[t, i] = -value
        cholesky_solve(L[t], k, w[t])
        for i in range(n):
            value = r[t, i]
            for m in range(n):
                value += Ac[t, m, i] * v[m]
            for m in range(k):
                value += K[t, m, i] * r[t, n + m]
            p[t, i] = value
    x, lam0 = first_state(P[0], p[0], P0, free, x0)
    for t in range(stages):
        for i in range(n):
            y[t, i] = x[i]
        for i in range(k):
            value = w[t, i]
            for m in range(n):
                value += K[t, i, m] * x[m]
            y[t, n + i] = value
        for i in range(n):
            value = c[t, i]
            for m in range(n):
                value += A[t, i, m] * y[t, m]
            for m in range(k):
                value += B[t, i, m] * y[t, n + m]
            x[i] = value
        for i in range(n):
            value = p[t + 1, i]
            for m in range(n):
                value += P[t + 1, i, m] * x[m]
            eta[t, i] = -value
    return y, eta, lam0


@jit
def gram(H: Array, G: Array, weights: Array, points: Array, ends: Indices) -> Array:
    """Return H + G'W^-2 G; cone j has the rows ends[j] .. ends[j+1] - 1, of which G'W^-2 G = (2 q q' - G'J G)/eta^2."""
    stages, _, nz = G.shape
    linear = ends[0]
    out, q = H.copy(), np.empty(nz)
    for t in range(stages):
        for i in range(linear):
            if weights[t, i] != 0.0:
                for a in range(nz):
                    scaled = weights[t, i] * G[t, i, a]
                    if scaled != 0.0:
                        for b in range(nz):
                            out[t, a, b] += scaled * G[t, i, b]
        for j in range(len(ends) - 1):
            weight = weights[t, linear + j]
            if weight == 0.0:
                continue
            head = ends[j]
            for a in range(nz):
                q[a] = points[t, head - linear] * G[t, head, a]
                for i in range(head + 1, ends[j + 1]):
                    q[a] -= points[t, i - linear] * G[t, i, a]
            for a in range(nz):
                for b in range(nz):
                    value = 2 * q[a] * q[b] - G[t, head, a] * G[t, head, b]
                    for i in range(head + 1, ends[j + 1]):
                        value += G[t, i, a] * G[t, i, b]
                    out[t, a, b] += weight * value
    return out


@jit
def forward(A: Array, B: Array, c: Array, breaks: Indices, starts: Array, y: Array) -> Array:
    """Write the states of y, and return the ends."""
    stages, n, k = B.shape
    ends, done = np.empty(starts.shape), 0
    for t in range(stages - 1):
        for i in range(n):
            value = c[t, i]
            for m in range(n):
                value += A[t, i, m] * y[t, m]
            for m in range(k):
                value += B[t, i, m] * y[t, n + m]
            y[t + 1, i] = value
        if done < len(breaks) and breaks[done] == t + 1:
            for i in range(n):
                ends[done, i] = y[t + 1, i]
                y[t + 1, i] = starts[done, i]
            done += 1
    return ends


@jit
def backward(A: Array, B: Array, gradient: Array, breaks: Indices, prices: Array) -> tuple[Array, Array, Array]:
    """Return the costates, and the gradients in w and in the starts."""
    stages, n, k = B.shape
    p, gw, gstarts = np.zeros((stages + 1, n)), np.empty((stages, k)), np.empty(prices.shape)
    left = len(breaks) - 1
    for t in range(stages - 1, -1, -1):
        for i in range(k):
            value = gradient[t, n + i]
            for m in range(n):
                value += B[t, m, i] * p[t + 1, m]
            gw[t, i] = value
        for i in range(n):
            value = gradient[t, i]
            for m in range(n):
                value += A[t, m, i] * p[t + 1, m]
            p[t, i] = value
        if left >= 0 and breaks[left] == t:
            for i in range(n):
                gstarts[left, i] = p[t, i]
                p[t, i] = -prices[left, i]
            left -= 1
    return p[:stages].copy(), gw, gstarts


@jit
def times(matrices: Array, vectors: Array) -> Array:
    """Return M_t v_t."""
    stages, rows, columns = matrices.shape
    out = np.empty((stages, rows))
    for t in range(stages):
        for i in range(rows):
            value = 0.0
            for j in range(columns):
                value += matrices[t, i, j] * vectors[t, j]
            out[t, i] = value
    return out


@jit
def transposed_times(matrices: Array, vectors: Array) -> Array:
    """Return M_t'v_t."""
    stages, rows, columns = matrices.shape
    out = np.zeros((stages, columns))
    for t in range(stages):
        for i in range(rows):
            for j in range(columns):
                out[t, j] += matrices[t, i, j] * vectors[t, i]
    return out


KERNELS = Kernels(
    (__file__, dense.__file__),
    (factor, (*REALS[3:] * 3, INDICES)),
    (is_convex, (*REALS[3:] * 3, INDICES)),
    (solve, (*REALS[3:] * 6, REALS[2], INDICES, REALS[2], REALS[2], REALS[1])),
    (gram, (REALS[3], REALS[3], REALS[2], REALS[2], INDICES)),
    (forward, (REALS[3], REALS[3], REALS[2], INDICES, REALS[2], WRITTEN[2])),
    (backward, (REALS[3], REALS[3], REALS[2], INDICES, REALS[2])),
    (times, (REALS[3], REALS[2])),
    (transposed_times, (REALS[3], REALS[2])),
)


class CompiledRegulator(Regulator):
    """The factors of the Riccati recursion."""

    def __init__(self, A: Array, B: Array, Phi: Array, fixed: Mask):
        """Factor the stages."""
        self._A, self._B, self._fixed, self._free = A, B, fixed, np.flatnonzero(~fixed)
        self._factors = factor(A, B, Phi, self._free)

    def solve(self, r: Array, c: Array, x0: Array) -> tuple[Array, Array, Array]:
        """Return y, eta and lam0."""
        return solve(self._A, self._B, *self._factors, self._free, r, c, x0)

    def gains(self) -> Gains:
        """Return the gains and factors of the Riccati recursion."""
        K, L, Ac, P, _ = self._factors
        return Gains(self._B, K, L, Ac, P[0], self._fixed)


class CompiledLoops:
    """All loops by numba."""

    compiled: ClassVar[bool] = True

    def is_convex(self, A: Array, B: Array, Phi: Array, fixed: Mask) -> bool:
        """Return whether the problem is strictly convex on its dynamics."""
        return is_convex(A, B, Phi, np.flatnonzero(~fixed))

    def gram(self, H: Array, G: Array, weights: Array, points: Array, cones: tuple[int, ...]) -> Array:
        """Return H + G'W^-2 G."""
        return gram(H, G, weights, points, np.cumsum([G.shape[1] - sum(cones), *cones]))

    factor = CompiledRegulator
    times = staticmethod(times)
    transposed_times = staticmethod(transposed_times)
    forward = staticmethod(forward)
    backward = staticmethod(backward)
