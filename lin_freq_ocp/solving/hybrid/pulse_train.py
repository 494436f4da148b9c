"""The method for pulse trains: branch and bound over angles, whose best is polished and judged.

A part of the angles is closed by the curvature around a local optimum (angles.py), or bounded on a lattice
(angle_lattice.py) with the prices of such an optimum. What may hold a better train becomes a narrower part for the same
or a finer lattice, or two parts.
"""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import ClassVar, NamedTuple

import numpy as np

from lin_freq_ocp.base.arrays import Array, first_largest
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.phrases import low_to_high, number
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.bound import RIGOROUS, Bound
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE
from lin_freq_ocp.methods.candidate import zero_multipliers
from lin_freq_ocp.methods.hybrid.angle_lattice import AngleLattice, AngleRange
from lin_freq_ocp.methods.hybrid.angles import bound_near, local_angles, local_prices, nearest_train
from lin_freq_ocp.methods.hybrid.quarter import Quarter
from lin_freq_ocp.methods.hybrid.smooth.local_optimum import LocalOptimum
from lin_freq_ocp.problem.hybrid.pulse_train import ANGLE, CURRENT, QUARTER, PulseTrain
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.hybrid.certify_modes import best_multipliers
from lin_freq_ocp.solving.hybrid.smooth import outcome_of_search, refine_optimum
from lin_freq_ocp.solving.method import Request
from lin_freq_ocp.solving.outcome import Judged, Outcome
from lin_freq_ocp.transform.simulation import simulate

GAP = 1e-6  # default of the relative gap to prove
SHARE_OF_PARTS = 0.95  # of the time, after which the best train is refined and judged
SAME_OPTIMUM = 0.01  # distance of angles [rad] of two trains of a lattice from which the local optimum is the same
FIRST_LATTICE = 250  # angles of a quarter: where a first train is sought, without a tube
LATTICES = [1000 * 2**n for n in range(7)]  # with eight switches, the first has gaps of about 1 %
SMALLER = 0.7  # of the sum of the ranges of a part, below which it is bounded again before it is divided
MOST_PARTS = 20_000  # in all: a minute or more
LEAST_OVER = 1e-12  # of a bound on the energy over the cutoff, and of the best energy over it: rounding is smaller
EXCLUDED = "proven by branch and bound over the angles: no pulse train satisfies the constraints"
ANGLES = "branch and bound over the angles"


@dataclass(frozen=True)
class Angles:
    """Branch and bound over the angles of a pulse train (docs/levels.md).

    Attributes
    ----------
    gap : float
        Relative gap (J - D)/S to prove.

    Examples
    --------
    >>> problem = lfo.library.pulse_pattern(kind="opp", modulation=0.9, switches=8)
    >>> lfo.solve(problem, lfo.solvers.Angles(gap=1e-4)).status
    'optimal'
    """

    gap: float = GAP

    shorthand: ClassVar[str] = "angles"
    takes_start: ClassVar[bool] = True

    def solve(self, problem: OptimalControlProblem, request: Request) -> Outcome:
        """Narrow and divide parts until the bound reaches the cost of the best local optimum, and judge that."""
        search = _TrainSearch(problem, self.gap, now(), request)
        message, interrupted = "", False
        try:
            message = search.run()
        except KeyboardInterrupt:
            message, interrupted = "interrupted", True
        return search.outcome(message, interrupted)


class _Node(NamedTuple):
    """Some trains: a bound on their cost, their number, the lattice that is next, and prices of the amplitudes."""

    bound: float
    number: int
    level: int
    part: AngleRange
    r: Array


