# ruff: noqa: D102
"""Spectra of a linear output y_t = C x_t + D u_t of the trajectory as affine maps.

Their values are at the bins of a DFT, at any frequencies, or at the bins of windows that may begin with known samples
of the past. ``AffineMap`` documents the methods without a docstring.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
import scipy.sparse as sp
from numpy.lib.stride_tricks import sliding_window_view

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, Mask, real_signal
from lin_freq_ocp.problem.terms.maps import AffineMap, Shapes, SpectrumForm, sparse_rows


@dataclass(frozen=True, eq=False)
class OutputMap(AffineMap):
    """A map of the windowed output w_t y_t, y_t = C x_t + D u_t, whose values are (Re, Im) of bins or frequencies."""

    C: Array | None  # (n,)
    D: Array | None  # (m,); y has the samples t = 0 .. T-1, and without D also T
    window: Array  # w_t, (samples,); ones for the plain DFT

    @property
    @abstractmethod
    def real(self) -> Mask:
        """At which bins or frequencies the spectrum is real for every signal, (count,)."""

    @abstractmethod
    def waves(self) -> Array:
        """Return the coefficients of the samples in Re and Im of each bin or frequency in turn, (rows, samples)."""

    @property
    def samples(self) -> int:
        return len(self.window)

    @property
    def component(self) -> int:
        row = self.C if self.C is not None else self.D
        assert row is not None  # one of C and D is stated
        return int(np.flatnonzero(row)[0])

    @property
    def positions(self) -> Indices:
        return self.nearest_bins

    @property
    def dense_size(self) -> tuple[int, int]:
        rows, signals = 2 * len(self.real), sum(1 for part in (self.C, self.D) if part is not None and part.any())
        return rows, rows * len(self.window) * signals

    def spectrum_of(self, C: Array | None, D: Array | None) -> bool:
        return all(
            first is second or (first is not None and second is not None and np.array_equal(first, second))
            for first, second in ((self.C, C), (self.D, D))
        )

    def rows(self, horizon: int, n: int, m: int) -> tuple[sp.csr_array, Array]:
        waves = self.waves()
        return self.signal_rows(waves, np.arange(self.samples), horizon, n, m), np.zeros(len(waves))

    def signal_rows(self, of_y: Array, times: Indices, horizon: int, n: int, m: int) -> sp.csr_array:
        """Return rows on (x, u) from rows on y, (rows, samples), at these times, (samples,) or (rows, samples)."""
        values, columns = list[Array](), list[Indices]()
        for row, first, width in ((self.C, 0, n), (self.D, (horizon + 1) * n, m)):
            if row is not None:
                used = np.flatnonzero(row)
                parts = np.broadcast_arrays(of_y[..., None] * row[used], first + times[..., None] * width + used)
                shape = len(of_y), of_y.shape[1] * len(used)
                values.append(parts[0].reshape(shape))
                columns.append(parts[1].reshape(shape))
        return sparse_rows(np.hstack(values), np.hstack(columns), (horizon + 1) * n + horizon * m)

    def sizes(self, x: Array, u: Array) -> Array:
        """Return the typical size of a bin, the Euclidean norm of w y, for every entry, (groups, dim)."""
        y = self.magnitudes().output(np.abs(x), np.abs(u))[: self.samples]
        return np.full(self.shape, np.sqrt(((self.window * y) ** 2).sum()))

    def pulled_sizes(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        return self.magnitudes().spread(np.abs(self.window) * np.abs(self.pairs(weights)).sum(), shapes)

    def magnitudes(self) -> Self:
        """Return the map with the absolute values of the coefficients."""
        of_x, of_u = (None if part is None else np.abs(part) for part in (self.C, self.D))
        return replace(self, C=of_x, D=of_u)

    def length(self, horizon: int) -> int:
        """Return the number of samples of the signal over a horizon."""
        return horizon + (self.D is None)

    def output(self, x: Array, u: Array) -> Array:
        """Return y, (samples,)."""
        parts = [part[: self.length(len(u))] @ row for row, part in ((self.C, x), (self.D, u)) if row is not None]
        return sum(parts[1:], parts[0])

    def spread(self, signal: Array, shapes: Shapes) -> tuple[Array, Array]:
        """Return the adjoint of ``output`` for weights of its first samples, in the shapes of x and u."""
        of_x, of_u = (np.zeros(shape, dtype=signal.dtype) for shape in shapes)
        for row, part in ((self.C, of_x), (self.D, of_u)):
            if row is not None:
                part[: len(signal)] += np.outer(signal, row)
        return of_x, of_u


@dataclass(frozen=True, eq=False)
class SpectrumMap(OutputMap):
    """(Re, Im) of Y_j = sum_t w_t y_t exp(-2 pi i j t / N) at chosen bins j, for y_t = C x_t + D u_t.

    Each bin is a group (Re, Im); with ``joint``, all of them are a single group. The imaginary parts of bins 0 and N/2
    are zero; a joint group leaves them out.
    """

    points: int  # N: the number of samples, or a multiple of it for a finer grid
    bins: Indices  # (bins,), within 0 .. N/2
    joint: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        return (1, 2 * len(self.bins) - int(self.real.sum())) if self.joint else (len(self.bins), 2)

    @property
    def real(self) -> Mask:
        return np.asarray((self.bins == 0) | (2 * self.bins == self.points))

    @property
    def nearest_bins(self) -> Indices:
        return np.rint(self.bins * len(self.window) / self.points).astype(int)

    @property
    def frequencies(self) -> Array:
        return np.zeros(0) if self.joint else 2 * np.pi * self.bins / self.points

    def spectrum_form(self, n: int, m: int) -> SpectrumForm:
        parts = [np.zeros(size) if part is None else part for part, size in ((self.C, n), (self.D, m))]
        kept = self.kept if self.joint else np.ones(2 * len(self.bins), dtype=bool)
        return SpectrumForm(np.concatenate(parts), self.window, self.points, self.bins, kept)

    @property
    def additions(self) -> float:
        return float(5 * np.log2(self.points) + 10)

    def values(self, x: Array, u: Array) -> Array:
        spectrum = np.fft.rfft(self.window * self.output(x, u)[: self.samples], n=self.points)[self.bins]
        return self.grouped(np.stack([spectrum.real, spectrum.imag], axis=1))

    def pull_back(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        pairs = self.pairs(weights)
        signal = self.signal_of(pairs[:, 0] + 1j * pairs[:, 1])
        return self.spread(signal, shapes)

    def signal_of(self, weights: ComplexArray) -> Array:
        """Return the adjoint of the windowed DFT, (..., samples), for complex weights of the bins, (..., bins)."""
        spectra = np.zeros((*weights.shape[:-1], self.points // 2 + 1), dtype=np.result_type(weights, np.complex64))
        spectra[..., self.bins] = weights
        return real_signal(spectra, self.points)[..., : self.samples] * self.window

    def waves(self) -> Array:
        return self.waves_at(np.arange(self.samples))

    def waves_at(self, times: Array | Indices) -> Array:
        """Return the coefficients, (..., rows, samples), of samples at these times, (..., samples)."""
        angle = 2 * np.pi * (self.bins[:, None] * times[..., None, :] % self.points) / self.points
        waves = np.stack([np.cos(angle), -np.sin(angle)], axis=-2) * self.window
        waves[..., self.real, 1, :] = 0.0  # exactly, without the rounding error of sin(pi t)
        waves = waves.reshape(*times.shape[:-1], -1, self.samples)
        return waves[..., self.kept, :] if self.joint else waves

    def grouped(self, pairs: Array) -> Array:
        """Return values, (groups, dim), from (Re, Im) of every bin, (bins, 2), of one spectrum or several."""
        return pairs.reshape(-1, 2 * len(self.bins))[:, self.kept] if self.joint else pairs

    def pairs(self, values: Array) -> Array:
        if not self.joint:
            return values
        pairs = np.zeros((len(values), 2 * len(self.bins)), dtype=values.dtype)
        pairs[:, self.kept] = values
        return pairs.reshape(-1, 2)

    @property
    def kept(self) -> Mask:
        """Which of (Re, Im) of each bin are values of a joint map, (2 bins,)."""
        kept = np.ones((len(self.bins), 2), dtype=bool)
        kept[self.real, 1] = False
        return kept.ravel()


@dataclass(frozen=True, eq=False)
class FrequencyMap(OutputMap):
    """(Re, Im) of Y(w) = sum_t w_t y_t exp(-iwt) at frequencies w, a group for each, for y_t = C x_t + D u_t.

    With t = a B + b, exp(-iwt) is a product of two factors with about sqrt(T) values each.
    """

    at: Array  # w in rad/sample, (groups,)

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.at), 2

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

    def waves(self) -> Array:
        first, second = self.factors(np.dtype(np.float64))
        products = first[:, :, None] * second[:, None, :]
        whole = products.reshape(len(self.at), math.prod(products.shape[1:]))[:, : self.samples] * self.window
        waves = np.stack([whole.real, whole.imag], axis=1)
        waves[self.real, 1] = 0.0  # exactly, without the rounding error of sin(pi t)
        return waves.reshape(-1, self.samples)

    def transform(self, signal: Array) -> ComplexArray:
        """Return Y of a windowed signal, (groups,)."""
        first, second = self.factors(signal.dtype)
        blocks = np.zeros(first.shape[1] * second.shape[1], dtype=signal.dtype)
        blocks[: len(signal)] = signal
        inner = second @ blocks.reshape(first.shape[1], -1).T
        return (first * inner).sum(axis=1)

    def factors(self, dtype: np.dtype[np.floating]) -> tuple[ComplexArray, ComplexArray]:
        """Return exp(-iw a B), (groups, A), and exp(-iw b), (groups, B), in the precision of a type."""
        first, second = self._factors
        return (first, second) if dtype == np.longdouble else (first.astype(complex), second.astype(complex))

    @cached_property
    def _factors(self) -> tuple[ComplexArray, ComplexArray]:
        """Return the factors in extended precision."""
        B = int(np.ceil(np.sqrt(self.samples)))
        w, A = self.at.astype(np.longdouble)[:, None], -(-self.samples // B)
        return np.exp(-1j * w * (B * np.arange(A))), np.exp(-1j * w * np.arange(B))

    def signal(self, x: Array, u: Array) -> Array:
        """Return w_t y_t, (samples,)."""
        return self.window * self.output(x, u)[: self.samples]

    def at_points(self, points: Array) -> FrequencyMap:
        """Return the same map at other points."""
        return replace(self, at=points)


PI = np.arccos(np.longdouble(-1.0))


@dataclass(frozen=True, eq=False)
class SpectrogramMap(AffineMap):
    """(Re, Im) of Y_sj = sum_i w_i y_{s+i} exp(-2 pi i j (s+i) / N) for windows from s on, and bins j of each of them.

    The phase refers to time 0. The groups are those of ``spectrum``, window by window. Windows that end after the
    signal hold its last sample.
    """

    constants: ClassVar[tuple[str, ...]] = ("past",)
    spectrum: SpectrumMap  # of the first window's length
    starts: Indices  # s, (windows,), not before the past begins
    past: Array  # (P,): y at times -P .. -1
    held: bool = False  # whether windows may end after the signal

    @property
    def shape(self) -> tuple[int, int]:
        groups, dim = self.spectrum.shape
        return len(self.starts) * groups, dim

    @property
    def positions(self) -> Indices:
        return np.repeat(np.maximum(self.starts, 0), self.spectrum.shape[0])

    @property
    def additions(self) -> float:
        return self.spectrum.additions + 2

    @property
    def component(self) -> int:
        return self.spectrum.component

    @property
    def dense_size(self) -> tuple[int, int]:
        rows, entries = self.spectrum.dense_size
        return len(self.starts) * rows, len(self.starts) * entries

    def values(self, x: Array, u: Array) -> Array:
        spectra = np.fft.rfft(self._frames(self.spectrum.output(x, u)), n=self.spectrum.points, axis=1)
        turned = spectra[:, self.spectrum.bins] * self._turns.astype(spectra.dtype)
        pairs = np.stack([turned.real, turned.imag], axis=-1)
        pairs[:, self.spectrum.real, 1] = 0.0  # exactly, without the rounding error of a factor 1
        return self.spectrum.grouped(pairs.reshape(-1, 2))

    def pull_back(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        pairs = self._window_pairs(weights)
        turned = pairs[..., 0] + 1j * pairs[..., 1]
        frames = self.spectrum.signal_of(turned * np.conj(self._turns.astype(turned.dtype)))
        return self.spectrum.spread(self._add_windows(frames, shapes), shapes)

    def rows(self, horizon: int, n: int, m: int) -> tuple[sp.csr_array, Array]:
        base = self.spectrum
        times = self.starts[:, None] + np.arange(base.samples)
        waves = np.where(times[:, None] >= 0, base.waves_at(times), 0.0)
        last = np.minimum(times, base.length(horizon) - 1)
        each = np.repeat(last, waves.shape[1], axis=0)
        constant = self.values(np.zeros((horizon + 1, n)), np.zeros((horizon, m))).ravel()
        found = base.signal_rows(waves.reshape(each.shape), each, horizon, n, m)
        found.sum_duplicates()  # of a held sample
        return found, constant

    def sizes(self, x: Array, u: Array) -> Array:
        y = self.spectrum.magnitudes().output(np.abs(x), np.abs(u))
        norms = np.linalg.norm(self._frames(y, np.abs(self.past)), axis=1)
        return np.broadcast_to(np.repeat(norms, self.spectrum.shape[0])[:, None], self.shape)

    def pulled_sizes(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        total = np.abs(self._window_pairs(weights)).sum(axis=(1, 2))
        frames = total[:, None] * np.abs(self.spectrum.window)
        return self.spectrum.magnitudes().spread(self._add_windows(frames, shapes), shapes)

    def spectrum_form(self, n: int, m: int) -> SpectrumForm | None:
        if len(self.starts) > 1 or self.held:
            return None
        form, first = self.spectrum.spectrum_form(n, m), int(self.starts[0])
        window = np.append(np.zeros(max(first, 0)), form.window[max(-first, 0) :])
        return None if len(window) > form.points else SpectrumForm(form.row, window, form.points, form.bins, form.kept)

    def pairs(self, values: Array) -> Array:
        return self._window_pairs(values).reshape(-1, 2)

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

    @property
    def _turns(self) -> ComplexArray:
        """Return exp(-2 pi i j s / N) in extended precision, (windows, bins)."""
        base = self.spectrum
        return np.exp(-2j * PI * (np.outer(self.starts, base.bins) % base.points) / base.points)

    def _window_pairs(self, values: Array) -> Array:
        """Return (Re, Im) of every bin of every window, (windows, bins, 2)."""
        return self.spectrum.pairs(values).reshape(len(self.starts), -1, 2)

    def _frames(self, y: Array, past: Array | None = None) -> Array:
        """Return the windows of the past and of y, times their weights, (windows, samples)."""
        beyond = max(int(self.starts.max()) + self.spectrum.samples - len(y), 0)
        whole = np.concatenate([self.past if past is None else past, y, np.repeat(y[-1:], beyond)])
        frames = sliding_window_view(whole, self.spectrum.samples)[len(self.past) + self.starts]
        return frames * self.spectrum.window

    def _add_windows(self, frames: Array, shapes: Shapes) -> Array:
        """Return the sum of the windows at each time from 0 on."""
        P, samples = len(self.past), self.spectrum.length(shapes[1][0])
        signal = np.zeros(P + samples, dtype=frames.dtype)
        times = np.minimum(self.starts[:, None] + np.arange(frames.shape[1]), samples - 1)
        np.add.at(signal, P + times, frames)
        return signal[P:]
