"""Linear algebra over stages: the loops by NumPy and LAPACK, and those of loops.c, compiled once per user, by ctypes.

Stages t = 0 .. T, y_t = (x_t, w_t) with n states and k further entries, nz = n + k. A, B and Phi have T+1 stages; A_T
and B_T are zero, so that w_T is eliminated like every other. A regulator is the factored problem

    minimise sum_t 1/2 y_t'Phi_t y_t + r_t'y_t   subject to   x_{t+1} = A_t x_t + B_t w_t + c_t,  x_0 given where fixed,
    Phi_t y_t + r_t + (eta_{t-1}, 0) - (A_t, B_t)'eta_t + [t = 0] (lam0, 0) = 0,   lam0 = 0 where x_0 is free.

LAPACK computes a single solution by the LU factors of the banded matrix of all stages, whose unknowns are, stage by
stage, lam_t, x_t and w_t, with lam_0 = lam0 and lam_t = eta_{t-1}; the Riccati recursion gives many responses at once.
In both implementations, ``OpenLoop`` (dense.py) does the open-loop sweeps for many columns.
"""

from __future__ import annotations

import ctypes
from typing import ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.methods.native_code import compiled_library
from lin_freq_ocp.methods.structured.kkt.dense import CURVED, PIVOT, Gains, Regulator


class BandedLoops:
    """Factors, and sweeps in open loop, by NumPy and LAPACK; all arrays contiguous.

    In open loop the states start anew from ``starts`` at ``breaks``, (K,) increasing times within 1 .. T.
    """

    compiled: ClassVar[bool] = False

    def factor(self, A: Array, B: Array, Phi: Array, fixed: Mask) -> BandedRegulator:
        """Factor the stages: A (T+1, n, n), B (T+1, n, k), Phi (T+1, nz, nz) positive semidefinite, fixed (n,)."""
        return BandedRegulator(A, B, Phi, fixed)

    def is_convex(self, A: Array, B: Array, Phi: Array, fixed: Mask) -> bool:
        """Whether the problem with a symmetric Phi is strictly convex on its dynamics: no pivot is a rounding error."""
        AB, n = np.concatenate([A, B], axis=2), A.shape[1]
        P, least = np.zeros((n, n)), CURVED * np.abs(np.einsum("tii->ti", Phi))
        for t in range(len(A) - 1, -1, -1):
            M = Phi[t] + AB[t].T @ (P @ AB[t])
            L, info = lapack.dpotrf(M[n:, n:], lower=1, clean=1)
            if info or not (np.diag(L) ** 2 > least[t, n:]).all():
                return False
            K = lapack.dtrtrs(L, M[n:, :n], lower=1)[0]
            P = M[:n, :n] - K.T @ K
        if fixed.all():
            return True
        L, info = lapack.dpotrf(P[np.ix_(~fixed, ~fixed)], lower=1, clean=1)
        return not info and bool((np.diag(L) ** 2 > least[0, :n][~fixed]).all())

    def gram(self, H: Array, G: Array, weights: Array, points: Array, cones: tuple[int, ...]) -> Array:
        """Return H_t + G_t' W_t^-2 G_t, (T+1, nz, nz), for G (T+1, p, nz), whose last rows are second-order cones.

        weights (T+1, p - sum(cones) + len(cones)): 1/w^2 of the orthant rows, then 1/eta^2 of the cones; zero where
        there is no such row. points (T+1, sum(cones)): the w of the cones, W^2 = eta^2 (2 w w' - J), w'J w = 1.
        """
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
        """Write in y (T+1, nz) the states x_1 .. x_T that follow from its x_0 and w; starts (K, n), c (T+1, n).

        Return the ends (K, n): the states at the breaks before they are replaced.
        """
        n = A.shape[1]
        right = np.empty((len(A), n))
        right[0], right[1:] = y[0, :n], np.einsum("tij,tj->ti", B[:-1], y[:-1, n:]) + c[:-1]
        ends = right[breaks]
        right[breaks] = starts
        y[:, :n] = simulate(simulation_matrix(A, breaks), right, transposed=False)
        return ends + np.einsum("tij,tj->ti", A[breaks - 1], y[breaks - 1, :n])

    def backward(
        self, A: Array, B: Array, gradient: Array, breaks: Indices, prices: Array
    ) -> tuple[Array, Array, Array]:
        """Return the costates p (T+1, n), the gradient in w (T+1, k), and that in the starts (K, n).

        p_t = gradient_x + A_t'p_{t+1}, gw_t = gradient_w + B_t'p_{t+1}; at a break p_t is the gradient in its start,
        and then -prices, (K, n), takes its place. The multiplier of x_{t+1} = A_t x_t + B_t w_t + c_t is -p_{t+1}.
        """
        n = A.shape[1]
        right = gradient[:, :n].copy()
        right[breaks - 1] -= np.einsum("tji,tj->ti", A[breaks - 1], prices)
        costates = simulate(simulation_matrix(A, breaks), right, transposed=True)
        gstarts = costates[breaks]
        costates[breaks] = -prices
        gw = gradient[:, n:].copy()
        gw[:-1] += np.einsum("tji,tj->ti", B[:-1], costates[1:])
        return costates, gw, gstarts


