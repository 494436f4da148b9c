"""The second-order test: whether the Hessian of the Lagrangian is positive where the critical cone reaches.

    sum_t d_t' H_t d_t + dx_T' P dx_T >= 0   for all d_t = (dx_t, du_t) with dx_{t+1} = A_t dx_t + B_t du_t, C_t d_t = 0

H_t is the Hessian of c_t - <eta_t, f_t> + <mu_t, h_t>, h_t the path constraints, and C_t are the bounds, rows and
gradients of h_t that are active with a multiplier: they span the critical cone. The Riccati recursion decides in O(T):
the problem is convex if all its pivots

    H_uu + B' P_{t+1} B     with    P_t = Q_t - K_t' (H_uu + B' P_{t+1} B) K_t

are positive. C_t d_t = 0 is a weight on |C_t d_t|^2 that rises: a problem that is convex with one weight is convex on
C_t d_t = 0. A pivot below zero leads to a direction, from its time on by the gains of the recursion, which is then
checked itself: its curvature, and that it keeps the active constraints with one of its two signs.

Everything is in the sizes of the trajectory and the data. Rounding and errors of multipliers are some digits of the
terms of H: so much is added to it, which hides no direction of descent that is more than that.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE
from lin_freq_ocp.certificate.verdict import SecondOrder
from lin_freq_ocp.formulas.nodes import kinks
from lin_freq_ocp.formulas.operations import EXTERNAL
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.problem_data import replace_fields
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.hybrid.forms import active_normals, piecewise_smooth

CURVATURE = 1e-7  # part of the terms of the Hessian that errors of multipliers make: these are right to 1e-6 at most
CURVATURE_FLOOR = 1e-12  # the same, relative to the largest component
CONSTRAINT_WEIGHTS = (1e2, 1e5, 1e8)  # of active constraints, relative to the largest curvature
ALLOWED_VIOLATION = 1e-3  # violation of active constraints, relative to a direction, that the largest weight leaves


def second_order_test(
    problem: OptimalControlProblem, at: Trajectory, multipliers: Multipliers, sizes: tuple[Array, Array], final: Array
) -> SecondOrder:
    """Test a trajectory of smooth dynamics on which no kink and no switching boundary is active.

    ``sizes`` are those of states and controls, (n + m,), and the scales of the adjoint equation and of stationarity in
    u, (T, n + m); ``final`` (n, n) is added to the Hessian of the cost of x_T.
    """
    dynamics, T, n = piecewise_smooth(problem), problem.horizon, problem.state_dim
    formulas = [formula for mode in dynamics.modes for formula in mode.f]
    rough = [node.function for node in kinks(formulas, EXTERNAL) if node.function and not node.function.exact_curvature]
    if rough:
        return SecondOrder(None, f"{rough[0].title} has no exact second derivatives")
    x, u, (units, slopes) = at.x, at.u, sizes
    modes, y = dynamics.sequence_of(x, u), np.hstack([x[:-1], u])
    _, gains, curvatures = dynamics.jets_at(y).maps_of(modes, np.arange(T))
    cost = np.broadcast_to(problem.quadratic.stage_hessians, (T, len(units), len(units)))
    bent, scale = np.einsum("ti,tijk->tjk", multipliers.eta, curvatures), units[:, None] * units
    H, terms = (cost - bent) * scale, np.zeros((T + 1, len(units)))
    bends = np.einsum("ti,tijk->tjk", np.abs(multipliers.eta), np.abs(curvatures))
    terms[:-1] = np.einsum("tii->ti", np.abs(cost) + bends)
    added = final.copy()
    for one in problem.path_constraints:
        prices = multipliers.stage.get(one.name, np.zeros(one.map.shape))
        bends = np.einsum("ti,tijk->tjk", prices, one.map.jets_along(x, u).curvatures)
        H += bends[:T] * scale
        terms[:T] += np.einsum("tii->ti", np.abs(bends[:T]))
        added += bends[T:, :n, :n].sum(axis=0)
    P = (problem.quadratic.P + added) * scale[:n, :n]
    terms[-1, :n] = np.abs(np.diag(problem.quadratic.P)) + np.abs(added).max(axis=0)
    weighted = terms * units**2
    largest = float(weighted.max())
    if largest == 0:
        return SecondOrder(True, "")
    error = (CURVATURE * weighted + CURVATURE_FLOOR * largest)[:, None] * np.eye(len(units))
    AB, linear = gains * units / units[:n, None], replace_fields(problem, stage_rows=problem.rows_along(at))
    # a multiplier is zero if stationarity holds without it: its slopes are within the tolerance of the judge
    least, rows = CONDITION_TOLERANCE * np.vstack([slopes, slopes[-1:]]), list[tuple[int, Array, bool]]()
    strong = np.zeros((T + 1, len(units), len(units)))
    for t, active in enumerate(active_normals(linear, at, units, CONDITION_TOLERANCE)):
        for one in active:
            length, slopes_of_it = float(np.linalg.norm(one.column * units)), one.value(multipliers) * one.column
            if length > 0:
                row, held = one.column * units / length, one.fixed or bool((np.abs(slopes_of_it) > least[t]).any())
                rows.append((t, row, held))
                strong[t] += np.outer(row, row) if held else 0.0
    d, first = np.zeros((T + 1, len(units))), problem.initial_box.fixed
    for weight in CONSTRAINT_WEIGHTS if strong.any() else (0.0,):
        held = weight * largest * strong
        found = _negative_direction(AB, H + error[:-1] + held[:-1], P + error[-1, :n, :n] + held[-1, :n, :n], ~first)
        if found is None:
            return SecondOrder(True, "")
        d = found / np.abs(found).max()
    curvature = float(np.einsum("ti,tij,tj->", d[:-1], H, d[:-1]) + d[-1, :n] @ P @ d[-1, :n])
    keeps = all(abs(row @ d[t]) <= ALLOWED_VIOLATION for t, row, held in rows if held)
    weak = [float(row @ d[t]) for t, row, held in rows if not held]
    others = [term.name for term in linear.terms if term.polyhedron(n, problem.control_dim) is None]
    reason = "constraints couple all times" if problem.control_stop.any() or problem.state_stop.any() else ""
    reason = reason or (f"{others[0]} is curved or couples times" if others else "")
    if reason or curvature >= 0 or not keeps:
        return SecondOrder(None, reason or "active constraints leave it open")
    d = -d if max(weak, default=0.0) > ALLOWED_VIOLATION else d
    if max(weak, default=0.0) > ALLOWED_VIOLATION < -min(weak, default=0.0):
        return SecondOrder(None, "bounds that are active without a multiplier leave it open")
    return SecondOrder(False, "", curvature, Trajectory(d[:, :n] * units[:n], d[:-1, n:] * units[n:]))


def _negative_direction(AB: Array, H: Array, P: Array, free: Mask) -> Array | None:
    """Return d (T+1, n + m) along which the curvature is not positive, from a pivot that is not; None if all are."""
    T, n = len(H), len(P)
    gains, d = np.zeros((T, H.shape[1] - n, n)), np.zeros((T + 1, H.shape[1]))
    first = 0
    for t in range(T - 1, -1, -1):
        M = H[t] + AB[t].T @ P @ AB[t]
        try:
            L = np.linalg.cholesky(M[n:, n:])
        except np.linalg.LinAlgError:
            d[t, n:] = np.linalg.eigh(M[n:, n:])[1][:, 0]
            first = t
            break
        gains[t] = -np.linalg.solve(L.T, np.linalg.solve(L, M[n:, :n]))
        P = M[:n, :n] + M[:n, n:] @ gains[t]
        P = (P + P.T) / 2
    else:
        if not free.any():
            return None
        values, vectors = np.linalg.eigh(P[np.ix_(free, free)])
        if values[0] > 0:
            return None
        d[0, :n][free] = vectors[:, 0]
        d[0, n:] = gains[0] @ d[0, :n]
    for t in range(first, T):
        if t > first:
            d[t, n:] = gains[t] @ d[t, :n]
        d[t + 1, :n] = AB[t] @ d[t]
    return d
