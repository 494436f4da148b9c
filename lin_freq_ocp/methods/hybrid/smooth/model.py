"""A mode sequence of smooth maps over stages: all but the dynamics is that of the structured method, in its units.

With y_t = (x_t, w_t), the dynamics are x_{t+1} = c_t(y_t); c_t is the map of the mode at t, in deviations from an
origin and in units. The regions of the modes are path constraints. The distance from a fixed end has a weight in the
cost, too, which changes no solution. Without it, the recursion, which ignores the end, would reject a reduced Hessian
that is positive definite only because of the fixed end.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.formulas.jets import Jets, jets_of, values_of
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.methods.structured.assembly import Assembly, assemble_stages
from lin_freq_ocp.methods.structured.kkt.recursions import loops
from lin_freq_ocp.methods.structured.kkt.system import DYNAMICS, System, Values, largest
from lin_freq_ocp.methods.structured.stages import Stages
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.affine_mode import REGION
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics, SmoothMode
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.problem_data import replace_fields
from lin_freq_ocp.problem.sets.path_constraint import PathConstraint
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.units import cost_factor
from lin_freq_ocp.transform.hybrid.forms import piecewise_smooth
from lin_freq_ocp.transform.sizes import stated_sizes

END_WEIGHT = 1e6  # of the distance from a fixed end, relative to the largest curvature of the cost
LEAST_CURVATURE = 1e-3  # in units of order 1
VIOLATION = 1e-8  # violations of order-1 rows up to which a point is feasible
FAR_UNIT = 1e4  # a unit that exceeds the size of an answer by this factor costs half of the digits of its accuracy


class Derivatives(NamedTuple):
    """The map at a point: successors c (T, n), slopes (T, n, n+m), curvatures (T, n, n+m, n+m), in units of stages.

    Of path constraints, in their slots: values less limits (rows,), slopes (rows, n+m), curvatures (rows, n+m, n+m).
    """

    successors: Array
    slopes: Array
    curvatures: Array
    violations: Array
    normals: Array
    bends: Array

    @property
    def finite(self) -> bool:
        """Whether all are numbers."""
        return all(bool(np.isfinite(part).all()) for part in self)


class PathSlots(NamedTuple):
    """The values of all path constraints that are rows of the stages: where they stand, (rows,) each."""

    values: Indices  # among those of all path constraints, one after the other, flat
    times: Indices
    slots: Indices
    units: Array  # factors from units of the problem to those of the stages


@dataclass(frozen=True, eq=False)
class Pieces:
    """The smooth maps of a mode sequence: each mode in it with its times, and with its region as a path constraint.

    ``terminal`` is the terminal cost by a formula, if there is one. Where the ``selections`` of norms (T, components)
    are numbers, they are their derivatives, as for ``formulas.jets_of``.
    """

    dynamics: PiecewiseSmoothDynamics
    parts: tuple[tuple[SmoothMode, Indices], ...]
    regions: tuple[tuple[Indices, PathConstraint], ...]
    terminal: tuple[Formula, ...]
    selections: Mapping[Formula, Array] = field(default_factory=dict[Formula, Array])

    @classmethod
    def of(cls, problem: OptimalControlProblem, sequence: Indices) -> Pieces:
        """Return those of a problem and a sequence, (T,)."""
        dynamics, T = piecewise_smooth(problem), problem.horizon
        parts, regions = list[tuple[SmoothMode, Indices]](), list[tuple[Indices, PathConstraint]]()
        for i in np.unique(sequence):
            mode, times = dynamics.modes[i], np.flatnonzero(sequence == i)
            parts.append((mode, times))
            if mode.region:
                limits = np.where(sequence == i, 0.0, np.inf)[:, None] * np.ones(len(mode.region))
                region = PathConstraint(mode.region, f"{REGION} {i}", limits)
                dimensions = problem.state_dim, problem.control_dim
                regions.append((times, region.at_dimensions(*dimensions, T, "dynamics")))
        terminal = tuple(one for one in problem.cost.formulas[1:] if one is not None)
        return cls(dynamics, tuple(parts), tuple(regions), terminal)

    def with_regions(self, problem: OptimalControlProblem) -> OptimalControlProblem:
        """Return the problem with the regions as path constraints."""
        if not self.regions:
            return problem
        return replace_fields(problem, stage_rows=(*problem.stage_rows, *(one for _, one in self.regions)))

    def values(self, y: Array) -> Array:
        """Return f_t at (x_t, u_t), y (T, n + m); not numbers where a map is not defined."""
        values = np.empty((len(y), self.dynamics.state_dim))
        for mode, times in self.parts:
            inside = (values_of(mode.domain, y[times], times) > 0).all(axis=1, keepdims=True)
            values[times] = np.where(inside, values_of(mode.f, y[times], times), np.nan)
        return values

    def jets(self, y: Array) -> Jets:
        """Return f_t with derivatives at (x_t, u_t), y (T, n + m)."""
        (T, k), n = y.shape, self.dynamics.state_dim
        jets = Jets(np.empty((T, n)), np.empty((T, n, k)), np.empty((T, n, k, k)))
        for mode, times in self.parts:
            at = self._jets_of(mode.f, y, times)
            jets.values[times], jets.slopes[times], jets.curvatures[times] = at.values, at.slopes, at.curvatures
        return jets

    def cost(self, points: Array) -> float:
        """Return the cost by formulas at (x_t, u_t), t = 0 .. T, (T + 1, n + m)."""
        return sum(float(values_of(of, points[times], times).sum()) for of, times in self._costs(points))

    def cost_slopes(self, points: Array) -> tuple[Array, Array]:
        """Return its gradients and its Hessians, (T + 1, n + m) and (T + 1, n + m, n + m)."""
        gradients, hessians = np.zeros(points.shape), np.zeros((*points.shape, points.shape[1]))
        for formulas, times in self._costs(points):
            found = self._jets_of(formulas, points, times)
            gradients[times], hessians[times] = found.slopes.sum(axis=1), found.curvatures.sum(axis=1)
        return gradients, hessians

    def _costs(self, points: Array) -> Iterator[tuple[Sequence[Formula], Indices]]:
        yield from ((mode.cost, times) for mode, times in self.parts)
        yield self.terminal, np.array([len(points) - 1])

    def _jets_of(self, formulas: Sequence[Formula], y: Array, times: Indices) -> Jets:
        known = {norm: given[times] for norm, given in self.selections.items() if times[-1] < len(given)}
        return jets_of(formulas, y[times], known, times)

    def linear_at(self, trajectory: Trajectory) -> LinearDynamics:
        """Return the maps to first order along a trajectory, zero where they are not defined."""
        dynamics, y = self.dynamics, np.hstack([trajectory.x[:-1], trajectory.u])
        at, n = self.jets(y), dynamics.state_dim
        constants = at.values - np.einsum("tij,tj->ti", at.slopes, y)
        slopes, offset = (np.nan_to_num(part, posinf=0.0, neginf=0.0) for part in (at.slopes, constants))
        labels = dynamics.sampling_time, dynamics.state_names, dynamics.control_names
        return LinearDynamics(slopes[..., :n], slopes[..., n:], offset, *labels)

    def with_region(self, stage: Mapping[str, Array]) -> Mapping[str, Array]:
        """Return multipliers with those of all regions under the name REGION, (T, rows)."""
        if not self.regions:
            return stage
        most = max(one.rows for _, one in self.regions)
        found = np.zeros((sum(len(times) for _, times in self.parts), most))
        for times, one in self.regions:
            found[times, : one.rows] = stage[one.name][times]
        names = {one.name for _, one in self.regions}
        return {name: values for name, values in stage.items() if name not in names} | {REGION: found}

    def without_region(self, stage: Mapping[str, Array]) -> Mapping[str, Array]:
        """Return multipliers with those under the name REGION as those of each region."""
        found = {name: values for name, values in stage.items() if name != REGION}
        for times, one in self.regions if REGION in stage else ():
            found[one.name] = np.zeros(one.map.shape)
            found[one.name][times] = stage[REGION][times, : one.rows]
        return found


@dataclass(frozen=True, eq=False)
class SmoothModel:
    """The stages of a mode sequence of a problem, linearised at some trajectory, and the maps themselves.

    The ``problem`` has the regions of the modes as path constraints, each without limits where another mode is.
    """

    problem: OptimalControlProblem
    pieces: Pieces
    assembly: Assembly
    plain: Assembly | None = None  # without the weight of the end
    outside: float = 0.0  # the largest violation of path constraints by the fixed ends, whatever the trajectory is

    @classmethod
    def at(cls, given: OptimalControlProblem, trajectory: Trajectory, sequence: Indices | None = None) -> SmoothModel:
        """Return the model of a mode sequence, by default of the first mode alone, linearised at a trajectory.

        Its units follow from the problem's own data.
        """
        alone = np.zeros(given.horizon, dtype=np.intp)
        sizes, pieces = stated_sizes(given), Pieces.of(given, alone if sequence is None else sequence)
        problem = pieces.with_regions(given)
        linear = replace_fields(
            problem,
            dynamics=pieces.linear_at(trajectory),
            cost=problem.cost.without_formulas.at_dimensions(given.state_dim, given.control_dim, given.horizon),
            stage_rows=tuple(rows.pattern(trajectory.x, trajectory.u, sizes) for rows in problem.stage_rows),
        )
        slacks = [np.zeros(1)] * len(linear.terms) if problem.path_constraints else None  # whose values are not affine
        model = cls(problem, pieces, assemble_stages(linear, sizes, slacks))
        if problem.path_constraints:
            model = model.without_constants()
        return model.with_end_weighted(trajectory)

    def with_end_weighted(self, trajectory: Trajectory) -> SmoothModel:
        """Return the model with stages in units whose cost is as steep as usual at a trajectory."""
        plain = self.assembly
        assembly = self.with_unit_of_cost(trajectory) if self.problem.cost.has_formulas else plain
        stages = assembly.stages
        H, h, terminal, end = stages.H.copy(), stages.h.copy(), stages.coupling.terminal, stages.coupling.terminal_state
        largest = float(np.abs(np.einsum("tii->ti", H[:-1])).max(initial=0.0))
        weight = END_WEIGHT * max(LEAST_CURVATURE, largest)  # of the distance of x_T from its fixed components
        H[-1, terminal, terminal] += weight
        h[-1, terminal] -= weight * end
        constant = stages.constant + 0.5 * weight * float(end @ end)
        return replace(
            self, assembly=replace(assembly, stages=replace(stages, H=H, h=h, constant=constant)), plain=plain
        )

    def revised(self, y: Array, far: float) -> SmoothModel | None:
        """Return the model in units of the size of a solution y.

        None if the present units are similar, or none of them exceeds its new one by the factor ``far``.
        """
        plain = None if self.plain is None else self.plain.revised(y)
        if self.plain is None or plain is None or (self.plain.units.columns <= far * plain.units.columns).all():
            return None
        return replace(self, assembly=plain).with_end_weighted(self.trajectory(y))

    @property
    def stages(self) -> Stages:
        """Return the stages; A, B and d are linearised at the first trajectory."""
        return self.assembly.stages

    def trajectory(self, y: Array) -> Trajectory:
        """Return the trajectory of a point."""
        return self.assembly.trajectory(y)

    def multipliers(self, y: Array, z: Values) -> Multipliers:
        """Return the multipliers of duals at a point."""
        assembly, trajectory = self.assembly, self.trajectory(y)
        dynamics, rows = self.pieces.linear_at(trajectory), self.problem.rows_along(trajectory)
        linear = replace_fields(assembly.problem, dynamics=dynamics, stage_rows=rows)
        program = LinearProgram(linear, assembly.program.origin)
        multipliers = replace(assembly, program=program).multipliers(z, 1.0, y)
        return replace(multipliers, stage=self.pieces.with_region(multipliers.stage))

    @cached_property
    def path(self) -> PathSlots:
        """The rows of path constraints in the stages."""
        assembly, n = self.assembly, self.problem.state_dim
        layout, shape, constraints = assembly.program.layout, self.stages.g.shape, self.problem.path_constraints
        first = dict(zip((name for name, _ in layout.names), layout.terms, strict=True))
        sizes = [one.map.shape[0] * one.rows for one in constraints]
        targets = [first[one.name] + np.arange(size) for one, size in zip(constraints, sizes, strict=True)]
        slot_of = np.full(layout.count + 1, -1)
        slot_of[assembly.targets[n : n + shape[0] * shape[1]]] = np.arange(shape[0] * shape[1])
        slots = slot_of[np.concatenate([np.arange(0), *targets])]
        values = np.flatnonzero(slots >= 0)
        values = values[np.isfinite(self.stages.g.ravel()[slots[values]])]
        times, slots = np.divmod(slots[values], max(shape[1], 1))
        return PathSlots(values, times, slots, assembly.units.rows[n:][times * shape[1] + slots])

    def violation(self, y: Array) -> float:
        """Return the largest violation of the dynamics, of the fixed ends and of all rows at a point."""
        system = System(self.stages_at(y), loops())
        residuals = [values - right for values, right in zip(system.rows(y), system.b, strict=True)]
        for i, cone in system.cones.items():
            residuals[i] = np.array([max(0.0, -cone.margin(-residuals[i] * cone.present))])
        return largest([*residuals[:DYNAMICS], self.defects(y), *residuals[DYNAMICS + 1 :]])

    def path_values(self, y: Array) -> Array:
        """Return the values less limits, and less the slacks of soft ones, of path constraints at a point, (rows,)."""
        if not len(self.path.values):
            return np.zeros(0)
        constraints, points = self.problem.path_constraints, self._points(y)
        return self._violations(
            y, [values_of(one.formulas, points[one.map.times], one.map.times) for one in constraints]
        )

    def _violations(self, y: Array, values: Sequence[Array]) -> Array:
        """Return ``path_values`` from the values of each path constraint."""
        rows, first = self.path, self._units.shape[1]
        pairs = zip(values, self.problem.path_constraints, strict=True)
        violations = np.concatenate([(value - one.limits()).ravel() for value, one in pairs])
        less = np.einsum("ri,ri->r", self.stages.G[rows.times, rows.slots, first:], y[rows.times, first:])
        return violations[rows.values] * rows.units + less

    def stages_at(self, y: Array) -> Stages:
        """Return the stages with the path constraints linearised at a point; without any, those of the model."""
        return self.linearised(y, self.derivatives(y)) if len(self.path.values) else self.stages

    def defects(self, y: Array) -> Array:
        """Return x_{t+1} - c_t at a point, (T, n); not a number where the map is not defined."""
        return y[1:, : self.problem.state_dim] - self._deviations(self.pieces.values(self._signals(y)))

    def derivatives(self, y: Array) -> Derivatives:
        """Return c with its derivatives at a point; those with respect to fixed controls are zero."""
        map_jets = self.pieces.jets(self._signals(y))
        units = self._units[:-1].copy()
        units[:, self.problem.state_dim :][self.assembly.fixed] = 0.0
        after = self._units[1:, : self.problem.state_dim]
        slopes = map_jets.slopes * units[:, None, :] / after[:, :, None]
        curvatures = map_jets.curvatures * (units[:, :, None] * units[:, None, :])[:, None] / after[:, :, None, None]
        return Derivatives(self._deviations(map_jets.values), slopes, curvatures, *self._path_derivatives(y, units))

    def _path_derivatives(self, y: Array, units: Array) -> tuple[Array, Array, Array]:
        """Return values less limits of path constraints, slopes and curvatures by signals with units (T, n + m)."""
        rows, width = self.path, units.shape[1]
        if not len(rows.values):
            return np.zeros(0), np.zeros((0, width)), np.zeros((0, width, width))
        constraints, points = self.problem.path_constraints, self._points(y)
        jets = [jets_of(one.formulas, points[one.map.times], times=one.map.times) for one in constraints]
        normals = np.concatenate([at.slopes.reshape(-1, width) for at in jets])[rows.values]
        bends = np.concatenate([at.curvatures.reshape(-1, width, width) for at in jets])[rows.values]
        columns = np.vstack([units, self._units[-1:]])[rows.times]
        return (
            self._violations(y, [at.values for at in jets]),
            normals * columns * rows.units[:, None],
            bends * columns[:, :, None] * columns[:, None] * rows.units[:, None, None],
        )

    def without_constants(self) -> SmoothModel:
        """Return the model without the rows of path constraints that depend on fixed ends alone."""
        stages, n, limits = self.stages, self.problem.state_dim, self.stages.g.copy()
        fixed, y = np.zeros((2, stages.G.shape[2]), dtype=bool), np.zeros(stages.h.shape)
        fixed[0, :n], fixed[1, stages.coupling.terminal] = stages.fixed, True
        y[0, :n], y[-1, stages.coupling.terminal] = np.nan_to_num(stages.initial), stages.coupling.terminal_state
        outside, violations = 0.0, self.path_values(y)
        for t, k, violation in zip(self.path.times, self.path.slots, violations, strict=True):
            if t in (0, self.problem.horizon) and not stages.G[t, k, ~fixed[int(t > 0)]].any():
                limits[t, k], outside = np.inf, max(outside, float(violation))
        return replace(self, assembly=replace(self.assembly, stages=replace(stages, g=limits)), outside=outside)

    def with_unit_of_cost(self, trajectory: Trajectory) -> Assembly:
        """Return the stages in the unit of cost in which the cost with its formulas is as steep as usual there."""
        assembly, y = self.assembly, self.assembly.point(trajectory)
        H, h = self.expanded_cost(y)
        slopes = np.abs(np.einsum("tij,tj->ti", H, y) + h) + np.abs(H).sum(axis=2)
        factor = cost_factor(np.nan_to_num(slopes), assembly.priced, np.median)
        stages, units = assembly.stages, assembly.units
        scaled = {name: factor * getattr(stages, name) for name in ("H", "h", "constant")}
        return replace(assembly, stages=replace(stages, **scaled), units=replace(units, cost=factor * units.cost))

    def cost(self, y: Array) -> float:
        """Return the cost at a point, in units of stages; not a number where a formula is not defined."""
        stages, units = self.stages, self.assembly.units
        quadratic = 0.5 * float(np.einsum("ti,tij,tj->", y, stages.H, y)) + float(np.vdot(stages.h, y))
        return quadratic + stages.constant + units.cost * self.pieces.cost(self._points(y))

    def expanded_cost(self, y: Array) -> tuple[Array, Array]:
        """Return H and h of 1/2 y'H y + h'y + ..., the cost with its formulas to second order at a point."""
        stages, (n, m) = self.stages, (self.problem.state_dim, self.problem.control_dim)
        gradients, hessians = self.pieces.cost_slopes(self._points(y))
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
        if not len(self.path.values):
            return replace(stages, A=A, B=B, d=d, H=stages.H.copy())
        at, G, g = (self.path.times, self.path.slots), stages.G.copy(), stages.g.copy()
        G[(*at, slice(0, count))] = derivatives.normals
        g[at] = np.einsum("ri,ri->r", G[at], y[at[0]]) - derivatives.violations
        return replace(stages, A=A, B=B, d=d, H=stages.H.copy(), G=G, g=g)

    @property
    def _units(self) -> Array:
        return self.assembly.units.columns[:, : self.problem.state_dim + self.problem.control_dim]

    def _signals(self, y: Array) -> Array:
        origin, units = self.assembly.program.origin, self._units[:-1]
        return np.hstack([origin.x[:-1], origin.u]) + y[:-1, : units.shape[1]] * units

    def _points(self, y: Array) -> Array:
        """Return (x_t, u_t) in units of the problem for t = 0 .. T, (T + 1, n + m), with zeros for u_T."""
        n = self.problem.state_dim
        end = self.assembly.program.origin.x[-1] + y[-1, :n] * self._units[-1, :n]
        return np.vstack([self._signals(y), np.append(end, np.zeros(self.problem.control_dim))])

    def _deviations(self, values: Array) -> Array:
        return (values - self.assembly.program.origin.x[1:]) / self._units[1:, : self.problem.state_dim]
