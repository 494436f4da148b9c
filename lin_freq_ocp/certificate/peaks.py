"""The largest value of a spectrum below its limit, over all frequencies of some intervals, with proof.

V(w) = sum_t v_t exp(-iwt) of samples v_0 .. v_{N-1}, and a limit l > 0 that is linear on each interval. The circle is
divided into cells of half-width s about w_c. With the time tau from the middle of the samples, |V| on a cell is |g| of

    g(y) = sum_j a_j y^j,   a_j = (-is)^j / j! sum_t v_t tau_t^j exp(-i w_c t),   w = w_c + s y,   -1 <= y <= 1,

by one FFT for each j, all cells at once. The rest of the series is at most the sum of |v_t| |s tau_t|^j / j! over
other j. |V| <= R l holds on a cell if no Bernstein coefficient of (R l - e)^2 - |g|^2 is negative, where e bounds that
rest and the rounding of the FFT; cells of which this is not clear are halved.

References: Higham, Accuracy and Stability of Numerical Algorithms, 2002, Theorem 24.2 (rounding of the FFT); Farouki,
Computer Aided Geometric Design 29, 2012 (Bernstein coefficients as bounds).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np
from scipy import fft

from lin_freq_ocp.arrays import Array, ComplexArray, Indices, extended
from lin_freq_ocp.problem.terms.limits import Limits

CELLS = 4  # for each sample: the series then converges like (pi/8)^j / j!
TERMS = 16  # of the series: what is left is 1e-20 of the sum of the samples' absolute values
RATIO = 1e-10  # by which the proven ratio may exceed the largest found
DOUBLE_SHARE = 1e-11  # error of the ratio, from rounding in double precision, that needs no longer numbers
FFT_ROUNDING = 7.0  # roundings of each of the log2 stages of an FFT, relative to the norm of the result
COEFFICIENT_ROUNDING = 8 * TERMS * float(np.finfo(np.float64).eps)  # of a Bernstein coefficient, per (sum of |a_j|)^2
SHIFT_ROUNDING = 4 * TERMS * float(np.finfo(np.float64).eps)  # of new coefficients, per sum of |a_j|
HALVINGS = 40  # after which cells are as narrow as rounding
MOST_CELLS = 2_000_000  # at a time


@dataclass(frozen=True)
class Peak:
    """The largest |V| / l: proven to be at most ``ratio``; ``found`` at ``frequency`` in rad/sample."""

    ratio: float
    found: float
    frequency: float

    def __str__(self) -> str:
        found = f"it is {self.found:.12g} at {self.frequency:.6g} rad/sample"
        return f"|V| is at most {self.ratio:.12g} of its limit, proven; {found}"


@dataclass(frozen=True, eq=False)
class _Cells:
    """Polynomials on -1 <= y <= 1, and the limits there."""

    a: ComplexArray  # (cells, TERMS)
    middle: Array  # frequency at y = 0, (cells,)
    half: Array  # half-width, (cells,)
    limit: Array  # at y = 0, (cells,)
    slope: Array  # of the limit in y, (cells,)
    error: Array  # by which |g| can miss |V|, (cells,)

    def chosen(self, at: Indices) -> _Cells:
        """Return some of the cells."""
        return _Cells(self.a[at], *(array[at] for array in self.reals))

    def part(self, first: Array, last: Array) -> _Cells:
        """Return the parts first <= y <= last of the cells."""
        centre, scale = (first + last) / 2, (last - first) / 2
        return _Cells(
            _shifted(self.a, centre, scale),
            self.middle + self.half * centre,
            self.half * scale,
            self.limit + self.slope * centre,
            self.slope * scale,
            self.error + SHIFT_ROUNDING * np.abs(self.a).sum(1),
        )

    @property
    def reals(self) -> tuple[Array, ...]:
        """Return all fields but a."""
        return self.middle, self.half, self.limit, self.slope, self.error

    @property
    def least(self) -> Array:
        """Return the lowest limit on each cell."""
        return self.limit - np.abs(self.slope)


def certified_peak(samples: Array, limits: Limits) -> Peak:
    """Return the largest |V| / l of samples (N,), with proof."""
    size = float(np.abs(samples).max(initial=0.0))
    if size == 0:
        return Peak(0.0, 0.0, float(limits.low[0]))
    if not np.isfinite(size):
        return Peak(np.inf, np.inf, float(limits.low[0]))
    least = float(min(limits.at_low.min(), limits.at_high.min())) / size
    series, error = _series(extended(samples) / size, least)
    return _largest(_on_intervals(series, error, limits, size))


def _series(values: Array, least: float) -> tuple[ComplexArray, float]:
    """Return a, (cells, TERMS), and by how much |g| can miss |V|."""
    N = len(values)
    points = 2 * fft.next_fast_len(CELLS * N // 2, real=True)
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
        a.append(((-1j) ** j * fft.rfft(weighted, n=points)).astype(np.complex128))
        error += rounding * float(np.finfo(weighted.dtype).eps)
    found = np.stack(a, axis=1)
    return found, error


def _on_intervals(series: ComplexArray, error: float, limits: Limits, size: float) -> _Cells:
    """Return the parts of the cells on each interval on which the limit is linear."""
    step = np.pi / (2 * (len(series) - 1))
    parts: list[_Cells] = []
    for low, high, at_low, at_high in zip(limits.low, limits.high, limits.at_low, limits.at_high, strict=True):
        k = np.arange(max(round(low / (2 * step)) - 1, 0), min(round(high / (2 * step)) + 2, len(series)))
        first, last = np.maximum(low / step - 2 * k, -1.0), np.minimum(high / step - 2 * k, 1.0)
        kept = first <= last
        k, first, last = k[kept], first[kept], last[kept]
        slope = (at_high - at_low) / (high - low) if high > low else 0.0
        middle, ones = 2.0 * step * k, np.ones(len(k))
        limit = at_low + slope * (middle - low)
        whole = _Cells(series[k], middle, step * ones, limit / size, slope * step / size * ones, error * ones)
        parts.append(whole.part(first, last))
    return _joined(parts)


def _largest(cells: _Cells) -> Peak:
    found, frequency, proven = 0.0, float(cells.middle[0]), 0.0
    for _ in range(HALVINGS):
        values = np.abs(cells.a[:, 0]) / cells.limit
        best = int(np.argmax(values))
        if values[best] > found:
            found, frequency = float(values[best]), float(cells.middle[best])
        proven = max(proven, found * (1 + RATIO) + 2 * float(cells.error[best] / cells.limit[best]))
        cells = cells.chosen(_unclear(cells, proven))
        if not len(cells.a) or 2 * len(cells.a) > MOST_CELLS:
            break
        ends = np.ones(len(cells.a))
        cells = _joined([cells.part(-ends, 0 * ends), cells.part(0 * ends, ends)])
    if len(cells.a):
        proven = max(proven, float(((np.abs(cells.a).sum(1) + cells.error) / cells.least).max()))
    return Peak(proven, found, frequency)


def _unclear(cells: _Cells, ratio: float) -> Indices:
    """Return which cells are not proven to have |V| <= ratio * l."""
    sums, margin = np.abs(cells.a).sum(1), ratio * cells.least - cells.error
    left = np.flatnonzero(sums > margin)
    if not len(left):
        return left
    few = cells.chosen(left)
    square = _squared(few.a.real) + _squared(few.a.imag)
    centre, slope = ratio * few.limit - few.error, ratio * few.slope
    square[:, 0] -= centre**2
    square[:, 1] -= 2 * centre * slope
    square[:, 2] -= slope**2
    rounding = COEFFICIENT_ROUNDING * (sums[left] + np.abs(centre) + np.abs(slope)) ** 2
    return left[((square @ BERNSTEIN).max(1) + rounding > 0) | (margin[left] <= 0)]


def _squared(p: Array) -> Array:
    """Return the coefficients of the squares of polynomials (cells, TERMS)."""
    found = np.zeros((len(p), 2 * TERMS - 1))
    for j in range(TERMS):
        found[:, j : j + TERMS] += p[:, j : j + 1] * p
    return found


def _shifted(a: ComplexArray, centre: Array, scale: Array) -> ComplexArray:
    """Return the coefficients in z of polynomials in y = centre + scale z."""
    found = a.copy()
    for first in range(TERMS - 1):
        for j in range(TERMS - 2, first - 1, -1):
            found[:, j] += centre * found[:, j + 1]
    return found * scale[:, None] ** np.arange(TERMS)


def _joined(parts: list[_Cells]) -> _Cells:
    reals = zip(*(part.reals for part in parts), strict=True)
    return _Cells(np.concatenate([part.a for part in parts]), *map(np.concatenate, reals))


def _bernstein(degree: int) -> Array:
    """Return the matrix from coefficients in y on [-1, 1] to Bernstein coefficients, (degree + 1, degree + 1).

    That of y^j at place k is the coefficient of z^j in (1 - z)^(d - k) (1 + z)^k, divided by that in (1 + z)^d.
    """
    powers = [np.ones(1)]
    for _ in range(degree):
        powers.append(np.convolve(powers[-1], [1.0, 1.0]))
    signs = (-1.0) ** np.arange(degree + 1)
    columns = [np.convolve(powers[degree - k] * signs[: degree - k + 1], powers[k]) for k in range(degree + 1)]
    return np.stack(columns, axis=1) / powers[degree][:, None]


BERNSTEIN = _bernstein(2 * TERMS - 2)
