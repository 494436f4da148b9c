"""A primal-dual barrier method for smooth dynamics.

    minimise J(y) - mu log det s   subject to   x_{t+1} = c_t(y_t),   other rows of y:  A y + s = b,  s in the cone

Newton's method on the conditions of this problem, with the scalings of Nesterov and Todd for z o s = mu e, while mu
falls to zero: each step is one system of the structured method. Its Hessian is that of the Lagrangian where the reduced
problem is convex with it, else that of the cost: then multipliers stay those of a convex problem. Steps are shortened
until a filter takes them (Waechter and Biegler, 2006: pairs of infeasibility theta and objective phi), and corrected
where the curvature of the dynamics is what it rejects. Where even short steps fail, the infeasibility alone is reduced
first, by steps to the nearest point of the linearised constraints.

The file has, in this order: the filter, the barrier problem at a point, the iteration, and the local optimum of a
problem from a trajectory that need not be feasible.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.cones import Cone
from lin_freq_ocp.methods.hybrid.smooth.model import Derivatives, SmoothModel
from lin_freq_ocp.methods.hybrid.smooth.sequential import LocalOptimum
from lin_freq_ocp.methods.structured.choice import choose_kkt_solver
from lin_freq_ocp.methods.structured.embedding import EmbeddedPoint, End
from lin_freq_ocp.methods.structured.kkt.null_space import NullSpaceSolver, sort_rows
from lin_freq_ocp.methods.structured.kkt.range_space import range_space_solver
from lin_freq_ocp.methods.structured.kkt.recursions import Loops, loops
from lin_freq_ocp.methods.structured.kkt.reduced import DenseReduced
from lin_freq_ocp.methods.structured.kkt.system import DYNAMICS, STAGES, KKTSolver, StepSystem, System, Values, largest
from lin_freq_ocp.methods.structured.stages import Stages
from lin_freq_ocp.problem.hybrid.forms import piecewise_smooth
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory

IMPROVED = 1e-5  # share of the infeasibility by which either is to fall
ARMIJO = 1e-4  # share of the predicted decrease of the objective
FEASIBLE, FAR = 1e-4, 1e4  # infeasibilities, relative to the first, of steps for the objective, and never exceeded
SLOPE_POWER, INFEASIBILITY_POWER = 2.3, 1.1  # of the switching condition
ROUNDING = 1e-13  # of the objective


@dataclass(frozen=True)
class Measure:
    """Infeasibility and objective of a point."""

    theta: float
    phi: float


@dataclass(eq=False)
class Filter:
    """What trial points are compared with; ``first`` is the infeasibility of the first point."""

    first: float
    entries: list[Measure] = field(default_factory=list[Measure])

    def accepts(self, trial: Measure) -> bool:
        """Whether a point improves on every point of the filter."""
        near = trial.theta <= FAR * max(1.0, self.first) and bool(np.isfinite(trial.phi))
        return near and all(trial.theta < one.theta or trial.phi < one.phi for one in self.entries)

    def takes(self, here: Measure, trial: Measure, slope: float, length: float) -> bool:
        """Whether a step of a length leads to an acceptable point; then the filter knows where it began.

        ``slope`` is the predicted change of the objective by a full step.
        """
        rounding = ROUNDING * abs(here.phi)
        if not self.accepts(Measure(trial.theta, trial.phi - rounding)):
            return False
        feasible = here.theta <= FEASIBLE * max(1.0, self.first)
        # the switching condition: the predicted decrease of the objective outweighs the infeasibility
        if feasible and slope < 0 and length * (-slope) ** SLOPE_POWER > here.theta**INFEASIBILITY_POWER:
            return trial.phi <= here.phi + ARMIJO * length * slope + rounding
        less = trial.theta <= (1 - IMPROVED) * here.theta
        if not less and trial.phi > here.phi - IMPROVED * here.theta + rounding:
            return False
        self.add(here)
        return True

    def add(self, here: Measure) -> None:
        """Exclude what does not improve on a point."""
        self.entries.append(Measure((1 - IMPROVED) * here.theta, here.phi - IMPROVED * here.theta))


MARGIN = 1e-2  # distance of the first point to the boundary, in units in which limits are of order 1


NEAR = 0.1  # infeasibility, in units of order 1, from which it is worth a second side to know that a step is convex
FRACTION = 0.99  # of the way to the boundary, at least


class Trial(NamedTuple):
    """A point along a step."""

    y: Array
    s: dict[int, Array]
    measure: Measure
    defects: Array


@dataclass(frozen=True, eq=False)
class Objective:
    """1/2 y'H y + h'y + constant, and whether the curvature of the dynamics counts."""

    H: Array
    h: Array
    constant: float
    curved: bool


class Local:
    """A barrier problem near a point."""

    def __init__(
        self, model: SmoothModel, objective: Objective, loops: Loops, point: EmbeddedPoint, found: Derivatives
    ):
        self._model, self._objective, self._loops, self.point, self._found = model, objective, loops, point, found
        self.system = System(model.linearised(point.y, found), loops)
        rows = zip(self.system.rows(point.y), self.system.b, strict=True)
        self.left: Values = [values - right for values, right in rows]
        for i, s in point.s.items():
            self.left[i] = (self.left[i] + s) * self.cones[i].present
        self._gradient = loops.times(objective.H, point.y) + objective.h
        self._dual = self._gradient + self.system.adjoint(point.z)
        self.theta = sum(float(np.abs(part).sum()) for part in self.left)

    @property
    def cones(self) -> dict[int, Cone]:
        """Return the cones by the index of their rows."""
        return self.system.cones

    def error(self, mu: float) -> float:
        """Return the largest relative residual of the barrier problem."""
        point, dual = self.point, largest([self._dual]) / (1 + largest([self._gradient]))
        products = [cone.product(point.s[i], point.z[i]) - mu * cone.identity for i, cone in self.cones.items()]
        return max(dual, largest(self.left), largest(products))

    def phi(self, y: Array, s: dict[int, Array], mu: float) -> float:
        """Return the objective with the barrier."""
        objective = self._objective
        cost = 0.5 * float(np.vdot(y, self._loops.times(objective.H, y))) + float(np.vdot(objective.h, y))
        return cost + objective.constant - mu * sum(cone.log_determinant(s[i]) for i, cone in self.cones.items())

    def measure(self, mu: float) -> Measure:
        """Return the infeasibility and the objective here."""
        return Measure(self.theta, self.phi(self.point.y, self.point.s, mu))

    def factor(self, mu: float, sides: Sequence[KKTSolver]) -> None:
        """Factor the system of a step, with the curvature of the dynamics if the problem stays convex.

        Convexity is that on the dynamics or, where a side sees it, on the rows that couple times. The first side is
        taken unless only another one sees it.
        """
        stages, self.mu = self.system.stages, mu
        for i, own in self.cones.items():
            own.scale(self.point.s[i], self.point.z[i])
        if not (self._objective.curved and self.point.z[DYNAMICS].any() and self._exact(sides)):
            stages.H[:] = self._objective.H
            self._factor_system(sides[0])
        squares = {i: own.product(own.lam, own.lam) - mu * own.identity for i, own in self.cones.items()}
        self._centred = {i: own.scaled(own.quotient(squares[i]), 1) for i, own in self.cones.items()}

    def _exact(self, sides: Sequence[KKTSolver]) -> bool:
        """Factor the system with the curvature of the dynamics; return whether the problem is convex with it."""
        stages, cone = self.system.stages, self.cones[STAGES]
        curved = -np.einsum("ti,tijk->tjk", self.point.z[DYNAMICS][:-1], self._found.curvatures)
        count = curved.shape[1]
        stages.H[:-1, :count, :count] += curved
        Phi = self._loops.gram(stages.H, stages.G, *cone.inverse_squares, stages.cones)
        if self._loops.is_convex(stages.A, stages.B, Phi, stages.fixed):  # on the dynamics
            self._factor_system(sides[0])
            return True
        return self.theta <= NEAR and any(side.indefinite and self._factor_system(side) for side in sides)

    def _factor_system(self, side: KKTSolver) -> bool:
        """Factor the system by a side; return what it sees of convexity."""
        self._step = StepSystem(self.system, side.exchanged(self.system.stages))
        return self._step.factor()

    def step(self, left: Values | None = None) -> tuple[Array, Values, dict[int, Array]]:
        """Return the change of y, z and s that takes away residuals of the rows, by default those here."""
        left = self.left if left is None else left
        right = [-part for part in left]
        for i, centred in self._centred.items():
            right[i] = right[i] + centred
        y, z = self._step.solve(-self._dual, right)
        rows = self.system.rows(y)
        return y, z, {i: (-left[i] - rows[i]) * cone.present for i, cone in self.cones.items()}

    def slope(self, y: Array, s: dict[int, Array]) -> float:
        """Return the derivative of the objective along a step."""
        barrier = sum(float(np.vdot(cone.inverse(self.point.s[i]), s[i])) for i, cone in self.cones.items())
        return float(np.vdot(self._gradient, y)) - self.mu * barrier

    def longest(self, change: dict[int, Array], power: int) -> float:
        """Return the part of a step of slacks (power -1) or duals (1) that stays inside, at most 1."""
        lengths = [cone.longest(cone.scaled(change[i], power)) for i, cone in self.cones.items()]
        return min([1.0, *(max(FRACTION, 1 - self.mu) * length for length in lengths)])

    def trial(self, y: Array, s: dict[int, Array], length: float) -> Trial | None:
        """Return the point at a part of a step; None if the map is not defined there."""
        after, slacks = self.point.y + length * y, {i: own + length * s[i] for i, own in self.point.s.items()}
        defects = self._model.defects(after)
        if not np.isfinite(defects).all():
            return None
        linear = self.theta - float(np.abs(self.left[DYNAMICS]).sum())
        theta = float(np.abs(defects).sum()) + (1 - length) * linear
        return Trial(after, slacks, Measure(theta, self.phi(after, slacks, self.mu)), defects)


FIRST_MU, LEAST_MU = 0.1, 1e-11  # in units in which the steepest slope of the cost is 10
MU_FACTOR, MU_POWER = 0.2, 1.5  # mu falls to the smaller of MU_FACTOR mu and mu^MU_POWER
SOLVED = 10.0  # error of a barrier problem, in units of mu, at which mu falls
SHORTEST = 1e-7  # part of a step
CORRECTIONS = 4  # of a step at most
CORRECTED = 0.99  # infeasibility after a correction, relative to that before, from which no further one is made
RESTORED = 0.1  # infeasibility to reach where steps fail, relative to that there
PROXIMITY = 1e-2  # weight of the distance from there, in units of order 1
LEAST_DECREASE = 1e-4  # share of the predicted decrease of the infeasibility
MOST_STEPS = 300
MOST_RESTORING = 60
FEW_ROWS = 250  # that couple times
ACCURATE = 1e-10  # residuals in units of order 1


@dataclass(frozen=True, eq=False)
class Answer:
    """The last point, and the largest violation of its rows."""

    end: End
    point: EmbeddedPoint
    violation: float
    steps: int


@dataclass(eq=False)
class Barrier:
    """One solve of a model, from barrier weight ``mu``; ``run`` it once. ``end`` is by clock.now."""

    model: SmoothModel
    loops: Loops
    end: float = np.inf
    mu: float = FIRST_MU
    most_steps: int = MOST_STEPS

    def __post_init__(self):
        stages = self.model.stages
        self._cost = Objective(stages.H, stages.h, stages.constant, curved=True)
        self._sides = sides_for(stages, self.loops)
        self._steps = 0
        self._last: Local | None = None

    def run(self, y: Array) -> Answer:
        """Iterate from a point until it is accurate, no step helps, or the time is over."""
        try:
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # seen by numbers that are not finite
                ended = self._iterate_newton(y)
        except KeyboardInterrupt:
            if self._last is None:
                raise
            ended = End.INTERRUPTED
        last = self._last
        if last is None:
            return Answer(ended, EmbeddedPoint(y, [], {}), np.inf, 0)
        return Answer(ended, last.point, largest(last.left), self._steps)

    def _iterate_newton(self, y: Array) -> End:
        mu, last, system = self.mu, 0.0, System(self.model.stages, self.loops)
        rows, z = system.rows(y), [np.zeros_like(right) for right in system.b]
        s = {i: cone.raised((system.b[i] - rows[i]) * cone.present, MARGIN) for i, cone in system.cones.items()}
        for i, cone in system.cones.items():
            z[i] = mu * cone.inverse(s[i])
        local = self._at(EmbeddedPoint(y, z, s))
        if local is None:
            return End.UNDEFINED
        entries = Filter(local.theta)
        while self._steps < self.most_steps:
            self._last = local
            if local.error(0.0) <= ACCURATE or (mu <= LEAST_MU and local.error(mu) <= ACCURATE):
                return End.OPTIMAL
            while mu > LEAST_MU and local.error(mu) <= SOLVED * mu:
                mu = max(LEAST_MU, min(MU_FACTOR * mu, mu**MU_POWER))
                entries = Filter(entries.first)
            clock = now()
            if clock + last > self.end:
                return End.TIME
            after = self._filter_step(local, entries, mu) or self._restore_feasibility(local, entries, mu)
            if after is None:
                return End.TIME if now() > self.end else End.STALLED
            local = after
            self._steps += 1
            last = now() - clock  # the next one takes about as long
        return End.STALLED

    def _at(self, point: EmbeddedPoint, objective: Objective | None = None) -> Local | None:
        """Return what there is at a point; None if the map is not defined there."""
        found = self.model.derivatives(point.y)
        return Local(self.model, objective or self._cost, self.loops, point, found) if found.finite else None

    def _filter_step(self, local: Local, entries: Filter, mu: float) -> Local | None:
        """Return the next point by a step that the filter takes; None if it takes none."""
        local.factor(mu, self._sides)
        y, z, s = local.step()
        here, slope = local.measure(mu), local.slope(y, s)
        of_duals = local.longest({i: z[i] for i in s}, 1)
        first = length = local.longest(s, -1)
        while length > SHORTEST:
            trial = local.trial(y, s, length)
            if trial is not None:
                taken = entries.takes(here, trial.measure, slope, length)
                if not taken and length == first and trial.measure.theta >= here.theta:
                    trial = self._corrected_step(local, entries, trial, slope, length)
                    taken = trial is not None
                if taken and trial is not None:
                    after = self._at(_moved_point(local.point, trial, z, length, of_duals))
                    if after is not None:
                        return after
            length /= 2
        return None

    def _corrected_step(self, local: Local, entries: Filter, trial: Trial, slope: float, length: float) -> Trial | None:
        """Return a point that the filter takes by steps corrected for the curvature of the dynamics, or None."""
        here, left, part = local.measure(local.mu), [*local.left], length
        for _ in range(CORRECTIONS):
            left[DYNAMICS] = part * left[DYNAMICS]
            left[DYNAMICS][:-1] += trial.defects
            y, _, s = local.step(left)
            part = local.longest(s, -1)
            after = local.trial(y, s, part)
            if after is None:
                return None
            if entries.takes(here, after.measure, slope, length):
                return after
            if after.measure.theta > CORRECTED * trial.measure.theta:
                return None
            trial = after
        return None

    def _restore_feasibility(self, local: Local, entries: Filter, mu: float) -> Local | None:
        """Return a point of less infeasibility that the filter accepts, by steps without the cost; None if none."""
        target, stages = RESTORED * local.theta, self.model.stages
        entries.add(local.measure(mu))
        H = np.broadcast_to(PROXIMITY * np.eye(stages.h.shape[1]), stages.H.shape)
        near = Objective(np.ascontiguousarray(H), -PROXIMITY * local.point.y, 0.0, curved=False)
        point = local.point
        for _ in range(MOST_RESTORING):
            z = [part if i in point.s else np.zeros_like(part) for i, part in enumerate(point.z)]
            here = self._at(replace(point, z=z), near)  # rows without slacks have no multipliers
            if here is None or now() > self.end:
                return None
            if here.theta <= target:
                after = self._at(here.point)
                if after is not None and entries.accepts(after.measure(mu)):
                    return after
            here.factor(mu, self._sides)
            y, z, s = here.step()
            of_duals, length = here.longest({i: z[i] for i in s}, 1), here.longest(s, -1)
            while length > SHORTEST:
                trial = here.trial(y, s, length)
                if trial is not None and trial.measure.theta <= (1 - LEAST_DECREASE * length) * here.theta:
                    point = _moved_point(point, trial, z, length, of_duals)
                    break
                length /= 2
            else:
                return None
        return None


def sides_for(stages: Stages, loops: Loops) -> tuple[KKTSolver, ...]:
    """Return the side of steps and, beside it, that of what stop bands keep, which sees if they make a problem convex.

    With few rows the latter is slower, as more of it depends on the dynamics.
    """
    if stages.coupling.count > FEW_ROWS:
        return (choose_kkt_solver(stages, loops),)
    kept = (NullSpaceSolver(stages, loops, DenseReduced),) if sort_rows(stages)[0] else ()
    return range_space_solver(stages, loops), *kept


def _moved_point(point: EmbeddedPoint, trial: Trial, z: list[Array], length: float, of_duals: float) -> EmbeddedPoint:
    """Return a point with new variables, and its duals moved: those of cones by a length of their own."""
    lengths = [of_duals if i in trial.s else length for i in range(len(z))]
    moved = [own + part * change for own, part, change in zip(point.z, lengths, z, strict=True)]
    return EmbeddedPoint(trial.y, moved, trial.s)


WARM_MU = 1e-3  # first weight of the barrier at a start that is believed to be near
FEW_STEPS = 60  # from others: 15 to 50 are common, and another start is better than many more


def is_smooth(problem: OptimalControlProblem) -> bool:
    """Whether the dynamics are one smooth map that holds everywhere it is defined."""
    dynamics = piecewise_smooth(problem)
    return len(dynamics.modes) == 1 and not dynamics.modes[0].region and not dynamics.norms


def smooth_optimum(
    problem: OptimalControlProblem, start: Trajectory, end: float = np.inf, warm: bool = True
) -> tuple[LocalOptimum | None, End]:
    """Return the local optimum near a trajectory, or the last point, and how the iteration ended.

    None if the map is not defined at the start. ``end`` is by ``clock.now``. ``warm``: the start is believed to
    be near, and worth many steps.
    """
    model = SmoothModel.at(problem, start)
    first = (WARM_MU, MOST_STEPS) if warm else (FIRST_MU, FEW_STEPS)
    barrier = Barrier(model, loops(wait=end == np.inf), end, *first)
    answer = barrier.run(model.assembly.point(start))
    if answer.end is End.UNDEFINED:
        return None, answer.end
    trajectory = model.trajectory(answer.point.y)
    multipliers = model.multipliers(answer.point.y, answer.point.z)
    cost = problem.value(trajectory.x, trajectory.u)
    sequence = np.zeros(problem.horizon, dtype=np.intp)
    return LocalOptimum(sequence, trajectory, multipliers, cost, answer.violation), answer.end
