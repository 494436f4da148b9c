"""Polyhedra {y : a'y <= b, row by row} and boxes: largest balls, coverings, redundant rows, and minima over them.

Every question about polyhedra is the linear program of the largest ball. Its answer is measured again, from its centre
and the rows: a polyhedron that is called empty may hold a ball that the solver has missed; a returned ball is one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.errors import NumericalError, ProblemError

# Of the linear programs' rows and slopes: the least that HiGHS takes, far below the radii below
HIGHS_TOLERANCE = 1e-10
# A gap or an overlap of regions counts if a ball of this radius fits in, in natural units: solvers satisfy rows to
# 1e-8 or so, and within that a point is on both sides.
THICKNESS = 1e-7
# Largest difference of two rows, of length 1 in natural units, that are the same hyperplane: more than what counts as
# no gap, so that regions without a gap between them share a facet.
SAME_FACET = 4 * THICKNESS
EASY_RADIUS = 0.05  # a ball of this radius is sought by projections before a linear program finds the largest
PROJECTIONS, OVERSHOOT = 12, 1.2  # number and length: a little beyond the row, for rows at an acute angle
LARGEST_BALL = 1.0  # the largest radius sought: in an unbounded polyhedron there is no largest
SMALLEST_PIECE = 1e-10  # radius of the largest ball, in natural units, from which a piece has an interior
SAME_FUNCTION = 16 * float(np.finfo(np.float64).eps)  # relative difference of coefficients that is rounding
FLAT = 1e-9  # a row whose normal, or the part of it that counts, is shorter has no direction: rounding
MOST_CORNERS = 100_000  # combinations of rows of which some are the vertices of a polyhedron
OPTIMAL, INFEASIBLE = 0, 2  # statuses of ``linprog``


@dataclass(frozen=True, eq=False)
class Cell:
    """{y : normals y <= limits}."""

    normals: Array  # (rows, d), of length 1
    limits: Array  # (rows,)

    def __and__(self, other: Cell) -> Cell:
        return Cell(np.vstack([self.normals, other.normals]), np.append(self.limits, other.limits))

    def beyond(self, row: int) -> Cell:
        """Return the half space on the other side of a row."""
        return Cell(-self.normals[row : row + 1], -self.limits[row : row + 1])

    def take(self, rows: Indices | Mask | slice) -> Cell:
        """Return the cell of some of the rows."""
        return Cell(self.normals[rows], self.limits[rows])

    def inner_point(self, thickness: float) -> Array | None:
        """Return the centre of the largest ball, (d,), if its radius is above ``thickness``."""
        if self.apart_from(self, thickness):  # opposite rows, as those of a level, need no program
            return None
        return ball_centre(self.normals, self.limits, np.ones(len(self.limits)), thickness)

    def apart_from(self, other: Cell, thickness: float) -> bool:
        """Whether two opposite rows alone leave no ball of radius ``thickness`` in both cells."""
        opposite = np.abs(self.normals[:, None] + other.normals).max(axis=-1, initial=0.0) <= FLAT
        return bool((opposite & (self.limits[:, None] + other.limits <= 2 * thickness)).any())

    def same_as(self, normal: Array, limit: float) -> Mask:
        """Whether each row is the same half space as normal'y <= limit."""
        distance = np.abs(self.normals - normal).max(axis=-1, initial=0.0)
        return (distance <= SAME_FACET) & (np.abs(self.limits - limit) <= SAME_FACET * max(1.0, abs(limit)))

    def restricted(self, foot: Array, along: Array) -> Cell | None:
        """Return the cell in z of y = foot + along z, orthonormal columns; None if a row without direction forbids it.

        A row that is as good as parallel to the columns is kept or broken by the foot alone, within ``SAME_FACET``.
        """
        matrix, limits = self.normals @ along, self.limits - self.normals @ foot
        decided = np.linalg.norm(matrix, axis=1) <= SAME_FACET
        if (limits[decided] < -SAME_FACET * np.maximum(1.0, np.abs(self.limits[decided]))).any():
            return None
        return cell_of(matrix[~decided], limits[~decided])

    def implies(self, other: Cell, row: int) -> bool:
        """Whether one row of this cell alone makes a row of another hold."""
        same = np.abs(self.normals - other.normals[row]).max(axis=-1, initial=0.0) <= FLAT
        return bool((same & (self.limits <= other.limits[row] + FLAT)).any())


