"""The stages of the global bound: costs with constraints priced by multipliers, bounds of states and controls.

For any multipliers, every feasible trajectory has J >= constant + sum_t c_t(x_t, u_t) + c_T(x_T), where the quadratics
c_t hold the signals of the frequency multipliers, which vanish in the sum, and the affine minorants <lambda+, L> - h*
of terms h(L(x, u)) (hamiltonian.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.certificate.hamiltonian import require_fitting
from lin_freq_ocp.certificate.hybrid.global_bound.tolerances import FLATNESS, SHADOW_WIDENING
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import time_signal
from lin_freq_ocp.problem.trajectory import Multipliers


@dataclass(frozen=True, eq=False)
class StageCosts:
    """Quadratics 1/2 y'H y + b'y of y = (x_t, u_t), with a constant for all of them together.

    hessians : (T, n + m, n + m), linear : (T, n + m), terminal_hessian : (n, n), terminal_linear : (n,);
    ``size`` is the sum of the absolute values of what the constant is summed from.
    """

    hessians: Array
    linear: Array
    terminal_hessian: Array
    terminal_linear: Array
    constant: float
    size: float


def stage_costs(problem: OptimalControlProblem, multipliers: Multipliers) -> StageCosts:
    """Return the stage costs of a problem with its frequency multipliers and those of its terms."""
    T, n, m, cost = problem.horizon, problem.state_dim, problem.control_dim, problem.quadratic
    require_fitting(problem, multipliers)
    x_ref, u_ref = np.broadcast_to(cost.x_ref, (T + 1, n)), np.broadcast_to(cost.u_ref, (T, m))
    y_ref = np.hstack([x_ref[:T], u_ref])
    hessians = np.array(np.broadcast_to(cost.stage_hessians(), (T, n + m, n + m)))
    of_reference = np.einsum("tij,tj->ti", hessians, y_ref)
    own = np.concatenate([np.broadcast_to(cost.q, (T, n)), np.broadcast_to(cost.r, (T, m))], axis=1)
    terminal = cost.P @ x_ref[T]
    constants = [*(0.5 * (y_ref * of_reference).sum(1)), float(0.5 * x_ref[T] @ terminal)]
    in_x, in_u = problem.in_time(multipliers.rho_x), time_signal(multipliers.rho_u, T)
    for term in problem.terms:
        values = term.map.values(x_ref, u_ref)
        weights = term.penalty.subgradient(multipliers.stage.get(term.name, np.zeros(term.shape)), 1.0)
        pulled_x, pulled_u = term.map.pull_back(weights, (x_ref.shape, u_ref.shape))
        in_x, in_u = in_x + pulled_x, in_u + pulled_u
        constants += [*term.penalty.cost(values).ravel(), *(-term.penalty.gap(values, weights, 1.0)).ravel()]
        constants += [-float((pulled_x * x_ref).sum()), -float((pulled_u * u_ref).sum())]
    linear = own - of_reference + np.hstack([in_x[:T], in_u])
    terminal_linear = cost.p - terminal + in_x[T]
    size = float(np.abs(constants).sum() + np.abs(in_x * x_ref).sum() + np.abs(in_u * u_ref).sum())
    linear, P, terminal_linear = (np.asarray(part, dtype=np.float64) for part in (linear, cost.P, terminal_linear))
    return StageCosts(hessians, linear, P, terminal_linear, float(np.sum(constants)), size)


@dataclass(frozen=True, eq=False)
class Stages:
    """A problem with priced costs and bounds: a trajectory that is not within them costs too much or is not feasible.

    lower, upper : (T, m), of the controls; lowest, highest : (T+1, n), of the states.
    """

    problem: OptimalControlProblem
    costs: StageCosts
    lower: Array
    upper: Array
    lowest: Array
    highest: Array

    @classmethod
    def below(cls, problem: OptimalControlProblem, costs: StageCosts, level: float) -> Stages:
        """Return the stages of trajectories below a level of the cost without its constant."""
        n = problem.state_dim
        forms = [QuadraticForm(*parts) for parts in zip(costs.hessians, costs.linear, strict=True)]
        forms.append(QuadraticForm(costs.terminal_hessian, costs.terminal_linear))
        left = level - sum(form.least for form in forms)
        shadows = [form.shadow(max(left, 0.0) if np.isfinite(left) else np.inf) for form in forms]
        x, u = np.array([shadow[:, :n] for shadow in shadows]), np.array([shadow[:, n:] for shadow in shadows[:-1]])
        return cls(problem, costs, *_clipped(u, problem.control_tube), *_clipped(x, problem.state_tube))

    def cost(self, t: int, y: Array) -> Array:
        """Return c_t of pairs (points, n + m)."""
        return 0.5 * np.einsum("pi,ij,pj->p", y, self.costs.hessians[t], y) + y @ self.costs.linear[t]


class QuadraticForm:
    """The quadratic 1/2 y'H y + b'y with H >= 0; ``least`` is its minimum, or -inf.

    It is taken apart in units in which the diagonal of H is 1, so that flat directions do not depend on units.
    """

    def __init__(self, hessian: Array, linear: Array):
        diagonal = np.diagonal(hessian)
        units = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        values, vectors = np.linalg.eigh(units[:, None] * hessian * units)
        curved, slope = values > FLATNESS * max(float(values[-1]), 0.0), units * linear
        along = vectors.T @ slope
        flat = np.abs(along[~curved]).max(initial=0.0) <= FLATNESS * float(np.abs(slope).max(initial=0.0))
        flat &= not linear[diagonal <= 0].any()
        self._flat_in = np.abs(vectors[:, ~curved]).max(axis=1, initial=0.0) > FLATNESS
        inverse = vectors[:, curved] / values[curved]
        self._centre = units * (-inverse @ along[curved])
        self._inverse = units**2 * (inverse * vectors[:, curved]).sum(axis=1)
        self.least = -0.5 * float((along[curved] ** 2 / values[curved]).sum()) if flat else -np.inf

    def shadow(self, above: float) -> Array:
        """Return bounds of y where the form is ``above`` its least at most, (2, n + m)."""
        if above == np.inf:
            return np.stack([np.full(len(self._centre), -np.inf), np.full(len(self._centre), np.inf)])
        radius = np.sqrt(2 * above * self._inverse)
        widened = (1 + SHADOW_WIDENING) * radius + SHADOW_WIDENING * np.abs(self._centre)
        radius = np.where(self._flat_in, np.inf, widened)
        return np.stack([self._centre - radius, self._centre + radius])


def _clipped(shadow: Array, box: Box) -> tuple[Array, Array]:
    """Return the intersection of shadows (times, 2, .) with a box; the nearest of the box where it is empty."""
    return np.clip(shadow[:, 0], box.lower, box.upper), np.clip(shadow[:, 1], box.lower, box.upper)
