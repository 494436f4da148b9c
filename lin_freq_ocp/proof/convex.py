"""Quadratic costs whose Hessians are semidefinite exactly, and not only up to rounding, as a checker wants them.

A matrix such as C'C has been rounded: its least eigenvalue may be -1e-17 and not 0, and no cost is bounded below over
free states then. A Hessian that the package takes for semidefinite is stated with its diagonal larger by the least
multiple of a rounding with which it is so exactly: the problem of the proof is that one. Its cost J+ is nowhere below
the given J, and in a box above it by no more than ``raised_by``. So an upper bound of J+ is one of J, and a lower one
of J+ less this is one of J.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.certificate.reach import Region
from lin_freq_ocp.certificate.tolerances import RADIUS_MARGIN
from lin_freq_ocp.problem.costs.quadratic import CONVEXITY_TOLERANCE, CostSum, is_semidefinite
from lin_freq_ocp.problem.ocp import OptimalControlProblem

LEAST_RISE = 2.0**-52  # of a diagonal that is tried
LARGER_RISE = 2.0**-46  # with less, a slope along the least eigenvector may cost much; with more, states far away do
RISE_STEP = 4.0  # between rises of the diagonal that are tried


def convex_problem(problem: OptimalControlProblem, least: float = 0.0) -> OptimalControlProblem:
    """Return the problem with Hessians that are symmetric and semidefinite exactly; itself if they are so.

    The diagonals of Hessians that are not diagonal are larger by this part of them, at least.
    """
    cost, n = problem.quadratic, problem.state_dim
    given = cost.stage_hessians()
    hessians, P = np.stack([_semidefinite(one, least) for one in given]), _semidefinite(cost.P, least)
    if np.array_equal(hessians, given) and np.array_equal(P, cost.P):
        return problem
    stage = hessians[0] if len(hessians) == 1 else hessians
    parts = {"Q": stage[..., :n, :n], "R": stage[..., n:, n:], "S": stage[..., :n, n:]}
    return replace(problem, cost=CostSum([replace(cost, **parts, P=P), *problem.cost.norms]))


def raised_by(given: OptimalControlProblem, raised: OptimalControlProblem, region: Region) -> float:
    """Return a bound on what the cost of a raised problem is above the given one in a region; inf without one."""
    if raised is given:
        return 0.0
    cost, other, total = given.quadratic, raised.quadratic, 0.0
    x, u = (
        np.maximum(np.abs(lower - ref), np.abs(upper - ref))
        for (lower, upper), ref in ((region.x, cost.x_ref), (region.u, cost.u_ref))
    )
    stages = cost.stage_hessians(), other.stage_hessians(), np.hstack([x[:-1], u])
    for old, new, v in (stages, (cost.P[None], other.P[None], x[-1:])):
        change = np.maximum(np.abs(new - old), np.abs(new - np.swapaxes(old, 1, 2)))
        with np.errstate(invalid="ignore"):  # 0 times inf: what is not raised may be anywhere
            total += float(np.where(change > 0, change * v[:, :, None] * v[:, None, :], 0.0).sum())
    return RADIUS_MARGIN * total / 2


def _semidefinite(matrix: Array, least: float) -> Array:
    """Return a symmetric matrix with the least rise of the diagonal that makes it semidefinite; itself if none does.

    The rise itself is semidefinite, too, with what the rounding of entries adds.
    """
    symmetric, diagonal = (matrix + matrix.T) / 2, np.diag(np.diagonal(matrix))
    if np.array_equal(matrix, diagonal):
        return matrix
    rise = least
    while rise <= CONVEXITY_TOLERANCE:
        raised = symmetric + rise * diagonal
        if is_semidefinite(raised) and is_semidefinite(raised - matrix):
            return raised
        rise = max(RISE_STEP * rise, LEAST_RISE)
    return matrix