def cell_of(matrix: Array, limits: Array) -> Cell | None:
    """Return the cell of rows of any length; rows without limit or direction are left out, None if one cannot hold."""
    norms = np.linalg.norm(matrix, axis=1)
    kept = np.isfinite(limits) & (norms > 0)
    if (limits[~kept] < 0).any():
        return None
    return Cell(matrix[kept] / norms[kept, None], limits[kept] / norms[kept])


def has_interior(matrix: Array, limits: Array, thickness: float) -> bool:
    """Whether matrix y <= limits holds a ball of radius ``thickness`` in natural units."""
    sizes = natural_sizes(matrix, limits, np.full(matrix.shape[1], np.inf), 0.0)
    cell = cell_of(matrix * sizes, limits)
    return cell is not None and cell.inner_point(thickness) is not None


def ball_centre(
    normals: Array, limits: Array, radii: Array, thickness: float, plane: tuple[Array, float] | None = None
) -> Array | None:
    """Return the centre y of the largest ball, normals y + radius * radii <= limits, if its radius is above thickness.

    ``radii``, (rows,), are 1 for rows of length 1, less for a ball in a plane, and 0 (below ``FLAT``) for a row that
    only the centre must satisfy, within ``thickness``. With a ``plane`` (normal, limit), the centre lies in it.
    """
    grows = radii > FLAT
    rows = np.column_stack([normals, np.where(grows, radii, 0.0)])
    right = np.where(grows, limits, limits + thickness)

    def holds(y: Array) -> bool:
        slack = right - normals @ y
        free = (slack[grows] / radii[grows]).min(initial=LARGEST_BALL) > thickness
        in_plane = plane is None or abs(plane[0] @ y - plane[1]) <= thickness
        return bool(np.isfinite(y).all() and free and in_plane and (slack[~grows] >= 0).all())

    y = _project(normals, right - EASY_RADIUS * rows[:, -1], plane)
    if y is not None and EASY_RADIUS > thickness and holds(y):
        return y
    y = _largest_ball(rows, right, plane)
    return y if y is not None and holds(y) else None


def _project(normals: Array, right: Array, plane: tuple[Array, float] | None) -> Array | None:
    """Return a point of normals y <= right by projections on the most violated row, None if a few do not lead there."""
    y, steps = np.zeros(normals.shape[1]), normals
    if plane is not None:
        along = plane[0] / (plane[0] @ plane[0])
        y, steps = plane[1] * along, normals - np.outer(normals @ along, plane[0])
    steps = steps / np.maximum((steps**2).sum(axis=1), FLAT)[:, None]
    for _ in range(PROJECTIONS):
        slack = right - normals @ y
        row = int(np.argmin(np.append(slack, 0.0)))
        if row == len(slack):
            return y
        y = y + OVERSHOOT * slack[row] * steps[row]
    return None


def _largest_ball(rows: Array, right: Array, plane: tuple[Array, float] | None) -> Array | None:
    """Return y of the largest r with rows (y, r) <= right and r <= 1; None without one."""
    from scipy.optimize import linprog  # slow to import

    d = rows.shape[1] - 1
    bounds = [(None, None)] * d + [(None, LARGEST_BALL)]
    equal = (None, None) if plane is None else (np.append(plane[0], 0.0)[None], np.array([plane[1]]))
    answer = linprog(
        -np.eye(d + 1)[-1],
        rows,
        right,
        *equal,
        bounds,
        method="highs-ds",
        options={"primal_feasibility_tolerance": HIGHS_TOLERANCE, "dual_feasibility_tolerance": HIGHS_TOLERANCE},
    )
    if answer.status not in (OPTIMAL, INFEASIBLE):
        raise NumericalError(f"The largest ball in a polyhedron was not found: {answer.message}")
    return None if answer.x is None or answer.status == INFEASIBLE else np.asarray(answer.x[:-1])


def irredundant(cell: Cell, thickness: float) -> Indices:
    """Return the rows that the others do not imply: outside of each, a ball fits into all others."""
    needed = list(range(len(cell.limits)))
    for row in range(len(cell.limits)):
        others = cell.take(np.array([k for k in needed if k != row], dtype=int))
        if (others & cell.beyond(row)).inner_point(thickness) is None:
            needed.remove(row)
    return np.array(needed, dtype=int)


