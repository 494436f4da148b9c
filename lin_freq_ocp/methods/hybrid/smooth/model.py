"""A problem with one smooth map over stages: all but the dynamics is that of the structured method, in its units.

With y_t = (x_t, w_t), the dynamics are x_{t+1} = c_t(y_t); c_t is the map f in deviations from an origin and in units.
The distance from a fixed end has a weight in the cost, too, which changes no solution. Without it, the recursion, which
ignores the end, would reject a reduced Hessian that is positive definite only because of the fixed end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.formulas.jets import jets, values_of
from lin_freq_ocp.methods.structured.assembly import Assembly, assemble_stages
from lin_freq_ocp.methods.structured.kkt.system import Values
from lin_freq_ocp.methods.structured.stages import Stages
from lin_freq_ocp.problem.hybrid.forms import piecewise_smooth
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sizes import stated_sizes
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.units import cost_factor

END_WEIGHT = 1e6  # of the distance from a fixed end, relative to the largest curvature of the cost
LEAST_CURVATURE = 1e-3  # in units of order 1
FAR_UNIT = 1e4  # a unit that exceeds the size of an answer by this factor costs half of the digits of its accuracy


class Derivatives(NamedTuple):
    """The map at a point: successors c (T, n), slopes (T, n, n+m), curvatures (T, n, n+m, n+m), in units of stages."""

    successors: Array
    slopes: Array
    curvatures: Array

    @property
    def finite(self) -> bool:
        """Whether all are numbers."""
        return all(bool(np.isfinite(part).all()) for part in self)


@dataclass(frozen=True, eq=False)
class SmoothModel:
    """The stages of a problem with one smooth map, linearised at some trajectory, and the map itself."""

    problem: OptimalControlProblem
    assembly: Assembly

    @classmethod
    def at(
        cls, problem: OptimalControlProblem, trajectory: Trajectory, sizes: tuple[Array, Array] | None = None
    ) -> SmoothModel:
        """Return the model linearised at a trajectory, in units of ``sizes``, by default those that the data state."""
        linear = replace(problem, dynamics=problem.dynamics_along(trajectory), cost=problem.cost.without_formulas)
        assembly = assemble_stages(linear, sizes or stated_sizes(problem))
        if problem.cost.has_formulas:
            assembly = cls(problem, assembly).with_unit_of_cost(trajectory)
        stages = assembly.stages
        H, h, terminal, end = stages.H.copy(), stages.h.copy(), stages.coupling.terminal, stages.coupling.terminal_state
        largest = float(np.abs(np.einsum("tii->ti", H[:-1])).max(initial=0.0))
        weight = END_WEIGHT * max(LEAST_CURVATURE, largest)  # of the distance of x_T from its fixed components
        H[-1, terminal, terminal] += weight
        h[-1, terminal] -= weight * end
        constant = stages.constant + 0.5 * weight * float(end @ end)
        return cls(problem, replace(assembly, stages=replace(stages, H=H, h=h, constant=constant)))

    @property
    def stages(self) -> Stages:
        """Return the stages; A, B and d are linearised at the first trajectory."""
        return self.assembly.stages

    def trajectory(self, y: Array) -> Trajectory:
        """Return the trajectory of a point."""
        return self.assembly.trajectory(y)

    def multipliers(self, y: Array, z: Values) -> Multipliers:
        """Return the multipliers of duals at a point."""
        assembly, dynamics = self.assembly, self.problem.dynamics_along(self.trajectory(y))
        program = LinearProgram(replace(assembly.problem, dynamics=dynamics), assembly.program.origin)
        return replace(assembly, program=program).multipliers(z, 1.0, y)

    def in_smaller_units(self, y: Array) -> SmoothModel | None:
        """Return the model in units of the size of a solution y; None if the present units are not far larger."""
        revised, n = self.assembly.revised(y), self.problem.state_dim
        if revised is None or (self.assembly.units.columns <= FAR_UNIT * revised.units.columns).all():
            return None
        sizes = revised.units.columns[:, : n + self.problem.control_dim]
        return self.at(self.problem, self.trajectory(y), (sizes[:, :n].max(axis=0), sizes[:-1, n:].max(axis=0)))

    def defects(self, y: Array) -> Array:
        """Return x_{t+1} - c_t at a point, (T, n); not a number where the map is not defined."""
        mode, signals = piecewise_smooth(self.problem).modes[0], self._signals(y)
        values = values_of(mode.f, signals)
        values[~(values_of(mode.domain, signals) > 0).all(axis=1)] = np.nan
        return y[1:, : self.problem.state_dim] - self._deviations(values)

    def derivatives(self, y: Array) -> Derivatives:
        """Return c with its derivatives at a point; those with respect to fixed controls are zero."""
        map_jets = jets(piecewise_smooth(self.problem).modes[0].f, self._signals(y))
        units = self._units[:-1].copy()
        units[:, self.problem.state_dim :][self.assembly.fixed] = 0.0
        after = self._units[1:, : self.problem.state_dim]
        slopes = map_jets.slopes * units[:, None, :] / after[:, :, None]
        curvatures = map_jets.curvatures * (units[:, :, None] * units[:, None, :])[:, None] / after[:, :, None, None]
        return Derivatives(self._deviations(map_jets.values), slopes, curvatures)

    def with_unit_of_cost(self, trajectory: Trajectory) -> Assembly:
        """Return the stages in the unit of cost in which the cost with its formulas is as steep as usual there."""
        assembly, y = self.assembly, self.assembly.point(trajectory)
        H, h = self.expanded_cost(y)
        slopes = np.abs(np.einsum("tij,tj->ti", H, y) + h) + np.abs(H).sum(axis=2)
        factor = cost_factor(np.nan_to_num(slopes), assembly.priced)
        stages, units = assembly.stages, assembly.units
        scaled = {name: factor * getattr(stages, name) for name in ("H", "h", "constant")}
        return replace(assembly, stages=replace(stages, **scaled), units=replace(units, cost=factor * units.cost))

    def cost(self, y: Array) -> float:
        """Return the cost at a point, in units of stages; not a number where a formula is not defined."""
        stages, origin, n = self.stages, self.assembly.program.origin, self.problem.state_dim
        units = self.assembly.units
        quadratic = 0.5 * float(np.einsum("ti,tij,tj->", y, stages.H, y)) + float(np.vdot(stages.h, y))
        x, u = origin.x + y[:, :n] * units.columns[:, :n], self._signals(y)[:, n:]
        return quadratic + stages.constant + units.cost * float(self.problem.cost.formula_values(x, u).sum())

    def expanded_cost(self, y: Array) -> tuple[Array, Array]:
        """Return H and h of 1/2 y'H y + h'y + ..., the cost with its formulas to second order at a point."""
        stages, origin = self.stages, self.assembly.program.origin
        n, m = self.problem.state_dim, self.problem.control_dim
        gradients, hessians = np.zeros((len(y), n + m)), np.zeros((len(y), n + m, n + m))
        end = np.append(origin.x[-1] + y[-1, :n] * self.assembly.units.columns[-1, :n], np.zeros(m))[None]
        terminal = [one for one in self.problem.cost.formulas[1:] if one is not None]
        mode = piecewise_smooth(self.problem).modes[0]
        for formulas, signals, times in ((mode.cost, self._signals(y), slice(-1)), (terminal, end, slice(-1, None))):
            found = jets(formulas, signals)
            gradients[times], hessians[times] = found.slopes.sum(axis=1), found.curvatures.sum(axis=1)
        units, cost = self._units.copy(), self.assembly.units.cost
        units[:-1, n:][self.assembly.fixed] = 0.0
        H, h = stages.H.copy(), stages.h.copy()
        curvature = cost * hessians * units[:, :, None] * units[:, None, :]
        H[:, : n + m, : n + m] += curvature
        h[:, : n + m] += cost * gradients * units - np.einsum("tij,tj->ti", curvature, y[:, : n + m])
        return H, h

    def linearised(self, y: Array, derivatives: Derivatives) -> Stages:
        """Return the stages linearised at a point, with a copy of the Hessian of the cost."""
        stages, n, count = self.stages, self.problem.state_dim, derivatives.slopes.shape[2]
        A, B, d = np.zeros_like(stages.A), np.zeros_like(stages.B), np.zeros_like(stages.d)
        A[:-1], B[:-1, :, : count - n] = derivatives.slopes[:, :, :n], derivatives.slopes[:, :, n:]
        d[:-1] = derivatives.successors - np.einsum("tij,tj->ti", derivatives.slopes, y[:-1, :count])
        return replace(stages, A=A, B=B, d=d, H=stages.H.copy())

    @property
    def _units(self) -> Array:
        return self.assembly.units.columns[:, : self.problem.state_dim + self.problem.control_dim]

    def _signals(self, y: Array) -> Array:
        origin, units = self.assembly.program.origin, self._units[:-1]
        return np.hstack([origin.x[:-1], origin.u]) + y[:-1, : units.shape[1]] * units

    def _deviations(self, values: Array) -> Array:
        return (values - self.assembly.program.origin.x[1:]) / self._units[1:, : self.problem.state_dim]
