"""K = [[H, M'], [M, 0]] of the active rows at a point, factored once, and its solves.

K is not regularised: a number on its diagonal damps a derivative where rows are nearly parallel, without a sign of it.
The factor of the regularised K, which a solver has, serves for refinement with residuals in extended precision, if
that converges; else K is factored itself. If this fails, too, K is singular, and a vector of its null space says why.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu

from lin_freq_ocp.base.arrays import Array, to_long_double
from lin_freq_ocp.program.active_rows import EPSILON, ActiveRows, linearised_rows
from lin_freq_ocp.program.program import Program, regularised_kkt

KKT_REFINEMENTS = 8  # of a solve, each of which must halve the correction
MOST_SOLVE_ERROR = 1e-6  # relative error of a solve above which no derivative is stated
PROXIMAL = 1e-9  # on the diagonal of a singular K, for solutions where the data are consistent


@dataclass(frozen=True, eq=False)
class ActiveKKT:
    """K at a point z with the duals y of all rows, in the units of its program."""

    program: Program
    active: ActiveRows
    z: Array
    y: Array
    near: SuperLU | None = None  # the factor of a K nearby

    @cached_property
    def _rows(self) -> tuple[sp.csr_array, sp.csc_array, sp.csr_array, sp.csr_array]:
        return linearised_rows(self.program, self.z, self.y, self.active)

    @property
    def choice(self) -> sp.csr_array:
        """Return N: the rows of M are N A, and q has the duals N'q."""
        return self._rows[2]

    @property
    def hessian(self) -> sp.csc_array:
        """Return H."""
        return self._rows[1]

    @property
    def curvature(self) -> sp.csr_array:
        """Return W: with a change dz, the duals of cones change by W A dz besides N'q."""
        return self._rows[3]

    @cached_property
    def _matrix(self) -> sp.csr_array:
        M, H = self._rows[:2]
        return sp.csr_array(regularised_kkt(H, sp.csc_array(M), 0.0, 0.0))

    @cached_property
    def _factor(self) -> tuple[SuperLU, bool]:
        """A factor of K, or of one nearby, and whether K is singular, by solves with a random right-hand side."""
        M, H = self._rows[:2]
        right = np.random.default_rng(0).standard_normal(self._matrix.shape[0])
        if self.near is not None and self._is_regular(self.near, right, np.sqrt(EPSILON)):
            return self.near, False
        try:
            factor = splu(sp.csc_array(self._matrix))
            if self._is_regular(factor, right, MOST_SOLVE_ERROR):
                return factor, False
        except RuntimeError:  # a pivot is zero
            pass
        return splu(regularised_kkt(H, sp.csc_array(M), PROXIMAL, PROXIMAL)), True

    def _is_regular(self, factor: SuperLU, right: Array, most_error: float) -> bool:
        """Whether a solve converges and gives rows their values: those that depend on each other have no solution."""
        solution, error = self._solve_refined(factor, right)
        missed = (self._matrix @ solution - right)[len(self.z) :]
        return error < most_error and float(np.abs(missed).max(initial=0.0)) <= MOST_SOLVE_ERROR * np.abs(right).max()

    @property
    def singular(self) -> bool:
        """Return whether K is singular, as far as numbers say."""
        return self._factor[1]

    @cached_property
    def weakest(self) -> tuple[Array, Array]:
        """The parts in z and in the duals of all rows of a vector that K takes to nearly nothing: inverse iteration."""
        vector = np.random.default_rng(0).standard_normal(self._matrix.shape[0])
        for _ in range(3):
            vector = self._factor[0].solve(vector / np.linalg.norm(vector))
        of_z, of_rows = np.split(vector / np.linalg.norm(vector), [len(self.z)])
        return of_z, self.choice.T @ of_rows

    def solve(self, of_z: Array, of_rows: Array) -> tuple[Array, Array, float]:
        """Return (p, q) with H p + M'q = of_z and A p = of_rows in active rows, and the relative error.

        ``of_rows`` and q are of all rows of the program; q is that of its duals, the curvature of cones included.
        """
        solution, error = self._solve_refined(self._factor[0], np.concatenate([of_z, self.choice @ of_rows]))
        p, q = np.split(solution, [len(of_z)])
        return p, self.choice.T @ q + self.curvature @ (self.program.A @ p), error

    def newton_step(self) -> tuple[Array, Array]:
        """Return the changes of z and y that satisfy the conditions of the active rows, cones to first order."""
        program, values = self.program, self.program.A @ self.z
        limits = np.where(self.active.above, program.upper, program.lower)
        limits = np.where(np.isfinite(limits), limits, 0.0)
        slope = program.P @ to_long_double(self.z) + program.q + program.A.T @ to_long_double(self.y)
        p, q, _ = self.solve(-slope.astype(np.float64), limits - values)
        return p, q

    def _solve_refined(self, factor: SuperLU, right: Array) -> tuple[Array, float]:
        """Return the solution for a right-hand side, and its relative error, by the last correction."""
        K, x, before, error = self._matrix, to_long_double(np.zeros(len(right))), np.inf, 1.0
        values, occupied = to_long_double(K.data), np.flatnonzero(np.diff(K.indptr))
        for _ in range(KKT_REFINEMENTS):
            products = np.zeros(len(right), dtype=np.longdouble)
            products[occupied] = np.add.reduceat(values * x[K.indices], K.indptr[:-1][occupied])
            step = factor.solve((right - products).astype(np.float64))
            if not np.isfinite(step).all():
                return np.zeros(len(right)), 1.0
            x = x + step
            last, size = float(np.abs(step).max(initial=0.0)), float(np.abs(x).max(initial=0.0))
            error = last / size if size > 0 else 0.0
            if error <= EPSILON or last > 0.5 * before:
                break
            before = last
        return x.astype(np.float64), min(error, 1.0)