ADDRESS = ctypes.c_char * 0  # of an array that can be written: made in a quarter of the time of ``ctypes.data``


class Reals:
    """The type of an argument: a contiguous array of reals, whose address is passed."""

    dtype: ClassVar[np.dtype[np.generic]] = np.dtype(np.float64)

    @classmethod
    def from_param(cls, array: NDArray[np.generic]) -> ctypes.Array[ctypes.c_char] | ctypes.c_void_p:
        """Return the address; ctypes calls this for every argument."""
        if array.dtype != cls.dtype or not array.flags.c_contiguous:
            raise TypeError(f"got an array of {array.dtype}, strides {array.strides}; expected {cls.dtype}, contiguous")
        return ADDRESS.from_buffer(array.data) if array.flags.writeable else ctypes.c_void_p(array.ctypes.data)


class Integers(Reals):
    """The same with integers of the size of an index."""

    dtype = np.dtype(np.intp)


class FactoredStages(ctypes.Structure):
    """lfo_regulator of loops.c."""

    _fields_ = [(name, ctypes.c_ssize_t) for name in ("stages", "n", "k", "count")] + [
        (name, ctypes.c_void_p) for name in ("free", "A", "B", "K", "L", "Ac", "P", "P0")
    ]


ARGUMENTS = {"factor": "pRR dd", "solve": "pRRR RRR R", "gram": "sssss RRRR I R R", "forward": "ssss RRR I R RR"}
ARGUMENTS |= {"backward": "ssss RRR I R RRR"}
"""The arguments of each function: a structure, sizes, arrays of reals or integers, doubles."""

KINDS = {"p": ctypes.POINTER(FactoredStages), "s": ctypes.c_ssize_t, "R": Reals, "I": Integers, "d": ctypes.c_double}


def loops_library() -> ctypes.CDLL | None:
    """Return the compiled loops; None, with a warning, if there are none."""
    return compiled_library(__file__, "loops.c", "../../dense.h")


class CompiledRegulator(Regulator):
    """The factors of the Riccati recursion."""

    def __init__(self, library: ctypes.CDLL, A: Array, B: Array, Phi: Array, fixed: Mask, curved: float = -1.0):
        """Factor the stages, or up to a pivot that is not above so many times the curvature of its stage."""
        self._library, self._fixed, (stages, n, k) = library, fixed, B.shape
        free = np.flatnonzero(~fixed)
        K, L, Ac = np.empty((stages, k, n)), np.zeros((stages, k, k)), np.empty((stages, n, n))
        P, P0 = np.zeros((stages + 1, n, n)), np.zeros((len(free), len(free)))
        self._arrays = free, A, B, K, L, Ac, P, P0
        self._stages = FactoredStages(*B.shape, len(free), *(array.ctypes.data for array in self._arrays))
        self.complete = bool(library.lfo_factor(self._stages, Phi, np.empty((n + k, n)), PIVOT, curved))

    def solve(self, r: Array, c: Array, x0: Array) -> tuple[Array, Array, Array]:
        """Return y, eta and lam0."""
        y, eta, lam0 = np.empty(r.shape), np.empty(c.shape), np.empty(len(x0))
        self._library.lfo_solve(self._stages, r, c, x0, y, eta, lam0, np.empty(len(x0)))
        return y, eta, lam0

    def gains(self) -> Gains:
        """Return the gains and factors of the Riccati recursion."""
        _, _, B, K, L, Ac, P, _ = self._arrays
        return Gains(B, K, L, Ac, P[0], self._fixed)


