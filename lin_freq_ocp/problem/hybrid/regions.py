"""Polyhedral regions in (x, u): overlaps, gaps, switching boundaries, and jumps of the map there.

The natural unit of a component is the half width of its bounds, or the extent of the regions along it if that is less
or if the component has no bounds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TypeVar

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask, brief
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.polyhedra import (
    FLAT,
    SAME_FACET,
    THICKNESS,
    Cell,
    ball_centre,
    cell_of,
    natural_sizes,
    uncovered_point,
)
from lin_freq_ocp.problem.dynamics.base import SwitchingBoundary
from lin_freq_ocp.problem.hybrid.affine_mode import FACET_TOLERANCE, ModeArrays
from lin_freq_ocp.problem.sets.stage_rows import StageSet, StageSets

# A map whose jump across a switching boundary is below this, relative to its terms, is continuous: linearised matrices
# have errors of about 1e-9, and the judge accepts ten times as much, FACET_TOLERANCE.
CONTINUITY_TOLERANCE = 1e-7
FIXED_WIDTH = 1e-9  # a component whose bounds differ by less, relative to their size, is fixed
# Rows with a smaller extent along a component, relative to its half width, do not reduce its unit: smaller lengths may
# be rounding, and THICKNESS times this is still a hundred times above rounding.
LEAST_UNIT = 1e-6


Fault = TypeVar("Fault")
_Overlap = tuple[int, int, str]  # two modes, and a point of both in words


@dataclass(frozen=True, eq=False)
class SwitchingFacet(SwitchingBoundary):
    """A shared facet of two modes, h_x'x + h_u'u = limit with |(h_x, h_u)| = 1; the first mode is on the lower side."""

    first: int
    second: int
    h_x: Array
    h_u: Array
    limit: float
    g: Array  # (n,): D f_first - D f_second = g h' if the map is continuous
    jump: float  # bound on the difference of the maps on the facet within the sets' bounds, relative to its terms
    time: int | None = None  # of a time-varying facet

    @property
    def continuous(self) -> bool:
        """Whether the map is continuous across the facet."""
        return self.jump <= CONTINUITY_TOLERANCE


@dataclass(frozen=True, eq=False)
class _Pieces:
    """The regions of one time in y = (v - centre) / units, v = (x, u)."""

    cells: list[Cell]  # the regions, in all components of y
    domain: Cell  # the sets, in the free components of y
    free: Mask  # (n + m,): components that their bounds do not fix; y is 0 for the others
    centre: Array
    units: Array
    extent: Array  # (n + m,): the largest |y| within the bounds; 1 without bounds

    def point_text(self, y: Array) -> str:
        """Return the point (x, u) of free components y in words."""
        v = self.centre.copy()
        v[self.free] += self.units[self.free] * y
        return brief([float(f"{value:.4g}") for value in v], 200)

    @property
    def key(self) -> bytes:
        """Return a key that equal pieces share."""
        parts = [self.centre, self.units, self.free.astype(float), self.domain.normals, self.domain.limits]
        parts += [part for cell in self.cells for part in (cell.normals, cell.limits)]
        return b"|".join(part.tobytes() for part in parts)


class CheckedRegions:
    """A cache of the overlaps and gaps of regions, which are costly to find, by the keys of their pieces.

    ``names`` are those of the modes; ``constant``: no region depends on time.
    """

    def __init__(self, names: Sequence[str], constant: bool):
        self.names, self.constant = names, constant
        self._overlaps = dict[bytes, _Overlap | None]()
        self._gaps = dict[bytes, str | None]()

    def require_apart(self, arrays: ModeArrays, sets: StageSets) -> None:
        """Raise ProblemError unless regions overlap on facets only."""
        fault = self._first_fault(arrays, sets, self._overlaps, _overlap)
        if fault is not None:
            (first, second, point), when = fault
            got = f"a region that overlaps that of {self.names[first]!r}{when}, around (x, u) = {point}"
            raise ProblemError(f"dynamics.modes[{second}]", got, "regions that overlap on switching boundaries only")

    def gap(self, arrays: ModeArrays, sets: StageSets) -> str | None:
        """Return a point of the sets outside all regions, in words; None if the regions cover the sets."""
        fault = self._first_fault(arrays, sets, self._gaps, _gap)
        return None if fault is None else f"around (x, u) = {fault[0]}{fault[1]}"

    def _first_fault(
        self,
        arrays: ModeArrays,
        sets: StageSets,
        known: dict[bytes, Fault | None],
        fault_of: Callable[[_Pieces], Fault | None],
    ) -> tuple[Fault, str] | None:
        """Return the first fault over all times, and its time in words; a fault needs one within the union of sets."""

        def cached_fault(t: int, stage: StageSet) -> Fault | None:
            pieces = _pieces(arrays, t, stage)
            if pieces.key not in known:
                known[pieces.key] = fault_of(pieces)
            return known[pieces.key]

        if self.constant:
            fault = cached_fault(0, sets.around())
            if fault is None or sets.constant:
                return None if fault is None else (fault, "")
        faults = ((cached_fault(t, sets.at(t)), f" at t = {t}") for t in range(sets.horizon))
        return next(((fault, when) for fault, when in faults if fault is not None), None)


def meets_gap(arrays: ModeArrays, sets: StageSets, t: int, v: Array, modes: Mask) -> bool:
    """Whether modes that hold at v = (x_t, u_t) leave a part of the sets next to v uncovered.

    Near v, a region is the cone of its rows that are active at v, within FACET_TOLERANCE; so are the sets.
    """
    pieces = _pieces(arrays, t, sets.at(t))
    y = (v - pieces.centre) / pieces.units
    free, columns = y[pieces.free], np.eye(len(y))[:, pieces.free]
    cells = [_cone(cell, y).restricted(np.zeros(len(y)), columns) for cell in np.array(pieces.cells)[modes]]
    near = np.eye(len(free))
    ball = Cell(np.vstack([near, -near]), np.ones(2 * len(free)))
    return uncovered_point(ball & _cone(pieces.domain, free), [cell for cell in cells if cell is not None]) is not None


def switching_facets(arrays: ModeArrays, sets: StageSets, time_varying: bool) -> tuple[SwitchingFacet, ...]:
    """Return every facet that two regions share within the sets."""
    n, around = arrays.A.shape[-1], sets.around()
    known: dict[bytes, list[tuple[int, int, Array, float]]] = {}
    boundaries: list[SwitchingFacet] = []
    for t in range(sets.horizon if time_varying else 1):
        pieces = _pieces(arrays, t, around)
        if pieces.key not in known:
            pairs = combinations(range(len(pieces.cells)), 2)
            facets = [(i, j, _shared_facet(pieces, i, j)) for i, j in pairs]
            known[pieces.key] = [(i, j, *facet) for i, j, facet in facets if facet is not None]
        for i, j, row, limit in known[pieces.key]:
            g, jump = _jump(arrays, t, (i, j), pieces, row, limit)
            normal = row / pieces.units
            size = float(np.linalg.norm(normal))
            edge = (limit + float(normal @ pieces.centre)) / size
            time = t if time_varying else None
            boundaries.append(SwitchingFacet(i, j, normal[:n] / size, normal[n:] / size, edge, g * size, jump, time))
    return tuple(boundaries)


def _pieces(arrays: ModeArrays, t: int, sets: StageSet) -> _Pieces:
    """Return the regions of one time in natural units."""
    below, above = np.isfinite(sets.lower), np.isfinite(sets.upper)
    lower, upper = np.where(below, sets.lower, 0.0), np.where(above, sets.upper, 0.0)
    centre = np.where(below & above, (lower + upper) / 2, lower + upper)
    width = np.where(below & above, upper - lower, np.inf)
    fixed = width <= FIXED_WIDTH * np.maximum(np.abs(lower), np.abs(upper))
    matrices = np.concatenate([arrays.G[t], arrays.H[t]], axis=-1)
    limits, set_limits = arrays.h[t] - matrices @ centre, sets.limits - sets.matrix @ centre
    rows, right = np.vstack([*matrices, sets.matrix]), np.concatenate([*limits, set_limits])
    finite = np.isfinite(right)
    units = natural_sizes(rows[finite], right[finite], np.where(fixed, 0.0, width / 2), LEAST_UNIT)
    cells = [cell_of(matrix * units, limit) for matrix, limit in zip(matrices, limits, strict=True)]
    free, identity = ~fixed, np.eye(len(centre))
    walls = np.vstack([identity[above & free], -identity[below & free]])[:, free]
    distances = np.concatenate([((upper - centre) / units)[above & free], ((centre - lower) / units)[below & free]])
    within = cell_of(np.vstack([walls, (sets.matrix * units)[:, free]]), np.append(distances, set_limits))
    if within is None or within.inner_point(THICKNESS) is None:  # some rows are equations: only the bounds count
        within = Cell(walls, distances)
    extent = np.where(below & above, np.where(fixed, 0.0, width / 2) / units, 1.0)
    return _Pieces([cell for cell in cells if cell is not None], within, free, centre, units, extent)


def _gap(pieces: _Pieces) -> str | None:
    """Return a point of one time that no mode covers, in words."""
    columns = np.eye(len(pieces.free))[:, pieces.free]
    regions = [cell.restricted(np.zeros(len(pieces.free)), columns) for cell in pieces.cells]
    point = uncovered_point(pieces.domain, [region for region in regions if region is not None])
    return None if point is None else pieces.point_text(point)


def _cone(cell: Cell, y: Array) -> Cell:
    """Return the cone of directions from a point into its cell: the active rows, with limits of zero."""
    active = cell.limits - cell.normals @ y <= FACET_TOLERANCE * (1 + np.abs(cell.limits))
    return Cell(cell.normals[active], np.zeros(int(active.sum())))


def _overlap(pieces: _Pieces) -> _Overlap | None:
    """Return the first two regions that overlap within the sets, and the centre of a ball in both, in words."""
    domain = pieces.domain
    for (i, first), (j, second) in combinations(enumerate(pieces.cells), 2):
        if first.apart_from(second, THICKNESS):
            continue
        normals = np.vstack([first.normals[:, pieces.free], second.normals[:, pieces.free], domain.normals])
        limits = np.concatenate([first.limits, second.limits, domain.limits])
        point = ball_centre(normals, limits, np.ones(len(limits)), THICKNESS)
        if point is not None:
            return i, j, pieces.point_text(point)
    return None


def _shared_facet(pieces: _Pieces, i: int, j: int) -> tuple[Array, float] | None:
    """Return (a, b), |a| = 1, with a'y <= b in region i and a'y >= b in region j, if they share a facet there.

    Regions on opposite sides of two hyperplanes meet in an edge at most, the intersection of the two.
    """
    first, second = pieces.cells[i], pieces.cells[j]
    opposite = np.abs(first.normals[:, None] + second.normals).max(axis=-1, initial=0.0) <= SAME_FACET
    size = np.maximum(1.0, np.abs(first.limits))[:, None]
    opposite &= np.abs(first.limits[:, None] + second.limits) <= SAME_FACET * size
    facing = np.flatnonzero(opposite.any(axis=1))
    if not len(facing):
        return None
    row, limit = first.normals[facing[0]], float(first.limits[facing[0]])
    if not first.take(facing).same_as(row, limit).all():
        return None
    both = first & second
    others = both.take(~both.same_as(row, limit) & ~both.same_as(-row, -limit))
    # a ball within the hyperplane row'y = limit must fit into the other rows, with its centre in the sets
    domain, along = pieces.domain, row[pieces.free]
    length = float(np.linalg.norm(along))
    if length <= FLAT:
        if abs(limit) > SAME_FACET:
            return None
        plane, inside = None, np.ones(len(domain.limits))
    else:
        direction = along / length
        plane = direction, limit / length
        inside = _part_across(domain.normals, direction)
    normals = np.vstack([others.normals[:, pieces.free], domain.normals])
    radii = np.append(_part_across(others.normals, row), inside)
    centre = ball_centre(normals, np.append(others.limits, domain.limits), radii, THICKNESS, plane)
    return None if centre is None else (row, limit)


def _part_across(normals: Array, direction: Array) -> Array:
    """Return the lengths of the parts of vectors perpendicular to a direction of length 1."""
    return np.linalg.norm(normals - np.outer(normals @ direction, direction), axis=1)


def _jump(
    arrays: ModeArrays, t: int, pair: tuple[int, int], pieces: _Pieces, row: Array, limit: float
) -> tuple[Array, float]:
    """Return the best g in D f_i - D f_j = g row', and a bound on the relative difference of the maps on the facet."""
    maps = [np.concatenate([arrays.A[t, i], arrays.B[t, i]], axis=-1) for i in pair]
    difference, offset = (maps[0] - maps[1]) * pieces.units, arrays.offset[t, pair[0]] - arrays.offset[t, pair[1]]
    offset = offset + (maps[0] - maps[1]) @ pieces.centre
    g = difference @ row
    rest = np.abs(difference - np.outer(g, row)) @ pieces.extent + np.abs(offset + g * limit)
    largest = np.abs(pieces.centre) + pieces.extent * pieces.units
    terms = (np.abs(maps[0]) + np.abs(maps[1])) @ largest + np.abs(arrays.offset[t, list(pair)]).sum(axis=0)
    return g, float((rest / np.where(terms > 0, terms, 1.0)).max())
