"""Linear algebra over stages, by compiled loops or by NumPy and LAPACK.

Stages t = 0 .. T, y_t = (x_t, w_t) with n states and k further entries, nz = n + k. A, B and Phi have T+1 stages; A_T
and B_T are zero, so that w_T is eliminated like every other. A regulator is the factored problem

    minimise sum_t 1/2 y_t'Phi_t y_t + r_t'y_t   subject to   x_{t+1} = A_t x_t + B_t w_t + c_t,  x_0 given where fixed,
    Phi_t y_t + r_t + (eta_{t-1}, 0) - (A_t, B_t)'eta_t + [t = 0] (lam0, 0) = 0,   lam0 = 0 where x_0 is free.

Interface:

    loops(compiled=None, patient=True) -> Loops
    Loops.factor(A, B, Phi, fixed) -> Regulator
    Regulator.solve(r, c, x0) -> y, eta, lam0
    Regulator.responses(channels, R, E) -> Y, X
    Regulator.gram(channels, R, E) -> -R'Y - E'X
    Loops.is_convex(A, B, Phi, fixed) -> bool
    Loops.gram(H, G, weights, points, cones) -> Phi
    Loops.times(M, v) -> M_t v_t, Loops.transposed_times(M, v) -> M_t'v_t
    Loops.forward(A, B, c, breaks, starts, y) -> ends
    Loops.backward(A, B, gradient, breaks, prices) -> costates, gw, gstarts
    OpenLoop(A, B, Phi, breaks).columns(starts, W) -> GW, gstarts, ends, X        of blocks.py, the same for both
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import ClassVar, Protocol

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.methods.structured.kkt.banded import BandedLoops


class Regulator(Protocol):
    """The factored stages."""

    def solve(self, r: Array, c: Array, x0: Array) -> tuple[Array, Array, Array]:
        """Return y (T+1, nz), eta (T+1, n) with eta_T = 0, and lam0 (n,).

        r is (T+1, nz), c (T+1, n) with c_T = 0, x0 (n,) with zero where x_0 is free.
        """
        ...

    def responses(self, channels: Indices, R: Array, E: Array) -> tuple[Array, Array]:
        """Return the entries ``channels`` of y, (T+1, channels, m), and x_T, (n, m), for m gradients; c = 0, x0 = 0.

        R (T+1, channels, m) are gradients on these entries, each of them named once; E (n, m) is added on x_T.
        """
        ...

    def gram(self, channels: Indices, R: Array, E: Array) -> Array:
        """Return the lower triangle of minus the gradients times their responses, (m, m), positive semidefinite."""
        ...


class Loops(Protocol):
    """Factors, and sweeps in open loop; all arrays contiguous.

    In open loop the states start anew from ``starts`` at ``breaks``, (K,) increasing times within 1 .. T.
    """

    compiled: ClassVar[bool]

    def factor(self, A: Array, B: Array, Phi: Array, fixed: Mask) -> Regulator:
        """Factor the stages: A (T+1, n, n), B (T+1, n, k), Phi (T+1, nz, nz) positive semidefinite, fixed (n,)."""
        ...

    def is_convex(self, A: Array, B: Array, Phi: Array, fixed: Mask) -> bool:
        """Return whether the problem of a regulator with a symmetric Phi is strictly convex on its dynamics."""
        ...

    def gram(self, H: Array, G: Array, weights: Array, points: Array, cones: tuple[int, ...]) -> Array:
        """Return H_t + G_t' W_t^-2 G_t, (T+1, nz, nz), for G (T+1, p, nz), whose last rows are second-order cones.

        weights (T+1, p - sum(cones) + len(cones)): 1/w^2 of the orthant rows, then 1/eta^2 of the cones; zero where
        there is no such row. points (T+1, sum(cones)): the w of the cones, W^2 = eta^2 (2 w w' - J), w'J w = 1.
        """
        ...

    def times(self, matrices: Array, vectors: Array) -> Array:
        """Return M_t v_t, (T+1, rows), for M (T+1, rows, columns) and v (T+1, columns)."""
        ...

    def transposed_times(self, matrices: Array, vectors: Array) -> Array:
        """Return M_t'v_t, (T+1, columns), for v (T+1, rows)."""
        ...

    def forward(self, A: Array, B: Array, c: Array, breaks: Indices, starts: Array, y: Array) -> Array:
        """Write in y (T+1, nz) the states x_1 .. x_T that follow from its x_0 and w; starts (K, n), c (T+1, n).

        Return the ends (K, n): the states at the breaks before they are replaced.
        """
        ...

    def backward(
        self, A: Array, B: Array, gradient: Array, breaks: Indices, prices: Array
    ) -> tuple[Array, Array, Array]:
        """Return the costates p (T+1, n), the gradient in w (T+1, k), and that in the starts (K, n).

        p_t = gradient_x + A_t'p_{t+1}, gw_t = gradient_w + B_t'p_{t+1}; at a break p_t is the gradient in its start,
        and then -prices, (K, n), takes its place. The multiplier of x_{t+1} = A_t x_t + B_t w_t + c_t is -p_{t+1}.
        """
        ...


def loops(compiled: bool | None = None, patient: bool = True) -> Loops:
    """Return the compiled loops or those by NumPy and LAPACK.

    By default the first, if numba is installed. Who is not patient takes them only if nothing remains to be compiled.
    """
    if compiled is False or (compiled is None and find_spec("numba") is None):
        return BandedLoops()
    from lin_freq_ocp.methods.structured.kkt.compiled.loops import KERNELS, CompiledLoops

    if compiled is None and not patient and not KERNELS.ready:
        return BandedLoops()
    KERNELS.prepare()
    return CompiledLoops()
