"""The problem as a CVXPY problem, to be solved with its solvers or extended by the user."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.problem.arrays import Array, Mask
from lin_freq_ocp.problem.costs import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets import Box, stacked
from lin_freq_ocp.problem.stage_rows import StageRows
from lin_freq_ocp.transcription.real_rows import real_rows

if TYPE_CHECKING:
    import cvxpy


def to_cvxpy(problem: OptimalControlProblem) -> cvxpy.Problem:
    """Return the problem in CVXPY; its optimal value is the cost J, constant terms included.

    Variables (``var_dict``): "x" of shape (T+1, n), "u" of shape (T, m). Constraints carry labels: "dynamics", whose
    dual value is the adjoint eta (T, n); "initial state", "terminal state", "state set", "control set" where a
    component is fixed, and the same with " lower" and " upper" for bounds (only the finite ones, in the order of
    time, then component); "control spectrum", "state spectrum": orthonormal real rows per component. Joint rows carry
    their own name ("stage rows" by default): only those with a finite limit, in the order of time, then row.

    Parameters
    ----------
    problem : OptimalControlProblem
        With a convex cost.

    Raises
    ------
    UnsupportedError
        If the cost is not convex.
    """
    import cvxpy as cp  # here, because it takes more than a second to import and only its users need it

    _require_convex(problem.quadratic)
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    x, u = cp.Variable((T + 1, n), name="x"), cp.Variable((T, m), name="u")
    states = stacked("state_set", problem.state_set, n, T + 1)
    return cp.Problem(
        cp.Minimize(_cost(problem.quadratic, x, u)),
        [
            _dynamics(problem, x, u),
            *_within(problem.initial_box, x[0], "initial state"),
            *_within(problem.terminal_box, x[T], "terminal state"),
            *_within(_free_of_ends(states, problem), x, "state set"),
            *_within(problem.control_tube, u, "control set"),
            *(constraint for rows in problem.stage_rows for constraint in _joint(rows, x, u)),
            *_spectrum(problem.control_stop, u, "control spectrum"),
            *_spectrum(problem.state_stop, x, "state spectrum"),
        ],
    )


def _require_convex(cost: QuadraticCost) -> None:
    worst = cost.nonconvexity()
    if worst is not None:
        t, eigenvalue = worst
        which = "P" if t < 0 else f"[[Q, S], [S', R]] at t = {t}"
        raise UnsupportedError(
            f"cost: {which} has the eigenvalue {eigenvalue:g} < 0, and CVXPY takes convex costs only."
        )


def _cost(cost: QuadraticCost, x: Any, u: Any) -> Any:
    import cvxpy as cp

    a, b = x - np.broadcast_to(cost.x_ref, x.shape), u - np.broadcast_to(cost.u_ref, u.shape)
    stages = cp.vec(cp.hstack([a[:-1], b]), order="C")
    linear = [
        cp.sum(cp.multiply(np.broadcast_to(term, signal.shape), signal))
        for term, signal in ((cost.q, x[:-1]), (cost.r, u), (cost.p, x[-1]))
    ]
    quadratic = _half_square(_per_stage(cost.stage_hessians(), u.shape[0]), stages) + _half_square(cost.P, a[-1])
    return sum(linear, quadratic)


def _per_stage(hessians: Array, horizon: int) -> Any:
    """Return the block diagonal matrix of T blocks, from one for all times or one per time."""
    if len(hessians) == 1:
        return sp.kron(sp.eye_array(horizon), hessians[0], format="csc")
    return sp.block_diag(hessians, format="csc")


def _half_square(hessian: Any, v: Any) -> Any:
    """Return 1/2 v'H v for an H known to be positive semidefinite up to rounding."""
    import cvxpy as cp

    return 0.5 * cp.quad_form(v, cp.psd_wrap(hessian))


def _dynamics(problem: OptimalControlProblem, x: Any, u: Any) -> Any:
    """Return x_{t+1} - A_t x_t - B_t u_t = d_t: in this form its dual is eta, without a change of sign."""
    dynamics = problem.dynamics
    offset = np.broadcast_to(dynamics.offset, (problem.horizon, problem.state_dim))
    return (x[1:] - _times(dynamics.A, x[:-1]) - _times(dynamics.B, u) == offset).set_label("dynamics")


def _times(matrix: Array, vectors: Any) -> Any:
    """Return M v_t, or M_t v_t where the matrix has one per time, for vectors (T, columns)."""
    import cvxpy as cp

    if matrix.ndim == 2:
        return vectors @ matrix.T
    products = sp.block_diag(matrix, format="csr") @ cp.vec(vectors, order="C")
    return cp.reshape(products, matrix.shape[:2], order="C")


def _free_of_ends(states: Box, problem: OptimalControlProblem) -> Box:
    """Return the state sets without the bounds where an end fixes the state: they hold, and would only repeat it."""
    lower, upper = states.lower.copy(), states.upper.copy()
    for t, end in ((0, problem.initial_box), (-1, problem.terminal_box)):
        lower[t, end.fixed], upper[t, end.fixed] = -np.inf, np.inf
    return Box(lower, upper)


def _within(box: Box, signal: Any, label: str) -> list[Any]:
    """Return signal = value where the box leaves no freedom, and its finite bounds elsewhere."""
    lower, upper, free = box.lower, box.upper, ~box.fixed
    parts = (
        (box.fixed, lambda here: signal[here] == lower[here], label),
        (free & np.isfinite(lower), lambda here: signal[here] >= lower[here], f"{label} lower"),
        (free & np.isfinite(upper), lambda here: signal[here] <= upper[here], f"{label} upper"),
    )
    return [constraint(here).set_label(name) for here, constraint, name in parts if here.any()]


def _joint(rows: StageRows, x: Any, u: Any) -> list[Any]:
    """Return C x_t + D u_t <= e_t where there is a limit: its dual is the multiplier, without a change of sign."""
    bounded = rows.bounded(u.shape[0])
    values = _times(rows.C, x[:-1]) + _times(rows.D, u)
    limits = np.broadcast_to(rows.e, bounded.shape)
    return [(values[bounded] <= limits[bounded]).set_label(rows.name)] if bounded.any() else []


def _spectrum(stopped: Mask, signal: Any, label: str) -> list[Any]:
    """Return R_i v_i = 0 for every component i with stopped bins, one component after the other."""
    import cvxpy as cp

    rows = [real_rows(signal.shape[0], stopped[:, i]) @ signal[:, i] for i in np.flatnonzero(stopped.any(axis=0))]
    return [(cp.hstack(rows) == 0).set_label(label)] if rows else []
