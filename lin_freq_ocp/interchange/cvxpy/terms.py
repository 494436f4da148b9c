"""The terms h(L(x, u)) of a problem in CVXPY: labelled constraints where they are hard, else part of the objective."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.transcription.linear.conic_terms import TermRows, conic_terms


def terms_of(problem: OptimalControlProblem, x: Any, u: Any) -> tuple[list[Any], list[Any]]:
    """Return the costs and the constraints of all terms, from the same rows as other solvers get.

    The constraints of a hard term stand under its name. Only finite limits appear, group after group; how the duals
    become the term's multipliers lambda:

        v <= limit                lambda = dual
        v = 0                     lambda = dual; the imaginary parts of bins 0 and N/2 are left out
        |v| <= radius, SOC        lambda = -dual_value[1], (groups, dim), and |lambda| = dual_value[0]
        v_0 >= |(v_1, ...)|, SOC  lambda_0 = -dual_value[0], (groups,); (lambda_1, ...) = -dual_value[1]

    Groups of radius 0 beside others stand apart, as equations labelled with the term's name and " zero". A soft term
    or nonsmooth cost has a variable, its slacks: the objective has their prices, and what bounds them from below is
    labelled with the term's name and " slack".
    """
    import cvxpy as cp

    signals = cp.hstack([cp.vec(x, order="C"), cp.vec(u, order="C")])
    costs, constraints = list[Any](), list[Any]()
    for rows in conic_terms(problem).parts:
        values, name = rows.signals @ signals, rows.term.name
        if len(rows.prices):
            slacks, name = cp.Variable(len(rows.prices), name=f"slacks of {name}"), f"{name} slack"
            values, costs = values + rows.slacks @ slacks, [*costs, rows.prices @ slacks]
        for k, (kind, constraint) in enumerate(_constraints(rows, values)):
            constraints.append(constraint.set_label(name if k == 0 else f"{name} {kind}"))
    return costs, constraints


def stage_products(matrix: Array, vectors: Any) -> Any:
    """Return M v_t, or M_t v_t where the matrix has one per time, for vectors (times, columns)."""
    import cvxpy as cp

    if matrix.ndim == 2:
        return vectors @ matrix.T
    products = sp.block_diag(matrix, format="csr") @ cp.vec(vectors, order="C")
    return cp.reshape(products, matrix.shape[:2], order="C")


def _constraints(rows: TermRows, values: Any) -> list[tuple[str, Any]]:
    """Return cones, intervals, equations and inequalities, of those that there are, each with a word for its kind."""
    import cvxpy as cp

    lower, upper, found = rows.lower, rows.upper, list[tuple[str, Any]]()
    free = np.ones(len(lower), dtype=bool)
    if rows.cones:
        inside = np.array([np.arange(cone.start, cone.stop) for cone in rows.cones])  # all of one size
        free[inside] = False
        cone = cp.reshape(values[inside.ravel()], inside.shape, order="C") - lower[inside]
        found.append(("cone", cp.SOC(cone[:, 0], cone[:, 1:], axis=1)))
    both = free & np.isfinite(lower) & np.isfinite(upper)
    between, equal = np.flatnonzero(both & (lower < upper)), both & (lower == upper)
    if len(between):
        half, middle = (upper - lower)[between] / 2, (upper + lower)[between] / 2
        found.append(("interval", cp.SOC(half, cp.reshape(values[between] - middle, (len(half), 1), "C"), axis=1)))
    if equal.any():
        found.append(("zero", values[equal] == upper[equal]))
    for kind, here, sign, limit in (("upper", np.isfinite(upper), 1, upper), ("lower", np.isfinite(lower), -1, lower)):
        here = free & here & ~both
        if here.any():
            found.append((kind, sign * values[here] <= sign * limit[here]))
    return found
