"""Dynamics whose modes have a cost by formulas, and the same problem with this cost as a state.

With z_{t+1} = z_t + c_t(x_t, u_t), z_0 = 0, the cost sum c_t(x_t, u_t) is z_T, and its multiplier is -eta_C at all
times: <(eta, -eta_C), (f, z + c)> is <eta, f> - eta_C c up to z. The maximum principle of the problem with z is that of
the problem itself, with kinks of cost and dynamics in one subdifferential.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, assign, brief, with_columns
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.formulas.jets import jets
from lin_freq_ocp.formulas.nodes import Formula, signals, translate_formulas, with_states
from lin_freq_ocp.problem.costs.formula_cost import PRICED
from lin_freq_ocp.problem.costs.quadratic import CostSum
from lin_freq_ocp.problem.dynamics.base import Dynamics, entry_for, require_form, signal_labels, unique_names
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.formula_modes import formula_pieces
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics, SmoothMode, affine_formulas
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.problem_data import replace_fields
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.hybrid.forms import piecewise_smooth
from lin_freq_ocp.transform.reformulations import OwnStates, augment_states


@dataclass(frozen=True, eq=False, init=False)
class DynamicsWithFormulaCost(Dynamics, words="dynamics with a cost or path constraints by formulas"):
    """Dynamics with the stage cost of a problem by formulas, whose kinks are modes.

    ``form`` are the dynamics as smooth modes, ``stage`` is the cost, None where a terminal cost or path constraints are
    all that has formulas.
    """

    dynamics: Dynamics
    form: PiecewiseSmoothDynamics
    stage: Formula | None

    def __init__(self, dynamics: Dynamics, form: PiecewiseSmoothDynamics, stage: Formula | None):
        n, m = dynamics.state_dim, dynamics.control_dim
        labels = signal_labels(n, m, dynamics.sampling_time, dynamics.state_names, dynamics.control_names)
        assign(self, dynamics=dynamics, form=form, stage=stage, **labels)

    @property
    def standard_form(self) -> PiecewiseSmoothDynamics:
        """Return the modes, each with its formula of the cost."""
        return self._modes

    @cached_property
    def _modes(self) -> PiecewiseSmoothDynamics:
        if self.stage is None:
            return self.form
        modes, cost = self.form.modes, [self.stage]
        pieces = [(mode, piece) for mode in modes for piece in formula_pieces(cost, region=mode.region)]
        names = unique_names([", ".join(filter(None, (mode.name, piece.name))) for mode, piece in pieces])
        priced = [
            SmoothMode(mode.f, piece.region, mode.domain, name, piece.formulas)
            for (mode, piece), name in zip(pieces, names, strict=True)
        ]
        return replace(self.form, modes=priced)

    @property
    def without_cost(self) -> Dynamics:
        """Return the dynamics as stated."""
        return self.dynamics

    @property
    def given(self) -> tuple[Dynamics, None]:
        """Return the dynamics as stated."""
        return self.dynamics, None

    def facts(self, labels: Sequence[str]) -> list[tuple[str, str]]:
        """Return the dynamics as stated in words; the description of the cost is that of the problem."""
        return self.dynamics.facts(labels)

    def translated(self, origin: Array) -> Dynamics | None:
        """Return the dynamics of x - origin, origin (n,), with the cost of these states."""
        moved = self.dynamics.translated(origin)
        stage = self.stage if self.stage is None else translate_formulas([self.stage], origin)[0]
        return None if moved is None else entry_for(PRICED, moved)(moved, stage)

    def augmented(self, A: Array, B: Array, names: Sequence[str], horizon: int) -> Dynamics:
        """Return the dynamics of (x, w) with w_{t+1} = A w_t + B u_t; their problem has the cost of x."""
        return self.dynamics.augmented(A, B, names, horizon)


def price_smooth(dynamics: Dynamics, stage: Formula | None) -> DynamicsWithFormulaCost:
    """Return piecewise-smooth dynamics with a stage cost."""
    return DynamicsWithFormulaCost(dynamics, require_form(dynamics, PiecewiseSmoothDynamics), stage)


def price_linear(dynamics: Dynamics, stage: Formula | None) -> DynamicsWithFormulaCost:
    """Return linear dynamics with a stage cost, as one smooth mode."""
    linear = require_form(dynamics, LinearDynamics)
    times = max(linear.A.shape[:-2], linear.B.shape[:-2])
    rows = np.concatenate([np.broadcast_to(M, (*times, *M.shape[-2:])) for M in (linear.A, linear.B)], axis=-1)
    f = affine_formulas(rows, linear.offset, (linear.state_dim, linear.control_dim))
    labels = linear.sampling_time, linear.state_names, linear.control_names
    form = PiecewiseSmoothDynamics([SmoothMode(f)], linear.state_dim, linear.control_dim, *labels)
    return DynamicsWithFormulaCost(dynamics, form, stage)


@dataclass(frozen=True, eq=False)
class CostState(OwnStates):
    """The way back from the problem in the states (x, z), where z is the cost by formulas so far."""

    def with_cost(self, trajectory: Trajectory) -> Trajectory:
        """Return a trajectory of the given problem with its costs."""
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


def cost_as_state(problem: OptimalControlProblem, at: Trajectory | None = None) -> CostState | None:
    """Return the problem with its stage cost by formulas as a state; None if it has no cost by formulas.

    The terminal cost is that to first order at a trajectory. UnsupportedError if there is one, but no trajectory.
    """
    terminal = problem.cost.formulas[1]
    if not problem.cost.has_formulas:
        return None
    if terminal is not None and at is None:
        raise UnsupportedError(
            "cost: got a terminal cost by a formula and kinks; expected a QuadraticCost or L1Cost for the last state."
        )
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
    if terminal is not None and at is not None:
        slope[:n] += jets([terminal], np.append(at.x[-1], np.zeros(m))[None]).slopes[0, 0, :n]
    cost = CostSum([replace(augmented.quadratic, p=slope), *augmented.cost.norms])
    return CostState(problem, replace_fields(augmented, cost=cost.at_dimensions(n + 1, m, problem.horizon)))
