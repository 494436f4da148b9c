"""The Hamiltonian's first derivatives along a trajectory, and the size of the terms they are summed from.

H_t(eta, x, u) = <eta, f_t(x, u)> - eta_C c_t(x, u) - <eta_xhat, phi_t(x)> - <eta_uhat, psi_t(u)>   (e:hamiltonian)

What a problem has beyond that, h(L(x, u)) with multipliers lambda, joins it as the Lagrangian term -<lambda+, L(x, u)>,
with lambda+ the nearest multipliers that are subgradients of h somewhere (for a row, max(lambda, 0)): so all that
follows from it holds for them, too, and the bound for multipliers of any sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array, ComplexArray, Mask, extended
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.bands import time_signal
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory


@dataclass(frozen=True, eq=False)
class TermLift:
    """One term along a trajectory; arrays are (groups, dim), (groups, 1) where they are of whole groups.

    Attributes
    ----------
    term : Term
    given : (groups, dim)
        The multipliers, whatever they are.
    weights : (groups, dim)
        lambda+, the nearest ones that are subgradients of h somewhere.
    values : (groups, dim)
        L(x, u), in extended precision.
    sizes : (groups, dim)
        The sums of the absolute values of its terms: what its rounding errors are relative to.
    gap : (groups, dim or 1)
        h(v) + h*(lambda+) - <lambda+, v>, zero iff lambda+ is a subgradient of h at v.
    misfit : (groups, dim or 1)
        What the gap sees to second order only: how far the directions of lambda+ and v differ.
    """

    term: Term
    given: Array
    weights: Array
    values: Array
    sizes: Array
    gap: Array
    misfit: Array

    @property
    def gap_terms(self) -> Array:
        """Return what the rounding errors of the gaps are relative to, (groups,)."""
        limits = np.broadcast_to(self.term.penalty.sizes(), self.values.shape)
        return (np.abs(self.weights) * (self.sizes + limits)).sum(1) + np.abs(self.gap).sum(1)


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
        D_x H_t for t < T, with the terms; at T, where there is no f, -eta_C D c_T - (D phi_T)' eta_xhat.
    in_u : (T, m)
        D_u H_t, with the terms.
    in_x_terms, in_u_terms
        The sums of the absolute values of the terms of in_x and in_u: what their rounding errors are relative to.
    terms : tuple of TermLift
        Everything beyond the quadratic cost, boxes and stop bands.
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
    terms: tuple[TermLift, ...]

    @property
    def eta_before(self) -> Array:
        """Return eta_{t-1} for t = 0 .. T, shape (T+1, n), with 0 at t = 0, where there is none."""
        return np.vstack([np.zeros(self.problem.state_dim), self.multipliers.eta])

    @property
    def state_residual(self) -> Array:
        """Return x_{t+1} - f_t(x_t, u_t), shape (T, n)."""
        return state_residual(self.problem, self.trajectory)


def state_residual(problem: OptimalControlProblem, trajectory: Trajectory) -> Array:
    """Return x_{t+1} - f_t(x_t, u_t) of linear dynamics, shape (T, n)."""
    return trajectory.x[1:] - problem.linear.successors(trajectory.x, trajectory.u)


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
    cost_x, cost_u = problem.quadratic.gradient(x, u)
    in_x, in_u = -eta_C * cost_x - state_signal, -eta_C * cost_u - control_signal
    cost_x_terms, cost_u_terms = problem.quadratic.gradient_magnitudes(x, u)
    in_x_terms = abs(eta_C) * cost_x_terms + np.abs(multipliers.rho_x).sum(0)
    in_u_terms = abs(eta_C) * cost_u_terms + np.abs(multipliers.rho_u).sum(0)
    through_x, through_u = problem.linear.pull_back(eta)
    terms_x, terms_u = problem.linear.magnitudes().pull_back(np.abs(eta))
    in_x[:-1] += through_x
    in_u += through_u
    in_x_terms[:-1] += terms_x
    in_u_terms += terms_u
    terms = _lifted_terms(problem, trajectory, multipliers)
    shapes = x.shape, u.shape
    for lifted in terms:
        for signal, pulled in zip((in_x, in_u), lifted.term.map.pull_back(lifted.weights, shapes), strict=True):
            signal -= pulled
        sizes = lifted.term.map.pulled_sizes(lifted.weights, shapes)
        for signal, pulled in zip((in_x_terms, in_u_terms), sizes, strict=True):
            signal += pulled
    return Lift(
        problem, trajectory, multipliers, state_signal, control_signal, in_x, in_u, in_x_terms, in_u_terms, terms
    )


def _lifted_terms(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers
) -> tuple[TermLift, ...]:
    x, u, names = extended(trajectory.x), extended(trajectory.u), [term.name for term in problem.terms]
    for name in multipliers.stage:
        if name not in names:
            raise ProblemError("multipliers.stage", repr(name), f"the names of the constraints: {names}")
    lifted: list[TermLift] = []
    for term in problem.terms:
        given = multipliers.stage.get(term.name, np.zeros(term.shape))
        if given.shape != term.shape:
            raise ProblemError(f"multipliers.stage[{term.name!r}]", f"shape {given.shape}", f"shape {term.shape}")
        _require_no_multiplier_without_limit(term, given)
        values, weights = term.map.values(x, u), term.penalty.subgradient(extended(given), multipliers.eta_C)
        sizes = term.map.sizes(trajectory.x, trajectory.u)
        gap = term.penalty.gap(values, weights, multipliers.eta_C)
        lifted.append(TermLift(term, given, weights, values, sizes, gap, term.penalty.misfit(values, weights)))
    return tuple(lifted)


def _require_no_multiplier_without_limit(term: Term, given: Array) -> None:
    unlimited = (given != 0) & term.penalty.unlimited
    if unlimited.any():
        t, row = (int(i) for i in np.argwhere(unlimited)[0])
        field = f"multipliers.stage[{term.name!r}][{t}, {row}]"
        raise ProblemError(field, f"{given[t, row]:g}", "0", "There is no limit to this row then.")


def _require_only_at_stopped(field: str, rho: ComplexArray, stopped: Mask) -> None:
    free = (rho != 0) & ~stopped
    if free.any():
        k, component = (int(i) for i in np.argwhere(free)[0])
        raise ProblemError(f"multipliers.{field}[{k}, {component}]", f"{rho[k, component]:g}", "0", f"Bin {k} is free.")
