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
from lin_freq_ocp.methods.structured.assembly import Assembly, stages_of
from lin_freq_ocp.methods.structured.kkt.system import Values
from lin_freq_ocp.methods.structured.stages import Stages
from lin_freq_ocp.problem.hybrid.forms import piecewise_smooth
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sizes import stated_sizes
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.linear_program import LinearProgram

END_WEIGHT = 1e6  # of the distance from a fixed end, relative to the largest curvature of the cost
LEAST_CURVATURE = 1e-3  # in units of order 1


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
    def at(cls, problem: OptimalControlProblem, trajectory: Trajectory) -> SmoothModel:
        """Return the model linearised at a trajectory, with units that follow from the problem's own data."""
        assembly = stages_of(replace(problem, dynamics=problem.dynamics_along(trajectory)), stated_sizes(problem))
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
