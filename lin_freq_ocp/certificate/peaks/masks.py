"""The largest value of a spectrum below its limit, over all frequencies of some intervals, with proof.

V(w) = sum_t v_t exp(-iwt) of samples v_0 .. v_{N-1}, and a limit l > 0 that is linear on each interval. The circle is
divided into cells of half-width s about w_c. With the time tau from the middle of the samples, |V| on a cell is |g| of

    g(y) = sum_j a_j y^j,   a_j = (-is)^j / j! sum_t v_t tau_t^j exp(-i w_c t),   w = w_c + s y,   -1 <= y <= 1,

by one FFT for each j, all cells at once. The rest of the series is at most the sum of |v_t| |s tau_t|^j / j! over
other j; the rounding of the FFT is added.

References: Higham, Accuracy and Stability of Numerical Algorithms, 2002, Theorem 24.2 (rounding of the FFT).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import factorial

import numpy as np
from scipy import fft

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, extended
from lin_freq_ocp.certificate.peaks.cells import TERMS, Cells, Peak, joined, largest
from lin_freq_ocp.problem.terms.semi_infinite import Limits

CELLS = 4  # for each sample: the series then converges like (pi/8)^j / j!
DOUBLE_SHARE = 1e-11  # error of the ratio, from rounding in double precision, that needs no longer numbers
END_ROUNDING = 4 * float(np.finfo(np.float64).eps)  # of an end of an interval, in cells, for each cell before it
FFT_ROUNDING = 7.0  # roundings of each of the log2 stages of an FFT, relative to the norm of the result


@dataclass(frozen=True, eq=False)
class Series:
    """The polynomials g on cells of the half-width ``step`` about 2 k step, k = 0, 1, ..., from those on [0, pi]."""

    a: ComplexArray  # (cells, TERMS)
    error: float  # by which |g| can miss |V|

    @property
    def step(self) -> float:
        """Return the half-width of the cells."""
        return float(np.pi / (2 * (len(self.a) - 1)))

    def on(self, k: Indices) -> tuple[ComplexArray, Array]:
        """Return a of cells k, (k, TERMS), and their errors: V(w + 2 pi) = V(w), and V(-w) is its conjugate."""
        points = 2 * (len(self.a) - 1)
        k = k % points
        mirrored = 2 * k > points
        a = self.a[np.where(mirrored, points - k, k)]
        return np.where(mirrored[:, None], (-1.0) ** np.arange(TERMS) * a.conj(), a), np.full(len(k), self.error)


def certified_peak(samples: Array, limits: Limits, kind: Callable[[ComplexArray, float], Series] = Series) -> Peak:
    """Return the largest |V| / l of samples (N,), with proof; of another kind of series, its |g| / l."""
    size = float(np.abs(samples).max(initial=0.0))
    if size == 0:
        return Peak(0.0, 0.0, float(limits.low[0]))
    if not np.isfinite(size):
        return Peak(np.inf, np.inf, float(limits.low[0]))
    least = float(min(limits.at_low.min(), limits.at_high.min())) / size
    return largest(_on_intervals(kind(*_series(extended(samples) / size, least)), limits, size))


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


def _on_intervals(series: Series, limits: Limits, size: float) -> Cells:
    """Return the parts of the cells on each interval on which the limit is linear."""
    step, parts = series.step, list[Cells]()
    for low, high, at_low, at_high in zip(limits.low, limits.high, limits.at_low, limits.at_high, strict=True):
        k = np.arange(max(round(low / (2 * step)) - 1, 0), round(high / (2 * step)) + 2)
        slack = END_ROUNDING * max(len(series.a), len(k) + int(k[0]))
        first, last = np.maximum(low / step - 2 * k - slack, -1.0), np.minimum(high / step - 2 * k + slack, 1.0)
        kept = first <= last
        k, first, last = k[kept], first[kept], last[kept]
        slope = (at_high - at_low) / (high - low) if high > low else 0.0
        middle, ones = 2.0 * step * k, np.ones(len(k))
        limit = at_low + slope * (middle - low)
        a, error = series.on(k)
        whole = Cells(a, middle, step * ones, limit / size, slope * step / size * ones, error)
        parts.append(whole.part(first, last))
    return joined(parts)
