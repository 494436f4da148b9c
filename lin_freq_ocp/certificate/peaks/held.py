"""The largest spectrum of a held signal below its limit, |S(w) V(w)| / l(w) at w of any size, with proof.

V has the period 2 pi, and its polynomials g are those of masks. On a cell about c of half-width s, S is an entire
function, S(c + s y) = sum_j b_j y^j with |b_j| <= (s/2)^j / j!, as S is the spectrum of a box of width 1. Its values at
K = TERMS points of the circle |y| = 1 have the Fourier coefficients b_j + b_{j+K} + ...; with s <= pi/4, what these and
the left-out terms add is below 1e-19. The product of both polynomials is cut off, and what is cut off is added.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices
from lin_freq_ocp.certificate.peaks.cells import TERMS
from lin_freq_ocp.certificate.peaks.masks import Series

ROUNDING = 64 * TERMS * float(np.finfo(np.float64).eps)  # of S, its FFT and the product, per sum of |a_j|; |S| < 1.1


class HeldSeries(Series):
    """The polynomials of S V on cells."""

    def on(self, k: Indices) -> tuple[ComplexArray, Array]:
        """Return the coefficients on cells k, (k, TERMS), and their errors."""
        a, error = super().on(k)
        turns = np.exp(2j * np.pi * np.arange(TERMS) / TERMS)
        half = self.step * (k[:, None] + turns / 2)  # w / 2
        b = np.fft.fft(np.sin(half) / half, axis=1) / TERMS
        whole = np.zeros((len(k), 2 * TERMS - 1), dtype=complex)
        for j in range(TERMS):
            whole[:, j : j + TERMS] += b[:, j : j + 1] * a
        return whole[:, :TERMS], error + np.abs(whole[:, TERMS:]).sum(1) + ROUNDING * np.abs(a).sum(1)
