"""A problem with a cost by formulas as the problem with this cost as a state.

With z_{t+1} = z_t + c_t(x_t, u_t), z_0 = 0, the cost sum c_t(x_t, u_t) is z_T, and its multiplier is -eta_C at all
times: <(eta, -eta_C), (f, z + c)> is <eta, f> - eta_C c up to z. The maximum principle of the problem with z is that of
the problem itself, with kinks of cost and dynamics in one subdifferential.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import brief, with_columns
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.formulas.jets import jets_of
from lin_freq_ocp.formulas.nodes import signals, with_states
from lin_freq_ocp.problem.costs.quadratic import CostSum
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics, SmoothMode
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.problem_data import replace_fields
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.hybrid.forms import piecewise_smooth
from lin_freq_ocp.transform.reformulations import OwnStates, augment_states


@dataclass(frozen=True, eq=False)
class CostState(OwnStates):
    """The way back from the problem in the states (x, z), where z is the cost by formulas so far."""

    def start(self, trajectory: Trajectory) -> Trajectory:
        """Return a trajectory of the given problem with its cost so far."""
        costs = self.given.cost.formula_values(trajectory.x, trajectory.u)
        for t in np.flatnonzero(~np.isfinite(costs))[:1]:
            got = f"{costs[t]:g} at t = {t}, x = {brief(trajectory.x[t].tolist())}"
            raise ProblemError("SmoothCost", got, "a finite number along the trajectory")
        return Trajectory(np.column_stack([trajectory.x, np.append(0.0, np.cumsum(costs[:-1]))]), trajectory.u)

    def with_adjoint(self, multipliers: Multipliers) -> Multipliers:
        """Return multipliers of the given problem with those of z: -eta_C."""
        eta, mu = with_columns(multipliers.eta, 1), with_columns(multipliers.mu, 1)
        eta[:, -1] = mu[0, -1] = -multipliers.eta_C
        rho_x, stage = np.pad(multipliers.rho_x, ((0, 0), (0, 1))), dict(multipliers.stage)
        for name, own in self.own_values.items():
            if name in stage:
                stage[name] = np.zeros((len(stage[name]), len(own)))
                stage[name][:, own] = multipliers.stage[name]
        return replace(multipliers, eta=eta, mu=mu, rho_x=rho_x, stage=stage)


def cost_as_state(problem: OptimalControlProblem, at: Trajectory) -> CostState | None:
    """Return the problem with its stage cost by formulas as a state; None if it has no cost by formulas.

    The terminal cost is that to first order at a trajectory.
    """
    terminal = problem.cost.formulas[1]
    if not problem.cost.has_formulas:
        return None
    n, m, modes = problem.state_dim, problem.control_dim, list[SmoothMode]()
    cost_so_far = signals(n + 1, m)[0][n]
    dynamics = piecewise_smooth(problem)
    for mode in dynamics.modes:
        f, region, domain, cost = (with_states(part, 1) for part in (mode.f, mode.region, mode.domain, mode.cost))
        modes.append(SmoothMode([*f, sum(cost, cost_so_far)], region, domain, mode.name))
    labels = dynamics.sampling_time, [*dynamics.state_names, "cost so far"], dynamics.control_names
    stripped = replace_fields(problem, cost=problem.cost.without_formulas)
    with_state = PiecewiseSmoothDynamics(modes, n + 1, m, *labels)
    zero, free = np.zeros(1), np.full(1, -np.inf)
    augmented = augment_states(stripped, with_state, Box(zero, zero), free, problem.quadratic)
    slope = np.append(augmented.quadratic.p[:n], 1.0)
    if terminal is not None:
        slope[:n] += jets_of([terminal], np.append(at.x[-1], np.zeros(m))[None]).slopes[0, 0, :n]
    cost = CostSum([replace(augmented.quadratic, p=slope), *augmented.cost.norms])
    return CostState(problem, replace_fields(augmented, cost=cost.at_dimensions(n + 1, m, problem.horizon)))