class _TrainSearch:
    """One search: the parts that are left, and the best train so far."""

    def __init__(self, problem: OptimalControlProblem, gap: float, started: float, request: Request):
        dynamics = problem.dynamics
        assert isinstance(dynamics, PulseTrain)
        self._problem, self._gap, self._started, self._request = problem, gap, started, request
        self._quarter = quarter = Quarter.of_problem(problem, dynamics)
        self._dynamics, self._done, count = dynamics, np.inf, problem.horizon - 1
        self._best: tuple[Array, Array] | None = None  # steps and angles
        self._cost = np.inf
        self._optima = dict[tuple[bytes, bytes], tuple[Array, Array, Array]]()  # steps, angles, prices of local ones
        self._tried = set[tuple[bytes, bytes]]()
        self._lattices = [AngleLattice(quarter, N) for N in LATTICES]
        whole = AngleRange(np.zeros(count), np.full(count, QUARTER), np.zeros(count, dtype=np.intp))
        r = np.clip(0.0, quarter.low, quarter.high) / np.array(quarter.orders)
        self._parts, self._numbers = list[_Node](), 0
        self._push(_Node(quarter.least_cost, 0, 0, whole, r))

    def run(self) -> str:
        """Return why the search stopped early, or an empty string."""
        self._begin()
        end = self._started + SHARE_OF_PARTS * self._request.time_limit
        if self._best is None:
            self._find_train(end)
        while self._parts and self._parts[0].bound < self._cutoff:
            if now() > end:
                return f"time limit of {self._request.time_limit:g} s"
            if self._numbers > MOST_PARTS:
                return f"{MOST_PARTS:,} parts of the angles leave a gap"
            for child in self._branch(self._parts[0], end):
                self._push(child)
            heappop(self._parts)  # its children have larger numbers, and an interrupt before leaves it in the list
        return ""

    def _find_train(self, end: float) -> None:
        """Look for a train in parts whose amplitudes may meet their limits; without such a part there is none."""
        whole, least = self._parts[0], np.inf
        waiting = deque([whole.part])
        while waiting and self._best is None and now() <= end:
            part = waiting.popleft()
            found = nearest_train(self._quarter, part.low, part.high, part.sign)
            if found.excluded_by is not None:
                continue
            if part is whole.part:
                with suppress(UnsupportedError):
                    point = AngleLattice(self._quarter, FIRST_LATTICE).bound(whole.r, part)
                    self._look_once(point.steps, point.angles)
            if found.missed < least / 2 or part.sign.all():
                least = min(least, found.missed)
                self._look_once(found.steps, found.angles)
            waiting.extend(part.halves())
        if not waiting and self._best is None:
            self._parts.clear()

    def _branch(self, node: _Node, end: float) -> list[_Node]:
        """Bound a part, and return what is open of it: narrower, for a finer lattice, or as two parts."""
        part, quarter = node.part, self._quarter
        for steps, angles, prices in self._optima.values():
            if part.is_near(steps, angles):
                node = node._replace(r=prices)
                if part.sign.all():
                    proven = self._cost_at_least(bound_near(quarter, steps, angles, part.low, part.high))
                    if proven >= self._cutoff:
                        self._done = min(self._done, proven)
                        return []
        if nearest_train(quarter, part.low, part.high, part.sign).excluded_by is not None:
            return []
        lattice = self._lattices[node.level]
        try:
            best = max(lattice.best(part, node.r, end, self._enough), key=lambda point: point.bound)
            if self._cost_at_least(best.bound + best.loss) < self._cutoff:  # a finer lattice does not exclude it
                self._look_once(best.steps, best.angles)
            node = node._replace(bound=max(node.bound, self._cost_at_least(best.bound)), r=best.r)
            if node.bound >= self._cutoff:
                self._done = min(self._done, node.bound)
                return []
        except UnsupportedError:
            return [node._replace(part=half) for half in part.halves()]
        self._done = min(self._done, self._cutoff)  # trains outside the narrowed part cost at least this
        narrow = lattice.narrow(part, best.open)
        if narrow is None:
            return []
        finer = quarter.price * best.loss > (self._cutoff - node.bound) / 2 and node.level + 1 < len(LATTICES)
        narrower = (narrow.high - narrow.low).sum() < SMALLER * (part.high - part.low).sum()
        if narrower or (finer and narrow.sign.all()):
            return [node._replace(part=narrow, level=node.level + finer)]
        return [node._replace(part=half) for half in narrow.halves()]

    def _push(self, node: _Node) -> None:
        """Leave a part for later, unless no train is in it."""
        low, high = self._quarter.apart(node.part.low, node.part.high)
        if (low <= high).all():
            part = AngleRange(low, high, node.part.sign)
            heappush(self._parts, node._replace(number=self._numbers, part=part))
        self._numbers += 1

    def _cost_at_least(self, energy: float) -> float:
        """Return the bound on the cost of one on the energy."""
        return self._quarter.price * (energy + self._quarter.offset)

    @property
    def _enough(self) -> float:
        """Return the energy above which no train is of interest."""
        return self._cutoff / self._quarter.price - self._quarter.offset + LEAST_OVER

    def _begin(self) -> None:
        """Look near the start, if there is one: near its angles, or of a mode sequence, near equal dwells."""
        start, count = self._request.start, self._problem.horizon - 1
        if start is not None:
            steps = self._quarter.step * np.where(start.sequence[:count] == 0, 1.0, -1.0)
            equal = QUARTER * np.arange(1, count + 1) / (count + 1)
            self._look_near(steps, equal if start.trajectory is None else start.trajectory.x[1:-1, ANGLE])

    def _look_once(self, steps: Array, angles: Array) -> None:
        """Look near these angles, unless that was done near others that are almost the same."""
        key = steps.tobytes(), np.round(angles / SAME_OPTIMUM).tobytes()
        if key not in self._tried and steps.all():
            self._tried.add(key)
            self._look_near(steps, angles)

    def _look_near(self, steps: Array, angles: Array) -> None:
        """Remember the local optimum near these angles."""
        local = local_angles(self._quarter, steps, angles)
        if local is not None:
            key = steps.tobytes(), local[0].tobytes()
            self._optima[key] = steps, local[0], local_prices(self._quarter, steps, local[0])
            if local[1] < self._cost:
                self._best, self._cost = (steps, local[0]), local[1]

    @property
    def _value(self) -> float:
        """Return the bound on the cost of every train."""
        return min([self._done, *(node.bound for node in self._parts)])

    @property
    def _cutoff(self) -> float:
        """Return the bound at which the search ends: half of the gap, or rounding, is left to the refined answer."""
        left = max(self._gap / 2 * abs(self._cost), self._quarter.price * LEAST_OVER)
        return np.inf if self._best is None else self._cost - left

    def outcome(self, message: str, interrupted: bool) -> Outcome:
        """Return the refined answer with its bound, or why there is none."""
        solved, problem = now(), self._problem
        judged: Judged | None = None
        if self._best is not None:
            steps, angles = self._best
            last = -1.0 if steps.sum() > 0 or self._quarter.highest == 0 else 1.0  # to a level that is allowed
            directions = np.append(np.sign(steps), last)
            dwell = np.diff(np.concatenate([[0.0], angles, [QUARTER]]))
            first = problem.ends[0].project(np.zeros(problem.state_dim))
            first[CURRENT] = -self._dynamics.step * directions[:-1] @ (QUARTER - angles)
            train = simulate(problem, np.column_stack([dwell, directions / 2]), first)
            plain = best_multipliers(problem, train, zero_multipliers(problem, 1.0))
            local = LocalOptimum((directions < 0).astype(np.intp), train, plain.multipliers, self._cost, 0.0)
            refined = refine_optimum(problem, local, self._started + self._request.time_limit)
            bound = Bound(self._value, RIGOROUS, sets=ANGLES)
            # a cost of zero is rounding after a step
            judged, plain = (one.with_bound(bound) for one in (refined, plain))
            if plain.certificate.cost < judged.certificate.cost and plain.certificate.globally_optimal:
                judged = plain
            status = judged.certificate.status_within(self._gap)
            status = Status.LIMIT if status == Status.NUMERICAL_ERROR and message else status
            message = message or ("" if judged.certificate.feasible else _broken_bound(problem, train))
        else:
            excluded = not message and self._value == np.inf
            status, message = (Status.INFEASIBLE, EXCLUDED) if excluded else (Status.LIMIT, message)
        ending = status, "" if status == Status.OPTIMAL else message
        seconds = {"setup": 0.0, "solve": solved - self._started, "certify": now() - solved}
        return outcome_of_search(problem, Angles.shorthand, judged, ending, seconds, interrupted)


def _broken_bound(problem: OptimalControlProblem, train: Trajectory) -> str:
    """Return in words the bound that a train of the search misses most, relative to the values; empty without one."""
    worst, text = CONDITION_TOLERANCE, ""
    for names, signal, box in (
        (problem.state_names, train.x, problem.state_tube),
        (problem.control_names, train.u, problem.control_tube),
    ):
        excess = np.maximum(box.lower - signal, signal - box.upper) / np.abs(signal).max(axis=0).clip(min=LEAST_OVER)
        t, i = first_largest(excess)
        if excess[t, i] > worst:
            worst, (value, low, high) = excess[t, i], map(float, (signal[t, i], box.lower[t, i], box.upper[t, i]))
            text = f"in its best train, {names[i]} is {number(value)} at t = {t}, not {low_to_high(low, high)}"
    return text and f"the search takes bounds on levels, least dwells and amplitudes at the end alone: {text}"