def uncovered_point(domain: Cell, cells: Sequence[Cell]) -> Array | None:
    """Return a point of the domain outside all cells; None if they cover it.

    What is left uncovered in the interior ends at facets of cells. So each facet must have other cells on its far side:
    those that hold on it and have not the same facet. They are looked for in the plane of the facet, by cutting it.
    """
    fat = [(domain & cell).inner_point(THICKNESS) is not None for cell in cells]
    if not any(fat):
        return domain.inner_point(THICKNESS)
    for i, cell in enumerate(cells):
        for row in range(len(cell.limits) if fat[i] else 0):
            normal, limit = cell.normals[row], float(cell.limits[row])
            if domain.same_as(normal, limit).any():
                continue
            foot, along = limit * normal, np.linalg.qr(np.column_stack([normal, np.eye(len(normal))]))[0][:, 1:]
            facet = (domain & cell.take(~cell.same_as(normal, limit))).restricted(foot, along)
            point = None
            if facet is not None:
                point = _point_of_facet(facet, _FarSide(cells, i, normal, limit, foot, along), frozenset())
            if point is not None:
                return _point_in_gap(foot + along @ point, normal, domain, cells)
    return None


def _point_of_facet(piece: Cell, far: _FarSide, used: frozenset[int]) -> Array | None:
    """Return the centre of a ball in a piece of the plane that no cell on the far side covers; None without one.

    The piece is cut along the rows of the cell around the centre of its largest ball; each part is searched in turn.
    """
    point = piece.inner_point(THICKNESS)
    if point is None:
        return None
    k = far.around(point, used)
    cell = None if k is None else far.cells[k].restricted(far.foot, far.along)
    if k is None:
        return point
    if cell is None:
        return _point_of_facet(piece, far, used | {k})
    for row in range(len(cell.limits)):
        if piece.implies(cell, row):
            continue
        outside = _point_of_facet(piece & cell.beyond(row), far, used | {k})
        if outside is not None:
            return outside
        piece = piece & cell.take(slice(row, row + 1))
    return None


class _FarSide:
    """What may be on the far side of a facet: all cells but its own and those that have the same one."""

    def __init__(self, cells: Sequence[Cell], own: int, normal: Array, limit: float, foot: Array, along: Array):
        self.cells, self.foot, self.along = cells, foot, along
        d = len(normal)
        lengths = [len(cell.limits) + 1 for cell in cells]  # and an infinite row, as a cell may have none
        self.starts = np.append(0, np.cumsum(lengths)[:-1])
        self.normals = np.vstack([part for cell in cells for part in (cell.normals, np.zeros((1, d)))])
        self.limits = np.concatenate([part for cell in cells for part in (cell.limits, [np.inf])])
        rows = Cell(self.normals, np.where(np.isfinite(self.limits), self.limits, 0.0))
        self.facing = rows.same_as(-normal, -limit)
        self.excluded = np.logical_or.reduceat(rows.same_as(normal, limit), self.starts)
        self.excluded[own] = True

    def around(self, point: Array, used: frozenset[int]) -> int | None:
        """Return the cell that a point of the plane is deepest in, if it is in any."""
        slack = self.limits - self.normals @ (self.foot + self.along @ point)
        margins = np.minimum.reduceat(np.where(self.facing, np.inf, slack), self.starts)
        margins[self.excluded | np.isin(np.arange(len(self.cells)), list(used))] = -np.inf
        k = int(np.argmax(margins))
        return k if margins[k] >= -THICKNESS else None


def _point_in_gap(start: Array, direction: Array, domain: Cell, cells: Sequence[Cell]) -> Array:
    """Return a point halfway from a facet to where, straight on, the next cell begins or the domain ends."""
    ends = [_interval(domain, start, direction)[1], 2 * LARGEST_BALL]
    begins = [interval[0] for cell in cells if (interval := _interval(cell, start, direction))[1] > THICKNESS]
    return start + min(*ends, *(begin for begin in begins if begin > THICKNESS)) / 2 * direction


