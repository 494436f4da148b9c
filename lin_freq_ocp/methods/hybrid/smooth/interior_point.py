"""A primal-dual barrier method for smooth dynamics.

    minimise J(y) - mu log det s   subject to   x_{t+1} = c_t(y_t),   h_t(y_t) + s = upper,
                                                other rows of y:  A y + s = b,  s in the cone

Newton's method solves the conditions of this problem, with the scalings of Nesterov and Todd for z o s = mu e, while mu
falls to zero. Each step is one system of the structured method. Its Hessian is that of the Lagrangian if the reduced
problem is convex with it, otherwise that of the cost: the multipliers are then those of a convex problem. If the cost
alone is not convex enough, a multiple of the identity is added to the Hessian of the Lagrangian. Steps are shortened
until a filter accepts them (Waechter and Biegler, 2006: pairs of infeasibility theta and objective phi), and corrected
if the filter rejects them for the curvature of the dynamics. If even short steps fail, steps to the nearest point of
the linearised constraints first reduce the infeasibility alone.

Without inequalities there is no mu. The first multipliers are those of least squares, and a step that the filter does
not accept is replaced by one with a larger multiple of the identity, instead of being shortened further.

The file has, in this order: the filter, the barrier problem at a point, and the iteration.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from lin_freq_ocp.base.arrays import Array, times_vectors
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.cones import Cone
from lin_freq_ocp.methods.hybrid.smooth.model import Derivatives, SmoothModel
from lin_freq_ocp.methods.structured.choice import choose_kkt_solver
from lin_freq_ocp.methods.structured.embedding import EmbeddedPoint, End
from lin_freq_ocp.methods.structured.kkt.null_space import NullSpaceSolver, sort_rows
from lin_freq_ocp.methods.structured.kkt.range_space import range_space_solver
from lin_freq_ocp.methods.structured.kkt.recursions import Loops
from lin_freq_ocp.methods.structured.kkt.reduced import DenseReduced
from lin_freq_ocp.methods.structured.kkt.system import DYNAMICS, STAGES, KKTSolver, StepSystem, System, Values, largest

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
    """The points with which trial points are compared; ``first`` is the infeasibility of the first point.

    Infeasibilities above ``far`` times that, or ``far``, are not accepted.
    """

    first: float
    far: float = FAR
    entries: list[Measure] = field(default_factory=list[Measure])

    def accepts(self, trial: Measure) -> bool:
        """Whether a point improves on every point of the filter."""
        near = trial.theta <= self.far * max(1.0, self.first) and bool(np.isfinite(trial.phi))
        return near and all(trial.theta < entry.theta or trial.phi < entry.phi for entry in self.entries)

    def takes(self, current: Measure, trial: Measure, slope: float, length: float) -> bool:
        """Whether a step of a length leads to an acceptable point; then the filter knows where it began.

        ``slope`` is the predicted change of the objective by a full step.
        """
        rounding = ROUNDING * abs(current.phi)
        if not self.accepts(Measure(trial.theta, trial.phi - rounding)):
            return False
        feasible = current.theta <= FEASIBLE * max(1.0, self.first)
        # the switching condition: the predicted decrease of the objective outweighs the infeasibility
        if feasible and slope < 0 and length * (-slope) ** SLOPE_POWER > current.theta**INFEASIBILITY_POWER:
            return trial.phi <= current.phi + ARMIJO * length * slope + rounding
        less = trial.theta <= (1 - IMPROVED) * current.theta
        if not less and trial.phi > current.phi - IMPROVED * current.theta + rounding:
            return False
        self.add(current)
        return True

    def add(self, current: Measure) -> None:
        """Exclude all points that do not improve on this one."""
        self.entries.append(Measure((1 - IMPROVED) * current.theta, current.phi - IMPROVED * current.theta))


MARGIN = 1e-2  # distance of the first point to the boundary, in units in which limits are of order 1
NEAR = 0.1  # infeasibility, in units of order 1, below which a second solver may tell that a step is convex
# Multiples of the identity that make a Hessian convex, in units of order 1: the first and the least, the factor from
# one to the next, that by which the next step begins lower (Waechter and Biegler, 2006), and the largest
FIRST_SHIFT, LEAST_SHIFT, SHIFT_RISE, SHIFT_FALL, LARGEST_SHIFT = 1e-4, 1e-10, 8.0, 24.0, 1e20
FRACTION = 0.99  # of the way to the boundary, at least
STABILISED = 1e-4  # compliance of a fixed end, of which dynamics may imply a part, per infeasibility (Wright, 1998)


class Trial(NamedTuple):
    """A point along a step."""

    y: Array
    s: dict[int, Array]
    measure: Measure
    defects: Array
    path: Array  # residuals of the rows of path constraints, (rows,)


@dataclass(frozen=True, eq=False)
class Objective:
    """1/2 y'H y + h'y + constant, and whether the curvature of the dynamics counts.

    Of a cost by formulas these are H and h to second order at a point, and ``exact`` is the cost at any point.
    """

    H: Array
    h: Array
    constant: float
    curved: bool
    exact: Callable[[Array], float] | None = None

    def defined_at(self, y: Array) -> bool:
        """Whether the cost and its derivatives are numbers at the point where it was expanded."""
        return self.exact is None or bool(np.isfinite([self.exact(y), self.H.sum(), self.h.sum()]).all())

    @property
    def convex(self) -> Array:
        """Return H, of a cost by formulas with the size of the curvature where that is negative."""
        if self.exact is None:
            return self.H
        values, vectors = np.linalg.eigh(self.H)
        return np.einsum("tij,tj,tkj->tik", vectors, np.abs(values), vectors)


class BarrierPoint:
    """A barrier problem near a point."""

    def __init__(
        self, model: SmoothModel, objective: Objective, system: System, point: EmbeddedPoint, derivatives: Derivatives
    ):
        self._model, self._objective, self._loops = model, objective, system.loops
        self.point, self._derivatives = point, derivatives
        self.system = system.exchanged(model.linearised(point.y, derivatives))
        self.system.stages.H[:] = objective.H
        rows = zip(self.system.rows(point.y), self.system.b, strict=True)
        self.left: Values = [values - right for values, right in rows]
        for i, s in point.s.items():
            self.left[i] = (self.left[i] + s) * self.cones[i].present
        self._gradient = times_vectors(objective.H, point.y) + objective.h
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
        objective, barrier = self._objective, mu * sum(cone.log_determinant(s[i]) for i, cone in self.cones.items())
        if objective.exact is not None:
            return objective.exact(y) - barrier
        cost = 0.5 * float(np.vdot(y, times_vectors(objective.H, y))) + float(np.vdot(objective.h, y))
        return cost + objective.constant - barrier

    def bound(self, reach: float) -> float:
        """Return what the objective costs at least within a reach, as far as the Lagrangian is convex."""
        point = self.point
        lagrangian = self.phi(point.y, point.s, 0.0) - sum(float(np.vdot(point.z[i], s)) for i, s in point.s.items())
        lagrangian += sum(float(np.vdot(z, left)) for z, left in zip(point.z, self.left, strict=True))
        return lagrangian - reach * float(np.abs(self._dual).sum())

    def measure(self, mu: float) -> Measure:
        """Return the infeasibility and the objective here."""
        return Measure(self.theta, self.phi(self.point.y, self.point.s, mu))

    def fitted_multipliers(self, solver: KKTSolver) -> Values:
        """Return the multipliers of least squares at this point, of a problem without inequalities."""
        self._is_convex(np.broadcast_to(np.eye(self._objective.H.shape[1]), self._objective.H.shape), 0.0)
        self._factor_system(solver)
        return self._step.solve(-self._gradient, [np.zeros_like(part) for part in self.left])[1]

    def factor(self, mu: float, solvers: Sequence[KKTSolver], shift: float = 0.0, least: float = 0.0) -> float:
        """Factor the system of a step, and return the multiple of the identity in its Hessian, ``least`` or more.

        The Hessian is that of the Lagrangian if the problem is convex with it, on the dynamics or, if a solver can
        detect it, on the rows that couple times; else that of the cost, if it is convex on the dynamics. Otherwise the
        multiple of the identity that is added to the first grows; it begins near that of an earlier step, ``shift``.
        The first solver is taken unless only another one detects convexity.
        """
        lagrangian, self.mu, applied = self._objective.H.copy(), mu, least
        for i, cone in self.cones.items():
            cone.scale(self.point.s[i], self.point.z[i])
        eta = self.point.z[DYNAMICS][:-1]
        curved = self._objective.curved and (eta.any() or self._objective.exact is not None)
        if curved:
            curvature = np.einsum("ti,tijk->tjk", eta, self._derivatives.curvatures)
            lagrangian[:-1, : curvature.shape[1], : curvature.shape[1]] -= curvature
        rows = self._model.path
        if self._objective.curved and len(rows.values):
            bends, curved = self._derivatives.bends, True
            added = np.zeros((len(lagrangian), *bends.shape[1:]))
            np.add.at(added, rows.times, self.point.z[STAGES][rows.times, rows.slots, None, None] * bends)
            lagrangian[:, : bends.shape[1], : bends.shape[1]] += added
        convex = curved and self._is_convex(lagrangian, applied)
        if not convex and curved and self.theta <= NEAR:
            convex = detected = any(solver.indefinite and self._factor_system(solver) for solver in solvers)
        else:
            detected = False
        if not convex and not self._is_convex(self._objective.convex, applied) and self._objective.curved:
            applied = max(least, shift / SHIFT_FALL)
            while not self._is_convex(lagrangian, applied) and applied < LARGEST_SHIFT:
                applied = max(FIRST_SHIFT if shift == 0 else LEAST_SHIFT, SHIFT_RISE * applied)
        if not detected:
            self._factor_system(solvers[0])
        squares = {i: cone.product(cone.lam, cone.lam) - mu * cone.identity for i, cone in self.cones.items()}
        self._centred = {i: cone.scaled(cone.quotient(squares[i]), 1) for i, cone in self.cones.items()}
        return applied

    def _is_convex(self, H: Array, shift: float) -> bool:
        """Give the stages a Hessian with a multiple of the identity; return if they are convex on the dynamics."""
        stages, cone = self.system.stages, self.cones[STAGES]
        stages.H[:] = H + shift * np.eye(H.shape[1])
        Phi = self._loops.gram(stages.H, stages.G, *cone.inverse_squares, stages.cones)
        return self._loops.is_convex(stages.A, stages.B, Phi, stages.fixed)

    def _factor_system(self, solver: KKTSolver) -> bool:
        """Factor the system; return whether the solver finds the problem convex."""
        coupling = self.system.coupling
        of_end: Array = STABILISED * (np.arange(coupling.equation_count) < len(coupling.terminal)).astype(np.float64)
        self._step = StepSystem(self.system, solver.exchanged(self.system.stages), min(self.theta, 1.0) * of_end)
        return self._step.factor()

    def step(self, left: Values | None = None) -> tuple[Array, Values, dict[int, Array]]:
        """Return the change of y, z and s that removes residuals of the rows, by default those at this point."""
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
        """Return the largest part of a step, up to 1, with slacks (power -1) or duals (1) inside the cone."""
        longest = 1.0
        for i, cone in self.cones.items():
            # Slacks and duals that a step leaves within mu of the boundary of a second-order cone are not aligned: the
            # squares of their scaling then differ by 1/mu^2, and no system can be solved there. A row has one number.
            fraction = FRACTION if cone.blocks else max(FRACTION, 1 - self.mu)
            longest = min(longest, fraction * cone.longest(cone.scaled(change[i], power)))
        return longest

    def trial(self, y: Array, s: dict[int, Array], length: float) -> Trial | None:
        """Return the point at a part of a step; None if the map is not defined there."""
        after, slacks = self.point.y + length * y, {i: slack + length * s[i] for i, slack in self.point.s.items()}
        defects, path = self._model.defects(after), self._model.path
        bent = self._model.path_values(after) + slacks[STAGES][path.times, path.slots]
        if not (np.isfinite(defects).all() and np.isfinite(bent).all()):
            return None
        curved = self.left[DYNAMICS], self.left[STAGES][path.times, path.slots]
        linear = self.theta - sum(float(np.abs(part).sum()) for part in curved)
        theta = float(np.abs(defects).sum() + np.abs(bent).sum()) + (1 - length) * linear
        return Trial(after, slacks, Measure(theta, self.phi(after, slacks, self.mu)), defects, bent)


FIRST_MU, LEAST_MU = 0.1, 1e-11  # in units in which the steepest slope of the cost is 10
MU_FACTOR, MU_POWER = 0.2, 1.5  # mu falls to the smaller of MU_FACTOR mu and mu^MU_POWER
SOLVED = 10.0  # error of a barrier problem, in units of mu, at which mu falls
SHORTEST = 1e-7  # part of a step
LONGEST = 30.0  # step that is tried, in units of order 1: longer ones get a larger multiple of the identity
# Without inequalities: part of a step below which a larger multiple of the identity takes its place, how often that is
# tried, the infeasibility that is never exceeded, relative to the first, and the largest multipliers to begin with
LEAST_PART, MOST_SHIFTS, FARTHEST, LARGEST_DUAL = 0.1, 20, 10.0, 1e3
CORRECTIONS = 4  # of a step at most
CORRECTED = 0.99  # infeasibility after a correction, relative to that before, from which no further one is made
RESTORED = 0.1  # infeasibility to reach where steps fail, relative to that there
PROXIMITY = 1e-2  # weight of the distance from there, in units of order 1
LEAST_DECREASE = 1e-4  # share of the predicted decrease of the infeasibility
MOST_STEPS = 300
MOST_RESTORING = 60
FEW_ROWS = 250  # that couple times
ACCURATE, ACCEPTABLE = 1e-10, 1e-7  # residuals in units of order 1 at which it ends, and of a local optimum at most


@dataclass(frozen=True, eq=False)
class BarrierResult:
    """The last point, the largest violation of its rows, and its largest relative residual."""

    end: End
    point: EmbeddedPoint
    violation: float
    error: float
    steps: int


@dataclass(eq=False)
class Barrier:
    """One solve of a model, from barrier weight ``mu``; ``run`` it once. ``end`` is by clock.now.

    It ends where the cost will not fall ``below`` a number.
    """

    model: SmoothModel
    loops: Loops
    end: float = np.inf
    mu: float = FIRST_MU
    most_steps: int = MOST_STEPS
    below: float = np.inf

    def __post_init__(self):
        stages = self.model.stages
        self._cost = Objective(stages.H, stages.h, stages.constant, curved=True)
        self._solvers: tuple[KKTSolver, ...] = (choose_kkt_solver(stages, self.loops),)
        if stages.coupling.count <= FEW_ROWS:
            # the null-space solver, which detects convexity on stop bands, is slower with few rows: it comes second
            null_space = (NullSpaceSolver(stages, self.loops, DenseReduced),) if sort_rows(stages)[0] else ()
            self._solvers = range_space_solver(stages, self.loops), *null_space
        self._steps, self._shift, self._system = 0, 0.0, System(stages, self.loops)
        coupled = self.model.stages.coupling
        self.unequal = bool(stages.present.any() or coupled.inequalities or coupled.balls)
        self._last: BarrierPoint | None = None

    def run(self, y: Array) -> BarrierResult:
        """Iterate from a point until it is accurate, no step helps, or the time is over."""
        try:
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # seen by numbers that are not finite
                ended = self._iterate_newton(y)
        except KeyboardInterrupt:
            if self._last is None:
                raise
            ended = End.INTERRUPTED
        except np.linalg.LinAlgError:  # the map, linearised along the trajectory, overflows within the horizon
            ended = End.STALLED
        last = self._last
        if last is None:
            return BarrierResult(ended, EmbeddedPoint(y, [], {}), np.inf, np.inf, 0)
        return BarrierResult(ended, last.point, largest(last.left), last.error(0.0), self._steps)

    def _iterate_newton(self, y: Array) -> End:
        mu, last, system = self.mu, 0.0, self._system.exchanged(self.model.stages_at(y))
        rows, z = system.rows(y), [np.zeros_like(right) for right in system.b]
        s = {i: cone.raised((system.b[i] - rows[i]) * cone.present, MARGIN) for i, cone in system.cones.items()}
        for i, cone in system.cones.items():
            z[i] = mu * cone.inverse(s[i])
        local, self._longest = self._at(EmbeddedPoint(y, z, s)), LONGEST * max(1.0, largest([y]))
        if local is None:
            return End.UNDEFINED
        if not self.unequal:
            mu, fitted = 0.0, local.fitted_multipliers(self._solvers[0])
            local.point = replace(local.point, z=fitted) if largest(fitted) <= LARGEST_DUAL else local.point
            local = self._at(local.point) or local
        entries = Filter(local.theta, FAR if self.unequal else FARTHEST)
        if not self.unequal and local.theta <= ACCEPTABLE:
            entries.add(local.measure(mu))  # no answer is worse than a first point that is a trajectory
        while self._steps < self.most_steps:
            self._last = local
            if local.error(0.0) <= ACCURATE or (mu <= LEAST_MU and local.error(mu) <= ACCURATE):
                further = None if self.unequal else self._filter_step(local, entries, mu)  # it doubles the digits
                if further is not None and further.error(0.0) < local.error(0.0):
                    self._last = further
                return End.OPTIMAL
            if self.below < np.inf and local.bound(self._longest) >= self.below:
                return End.DEARER
            while mu > LEAST_MU and local.error(mu) <= SOLVED * mu:
                mu = max(LEAST_MU, min(MU_FACTOR * mu, mu**MU_POWER))
                entries = Filter(entries.first, entries.far)
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

    def _at(self, point: EmbeddedPoint, objective: Objective | None = None) -> BarrierPoint | None:
        """Return the barrier problem at a point; None if the map is not defined there."""
        derivatives = self.model.derivatives(point.y)
        if objective is None and self.model.problem.cost.has_formulas:
            H, h = self.model.expanded_cost(point.y)
            objective = Objective(H, h, 0.0, curved=True, exact=self.model.cost)
        objective = objective or self._cost
        if not derivatives.finite or not objective.defined_at(point.y):
            return None
        return BarrierPoint(self.model, objective, self._system, point, derivatives)

    def _filter_step(self, local: BarrierPoint, entries: Filter, mu: float) -> BarrierPoint | None:
        """Return the next point by a step that the filter takes; None if it takes none."""
        least = 0.0
        for _ in range(MOST_SHIFTS):
            shift = local.factor(mu, self._solvers, self._shift, least)
            self._shift, step = shift or self._shift, local.step()
            short = largest([step[0]]) <= self._longest and largest(step[1]) < np.inf
            after = self._search_line(local, entries, *step) if short else None
            if after is not None:
                return after
            if short and self.unequal:
                break
            least = SHIFT_RISE * max(shift, self._shift / SHIFT_FALL) or FIRST_SHIFT
        return None

    def _search_line(
        self, local: BarrierPoint, entries: Filter, y: Array, z: Values, s: dict[int, Array]
    ) -> BarrierPoint | None:
        """Return the next point by a part of a step; None if the filter takes none."""
        current, slope = local.measure(local.mu), local.slope(y, s)
        of_duals = local.longest({i: z[i] for i in s}, 1)
        first = length = local.longest(s, -1)
        while length > (SHORTEST if self.unequal else LEAST_PART):
            trial = local.trial(y, s, length)
            if trial is not None:
                taken = entries.takes(current, trial.measure, slope, length)
                correct = length == first or not self.unequal
                if not taken and correct and trial.measure.theta >= current.theta:
                    trial = self._corrected_step(local, entries, trial, slope, length)
                    taken = trial is not None
                if taken and trial is not None:
                    after = self._at(_point_after(local.point, trial, z, length, of_duals))
                    if after is not None:
                        return after
            length /= 2
        return None

    def _corrected_step(
        self, local: BarrierPoint, entries: Filter, trial: Trial, slope: float, length: float
    ) -> Trial | None:
        """Return a point that the filter takes by steps corrected for the curvature of the dynamics, or None."""
        current, left, part = local.measure(local.mu), [*local.left], length
        for _ in range(CORRECTIONS):
            left[DYNAMICS], left[STAGES] = part * left[DYNAMICS], left[STAGES].copy()
            left[DYNAMICS][:-1] += trial.defects
            at = self.model.path.times, self.model.path.slots
            left[STAGES][at] = part * left[STAGES][at] + trial.path
            y, _, s = local.step(left)
            part = local.longest(s, -1)
            after = local.trial(y, s, part)
            if after is None:
                return None
            if entries.takes(current, after.measure, slope, length):
                return after
            if after.measure.theta > CORRECTED * trial.measure.theta:
                return None
            trial = after
        return None

    def _restore_feasibility(self, local: BarrierPoint, entries: Filter, mu: float) -> BarrierPoint | None:
        """Return a point of less infeasibility that the filter accepts, by steps without the cost; None if none."""
        target, stages = RESTORED * local.theta, self.model.stages
        entries.add(local.measure(mu))
        H = np.broadcast_to(PROXIMITY * np.eye(stages.h.shape[1]), stages.H.shape)
        near = Objective(np.ascontiguousarray(H), -PROXIMITY * local.point.y, 0.0, curved=False)
        point = local.point
        for _ in range(MOST_RESTORING):
            z = [part if i in point.s else np.zeros_like(part) for i, part in enumerate(point.z)]
            restoring = self._at(replace(point, z=z), near)  # rows without slacks have no multipliers
            if restoring is None or now() > self.end:
                return None
            if restoring.theta <= target:
                after = self._at(restoring.point)
                if after is not None and entries.accepts(after.measure(mu)):
                    return after
            restoring.factor(mu, self._solvers)
            y, z, s = restoring.step()
            if largest(z) == np.inf:
                return None
            of_duals, length = restoring.longest({i: z[i] for i in s}, 1), restoring.longest(s, -1)
            while length > SHORTEST:
                trial = restoring.trial(y, s, length)
                if trial is not None and trial.measure.theta <= (1 - LEAST_DECREASE * length) * restoring.theta:
                    point = _point_after(point, trial, z, length, of_duals)
                    break
                length /= 2
            else:
                return None
        return None


def _point_after(point: EmbeddedPoint, trial: Trial, z: list[Array], length: float, of_duals: float) -> EmbeddedPoint:
    """Return the point after a step; the duals of cones have a step length of their own."""
    lengths = [of_duals if i in trial.s else length for i in range(len(z))]
    duals = [dual + part * change for dual, part, change in zip(point.z, lengths, z, strict=True)]
    return EmbeddedPoint(trial.y, duals, trial.s)
