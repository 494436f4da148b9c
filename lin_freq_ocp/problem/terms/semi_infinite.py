# ruff: noqa: D102  (a method without a docstring is described by the class that it implements)
"""Semi-infinite constraints |V(p)| <= l(p), one for each point p of a parameter set, on a signal of the trajectory.

A term of a problem has finitely many of them, at its points; what must hold at all others stands in its ``everywhere``.
By Caratheodory's theorem, an optimum has multipliers at finitely many points only. The sets are the frequencies of a
spectrum, those of a signal that is held between its samples, and the modes of a plant that is known up to a box. Each
has its largest |V|/l on some curves, intervals or edges, on which ``peaks_above`` finds the local maxima. A new set is
a subclass of ``Continuum`` with a function registered in ``proven_peak`` (certificate/peaks), which proves the maxima.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy import fft

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, Mask, brief, to_long_double
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.problem.terms.maps import Shapes
from lin_freq_ocp.problem.terms.penalties import LargestExcess, NormBall
from lin_freq_ocp.problem.terms.penalty import HARD, Penalty
from lin_freq_ocp.problem.terms.spectrum_maps import FrequencyMap

Curve = tuple[complex, complex]  # its ends: frequencies, or logarithms of eigenvalues
SMALLEST = float(np.finfo(np.float64).tiny)  # ratio whose logarithm stands for that of zero


@dataclass(frozen=True, eq=False)
class Continuum(ABC):
    """|V(p)| <= l(p) at every point of a parameter set; points are arrays (k,) or (k, parameters)."""

    map: FrequencyMap  # at no point
    price: float = field(default=np.inf, kw_only=True)  # of the largest |V|/l - 1, if that is above 0; inf: never is

    @abstractmethod
    def limit_at(self, points: Array) -> Array:
        """Return l at points, (k,); infinity outside the set."""

    @abstractmethod
    def first_points(self) -> Array:
        """Return the points to begin with."""

    @abstractmethod
    def distances(self, some: Array, others: Array) -> Array:
        """Return the distances of k points and l others, in DFT bins of the signal, (k, l)."""

    @abstractmethod
    def points_on(self, curve: Curve, share: Array) -> Array:
        """Return the points at shares (k,) of the way along a curve."""

    @abstractmethod
    def samples(self, signal: Array) -> Iterator[tuple[Curve, Array, Array]]:
        """Yield the curves that hold all maxima, with shares (k,) of the way along each, and |V|/l there, (k,)."""

    def ratios(self, signal: Array, points: Array) -> Array:
        """Return |V|/l of a windowed signal at points, (k,)."""
        return np.abs(self.map.placed(points).transform(signal)) / self.limit_at(points)

    def at(self, points: Array) -> tuple[FrequencyMap, Penalty]:
        """Return the map to the values at points, and their balls."""
        if points.shape[1:] != self.map.at.shape[1:]:
            expected = "shape " + str(("atoms", *self.map.at.shape[1:])).replace("'", "")
            raise ProblemError("multipliers.frequencies", f"{brief(points.tolist())}", expected)
        limits = self.limit_at(points)
        soft = np.isfinite(self.price)
        ball = LargestExcess(limits, np.asarray(self.price)) if soft else NormBall(2, limits, HARD)
        return self.map.placed(points), ball


FINENESS = 16  # points of a first search for each bin of the signal's DFT
STEPS = 4  # of Newton's method, from 1/16 of a bin: it converges quadratically from the first on
DIFFERENCE = 1e-2  # distance of the points of differences, in that of the samples: they err by 1e-5 of a step
FARTHEST = 2.0  # distances of the samples that a maximum may be from the sample


def peaks_above(everywhere: Continuum, x: Array, u: Array, above: float) -> tuple[Array, Array]:
    """Return the points of the local maxima of |V|/l above a ratio, and these ratios, (peaks,).

    Those of samples on the curves of the set are refined by Newton's method for ln |V|/l, from differences.
    """
    signal, peaks = everywhere.map.signal(x, u), list[Array]()
    for curve, share, ratio in everywhere.samples(signal):
        padded, step = np.concatenate([[-np.inf], ratio, [-np.inf]]), float(np.diff(share).max())
        highest = (ratio >= padded[:-2]) & (ratio >= padded[2:]) & (ratio > above * (1 - 1 / FINENESS))
        start = share[highest]
        peak, d = start, DIFFERENCE * step
        for _ in range(STEPS):
            inner = np.clip(peak, d, 1 - d)
            around = everywhere.points_on(curve, np.concatenate([inner - d, inner, inner + d]))
            left, here, right = np.log(np.maximum(everywhere.ratios(signal, around), SMALLEST)).reshape(3, -1)
            slope, curvature = (right - left) / (2 * d), (right - 2 * here + left) / d**2
            move = np.where(curvature < 0, -slope / np.where(curvature < 0, curvature, 1.0), np.sign(slope) * step)
            peak = np.clip(np.clip(inner + move, start - FARTHEST * step, start + FARTHEST * step), 0.0, 1.0)
        peaks.append(everywhere.points_on(curve, peak))
    found = np.unique(np.concatenate(peaks), axis=0)
    ratios = everywhere.ratios(signal, found)
    return found[ratios > above], ratios[ratios > above]


@dataclass(frozen=True, eq=False)
class Limits:
    """l(w) on intervals low <= w <= high (pieces,), linear from ``at_low`` to ``at_high`` on each, above zero."""

    low: Array
    high: Array
    at_low: Array
    at_high: Array

    def at(self, frequencies: Array) -> Array:
        """Return the least limit at frequencies (k,) in rad/sample; infinity beyond all intervals."""
        w = frequencies[:, None]
        inside = (w >= self.low) & (w <= self.high)
        share = (w - self.low) / np.where(self.high > self.low, self.high - self.low, 1.0)
        found = (1 - share) * self.at_low + share * self.at_high
        return np.where(inside, found, np.inf).min(axis=1)

    def scaled(self, factor: float) -> Limits:
        """Return the limits times a factor."""
        return Limits(self.low, self.high, factor * self.at_low, factor * self.at_high)

    def raised(self, amount: float) -> Limits:
        """Return the limits plus an amount."""
        return Limits(self.low, self.high, self.at_low + amount, self.at_high + amount)


def limits_on(intervals: Sequence[tuple[float, float]], frequencies: Array, limits: Array) -> Limits:
    """Return the limit through points (k,), constant beyond them, on intervals in rad/sample."""
    low, high = list[float](), list[float]()
    for first, last in intervals:
        inner = frequencies[(frequencies > first) & (frequencies < last)]
        ends = [first, *inner.tolist(), last]
        low += ends[:-1]
        high += ends[1:]
    starts, stops = np.array(low), np.array(high)
    return Limits(starts, stops, np.interp(starts, frequencies, limits), np.interp(stops, frequencies, limits))


ZERO = 1e-6  # of S, below which an end of an interval is none of the first points: its constraint is hardly any


@dataclass(frozen=True, eq=False)
class Frequencies(Continuum):
    """|V(w)| <= l(w) at every frequency w in rad/sample of the intervals of the limits."""

    limits: Limits
    highest: ClassVar[float] = np.pi  # beyond it, there are no points

    def limit_at(self, points: Array) -> Array:
        return self.limits.at(points)

    def first_points(self) -> Array:
        """Return the bins within the intervals, of those with the same V the one with the least limit, and the ends."""
        N = self.map.samples
        k = np.arange(round(N * self.limits.high.max() / (2 * np.pi)) + 1)
        w = 2 * np.pi * k / N
        limits, same = self.limits.at(w), np.minimum(k % N, -k % N)
        of_V = np.full(len(k), np.inf)
        np.divide(limits, self.factor(w), out=of_V, where=np.isfinite(limits) & (k % N > 0) | (k == 0))
        tightest = np.lexsort((of_V, same))
        firsts = tightest[np.unique(same[tightest], return_index=True)[1]]
        ends = np.concatenate([self.limits.low, self.limits.high])
        return np.unique(np.concatenate([w[firsts[np.isfinite(of_V[firsts])]], ends[self.factor(ends) > ZERO]]))

    def at(self, points: Array) -> tuple[FrequencyMap, Penalty]:
        if points.ndim == 1 and (points > self.highest).any():
            raise ProblemError("multipliers.frequencies", brief(points.tolist()), "frequencies from 0 to pi rad/sample")
        return super().at(points)

    def factor(self, points: Array) -> Array:
        """Return the modulus of what V is multiplied by, (k,)."""
        return np.ones(len(points))

    def distances(self, some: Array, others: Array) -> Array:
        return np.abs(some[:, None] - others) * self.map.samples / (2 * np.pi)

    def points_on(self, curve: Curve, share: Array) -> Array:
        low, high = (end.real for end in curve)
        return np.clip(low + (high - low) * share, low, high)

    def samples(self, signal: Array) -> Iterator[tuple[Curve, Array, Array]]:
        """Yield the intervals, with the ends and the points of a zero-padded FFT within, whose period is 2 pi."""
        points = fft.next_fast_len(FINENESS * len(signal), real=True)
        step, spectrum, limits = 2 * np.pi / points, np.abs(fft.rfft(signal, n=points)), self.limits
        for low, high, *levels in zip(limits.low, limits.high, limits.at_low, limits.at_high, strict=True):
            k = np.arange(int(low / step), int(high / step) + 2)
            k = k[(step * k > low) & (step * k < high)]
            ends, w = np.array([low, high]), np.asarray(step * k, dtype=np.float64)
            inner = spectrum[np.minimum(k % points, -k % points)] * self.factor(w) / np.interp(w, ends, levels)
            share = np.concatenate([[0.0], (w - low) / (high - low), [1.0]])
            yield (float(low), float(high)), share, np.insert(self.ratios(signal, ends), 1, inner)


@dataclass(frozen=True, eq=False)
class ScaledMap(FrequencyMap, ABC):
    """A factor times a sum of the samples, of which no term is larger than its sample; the values are about no bins."""

    @property
    @abstractmethod
    def gain(self) -> ComplexArray:
        """Return the factor of each value, (groups,)."""

    @property
    def nearest_bins(self) -> Indices:
        return np.arange(0)

    @property
    def frequencies(self) -> Array:
        return np.zeros(0)

    def spectrum_of(self, C: Array | None, D: Array | None) -> bool:
        return False

    def sizes(self, x: Array, u: Array) -> Array:
        return super().sizes(x, u) * np.abs(self.gain.astype(complex))[:, None]

    def pulled_sizes(self, weights: Array, shapes: Shapes) -> tuple[Array, Array]:
        return super().pulled_sizes(weights * np.abs(self.gain.astype(complex))[:, None], shapes)


@dataclass(frozen=True, eq=False)
class HeldMap(ScaledMap):
    """(Re, Im) of S(w) V(w)."""

    @property
    def gain(self) -> ComplexArray:
        return to_long_double(sinc(to_long_double(self.at)) + 0j)

    @property
    def additions(self) -> float:
        return super().additions * max(float(self.at.max(initial=0.0)) / np.pi, 1.0)

    @cached_property
    def _factors(self) -> tuple[ComplexArray, ComplexArray]:
        first, second = super()._factors
        return self.gain[:, None] * first, second


@dataclass(frozen=True, eq=False)
class HeldFrequencies(Frequencies):
    """|S(w) V(w)| <= l(w) at every w of the intervals of the limits, w = 2 pi f h for any f >= 0 in Hz.

    v(t) = v_k for k h <= t < (k + 1) h has the spectrum h S V but for a factor of modulus 1, with S(w) = sin(w/2) /
    (w/2) and V(w) = sum_t v_t exp(-iwt), of period 2 pi. Limits that are constant from some w = a on need only be held
    up to a + 2 pi: |S V| = 2 |sin(w/2) V(w)| / w, whose numerator has the period 2 pi, so that every later value is
    below the value at a frequency of that interval.
    """

    highest: ClassVar[float] = np.inf

    def factor(self, points: Array) -> Array:
        return np.abs(sinc(points))


def sinc(w: Array) -> Array:
    """Return S(w), of any precision."""
    half = np.where(w == 0, 1.0, w / 2)
    return np.where(w == 0, 1.0, np.sin(half) / half)


@dataclass(frozen=True, eq=False)
class VibrationMap(ScaledMap):
    """(Re, Im) of V for modes ``at`` (groups, 2): natural frequency in Hz, damping ratio."""

    sampling_time: float

    @property
    def real(self) -> Mask:
        return np.zeros(len(self.at), dtype=bool)

    @property
    def gain(self) -> ComplexArray:
        """Return (z - 1) / sqrt(1 - zeta^2), (groups,)."""
        turned: ComplexArray = np.exp(self._angles)
        return (turned - 1) / np.sqrt(1 - self._damping_ratio**2)

    @property
    def _angles(self) -> ComplexArray:
        """Return s h, (groups,)."""
        w, damping = (2 * np.pi * self.sampling_time) * to_long_double(self.at[:, 0]), self._damping_ratio
        return w * (-damping + 1j * np.sqrt(1 - damping**2))

    @property
    def _damping_ratio(self) -> Array:
        return to_long_double(self.at[:, 1])

    @cached_property
    def _factors(self) -> tuple[ComplexArray, ComplexArray]:
        B, s = int(np.ceil(np.sqrt(self.samples))), self._angles[:, None]
        left = self.samples - 1 - B * np.arange(-(-self.samples // B))
        return self.gain[:, None] * np.exp(s * left), np.exp(-s * np.arange(B))


@dataclass(frozen=True, eq=False)
class PlantBox(Continuum):
    """|V| <= limit for every mode of a box: the residual vibration of a signal that is held between its samples.

    A mode is q'' + 2 zeta w q' + w^2 q = w^2 v. With the eigenvalue s = w (-zeta + i sqrt(1 - zeta^2)), z = exp(s h),
    and no signal after N samples, its amplitude is |V|,

        V = (z - 1) / sqrt(1 - zeta^2) sum_t v_t z^(N-1-t).

    In y = ln s = ln w + i phi, the sum times (z - 1) is analytic and sqrt(1 - zeta^2) = sin(phi): ln |V| is
    subharmonic, as the second derivative of -ln sin(phi) is 1/sin(phi)^2. The box of (w, zeta) is a rectangle in y: the
    largest |V| is on its edges.
    """

    low: Array  # natural frequency in Hz and damping ratio, (2,)
    high: Array
    limit: float
    sampling_time: float

    def limit_at(self, points: Array) -> Array:
        return np.where(((points >= self.low) & (points <= self.high)).all(axis=1), self.limit, np.inf)

    def first_points(self) -> Array:
        """Return points on the edges, a bin of the signal's DFT apart at most."""
        per_edge = [np.linspace(0.0, 1.0, int(np.ceil(self.bins(edge))) + 1) for edge in self.edges]
        found = [self.points_on(edge, share) for edge, share in zip(self.edges, per_edge, strict=True)]
        return np.unique(np.concatenate(found), axis=0)

    def distances(self, some: Array, others: Array) -> Array:
        first, second = (np.exp(self.logarithms(points)) for points in (some, others))
        return np.abs(first[:, None] - second) * self.duration / (2 * np.pi)

    @property
    def duration(self) -> float:
        """Return that of the signal in seconds."""
        return self.map.samples * self.sampling_time

    @property
    def edges(self) -> list[tuple[complex, complex]]:
        """Return the ends of the rectangle's edges in y = ln s; of edges that coincide, one."""
        y = self.logarithms(np.array([self.low, self.high]))
        (left, right), (bottom, top) = y.real, y.imag
        along = [(complex(left, phi), complex(right, phi)) for phi in dict.fromkeys((bottom, top))]
        across = [(complex(size, bottom), complex(size, top)) for size in dict.fromkeys((left, right))]
        return (along if left < right or bottom == top else []) + (across if bottom < top else [])

    def bins(self, edge: tuple[complex, complex]) -> float:
        """Return the length of an edge in bins of the signal's DFT, or more."""
        return abs(edge[1] - edge[0]) * float(self.high[0]) * self.duration

    def logarithms(self, points: Array) -> ComplexArray:
        """Return y of modes (k, 2), (k,)."""
        return np.log(2 * np.pi * points[:, 0]) + 1j * np.arccos(-points[:, 1])

    def points_on(self, curve: Curve, share: Array) -> Array:
        """Return the modes at shares (k,) of the way along an edge, (k, 2)."""
        y = curve[0] + (curve[1] - curve[0]) * share
        return np.clip(np.column_stack([np.exp(y.real) / (2 * np.pi), -np.cos(y.imag)]), self.low, self.high)

    def samples(self, signal: Array) -> Iterator[tuple[Curve, Array, Array]]:
        for edge in self.edges:
            share = np.linspace(0.0, 1.0, max(int(np.ceil(FINENESS * self.bins(edge))), 1) + 1)
            yield edge, share, self.ratios(signal, self.points_on(edge, share))
