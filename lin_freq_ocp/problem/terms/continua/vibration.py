# ruff: noqa: D102  (a method without a docstring is described by the class that it implements)
"""What a held signal leaves ringing in modes q'' + 2 zeta w q' + w^2 q = w^2 v, whose (w, zeta) lie in a box.

With the eigenvalue s = w (-zeta + i sqrt(1 - zeta^2)), z = exp(s h), and no signal after N samples, it is |V|,

    V = (z - 1) / sqrt(1 - zeta^2) sum_t v_t z^(N-1-t).

In y = ln s = ln w + i phi, the sum times (z - 1) is analytic and sqrt(1 - zeta^2) = sin(phi): ln |V| is subharmonic,
as the second derivative of -ln sin(phi) is 1/sin(phi)^2. The box is a rectangle in y: the largest |V| is on its edges.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Mask, extended
from lin_freq_ocp.problem.terms.continua.scaled_map import ScaledMap
from lin_freq_ocp.problem.terms.continuum import Continuum


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
        return (turned - 1) / np.sqrt(1 - self._damping**2)

    @property
    def _angles(self) -> ComplexArray:
        """Return s h, (groups,)."""
        w, damping = (2 * np.pi * self.sampling_time) * extended(self.at[:, 0]), self._damping
        return w * (-damping + 1j * np.sqrt(1 - damping**2))

    @property
    def _damping(self) -> Array:
        return extended(self.at[:, 1])

    @cached_property
    def _factors(self) -> tuple[ComplexArray, ComplexArray]:
        B, s = int(np.ceil(np.sqrt(self.samples))), self._angles[:, None]
        left = self.samples - 1 - B * np.arange(-(-self.samples // B))
        return self.gain[:, None] * np.exp(s * left), np.exp(-s * np.arange(B))


@dataclass(frozen=True, eq=False)
class PlantBox(Continuum):
    """|V| <= limit for every mode of a box."""

    low: Array  # natural frequency in Hz and damping ratio, (2,)
    high: Array
    limit: float
    sampling_time: float

    def limit_at(self, points: Array) -> Array:
        return np.where(((points >= self.low) & (points <= self.high)).all(axis=1), self.limit, np.inf)

    def first_points(self) -> Array:
        """Return points on the edges, a bin of the signal's DFT apart at most."""
        per_edge = [np.linspace(0.0, 1.0, int(np.ceil(self.bins(edge))) + 1) for edge in self.edges]
        found = [self.modes_on(edge, share) for edge, share in zip(self.edges, per_edge, strict=True)]
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

    def modes_on(self, edge: tuple[complex, complex], share: Array) -> Array:
        """Return the modes at shares (k,) of the way along an edge, (k, 2)."""
        y = edge[0] + (edge[1] - edge[0]) * share
        return np.clip(np.column_stack([np.exp(y.real) / (2 * np.pi), -np.cos(y.imag)]), self.low, self.high)