def _interval(cell: Cell, start: Array, direction: Array) -> tuple[float, float]:
    """Return from where to where a straight line is in a cell, as multiples of the direction; (inf, -inf): nowhere."""
    slack, rate = cell.limits - cell.normals @ start, cell.normals @ direction
    falling, rising = rate < -FLAT, rate > FLAT
    if (slack[~falling & ~rising] < -THICKNESS).any():
        return np.inf, -np.inf
    first = float((slack[falling] / rate[falling]).max(initial=-np.inf))
    last = float((slack[rising] / rate[rising]).min(initial=np.inf))
    return (first, last) if first <= last else (np.inf, -np.inf)


def vertices(matrix: Array, limits: Array) -> tuple[Array, Array]:
    """Return the vertices of a bounded polyhedron, (vertices, d), and bounds of their rounding errors, (d,).

    Raises
    ------
    ProblemError
        If it is empty or unbounded, or has too many combinations of d rows.
    """
    from scipy.optimize import linprog  # slow to import

    finite = np.isfinite(limits)
    F, g, d = matrix[finite], limits[finite], matrix.shape[1]
    field, whole = "disturbance.set", "a bounded polyhedron that is not empty"
    for direction in (*np.eye(d), *-np.eye(d)):
        solved = linprog(direction, A_ub=F, b_ub=g, bounds=(None, None), method="highs") if len(F) else None
        if solved is None or solved.status != OPTIMAL:
            raise ProblemError(field, "a polyhedron without bounds, or without points", whole)
    if comb(len(F), d) > MOST_CORNERS:
        expected = f"at most {MOST_CORNERS} combinations of rows"
        raise ProblemError(field, f"{comb(len(F), d)}", expected, "Give the vertices as an array (vertices, k).")
    scale = 1.0 / np.abs(F).max(axis=0)
    chosen = np.array(list(combinations(range(len(F)), d)))
    rows = F[chosen] * scale
    regular = np.abs(np.linalg.det(rows / np.linalg.norm(rows, axis=2, keepdims=True).clip(min=FLAT**2))) > FLAT
    corners, inverse = chosen[regular], np.linalg.inv(rows[regular]) * scale[:, None]
    found = (inverse @ g[corners][..., None])[..., 0]
    terms = np.abs(found) @ np.abs(F).T + np.abs(g)
    inside = (found @ F.T <= g + HIGHS_TOLERANCE * terms).all(axis=1)
    found, inverse, corners = found[inside], np.abs(inverse[inside]), corners[inside]
    residual = np.abs(g[corners] - (F[corners] @ found[..., None])[..., 0])
    rounding = (d + 3) * np.finfo(float).eps * np.take_along_axis(terms[inside], corners, axis=1)
    errors = (1 + SAME_FACET) * (inverse @ (residual + rounding)[..., None])[..., 0]
    return found, errors.max(axis=0)


def hull_weights(points: Array, rays: Array) -> Array:
    """Return weights >= 0 of points (k, n), then of rays (l, n), with the least |sum|^2 + (s - 1)^2, s on the points.

    They are a multiple of the weights with s = 1 whose sum is nearest to 0: those of another s have the value
    s^2 |sum|^2 + (s - 1)^2, which for the best s rises with |sum|.
    """
    rows = np.vstack([np.vstack([points, rays]).T, np.append(np.ones(len(points)), np.zeros(len(rays)))])
    right = np.append(np.zeros(len(rows) - 1), 1.0)
    weights, _, rank, _ = np.linalg.lstsq(rows, right)
    if rank == rows.shape[1] and (weights >= 0).all():  # as for a single point
        return np.asarray(weights, dtype=np.float64)
    from scipy.optimize import nnls  # slow to import

    return nnls(rows, right)[0]


def natural_sizes(matrix: Array, limits: Array, half_widths: Array, least: float) -> Array:
    """Return a unit for each component, (d,), from the rows matrix v <= limits and the half widths of its bounds.

    v counts from the middle of its bounds; half widths are inf without bounds, 0 where a component is fixed. The unit
    is how far the rows reach along a component, where that is less than its half width (but not less than the part
    ``least`` of it, which may be rounding) or there is none; else the half width, or 1.
    """
    coefficients = np.abs(matrix)
    bounded = np.isfinite(half_widths) & (half_widths > 0)
    sizes = np.where(bounded, half_widths, 0.0)
    for _ in sizes:  # the size of one component may determine that of another
        reach = _reach(coefficients, np.abs(limits), sizes)
        grown = np.where(bounded | (sizes > 0), sizes, reach)
        if (grown == sizes).all():
            break
        sizes = grown
    sizes = np.where(sizes > 0, sizes, 1.0)
    reach = _reach(coefficients, np.abs(limits), sizes)
    return np.where(bounded & (reach >= least * sizes), np.minimum(reach, sizes), sizes)


