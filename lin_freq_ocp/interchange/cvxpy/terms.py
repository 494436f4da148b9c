"""The terms h(L(x, u)) of a problem in CVXPY: labelled constraints where they are hard, else part of the objective."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.maps import SpectrumMap, StageMap, SumMap, TrajectoryMap
from lin_freq_ocp.problem.terms.penalties import Below, Cone, Norm
from lin_freq_ocp.problem.terms.term import Term


def constraints_of(problem: OptimalControlProblem, x: Any, u: Any) -> list[Any]:
    """Return the hard terms, each under its name.

    Only finite limits appear, group after group; how the duals become the term's multipliers lambda:

        v <= limit                lambda = dual
        v = 0                     lambda = dual; the imaginary parts of bins 0 and N/2 are left out
        |v| <= radius, SOC        lambda = -dual_value[1], (groups, dim), and |lambda| = dual_value[0]
        v_0 >= |(v_1, ...)|, SOC  lambda_0 = -dual_value[0], (groups,); (lambda_1, ...) = -dual_value[1]

    Groups of radius 0 beside others stand apart, as equations labelled with the term's name and " zero".
    """
    return [one for term in problem.terms if term.hard for one in _constraints(term, _values(term.map, x, u))]


def costs_of(problem: OptimalControlProblem, x: Any, u: Any) -> list[Any]:
    """Return the soft terms and nonsmooth costs, one expression each."""
    return [cost for term in problem.terms if not term.hard for cost in _costs(term, _values(term.map, x, u))]


def stage_products(matrix: Array, vectors: Any) -> Any:
    """Return M v_t, or M_t v_t where the matrix has one per time, for vectors (times, columns)."""
    import cvxpy as cp

    if matrix.ndim == 2:
        return vectors @ matrix.T
    products = sp.block_diag(matrix, format="csr") @ cp.vec(vectors, order="C")
    return cp.reshape(products, matrix.shape[:2], order="C")


def _constraints(term: Term, v: Any) -> list[Any]:
    import cvxpy as cp

    penalty = term.penalty
    if isinstance(penalty, Cone):
        return [cp.SOC(v[:, 0], v[:, 1:], axis=1).set_label(term.name)]
    if isinstance(penalty, Below):
        limit = np.broadcast_to(penalty.limit, term.shape)
        finite = np.isfinite(limit)
        return [(v[finite] <= limit[finite]).set_label(term.name)] if finite.any() else []
    radius = np.broadcast_to(penalty.radius, term.shape[:1])
    zero, limited = np.flatnonzero(radius == 0), np.flatnonzero(np.isfinite(radius) & (radius > 0))
    found: list[Any] = []
    if len(limited):
        limit = radius[limited]
        euclidean = penalty.order == 2
        inside = cp.SOC(limit, v[limited], axis=1) if euclidean else _norms(penalty, v[limited]) <= limit
        found.append(inside.set_label(term.name))
    kept = _depends(term)[zero]
    if kept.any():
        found.append((v[zero][kept] == 0).set_label(f"{term.name} zero" if found else term.name))
    return found


def _costs(term: Term, v: Any) -> list[Any]:
    import cvxpy as cp

    penalty = term.penalty
    assert not isinstance(penalty, Cone)  # which is always hard
    if isinstance(penalty, Below):
        limit, weight = (np.broadcast_to(part, term.shape) for part in (penalty.limit, penalty.weight))
        finite = np.isfinite(limit)
        return [weight[finite] @ cp.pos(v[finite] - limit[finite])] if finite.any() else []
    radius, weight = (np.broadcast_to(part, term.shape[:1]) for part in (penalty.radius, penalty.weight))
    limited = np.flatnonzero(np.isfinite(radius))
    if not len(limited):
        return []
    norms = _norms(penalty, v[limited])
    return [weight[limited] @ (cp.pos(norms - radius[limited]) if radius[limited].any() else norms)]


def _norms(penalty: Norm, v: Any) -> Any:
    """Return the norm of every group."""
    import cvxpy as cp

    return cp.norm(v, "inf" if penalty.order == np.inf else int(penalty.order), axis=1)


def _values(one: TrajectoryMap, x: Any, u: Any) -> Any:
    """Return v = L(x, u), (groups, dim)."""
    if isinstance(one, StageMap):
        parts = [stage_products(matrix, signal[one.times]) for matrix, signal in _given((one.C, x), (one.D, u))]
        return sum(parts, np.broadcast_to(one.constant, one.shape))
    if isinstance(one, SumMap):
        return _sums(one, x, u)
    return _spectrum(one, x, u)


def _sums(one: SumMap, x: Any, u: Any) -> Any:
    import cvxpy as cp

    parts = [
        np.swapaxes(matrices, 0, 1).reshape(len(one.constant), -1) @ cp.vec(signal, order="C")
        for matrices, signal in _given((one.Phi, x), (one.Psi, u))
    ]
    return cp.reshape(sum(parts, one.constant), one.shape, order="C")


def _spectrum(one: SpectrumMap, x: Any, u: Any) -> Any:
    import cvxpy as cp

    samples = len(one.window)
    waves = np.exp(-2j * np.pi * (np.outer(one.bins, np.arange(samples)) % one.points) / one.points) * one.window
    pairs = np.stack([waves.real, waves.imag], axis=1)
    pairs[one.single, 1] = 0.0  # and not the rounding error of sin(pi t)
    kept = np.ones(pairs.shape[:2], dtype=bool)
    if one.together:
        kept[one.single, 1] = False
    y = sum(signal[:samples] @ row for row, signal in _given((one.C, x), (one.D, u)))
    return cp.reshape(pairs[kept] @ y, one.shape, order="C")


def _depends(term: Term) -> Mask:
    """Where a value depends on the trajectory, (groups, dim): not the imaginary part of a real bin."""
    depends = np.ones(term.shape, dtype=bool)
    if isinstance(term.map, SpectrumMap) and not term.map.together:
        depends[term.map.single, 1] = False
    return depends


def _given(*pairs: tuple[Array | None, Any]) -> list[tuple[Array, Any]]:
    """Return the pairs of a matrix and a signal where there is a matrix."""
    return [(matrix, signal) for matrix, signal in pairs if matrix is not None]
