"""The linear program of the structured method: stages, and rows that couple times.

    minimise    sum_t 1/2 y_t'H_t y_t + h_t'y_t + constant,  t = 0 .. T,  y_t = (x_t, w_t)
    subject to  x_{t+1} = A_t x_t + B_t w_t + d_t,  t < T;   x_0 given where it is fixed
                s_t = g_t - G_t y_t in K:  entries >= 0, then second-order cones s_0 >= |(s_1, ...)|
                coupling rows F on several times: frequency constraints, a fixed x_T, linear equations and inequalities

w_t contains the controls u_t, then slacks, on which no state depends. At t = T, A, B and d are zero, and u_T costs
1/2 |u_T|^2, so that all stages have the same form. Coupling rows depend on some entries of y_t only, the *channels*:
signals Y (T+1, channels, k) are those entries of k trajectories. A family of rows maps signals to values (count, k),
and has the adjoint of that map.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask


@dataclass(frozen=True, eq=False)
class Stages:
    """The arrays of a problem, contiguous, with n states, k entries of w, and p rows a stage."""

    A: Array  # (T+1, n, n)
    B: Array  # (T+1, n, k)
    d: Array  # (T+1, n)
    H: Array  # (T+1, n+k, n+k), symmetric positive semidefinite
    h: Array  # (T+1, n+k)
    G: Array  # (T+1, p, n+k)
    g: Array  # (T+1, p): inf where there is no such row; all entries of a cone are inf, or none
    cones: tuple[int, ...]  # sizes of the second-order cones, which are the last rows of every stage
    initial: Array  # (n,): nan where x_0 is free
    coupling: Coupling
    constant: float = 0.0

    @property
    def horizon(self) -> int:
        """Return T."""
        return len(self.A) - 1

    @property
    def states(self) -> int:
        """Return n."""
        return self.A.shape[1]

    @property
    def present(self) -> Mask:
        """Return which rows there are, (T+1, p)."""
        return np.isfinite(self.g)

    @property
    def fixed(self) -> Mask:
        """Return which entries of x_0 are given, (n,)."""
        return ~np.isnan(self.initial)

    @cached_property
    def coupled(self) -> AllRows:
        """Return all rows that couple times."""
        return AllRows(self.coupling, len(self.A), self.states)


@dataclass(frozen=True, eq=False)
class Coupling:
    """All rows that couple times; entries ``terminal`` of x_T are fixed to ``terminal_state``."""

    channels: Indices  # (channels,): entries of y_t
    terminal: Indices
    terminal_state: Array
    equations: tuple[Equations, ...] = ()
    inequalities: tuple[Inequalities, ...] = ()
    balls: tuple[Balls, ...] = field(default=())

    @property
    def equation_count(self) -> int:
        """Return the number of equations, of which those of x_T come first."""
        return len(self.terminal) + sum(part.rows.count for part in self.equations)

    @property
    def count(self) -> int:
        """Return the number of all rows, with constant heads of balls left out."""
        unequal = sum(part.rows.count for part in self.inequalities)
        round_ = sum(part.rows.count + (0 if part.heads is None else part.heads.count) for part in self.balls)
        return self.equation_count + unequal + round_

    def families(self) -> Iterator[tuple[CoupledRows, Indices]]:
        """Yield every family of rows after those of x_T, with the indices of its rows among all."""
        first = len(self.terminal)
        for part in (*self.equations, *self.inequalities):
            yield part.rows, first + np.arange(part.rows.count)
            first += part.rows.count
        for part in self.balls:
            heads = 0 if part.heads is None else 1
            at = first + np.arange(len(part.radius) * (part.dim + heads)).reshape(len(part.radius), -1)
            if part.heads is not None:
                yield part.heads, at[:, 0]
            yield part.rows, at[:, heads:].ravel()
            first += at.size


@dataclass(frozen=True, eq=False)
class RowFamily:
    """Rows of one kind, (count,), that are compared with numbers one by one."""

    rows: CoupledRows
    right: Array

    def used(self, channels: int) -> Mask:
        """Return which of the channels have a coefficient."""
        return self.rows.used(channels)

    def narrowed(self, used: Mask) -> Self:
        """Return the family on the used channels only."""
        return replace(self, rows=self.rows.narrowed(used))

    def scaled(self, units: Array) -> tuple[Self, Array]:
        """Return the family in units (T+1, channels) with rows of length 1, and the factors of its rows."""
        factors = inverse_sizes(self.rows.scaled(np.ones(self.rows.count), units).norms())
        return replace(self, rows=self.rows.scaled(factors, units), right=self.right * factors), factors


class Equations(RowFamily):
    """rows(y) = right, (count,)."""


class Inequalities(RowFamily):
    """rows(y) <= limits, (count,)."""

    @property
    def limits(self) -> Array:
        """Return the right-hand sides."""
        return self.right


@dataclass(frozen=True, eq=False)
class Balls:
    """|v_j + offset_j| <= radius_j + slack_j for groups v_j of values (balls * dim,): masks and energies.

    A soft ball has a slack: the entry of y that ``heads`` selects, which a row of its stage keeps from being negative.
    """

    rows: CoupledRows
    radius: Array  # (balls,), above zero; 0 or above with slacks
    heads: CoupledRows | None = None
    offset: Array | None = None  # (balls, dim); None: zeros

    @property
    def dim(self) -> int:
        """Return the size of a group."""
        return self.rows.count // len(self.radius)

    @property
    def right(self) -> Array:
        """Return (radius, offset), (balls, 1 + dim): with (slack, v) added, a point of the cone."""
        offset = np.zeros((len(self.radius), self.dim)) if self.offset is None else self.offset
        return np.column_stack([self.radius, offset])

    def used(self, channels: int) -> Mask:
        """Return which of the channels have a coefficient."""
        return self.rows.used(channels) | (False if self.heads is None else self.heads.used(channels))

    def narrowed(self, used: Mask) -> Self:
        """Return the balls on the used channels only."""
        return replace(self, rows=self.rows.narrowed(used), heads=self.heads and self.heads.narrowed(used))

    def scaled(self, units: Array) -> tuple[Self, Array]:
        """Return the balls in units (T+1, channels), and the factors of the entries of ``right``, flat.

        Their radius is 1, unless the rows of their slacks are longer.
        """
        count, sizes = len(self.radius), np.abs(self.radius)
        if self.heads is not None:
            sizes = np.maximum(sizes, self.heads.scaled(np.ones(count), units).norms())
        lengths = self.rows.scaled(np.ones(self.rows.count), units).norms().reshape(count, -1).max(axis=1)
        factor = inverse_sizes(np.where(sizes > 0, sizes, lengths))
        scaled = replace(
            self,
            rows=self.rows.scaled(np.repeat(factor, self.dim), units),
            radius=self.radius * factor,
            heads=self.heads and self.heads.scaled(factor, units),
            offset=None if self.offset is None else self.offset * factor[:, None],
        )
        return scaled, np.repeat(factor, 1 + self.dim)


def inverse_sizes(sizes: Array) -> Array:
    """Return 1 / sizes, and 1 for sizes of zero."""
    return 1.0 / np.where(sizes > 0, sizes, 1.0)


@dataclass(frozen=True, eq=False)
class SpectrumRows:
    """(Re, Im) of scale_j sum_t window_t c'Y_t exp(-2 pi i bin_j t / points), of which those ``kept`` count."""

    coefficients: Array  # c, (channels,)
    window: Array  # (samples,)
    points: int
    bins: Indices  # (bins,), within 0 .. points/2
    scale: Array  # (bins,)
    kept: Mask  # (2 bins,), Re and Im of each bin in turn

    @property
    def count(self) -> int:
        """Return the number of rows."""
        return int(self.kept.sum())

    def forward(self, signals: Array) -> Array:
        """Return the values of the rows, (count, k)."""
        signal = self.window[:, None] * np.einsum("c,tck->tk", self.coefficients, signals[: len(self.window)])
        spectrum = np.fft.rfft(signal, n=self.points, axis=0)[self.bins] * self.scale[:, None]
        pairs = np.empty((2 * len(self.bins), signals.shape[2]))
        pairs[0::2], pairs[1::2] = spectrum.real, spectrum.imag
        return pairs[self.kept]

    def add_adjoint(self, weights: Array, signals: Array) -> None:
        """Add the adjoint of weights (count, k) to signals."""
        pairs = np.zeros((2 * len(self.bins), weights.shape[1]))
        pairs[self.kept] = weights
        real = (self.bins == 0) | (2 * self.bins == self.points)
        factor = self.scale * np.where(real, self.points, self.points / 2)
        spectrum = np.zeros((self.points // 2 + 1, weights.shape[1]), dtype=complex)
        spectrum[self.bins] = (pairs[0::2] + 1j * pairs[1::2]) * factor[:, None]
        signal = np.fft.irfft(spectrum, n=self.points, axis=0)[: len(self.window)] * self.window[:, None]
        self._add_signal(signal, signals)

    def add_columns(self, chosen: Indices, signals: Array) -> None:
        """Add row chosen[j] itself to signals (T+1, channels, len(chosen)) at j."""
        entry = np.flatnonzero(self.kept)[chosen]
        bins, imaginary = self.bins[entry // 2], entry % 2 == 1
        angles = 2 * np.pi * np.arange(self.points) / self.points
        table = np.concatenate([np.cos(angles), -np.sin(angles)])
        at = (np.arange(len(self.window))[:, None] * bins) % self.points + self.points * imaginary
        waves = table[at] * self.scale[entry // 2]
        self._add_signal(waves * self.window[:, None], signals)

    @property
    def oversampling(self) -> int:
        """Return the number of grid points for each point of the plain DFT."""
        return self.points // len(self.window)

    def used(self, channels: int) -> Mask:
        """Return which of the channels have a coefficient."""
        return self.coefficients != 0

    def narrowed(self, used: Mask) -> SpectrumRows:
        """Return the rows on the used channels only."""
        return replace(self, coefficients=self.coefficients[used])

    def norms(self) -> Array:
        """Return the Euclidean norms of the rows, (count,), the same for both rows of a bin."""
        real = (self.bins == 0) | (2 * self.bins == self.points)
        size = np.sqrt((self.coefficients**2).sum() * (self.window**2).sum() * np.where(real, 1.0, 0.5))
        return np.repeat(size * np.abs(self.scale), 2)[self.kept]

    def scaled(self, factors: Array, units: Array) -> SpectrumRows:
        """Return the rows times factors (count,), equal in a bin, of signals in constant units (T+1, channels)."""
        pairs = np.ones(2 * len(self.bins))
        pairs[self.kept] = factors
        of_bins = np.where(self.kept[0::2], pairs[0::2], pairs[1::2])
        return replace(self, coefficients=self.coefficients * units[0], scale=self.scale * of_bins)

    def _add_signal(self, signal: Array, signals: Array) -> None:
        for channel in np.flatnonzero(self.coefficients):
            signals[: len(signal), channel] += self.coefficients[channel] * signal


@dataclass(frozen=True, eq=False)
class SparseRows:
    """Rows given by a matrix (count, (T+1) channels)."""

    matrix: sp.csr_array

    @property
    def count(self) -> int:
        """Return the number of rows."""
        return self.matrix.shape[0]

    @cached_property
    def _transpose(self) -> sp.csc_array:  # SciPy takes longer to make it than to multiply by it
        return self.matrix.T

    def forward(self, signals: Array) -> Array:
        """Return the values of the rows, (count, k)."""
        return self.matrix @ signals.reshape(-1, signals.shape[2])

    def add_adjoint(self, weights: Array, signals: Array) -> None:
        """Add the adjoint of weights (count, k) to signals."""
        signals += (self._transpose @ weights).reshape(signals.shape)

    def add_columns(self, chosen: Indices, signals: Array) -> None:
        """Add row chosen[j] itself to signals (T+1, channels, len(chosen)) at j."""
        signals += self.matrix[chosen].T.toarray().reshape(signals.shape)

    @property
    def oversampling(self) -> int:
        """Return 1."""
        return 1

    def used(self, channels: int) -> Mask:
        """Return which of the channels have a coefficient."""
        return np.bincount(self.matrix.indices % channels, minlength=channels) > 0

    def narrowed(self, used: Mask) -> SparseRows:
        """Return the rows on the used channels only."""
        channels, position, indices = len(used), np.cumsum(used) - 1, self.matrix.indices.astype(np.intp)
        columns = indices // channels * int(used.sum()) + position[indices % channels]
        shape = self.count, self.matrix.shape[1] // channels * int(used.sum())
        return SparseRows(sp.csr_array((self.matrix.data, columns, self.matrix.indptr), shape=shape))

    def norms(self) -> Array:
        """Return the Euclidean norms of the rows, (count,)."""
        row = np.repeat(np.arange(self.count), np.diff(self.matrix.indptr))
        return np.sqrt(np.bincount(row, self.matrix.data**2, minlength=self.count))

    def scaled(self, factors: Array, units: Array) -> SparseRows:
        """Return the rows times factors (count,), of signals in units (T+1, channels)."""
        data = self.matrix.data * units.ravel()[self.matrix.indices] * np.repeat(factors, np.diff(self.matrix.indptr))
        return SparseRows(sp.csr_array((data, self.matrix.indices, self.matrix.indptr), shape=self.matrix.shape))


CoupledRows = SpectrumRows | SparseRows
"""A family of linear rows on signals (T+1, channels, k); both classes have the same methods."""


class AllRows:
    """The rows F of a coupling, in its order, on y (stages, n + k)."""

    def __init__(self, coupling: Coupling, stages: int, states: int):
        self._coupling, self._states, self._shape = coupling, states, (stages, len(coupling.channels))
        self._families = tuple(coupling.families())

    @cached_property
    def gradients(self) -> tuple[Array, Array]:
        """Return all rows as gradients on channels (stages, channels, rows) and on x_T (n, rows)."""
        return self.chosen(np.arange(self._coupling.count))

    def chosen(self, chosen: Indices) -> tuple[Array, Array]:
        """Return chosen rows as gradients on channels (stages, channels, k) and on x_T (n, k)."""
        terminal, signals = self._coupling.terminal, np.zeros((*self._shape, len(chosen)))
        end = np.zeros((self._states, len(chosen)))
        of_end = np.flatnonzero(chosen < len(terminal))
        end[terminal[chosen[of_end]], of_end] = 1.0
        for rows, at in self._families:
            inside = np.flatnonzero(np.isin(chosen, at, assume_unique=True))
            if len(inside):
                part = np.zeros((*self._shape, len(inside)))
                rows.add_columns(np.searchsorted(at, chosen[inside]), part)
                signals[:, :, inside] += part
        return signals, end

    def values(self, y: Array) -> Array:
        """Return F y."""
        terminal, signals = self._coupling.terminal, y[:, self._coupling.channels]
        values = np.zeros(self._coupling.count)
        for rows, at in self._families:
            values[at] = rows.forward(signals[:, :, None])[:, 0]
        values[: len(terminal)] = y[-1, terminal]
        return values

    def add_adjoint(self, nu: Array, gradient: Array) -> None:
        """Add F'nu to a gradient (stages, n + k)."""
        terminal, channels = self._coupling.terminal, self._coupling.channels
        gradient[-1, terminal] += nu[: len(terminal)]
        if len(channels):
            signals = np.zeros((*self._shape, 1))
            for rows, at in self._families:
                rows.add_adjoint(nu[at, None], signals)
            gradient[:, channels] += signals[:, :, 0]
