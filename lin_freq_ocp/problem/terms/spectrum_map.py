"""DFT bins of a linear output of the trajectory, as an affine map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy import fft

from lin_freq_ocp.arrays import Array, Indices, Mask
from lin_freq_ocp.problem.terms.maps import AffineMap, Shapes, joined_rows


@dataclass(frozen=True, eq=False)
class SpectrumMap(AffineMap):
    """(Re, Im) of Y_j = sum_t w_t y_t exp(-2 pi i j t / N) at chosen bins j, for y_t = C x_t + D u_t.

    One group (Re, Im) for each bin, or with ``together`` a single group of all of them. The imaginary part of bins 0
    and N/2, always zero, is left out where all are together, and is a zero elsewhere.

    Attributes
    ----------
    C : (n,), or None; D : (m,), or None
        y_t is looked at for t = 0 .. T-1, and at T, too, if D is None.
    window : (samples,)
        w_t; ones for the plain DFT.
    points : int
        N: as many as there are samples, or a multiple of that for a finer grid.
    bins : (bins,)
        Within 0 .. N/2.
    together : bool
    """

    C: Array | None
    D: Array | None
    window: Array
    points: int
    bins: Indices
    together: bool = False

    @property
    def samples(self) -> int:
        """Return the length of the signal."""
        return len(self.window)

    @property
    def component(self) -> int:
        """Return the state or control that it is a spectrum of, if it is that of one."""
        row = self.C if self.C is not None else self.D
        assert row is not None  # there is a signal
        return int(np.flatnonzero(row)[0])

    @property
    def nearest_bins(self) -> Indices:
        """Return the nearest bin of the plain DFT to each of the bins, (bins,)."""
        return np.rint(self.bins * len(self.window) / self.points).astype(int)

    @property
    def single(self) -> Mask:
        """Which of the bins are real for every signal, (bins,)."""
        return np.asarray((self.bins == 0) | (2 * self.bins == self.points))

    @property
    def frequencies(self) -> Array:
        """Return the frequency of each bin in rad/sample; empty if all are together."""
        return np.zeros(0) if self.together else 2 * np.pi * self.bins / self.points

    def spectrum_of(self, C: Array | None, D: Array | None) -> bool:
        """Whether this is a spectrum of y = C x + D u."""
        return _same(self.C, C) and _same(self.D, D)

    @property
    def dense_size(self) -> tuple[int, int]:
        """Return how many rows are dense, and the number of their entries."""
        rows, signals = 2 * len(self.bins), sum(1 for part in (self.C, self.D) if part is not None and part.any())
        return rows, rows * len(self.window) * signals

    @property
    def places(self) -> Indices:
        """Return the bins; of points between them, the nearest."""
        return self.nearest_bins

    @property
    def additions(self) -> float:
        """Return how many operations in a row make one value: rounding errors grow with it."""
        return float(5 * np.log2(self.points) + 10)

    def values(self, x: Array, u: Array) -> Array:
        """Return v, (groups, dim), for x (T+1, n) and u (T, m)."""
        spectrum = fft.rfft(self.window * self._signal(x, u), n=self.points)[self.bins]
        return self._grouped(np.stack([spectrum.real, spectrum.imag], axis=1))

    def pull_back(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        """Return the adjoint's values, of the shapes of x and u."""
        pairs = self.pairs(weights)
        k = np.arange(self.points // 2 + 1)
        spectrum = np.zeros(len(k), dtype=np.result_type(pairs, np.complex64))
        spectrum[self.bins] = pairs[:, 0] + 1j * pairs[:, 1]
        factor = np.where((k == 0) | (2 * k == self.points), 1.0, 0.5)
        signal = fft.irfft(self.points * factor * spectrum, n=self.points)[: len(self.window)] * self.window
        return self._spread(signal, shapes)

    def rows(self, horizon: int, n: int, m: int) -> tuple[sp.csr_array, Array]:
        """Return cosines and sines as rows; the constant is zero."""
        t = np.arange(len(self.window))
        angle = 2 * np.pi * (np.outer(self.bins, t) % self.points) / self.points
        waves = np.stack([np.cos(angle), -np.sin(angle)], axis=1) * self.window
        waves[self.single, 1] = 0.0  # and not the rounding error of sin(pi t)
        waves = waves.reshape(-1, len(t))
        waves = waves[self._kept] if self.together else waves
        of_x, of_u = _signal_rows(waves, self.C, horizon + 1, n), _signal_rows(waves, self.D, horizon, m)
        return joined_rows(of_x, of_u), np.zeros(len(waves))

    def sizes(self, x: Array, u: Array) -> Array:
        """Return the Euclidean norm of w y, the typical size of a bin, for every entry, (groups, dim)."""
        of_x, of_u = (None if part is None else np.abs(part) for part in (self.C, self.D))
        y = SpectrumMap(of_x, of_u, self.window, self.points, self.bins)._signal(np.abs(x), np.abs(u))
        norm = np.sqrt(((self.window * y) ** 2).sum())
        return np.full(self.shape, norm)

    def pulled_sizes(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        """Return the sums of the absolute values of the terms of ``pull_back``."""
        of_x, of_u = (None if part is None else np.abs(part) for part in (self.C, self.D))
        absolute = SpectrumMap(of_x, of_u, self.window, self.points, self.bins)
        return absolute._spread(np.abs(self.window) * np.abs(self.pairs(weights)).sum(), shapes)

    @property
    def shape(self) -> tuple[int, int]:
        """Return (groups, dim) of the values."""
        return (1, 2 * len(self.bins) - int(self.single.sum())) if self.together else (len(self.bins), 2)

    def pairs(self, values: Array) -> Array:
        """Return (Re, Im) of every bin, (bins, 2), from values or multipliers (groups, dim)."""
        if not self.together:
            return values
        pairs = np.zeros(2 * len(self.bins), dtype=values.dtype)
        pairs[self._kept] = values[0]
        return pairs.reshape(-1, 2)

    @property
    def _kept(self) -> Mask:
        kept = np.ones((len(self.bins), 2), dtype=bool)
        kept[self.single, 1] = False
        return kept.ravel()

    def _grouped(self, pairs: Array) -> Array:
        return pairs.reshape(-1)[self._kept][None] if self.together else pairs

    def _signal(self, x: Array, u: Array) -> Array:
        parts = [signal @ row for row, signal in ((self.C, x), (self.D, u)) if row is not None]
        return sum((part[: len(self.window)] for part in parts[1:]), parts[0][: len(self.window)])

    def _spread(self, signal: Array, shapes: Shapes) -> tuple[Array, Array]:
        pulled = tuple(np.zeros(shape, dtype=signal.dtype) for shape in shapes)
        for row, part in zip((self.C, self.D), pulled, strict=True):
            if row is not None:
                part[: len(signal)] += np.outer(signal, row)
        return pulled[0], pulled[1]


def _signal_rows(waves: Array, row: Array | None, samples: int, columns: int) -> sp.csr_array:
    """Return the rows on one signal, (rows, samples * columns)."""
    if row is None:
        return sp.csr_array((len(waves), samples * columns))
    rows = sp.csr_array(sp.kron(sp.csr_array(waves), row[None]))
    return sp.csr_array((rows.data, rows.indices, rows.indptr), shape=(len(waves), samples * columns))


def _same(one: Array | None, other: Array | None) -> bool:
    """Whether both are the same coefficients, or both absent."""
    return one is other or (one is not None and other is not None and bool(np.array_equal(one, other)))
