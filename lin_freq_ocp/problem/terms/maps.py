# ruff: noqa: D102
"""Affine maps of a trajectory, (x, u) -> values (groups, dim): of stages, of both ends, and sums over all times.

The maps of spectra are in ``spectrum_maps.py``. A new map is a subclass of ``AffineMap`` in a file of its own: nothing
else in the package tells maps apart. ``AffineMap`` and ``MatrixMap`` document the methods without a docstring.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import ClassVar, Self

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask, times_vectors

Shapes = tuple[tuple[int, ...], tuple[int, ...]]  # of x, (T+1, n), and of u, (T, m)


@dataclass(frozen=True, eq=False)
class SpectrumForm:
    """(Re, Im) of sum_t window_t row'(x_t, u_t) exp(-2 pi i bin t / points) for each bin, the ``kept`` ones."""

    row: Array  # (n + m,)
    window: Array  # (samples,)
    points: int
    bins: Indices  # (bins,), within 0 .. points/2
    kept: Mask  # (2 bins,), Re and Im of each bin in turn

    @property
    def zero(self) -> Mask:
        """Return which of (Re, Im) of each bin vanish for every signal, (2 bins,)."""
        zero = np.zeros((len(self.bins), 2), dtype=bool)
        zero[:, 1] = (self.bins == 0) | (2 * self.bins == self.points)
        return zero.ravel() | (not self.row.any())


