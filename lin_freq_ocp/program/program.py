"""Convex programs, quadratic or conic, with named rows and the residuals of their solutions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask

# The gap is relative to the sum |terms| of the objective, but not to less than these parts of it
TYPICAL_SHARE = 1e-3  # at a typical point
UNIT_SHARE = 1e-13  # where all variables are 1
CONIC_UNIT_SHARE = 1e-6  # the same with cones, where a point is as an interior-point method leaves it


class Block(Enum):
    """Names of row blocks."""

    DYNAMICS = "dynamics"
    STATE_SET = "state set"
    CONTROL_SET = "control set"
    TERMS = "terms"
    STATE_SPECTRUM = "state spectrum"
    CONTROL_SPECTRUM = "control spectrum"
    MODES = "modes"
    REGIONS = "mode regions"


@dataclass(frozen=True)
class Residuals:
    """Residuals of (z, y), each relative to the size of its own terms (at least 1).

    ``primal`` is the largest violation of lower <= A z <= upper; ``dual`` the largest entry of P z + q + A'y and of
    duals with the wrong sign; ``gap`` the first-order error of the objective: violations times duals, complementarity,
    and slopes times variables, relative to the sum of the objective's terms.
    """

    primal: float
    dual: float
    gap: float

    @property
    def worst(self) -> float:
        """Return the largest of the three."""
        return max(self.primal, self.dual, self.gap)


@dataclass(frozen=True, eq=False)
class StandardForm:
    """Minimise 1/2 z'P z + q'z subject to A z + s = b, s in cones, with the inverse map of duals.

    P is the upper triangle. Rows in this order: ``equations`` (s = 0), ``inequalities`` (s >= 0), second-order cones
    (s_0 >= |(s_1, ...)|) with so many rows each, from these rows of the program with these signs.
    """

    P: sp.csc_array
    q: Array
    A: sp.csc_array
    b: Array
    equations: int
    inequalities: int
    cones: tuple[int, ...]
    row: Indices
    sign: Array

    def dual(self, rows: int, y: Array) -> Array:
        """Return one dual per row of the program, upper minus lower, shape (rows,)."""
        duals = np.zeros(rows)
        np.add.at(duals, self.row, self.sign * y)
        return duals

    def dual_objective(self, z: Array, y: Array) -> float:
        """Return -1/2 z'P z - b'y: a lower bound if y is in the dual cone and P z + q + A'y = 0."""
        half = self.P @ z - 0.5 * self.P.diagonal() * z
        return float(-z @ half - self.b @ y)


@dataclass(frozen=True, eq=False)
class SingleBounds:
    """The rows of a program outside cones, with those on one variable as its bounds ``below`` and ``above``.

    ``violation`` is the violation of rows without variables, and of contradicting bounds.
    """

    below: Array
    above: Array
    A: sp.csr_array
    lower: Array
    upper: Array
    violation: float


