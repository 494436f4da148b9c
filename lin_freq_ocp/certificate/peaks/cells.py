"""The largest value of functions on cells below a limit, with proof, from their polynomials.

On a cell, |V| is |g| but for an error of e at most, g(y) = sum_j a_j y^j with -1 <= y <= 1, and the limit l is linear.
|V| <= R l holds there if no Bernstein coefficient of (R l - e)^2 - |g|^2 is negative; cells of which this is not clear
are halved.

References: Farouki, Computer Aided Geometric Design 29, 2012 (Bernstein coefficients as bounds).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices

TERMS = 16  # of the series: what is left is 1e-20 of the sum of the samples' absolute values
RATIO = 1e-10  # by which the proven ratio may exceed the largest found
COEFFICIENT_ROUNDING = 8 * TERMS * float(np.finfo(np.float64).eps)  # of a Bernstein coefficient, per (sum of |a_j|)^2
SHIFT_ROUNDING = 4 * TERMS * float(np.finfo(np.float64).eps)  # of new coefficients, per sum of |a_j|
HALVINGS = 40  # after which cells are as narrow as rounding
MOST_CELLS = 2_000_000  # at a time


@dataclass(frozen=True)
class Peak:
    """The largest |V| / l: proven to be at most ``ratio``; ``found`` at ``frequency`` in rad/sample.

    Of a residual vibration: at a natural frequency in Hz, and a damping ratio.
    """

    ratio: float
    found: float
    frequency: float
    damping: float | None = None

    def __str__(self) -> str:
        what, unit = ("|V|", "rad/sample") if self.damping is None else ("the vibration", "Hz")
        where = "" if self.damping is None else f", damping ratio {self.damping:.6g}"
        found = f"it is {self.found:.12g} at {self.frequency:.6g} {unit}{where}"
        return f"{what} is at most {self.ratio:.12g} of its limit, proven; {found}"


@dataclass(frozen=True, eq=False)
class Cells:
    """Polynomials on -1 <= y <= 1, and the limits there."""

    a: ComplexArray  # (cells, TERMS)
    middle: Array  # frequency, or another parameter, at y = 0, (cells,)
    half: Array  # half-width, (cells,)
    limit: Array  # at y = 0, (cells,)
    slope: Array  # of the limit in y, (cells,)
    error: Array  # by which |g| can miss |V|, (cells,)

    def chosen(self, at: Indices) -> Cells:
        """Return some of the cells."""
        return Cells(self.a[at], *(array[at] for array in self.reals))

    def part(self, first: Array, last: Array) -> Cells:
        """Return the parts first <= y <= last of the cells."""
        centre, scale = (first + last) / 2, (last - first) / 2
        return Cells(
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


def largest(cells: Cells) -> Peak:
    """Return the largest |V| / l on cells, at a parameter."""
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
        cells = joined([cells.part(-ends, 0 * ends), cells.part(0 * ends, ends)])
    if len(cells.a):
        proven = max(proven, float(((np.abs(cells.a).sum(1) + cells.error) / cells.least).max()))
    return Peak(proven, found, frequency)


def _unclear(cells: Cells, ratio: float) -> Indices:
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


def joined(parts: list[Cells]) -> Cells:
    """Return all cells of several."""
    reals = zip(*(part.reals for part in parts), strict=True)
    return Cells(np.concatenate([part.a for part in parts]), *map(np.concatenate, reals))


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
