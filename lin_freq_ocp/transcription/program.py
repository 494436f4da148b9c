"""A convex quadratic program with named rows: what every solver gets, and what its answer is measured against."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.problem.arrays import Array, Indices, Mask


class Block(Enum):
    """Names of row blocks."""

    DYNAMICS = "dynamics"
    STATE_SET = "state set"
    CONTROL_SET = "control set"
    STAGE_ROWS = "stage rows"
    STATE_SPECTRUM = "state spectrum"
    CONTROL_SPECTRUM = "control spectrum"


@dataclass(frozen=True)
class Residuals:
    """How far (z, y) is from solving its program; each relative to the size of its own terms (at least 1).

    Attributes
    ----------
    primal : float
        Largest violation of lower <= A z <= upper.
    dual : float
        Largest entry of P z + q + A'y, and of duals with a sign that their row cannot have.
    gap : float
        Difference between primal and dual objective.
    """

    primal: float
    dual: float
    gap: float

    @property
    def worst(self) -> float:
        """Return the largest of the three."""
        return max(self.primal, self.dual, self.gap)


@dataclass(frozen=True, eq=False)
class OneSided:
    """The rows of a program as equations A z = b and inequalities G z <= h, with the way back for their duals.

    Attributes
    ----------
    A : sparse (equations, variables); b : (equations,)
    G : sparse (inequalities, variables); h : (inequalities,)
        First the upper bounds, then the lower ones with their sign changed.
    equations, above, below : indices of the program's rows
    """

    A: sp.csc_array
    b: Array
    G: sp.csc_array
    h: Array
    equations: Indices
    above: Indices
    below: Indices

    def dual(self, rows: int, of_equations: Array, of_inequalities: Array) -> Array:
        """Return one dual per row of the program, upper minus lower, shape (rows,)."""
        y = np.zeros(rows)
        y[self.equations] = of_equations
        y[self.above] += of_inequalities[: len(self.above)]
        y[self.below] -= of_inequalities[len(self.above) :]
        return y


@dataclass(frozen=True, eq=False)
class Program:
    """Minimise 1/2 z'P z + q'z + constant subject to lower <= A z <= upper.

    The dual y of a row is positive at its upper and negative at its lower bound: P z + q + A'y = 0.

    Attributes
    ----------
    P : sparse (variables, variables), symmetric; q : (variables,); constant : float
    A : sparse (rows, variables); lower, upper : (rows,)
    rows : mapping from Block to slice
    """

    P: sp.csc_array
    q: Array
    constant: float
    A: sp.csc_array
    lower: Array
    upper: Array
    rows: Mapping[Block, slice]

    @property
    def equality(self) -> Mask:
        """Which rows are equations."""
        return self.lower == self.upper

    def one_sided(self) -> OneSided:
        """Return the rows as most solvers want them."""
        equal = self.equality
        equations = np.flatnonzero(equal)
        above = np.flatnonzero(~equal & np.isfinite(self.upper))
        below = np.flatnonzero(~equal & np.isfinite(self.lower))
        return OneSided(
            A=sp.csc_array(self.A[equations]),
            b=self.upper[equations],
            G=sp.csc_array(sp.vstack([self.A[above], -self.A[below]])),
            h=np.concatenate([self.upper[above], -self.lower[below]]),
            equations=equations,
            above=above,
            below=below,
        )

    def objective(self, z: Array) -> float:
        """Return 1/2 z'P z + q'z + constant."""
        return float(0.5 * z @ (self.P @ z) + self.q @ z + self.constant)

    def residuals(self, z: Array, y: Array) -> Residuals:
        """Measure an answer from the data alone; no solver's word is taken."""
        if not (np.isfinite(z).all() and np.isfinite(y).all()):
            return Residuals(np.inf, np.inf, np.inf)
        Pz, Az, Aty = self.P @ z, self.A @ z, self.A.T @ y
        violation = np.maximum(np.maximum(self.lower - Az, Az - self.upper), 0.0)
        bound = np.where(y > 0, self.upper, self.lower)
        impossible = ~np.isfinite(bound) & (y != 0)
        support = float((y * np.where(np.isfinite(bound), bound, 0.0)).sum())
        curvature, linear = float(z @ Pz), float(self.q @ z)
        size = np.abs(Pz).max(initial=0), np.abs(Aty).max(initial=0), np.abs(self.q).max(initial=0)
        return Residuals(
            primal=float(violation.max(initial=0) / max(1.0, np.abs(Az).max(initial=0))),
            dual=float(
                max(np.abs(Pz + self.q + Aty).max(initial=0), np.abs(y[impossible]).max(initial=0)) / max(1.0, *size)
            ),
            gap=abs(curvature + linear + support) / max(1.0, curvature, abs(linear), abs(support)),
        )

    def descent_ray_residual(self, z: Array) -> float:
        """Return how far z is from unbounded descent: P z = 0, A z recedes, scaled to q'z = -1; inf if q'z >= 0."""
        slope = float(self.q @ z)
        if slope >= 0:
            return np.inf
        z = z / -slope
        Az = self.A @ z
        leaving = np.maximum(np.where(np.isfinite(self.upper), Az, 0.0), np.where(np.isfinite(self.lower), -Az, 0.0))
        return float(max(np.abs(self.P @ z).max(initial=0), leaving.max(initial=0.0)))


@dataclass(frozen=True, eq=False)
class Scaling:
    """Change of units z = columns * z', row i times rows[i], cost times ``cost``; and its exact inverse."""

    columns: Array
    rows: Array
    cost: float

    def apply(self, program: Program) -> Program:
        """Return the program in the new units."""
        D, E = sp.diags_array(self.columns), sp.diags_array(self.rows)
        return Program(
            P=sp.csc_array(self.cost * (D @ program.P @ D)),
            q=self.cost * self.columns * program.q,
            constant=self.cost * program.constant,
            A=sp.csc_array(E @ program.A @ D),
            lower=self.rows * program.lower,
            upper=self.rows * program.upper,
            rows=program.rows,
        )

    def primal(self, z: Array) -> Array:
        """Return z in the program's own units."""
        return self.columns * z

    def dual(self, y: Array) -> Array:
        """Return y in the program's own units."""
        return self.rows * y / self.cost
