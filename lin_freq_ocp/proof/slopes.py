"""The slopes s_t of the adjoint equation eta_{t-1} = A_t' eta_t - s_t of a proof, exactly but for spectra of states."""

from __future__ import annotations

import numpy as np
from flint import arb, arb_mat

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.proof.adjoint import Balls
from lin_freq_ocp.proof.multipliers import DualPoint
from lin_freq_ocp.proof.statement import joined


def exact_slopes(problem: OptimalControlProblem, point: DualPoint) -> list[Balls]:
    """Return s_0 .. s_T: the gradient of the cost at z_t, what is pulled back, and mu_t; in balls of any precision."""
    slopes = [[arb(value) for value in row] for row in point.mu.tolist()]
    if point.normal:
        _add_cost(slopes, problem, point)
    if point.state_signal.any():
        _add(slopes, point.state_signal)
    for term, weights in zip(problem.terms, point.weights, strict=True):
        if term.map.dense_size[0]:
            pulled, _ = term.map.pull_back(weights, (point.x.shape, point.u.shape))
            _add(slopes, pulled)
        elif weights.any():
            _add_rows(slopes, term, weights, problem)
    return slopes


def _add(slopes: list[Balls], signal: Array) -> None:
    for slope, row in zip(slopes, signal.tolist(), strict=True):
        for i, value in enumerate(row):
            slope[i] += value


def _add_rows(slopes: list[Balls], term: Term, weights: Array, problem: OptimalControlProblem) -> None:
    """Add what sparse rows pull back: the sums of multipliers times coefficients of states."""
    n, count = problem.state_dim, (problem.horizon + 1) * problem.state_dim
    matrix, _ = term.map.rows(problem.horizon, n, problem.control_dim)
    used = np.flatnonzero(weights)
    found = matrix[used].tocoo()
    of_x = found.col < count
    multipliers = weights.ravel()[used][found.row[of_x]].tolist()
    for place, value, weight in zip(found.col[of_x].tolist(), found.data[of_x].tolist(), multipliers, strict=True):
        slopes[place // n][place % n] += arb(value) * weight


def _add_cost(slopes: list[Balls], problem: OptimalControlProblem, point: DualPoint) -> None:
    """Add the gradient in x of the quadratic cost at z_t."""
    cost, n, T = problem.quadratic, problem.state_dim, problem.horizon
    hessians, linear = (
        cost.stage_hessians()[:, :n],
        np.broadcast_to(joined(cost.q, cost.r, T), (T, n + point.u.shape[1])),
    )
    if hessians.any() or linear[:, :n].any():
        points = np.hstack([point.x[:-1], point.u])
        centers = np.broadcast_to(joined(cost.x_ref, cost.u_ref, T), points.shape)
        once = arb_mat(hessians[0].tolist()) if len(hessians) == 1 else None
        for t, slope in enumerate(slopes[:-1]):
            hessian = arb_mat(hessians[t].tolist()) if once is None else once
            _add_gradient(slope, hessian, points[t], centers[t], linear[t])
    x_ref = cost.x_ref[-1] if cost.x_ref.ndim == 2 else cost.x_ref
    _add_gradient(slopes[-1], arb_mat(cost.P.tolist()), point.x[-1], x_ref, cost.p)


def _add_gradient(slope: Balls, hessian: arb_mat, point: Array, center: Array, linear: Array) -> None:
    """Add the first entries of hessian (point - center) + linear."""
    moved = arb_mat([[arb(a) - b] for a, b in zip(point.tolist(), center.tolist(), strict=True)])
    bent = (hessian * moved).entries()
    for i, value in enumerate(bent):
        slope[i] += value + float(linear[i])