class AffineMap(ABC):
    """(x, u) -> values (groups, dim), with its adjoint, its sparse rows, and the magnitudes of its terms.

    The adjoint satisfies <lambda, values(x, u) - values(0, 0)> = <pull_back(lambda), (x, u)>. Rounding errors of
    ``values`` are relative to ``sizes``, those of ``pull_back`` to ``pulled_sizes``.
    """

    constants: ClassVar[tuple[str, ...]] = ()  # the fields that only the values at x = 0, u = 0 depend on
    takes_batches: ClassVar[bool] = False  # whether signals and values may have leading axes, for many trajectories

    def same_rows(self, other: AffineMap) -> bool:
        """Whether another map differs from this one in ``constants`` at most, so that L is the same."""
        if self is other:
            return True
        if type(self) is not type(other) or not is_dataclass(self):
            return False
        names = [field.name for field in fields(self) if field.name not in self.constants]
        return all(_equal(getattr(self, name), getattr(other, name)) for name in names)

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int]:
        """Return (groups, dim) of the values."""

    @property
    @abstractmethod
    def positions(self) -> Indices:
        """Return the time of every group; of a spectrum, the nearest bin of the plain DFT; empty without either."""

    @property
    @abstractmethod
    def additions(self) -> float:
        """Return the number of operations that make a value: rounding errors grow with it."""

    @abstractmethod
    def values(self, x: Array, u: Array) -> Array:
        """Return v, (groups, dim), for x (T+1, n) and u (T, m)."""

    @abstractmethod
    def pull_back(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        """Return the adjoint of weights (groups, dim), in the shapes of x and u."""

    @abstractmethod
    def rows(self, horizon: int, n: int, m: int) -> tuple[sp.csr_array, Array]:
        """Return L, (groups * dim, (T+1) n + T m), and c with values = L (x, u) + c, group by group."""

    @abstractmethod
    def sizes(self, x: Array, u: Array) -> Array:
        """Return the magnitudes of the terms of v, (groups, dim)."""

    def largest_changes(self, x: Array, u: Array) -> Array:
        """Return how much v changes at most, (groups, dim), with changes of states and controls up to x and u."""
        return self.sizes(x, u) - self.sizes(np.zeros_like(x), np.zeros_like(u))

    @abstractmethod
    def pulled_sizes(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        """Return the sums of the absolute values of the terms of ``pull_back``."""

    def stage_form(self, n: int, m: int) -> tuple[Array, Array] | None:
        """Return M, (groups or 1, dim, n + m), and c, (groups, dim), with v = M (x_t, u_t) + c for every group.

        t is the time of the group. None if a group depends on several times.
        """
        return None

    def form_at_origin(self, n: int, m: int) -> tuple[Array, Array] | None:
        """Return the ``stage_form`` that holds near the origin, of values that need not be affine."""
        return self.stage_form(n, m)

    def spectrum_form(self, n: int, m: int) -> SpectrumForm | None:
        """Return the data of a spectrum, whose values are the kept (Re, Im) in their order; None for other maps."""
        return None

    @property
    def spectrum(self) -> OutputMap | None:
        """Return the map itself if its values belong to frequencies of one whole signal; None for other maps."""
        return None

    @property
    def locations(self) -> Array:
        """Return the point of each group in the parameter set of a semi-infinite constraint; empty for other maps."""
        return np.zeros(0)

    @property
    def dense_size(self) -> tuple[int, int]:
        """Return the number of dense rows and the number of their entries."""
        return 0, 0


def _equal(one: object, other: object) -> bool:
    """Whether the fields of two maps are the same: arrays, numbers, or maps."""
    if isinstance(one, AffineMap) and isinstance(other, AffineMap):
        return one.same_rows(other)
    return one is other or np.array_equal(np.asarray(one), np.asarray(other))


class MatrixMap(AffineMap):
    """A map stated by matrices: the map of their absolute values yields the magnitudes."""

    @abstractmethod
    def magnitudes(self) -> AffineMap:
        """Return the map with the absolute values of all data."""

    def sizes(self, x: Array, u: Array) -> Array:
        return self.magnitudes().values(np.abs(x), np.abs(u))

    def pulled_sizes(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        return self.magnitudes().pull_back(np.abs(weights), shapes)


@dataclass(frozen=True, eq=False)
class StageMap(MatrixMap):
    """v_t = C_t x_t + D_t u_t + c_t at some times, a group for each."""

    takes_batches: ClassVar[bool] = True
    times: Indices  # (groups,), within 0 .. T without D, else within 0 .. T-1
    C: Array | None  # (dim, n) or (groups, dim, n)
    D: Array | None  # (dim, m) or (groups, dim, m)
    constant: Array  # (dim,) or (groups, dim)

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.times), self.constant.shape[-1]

    @property
    def positions(self) -> Indices:
        return self.times

    @property
    def additions(self) -> float:
        return float(sum(part.shape[-1] for part in (self.C, self.D, self.constant) if part is not None))

    def values(self, x: Array, u: Array) -> Array:
        v = np.broadcast_to(self.constant, self.shape).astype(np.result_type(x, u))
        for matrix, signal in ((self.C, x), (self.D, u)):
            if matrix is not None:
                v = v + times_vectors(matrix, signal[..., self.times, :])
        return v

    def pull_back(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        of_x, of_u = (np.zeros(shape, dtype=weights.dtype) for shape in shapes)
        for matrix, signal in ((self.C, of_x), (self.D, of_u)):
            if matrix is not None:
                pulled = times_vectors(np.swapaxes(matrix, -1, -2), weights)
                np.add.at(np.swapaxes(signal, 0, -2), self.times, np.swapaxes(pulled, 0, -2))
        return of_x, of_u

    def rows(self, horizon: int, n: int, m: int) -> tuple[sp.csr_array, Array]:
        values, columns, count = *self.entries(horizon, n, m), self.shape[0] * self.shape[1]
        values, columns = (part.reshape(count, n + m) for part in np.broadcast_arrays(values, columns))
        return sparse_rows(values, columns, (horizon + 1) * n + horizon * m), np.ravel(self.stage_form(n, m)[1])

    def entries(self, horizon: int, n: int, m: int) -> tuple[Array, Indices]:
        """Return C and D, (groups or 1, dim, n + m), and their columns among all states and controls."""
        of_x, of_u = self.times[:, None] * n + np.arange(n), self.times[:, None] * m + np.arange(m)
        return self.stage_form(n, m)[0], np.hstack([of_x, (horizon + 1) * n + of_u])[:, None]

    def stage_form(self, n: int, m: int) -> tuple[Array, Array]:
        parts = [
            np.zeros((1, self.shape[1], columns)) if part is None else part.reshape(-1, self.shape[1], columns)
            for part, columns in ((self.C, n), (self.D, m))
        ]
        groups = max(map(len, parts))
        matrix = np.concatenate([np.broadcast_to(part, (groups, *part.shape[1:])) for part in parts], axis=-1)
        return matrix, np.broadcast_to(self.constant, self.shape)

    def magnitudes(self) -> StageMap:
        C, D = (None if part is None else np.abs(part) for part in (self.C, self.D))
        return StageMap(self.times, C, D, np.abs(self.constant))


@dataclass(frozen=True, eq=False)
class SumMap(MatrixMap):
    """v = constant + sum_t (C_t x_t + D_t u_t), a single group (paper, (SFC) and (CFC)).

    The stages have no constants. Equations on both ends are the sum of two stages, 0 and T.
    """

    stages: tuple[StageMap, ...]
    constant: Array  # (dim,)

    @property
    def shape(self) -> tuple[int, int]:
        return 1, len(self.constant)

    @property
    def positions(self) -> Indices:
        return self.stages[0].times

    @property
    def additions(self) -> float:
        return float(sum(len(stage.times) + stage.additions for stage in self.stages))

    def values(self, x: Array, u: Array) -> Array:
        return self.constant + np.sum([stage.values(x, u).sum(axis=0, keepdims=True) for stage in self.stages], axis=0)

    def pull_back(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        return _sum_of_both(stage.pull_back(np.broadcast_to(weights, stage.shape), shapes) for stage in self.stages)

    def rows(self, horizon: int, n: int, m: int) -> tuple[sp.csr_array, Array]:
        pairs = [np.broadcast_arrays(*stage.entries(horizon, n, m)) for stage in self.stages]
        pairs = [[part.swapaxes(0, 1).reshape(len(self.constant), -1) for part in pair] for pair in pairs]
        values, columns = map(np.hstack, zip(*pairs, strict=True))
        total = sparse_rows(values, columns, (horizon + 1) * n + horizon * m)
        total.sum_duplicates()
        total.eliminate_zeros()
        return total, self.constant

    def form_at_origin(self, n: int, m: int) -> tuple[Array, Array]:
        """Return the largest effects of signals that do not change in size, and the values at the origin."""
        forms = [
            np.broadcast_to(np.abs(stage.stage_form(n, m)[0]), (len(stage.times), *stage.shape[1:], n + m))
            for stage in self.stages
        ]
        return np.concatenate(forms).sum(axis=0, keepdims=True), self.constant[None]

    def magnitudes(self) -> AffineMap:
        return SumMap(tuple(stage.magnitudes() for stage in self.stages), np.abs(self.constant))


@dataclass(frozen=True, eq=False)
class JoinedMap(AffineMap):
    """The values of several maps, one after the other, as a single group."""

    parts: tuple[AffineMap, ...]

    @property
    def shape(self) -> tuple[int, int]:
        return 1, sum(self._counts)

    @property
    def positions(self) -> Indices:
        return np.arange(0)

    @property
    def additions(self) -> float:
        return max(part.additions for part in self.parts)

    @property
    def dense_size(self) -> tuple[int, int]:
        rows, entries = zip(*(part.dense_size for part in self.parts), strict=True)
        return sum(rows), sum(entries)

    def values(self, x: Array, u: Array) -> Array:
        return np.concatenate([part.values(x, u).ravel() for part in self.parts])[None]

    def sizes(self, x: Array, u: Array) -> Array:
        return np.concatenate([part.sizes(x, u).ravel() for part in self.parts])[None]

    def pull_back(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        return _sum_of_both(part.pull_back(own, shapes) for part, own in self._split(weights))

    def pulled_sizes(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        return _sum_of_both(part.pulled_sizes(own, shapes) for part, own in self._split(weights))

    def rows(self, horizon: int, n: int, m: int) -> tuple[sp.csr_array, Array]:
        rows, constants = zip(*(part.rows(horizon, n, m) for part in self.parts), strict=True)
        return sp.csr_array(sp.vstack(rows)), np.concatenate([constant.ravel() for constant in constants])

    @property
    def _counts(self) -> list[int]:
        """Return the numbers of values of the parts."""
        return [part.shape[0] * part.shape[1] for part in self.parts]

    def _split(self, weights: Array) -> Iterator[tuple[AffineMap, Array]]:
        """Yield each part with its own weights."""
        each = np.split(weights[0], np.cumsum(self._counts)[:-1])
        return ((part, own.reshape(part.shape)) for part, own in zip(self.parts, each, strict=True))


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

    @property
    @abstractmethod
    def nearest_bins(self) -> Indices:
        """Return the bin of the plain DFT nearest to each bin or frequency, (count,)."""

    @property
    @abstractmethod
    def frequencies(self) -> Array:
        """Return the frequency of each group in rad/sample, (groups,); empty if groups are not single bins."""

    @abstractmethod
    def waves(self) -> Array:
        """Return the coefficients of the samples in Re and Im of each bin or frequency in turn, (rows, samples)."""

    def pairs(self, values: Array) -> Array:
        """Return (Re, Im) of every bin or frequency, (count, 2), from values or multipliers, (groups, dim)."""
        return values

    @property
    def samples(self) -> int:
        """Return the number of weights w_t."""
        return len(self.window)

    @property
    def component(self) -> int:
        """Return the index of the first state or control in y."""
        row = self.C if self.C is not None else self.D
        assert row is not None  # one of C and D is stated
        return int(np.flatnonzero(row)[0])

    @property
    def dense_size(self) -> tuple[int, int]:
        rows, signals = 2 * len(self.real), sum(1 for part in (self.C, self.D) if part is not None and part.any())
        return rows, rows * len(self.window) * signals

    def is_of(self, C: Array | None, D: Array | None) -> bool:
        """Whether y is C x + D u."""
        return all(
            first is second or (first is not None and second is not None and np.array_equal(first, second))
            for first, second in ((self.C, C), (self.D, D))
        )

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


def _sum_of_both(pulled: Iterable[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Return the sums of what several maps pull back to x and to u."""
    of_x, of_u = zip(*pulled, strict=True)
    return np.sum(of_x, axis=0), np.sum(of_u, axis=0)


def sparse_rows(values: Array, columns: Array | Indices, width: int) -> sp.csr_array:
    """Return rows with these values in these columns, (rows, k); scipy joins matrices in several times the time."""
    kept = values != 0
    return sp.csr_array((values[kept], columns[kept], np.append(0, kept.sum(1).cumsum())), shape=(len(values), width))
