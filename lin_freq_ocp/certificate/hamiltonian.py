"""The Hamiltonian's first derivatives along a trajectory, and the size of the terms they are summed from.

H_t(eta, x, u) = <eta, f_t(x, u)> - eta_C c_t(x, u) - <eta_xhat, phi_t(x)> - <eta_uhat, psi_t(u)>   (e:hamiltonian)

Joint rows C x_t + D u_t <= e_t with multipliers l_t join it as the Lagrangian term -<l_t+, C x + D u - e_t>, with
l+ = max(l, 0): so all that follows from it holds for the rows too, and the bound for multipliers of any sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem.arrays import Array, ComplexArray, Mask, extended
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum import time_signal
from lin_freq_ocp.problem.stage_rows import StageRows
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory


@dataclass(frozen=True, eq=False)
class RowLift:
    """One family of joint rows along a trajectory.

    Attributes
    ----------
    rows : StageRows
    weights : (T, rows)
        The multipliers l_t, of any sign.
    slack : (T, rows)
        e_t - C x_t - D u_t; inf where there is no limit.
    terms : (T, rows)
        |C| |x_t| + |D| |u_t|, what the rounding errors of C x_t + D u_t are relative to.
    """

    rows: StageRows
    weights: Array
    slack: Array
    terms: Array

    @property
    def positive(self) -> Array:
        """Return l+ = max(l, 0)."""
        return np.maximum(self.weights, 0.0)

    @property
    def products(self) -> Array:
        """Return l+ times slack, entry by entry; 0 where there is no limit, and no multiplier."""
        return self.positive * np.where(self.positive > 0, self.slack, 0.0)

    @property
    def products_terms(self) -> Array:
        """Return what the rounding errors of the products are relative to, (T, rows)."""
        limits = np.where(np.isfinite(self.rows.e), np.abs(self.rows.e), 0.0)
        return self.positive * (self.terms + limits)


@dataclass(frozen=True, eq=False)
class Lift:
    """A trajectory with its multipliers, and everything that several conditions need of them.

    Signals and derivatives are in extended precision: they are what is left of terms that cancel.

    Attributes
    ----------
    problem, trajectory, multipliers
        What is judged.
    state_signal : (T+1, n), control_signal : (T, m)
        The frequency multipliers as functions of time, (D phi_t)' eta_xhat and (D psi_t)' eta_uhat.
    in_x : (T+1, n)
        D_x H_t for t < T, with -C'l+; at T, where there is no f, -eta_C D c_T - (D phi_T)' eta_xhat.
    in_u : (T, m)
        D_u H_t, with -D'l+.
    in_x_terms, in_u_terms
        The sums of the absolute values of the terms of in_x and in_u: what their rounding errors are relative to.
    stage : tuple of RowLift
        The joint rows, one entry per family.
    """

    problem: OptimalControlProblem
    trajectory: Trajectory
    multipliers: Multipliers
    state_signal: Array
    control_signal: Array
    in_x: Array
    in_u: Array
    in_x_terms: Array
    in_u_terms: Array
    stage: tuple[RowLift, ...]

    @property
    def eta_before(self) -> Array:
        """Return eta_{t-1} for t = 0 .. T, shape (T+1, n), with 0 at t = 0, where there is none."""
        return np.vstack([np.zeros(self.problem.state_dim), self.multipliers.eta])


def lift(problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers) -> Lift:
    """Evaluate the Hamiltonian's derivatives; ProblemError if shapes do not fit or what is free has a multiplier."""
    problem.require(trajectory)
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    if multipliers.eta.shape != (T, n) or multipliers.nu.shape != (T, m):
        got = f"eta {multipliers.eta.shape}, nu {multipliers.nu.shape}"
        raise ProblemError("multipliers", got, f"eta {(T, n)}, nu {(T, m)}")
    _require_only_at_stopped("rho_u", multipliers.rho_u, problem.control_stop)
    _require_only_at_stopped("rho_x", multipliers.rho_x, problem.state_stop)
    x, u, eta = extended(trajectory.x), extended(trajectory.u), extended(multipliers.eta)
    eta_C = multipliers.eta_C
    state_signal = time_signal(extended(multipliers.rho_x), T + 1)
    control_signal = time_signal(extended(multipliers.rho_u), T)
    cost_x, cost_u = problem.cost.gradient(x, u)
    in_x, in_u = -eta_C * cost_x - state_signal, -eta_C * cost_u - control_signal
    cost_x_terms, cost_u_terms = problem.cost.gradient_magnitudes(x, u)
    in_x_terms = abs(eta_C) * cost_x_terms + np.abs(multipliers.rho_x).sum(0)
    in_u_terms = abs(eta_C) * cost_u_terms + np.abs(multipliers.rho_u).sum(0)
    through_x, through_u = problem.dynamics.pull_back(eta)
    terms_x, terms_u = problem.dynamics.magnitudes().pull_back(np.abs(eta))
    in_x[:-1] += through_x
    in_u += through_u
    in_x_terms[:-1] += terms_x
    in_u_terms += terms_u
    stage = _lifted_rows(problem, trajectory, multipliers)
    for family in stage:
        of_x, of_u = family.rows.pull_back(family.positive)
        terms_x, terms_u = family.rows.magnitudes().pull_back(family.positive)
        in_x[:-1] -= of_x
        in_u -= of_u
        in_x_terms[:-1] += terms_x
        in_u_terms += terms_u
    return Lift(
        problem, trajectory, multipliers, state_signal, control_signal, in_x, in_u, in_x_terms, in_u_terms, stage
    )


def _lifted_rows(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers
) -> tuple[RowLift, ...]:
    x, u, names = trajectory.x, trajectory.u, [family.name for family in problem.stage_rows]
    for name in multipliers.stage:
        if name not in names:
            raise ProblemError("multipliers.stage", repr(name), f"the names of the joint rows: {names}")
    lifted: list[RowLift] = []
    for rows in problem.stage_rows:
        shape = problem.horizon, rows.rows
        weights = multipliers.stage.get(rows.name, np.zeros(shape))
        field = f"multipliers.stage[{rows.name!r}]"
        if weights.shape != shape:
            raise ProblemError(field, f"shape {weights.shape}", f"shape {shape}")
        unlimited = (weights != 0) & np.isinf(rows.e)
        if unlimited.any():
            t, row = (int(i) for i in np.argwhere(unlimited)[0])
            raise ProblemError(
                f"{field}[{t}, {row}]", f"{weights[t, row]:g}", "0", "There is no limit to this row then."
            )
        lifted.append(RowLift(rows, weights, rows.slack(x, u), rows.magnitudes().values(np.abs(x), np.abs(u))))
    return tuple(lifted)


def _require_only_at_stopped(field: str, rho: ComplexArray, stopped: Mask) -> None:
    free = (rho != 0) & ~stopped
    if free.any():
        k, component = (int(i) for i in np.argwhere(free)[0])
        raise ProblemError(f"multipliers.{field}[{k}, {component}]", f"{rho[k, component]:g}", "0", f"Bin {k} is free.")
