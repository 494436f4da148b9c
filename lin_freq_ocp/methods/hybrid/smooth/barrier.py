"""A primal-dual barrier method for smooth dynamics.

    minimise J(y) - mu log det s   subject to   x_{t+1} = c_t(y_t),   other rows of y:  A y + s = b,  s in the cone

Newton's method on the conditions of this problem, with the scalings of Nesterov and Todd for z o s = mu e, while mu
falls to zero: each step is one system of the structured method. Its Hessian is that of the Lagrangian where the reduced
problem is convex with it, else that of the cost: then multipliers stay those of a convex problem. Steps are shortened
until a filter takes them, and corrected where the curvature of the dynamics is what it rejects. Where even short steps
fail, the infeasibility alone is reduced first, by steps to the nearest point of the linearised constraints.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.methods.hybrid.smooth.filter import Filter
from lin_freq_ocp.methods.hybrid.smooth.interior import inverse, moved_inside
from lin_freq_ocp.methods.hybrid.smooth.local import Local, Objective, Point, Trial
from lin_freq_ocp.methods.hybrid.smooth.model import SmoothModel
from lin_freq_ocp.methods.structured.choice import choose_kkt_solver as choose_side
from lin_freq_ocp.methods.structured.kkt.null_space import NullSpaceSolver as KeptSide
from lin_freq_ocp.methods.structured.kkt.null_space import sort_rows
from lin_freq_ocp.methods.structured.kkt.range_space import range_space_solver as stopped_side
from lin_freq_ocp.methods.structured.kkt.recursions import Loops
from lin_freq_ocp.methods.structured.kkt.reduced import DenseReduced
from lin_freq_ocp.methods.structured.kkt.system import DYNAMICS, System, largest
from lin_freq_ocp.methods.structured.kkt.system import KKTSolver as Side
from lin_freq_ocp.methods.structured.stages import Stages

FIRST_MU, LEAST_MU = 0.1, 1e-11  # in units in which the steepest slope of the cost is 10
MU_FACTOR, MU_POWER = 0.2, 1.5  # mu falls to the smaller of MU_FACTOR mu and mu^MU_POWER
SOLVED = 10.0  # error of a barrier problem, in units of mu, at which mu falls
SHORTEST = 1e-7  # part of a step
CORRECTIONS = 4  # of a step at most
CORRECTED = 0.99  # infeasibility after a correction, relative to that before, from which no further one is made
RESTORED = 0.1  # infeasibility to reach where steps fail, relative to that there
PROXIMITY = 1e-2  # weight of the distance from there, in units of order 1
LESS = 1e-4  # share of the predicted decrease of the infeasibility
MOST_STEPS = 300
MOST_RESTORING = 60
FEW_ROWS = 250  # that couple times
ACCURATE = 1e-10  # residuals in units of order 1


class End(Enum):
    """How the iteration ended."""

    OPTIMAL = "optimal"
    STALLED = "stalled"
    TIME = "time limit"
    INTERRUPTED = "interrupted"
    UNDEFINED = "undefined"


@dataclass(frozen=True, eq=False)
class Answer:
    """The last point, and the largest violation of its rows."""

    end: End
    point: Point
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
                ended = self._iterated(y)
        except KeyboardInterrupt:
            if self._last is None:
                raise
            ended = End.INTERRUPTED
        last = self._last
        if last is None:
            return Answer(ended, Point(y, [], {}), np.inf, 0)
        return Answer(ended, last.point, largest(last.left), self._steps)

    def _iterated(self, y: Array) -> End:
        mu, last = self.mu, 0.0
        local = self._at(self._first(y, mu))
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
            after = self._stepped(local, entries, mu) or self._restored(local, entries, mu)
            if after is None:
                return End.TIME if now() > self.end else End.STALLED
            local = after
            self._steps += 1
            last = now() - clock  # the next one takes about as long
        return End.STALLED

    def _at(self, point: Point, objective: Objective | None = None) -> Local | None:
        """Return what there is at a point; None if the map is not defined there."""
        found = self.model.derivatives(point.y)
        return Local(self.model, objective or self._cost, self.loops, point, found) if found.finite else None

    def _first(self, y: Array, mu: float) -> Point:
        system = System(self.model.stages, self.loops)
        rows, z = system.rows(y), [np.zeros_like(right) for right in system.b]
        s = {i: moved_inside(cone, system.b[i] - rows[i]) for i, cone in system.cones.items()}
        for i, cone in system.cones.items():
            z[i] = mu * inverse(cone, s[i])
        return Point(y, z, s)

    def _stepped(self, local: Local, entries: Filter, mu: float) -> Local | None:
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
                    trial = self._corrected(local, entries, trial, slope, length)
                    taken = trial is not None
                if taken and trial is not None:
                    after = self._at(_moved(local.point, trial, z, length, of_duals))
                    if after is not None:
                        return after
            length /= 2
        return None

    def _corrected(self, local: Local, entries: Filter, trial: Trial, slope: float, length: float) -> Trial | None:
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

    def _restored(self, local: Local, entries: Filter, mu: float) -> Local | None:
        """Return a point of less infeasibility that the filter accepts, by steps without the cost; None if none."""
        target, stages = RESTORED * local.theta, self.model.stages
        entries.add(local.measure(mu))
        H = np.broadcast_to(PROXIMITY * np.eye(stages.h.shape[1]), stages.H.shape)
        near = Objective(np.ascontiguousarray(H), -PROXIMITY * local.point.y, 0.0, curved=False)
        point = local.point
        for _ in range(MOST_RESTORING):
            here = self._at(_without_equations(point), near)
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
                if trial is not None and trial.measure.theta <= (1 - LESS * length) * here.theta:
                    point = _moved(point, trial, z, length, of_duals)
                    break
                length /= 2
            else:
                return None
        return None


def sides_for(stages: Stages, loops: Loops) -> tuple[Side, ...]:
    """Return the side of steps and, beside it, that of what stop bands keep, which sees if they make a problem convex.

    With few rows the latter is slower, as more of it depends on the dynamics.
    """
    if stages.coupling.count > FEW_ROWS:
        return (choose_side(stages, loops),)
    kept = (KeptSide(stages, loops, DenseReduced),) if sort_rows(stages)[0] else ()
    return stopped_side(stages, loops), *kept


def _moved(point: Point, trial: Trial, z: list[Array], length: float, of_duals: float) -> Point:
    """Return a point with new variables, and its duals moved: those of cones by a length of their own."""
    lengths = [of_duals if i in trial.s else length for i in range(len(z))]
    moved = [own + part * change for own, part, change in zip(point.z, lengths, z, strict=True)]
    return Point(trial.y, moved, trial.s)


def _without_equations(point: Point) -> Point:
    """Return a point with zeros for the multipliers of rows without slacks."""
    z = [part if i in point.s else np.zeros_like(part) for i, part in enumerate(point.z)]
    return replace(point, z=z)