@dataclass(frozen=True, eq=False)
class Program:
    """Minimise 1/2 z'P z + q'z + constant subject to lower <= A z <= upper, and A z - lower in a cone in cone rows.

    The dual y of a row is positive at its upper and negative at its lower bound: P z + q + A'y = 0. In cone rows,
    s = A z - lower has s_0 >= |(s_1, ...)|, and y lies in the polar cone: -y_0 >= |(y_1, ...)|; upper is infinite.

    Attributes
    ----------
    P : sparse (variables, variables), symmetric; q : (variables,); constant : float
    A : sparse (rows, variables); lower, upper : (rows,)
    rows : mapping from Block to slice
    cones : tuple of slice
        The rows of every second-order cone; any other row stands alone.
    binaries : indices of variables that are 0 or 1
    """

    P: sp.csc_array
    q: Array
    A: sp.csc_array
    lower: Array
    upper: Array
    constant: float = 0.0
    rows: Mapping[Block, slice] = field(default_factory=dict[Block, slice])
    cones: tuple[slice, ...] = ()
    binaries: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    @property
    def equality(self) -> Mask:
        """Which rows are equations."""
        return self.lower == self.upper

    @cached_property
    def in_cones(self) -> Indices:
        """The rows of all cones, one cone after the other."""
        return rows_of(self.cones)

    @cached_property
    def cone_of(self) -> Indices:
        """The number of the cone of each row of all cones."""
        return np.repeat(np.arange(len(self.cones)), np.array([c.stop - c.start for c in self.cones], dtype=np.intp))

    @cached_property
    def heads(self) -> Indices:
        """The places of the first rows of cones among the rows of all cones."""
        return np.flatnonzero(np.diff(self.cone_of, prepend=-1))

    def of_cones(self, of_rows: Array) -> tuple[Array, Array, Array]:
        """Return the entries s of a vector (rows,) in all cones, and s_0 and |(s_1, ...)| of each cone."""
        s = of_rows[self.in_cones]
        tails = s.copy()
        tails[self.heads] = 0.0
        return s, s[self.heads], np.sqrt(np.add.reduceat(tails**2, self.heads))

    def outside_cones(self, of_rows: Array) -> float:
        """Return by how much |(s_1, ...)| exceeds s_0 at most."""
        _, heads, tails = self.of_cones(of_rows)
        return float((tails - heads).max(initial=0.0))

    def outside(self, z: Array, chosen: Mask | None = None) -> float:
        """Return the largest violation by z of cones, and of rows outside them: the chosen ones, or all."""
        values = self.A @ z
        violation = np.maximum(values - self.upper, self.lower - values)[self.alone if chosen is None else chosen]
        return max(float(violation.max(initial=0.0)), self.outside_cones(values - self.lower))

    @cached_property
    def alone(self) -> Mask:
        """Which rows are in no cone."""
        alone = np.ones(len(self.lower), dtype=bool)
        alone[self.in_cones] = False
        return alone

    def without_bounds_beyond(self, size: float) -> Program | None:
        """Return the program without bounds farther than ``size`` from zero; None if there are none."""
        above = self.alone & np.isfinite(self.upper) & (self.upper > size) & ~self.equality
        below = self.alone & np.isfinite(self.lower) & (self.lower < -size) & ~self.equality
        if not (above.any() or below.any()):
            return None
        return replace(self, lower=np.where(below, -np.inf, self.lower), upper=np.where(above, np.inf, self.upper))

    def relax_limits(self, by: Array) -> Program:
        """Return the program with limits that are farther apart by this on each side, (rows,)."""
        return replace(self, lower=self.lower - by, upper=self.upper + by)

    def standard(self) -> StandardForm:
        """Return the program in the form of interior-point methods."""
        equal = self.equality
        above = ~equal & np.isfinite(self.upper)
        below = ~equal & np.isfinite(self.lower) & self.alone
        parts = *(np.flatnonzero(rows) for rows in (equal, above, below)), self.in_cones
        row, sign = np.concatenate(parts), np.repeat([1.0, 1.0, -1.0, -1.0], [len(part) for part in parts])
        A = self.A[row]
        A.sort_indices()
        A.data *= sign[A.indices]
        # the upper triangle of P; scipy's function takes several times as long
        column = np.repeat(np.arange(len(self.q)), np.diff(self.P.indptr))
        inside = self.P.indices <= column
        pointers = np.append(0, np.cumsum(np.bincount(column[inside], minlength=len(self.q))))
        triangle = sp.csc_array((self.P.data[inside], self.P.indices[inside], pointers), shape=self.P.shape)
        triangle.sort_indices()
        return StandardForm(
            P=triangle,
            q=self.q,
            A=A,
            b=np.where(sign > 0, self.upper[row], -self.lower[row]),
            equations=len(parts[0]),
            inequalities=len(parts[1]) + len(parts[2]),
            cones=tuple(cone.stop - cone.start for cone in self.cones),
            row=row,
            sign=sign,
        )

    def single_bounds(self) -> SingleBounds:
        """Return the rows outside cones, those on one variable as its bounds."""
        A = sp.csr_array(self.A)
        count = np.diff(A.indptr)
        single = self.alone & (count == 1)
        below, above = np.full(len(self.q), -np.inf), np.full(len(self.q), np.inf)
        first = A.indptr[:-1][single]
        column, value = A.indices[first], A.data[first]
        limits = np.sort([self.lower[single] / value, self.upper[single] / value], axis=0)
        np.maximum.at(below, column, limits[0])
        np.minimum.at(above, column, limits[1])
        empty, rest = self.alone & (count == 0), self.alone & (count > 1)
        violation = np.concatenate([below - above, self.lower[empty], -self.upper[empty]]).max(initial=0.0)
        above = np.maximum(below, above)
        return SingleBounds(below, above, sp.csr_array(A[rest]), self.lower[rest], self.upper[rest], float(violation))

    def scaled(self, scaling: Scaling) -> Program:
        """Return the program in other units."""
        return replace(
            self,
            P=sp.csc_array(scaling.cost * scale_matrix(self.P, scaling.columns, scaling.columns)),
            q=scaling.cost * scaling.columns * self.q,
            constant=scaling.cost * self.constant,
            A=scale_matrix(self.A, scaling.rows, scaling.columns),
            lower=scaling.rows * self.lower,
            upper=scaling.rows * self.upper,
        )

    def objective(self, z: Array) -> float:
        """Return 1/2 z'P z + q'z + constant."""
        return float(0.5 * z @ (self.P @ z) + self.q @ z + self.constant)

    def residuals(self, z: Array, y: Array, sizes: Array | float = 1.0) -> Residuals:
        """Return the residuals of a point and duals; ``sizes`` (variables,) are those of a typical point."""
        if not (np.isfinite(z).all() and np.isfinite(y).all()):
            return Residuals(np.inf, np.inf, np.inf)
        Pz, Az, Aty = self.P @ z, self.A @ z, self.A.T @ y
        bound, carried = self._bound_of(y)
        impossible, outside_polar = ~carried & (y != 0), self.outside_cones(-y)
        slope, apart = Pz + self.q + Aty, bound - Az
        with np.errstate(over="ignore", invalid="ignore"):  # divergence gives large residuals
            wrong = float(np.abs(y[self.alone]) @ np.abs(apart[self.alone]) + np.abs(slope) @ np.abs(z))
            wrong += float(np.abs(np.add.reduceat((y * apart)[self.in_cones], self.heads)).sum())
            rounding, ones = CONIC_UNIT_SHARE if self.cones else UNIT_SHARE, np.ones(len(z))
            least = TYPICAL_SHARE * self._magnitude(sizes * ones), rounding * self._magnitude(ones)
            total = max(self._magnitude(np.abs(z)), *least)
        size = np.abs(Pz).max(initial=0), np.abs(Aty).max(initial=0), np.abs(self.q).max(initial=0)
        return Residuals(
            primal=self.outside(z) / max(1.0, float(np.abs(Az).max(initial=0))),
            dual=float(
                max(np.abs(slope).max(initial=0), np.abs(y[impossible]).max(initial=0), outside_polar) / max(1.0, *size)
            ),
            gap=wrong / total if total > 0 else wrong,
        )

    def _bound_of(self, y: Array) -> tuple[Array, Mask]:
        """Return the bound that each dual belongs to, 0 if it is infinite, and whether it is finite."""
        bound = np.where((y > 0) & self.alone, self.upper, self.lower)
        finite = np.isfinite(bound)
        return np.where(finite, bound, 0.0), finite

    def _magnitude(self, z: Array) -> float:
        """Return the sum of the absolute terms of the objective, for z >= 0."""
        return float(0.5 * z @ (abs(self.P) @ z) + np.abs(self.q) @ z)

    def infeasibility_residual(self, y: Array) -> float:
        """Return the residual of y as a Farkas proof: A'y = 0, scaled to a support of -1; inf if that is >= 0.

        Duals of missing bounds, or outside the polar of a cone, count likewise.
        """
        bound, carried = self._bound_of(y)
        support = float((y * bound).sum())
        if support >= 0:
            return np.inf
        lost = np.abs(y[~carried]).max(initial=0.0)
        return float(max(np.abs(self.A.T @ y).max(initial=0.0), lost, self.outside_cones(-y))) / -support


