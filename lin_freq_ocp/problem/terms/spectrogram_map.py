# ruff: noqa: D102  (a method without a docstring is described by the class that it implements)
"""DFT bins of windows of a linear output, of which samples before time 0 are data, as an affine map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.lib.stride_tricks import sliding_window_view
from scipy import fft

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices
from lin_freq_ocp.problem.terms.maps import AffineMap, Shapes, SpectrumForm, joined_rows
from lin_freq_ocp.problem.terms.spectrum_map import SpectrumMap, signal_rows

PI = np.arccos(np.longdouble(-1.0))


@dataclass(frozen=True, eq=False)
class SpectrogramMap(AffineMap):
    """(Re, Im) of Y_sj = sum_i w_i y_{s+i} exp(-2 pi i j (s+i) / N) for windows from s on, and bins j of each of them.

    The phase is counted from time 0. Groups are those of ``spectrum``, window by window.
    """

    spectrum: SpectrumMap  # of the first window's length
    starts: Indices  # s, (windows,), not before the past begins
    past: Array  # (P,): y at times -P .. -1

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
        found = fft.rfft(self._frames(self.spectrum.signal(x, u)), n=self.spectrum.points, axis=1)
        turned = found[:, self.spectrum.bins] * self._turns.astype(found.dtype)
        pairs = np.stack([turned.real, turned.imag], axis=-1)
        pairs[:, self.spectrum.real, 1] = 0.0  # and not rounding of a factor of one
        return self.spectrum.grouped(pairs.reshape(-1, 2))

    def pull_back(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        base, pairs = self.spectrum, self._window_pairs(weights)
        k = np.arange(base.points // 2 + 1)
        factor = np.where((k == 0) | (2 * k == base.points), 1.0, 0.5)
        spectra = np.zeros((len(self.starts), len(k)), dtype=np.result_type(pairs, np.complex64))
        spectra[:, base.bins] = (pairs[..., 0] + 1j * pairs[..., 1]) * np.conj(self._turns.astype(spectra.dtype))
        frames = fft.irfft(base.points * factor * spectra, n=base.points, axis=1)
        return base.spread(self._added(frames[:, : base.samples] * base.window, shapes), shapes)

    def rows(self, horizon: int, n: int, m: int) -> tuple[sp.csr_array, Array]:
        base, L = self.spectrum, self.spectrum.samples
        times = self.starts[:, None] + np.arange(L)
        angle = 2 * np.pi * (times[:, None, :] * base.bins[:, None] % base.points) / base.points
        waves = np.stack([np.cos(angle), -np.sin(angle)], axis=2) * base.window
        waves[:, base.real, 1] = 0.0
        waves = waves.reshape(len(self.starts), -1, L)
        waves = waves[:, base.kept] if base.together else waves
        here = np.broadcast_to(times[:, None] >= 0, waves.shape)
        row = np.broadcast_to(np.arange(waves.size // L).reshape(*waves.shape[:2], 1), waves.shape)[here]
        column = np.broadcast_to(times[:, None], waves.shape)[here]
        of_y = sp.csr_array((waves[here], (row, column)), shape=(waves.size // L, base.length(horizon)))
        of_x, of_u = signal_rows(of_y, base.C, horizon + 1, n), signal_rows(of_y, base.D, horizon, m)
        return joined_rows(of_x, of_u), self.values(np.zeros((horizon + 1, n)), np.zeros((horizon, m))).ravel()

    def sizes(self, x: Array, u: Array) -> Array:
        y = self.spectrum.magnitudes().signal(np.abs(x), np.abs(u))
        norms = np.linalg.norm(self._frames(y, np.abs(self.past)), axis=1)
        return np.broadcast_to(np.repeat(norms, self.spectrum.shape[0])[:, None], self.shape)

    def pulled_sizes(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        total = np.abs(self._window_pairs(weights)).sum(axis=(1, 2))
        frames = total[:, None] * np.abs(self.spectrum.window)
        return self.spectrum.magnitudes().spread(self._added(frames, shapes), shapes)

    def spectrum_form(self, n: int, m: int) -> SpectrumForm | None:
        if len(self.starts) > 1:
            return None
        form, first = self.spectrum.spectrum_form(n, m), int(self.starts[0])
        window = np.append(np.zeros(max(first, 0)), form.window[max(-first, 0) :])
        return None if len(window) > form.points else SpectrumForm(form.row, window, form.points, form.bins, form.kept)

    def pairs(self, values: Array) -> Array:
        return self._window_pairs(values).reshape(-1, 2)

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
        whole = np.concatenate([self.past if past is None else past, y])
        frames = sliding_window_view(whole, self.spectrum.samples)[len(self.past) + self.starts]
        return frames * self.spectrum.window

    def _added(self, frames: Array, shapes: Shapes) -> Array:
        """Return the sum of windows over each time from 0 on."""
        P, samples = len(self.past), self.spectrum.length(shapes[1][0])
        signal = np.zeros(P + samples, dtype=frames.dtype)
        np.add.at(signal, P + self.starts[:, None] + np.arange(frames.shape[1]), frames)
        return signal[P:]
