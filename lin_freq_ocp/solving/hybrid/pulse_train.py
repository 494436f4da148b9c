"""The method for pulse trains: branch and bound over angles, whose best is polished and judged."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.bound import RIGOROUS, Bound
from lin_freq_ocp.methods.candidate import zero_multipliers
from lin_freq_ocp.methods.hybrid.angle_lattice import AngleLattice, AngleRange, LatticePoint
from lin_freq_ocp.methods.hybrid.angles import AngleBound, local_angles
from lin_freq_ocp.methods.hybrid.quarter import Quarter
from lin_freq_ocp.methods.hybrid.smooth.local_optimum import LocalOptimum
from lin_freq_ocp.problem.hybrid.pulse_train import ANGLE, CURRENT, QUARTER, PulseTrain
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.solving.hybrid.certify_modes import best_multipliers
from lin_freq_ocp.solving.hybrid.smooth import outcome_of_search, refine_optimum
from lin_freq_ocp.solving.method import Request
from lin_freq_ocp.solving.outcome import Judged, Outcome
from lin_freq_ocp.transform.simulation import simulate

GAP = 1e-6  # default of the relative gap to prove
SHARE_OF_BOXES = 0.95  # of the time, after which the best train is refined and judged
LOCAL_WIDTH = 0.05  # half width of a box [rad] from which a local search starts at its centre
SAME_OPTIMUM = 0.01  # distance of angles [rad] of two trains of a lattice from which the local optimum is the same
FEW_ANGLES = 3  # boxes alone prove them within a second
FEW_TO_NARROW = 5  # angles up to which boxes prove the gap that the lattice leaves
LATTICES = 1000, 4000, 8000  # angles of a quarter: gaps of about 1, .1 and .03 % for eight switches
NARROWING, HALVINGS = (1000, 4000), 3  # angles of lattices that narrow boxes, and how often each side may halve
LEAST_OVER = 1e-12  # of a bound on the energy over the cutoff: its rounding is smaller
EXCLUDED_BY_BOXES = "proven by branch and bound: no box of angles contains a pulse train"
ANGLES = "branch and bound over boxes of the angles"


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
    >>> lfo.solve(problem, lfo.solvers.Angles(gap=1e-3)).status
    'optimal'
    """

    gap: float = GAP

    shorthand: ClassVar[str] = "angles"
    takes_start: ClassVar[bool] = True

    def solve(self, problem: OptimalControlProblem, request: Request) -> Outcome:
        """Halve boxes until the bound reaches the cost of the best local optimum, and judge that."""
        search = _TrainSearch(problem, self.gap, now(), request)
        message, interrupted = "", False
        try:
            message = search.run()
        except KeyboardInterrupt:
            message, interrupted = "interrupted", True
        return search.outcome(message, interrupted)


