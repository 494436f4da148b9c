"""Polyhedral regions in (x, u): whether they cover the sets or overlap, where they meet, and whether the map jumps.

Every question is a linear program: the radius of the largest ball in a polyhedron, in units of the sets' half widths.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linprog

from lin_freq_ocp.errors import NumericalError, ProblemError
from lin_freq_ocp.problem.arrays import Array, brief
from lin_freq_ocp.problem.piecewise_affine import ModeArrays, PiecewiseAffineDynamics
from lin_freq_ocp.problem.sets import Box

THICKNESS = 1e-7
"""A gap or an overlap counts if a ball of this radius fits in, relative to the half widths of the sets."""

SAME_FACET = 1e-9
"""Largest difference of two rows, divided by their norms, that are one and the same hyperplane."""

CONTINUITY_TOLERANCE = 1e-9
"""Jump of the map across a border, relative to the terms it is made of, up to which it is continuous."""


@dataclass(frozen=True, eq=False)
class Border:
    """Where the regions of two modes meet: h_x'x + h_u'u = limit, with the first mode below.

    Attributes
    ----------
    first, second : int
        The modes.
    h_x : (n,), h_u : (m,), limit : float
        The facet, h_x'x + h_u'u <= limit for the first mode.
    g : (n,)
        D f_first - D f_second = g h' where the map is continuous.
    jump : float
        Largest difference of the two maps on the border, over the sets, relative to its terms.
    time : int or None
        The time, if the dynamics depend on it.
    """

    first: int
    second: int
    h_x: Array
    h_u: Array
    limit: float
    g: Array
    jump: float
    time: int | None = None

    @property
    def continuous(self) -> bool:
        """Whether the map does not jump here."""
        return self.jump <= CONTINUITY_TOLERANCE


@dataclass(frozen=True, eq=False)
class _Pieces:
    """The modes of one time in y = (x, u) / units: maps F y + c, regions rows y <= limits, box rows apart."""

    maps: Array
    offsets: Array
    rows: list[Array]
    limits: list[Array]
    box_rows: Array
    box_limits: Array


def require_partition(dynamics: PiecewiseAffineDynamics, horizon: int, states: Box, controls: Box) -> None:
    """Raise ProblemError unless the regions cover the boxes and overlap on borders only."""
    names, checked = dynamics.mode_names, None
    for t, pieces, units in _times(dynamics, horizon, states, controls):
        if checked is not None and _same_regions(checked, pieces):
            continue
        checked = pieces
        when = "" if t is None else f" at t = {t}"
        for i, j in _pairs(len(names)):
            rows, limits = np.vstack([pieces.rows[i], pieces.rows[j]]), np.append(pieces.limits[i], pieces.limits[j])
            point = _inner_point(pieces, rows, limits)
            if point is not None:
                where = brief([float(f"{value:.4g}") for value in point * units])
                raise ProblemError(
                    f"dynamics.modes[{j}]",
                    f"a region that overlaps that of {names[i]!r}{when}, around (x, u) = {where}",
                    "regions that meet on borders only",
                )
        point = _uncovered(pieces, 0, np.zeros((0, len(units))), np.zeros(0))
        if point is not None:
            where = brief([float(f"{value:.4g}") for value in point * units])
            raise ProblemError(
                "dynamics.modes",
                f"no mode around (x, u) = {where}{when}",
                "regions that cover the state and control sets",
                "Widen a region or tighten the bounds.",
            )


def borders(dynamics: PiecewiseAffineDynamics, horizon: int, states: Box, controls: Box) -> tuple[Border, ...]:
    """Return every border that regions share within the boxes."""
    n = dynamics.state_dim
    found: list[Border] = []
    for t, pieces, units in _times(dynamics, horizon, states, controls):
        for i, j in _pairs(len(dynamics.modes)):
            for row, limit in _shared_facets(pieces, i, j):
                g, jump = _jump(pieces, i, j, row, limit)
                normal = row / units
                size = float(np.linalg.norm(normal))
                normal, edge = normal / size, limit / size
                found.append(Border(i, j, normal[:n], normal[n:], edge, g * size, jump, t))
    return tuple(found)


def _times(
    dynamics: PiecewiseAffineDynamics, horizon: int, states: Box, controls: Box
) -> Iterator[tuple[int | None, _Pieces, Array]]:
    """Yield the pieces of every time that differs, with the half widths of the boxes as units."""
    lower = np.concatenate([states.lower.min(0), controls.lower.min(0)])
    upper = np.concatenate([states.upper.max(0), controls.upper.max(0)])
    bounded = np.isfinite(lower) & np.isfinite(upper) & (upper > lower)
    units = np.where(bounded, (upper - np.where(bounded, lower, 0.0)) / 2, 1.0)
    arrays = dynamics.arrays(horizon if dynamics.time_varying else 1)
    identity = np.eye(len(units))
    box_rows = np.vstack([identity[np.isfinite(upper)], -identity[np.isfinite(lower)]])
    box_limits = np.concatenate([(upper / units)[np.isfinite(upper)], (-lower / units)[np.isfinite(lower)]])
    for t in range(len(arrays.h)):
        yield (t if dynamics.time_varying else None), _pieces(arrays, t, units, box_rows, box_limits), units


def _pieces(arrays: ModeArrays, t: int, units: Array, box_rows: Array, box_limits: Array) -> _Pieces:
    matrices = np.concatenate([arrays.G[t], arrays.H[t]], axis=-1) * units
    norms = np.linalg.norm(matrices, axis=-1)
    real = np.isfinite(arrays.h[t]) & (norms > 0)
    return _Pieces(
        maps=np.concatenate([arrays.A[t], arrays.B[t]], axis=-1) * units,
        offsets=arrays.offset[t],
        rows=[matrix[keep] / norm[keep, None] for matrix, keep, norm in zip(matrices, real, norms, strict=True)],
        limits=[limit[keep] / norm[keep] for limit, keep, norm in zip(arrays.h[t], real, norms, strict=True)],
        box_rows=box_rows,
        box_limits=box_limits,
    )


def _same_regions(one: _Pieces, other: _Pieces) -> bool:
    """Whether the regions of two times are the same; their maps may differ."""
    return all(map(np.array_equal, [*one.rows, *one.limits], [*other.rows, *other.limits]))


def _pairs(count: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(count) for j in range(i + 1, count)]


def _inner_point(pieces: _Pieces, rows: Array, limits: Array, plane: tuple[Array, float] | None = None) -> Array | None:
    """Return the centre of the largest ball in rows y <= limits and the box, if it has the radius THICKNESS.

    With a plane (a, b), |a| = 1, the ball lies in a'y = b.
    """
    matrix, right = np.vstack([rows, pieces.box_rows]), np.append(limits, pieces.box_limits)
    across = matrix if plane is None else matrix - np.outer(matrix @ plane[0], plane[0])
    radii = np.linalg.norm(across, axis=1)
    inequalities = np.column_stack([matrix, radii])
    cost = np.zeros(matrix.shape[1] + 1)
    cost[-1] = -1.0
    equal = () if plane is None else (np.append(plane[0], 0.0)[None], np.array([plane[1]]))
    bounds = [(None, None)] * matrix.shape[1] + [(None, 1.0)]
    answer: Any = linprog(cost, inequalities, right, *equal, bounds=bounds, method="highs")
    if answer.status == 2:
        return None
    if answer.status != 0:
        raise NumericalError(f"A linear program about the regions of modes ended as: {answer.message}")
    return np.asarray(answer.x[:-1]) if answer.x[-1] > THICKNESS else None


def _uncovered(pieces: _Pieces, i: int, rows: Array, limits: Array) -> Array | None:
    """Return a point of rows y <= limits and the box, with a ball around it, that modes i, i+1, ... do not cover."""
    point = _inner_point(pieces, rows, limits)
    if point is None or i == len(pieces.rows):
        return point
    for row, limit in zip(pieces.rows[i], pieces.limits[i], strict=True):
        beyond = _uncovered(pieces, i + 1, np.vstack([rows, -row]), np.append(limits, -limit))
        if beyond is not None:
            return beyond
        rows, limits = np.vstack([rows, row]), np.append(limits, limit)
    return None


def _shared_facets(pieces: _Pieces, i: int, j: int) -> Iterator[tuple[Array, float]]:
    """Yield (a, b), |a| = 1: region i has a'y <= b, region j a'y >= b, and both touch it in more than an edge."""
    for row, limit in zip(pieces.rows[i], pieces.limits[i], strict=True):
        opposite = np.abs(pieces.rows[j] + row).max(axis=1, initial=0.0) <= SAME_FACET
        opposite &= np.abs(pieces.limits[j] + limit) <= SAME_FACET * max(1.0, abs(limit))
        if opposite.any():
            rows, limits = np.vstack([pieces.rows[i], pieces.rows[j]]), np.append(pieces.limits[i], pieces.limits[j])
            others = np.linalg.norm(rows - np.outer(rows @ row, row), axis=1) > SAME_FACET
            if _inner_point(pieces, rows[others], limits[others], (row, float(limit))) is not None:
                yield row, float(limit)


def _jump(pieces: _Pieces, i: int, j: int, row: Array, limit: float) -> tuple[Array, float]:
    """Return g with D f_i - D f_j = g row' (the nearest such), and the largest relative difference on the border."""
    difference, offset = pieces.maps[i] - pieces.maps[j], pieces.offsets[i] - pieces.offsets[j]
    g = difference @ row
    rest = np.abs(difference - np.outer(g, row)).sum(axis=1) + np.abs(offset + g * limit)
    terms = np.abs(pieces.maps[i]).sum(axis=1) + np.abs(pieces.maps[j]).sum(axis=1)
    terms += np.abs(pieces.offsets[i]) + np.abs(pieces.offsets[j])
    return g, float((rest / np.where(terms > 0, terms, 1.0)).max())