class CompiledLoops:
    """All loops in C."""

    compiled: ClassVar[bool] = True

    def __init__(self, library: ctypes.CDLL):
        """Tell the library the types of its arguments."""
        self._library = library
        for name, kinds in ARGUMENTS.items():
            getattr(library, f"lfo_{name}").argtypes = [KINDS[kind] for kind in kinds.replace(" ", "")]

    def factor(self, A: Array, B: Array, Phi: Array, fixed: Mask) -> CompiledRegulator:
        """Factor the stages."""
        return CompiledRegulator(self._library, A, B, Phi, fixed)

    def is_convex(self, A: Array, B: Array, Phi: Array, fixed: Mask) -> bool:
        """Return whether the problem is strictly convex on its dynamics."""
        return CompiledRegulator(self._library, A, B, Phi, fixed, CURVED).complete

    def gram(self, H: Array, G: Array, weights: Array, points: Array, cones: tuple[int, ...]) -> Array:
        """Return H + G'W^-2 G."""
        sizes, linear, out = np.array(cones, dtype=np.intp), G.shape[1] - sum(cones), np.empty(H.shape)
        given = *G.shape, linear, len(cones), H, G, weights, points, sizes
        self._library.lfo_gram(*given, out, np.empty(G.shape[2]))
        return out

    def forward(self, A: Array, B: Array, c: Array, breaks: Indices, starts: Array, y: Array) -> Array:
        """Write the states of y, and return the ends."""
        ends = np.empty(starts.shape)
        self._library.lfo_forward(*B.shape, len(breaks), A, B, c, breaks, starts, y, ends)
        return ends

    def backward(
        self, A: Array, B: Array, gradient: Array, breaks: Indices, prices: Array
    ) -> tuple[Array, Array, Array]:
        """Return the costates, and the gradients in w and in the starts."""
        stages, n, k = B.shape
        p, gw, gstarts = np.empty((stages, n)), np.empty((stages, k)), np.empty(prices.shape)
        self._library.lfo_backward(*B.shape, len(breaks), A, B, gradient, breaks, prices, p, gw, gstarts)
        return p, gw, gstarts


Loops: TypeAlias = BandedLoops | CompiledLoops
"""The loops over stages; both classes have the methods of ``BandedLoops``, which say what they return."""


def can_compile() -> bool:
    """Whether the loops run in C."""
    return loops_library() is not None


def loops(compiled: bool = True) -> Loops:
    """Return the loops in C; those by NumPy and LAPACK without a compiler, or if they are asked for."""
    library = loops_library() if compiled else None
    return BandedLoops() if library is None else CompiledLoops(library)


def simulation_matrix(A: Array, breaks: Indices) -> Array:
    """Return the banded matrix of x_{t+1} - A_t x_t for ``simulate``, with A_{t-1} = 0 for t in ``breaks``."""
    stages, n, _ = A.shape
    entries = np.zeros((stages, n, 2 * n))  # column by column; row i of a column j is at i - j
    for j in range(n):
        entries[:-1, j, n - j : 2 * n - j] = -A[:-1, :, j]
        entries[breaks - 1, j] = 0.0
    return entries.reshape(stages * n, -1).T


