"""State bounds between the samples of a continuous plant whose control is constant over each period.

From the state x at the start of a cell of length w, with v = A x + B u + d, the state is the polynomial

    x(a w) = x + sum_{j=1}^{K} (w^j / j!) A^{j-1} v a^j,   0 <= a <= 1,   K = DEGREE,

up to w |v| (w |A|)^K e^{w |A|} / (K + 1)!. A period has so many cells that w |A| <= REACH, in units of the states that
balance A. A polynomial lies below its largest Bernstein coefficient, and its first and last coefficients are values:
cells are halved until both agree. The samples of the trajectory are taken as they are; the errors of its dynamics at
samples are conditions of the certificate.

Reference: Farouki, Computer Aided Geometric Design 29, 2012 (Bernstein polynomials).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, comb, factorial

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, first_largest
from lin_freq_ocp.base.phrases import first_few, number, short_name, split_unit
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE, RADIUS_MARGIN
from lin_freq_ocp.problem.dynamics.plant import ContinuousPlant
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.trajectory import Trajectory

DEGREE = 15  # of the Taylor polynomials
REACH = 0.5  # largest w |A| of a cell: the remainder is below 1e-17 of a cell's motion
LARGEST_REACH = 512.0  # largest h |A| of a period; a stiffer plant is left out
RESOLUTION = 1e-9  # part of its size to which a largest value is bounded: far below what matters
MUCH = 10.0  # times the violation of a simulation, above which a rigorous bound on it says little
LATEST_HALVING = 60  # narrower cells are beyond double precision
ROUNDING = 4 * (DEGREE + 1) * float(np.finfo(np.float64).eps)  # of sums of a few terms for each power, relative to them
# Bernstein coefficients from power coefficients
BERNSTEIN = np.array(
    [[comb(k, j) / comb(DEGREE, j) if j <= k else 0.0 for j in range(DEGREE + 1)] for k in range(DEGREE + 1)]
)


@dataclass(frozen=True)
class BoundPeak:
    """The largest violation of one state bound over all instants of the horizon.

    Attributes
    ----------
    component : int
        Of the state.
    name : str
        Of the component, with its unit.
    side : str
        "lower" or "upper".
    violation : float
        Largest value of the state above an upper bound, or below a lower one, in the unit of the component; negative
        if the bound holds everywhere.
    at_most : float
        A rigorous upper bound of the violation.
    relative : float
        The violation over half the width of the bounds; over half the range of the trajectory if one side is free.
    time : float
        Of the violation, in seconds from the first sample.

    Examples
    --------
    >>> result = lfo.solve(lfo.library.pendulum(sampling_time=0.1))
    >>> print(result.between_samples.worst)
    position exceeds its upper bound by 8.5e-5 m (0.043 %) at 1.7486 s
    """

    component: int
    name: str
    side: str
    violation: float
    at_most: float
    relative: float
    time: float

    @property
    def holds(self) -> bool:
        """Whether the bound holds at every instant, within the tolerance of conditions."""
        return self.violation <= 0 or self.relative <= CONDITION_TOLERANCE

    def __str__(self) -> str:
        name, unit = split_unit(self.name)
        size = " ".join(part for part in (number(self.violation, 3), unit) if part)
        verb = "exceeds its upper" if self.side == "upper" else "falls below its lower"
        return f"{name} {verb} bound by {size} ({100 * self.relative:.2g} %) at {self.time:.5g} s"


@dataclass(frozen=True)
class BetweenSamples:
    """The state bounds of a problem with a continuous plant, at every instant.

    Attributes
    ----------
    bounds : tuple of BoundPeak
        Of every finite state bound of the plant's states.
    simulated : tuple of str
        The states for which ``at_most`` is more than ten times the violation that a simulation reaches (or the
        tolerance, if that is larger): over many oscillations in a period, nothing better is proven of them.

    Examples
    --------
    >>> result = lfo.solve(lfo.library.scanner())
    >>> print(result.between_samples)
    speed exceeds its upper bound by 0.0349 mm/s (3.7 %) at 0.00094991 s
    """

    bounds: tuple[BoundPeak, ...]
    simulated: tuple[str, ...] = ()

    @property
    def worst(self) -> BoundPeak:
        """Return the bound with the largest relative violation."""
        return self.bounds[first_largest(np.array([bound.relative for bound in self.bounds]))[0]]

    @property
    def holds(self) -> bool:
        """Whether all state bounds hold at every instant, within the tolerance of conditions."""
        return all(bound.holds for bound in self.bounds)

    def __str__(self) -> str:
        text = "all state bounds hold between the samples" if self.holds else str(self.worst)
        if self.simulated:
            names = first_few([short_name(name) for name in self.simulated])
            text += f", by a simulation (the rigorous at_most of {names} is more than ten times as large)"
        return text


def bounds_between_samples(problem: OptimalControlProblem, trajectory: Trajectory) -> BetweenSamples | None:
    """Return the largest violation of every state bound over all instants of a continuous plant.

    Within a period a bound that depends on time is the wider one of both samples. The bounds of the ends play no part.

    Parameters
    ----------
    problem : OptimalControlProblem
    trajectory : Trajectory
        Of its shape; its controls are constant over each period.

    Returns
    -------
    BetweenSamples or None
        None without a continuous plant or state bounds, if the control is modulated within a period (duty cycles of
        levels), or if the plant is so stiff that h |A| is above ``LARGEST_REACH``.
    """
    plant, step, control_set = problem.form.plant, problem.sampling_time, problem.control_set
    modulated = isinstance(control_set, ConvexSet) and len(control_set.levels_of(problem.control_dim)) > 0
    if plant is None or step is None or modulated:
        return None
    boxes, n = problem.state_boxes, len(plant.A)
    upper, lower = np.maximum(boxes.upper[:-1], boxes.upper[1:]), np.minimum(boxes.lower[:-1], boxes.lower[1:])
    limits = np.hstack([upper[:, :n], -lower[:, :n]])  # of x and of -x
    rows = np.flatnonzero(np.isfinite(limits).any(axis=0))
    parts = max(1, ceil(plant.balance()[0] * step / REACH))
    if not len(rows) or parts * REACH > LARGEST_REACH:
        return None
    components = rows % n
    sizes = np.array([_size(problem, trajectory.x, int(i)) for i in components])
    peaks = _LargestValues(np.where(rows < n, 1.0, -1.0), components, limits[:, rows], RESOLUTION * sizes)
    error = peaks.search(plant, trajectory.x[:-1, :n], trajectory.u, step / parts, parts)
    at_most = peaks.proven + error
    loose = components[at_most > MUCH * np.maximum(peaks.values, CONDITION_TOLERANCE * sizes)]
    figures = np.stack([peaks.values, at_most, peaks.values / sizes, peaks.times], axis=1).tolist()
    named = [(int(row % n), problem.state_names[row % n], "upper" if row < n else "lower") for row in rows]
    bounds = (BoundPeak(*name, *values) for name, values in zip(named, figures, strict=True))
    return BetweenSamples(tuple(bounds), tuple(problem.state_names[i] for i in np.unique(loose)))


def _size(problem: OptimalControlProblem, x: Array, i: int) -> float:
    """Return half the least width of the bounds of a state; half its range over x if these are not finite and apart."""
    widths = problem.state_boxes.upper[:, i] - problem.state_boxes.lower[:, i]
    widths = widths[np.isfinite(widths) & (widths > 0)]
    if len(widths):
        return float(widths.min()) / 2
    return float(np.ptp(x[:, i])) / 2 or float(np.abs(x[:, i]).max()) or 1.0


class _LargestValues:
    """Largest values of sign * x_i(t) - limit over all instants, of several rows (component, sign).

    Cells are polynomials b (cells, DEGREE + 1) in Bernstein form, with their row and their start in seconds.
    """

    def __init__(self, signs: Array, components: Indices, limits: Array, resolution: Array):
        self._signs, self._components, self._limits, self._resolution = signs, components, limits, resolution
        self.values, self.proven = np.full(len(signs), -np.inf), np.full(len(signs), -np.inf)
        self.times = np.zeros(len(signs))

    def search(self, plant: ContinuousPlant, x: Array, u: Array, w: float, parts: int) -> Array:
        """Search all periods, of ``parts`` cells of length w each; return a bound of the errors of each row."""
        norm, units = plant.balance()
        growth = RADIUS_MARGIN * float(np.abs(plant.flow(w) * units / units[:, None]).sum(axis=1).max())
        remainder = w * (w * norm) ** DEGREE * np.exp(w * norm) / factorial(DEGREE + 1)
        drive, sizes = u @ plant.B.T + plant.offset, np.abs(u) @ np.abs(plant.B).T + np.abs(plant.offset)
        periods, used = w * parts * np.arange(float(len(x))), np.flatnonzero(np.isfinite(self._limits).ravel())
        b, row, start = np.empty((0, DEGREE + 1)), np.empty(0, dtype=np.intp), np.empty(0)
        y, error, largest_error = x, 0.0, 0.0
        for part in range(parts):
            powers = np.empty((DEGREE + 1, *y.shape))
            powers[0], powers[1] = y, w * (y @ plant.A.T + drive)
            for j in range(2, DEGREE + 1):
                powers[j] = powers[j - 1] @ plant.A.T * (w / j)
            rates = (np.abs(powers[1]) / (w * units)).max(initial=0.0)
            terms = ((np.abs(y) + w * (np.abs(y) @ np.abs(plant.A).T + sizes)) / units).max(initial=0.0)
            error = growth * error + remainder * rates + ROUNDING * len(units) * terms
            largest_error = max(largest_error, error)
            hulls = np.tensordot(BERNSTEIN, self._signs * powers[:, :, self._components], axes=1) - self._limits
            cells = hulls.reshape(DEGREE + 1, -1).T[used]
            new = self._prune(cells, used % len(self._signs), (periods + part * w)[used // len(self._signs)], w)
            b, row, start = np.vstack([b, new[0]]), np.append(row, new[1]), np.append(start, new[2])
            y = powers.sum(axis=0)
        for _ in range(LATEST_HALVING):
            b, row, start = self._prune(b, row, start, w)
            if not len(b):
                break
            left, right, w = np.empty_like(b), np.empty_like(b), w / 2
            for j in range(DEGREE + 1):  # de Casteljau's algorithm
                left[:, j], right[:, DEGREE - j] = b[:, 0], b[:, -1]
                b = (b[:, :-1] + b[:, 1:]) / 2
            b, row, start = np.vstack([left, right]), np.tile(row, 2), np.append(start, start + w)
        np.maximum.at(self.proven, row, b.max(axis=1, initial=-np.inf))
        self.proven = np.maximum(self.proven, self.values + self._resolution)
        return largest_error * units[self._components] + 2 * np.finfo(np.float64).eps * np.abs(self.values)

    def _prune(self, b: Array, row: Indices, start: Array, w: float) -> tuple[Array, Indices, Array]:
        """Note the values at both ends of cells of length w, and return the cells with larger coefficients."""
        for values, times in ((b[:, 0], start), (b[:, -1], start + w)):
            for i in np.unique(row):
                seen, at = np.append(self.values[i], values[row == i]), np.append(self.times[i], times[row == i])
                self.values[i], self.times[i] = seen.max(), at[first_largest(seen, at)]
        wider = b.max(axis=1, initial=-np.inf) > self.values[row] + self._resolution[row]
        return b[wider], row[wider], start[wider]
