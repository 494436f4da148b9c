# ruff: noqa: D102  (a method without a docstring is described by the class that it implements)
"""The spectrum of a linear output of the trajectory at any frequencies, as an affine map."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, Mask
from lin_freq_ocp.problem.terms.maps import AffineMap, Shapes, joined_rows
from lin_freq_ocp.problem.terms.spectrum_map import SpectrumMap, signal_rows


@dataclass(frozen=True, eq=False)
class FrequencyMap(AffineMap):
    """(Re, Im) of Y(w) = sum_t h_t y_t exp(-iwt) at frequencies w, one group each, for y_t = C x_t + D u_t.

    With t = a B + b, exp(-iwt) is a product of two factors, of some sqrt(T) values each.
    """

    C: Array | None  # (n,)
    D: Array | None  # (m,)
    window: Array  # h_t, (samples,)
    at: Array  # w in rad/sample, (groups,)

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.at), 2

    @property
    def samples(self) -> int:
        return len(self.window)

    @property
    def component(self) -> int:
        return self._plain.component

    @property
    def nearest_bins(self) -> Indices:
        return np.rint(self.at * len(self.window) / (2 * np.pi)).astype(int)

    @property
    def positions(self) -> Indices:
        return self.nearest_bins

    @property
    def frequencies(self) -> Array:
        return self.at

    @property
    def places(self) -> Array:
        return self.at

    @property
    def real(self) -> Mask:
        """Which of the values are real for every signal, (groups,)."""
        return np.asarray((self.at == 0) | (self.at == np.pi))

    @property
    def additions(self) -> float:
        return float(4 * len(self.window) + 10)  # that many roundings are in an angle w t

    @property
    def dense_size(self) -> tuple[int, int]:
        rows, signals = 2 * len(self.at), sum(1 for part in (self.C, self.D) if part is not None and part.any())
        return rows, rows * len(self.window) * signals

    def spectrum_of(self, C: Array | None, D: Array | None) -> bool:
        return self._plain.spectrum_of(C, D)

    def values(self, x: Array, u: Array) -> Array:
        found = self.transform(self.signal(x, u))
        return np.stack([found.real, found.imag], axis=1)

    def pull_back(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        first, second = self.factors(weights.dtype)
        turned = (weights[:, 0] + 1j * weights[:, 1])[:, None]
        signal = (np.conj(first).T @ (turned * np.conj(second))).real.reshape(-1)[: self.samples]
        return self._plain.spread(signal * self.window, shapes)

    def rows(self, horizon: int, n: int, m: int) -> tuple[sp.csr_array, Array]:
        of_y = sp.csr_array(self.waves())
        of_x, of_u = signal_rows(of_y, self.C, horizon + 1, n), signal_rows(of_y, self.D, horizon, m)
        return joined_rows(of_x, of_u), np.zeros(2 * len(self.at))

    def sizes(self, x: Array, u: Array) -> Array:
        return np.broadcast_to(self._plain.sizes(x, u)[:1], self.shape)

    def pulled_sizes(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        return self._plain.magnitudes().spread(np.abs(self.window) * np.abs(weights).sum(), shapes)

    def waves(self) -> Array:
        """Return the coefficients of the samples, (2 groups, samples): of Re and Im of each frequency in turn."""
        first, second = self.factors(np.dtype(np.float64))
        whole = (first[:, :, None] * second[:, None, :]).reshape(len(self.at), -1)[:, : self.samples] * self.window
        waves = np.stack([whole.real, whole.imag], axis=1)
        waves[self.real, 1] = 0.0  # and not the rounding error of sin(pi t)
        return waves.reshape(-1, self.samples)

    def transform(self, signal: Array) -> ComplexArray:
        """Return Y of a signal that is windowed already, (groups,)."""
        first, second = self.factors(signal.dtype)
        blocks = np.zeros(first.shape[1] * second.shape[1], dtype=signal.dtype)
        blocks[: len(signal)] = signal
        inner = second @ blocks.reshape(first.shape[1], -1).T
        return (first * inner).sum(axis=1)

    def factors(self, dtype: np.dtype[np.floating]) -> tuple[ComplexArray, ComplexArray]:
        """Return exp(-iw a B), (groups, A), and exp(-iw b), (groups, B), for signals of a type."""
        first, second = self._factors
        return (first, second) if dtype == np.longdouble else (first.astype(complex), second.astype(complex))

    @cached_property
    def _factors(self) -> tuple[ComplexArray, ComplexArray]:
        return self.plain_factors

    @property
    def plain_factors(self) -> tuple[ComplexArray, ComplexArray]:
        """Return the factors in extended precision."""
        B = int(np.ceil(np.sqrt(self.samples)))
        w, A = self.at.astype(np.longdouble)[:, None], -(-self.samples // B)
        return np.exp(-1j * w * (B * np.arange(A))), np.exp(-1j * w * np.arange(B))

    @property
    def _plain(self) -> SpectrumMap:
        """Return the map of the first bin, which has the same signal."""
        return SpectrumMap(self.C, self.D, self.window, len(self.window), np.array([0]))

    def signal(self, x: Array, u: Array) -> Array:
        """Return h_t y_t, (samples,)."""
        return self.window * self._plain.signal(x, u)[: self.samples]

    def placed(self, points: Array) -> FrequencyMap:
        """Return the map to the values at other points."""
        return replace(self, at=points)
