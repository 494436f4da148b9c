"""Affine maps of a trajectory, (x, u) -> values (groups, dim): stages, spectra, and sums over all times.

Each has ``values`` and ``pull_back``, its adjoint: <lambda, values(x, u) - values(0, 0)> = <pull_back(lambda), (x, u)>.
``sizes`` and ``pulled_sizes`` are the same for absolute values: what rounding errors are relative to.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

from lin_freq_ocp.arrays import Array, Indices, Mask

Shapes = tuple[tuple[int, ...], tuple[int, ...]]
"""The shapes of x, (T+1, n), and of u, (T, m)."""


@dataclass(frozen=True, eq=False)
class StageMap:
    """v_t = C_t x_t + D_t u_t + c_t at some times, one group for each.

    Attributes
    ----------
    times : (groups,)
        Within 0 .. T where D is None or the control is not looked at, else within 0 .. T-1.
    C : (dim, n) or (groups, dim, n), or None
    D : (dim, m) or (groups, dim, m), or None
    constant : (dim,) or (groups, dim)
    """

    times: Indices
    C: Array | None
    D: Array | None
    constant: Array

    @property
    def shape(self) -> tuple[int, int]:
        """Return (groups, dim) of the values."""
        return len(self.times), self.constant.shape[-1]

    @property
    def places(self) -> Indices:
        """Return the time of every group."""
        return self.times

    @property
    def additions(self) -> float:
        """Return how many operations in a row make one value: rounding errors grow with it."""
        return float(sum(part.shape[-1] for part in (self.C, self.D) if part is not None) + self.constant.shape[-1])

    def values(self, x: Array, u: Array) -> Array:
        """Return v, (groups, dim), for x (T+1, n) and u (T, m)."""
        v = np.broadcast_to(self.constant, self.shape).astype(np.result_type(x, u))
        for matrix, signal in ((self.C, x), (self.D, u)):
            if matrix is not None:
                v = v + _product(matrix, signal[self.times])
        return v

    def pull_back(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        """Return the adjoint's values, of the shapes of x and u."""
        pulled = tuple(np.zeros(shape, dtype=weights.dtype) for shape in shapes)
        for matrix, signal in zip((self.C, self.D), pulled, strict=True):
            if matrix is not None:
                np.add.at(signal, self.times, _product(np.swapaxes(matrix, -1, -2), weights))
        return pulled[0], pulled[1]

    def sizes(self, x: Array, u: Array) -> Array:
        """Return the sums of the absolute values of the terms of v, (groups, dim)."""
        return self._absolute().values(np.abs(x), np.abs(u))

    def pulled_sizes(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        """Return the sums of the absolute values of the terms of ``pull_back``."""
        return self._absolute().pull_back(np.abs(weights), shapes)

    def _absolute(self) -> StageMap:
        C, D = (None if part is None else np.abs(part) for part in (self.C, self.D))
        return StageMap(self.times, C, D, np.abs(self.constant))


@dataclass(frozen=True, eq=False)
class SpectrumMap:
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


@dataclass(frozen=True, eq=False)
class SumMap:
    """v = constant + sum_t (Phi_t x_t + Psi_t u_t), a single group (paper, (SFC) and (CFC)).

    Attributes
    ----------
    Phi : (T+1, dim, n), or None; Psi : (T, dim, m), or None
    constant : (dim,)
    """

    Phi: Array | None
    Psi: Array | None
    constant: Array

    @property
    def shape(self) -> tuple[int, int]:
        """Return (groups, dim) of the values."""
        return 1, len(self.constant)

    @property
    def places(self) -> Indices:
        """Return all times."""
        return np.arange(len(next(part for part in (self.Phi, self.Psi) if part is not None)))

    @property
    def additions(self) -> float:
        """Return how many operations in a row make one value: rounding errors grow with it."""
        return float(sum(part.shape[0] + part.shape[2] for part in (self.Phi, self.Psi) if part is not None))

    def values(self, x: Array, u: Array) -> Array:
        """Return v, (1, dim), for x (T+1, n) and u (T, m)."""
        v = self.constant.astype(np.result_type(x, u))
        for matrix, signal in ((self.Phi, x), (self.Psi, u)):
            if matrix is not None:
                v = v + np.einsum("tij,tj->i", matrix, signal)
        return v[None]

    def pull_back(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        """Return the adjoint's values, of the shapes of x and u."""
        of_x, of_u = (
            np.zeros(shape, dtype=weights.dtype) if matrix is None else np.einsum("tij,i->tj", matrix, weights[0])
            for matrix, shape in zip((self.Phi, self.Psi), shapes, strict=True)
        )
        return of_x, of_u

    def sizes(self, x: Array, u: Array) -> Array:
        """Return the sums of the absolute values of the terms of v, (1, dim)."""
        return self._absolute().values(np.abs(x), np.abs(u))

    def pulled_sizes(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        """Return the sums of the absolute values of the terms of ``pull_back``."""
        return self._absolute().pull_back(np.abs(weights), shapes)

    def _absolute(self) -> SumMap:
        Phi, Psi = (None if part is None else np.abs(part) for part in (self.Phi, self.Psi))
        return SumMap(Phi, Psi, np.abs(self.constant))


TrajectoryMap = StageMap | SpectrumMap | SumMap


def _product(matrix: Array, vectors: Array) -> Array:
    """Return M v_g, or M_g v_g where the matrix has one per group, for vectors (groups, columns)."""
    return vectors @ matrix.T if matrix.ndim == 2 else np.einsum("gij,gj->gi", matrix, vectors)
