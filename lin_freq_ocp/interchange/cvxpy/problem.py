"""The problem as a CVXPY problem, to be solved with its solvers or extended by the user."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.interchange.cvxpy.terms import stage_products, terms_of
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.transcription.linear.real_rows import real_rows

if TYPE_CHECKING:
    import cvxpy


def to_cvxpy(problem: OptimalControlProblem) -> cvxpy.Problem:
    """Return the problem in CVXPY; its optimal value is the cost J, constant terms included.

    Variables (``var_dict``): "x" of shape (T+1, n), "u" of shape (T, m). Constraints carry labels: "dynamics", whose
    dual value is the adjoint eta (T, n); "initial state", "terminal state", "state set", "control set" where a
    component is fixed, and the same with " lower" and " upper" for bounds (only the finite ones, in the order of
    time, then component); "control spectrum", "state spectrum": orthonormal real rows per component.

    Whatever else must hold carries the name under which its multipliers stand in ``result.multipliers.stage``: joint
    rows ("stage rows" by default), "control set" and the like beyond boxes (components that such a set also fixes are
    then "control set fixed"), "mask on ...", "energy bound on ...". Rows and equations have the multipliers as their
    dual value, only finite limits, in the order of time or bin, then row. Euclidean norms and cones are ``cvxpy.SOC``,
    one cone per time or bin, whose dual values are a number sigma >= |z| and a vector z of each: the multiplier is -z
    of a norm, and (-sigma, -z) of a cone. Soft constraints and nonsmooth costs are in the objective, with a variable of
    their own: "slacks of " and their name, bounded by constraints of that name with " slack".

    Parameters
    ----------
    problem : OptimalControlProblem
        With a convex cost.

    Returns
    -------
    cvxpy.Problem

    Raises
    ------
    UnsupportedError
        If the cost is not convex, or the dynamics have modes (take ``problem.with_modes(sequence)``).

    Examples
    --------
    >>> model = lfo.to_cvxpy(lfo.library.double_integrator(horizon=60))
    >>> model.var_dict["x"].shape
    (61, 2)
    """
    import cvxpy as cp  # here, because it takes more than a second to import and only its users need it

    require_problem(problem)
    _ = problem.linear  # which raises if there are modes
    _require_convex(problem.quadratic)
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    x, u = cp.Variable((T + 1, n), name="x"), cp.Variable((T, m), name="u")
    states = problem.state_boxes
    costs, terms = terms_of(problem, x, u)
    taken = {constraint.label for constraint in terms}
    return cp.Problem(
        cp.Minimize(sum(costs, _cost(problem.quadratic, x, u))),
        [
            _dynamics(problem, x, u),
            *_within(problem.initial_box, x[0], "initial state", taken),
            *_within(problem.terminal_box, x[T], "terminal state", taken),
            *_within(_free_of_ends(states, problem), x, "state set", taken),
            *_within(problem.control_tube, u, "control set", taken),
            *terms,
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
    dynamics = problem.linear
    offset = np.broadcast_to(dynamics.offset, (problem.horizon, problem.state_dim))
    return (x[1:] - stage_products(dynamics.A, x[:-1]) - stage_products(dynamics.B, u) == offset).set_label("dynamics")


def _free_of_ends(states: Box, problem: OptimalControlProblem) -> Box:
    """Return the state sets without the bounds where an end fixes the state: they hold, and would only repeat it."""
    lower, upper = states.lower.copy(), states.upper.copy()
    for t, end in ((0, problem.initial_box), (-1, problem.terminal_box)):
        lower[t, end.fixed], upper[t, end.fixed] = -np.inf, np.inf
    return Box(lower, upper)


def _within(box: Box, signal: Any, label: str, taken: set[str]) -> list[Any]:
    """Return signal = value where the box leaves no freedom, and its finite bounds elsewhere."""
    lower, upper, free = box.lower, box.upper, ~box.fixed
    parts = (
        (box.fixed, lambda here: signal[here] == lower[here], f"{label} fixed" if label in taken else label),
        (free & np.isfinite(lower), lambda here: signal[here] >= lower[here], f"{label} lower"),
        (free & np.isfinite(upper), lambda here: signal[here] <= upper[here], f"{label} upper"),
    )
    return [constraint(here).set_label(name) for here, constraint, name in parts if here.any()]


def _spectrum(stopped: Mask, signal: Any, label: str) -> list[Any]:
    """Return R_i v_i = 0 for every component i with stopped bins, one component after the other."""
    import cvxpy as cp

    rows = [real_rows(signal.shape[0], stopped[:, i]) @ signal[:, i] for i in np.flatnonzero(stopped.any(axis=0))]
    return [(cp.hstack(rows) == 0).set_label(label)] if rows else []