def simulate(matrix: Array, right: Array, transposed: bool) -> Array:
    """Return x_{t+1} = A_t x_t + right_{t+1}, or p_t = A_t'p_{t+1} + right_t, for right (T+1, n) or (T+1, n, k)."""
    trans, columns = "T" if transposed else "N", right.reshape(matrix.shape[1], *(right.shape[2:] or (1,)))
    return lapack.dtbtrs(matrix, columns, uplo="L", trans=trans, diag="U")[0].reshape(right.shape)


class BandedRegulator(Regulator):
    """LU factors of all stages; the Riccati recursion runs when its gains are first needed."""

    def __init__(self, A: Array, B: Array, Phi: Array, fixed: Mask):
        """Factor the stages."""
        self._A, self._B, self._Phi, self._fixed = A, B, Phi, fixed
        self._gains: Gains | None = None
        self._band = 2 * A.shape[1] + B.shape[2] - 1
        matrix = banded_matrix(A, B, Phi, fixed)
        self._lu, self._pivots, info = lapack.dgbtrf(matrix, self._band, self._band)
        if info > 0:  # diagonal entries of y are raised to the rounding errors of the others
            diagonal = matrix.T.reshape(len(A), -1, 3 * self._band + 1)[:, A.shape[1] :, 2 * self._band]
            diagonal += PIVOT * np.where(diagonal > 0, diagonal, diagonal.max(initial=0.0) or 1.0)
            self._lu, self._pivots, _ = lapack.dgbtrf(matrix, self._band, self._band)

    def solve(self, r: Array, c: Array, x0: Array) -> tuple[Array, Array, Array]:
        """Return y, eta and lam0."""
        stages, n = c.shape
        right = np.empty((stages, 2 * n + self._B.shape[2]))
        right[0, :n], right[1:, :n], right[:, n:] = x0, c[:-1], -r
        unknowns, _ = lapack.dgbtrs(self._lu, self._band, self._band, right.ravel(), self._pivots)
        unknowns = unknowns.reshape(right.shape)
        eta = np.zeros((stages, n))
        eta[:-1] = unknowns[1:, :n]
        return unknowns[:, n:].copy(), eta, np.where(self._fixed, unknowns[0, :n], 0.0)

    def gains(self) -> Gains:
        """Return the gains of the Riccati recursion, which loops.c derives."""
        if self._gains is None:
            B, Phi, AB = self._B, self._Phi, np.concatenate([self._A, self._B], axis=2)
            stages, n, k = B.shape
            P, root = np.zeros((n, n)), np.concatenate([np.eye(n), np.zeros((k, n))])
            L, K = np.empty((stages, k, k)), np.empty((stages, k, n))
            for t in range(stages - 1, -1, -1):
                M = Phi[t] + AB[t].T @ (P @ AB[t])
                L[t] = cholesky(M[n:, n:])
                K[t] = root[n:] = -lapack.dpotrs(L[t], M[n:, :n], lower=1)[0]
                closed = AB[t] @ root
                P = root.T @ (Phi[t] @ root) + closed.T @ (P @ closed)
                P = (P + P.T) / 2
            self._gains = Gains(B, K, L, self._A + B @ K, P, self._fixed)
        return self._gains


def banded_matrix(A: Array, B: Array, Phi: Array, fixed: Mask) -> Array:
    """Return the matrix of all stages in LAPACK's banded form for LU factors, with 2n + k - 1 diagonals a side."""
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


def cholesky(S: Array) -> Array:
    """Return the lower factor of a positive semidefinite matrix; pivots below rounding errors are raised."""
    L, info = lapack.dpotrf(S, lower=1, clean=1)
    if info:
        diagonal = np.diag(S)
        floor = PIVOT * np.where(diagonal > 0, diagonal, diagonal.max(initial=0.0) or 1.0)
        while info:
            L, info = lapack.dpotrf(S + np.diag(floor), lower=1, clean=1)
            floor *= 10
    return L


def break_times(A: Array, horizon: int, growth: float) -> Indices:
    """Return the times within 1 .. T-1 at which a simulation begins anew: states grow at most so much between them."""
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