class _TrainSearch:
    """One search: the boxes, and the best train so far."""

    def __init__(self, problem: OptimalControlProblem, gap: float, started: float, request: Request):
        dynamics = problem.dynamics
        assert isinstance(dynamics, PulseTrain)
        self._problem, self._gap, self._started, self._request = problem, gap, started, request
        self._quarter = quarter = Quarter.of_problem(problem, dynamics)
        self._bound, self._dynamics = AngleBound(quarter), dynamics
        self._floor = -np.inf  # the bound of the lattice
        self._best: tuple[Array, Array] | None = None  # steps and angles
        self._cost = np.inf
        self._tried: set[tuple[bytes, bytes]] = set()

    def run(self) -> str:
        """Return why the search stopped early, or an empty string."""
        self._begin()
        end = self._started + SHARE_OF_BOXES * self._request.time_limit
        if self._problem.horizon - 1 > FEW_ANGLES and now() <= end:
            self._search_lattice(end)
            if self._problem.horizon - 1 > FEW_TO_NARROW and self._floor > -np.inf:
                done = now() <= end
                return f"{LATTICES[-1]} angles leave a gap" if done else f"time limit of {self._request.time_limit:g} s"
        while self._value < self._cutoff:
            if now() <= end and not self._bound.halve(self._cutoff, end):
                return "too many boxes of angles"
            if self._bound.widest < LOCAL_WIDTH:  # search near the best box of each pattern, once on this scale
                for steps, angles in self._bound.best():
                    if now() <= end:
                        self._look_once(steps, angles, LOCAL_WIDTH)
            if now() > end:
                return f"time limit of {self._request.time_limit:g} s"
        return ""

    def _search_lattice(self, end: float) -> None:
        """Bound all trains on lattices, finer ones while the gap is open, and look near the best trains of each."""
        quarter, count = self._quarter, self._problem.horizon - 1
        whole = AngleRange(np.zeros(count), np.full(count, QUARTER), np.zeros(count, dtype=np.intp))
        r = np.clip(0.0, quarter.low, quarter.high) / np.array(quarter.orders)
        with suppress(UnsupportedError):
            lattices = [AngleLattice(quarter, N) for N in (LATTICES if count > FEW_TO_NARROW else LATTICES[:1])]
            for coarser, lattice in zip([lattices[0], *lattices], lattices, strict=False):
                if lattice is not coarser and now() + coarser.seconds * (lattice.count / coarser.count) ** 2 > end:
                    return
                for point in lattice.best(whole, r, end):
                    if self._cost_at_least(point) > self._floor:
                        self._floor, r = self._cost_at_least(point), point.r
                    self._look_once(point.steps, point.angles, SAME_OPTIMUM)
                if self._floor >= self._cutoff:
                    return
            if count <= FEW_TO_NARROW:
                self._narrow(r, end)

    def _narrow(self, r: Array, end: float) -> None:
        """Raise the bounds of the boxes, one for each pattern of steps, and leave out what the lattice excludes."""
        boxes = self._bound.boxes
        low, high, bound = boxes.centre - boxes.radius, boxes.centre + boxes.radius, boxes.bound.copy()
        for lattice, (i, steps) in product([AngleLattice(self._quarter, N) for N in NARROWING], enumerate(boxes.steps)):
            if bound[i] >= self._cutoff:
                continue
            sign, r_best = np.sign(steps).astype(np.intp), r
            for point in lattice.best(AngleRange(low[i], high[i], sign), r, end, self._enough):
                if self._cost_at_least(point) > bound[i]:
                    bound[i], r_best = self._cost_at_least(point), point.r
                self._look_once(point.steps, point.angles, SAME_OPTIMUM)
            for j, side in product(range(len(sign)), (0, 1)):
                if bound[i] >= self._cutoff or now() + lattice.seconds > end:
                    break
                for _ in range(HALVINGS):
                    part = AngleRange(low[i].copy(), high[i].copy(), sign)
                    (part.high, part.low)[side][j] = middle = (low[i, j] + high[i, j]) / 2
                    if self._cost_at_least(lattice.bound(r_best, part, self._enough)) < self._cutoff:
                        break
                    (low, high)[side][i, j] = middle
            if now() > end:
                break
        self._bound.boxes = replace(boxes, centre=(low + high) / 2, radius=(high - low) / 2, bound=bound)
        self._bound.done = min(self._bound.done, self._cutoff)  # of the trains left out

    def _cost_at_least(self, point: LatticePoint) -> float:
        """Return the bound of the lattice on the cost."""
        return self._quarter.price * (point.bound + self._quarter.offset)

    @property
    def _enough(self) -> float:
        """Return the energy above which no train is of interest."""
        return self._cutoff / self._quarter.price - self._quarter.offset + LEAST_OVER

    def _begin(self) -> None:
        """Look near the start, if there is one: near its angles, or of a mode sequence, near equal dwells."""
        start, count = self._request.start, self._problem.horizon - 1
        if start is not None:
            steps = np.where(start.sequence[:count] == 0, self._dynamics.step, -self._dynamics.step)
            equal = QUARTER * np.arange(1, count + 1) / (count + 1)
            self._look_near(steps, equal if start.trajectory is None else start.trajectory.x[1:-1, ANGLE])

    def _look_once(self, steps: Array, angles: Array, width: float) -> None:
        """Look near these angles unless that was done within about a width."""
        key = steps.tobytes(), np.round(angles / width).tobytes()
        if steps.all() and key not in self._tried:  # a part without a train has no steps
            self._tried.add(key)
            self._look_near(steps, angles)

    def _look_near(self, steps: Array, angles: Array) -> None:
        """Keep the local optimum near these angles if it is the best so far."""
        local = local_angles(self._quarter, steps, angles)
        if local is not None and local[1] < self._cost:
            self._best, self._cost = (steps, local[0]), local[1]

    @property
    def _value(self) -> float:
        """Return the bound on the cost of every train."""
        return max(self._floor, self._bound.value)

    @property
    def _cutoff(self) -> float:
        """Return the bound at which the search ends: half of the gap is reserved for the refined answer."""
        return np.inf if self._best is None else self._cost - self._gap / 2 * abs(self._cost)

    def outcome(self, message: str, interrupted: bool) -> Outcome:
        """Return the refined answer with its bound, or why there is none."""
        solved, problem = now(), self._problem
        judged: Judged | None = None
        if self._best is not None:
            steps, angles = self._best
            every = np.append(steps, -np.sign(steps.sum() or -1.0) * self._dynamics.step)  # the last is to level 0
            dwell = np.diff(np.concatenate([[0.0], angles, [QUARTER]]))
            first = problem.ends[0].project(np.zeros(problem.state_dim))
            first[CURRENT] = -(steps * (QUARTER - angles)).sum()
            train = simulate(problem, np.column_stack([dwell, np.sign(every) / 2]), first)
            multipliers = best_multipliers(problem, train, zero_multipliers(problem, 1.0)).multipliers
            local = LocalOptimum((every < 0).astype(np.intp), train, multipliers, self._cost, 0.0)
            judged = refine_optimum(problem, local, self._started + self._request.time_limit)
            judged = judged.with_bound(Bound(self._value, RIGOROUS, sets=ANGLES))
            status = judged.certificate.status_within(self._gap)
            status = Status.LIMIT if status == Status.NUMERICAL_ERROR and message else status
        else:
            excluded = not message and self._value == np.inf
            status, message = (Status.INFEASIBLE, EXCLUDED_BY_BOXES) if excluded else (Status.LIMIT, message)
        ending = status, "" if status == Status.OPTIMAL else message
        seconds = {"setup": 0.0, "solve": solved - self._started, "certify": now() - solved}
        return outcome_of_search(problem, Angles.shorthand, judged, ending, seconds, interrupted)