def _reach(coefficients: Array, limits: Array, sizes: Array) -> Array:
    """Return the |v_j| at which rows can hold with equality, the others up to their sizes; 0 where no row says one.

    Of rows about v_j alone it is the largest, as a limit next to zero may be rounding; else, of the rows that it shares
    with others, the smallest, as a coefficient next to zero may be rounding.
    """
    others = limits[:, None] + (coefficients * sizes) @ (1 - np.eye(len(sizes)))
    there = coefficients > 0
    reach = np.where(there, others, 0.0) / np.where(there, coefficients, 1.0)
    alone = there.sum(axis=1) == 1
    own = reach[alone].max(axis=0, initial=0.0)
    shared = np.where(reach[~alone] > 0, reach[~alone], np.inf).min(axis=0, initial=np.inf)
    return np.where(own > 0, own, np.where(np.isfinite(shared), shared, 0.0))


NEAREST_ROUNDS = 6  # of a Newton step and a sweep; two or three are usual
REGULAR = 1e-13  # of a diagonal entry, added to it: a Hessian may be singular


def box_minimiser(slope: Array, hessian: Array, low: Array, high: Array) -> Array:
    """Return v near the minimum of slope v + 1/2 v'H v over low <= v <= high, (..., k), H (..., k, k) semidefinite.

    A component whose diagonal entry is zero stays at the point of its bounds nearest to zero. Many boxes are solved
    side by side.

    Coordinate descent alone takes as many sweeps as the Hessian is ill-conditioned, and the weights of a Riccati
    equation are. Between sweeps there is therefore a Newton step of the components that no bound holds, cut at the
    bounds or at the first of them, whichever is lower: with the right bounds it ends the search.
    """
    shape = np.broadcast_shapes(slope.shape, low.shape, high.shape, hessian.shape[:-1])
    v = np.clip(np.zeros(shape), low, high)
    diagonal = np.diagonal(hessian, axis1=-2, axis2=-1)
    curved, sizes = diagonal > 0, np.where(diagonal > 0, diagonal, 1.0)
    for _ in range(NEAREST_ROUNDS):
        before = v.copy()
        v = _newton_step(slope, hessian, low, high, v)
        for j in range(shape[-1]):
            gradient = slope[..., j] + (hessian[..., j, :] * v).sum(axis=-1)
            step = np.where(curved[..., j], gradient / sizes[..., j], 0.0)
            v[..., j] = np.clip(v[..., j] - step, low[..., j], high[..., j])
        if (v == before).all():
            break
    return v


def _newton_step(slope: Array, hessian: Array, low: Array, high: Array, v: Array) -> Array:
    """Return the better of two points on the way to the minimum of the components that no bound holds, or v."""
    diagonal = np.diagonal(hessian, axis1=-2, axis2=-1)
    gradient = slope + (hessian * v[..., None, :]).sum(axis=-1)
    free = (diagonal > 0) & ~((v <= low) & (gradient >= 0)) & ~((v >= high) & (gradient <= 0))
    sizes = np.where(diagonal > 0, diagonal, 1.0)[..., None] * np.eye(v.shape[-1])
    system = np.where(free[..., None] & free[..., None, :], hessian + REGULAR * sizes, sizes)
    step = -np.linalg.solve(system, np.where(free, gradient, 0.0)[..., None])[..., 0]
    moving = step != 0
    margin = np.where(step > 0, high - v, v - low) / np.where(moving, np.abs(step), 1.0)
    length = np.minimum(np.where(moving, margin, np.inf).min(axis=-1, keepdims=True), 1.0)
    best, least = v, _quadratic_value(slope, hessian, v)
    for point in (np.clip(v + length * step, low, high), np.clip(v + step, low, high)):
        value = _quadratic_value(slope, hessian, point)
        best = np.where((value < least)[..., None], point, best)
        least = np.minimum(value, least)
    return best


def _quadratic_value(slope: Array, hessian: Array, v: Array) -> Array:
    return ((slope + 0.5 * (hessian * v[..., None, :]).sum(axis=-1)) * v).sum(axis=-1)
