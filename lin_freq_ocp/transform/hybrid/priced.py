"""The forms of dynamics with levels and with a cost by formulas, and the problem with this cost as a state.

With z_{t+1} = z_t + c_t(x_t, u_t), z_0 = 0, the cost sum c_t(x_t, u_t) is z_T, and its multiplier is -eta_C at all
times: <(eta, -eta_C), (f, z + c)> is <eta, f> - eta_C c up to z. The maximum principle of the problem with z is that of
the problem itself, with kinks of cost and dynamics in one subdifferential.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import brief, with_columns
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.formulas.jets import jets_of
from lin_freq_ocp.formulas.nodes import Formula, signals, with_states
from lin_freq_ocp.problem.costs.quadratic import CostSum
from lin_freq_ocp.problem.dynamics.base import Dynamics, require_form, unique_names
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.formula_modes import formula_pieces
from lin_freq_ocp.problem.hybrid.levels import SwitchedDynamics
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics, SmoothMode, affine_formulas
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.problem_data import replace_fields
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.hybrid.forms import piecewise_smooth
from lin_freq_ocp.transform.reformulations import OwnStates, augment_states


class ModesWithCost(PiecewiseSmoothDynamics, words="dynamics with a cost or path constraints by formulas"):
    """The form of dynamics with a cost by formulas: smooth modes, each with its formula of the cost."""


def form_of_linear(dynamics: Dynamics, levels: ConvexSet | None, stage: Formula | None) -> Dynamics:
    """Return linear dynamics with a mode for each of the levels, or else as one smooth mode with a stage cost."""
    linear = require_form(dynamics, LinearDynamics)
    if levels is not None:
        return SwitchedDynamics(linear, levels)
    times = max(linear.A.shape[:-2], linear.B.shape[:-2])
    rows = np.concatenate([np.broadcast_to(M, (*times, *M.shape[-2:])) for M in (linear.A, linear.B)], axis=-1)
    f = affine_formulas(rows, linear.offset, (linear.state_dim, linear.control_dim))
    return _with_cost(linear, [SmoothMode(f)], stage)


def form_of_smooth(dynamics: Dynamics, levels: ConvexSet | None, stage: Formula | None) -> Dynamics:
    """Return piecewise-smooth dynamics with a stage cost; levels are refused."""
    if levels is not None:
        return form_of_others(dynamics, levels, stage)
    return _with_cost(dynamics, require_form(dynamics, PiecewiseSmoothDynamics).modes, stage)


def form_of_others(dynamics: Dynamics, levels: ConvexSet | None, stage: Formula | None) -> Dynamics:
    """Refuse levels, and a cost or path constraints by formulas."""
    if levels is not None:
        advice = "Write the levels into the regions of the modes, or take duty_cycles=True."
        raise ProblemError("control_set", f"levels with {dynamics.words}", "LinearDynamics", advice)
    expected = "one of LinearDynamics, PiecewiseSmoothDynamics"
    raise UnsupportedError(f"dynamics: got {dynamics.words}; expected {expected}.")


def _with_cost(dynamics: Dynamics, modes: Sequence[SmoothMode], stage: Formula | None) -> ModesWithCost:
    """Return the modes with a stage cost, a mode for each piece of it."""
    if stage is not None:
        pieces = [(mode, piece) for mode in modes for piece in formula_pieces([stage], region=mode.region)]
        names = unique_names([", ".join(filter(None, (mode.name, piece.name))) for mode, piece in pieces])
        modes = [
            SmoothMode(mode.f, piece.region, mode.domain, name, piece.formulas)
            for (mode, piece), name in zip(pieces, names, strict=True)
        ]
    labels = dynamics.sampling_time, dynamics.state_names, dynamics.control_names
    return ModesWithCost(modes, dynamics.state_dim, dynamics.control_dim, *labels)


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
        eta, mu, rho_x = multipliers.eta, with_columns(multipliers.mu, 1), np.pad(multipliers.rho_x, ((0, 0), (0, 1)))
        mu[0, -1] = -multipliers.eta_C
        price = np.full((len(eta), 1), -multipliers.eta_C)
        stage = dict(multipliers.stage)
        for name, own in self.own_values.items():
            if name in stage:
                stage[name] = np.zeros((len(stage[name]), len(own)))
                stage[name][:, own] = multipliers.stage[name]
        return replace(multipliers, eta=np.hstack([eta, price]), mu=mu, rho_x=rho_x, stage=stage)


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
