"""Polyhedral regions in (x, u): whether they overlap or leave gaps, where they meet, and whether the map jumps.

Lengths are measured in natural units: of each component the half width of its bounds, or how far the rows of the
regions reach along it, if that is less or if it has none.
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

# Jump of the map across a border, relative to the terms it is made of, up to which it is continuous: matrices
# linearised are right to 1e-9 or so, and what the judge forgives, FACET_TOLERANCE, is ten times as much.
CONTINUITY_TOLERANCE = 1e-7
FIXED_WIDTH = 1e-9  # A component whose bounds are closer than this, relative to their size, is fixed between them
# Rows that reach along a component by less than this part of its half width do not make its unit smaller: what is
# shorter may be rounding, and THICKNESS times this is still a hundred times above it.
LEAST_UNIT = 1e-6


Found = TypeVar("Found")
_Overlap = tuple[int, int, str]  # two modes, and a point of both as text


@dataclass(frozen=True, eq=False)
class SwitchingFacet(SwitchingBoundary):
    """A facet of two modes, h_x'x + h_u'u = limit with |(h_x, h_u)| = 1: the first mode is where it is less."""

    first: int
    second: int
    h_x: Array
    h_u: Array
    limit: float
    g: Array  # (n,): D f_first - D f_second = g h' where the map is continuous
    jump: float  # bound on the difference of the maps on the facet within the sets' bounds, relative to its terms
    time: int | None = None  # if the dynamics depend on it

    @property
    def continuous(self) -> bool:
        """Whether the map does not jump here."""
        return self.jump <= CONTINUITY_TOLERANCE


@dataclass(frozen=True, eq=False)
class _Pieces:
    """The regions of one time in y = (v - centre) / units, v = (x, u)."""

    cells: list[Cell]  # a region each, in all components of y
    domain: Cell  # the sets, in the free components of y
    free: Mask  # (n + m,): components not fixed by their bounds; of the others, y is 0
    centre: Array
    units: Array
    extent: Array  # (n + m,): the largest |y| within the bounds; 1 without

    def point_text(self, y: Array) -> str:
        """Return (x, u) of free components y, as a message shows it."""
        v = self.centre.copy()
        v[self.free] += self.units[self.free] * y
        return brief([float(f"{value:.4g}") for value in v], 200)

    @property
    def key(self) -> bytes:
        """Return what pieces share that are the same."""
        parts = [self.centre, self.units, self.free.astype(float), self.domain.normals, self.domain.limits]
        parts += [part for cell in self.cells for part in (cell.normals, cell.limits)]
        return b"|".join(part.tobytes() for part in parts)


class CheckedRegions:
    """What the regions of dynamics are known to be, by the keys of their pieces: overlaps and gaps are costly to find.

    ``names`` are those of the modes; ``constant``: no region depends on time.
    """

    def __init__(self, names: Sequence[str], constant: bool):
        self.names, self.constant = names, constant
        self._overlaps = dict[bytes, _Overlap | None]()
        self._gaps = dict[bytes, str | None]()

    def require_apart(self, arrays: ModeArrays, sets: StageSets) -> None:
        """Raise ProblemError unless regions overlap on facets only."""
        found = self._first(arrays, sets, self._overlaps, _overlap)
        if found is not None:
            (first, second, point), when = found
            got = f"a region that overlaps that of {self.names[first]!r}{when}, around (x, u) = {point}"
            raise ProblemError(f"dynamics.modes[{second}]", got, "regions that meet on borders only")

    def gap(self, arrays: ModeArrays, sets: StageSets) -> str | None:
        """Return a place in the sets that no region holds, as text; None if they cover the sets."""
        found = self._first(arrays, sets, self._gaps, _gap)
        return None if found is None else f"around (x, u) = {found[0]}{found[1]}"

    def _first(
        self,
        arrays: ModeArrays,
        sets: StageSets,
        known: dict[bytes, Found | None],
        fault: Callable[[_Pieces], Found | None],
    ) -> tuple[Found, str] | None:
        """Return the first fault over all times, and when it is; without any around all sets, there is none."""

        def at(t: int, stage: StageSet) -> Found | None:
            pieces = _pieces(arrays, t, stage)
            if pieces.key not in known:
                known[pieces.key] = fault(pieces)
            return known[pieces.key]

        if self.constant:
            everywhere = at(0, sets.around())
            if everywhere is None or sets.constant:
                return None if everywhere is None else (everywhere, "")
        found = ((at(t, sets.at(t)), f" at t = {t}") for t in range(sets.horizon))
        return next(((one, when) for one, when in found if one is not None), None)


def meets_gap(arrays: ModeArrays, sets: StageSets, t: int, v: Array, modes: Mask) -> bool:
    """Whether these modes, which hold at v = (x_t, u_t), leave a part of the sets next to it uncovered.

    Near v a region is the cone of the rows that it touches, within FACET_TOLERANCE, and so are the sets.
    """
    pieces = _pieces(arrays, t, sets.at(t))
    y = (v - pieces.centre) / pieces.units
    free, columns = y[pieces.free], np.eye(len(y))[:, pieces.free]
    cells = [_cone(cell, y).restricted(np.zeros(len(y)), columns) for cell in np.array(pieces.cells)[modes]]
    near = np.eye(len(free))
    ball = Cell(np.vstack([near, -near]), np.ones(2 * len(free)))
    return uncovered_point(ball & _cone(pieces.domain, free), [cell for cell in cells if cell is not None]) is not None


def borders_of(arrays: ModeArrays, sets: StageSets, time_varying: bool) -> tuple[SwitchingFacet, ...]:
    """Return every border that regions share within the sets."""
    n, around = arrays.A.shape[-1], sets.around()
    known: dict[bytes, list[tuple[int, int, Array, float]]] = {}
    found: list[SwitchingFacet] = []
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
            found.append(SwitchingFacet(i, j, normal[:n] / size, normal[n:] / size, edge, g * size, jump, time))
    return tuple(found)


def _pieces(arrays: ModeArrays, t: int, sets: StageSet) -> _Pieces:
    """Return the regions of one time in natural units."""
    below, above = np.isfinite(sets.lower), np.isfinite(sets.upper)
    lower, upper = np.where(below, sets.lower, 0.0), np.where(above, sets.upper, 0.0)
    centre = np.where(below & above, (lower + upper) / 2, lower + upper)
    width = np.where(below & above, upper - lower, np.inf)
    fixed = width <= FIXED_WIDTH * np.maximum(np.abs(lower), np.abs(upper))
    matrices = np.concatenate([arrays.G[t], arrays.H[t]], axis=-1)
    limits, beyond = arrays.h[t] - matrices @ centre, sets.limits - sets.matrix @ centre
    every, right = np.vstack([*matrices, sets.matrix]), np.concatenate([*limits, beyond])
    known = np.isfinite(right)
    units = natural_sizes(every[known], right[known], np.where(fixed, 0.0, width / 2), LEAST_UNIT)
    cells = [cell_of(matrix * units, limit) for matrix, limit in zip(matrices, limits, strict=True)]
    free, identity = ~fixed, np.eye(len(centre))
    walls = np.vstack([identity[above & free], -identity[below & free]])[:, free]
    distances = np.concatenate([((upper - centre) / units)[above & free], ((centre - lower) / units)[below & free]])
    within = cell_of(np.vstack([walls, (sets.matrix * units)[:, free]]), np.append(distances, beyond))
    if within is None or within.inner_point(THICKNESS) is None:  # equations among the rows: only the bounds remain
        within = Cell(walls, distances)
    extent = np.where(below & above, np.where(fixed, 0.0, width / 2) / units, 1.0)
    return _Pieces([cell for cell in cells if cell is not None], within, free, centre, units, extent)


def _gap(pieces: _Pieces) -> str | None:
    """Return a point of one time that no mode covers, as text."""
    columns = np.eye(len(pieces.free))[:, pieces.free]
    regions = [cell.restricted(np.zeros(len(pieces.free)), columns) for cell in pieces.cells]
    point = uncovered_point(pieces.domain, [region for region in regions if region is not None])
    return None if point is None else pieces.point_text(point)


def _cone(cell: Cell, y: Array) -> Cell:
    """Return the directions into a cell from a point of it: the rows that the point touches, with limits of zero."""
    touched = cell.limits - cell.normals @ y <= FACET_TOLERANCE * (1 + np.abs(cell.limits))
    return Cell(cell.normals[touched], np.zeros(int(touched.sum())))


def _overlap(pieces: _Pieces) -> _Overlap | None:
    """Return the first two regions that overlap in the sets, and the centre of a ball that both hold, as text."""
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
    """Return (a, b), |a| = 1: region i has a'y <= b, region j a'y >= b, and both touch it in more than an edge.

    Regions on different sides of two hyperplanes meet in their intersection at most, which is an edge.
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
    # within the hyperplane row'y = limit, a ball has to fit into the other rows with its centre in the sets
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
    """Return the lengths of what remains of vectors without their parts along a direction of length 1."""
    return np.linalg.norm(normals - np.outer(normals @ direction, direction), axis=1)


def _jump(
    arrays: ModeArrays, t: int, pair: tuple[int, int], pieces: _Pieces, row: Array, limit: float
) -> tuple[Array, float]:
    """Return g with D f_i - D f_j = g row' (the nearest such), and a bound on the relative difference on the border."""
    maps = [np.concatenate([arrays.A[t, i], arrays.B[t, i]], axis=-1) for i in pair]
    difference, offset = (maps[0] - maps[1]) * pieces.units, arrays.offset[t, pair[0]] - arrays.offset[t, pair[1]]
    offset = offset + (maps[0] - maps[1]) @ pieces.centre
    g = difference @ row
    rest = np.abs(difference - np.outer(g, row)) @ pieces.extent + np.abs(offset + g * limit)
    largest = np.abs(pieces.centre) + pieces.extent * pieces.units
    terms = (np.abs(maps[0]) + np.abs(maps[1])) @ largest + np.abs(arrays.offset[t, list(pair)]).sum(axis=0)
    return g, float((rest / np.where(terms > 0, terms, 1.0)).max())
