# ruff: noqa: D102
"""Semi-infinite constraints |V(p)| <= l(p), one for each point p of a parameter set, on a signal of the trajectory.

A term of a problem samples the constraint at finitely many points; its ``semi_infinite`` is the whole constraint. By
Caratheodory's theorem, an optimum has multipliers at finitely many points only. The parameter sets are the frequencies
of a spectrum, those of a zero-order hold, and a box of vibration modes. On each, the largest |V|/l lies on curves
(intervals or edges), where ``peaks_above`` finds the local maxima. A new set is a subclass of
``SemiInfiniteConstraint`` with a function in ``proven_peak`` (certificate/peaks.py), which proves the maxima.
``AffineMap`` and ``SemiInfiniteConstraint`` document the methods without a docstring.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Mask, brief, to_long_double
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.problem.terms.penalties import LargestExcess, NormBall
from lin_freq_ocp.problem.terms.penalty import HARD, Penalty
from lin_freq_ocp.problem.terms.spectrum_maps import FrequencyMap

Curve = tuple[complex, complex]  # the ends: frequencies, or logarithms of eigenvalues
SMALLEST = float(np.finfo(np.float64).tiny)  # the ratio whose logarithm replaces that of zero


@dataclass(frozen=True, eq=False)
class SemiInfiniteConstraint(ABC):
    """|V(p)| <= l(p) at every point p of a parameter set; points are arrays (k,) or (k, parameters)."""

    map: FrequencyMap  # without points
    price: float = field(default=np.inf, kw_only=True)  # per unit of the largest |V|/l - 1 above 0; inf: hard

    @abstractmethod
    def limit_at(self, points: Array) -> Array:
        """Return l at points, (k,); infinity outside the set."""

    @abstractmethod
    def first_points(self) -> Array:
        """Return the points that a solve starts with."""

    @abstractmethod
    def distances(self, first: Array, second: Array) -> Array:
        """Return the distances of k points and l points, in DFT bins of the signal, (k, l)."""

    @abstractmethod
    def points_on(self, curve: Curve, share: Array) -> Array:
        """Return the points at fractions (k,) of a curve."""

    @abstractmethod
    def samples(self, signal: Array) -> Iterator[tuple[Curve, Array, Array]]:
        """Yield the curves that contain all maxima, with fractions (k,) of each and |V|/l there, (k,)."""

    def ratios(self, signal: Array, points: Array) -> Array:
        """Return |V|/l of a windowed signal at points, (k,)."""
        return np.abs(self.map.at_points(points).transform(signal)) / self.limit_at(points)

    def at(self, points: Array) -> tuple[FrequencyMap, Penalty]:
        """Return the map to the values at points, and the penalty that bounds them."""
        if points.shape[1:] != self.map.at.shape[1:]:
            expected = "shape " + str(("atoms", *self.map.at.shape[1:])).replace("'", "")
            raise ProblemError("multipliers.frequencies", f"{brief(points.tolist())}", expected)
        limits = self.limit_at(points)
        soft = np.isfinite(self.price)
        ball = LargestExcess(limits, np.asarray(self.price)) if soft else NormBall(2, limits, HARD)
        return self.map.at_points(points), ball


FINENESS = 16  # points of the first search per bin of the signal's DFT
STEPS = 4  # of Newton's method, from 1/16 of a bin: it converges quadratically from the first on
DIFFERENCE = 1e-2  # step of the difference quotients, relative to the distance of samples: an error of 1e-5 of a step
FARTHEST = 2.0  # largest distance of a maximum from its sample, relative to the distance of samples


def peaks_above(constraint: SemiInfiniteConstraint, x: Array, u: Array, above: float) -> tuple[Array, Array]:
    """Return the points of the local maxima of |V|/l above a ratio, and these ratios, (peaks,).

    Newton's method for ln |V|/l, with difference quotients, refines the local maxima of samples on the curves.
    """
    signal, peaks = constraint.map.signal(x, u), list[Array]()
    for curve, share, ratio in constraint.samples(signal):
        padded, step = np.concatenate([[-np.inf], ratio, [-np.inf]]), float(np.diff(share).max())
        highest = (ratio >= padded[:-2]) & (ratio >= padded[2:]) & (ratio > above * (1 - 1 / FINENESS))
        start = share[highest]
        peak, d = start, DIFFERENCE * step
        for _ in range(STEPS):
            inner = np.clip(peak, d, 1 - d)
            around = constraint.points_on(curve, np.concatenate([inner - d, inner, inner + d]))
            left, here, right = np.log(np.maximum(constraint.ratios(signal, around), SMALLEST)).reshape(3, -1)
            slope, curvature = (right - left) / (2 * d), (right - 2 * here + left) / d**2
            move = np.where(curvature < 0, -slope / np.where(curvature < 0, curvature, 1.0), np.sign(slope) * step)
            peak = np.clip(np.clip(inner + move, start - FARTHEST * step, start + FARTHEST * step), 0.0, 1.0)
        peaks.append(constraint.points_on(curve, peak))
    points = np.unique(np.concatenate(peaks), axis=0)
    ratios = constraint.ratios(signal, points)
    return points[ratios > above], ratios[ratios > above]


@dataclass(frozen=True, eq=False)
class Limits:
    """A limit l(w) > 0 on intervals low <= w <= high, (pieces,), linear from ``at_low`` to ``at_high`` on each."""

    low: Array
    high: Array
    at_low: Array
    at_high: Array

    def at(self, frequencies: Array) -> Array:
        """Return the least limit at frequencies (k,) in rad/sample; infinity outside all intervals."""
        w = frequencies[:, None]
        inside = (w >= self.low) & (w <= self.high)
        share = (w - self.low) / np.where(self.high > self.low, self.high - self.low, 1.0)
        return np.where(inside, (1 - share) * self.at_low + share * self.at_high, np.inf).min(axis=1)

    def scaled(self, factor: float) -> Limits:
        """Return the limits times a factor."""
        return Limits(self.low, self.high, factor * self.at_low, factor * self.at_high)

    def raised(self, amount: float) -> Limits:
        """Return the limits plus an amount."""
        return Limits(self.low, self.high, self.at_low + amount, self.at_high + amount)


def limits_on(intervals: Sequence[tuple[float, float]], frequencies: Array, limits: Array) -> Limits:
    """Return the limit through points (k,), constant outside of them, on intervals in rad/sample."""
    low, high = list[float](), list[float]()
    for first, last in intervals:
        inner = frequencies[(frequencies > first) & (frequencies < last)]
        ends = [first, *inner.tolist(), last]
        low += ends[:-1]
        high += ends[1:]
    starts, stops = np.array(low), np.array(high)
    return Limits(starts, stops, np.interp(starts, frequencies, limits), np.interp(stops, frequencies, limits))


ZERO = 1e-6  # of |S|, below which an end of an interval is no first point: it limits hardly anything


@dataclass(frozen=True, eq=False)
class MagnitudeMask(SemiInfiniteConstraint):
    """|V(w)| <= l(w) at every frequency w in rad/sample of the intervals of the limits."""

    limits: Limits
    hertz: float | None = field(default=None, kw_only=True)  # per rad/sample, if the band is stated in Hz
    highest: ClassVar[float] = np.pi  # no point lies above

    def limit_at(self, points: Array) -> Array:
        return self.limits.at(points)

    def first_points(self) -> Array:
        """Return the ends of the intervals, and the bins within: of bins with the same V, the most limited one."""
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
        """Return the modulus of the factor of V, (k,)."""
        return np.ones(len(points))

    def distances(self, first: Array, second: Array) -> Array:
        return np.abs(first[:, None] - second) * self.map.samples / (2 * np.pi)

    def points_on(self, curve: Curve, share: Array) -> Array:
        low, high = (end.real for end in curve)
        return np.clip(low + (high - low) * share, low, high)

    def samples(self, signal: Array) -> Iterator[tuple[Curve, Array, Array]]:
        """Yield the intervals, with their ends and the points of a zero-padded FFT, which has the period 2 pi."""
        from scipy.fft import next_fast_len  # slow to import

        points = next_fast_len(FINENESS * len(signal), real=True)
        step, spectrum, limits = 2 * np.pi / points, np.abs(np.fft.rfft(signal, n=points)), self.limits
        for low, high, *levels in zip(limits.low, limits.high, limits.at_low, limits.at_high, strict=True):
            k = np.arange(int(low / step), int(high / step) + 2)
            k = k[(step * k > low) & (step * k < high)]
            ends, w = np.array([low, high]), np.asarray(step * k, dtype=np.float64)
            inner = spectrum[np.minimum(k % points, -k % points)] * self.factor(w) / np.interp(w, ends, levels)
            share = np.concatenate([[0.0], (w - low) / (high - low), [1.0]])
            yield (float(low), float(high)), share, np.insert(self.ratios(signal, ends), 1, inner)


@dataclass(frozen=True, eq=False)
class ZeroOrderHoldMap(FrequencyMap):
    """(Re, Im) of S(w) V(w)."""

    scaled: ClassVar[bool] = True

    @property
    def gain(self) -> ComplexArray:
        return to_long_double(sinc(to_long_double(self.at)) + 0j)

    @property
    def additions(self) -> float:
        return super().additions * max(float(self.at.max(initial=0.0)) / np.pi, 1.0)


@dataclass(frozen=True, eq=False)
class ZeroOrderHoldMask(MagnitudeMask):
    """|S(w) V(w)| <= l(w) at every w of the intervals of the limits, w = 2 pi f h for any f >= 0 in Hz.

    The zero-order hold v(t) = v_k for k h <= t < (k + 1) h has the spectrum h S V, up to a factor of modulus 1, with
    S(w) = sin(w/2) / (w/2) and V(w) = sum_t v_t exp(-iwt), of period 2 pi. If the limit is constant from w = a on, the
    interval up to a + 2 pi suffices: |S V| = 2 |sin(w/2) V(w)| / w has a numerator of period 2 pi, so that a value
    at a frequency of that interval exceeds every later one.
    """

    highest: ClassVar[float] = np.inf

    def factor(self, points: Array) -> Array:
        return np.abs(sinc(points))


def sinc(w: Array) -> Array:
    """Return S(w) = sin(w/2) / (w/2) in the precision of w."""
    half = np.where(w == 0, 1.0, w / 2)
    return np.where(w == 0, 1.0, np.sin(half) / half)


@dataclass(frozen=True, eq=False)
class VibrationMap(FrequencyMap):
    """(Re, Im) of V for modes ``at``, (groups, 2): natural frequency in Hz, damping ratio; see ``VibrationLimit``."""

    scaled: ClassVar[bool] = True
    sampling_time: float
    relative: bool = False  # V is the sum of the samples alone

    @property
    def real(self) -> Mask:
        return np.zeros(len(self.at), dtype=bool)

    @property
    def gain(self) -> ComplexArray:
        """Return (z - 1) / sqrt(1 - zeta^2), (groups,); 1 if relative."""
        if self.relative:
            return super().gain
        turned: ComplexArray = np.exp(-self.exponents)
        return (turned - 1) / np.sqrt(1 - to_long_double(self.at[:, 1]) ** 2)

    @property
    def exponents(self) -> ComplexArray:
        """Return -s h, (groups,)."""
        frequencies, damping = to_long_double(self.at).T
        return 2 * np.pi * self.sampling_time * frequencies * (damping - 1j * np.sqrt(1 - damping**2))

    @property
    def first_power(self) -> int:
        return 1 - self.samples


@dataclass(frozen=True, eq=False)
class VibrationLimit(SemiInfiniteConstraint):
    """|V| <= limit for every mode of a box: the residual vibration that a zero-order hold of the signal excites.

    A mode is q'' + 2 zeta w q' + w^2 q = w^2 v. With the eigenvalue s = w (-zeta + i sqrt(1 - zeta^2)), z = exp(s h),
    and no signal after N samples, the amplitude of q at the end is |V|,

        V = (z - 1) / sqrt(1 - zeta^2) sum_t v_t z^(N-1-t).

    In y = ln s = ln w + i phi, the sum times (z - 1) is analytic and sqrt(1 - zeta^2) = sin(phi). Hence ln |V| is
    subharmonic: -ln sin(phi) has the second derivative 1/sin(phi)^2 > 0. The box of (w, zeta) is a rectangle in y, so
    that the largest |V| lies on its edges. With a ``relative`` map, V is the sum alone, whose logarithm is subharmonic,
    too.
    """

    map: VibrationMap
    low: Array  # natural frequency in Hz and damping ratio, (2,)
    high: Array
    limit: float
    sampling_time: float

    def limit_at(self, points: Array) -> Array:
        return np.where(((points >= self.low) & (points <= self.high)).all(axis=1), self.limit, np.inf)

    def first_points(self) -> Array:
        """Return points on the edges, at most a bin of the signal's DFT apart."""
        points = [self.points_on(edge, np.linspace(0.0, 1.0, int(np.ceil(self.bins(edge))) + 1)) for edge in self.edges]
        return np.unique(np.concatenate(points), axis=0)

    def distances(self, first: Array, second: Array) -> Array:
        s, r = (np.exp(self.logarithms(points)) for points in (first, second))
        return np.abs(s[:, None] - r) * self.duration / (2 * np.pi)

    @property
    def duration(self) -> float:
        """Return the duration of the signal in seconds."""
        return self.map.samples * self.sampling_time

    @property
    def edges(self) -> list[tuple[complex, complex]]:
        """Return the ends of the rectangle's edges in y = ln s, without edges that coincide with another."""
        y = self.logarithms(np.array([self.low, self.high]))
        (left, right), (bottom, top) = y.real, y.imag
        along = [(complex(left, phi), complex(right, phi)) for phi in dict.fromkeys((bottom, top))]
        across = [(complex(size, bottom), complex(size, top)) for size in dict.fromkeys((left, right))]
        return (along if left < right or bottom == top else []) + (across if bottom < top else [])

    def bins(self, edge: tuple[complex, complex]) -> float:
        """Return an upper bound on the length of an edge, in bins of the signal's DFT."""
        return abs(edge[1] - edge[0]) * float(self.high[0]) * self.duration

    def logarithms(self, points: Array) -> ComplexArray:
        """Return y of modes (k, 2), (k,)."""
        return np.log(2 * np.pi * points[:, 0]) + 1j * np.arccos(-points[:, 1])

    def points_on(self, curve: Curve, share: Array) -> Array:
        """Return the modes at fractions (k,) of an edge, (k, 2)."""
        y = curve[0] + (curve[1] - curve[0]) * share
        return np.clip(np.column_stack([np.exp(y.real) / (2 * np.pi), -np.cos(y.imag)]), self.low, self.high)

    def samples(self, signal: Array) -> Iterator[tuple[Curve, Array, Array]]:
        for edge in self.edges:
            share = np.linspace(0.0, 1.0, max(int(np.ceil(FINENESS * self.bins(edge))), 1) + 1)
            yield edge, share, self.ratios(signal, self.points_on(edge, share))
