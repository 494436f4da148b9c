"""The loops over stages in C, compiled once per user and called by ctypes; their source is loops.c."""

from __future__ import annotations

import ctypes
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.methods.native_code import compiled_library
from lin_freq_ocp.methods.structured.kkt.dense import CURVED, PIVOT, Gains, Regulator

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
