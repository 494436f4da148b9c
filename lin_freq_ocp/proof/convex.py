"""Quadratic costs whose Hessians are semidefinite exactly, and not only up to rounding, as a checker wants them.

A matrix such as C'C has been rounded: its least eigenvalue may be -1e-17 and not 0, and no cost is bounded below over
free states then. A Hessian that the package takes for semidefinite is stated with its diagonal larger by the least
multiple of a rounding with which a rational L D L' shows that it is: the problem of the proof is that one.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.problem.costs.quadratic import CONVEXITY_TOLERANCE, CostSum
from lin_freq_ocp.problem.ocp import OptimalControlProblem

LEAST_RISE = 2.0**-46  # that is tried: with less, a slope along the least eigenvector would cost much
STEP = 4.0  # between rises of the diagonal that are tried


def convex_problem(problem: OptimalControlProblem) -> OptimalControlProblem:
    """Return the problem with Hessians that are symmetric and semidefinite exactly; itself if they are so."""
    cost, n = problem.quadratic, problem.state_dim
    given = cost.stage_hessians()
    hessians, P = np.stack([_semidefinite(one) for one in given]), _semidefinite(cost.P)
    if np.array_equal(hessians, given) and np.array_equal(P, cost.P):
        return problem
    stage = hessians[0] if len(hessians) == 1 else hessians
    parts = {"Q": stage[..., :n, :n], "R": stage[..., n:, n:], "S": stage[..., :n, n:]}
    return replace(problem, cost=CostSum([replace(cost, **parts, P=P), *problem.cost.norms]))


def _semidefinite(matrix: Array) -> Array:
    """Return a symmetric matrix with the least rise of the diagonal that makes it semidefinite; itself if none does."""
    symmetric, diagonal = (matrix + matrix.T) / 2, np.diag(np.diagonal(matrix))
    if np.array_equal(matrix, diagonal):
        return matrix
    rise = 0.0
    while rise <= CONVEXITY_TOLERANCE:
        raised = symmetric + rise * diagonal
        if is_semidefinite(raised):
            return raised
        rise = max(STEP * rise, LEAST_RISE)
    return matrix


def is_semidefinite(matrix: Array) -> bool:
    """Whether a symmetric matrix is positive semidefinite, by a rational L D L'."""
    rows = [[Fraction(x) for x in row] for row in matrix.tolist()]
    while rows:
        (pivot, *rest), rows = rows[0], rows[1:]
        if pivot < 0 or (pivot == 0 and any(rest)):
            return False
        rows = [[x - row[0] * y / (pivot or 1) for x, y in zip(row[1:], rest, strict=True)] for row in rows]
    return True
