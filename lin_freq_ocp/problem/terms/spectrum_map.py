# ruff: noqa: D102  (a method without a docstring is described by the class that it implements)
"""DFT bins of a linear output of the trajectory, as an affine map."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from scipy import fft

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.problem.terms.maps import AffineMap, Shapes, SpectrumForm, joined_rows


@dataclass(frozen=True, eq=False)
class SpectrumMap(AffineMap):
    """(Re, Im) of Y_j = sum_t w_t y_t exp(-2 pi i j t / N) at chosen bins j, for y_t = C x_t + D u_t.

    One group (Re, Im) for each bin, or with ``together`` a single group of all of them. The imaginary part of bins 0
    and N/2, always zero, is left out where all are together, and is a zero elsewhere.
    """

    C: Array | None  # (n,)
    D: Array | None  # (m,); y_t counts for t = 0 .. T-1, and at T, too, without D
    window: Array  # w_t, (samples,); ones for the plain DFT
    points: int  # N: the number of samples, or a multiple of it for a finer grid
    bins: Indices  # (bins,), within 0 .. N/2
    together: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        return (1, 2 * len(self.bins) - int(self.real.sum())) if self.together else (len(self.bins), 2)

    @property
    def real(self) -> Mask:
        """Which of the bins are real for every signal, (bins,)."""
        return np.asarray((self.bins == 0) | (2 * self.bins == self.points))

    @property
    def samples(self) -> int:
        return len(self.window)

    @property
    def component(self) -> int:
        row = self.C if self.C is not None else self.D
        assert row is not None  # there is a signal
        return int(np.flatnonzero(row)[0])

    @property
    def nearest_bins(self) -> Indices:
        return np.rint(self.bins * len(self.window) / self.points).astype(int)

    @property
    def positions(self) -> Indices:
        return self.nearest_bins

    @property
    def frequencies(self) -> Array:
        return np.zeros(0) if self.together else 2 * np.pi * self.bins / self.points

    def spectrum_of(self, C: Array | None, D: Array | None) -> bool:
        return all(
            own is given or (own is not None and given is not None and np.array_equal(own, given))
            for own, given in ((self.C, C), (self.D, D))
        )

    def spectrum_form(self, n: int, m: int) -> SpectrumForm:
        parts = [np.zeros(size) if part is None else part for part, size in ((self.C, n), (self.D, m))]
        kept = self.kept if self.together else np.ones(2 * len(self.bins), dtype=bool)
        return SpectrumForm(np.concatenate(parts), self.window, self.points, self.bins, kept)

    @property
    def dense_size(self) -> tuple[int, int]:
        rows, signals = 2 * len(self.bins), sum(1 for part in (self.C, self.D) if part is not None and part.any())
        return rows, rows * len(self.window) * signals

    @property
    def additions(self) -> float:
        return float(5 * np.log2(self.points) + 10)

    def values(self, x: Array, u: Array) -> Array:
        spectrum = fft.rfft(self.window * self.signal(x, u)[: self.samples], n=self.points)[self.bins]
        return self.grouped(np.stack([spectrum.real, spectrum.imag], axis=1))

    def pull_back(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        pairs = self.pairs(weights)
        k = np.arange(self.points // 2 + 1)
        spectrum = np.zeros(len(k), dtype=np.result_type(pairs, np.complex64))
        spectrum[self.bins] = pairs[:, 0] + 1j * pairs[:, 1]
        factor = np.where((k == 0) | (2 * k == self.points), 1.0, 0.5)
        signal = fft.irfft(self.points * factor * spectrum, n=self.points)[: len(self.window)] * self.window
        return self.spread(signal, shapes)

    def rows(self, horizon: int, n: int, m: int) -> tuple[sp.csr_array, Array]:
        t = np.arange(len(self.window))
        angle = 2 * np.pi * (np.outer(self.bins, t) % self.points) / self.points
        waves = np.stack([np.cos(angle), -np.sin(angle)], axis=1) * self.window
        waves[self.real, 1] = 0.0  # and not the rounding error of sin(pi t)
        waves = waves.reshape(-1, len(t))
        waves = waves[self.kept] if self.together else waves
        of_y = sp.csr_array(waves)
        of_x, of_u = signal_rows(of_y, self.C, horizon + 1, n), signal_rows(of_y, self.D, horizon, m)
        return joined_rows(of_x, of_u), np.zeros(len(waves))

    def sizes(self, x: Array, u: Array) -> Array:
        """Return the Euclidean norm of w y, the typical size of a bin, for every entry, (groups, dim)."""
        y = self.magnitudes().signal(np.abs(x), np.abs(u))[: self.samples]
        return np.full(self.shape, np.sqrt(((self.window * y) ** 2).sum()))

    def pulled_sizes(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        return self.magnitudes().spread(np.abs(self.window) * np.abs(self.pairs(weights)).sum(), shapes)

    def grouped(self, pairs: Array) -> Array:
        """Return values, (groups, dim), from (Re, Im) of every bin, (bins, 2); of several spectra, one by one."""
        return pairs.reshape(-1, 2 * len(self.bins))[:, self.kept] if self.together else pairs

    def pairs(self, values: Array) -> Array:
        if not self.together:
            return values
        pairs = np.zeros((len(values), 2 * len(self.bins)), dtype=values.dtype)
        pairs[:, self.kept] = values
        return pairs.reshape(-1, 2)

    def magnitudes(self) -> SpectrumMap:
        """Return the map with the absolute values of the coefficients."""
        of_x, of_u = (None if part is None else np.abs(part) for part in (self.C, self.D))
        return replace(self, C=of_x, D=of_u)

    @property
    def kept(self) -> Mask:
        """Which of (Re, Im) of each bin are values of a map ``together``, (2 bins,)."""
        kept = np.ones((len(self.bins), 2), dtype=bool)
        kept[self.real, 1] = False
        return kept.ravel()

    def length(self, horizon: int) -> int:
        """Return the number of samples of the signal over a horizon."""
        return horizon + (self.D is None)

    def signal(self, x: Array, u: Array) -> Array:
        """Return y, (samples,)."""
        parts = [part[: self.length(len(u))] @ row for row, part in ((self.C, x), (self.D, u)) if row is not None]
        return sum(parts[1:], parts[0])

    def spread(self, signal: Array, shapes: Shapes) -> tuple[Array, Array]:
        """Return what a change of y by the first samples of a signal is worth in x and u."""
        of_x, of_u = (np.zeros(shape, dtype=signal.dtype) for shape in shapes)
        for row, part in ((self.C, of_x), (self.D, of_u)):
            if row is not None:
                part[: len(signal)] += np.outer(signal, row)
        return of_x, of_u


def signal_rows(of_y: sp.csr_array, row: Array | None, samples: int, columns: int) -> sp.csr_array:
    """Return rows on y_t = row'v_t, (rows, some samples), as rows on v, (rows, samples * columns)."""
    count, total = of_y.shape[0], samples * columns
    if row is None:
        return sp.csr_array((count, total))
    rows = sp.csr_array(sp.kron(of_y, row[None]))
    return sp.csr_array((rows.data, rows.indices, rows.indptr), shape=(count, total))
