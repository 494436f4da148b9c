"""The largest value of a spectrum or of a residual vibration relative to its limit, at every frequency, with proof.

Cells. The frequencies are divided into cells, on which the function is nearly a polynomial.

On a cell, |V| is |g| but for an error of e at most, g(y) = sum_j a_j y^j with -1 <= y <= 1, and the limit l is linear.
|V| <= R l holds there if no Bernstein coefficient of (R l - e)^2 - |g|^2 is negative; cells of which this is not clear
are halved.

References: Farouki, Computer Aided Geometric Design 29, 2012 (Bernstein coefficients as bounds).

Spectra of samples. V(w) = sum_t v_t exp(-iwt) of samples v_0 .. v_{N-1}, and a limit l > 0 that is linear on each
interval. The circle is divided into cells of half-width s about w_c. With the time tau from the middle of the samples,
|V| on a cell is |g| of

    g(y) = sum_j a_j y^j,   a_j = (-is)^j / j! sum_t v_t tau_t^j exp(-i w_c t),   w = w_c + s y,   -1 <= y <= 1,

by one FFT for each j, all cells at once. The rest of the series is at most the sum of |v_t| |s tau_t|^j / j! over
other j; the rounding of the FFT is added.

References: Higham, Accuracy and Stability of Numerical Algorithms, 2002, Theorem 24.2 (rounding of the FFT).

Held signals, |S(w) V(w)| / l(w) at w of any size. V has the period 2 pi, and its polynomials g are those of masks. On a
cell about c of half-width s, S is an entire function, S(c + s y) = sum_j b_j y^j with |b_j| <= (s/2)^j / j!, as S is
the spectrum of a box of width 1. Its values at K = TERMS points of the circle |y| = 1 have the Fourier coefficients b_j
+ b_{j+K} + ...; with s <= pi/4, what these and the left-out terms add is below 1e-19. The product of both polynomials
is cut off, and what is cut off is added.

Residual vibrations over a box of modes. |V| = |Q| / sin(phi), Q(y) = (z - 1) sum_t v_t z^(N-1-t), z = exp(h e^y), y =
ln w + i phi, is largest on an edge of the rectangle of all y, as ln |V| is subharmonic
(problem/terms/semi_infinite.py). An edge is divided into cells of half-length r about y_c. Q at K points of the
circle of radius r about y_c has the Fourier coefficients a_j = q_j + q_{j+K} + ..., where Q = sum_j q_j ((y - y_c) /
r)^j. By Cauchy, |q_j| <= M (r/R)^j with |Q| <= M on the circle of radius R: with W = N h max w, M = 2 exp(W (e^R - 1))
sum |v_t|. The limit times sin(phi), which is concave, is above its chord. A relative limit has Q without z - 1, for
which M is large enough, and no sin(phi).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import singledispatch
from math import factorial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, first_largest, to_long_double
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.semi_infinite import (
    Limits,
    MagnitudeMask,
    SemiInfiniteConstraint,
    VibrationLimit,
    ZeroOrderHoldMask,
    peaks_above,
)

Scalar = TypeVar("Scalar", np.float64, np.complex128)

TERMS = 16  # of the series: what is left is 1e-20 of the sum of the samples' absolute values
RATIO = 1e-10  # by which the proven ratio may exceed the largest found
COEFFICIENT_ROUNDING = 8 * TERMS * float(np.finfo(np.float64).eps)  # of a Bernstein coefficient, per (sum of |a_j|)^2
SHIFT_ROUNDING = 4 * TERMS * float(np.finfo(np.float64).eps)  # of new coefficients, per sum of |a_j|
HALVINGS = 40  # after which cells are as narrow as rounding
MOST_CELLS = 2_000_000  # at a time


@dataclass(frozen=True)
class Peak:
    """The largest |V| / l: proven to be at most ``ratio``; it is ``found`` at ``frequency`` in rad/sample.

    For a residual vibration, ``frequency`` is a natural frequency in Hz, with a damping ratio. Texts state a mask's
    frequency in Hz if its band is in Hz: ``hertz`` per rad/sample.
    """

    ratio: float
    found: float
    frequency: float
    damping: float | None = None
    hertz: float | None = None

    def __str__(self) -> str:
        what, where = "|V|", f"{self.frequency:.6g} rad/sample"
        if self.damping is not None:
            what, where = "the vibration", f"{self.frequency:.6g} Hz, damping ratio {self.damping:.6g}"
        elif self.hertz is not None:
            where = f"{self.hertz * self.frequency:.6g} Hz"
        return f"{what} is at most {self.ratio:.12g} of its limit, proven; it is {self.found:.12g} at {where}"


@dataclass(frozen=True, eq=False)
class Cells:
    """Polynomials on -1 <= y <= 1, and the limits there."""

    a: ComplexArray  # (cells, TERMS)
    middle: Array  # frequency, or another parameter, at y = 0, (cells,)
    half: Array  # half-width, (cells,)
    limit: Array  # at y = 0, (cells,)
    slope: Array  # of the limit in y, (cells,)
    error: Array  # largest difference of |g| and |V|, (cells,)

    def take(self, at: Indices) -> Cells:
        """Return some of the cells."""
        return Cells(*(getattr(self, field.name)[at] for field in fields(self)))

    @staticmethod
    def concatenate(parts: list[Cells]) -> Cells:
        """Return the cells of all parts."""
        return Cells(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Cells)))

    def part(self, first: Array, last: Array) -> Cells:
        """Return the parts first <= y <= last of the cells."""
        centre, scale = (first + last) / 2, (last - first) / 2
        a = self.a.copy()  # by Horner's scheme, the coefficients in z of polynomials in y = centre + scale z
        for j in (*reversed(range(TERMS - 1)), *range(1, TERMS - 1)):  # several passes at a time, two terms apart
            a[:, j : TERMS - 1 : 2] += centre[:, None] * a[:, j + 1 :: 2]
        return Cells(
            a * scale[:, None] ** np.arange(TERMS),
            self.middle + self.half * centre,
            self.half * scale,
            self.limit + self.slope * centre,
            self.slope * scale,
            self.error + SHIFT_ROUNDING * np.abs(self.a).sum(1),
        )

    @property
    def least(self) -> Array:
        """Return the lowest limit on each cell."""
        return self.limit - np.abs(self.slope)

    def undecided(self, ratio: float) -> Indices:
        """Return the cells on which |V| <= ratio * l is not proven."""
        sums, margin = np.abs(self.a).sum(1), ratio * self.least - self.error
        left = np.flatnonzero(sums > margin)
        if not len(left):
            return left
        few = self.take(left)
        square = _product(few.a.real, few.a.real) + _product(few.a.imag, few.a.imag)
        centre, slope = ratio * few.limit - few.error, ratio * few.slope
        square[:, 0] -= centre**2
        square[:, 1] -= 2 * centre * slope
        square[:, 2] -= slope**2
        rounding = COEFFICIENT_ROUNDING * (sums[left] + np.abs(centre) + np.abs(slope)) ** 2
        return left[((square @ BERNSTEIN).max(1) + rounding > 0) | (margin[left] <= 0)]


def bound_peak(cells: Cells) -> Peak:
    """Return the largest |V| / l on cells, at a parameter, with proof."""
    found, value, frequency, proven = 0.0, 0.0, float(cells.middle[0]), 0.0
    for _ in range(HALVINGS):
        values = np.abs(cells.a[:, 0]) / cells.limit
        best = int(np.argmax(values))
        # the frequency is the first whose value, kept with it, is the largest up to rounding
        seen, at = np.append([found, value], values), np.append([np.inf, frequency], cells.middle)
        first = first_largest(seen, at)
        found, value, frequency = float(seen.max()), float(seen[first]), float(at[first])
        proven = max(proven, found * (1 + RATIO) + 2 * float(cells.error[best] / cells.limit[best]))
        cells = cells.take(cells.undecided(proven))
        if not len(cells.a) or 2 * len(cells.a) > MOST_CELLS:
            break
        ends = np.ones(len(cells.a))
        cells = Cells.concatenate([cells.part(-ends, 0 * ends), cells.part(0 * ends, ends)])
    if len(cells.a):
        proven = max(proven, float(((np.abs(cells.a).sum(1) + cells.error) / cells.least).max()))
    return Peak(proven, found, frequency)


def _product(p: NDArray[Scalar], q: NDArray[Scalar]) -> NDArray[Scalar]:
    """Return the coefficients of the products of polynomials (cells, TERMS)."""
    product = np.zeros((len(p), 2 * TERMS - 1), dtype=p.dtype)
    for j in range(TERMS):
        product[:, j : j + TERMS] += p[:, j : j + 1] * q
    return product


def _bernstein_matrix(degree: int) -> Array:
    """Return the matrix from coefficients in y on [-1, 1] to Bernstein coefficients, (degree + 1, degree + 1).

    Its entry (k, j) is the coefficient of z^j in (1 - z)^(d - k) (1 + z)^k, divided by that in (1 + z)^d.
    """
    powers = [np.ones(1)]
    for _ in range(degree):
        powers.append(np.convolve(powers[-1], [1.0, 1.0]))
    signs = (-1.0) ** np.arange(degree + 1)
    columns = [np.convolve(powers[degree - k] * signs[: degree - k + 1], powers[k]) for k in range(degree + 1)]
    return np.stack(columns, axis=1) / powers[degree][:, None]


BERNSTEIN = _bernstein_matrix(2 * TERMS - 2)


CELLS = 4  # for each sample: the series then converges like (pi/8)^j / j!
DOUBLE_SHARE = 1e-11  # error of the ratio, from rounding in double precision, that needs no longer numbers
END_ROUNDING = 4 * float(np.finfo(np.float64).eps)  # of an end of an interval, in cells, for each cell before it
FFT_ROUNDING = 7.0  # roundings of each of the log2 stages of an FFT, relative to the norm of the result


@dataclass(frozen=True, eq=False)
class Series:
    """The polynomials g on cells of the half-width ``step`` about 2 k step, k = 0, 1, ..., from those on [0, pi]."""

    a: ComplexArray  # (cells, TERMS)
    error: float  # largest difference of |g| and |V|

    @property
    def step(self) -> float:
        """Return the half-width of the cells."""
        return float(np.pi / (2 * (len(self.a) - 1)))

    def on(self, k: Indices) -> tuple[ComplexArray, Array]:
        """Return a of cells k, (k, TERMS), and their errors: V(w + 2 pi) = V(w), and V(-w) = conj(V(w))."""
        points = 2 * (len(self.a) - 1)
        k = k % points
        mirrored = 2 * k > points
        a = self.a[np.where(mirrored, points - k, k)]
        return np.where(mirrored[:, None], (-1.0) ** np.arange(TERMS) * a.conj(), a), np.full(len(k), self.error)


def certified_peak(samples: Array, limits: Limits, kind: Callable[[ComplexArray, float], Series] = Series) -> Peak:
    """Return the largest |V| / l of samples (N,), with proof; for another kind of series, its |g| / l.

    Cells reach beyond an interval by rounding, its end does not: the limit is known at the frequency that is returned.
    """
    size = float(np.abs(samples).max(initial=0.0))
    if size == 0:
        return Peak(0.0, 0.0, float(limits.low[0]))
    if not np.isfinite(size):
        return Peak(np.inf, np.inf, float(limits.low[0]))
    least = float(min(limits.at_low.min(), limits.at_high.min())) / size
    peak = bound_peak(_cells_on_intervals(kind(*_coefficients(to_long_double(samples) / size, least)), limits, size))
    within = np.clip(peak.frequency, limits.low, limits.high)
    return replace(peak, frequency=float(within[np.argmin(np.abs(within - peak.frequency))]))


def _coefficients(values: Array, least: float) -> tuple[ComplexArray, float]:
    """Return a, (cells, TERMS), and the largest difference of |g| and |V|."""
    from scipy.fft import next_fast_len  # slow to import

    N = len(values)
    points = 2 * next_fast_len(CELLS * N // 2, real=True)
    tau = np.arange(N) - np.longdouble(N - 1) / 2
    step = np.longdouble(np.pi) / points
    reach = float(step) * (N - 1) / 2
    rest = float(np.abs(values).sum()) * reach**TERMS / factorial(TERMS) / (1 - reach / TERMS)
    stages, a, error = FFT_ROUNDING * np.log2(points) * np.sqrt(points), list[ComplexArray](), rest
    for j in range(TERMS):
        weighted = values * ((step * tau) ** j / factorial(j))
        rounding = stages * float(np.sqrt((weighted**2).sum()))
        in_double = rounding * float(np.finfo(np.float64).eps) <= DOUBLE_SHARE * least
        weighted = weighted.astype(np.float64) if in_double else weighted
        a.append(((-1j) ** j * np.fft.rfft(weighted, n=points)).astype(np.complex128))
        error += rounding * float(np.finfo(weighted.dtype).eps)
    return np.stack(a, axis=1), error


def _cells_on_intervals(series: Series, limits: Limits, size: float) -> Cells:
    """Return the parts of the cells on each interval on which the limit is linear."""
    step, parts = series.step, list[Cells]()
    for low, high, at_low, at_high in zip(limits.low, limits.high, limits.at_low, limits.at_high, strict=True):
        k = np.arange(max(round(low / (2 * step)) - 1, 0), round(high / (2 * step)) + 2)
        slack = END_ROUNDING * max(len(series.a), len(k) + int(k[0]))
        first, last = np.maximum(low / step - 2 * k - slack, -1.0), np.minimum(high / step - 2 * k + slack, 1.0)
        within = first <= last
        k, first, last = k[within], first[within], last[within]
        slope = (at_high - at_low) / (high - low) if high > low else 0.0
        middle, ones = 2.0 * step * k, np.ones(len(k))
        limit = at_low + slope * (middle - low)
        a, error = series.on(k)
        whole = Cells(a, middle, step * ones, limit / size, slope * step / size * ones, error)
        parts.append(whole.part(first, last))
    return Cells.concatenate(parts)


ROUNDING = 64 * TERMS * float(np.finfo(np.float64).eps)  # of S, its FFT and the product, per sum of |a_j|; |S| < 1.1


class HeldSeries(Series):
    """The polynomials of S V on cells."""

    def on(self, k: Indices) -> tuple[ComplexArray, Array]:
        """Return the coefficients on cells k, (k, TERMS), and their errors."""
        a, error = super().on(k)
        turns = np.exp(2j * np.pi * np.arange(TERMS) / TERMS)
        half = self.step * (k[:, None] + turns / 2)  # w / 2
        whole = _product(np.fft.fft(np.sin(half) / half, axis=1) / TERMS, a)
        return whole[:, :TERMS], error + np.abs(whole[:, TERMS:]).sum(1) + ROUNDING * np.abs(a).sum(1)


def peak_points(problem: OptimalControlProblem, x: Array, u: Array, above: float) -> dict[str, Array]:
    """Return the points of all local maxima above a ratio, by the names of their terms."""
    sets = {term.name: term.semi_infinite for term in problem.terms if term.semi_infinite is not None}
    maxima = {name: peaks_above(everywhere, x, u, above)[0] for name, everywhere in sets.items()}
    return {name: points for name, points in maxima.items() if len(points)}


CIRCLE_GROWTH = 16.0  # W (e^R - 1): the least of exp(CIRCLE_GROWTH) (r/R)^TERMS is near CIRCLE_GROWTH = TERMS
INNER = 0.03  # r / R: what the series leaves is 2e-17 of the sum of the samples' absolute values
CHORD = 4e-4  # longest cell along phi: the chord is below sin(phi) by 2e-8 of it
EXTENDED = float(np.finfo(np.longdouble).eps)
DOUBLE = float(np.finfo(np.float64).eps)


def certified_vibration(samples: Array, box: VibrationLimit) -> Peak:
    """Return the largest |V| / limit of samples (N,), with proof."""
    size = float(np.abs(samples).max(initial=0.0))
    if size == 0 or not np.isfinite(size):
        ratio = 0.0 if size == 0 else np.inf
        return Peak(ratio, ratio, float(box.low[0]), float(box.low[1]))
    values, limit = to_long_double(samples) / size, box.limit / size
    parts = [_cells_on_edge(values, box, limit, k, edge) for k, edge in enumerate(box.edges)]
    peak = bound_peak(Cells.concatenate(parts))
    k, share = divmod(peak.frequency, 2.0)
    ((frequency, damping),) = box.points_on(box.edges[int(k)], np.array([share])).tolist()
    return Peak(peak.ratio, peak.found, frequency, damping)


def _cells_on_edge(
    values: Array, box: VibrationLimit, limit: float, number: int, edge: tuple[complex, complex]
) -> Cells:
    """Return the cells of an edge; their parameter is twice the number of the edge, plus the share of its length."""
    (start, end), W = edge, 2 * np.pi * float(box.high[0]) * box.duration
    R = float(np.log1p(CIRCLE_GROWTH / W))
    length = abs(end - start)
    curved = end.imag != start.imag and not box.map.relative  # the limit, which sin(phi) multiplies
    count = max(int(np.ceil(length / min(2 * INNER * R, CHORD if curved else np.inf))), 1)
    share = (np.arange(count) + 0.5) / count
    step = (end - start) / (2 * count)
    radius = abs(step) or INNER * R
    direction = step / radius if step else 1.0
    centre, turns = start + (end - start) * share, np.exp(2j * np.pi * np.arange(TERMS) / TERMS)
    circles = (centre[:, None] + radius * direction * turns).astype(np.complex128)
    on_circles = _evaluate_vibration(values, circles, box.sampling_time, box.map.relative)
    a = np.fft.fft(on_circles.reshape(count, TERMS), axis=1) / TERMS
    if not step:
        a[:, 1:] = 0.0
    total = float(np.abs(values).sum())
    rest = 4 * total * np.exp(CIRCLE_GROWTH) * (radius / R) ** TERMS / (1 - radius / R)
    near = 2 * total * np.exp(W * np.expm1(radius))  # a bound of Q on the small circles
    rounding = (7 * np.sqrt(len(values)) + 30 + 4 * W) * EXTENDED + (TERMS + 4 * W) * DOUBLE
    phi = np.array([start.imag, *(start + (end - start) * (np.arange(count) + 1) / count).imag])
    sines = np.ones(count + 1) if box.map.relative else np.sin(phi)
    below, slope = limit * (sines[:-1] + sines[1:]) / 2, limit * np.diff(sines) / 2
    ones = np.ones(count)
    error = (rest + rounding * near) * ones
    return Cells(a, 2 * number + share, ones / (2 * count), below, slope, error)


def _evaluate_vibration(values: Array, points: ComplexArray, sampling_time: float, relative: bool) -> ComplexArray:
    """Return Q of samples at points y, flattened; computed in extended precision, then rounded."""
    y, N = points.reshape(-1, 1).astype(np.clongdouble), len(values)
    sh = np.exp(y) * np.longdouble(sampling_time)
    B, at = int(np.ceil(np.sqrt(N))), np.flatnonzero(values)
    if len(at) <= B:  # impulses
        total = np.exp(sh * (N - 1 - at)) @ values[at]
    else:
        A = -(-N // B)
        powers = np.zeros(A * B, dtype=values.dtype)
        powers[:N] = values[::-1]
        inner = _powers(np.exp(sh), B) @ powers.reshape(A, B).T
        total = (_powers(np.exp(sh * B), A) * inner).sum(axis=1)
    return (total if relative else np.expm1(sh[:, 0]) * total).astype(np.complex128)


def _powers(z: ComplexArray, count: int) -> ComplexArray:
    """Return z^0 .. z^(count - 1) of numbers (points, 1), each product with an error of sqrt(5)/2 of EXTENDED."""
    powers = np.hstack([np.ones_like(z), np.broadcast_to(z, (len(z), count - 1))])
    return np.cumprod(powers, axis=1, out=powers)


@singledispatch
def proven_peak(everywhere: SemiInfiniteConstraint, samples: Array) -> Peak:
    """Return the largest |V| / l of windowed samples (N,) over a parameter set, with proof."""
    raise NotImplementedError(type(everywhere).__name__)


@proven_peak.register
def _(everywhere: MagnitudeMask, samples: Array) -> Peak:
    return replace(certified_peak(samples, everywhere.limits), hertz=everywhere.hertz)


@proven_peak.register
def _(everywhere: ZeroOrderHoldMask, samples: Array) -> Peak:
    return replace(certified_peak(samples, everywhere.limits, HeldSeries), hertz=everywhere.hertz)


@proven_peak.register
def _(everywhere: VibrationLimit, samples: Array) -> Peak:
    return certified_vibration(samples, everywhere)