@dataclass(frozen=True, eq=False)
class Scaling:
    """Change of units z = columns * z', row i times rows[i], cost times ``cost``; and its exact inverse.

    The rows of one cone have the same factor.
    """

    columns: Array
    rows: Array
    cost: float

    def primal(self, z: Array) -> Array:
        """Return z in the program's own units."""
        return self.columns * z

    def dual(self, y: Array) -> Array:
        """Return y in the program's own units."""
        return self.rows * y / self.cost

    def scaled_primal(self, z: Array) -> Array:
        """Return z, in the program's own units, in the new ones."""
        return z / self.columns

    def scaled_dual(self, y: Array) -> Array:
        """Return y, in the program's own units, in the new ones."""
        return y * self.cost / self.rows


def rows_of(slices: Sequence[slice]) -> Indices:
    """Return the indices in slices, one after the other."""
    return np.concatenate([np.arange(0), *(np.arange(part.start, part.stop) for part in slices)])


def scale_matrix(matrix: sp.csc_array, rows: Array, columns: Array) -> sp.csc_array:
    """Return diag(rows) matrix diag(columns) by columns; products of sparse matrices take several times as long."""
    scaled = sp.csc_array(matrix, copy=True)
    scaled.data *= rows[scaled.indices]
    scaled.data *= np.repeat(columns, np.diff(scaled.indptr))
    return scaled


def regularised_kkt(P: sp.csc_array, A: sp.csc_array, of_variables: float, of_rows: float) -> sp.csc_array:
    """Return [[P, A'], [A, 0]] with a number added to the diagonal of P, and another taken from that of 0."""
    variables, count = P.shape[0], A.shape[0]
    every, rows = np.arange(variables + count), A.indices + variables
    of_P, of_A = (np.repeat(every[:variables], np.diff(matrix.indptr)) for matrix in (P, A))
    diagonal = np.append(np.full(variables, of_variables), np.full(count, -of_rows))
    values = np.concatenate([P.data, A.data, A.data, diagonal])
    i, j = np.concatenate([P.indices, rows, of_A, every]), np.concatenate([of_P, of_A, rows, every])
    return sp.csc_array((values, (i, j)), shape=(variables + count, variables + count))
