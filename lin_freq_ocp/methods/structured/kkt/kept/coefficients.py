"""Controls by the Fourier coefficients that their stop bands keep: u = N z + u_p.

The real DFT of a control, t < T, is orthonormal here: Re and Im of every bin in turn, times 1/sqrt(T) at the bins
0 and T/2, and sqrt(2/T) between. A stop band fixes some of these coefficients, the others are z; z of a control without
a stop band are its samples, t <= T. Vectors are the rows of arrays, so that transforms run along contiguous memory.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.methods.structured.model.coupling import Rows, SpectrumRows
from lin_freq_ocp.methods.structured.model.stages import Stages


@dataclass(frozen=True, eq=False)
class StopBand:
    """Rows of F that fix coefficients of one entry of w: F u = gain * coefficient."""

    entry: int
    rows: Indices  # within F
    coefficients: Indices  # 2 bin + (0: Re, 1: Im)
    gain: Array


@dataclass(frozen=True, eq=False)
class Remaining:
    """A family of rows that fixes no coefficients, and its rows of F."""

    rows: Rows
    at: Indices


def sort_rows(stages: Stages) -> tuple[list[StopBand], list[Remaining]]:
    """Return the stop bands among the coupling rows beyond x_T, and the rest."""
    taken: dict[int, set[int]] = {}
    bands: list[StopBand] = []
    rest: list[Remaining] = []
    equations = len(stages.coupling.equations)
    for i, (rows, at) in enumerate(stages.coupling.families()):
        band = _stop_band(stages, rows, at) if i < equations else None
        if band is None or not taken.setdefault(band.entry, set()).isdisjoint(band.coefficients.tolist()):
            rest.append(Remaining(rows, at))
        else:
            taken[band.entry].update(band.coefficients.tolist())
            bands.append(band)
    return bands, rest


def _stop_band(stages: Stages, rows: Rows, at: Indices) -> StopBand | None:
    """Return the stop band that rows are, if they are the plain DFT of a single control."""
    if not isinstance(rows, SpectrumRows) or rows.points != stages.horizon:
        return None
    used, T, n = np.flatnonzero(rows.coefficients), stages.horizon, stages.states
    even = len(rows.window) == T and bool(np.all(rows.window == rows.window[0]))
    if len(used) != 1 or stages.coupling.channels[used[0]] < n or not even or len(set(rows.bins)) < len(rows.bins):
        return None
    pairs = (2 * rows.bins[:, None] + [0, 1]).ravel()[rows.kept]
    factor = np.repeat(rows.scale, 2)[rows.kept] * rows.window[0] * rows.coefficients[used[0]]
    unit = unit_scale(T)[pairs]
    if not np.all(unit * factor):
        return None
    return StopBand(int(stages.coupling.channels[used[0]] - n), at, pairs, factor / unit)


def unit_scale(T: int) -> Array:
    """Return the factors that make the DFT orthonormal, (2 bins,); zero for the imaginary parts that do not exist."""
    scale = np.full((T // 2 + 1, 2), np.sqrt(2 / T))
    scale[0] = np.sqrt(1 / T), 0.0
    if T % 2 == 0:
        scale[-1] = np.sqrt(1 / T), 0.0
    return scale.ravel()


class Coefficients:
    """The coefficients z of all controls, one after the other."""

    def __init__(self, stages: Stages, bands: list[StopBand], controls: Indices):
        self.horizon = stages.horizon
        self._scale = unit_scale(self.horizon)
        self._bands = [(int(np.flatnonzero(controls == band.entry)[0]), band) for band in bands]
        self._kept: list[Indices | None] = []
        for j in range(len(controls)):
            stopped = [band.coefficients for control, band in self._bands if control == j]
            exist = self._scale > 0
            for part in stopped:
                exist[part] = False
            self._kept.append(np.flatnonzero(exist) if stopped else None)
        counts = [self.horizon + 1 if kept is None else len(kept) for kept in self._kept]
        self._ends = np.cumsum([0, *counts])
        self.count = int(self._ends[-1])
        self.stop_rows = np.concatenate([np.zeros(0, dtype=np.intp), *(band.rows for band in bands)])
        self.banded = np.array([kept is not None for kept in self._kept], dtype=bool)

    def analysis(self, w: Array) -> Array:
        """Return N'w, (m, count), for signals (T+1, controls, m)."""
        z = np.empty((w.shape[2], self.count))
        for j, kept in enumerate(self._kept):
            own = z[:, self._ends[j] : self._ends[j + 1]]
            if kept is None:
                own[:] = w[:, j].T
            else:
                signals = np.ascontiguousarray(w[:-1, j].T)
                np.multiply(self._transformed(signals)[:, kept], self._scale[kept], out=own)
        return z

    def synthesis(self, z: Array) -> Array:
        """Return N z, (T+1, controls, m), for coefficients (m, count)."""
        w = np.zeros((self.horizon + 1, len(self._kept), len(z)))
        for j, kept in enumerate(self._kept):
            own = z[:, self._ends[j] : self._ends[j + 1]]
            if kept is None:
                w[:, j] = own.T
            else:
                w[:-1, j] = self._signals(kept, own).T
        return w

    def particular(self, f: Array) -> Array:
        """Return u_p (T+1, controls), which has no kept coefficient and satisfies the stop bands, F u_p = f."""
        w = np.zeros((self.horizon + 1, len(self._kept)))
        for j, band in self._bands:
            values = f[band.rows] / band.gain
            if values.any():
                w[:-1, j] += self._signals(band.coefficients, values[None])[0]
        return w

    def multipliers(self, gw: Array, nu: Array) -> None:
        """Write into nu (rows of F,) those of the stop bands, which cancel a gradient (T+1, controls)."""
        for j, band in self._bands:
            pairs = self._transformed(np.ascontiguousarray(gw[None, :-1, j]))[0]
            nu[band.rows] = -pairs[band.coefficients] * self._scale[band.coefficients] / band.gain

    def stopped(self, j: int, signals: Array) -> Array:
        """Return signals (m, T) of a control without their kept coefficients."""
        kept = self._kept[j]
        if kept is None:
            return np.zeros_like(signals)
        return signals - self._signals(kept, self._transformed(signals)[:, kept] * self._scale[kept])

    @staticmethod
    def _transformed(signals: Array) -> Array:
        """Return the DFT of signals (m, T), Re and Im in turn."""
        return fft.rfft(signals, axis=1).view(np.float64)

    def _signals(self, chosen: Indices, values: Array) -> Array:
        """Return the signals (m, T) of some coefficients (m, chosen)."""
        pairs = np.zeros((len(values), len(self._scale)))
        pairs[:, chosen] = values / self._scale[chosen]
        return fft.irfft(pairs.view(np.complex128), n=self.horizon, axis=1)
