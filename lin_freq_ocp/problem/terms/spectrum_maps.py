# ruff: noqa: D102
"""Spectra of a linear output y_t = C x_t + D u_t of the trajectory as affine maps.

Their values are at the bins of a DFT, of the whole output or of windows that may begin with known samples of the past,
or at any frequencies. ``AffineMap`` and ``OutputMap`` document the methods without a docstring.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
import scipy.sparse as sp
from numpy.lib.stride_tricks import sliding_window_view

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, Mask, real_signal, to_long_double
from lin_freq_ocp.problem.terms.maps import OutputMap, Shapes, SpectrumForm

PI = np.arccos(np.longdouble(-1.0))


@dataclass(frozen=True, eq=False)
class SpectrumMap(OutputMap):
    """(Re, Im) of Y_sj = sum_i w_i y_{s+i} exp(-2 pi i j (s+i) / N) at chosen bins j, of windows from samples s on.

    By default, the one window is the whole output. Each bin of a window is a group (Re, Im); with ``joint``, all of
    them are a single group. The imaginary parts of bins 0 and N/2 are zero; a joint group leaves them out. Windows that
    end after the output hold its last sample.
    """

    constants: ClassVar[tuple[str, ...]] = ("past",)
    points: int  # N: the number of samples, or a multiple of it for a finer grid
    bins: Indices  # (bins,), within 0 .. N/2
    joint: bool = False
    starts: Indices = field(default_factory=lambda: np.zeros(1, dtype=np.intp))  # s, (windows,), within the past and y
    past: Array = field(default_factory=lambda: np.zeros(0))  # (P,): y at times -P .. -1
    held: bool = False  # whether windows may end after the output

    @property
    def spectrum(self) -> SpectrumMap | None:
        whole = len(self.starts) == 1 and not (self.starts[0] or len(self.past) or self.held)
        return self if whole else None

    @property
    def shape(self) -> tuple[int, int]:
        count = len(self.starts)
        return (count, int(self.kept.sum())) if self.joint else (count * len(self.bins), 2)

    @property
    def positions(self) -> Indices:
        of_windows = np.repeat(np.maximum(self.starts, 0), self.shape[0] // len(self.starts))
        return of_windows if self.spectrum is None else self.nearest_bins

    @property
    def real(self) -> Mask:
        return np.asarray((self.bins == 0) | (2 * self.bins == self.points))

    @property
    def kept(self) -> Mask:
        """Which of (Re, Im) of each bin are values of a joint map, (2 bins,)."""
        kept = np.ones((len(self.bins), 2), dtype=bool)
        kept[self.real, 1] = False
        return kept.ravel()

    @property
    def nearest_bins(self) -> Indices:
        return np.rint(self.bins * len(self.window) / self.points).astype(int)

    @property
    def frequencies(self) -> Array:
        return np.zeros(0) if self.joint else 2 * np.pi * self.bins / self.points

    @property
    def dense_size(self) -> tuple[int, int]:
        rows, entries = super().dense_size
        return len(self.starts) * rows, len(self.starts) * entries

    def spectrum_form(self, n: int, m: int) -> SpectrumForm | None:
        if len(self.starts) > 1 or self.held:
            return None
        row = np.concatenate([np.zeros(k) if part is None else part for part, k in ((self.C, n), (self.D, m))])
        kept = self.kept if self.joint else np.ones(2 * len(self.bins), dtype=bool)
        first = int(self.starts[0])
        window = np.append(np.zeros(max(first, 0)), self.window[max(-first, 0) :])
        return None if len(window) > self.points else SpectrumForm(row, window, self.points, self.bins, kept)

    @property
    def additions(self) -> float:
        return float(5 * np.log2(self.points) + 10) + (2 if self.starts.any() else 0)

    def values(self, x: Array, u: Array) -> Array:
        spectra = np.fft.rfft(self._frames(self.output(x, u), self.past), n=self.points, axis=1)[:, self.bins]
        turned = spectra * self._turns.astype(spectra.dtype)
        pairs = np.stack([turned.real, turned.imag], axis=-1)
        pairs[:, self.real, 1] = 0.0  # exactly, without the rounding error of a factor 1
        return pairs.reshape(-1, 2 * len(self.bins))[:, self.kept] if self.joint else pairs.reshape(-1, 2)

    def pull_back(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        pairs = self._window_pairs(weights)
        turned = pairs[..., 0] + 1j * pairs[..., 1]
        spectra = np.zeros((len(self.starts), self.points // 2 + 1), dtype=turned.dtype)
        spectra[:, self.bins] = turned * np.conj(self._turns.astype(turned.dtype))
        frames = real_signal(spectra, self.points)[:, : self.samples] * self.window
        return self.spread(self._add_windows(frames, shapes), shapes)

    def rows(self, horizon: int, n: int, m: int) -> tuple[sp.csr_array, Array]:
        times = self.starts[:, None] + np.arange(self.samples)
        waves = self._waves_at(times) * (times >= 0)[:, None]
        last = np.broadcast_to(np.minimum(times, self.length(horizon) - 1)[:, None], waves.shape)
        constant = self.values(np.zeros((horizon + 1, n)), np.zeros((horizon, m))).ravel()
        each = -1, self.samples
        found = self.signal_rows(waves.reshape(each), last.reshape(each), horizon, n, m)
        found.sum_duplicates()  # of a held sample
        return found, constant

    def waves(self) -> Array:
        return self._waves_at(np.arange(self.samples))

    def _waves_at(self, times: Array | Indices) -> Array:
        """Return the coefficients, (..., rows, samples), of samples at these times, (..., samples)."""
        angle = 2 * np.pi * (self.bins[:, None] * times[..., None, :] % self.points) / self.points
        waves = np.stack([np.cos(angle), -np.sin(angle)], axis=-2) * self.window
        waves[..., self.real, 1, :] = 0.0  # exactly, without the rounding error of sin(pi t)
        waves = waves.reshape(*times.shape[:-1], -1, self.samples)
        return waves[..., self.kept, :] if self.joint else waves

    def sizes(self, x: Array, u: Array) -> Array:
        """Return the typical size of a bin, the Euclidean norm of w y, for every entry, (groups, dim)."""
        frames = self._frames(self.magnitudes().output(np.abs(x), np.abs(u)), np.abs(self.past))
        norms = np.sqrt((frames**2).sum(axis=1))
        return np.broadcast_to(np.repeat(norms, self.shape[0] // len(norms))[:, None], self.shape)

    def pulled_sizes(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        total = np.abs(self._window_pairs(weights)).sum(axis=(1, 2))
        frames = total[:, None] * np.abs(self.window)
        return self.magnitudes().spread(self._add_windows(frames, shapes), shapes)

    def pairs(self, values: Array) -> Array:
        """Return (Re, Im) of every bin of every window, (windows * bins, 2)."""
        if not self.joint:
            return values
        pairs = np.zeros((len(values), 2 * len(self.bins)), dtype=values.dtype)
        pairs[:, self.kept] = values
        return pairs.reshape(-1, 2)

    def gauges(self, u: Array, facets: int | None) -> Array:
        """Return |Y| of each group for controls u (T, m), or the radius of the regular polygon with it on the boundary.

        The first of so many facets of the polygon is that of the real axis, where phases refer to the windows.
        """
        pairs = self.values(u, u)
        if facets is None:
            return np.linalg.norm(pairs, axis=1)
        own = (pairs[:, 0] + 1j * pairs[:, 1]) * np.conj(self._turns.astype(np.complex128)).ravel()
        directions = np.exp(-2j * np.pi * np.arange(facets) / facets)
        return (own[:, None] * directions).real.max(axis=1) / np.cos(np.pi / facets)

    @cached_property
    def _turns(self) -> ComplexArray:
        """Return exp(-2 pi i j s / N) in extended precision, (windows, bins)."""
        return np.exp(-2j * PI * (np.outer(self.starts, self.bins) % self.points) / self.points)

    def _window_pairs(self, values: Array) -> Array:
        """Return (Re, Im) of every bin of every window, (windows, bins, 2)."""
        return self.pairs(values).reshape(len(self.starts), -1, 2)

    def _frames(self, y: Array, past: Array) -> Array:
        """Return the windows of the past and of y, times their weights, (windows, samples)."""
        beyond = max(int(self.starts.max()) + self.samples - len(y), 0)
        whole = np.concatenate([past, y, np.repeat(y[-1:], beyond)])
        return sliding_window_view(whole, self.samples)[len(past) + self.starts] * self.window

    def _add_windows(self, frames: Array, shapes: Shapes) -> Array:
        """Return the sum of the windows at each time from 0 on."""
        P, samples = len(self.past), self.length(shapes[1][0])
        signal = np.zeros(P + samples, dtype=frames.dtype)
        times = np.minimum(self.starts[:, None] + np.arange(frames.shape[1]), samples - 1)
        np.add.at(signal, P + times, frames)
        return signal[P:]


@dataclass(frozen=True, eq=False)
class FrequencyMap(OutputMap):
    """(Re, Im) of g sum_t w_t y_t exp(r (t - t_0)) at points of a set, a group for each, for y_t = C x_t + D u_t.

    Here, points are frequencies w in rad/sample, with g = 1, r = -iw and t_0 = 0. With t = a B + b, exp(rt) is a
    product of two factors with about sqrt(T) values each.
    """

    at: Array  # the points, (groups,), or (groups, parameters)
    scaled: ClassVar[bool] = False  # whether g differs from 1: then the values belong to no frequency of the output

    @property
    def gain(self) -> ComplexArray:
        """Return g, (groups,), in extended precision; no term of a value is larger than |g| times its sample."""
        return to_long_double(np.ones(len(self.at)) + 0j)

    @property
    def exponents(self) -> ComplexArray:
        """Return r, (groups,), in extended precision."""
        return -1j * to_long_double(self.at)

    @property
    def first_power(self) -> int:
        """Return -t_0."""
        return 0

    @property
    def spectrum(self) -> FrequencyMap | None:
        return None if self.scaled else self

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.at), 2

    @property
    def positions(self) -> Indices:
        return np.arange(0) if self.scaled else self.nearest_bins

    @property
    def nearest_bins(self) -> Indices:
        return np.rint(self.at * len(self.window) / (2 * np.pi)).astype(int)

    @property
    def frequencies(self) -> Array:
        return self.at

    @property
    def locations(self) -> Array:
        return self.at

    @property
    def real(self) -> Mask:
        return np.asarray((self.at == 0) | (self.at == np.pi))

    @property
    def additions(self) -> float:
        return float(4 * len(self.window) + 10)  # that many roundings are in an angle w t

    def values(self, x: Array, u: Array) -> Array:
        spectrum = self.transform(self.signal(x, u))
        return np.stack([spectrum.real, spectrum.imag], axis=1)

    def pull_back(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        first, second = self.factors(weights.dtype)
        turned = (weights[:, 0] + 1j * weights[:, 1])[:, None]
        signal = (np.conj(first).T @ (turned * np.conj(second))).real.reshape(-1)[: self.samples]
        return self.spread(signal * self.window, shapes)

    def rows(self, horizon: int, n: int, m: int) -> tuple[sp.csr_array, Array]:
        waves = self.waves()
        return self.signal_rows(waves, np.arange(self.samples), horizon, n, m), np.zeros(len(waves))

    def waves(self) -> Array:
        first, second = self.factors(np.dtype(np.float64))
        products = first[:, :, None] * second[:, None, :]
        whole = products.reshape(len(self.at), math.prod(products.shape[1:]))[:, : self.samples] * self.window
        waves = np.stack([whole.real, whole.imag], axis=1)
        waves[self.real, 1] = 0.0  # exactly, without the rounding error of sin(pi t)
        return waves.reshape(-1, self.samples)

    def sizes(self, x: Array, u: Array) -> Array:
        """Return the typical size of a value, the Euclidean norm of w y times |g|, for every entry, (groups, dim)."""
        y = self.magnitudes().output(np.abs(x), np.abs(u))[: self.samples]
        norm = np.sqrt(((self.window * y) ** 2).sum())
        return np.full(self.shape, norm) * np.abs(self.gain.astype(complex))[:, None]

    def pulled_sizes(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        total = np.abs(weights * np.abs(self.gain.astype(complex))[:, None]).sum()
        return self.magnitudes().spread(np.abs(self.window) * total, shapes)

    def transform(self, signal: Array) -> ComplexArray:
        """Return Y of a windowed signal, (groups,)."""
        first, second = self.factors(signal.dtype)
        blocks = np.zeros(first.shape[1] * second.shape[1], dtype=signal.dtype)
        blocks[: len(signal)] = signal
        inner = second @ blocks.reshape(first.shape[1], -1).T
        return (first * inner).sum(axis=1)

    def factors(self, dtype: np.dtype[np.floating]) -> tuple[ComplexArray, ComplexArray]:
        """Return g exp(r (a B - t_0)), (groups, A), and exp(r b), (groups, B), in the precision of a type."""
        first, second = self._factors
        return (first, second) if dtype == np.longdouble else (first.astype(complex), second.astype(complex))

    @cached_property
    def _factors(self) -> tuple[ComplexArray, ComplexArray]:
        """Return the factors in extended precision."""
        B, r = int(np.ceil(np.sqrt(self.samples))), self.exponents[:, None]
        powers = B * np.arange(-(-self.samples // B)) + self.first_power
        return self.gain[:, None] * np.exp(r * powers), np.exp(r * np.arange(B))

    def signal(self, x: Array, u: Array) -> Array:
        """Return w_t y_t, (samples,)."""
        return self.window * self.output(x, u)[: self.samples]

    def at_points(self, points: Array) -> FrequencyMap:
        """Return the same map at other points."""
        return replace(self, at=points)
