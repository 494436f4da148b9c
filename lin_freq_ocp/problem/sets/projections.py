# pyright: reportAttributeAccessIssue=false
"""The nearest point and the support function of a set given by a Box and parts, as small conic programs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import clarabel
import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.errors import NumericalError
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.terms.penalties import Below, Cone, hard

if TYPE_CHECKING:
    from lin_freq_ocp.problem.sets.convex import Part

TOLERANCE = 1e-12
"""Of the solver's residuals and gap: what comes out is compared with 1e-8 at best."""

DONE = ("Solved", "AlmostSolved", "InsufficientProgress")


def nearest(box: Box, parts: Sequence[Part], point: Array) -> Array:
    """Return the point of the set with the least |v - point|."""
    size = max(1.0, float(np.abs(point).max()))
    return size * _solved(box, parts, np.eye(len(point)), -point / size, size)[0]


def support(box: Box, parts: Sequence[Part], direction: Array) -> float:
    """Return max <direction, v> over the set, inf if there is none."""
    size = float(np.abs(direction).max())
    if size == 0:
        return 0.0
    n = len(direction)
    v, status = _solved(box, parts, np.zeros((n, n)), -direction / size, 1.0)
    return np.inf if status.endswith("DualInfeasible") else float(direction @ v)


def _solved(box: Box, parts: Sequence[Part], P: Array, q: Array, unit: float) -> tuple[Array, str]:
    """Minimise 1/2 v'P v + q'v over the set divided by ``unit``."""
    matrices, right, cones = _conic_rows(box, parts, len(q))
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = TOLERANCE
    A, b = sp.csc_matrix(np.vstack(matrices)), np.concatenate(right) / unit
    answer = clarabel.DefaultSolver(sp.csc_matrix(P), q, A, b, cones, settings).solve()
    status = str(answer.status)
    if status not in DONE and not status.endswith("DualInfeasible"):
        empty = status.endswith("PrimalInfeasible")
        raise NumericalError("The set is empty." if empty else f"The solver of a set ended as {status}.")
    return np.array(answer.x), status


def _conic_rows(box: Box, parts: Sequence[Part], n: int) -> tuple[list[Array], list[Array], list[object]]:
    """Return the rows of A v + s = b with s in the cones."""
    identity = np.eye(n)
    finite = np.isfinite(box.upper), np.isfinite(box.lower)
    matrices = [identity[finite[0]], -identity[finite[1]]]
    right = [box.upper[finite[0]], -box.lower[finite[1]]]
    cones: list[object] = [clarabel.NonnegativeConeT(int(sum(side.sum() for side in finite)))]
    for part in parts:
        if not hard(part.penalty.weight):
            continue
        if isinstance(part.penalty, Below):
            limited = np.isfinite(part.penalty.limit)
            matrices.append(part.F[limited])
            right.append((part.penalty.limit - part.c)[limited])
            cones.append(clarabel.NonnegativeConeT(int(limited.sum())))
            continue
        edge = [] if isinstance(part.penalty, Cone) else [float(part.penalty.radius)]
        matrices.append(-np.vstack([np.zeros((len(edge), n)), part.F]))
        right.append(np.append(edge, part.c))
        cones.append(clarabel.SecondOrderConeT(len(edge) + len(part.c)))
    return matrices, right, cones
