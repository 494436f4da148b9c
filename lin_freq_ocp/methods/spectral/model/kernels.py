"""Circulant kernels: how a unit force on one row at one time moves another row at another (docs/spectral.md, 5)."""

from __future__ import annotations

import numpy as np
from scipy import fft

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices
from lin_freq_ocp.methods.spectral.model.lti import Lti
from lin_freq_ocp.methods.spectral.model.spaces import BinSpaces

SMALL_TABLE = 500_000  # entries up to which all kernels are computed at once


class Kernels:
    """K_fg(t) = irfft of F_f N N^* F_g': what F_f y_t loses by a unit force on F_g y_0.

    ``table`` is (rows, rows, T). Where it is not ``complete``, pairs f <= g are computed on demand: the others are
    undefined, and use no memory.
    """

    def __init__(self, lti: Lti, spaces: BinSpaces):
        self.lti, self.spaces, rows = lti, spaces, len(lti.F)
        self.known = np.zeros((rows, rows), dtype=bool)
        self.complete = rows * rows * lti.horizon <= SMALL_TABLE
        if self.complete:
            NF = self.of_rows(np.arange(rows))
            kernels = fft.irfft((NF[:, None] * NF[None].conj()).sum(2), lti.horizon)
            self.table = (kernels + kernels[:, :, -np.arange(lti.horizon)].swapaxes(0, 1)) / 2
        else:
            self.table = np.empty((rows, rows, lti.horizon))

    def gram(self, t: Indices, f: Indices, s: Indices, g: Indices) -> Array:
        """Return K_{f_i g_j}(t_i - s_j), shape (len(t), len(s)); all times are below T."""
        if not self.complete:
            self._require([(int(a), int(b)) for a in np.unique(f) for b in np.unique(g)])
        f, lag = f[:, None], t[:, None] - s  # a negative index counts from the end of the circle
        if self.complete:
            return self.table[f, g, lag]
        return self.table[np.minimum(f, g), np.maximum(f, g), np.where(f <= g, lag, -lag)]

    def free_response(self, f: Indices) -> Array:
        """Return K_ff(0) of each row: how far a unit force moves its own row without equations."""
        if not self.complete:
            self._require([(int(a), int(a)) for a in np.unique(f)])
        return self.table[f, f, 0]

    def _require(self, pairs: list[tuple[int, int]]) -> None:
        for f, g in map(sorted, pairs):
            if not self.known[f, g]:
                row, column = self.of_rows(np.array([f, g]))
                self.table[f, g] = fft.irfft((row * column.conj()).sum(0), self.lti.horizon)
                if f == g:
                    self.table[f, f] += np.roll(self.table[f, f, ::-1], 1)
                    self.table[f, f] /= 2
                self.known[f, g] = True

    def of_rows(self, rows: Indices) -> ComplexArray:
        """Return F_f N of some rows, shape (rows, m, bins)."""
        dimension = len(self.lti.M)
        return self.spaces.N[rows] if len(self.lti.F) == dimension else np.tensordot(self.lti.F[rows], self.spaces.N, 1)
