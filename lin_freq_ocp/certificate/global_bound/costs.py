"""What a trajectory costs stage by stage once frequency constraints and the like are priced by their multipliers.

For any multipliers, every feasible trajectory has J >= constant + sum_t c_t(x_t, u_t) + c_T(x_T), where the quadratics
c_t hold the signals of the frequency multipliers, which vanish in the sum, and the affine minorants <lambda+, L> - h*
of terms h(L(x, u)) (hamiltonian.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.certificate.hamiltonian import require_fitting
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.bands import time_signal
from lin_freq_ocp.problem.trajectory import Multipliers


@dataclass(frozen=True, eq=False)
class StageCosts:
    """Quadratics 1/2 y'H y + b'y of y = (x_t, u_t), with a constant for all of them together.

    Attributes
    ----------
    hessians : (T, n + m, n + m), linear : (T, n + m)
    terminal_hessian : (n, n), terminal_linear : (n,)
    constant : float
    size : float
        Sum of the absolute values of what the constant is summed from.
    """

    hessians: Array
    linear: Array
    terminal_hessian: Array
    terminal_linear: Array
    constant: float
    size: float


def stage_costs(problem: OptimalControlProblem, multipliers: Multipliers) -> StageCosts:
    """Return the stage costs of a problem with its frequency multipliers and those of its terms.

    Raises
    ------
    ProblemError
        If multipliers do not have the problem's shape, or what is free has one.
    """
    T, n, m, cost = problem.horizon, problem.state_dim, problem.control_dim, problem.quadratic
    require_fitting(problem, multipliers)
    x_ref, u_ref = np.broadcast_to(cost.x_ref, (T + 1, n)), np.broadcast_to(cost.u_ref, (T, m))
    y_ref = np.hstack([x_ref[:T], u_ref])
    hessians = np.array(np.broadcast_to(cost.stage_hessians(), (T, n + m, n + m)))
    drawn = np.einsum("tij,tj->ti", hessians, y_ref)
    own = np.concatenate([np.broadcast_to(cost.q, (T, n)), np.broadcast_to(cost.r, (T, m))], axis=1)
    terminal = cost.P @ x_ref[T]
    constants = [*(0.5 * (y_ref * drawn).sum(1)), float(0.5 * x_ref[T] @ terminal)]
    state_signal, control_signal = time_signal(multipliers.rho_x, T + 1), time_signal(multipliers.rho_u, T)
    in_x, in_u = state_signal.copy(), control_signal.copy()
    for term in problem.terms:
        given = multipliers.stage.get(term.name, np.zeros(term.shape))
        values = term.map.values(x_ref, u_ref)
        weights = term.penalty.subgradient(given, 1.0)
        pulled_x, pulled_u = term.map.pull_back(weights, (x_ref.shape, u_ref.shape))
        in_x, in_u = in_x + pulled_x, in_u + pulled_u
        constants += [*term.penalty.cost(values).ravel(), *(-term.penalty.gap(values, weights, 1.0)).ravel()]
        constants += [-float((pulled_x * x_ref).sum()), -float((pulled_u * u_ref).sum())]
    linear = own - drawn + np.hstack([in_x[:T], in_u])
    terminal_linear = cost.p - terminal + in_x[T]
    size = float(np.abs(constants).sum() + np.abs(in_x * x_ref).sum() + np.abs(in_u * u_ref).sum())
    return StageCosts(
        hessians,
        np.asarray(linear, dtype=np.float64),
        np.asarray(cost.P, dtype=np.float64),
        np.asarray(terminal_linear, dtype=np.float64),
        float(np.sum(constants)),
        size,
    )
