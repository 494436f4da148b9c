"""The method for pulse trains: branch and bound over angles, whose best is refined by Newton's method and judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.bound import RIGOROUS, Bound
from lin_freq_ocp.methods.candidate import zero_multipliers
from lin_freq_ocp.methods.hybrid.angles import AngleBound, local_angles
from lin_freq_ocp.methods.hybrid.smooth.local_optimum import LocalOptimum
from lin_freq_ocp.problem.hybrid.pulse_train import ANGLE, CURRENT, QUARTER, PulseTrain
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.solving.hybrid.smooth import outcome_of_search, refine_optimum
from lin_freq_ocp.solving.method import Request
from lin_freq_ocp.solving.outcome import Judged, Outcome
from lin_freq_ocp.transform.simulation import simulate

GAP = 1e-6  # default of the relative gap to prove
SHARE_OF_BOXES = 0.95  # of the time, after which the best train is refined and judged
LOCAL_WIDTH = 0.05  # half width of a box [rad] from which a local search starts at its centre
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
        self._bound, self._dynamics = AngleBound(problem, dynamics), dynamics
        self._best: tuple[Array, Array] | None = None  # steps and angles
        self._cost = np.inf
        self._tried: set[tuple[bytes, bytes]] = set()

    def run(self) -> str:
        """Return why the search stopped early, or an empty string."""
        self._begin()
        end = self._started + SHARE_OF_BOXES * self._request.time_limit
        while self._bound.value < self._cutoff:
            if now() <= end and not self._bound.halve(self._cutoff, end):
                return "too many boxes of angles"
            if self._bound.widest < LOCAL_WIDTH:  # search near the best box of each pattern, once on this scale
                for steps, angles in self._bound.best():
                    key = steps.tobytes(), np.round(angles / LOCAL_WIDTH).tobytes()
                    if now() <= end and key not in self._tried:
                        self._tried.add(key)
                        self._look_near(steps, angles)
            if now() > end:
                return f"time limit of {self._request.time_limit:g} s"
        return ""

    def _begin(self) -> None:
        """Look near the start, if there is one: near its angles, or of a mode sequence, near equal dwells."""
        start, count = self._request.start, self._problem.horizon - 1
        if start is not None:
            steps = np.where(start.sequence[:count] == 0, self._dynamics.step, -self._dynamics.step)
            equal = QUARTER * np.arange(1, count + 1) / (count + 1)
            self._look_near(steps, equal if start.trajectory is None else start.trajectory.x[1:-1, ANGLE])

    def _look_near(self, steps: Array, angles: Array) -> None:
        """Keep the local optimum near these angles if it is the best so far."""
        local = local_angles(self._bound, steps, angles)
        if local is not None and local[1] < self._cost:
            self._best, self._cost = (steps, local[0]), local[1]

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
            local = LocalOptimum((every < 0).astype(np.intp), train, zero_multipliers(problem, 1.0), self._cost, 0.0)
            judged = refine_optimum(problem, local, self._started + self._request.time_limit)
            judged = judged.with_bound(Bound(self._bound.value, RIGOROUS, sets=ANGLES))
            status = judged.certificate.status_within(self._gap)
            status = Status.LIMIT if status == Status.NUMERICAL_ERROR and message else status
        else:
            excluded = not message and self._bound.value == np.inf
            status, message = (Status.INFEASIBLE, EXCLUDED_BY_BOXES) if excluded else (Status.LIMIT, message)
        ending = status, "" if status == Status.OPTIMAL else message
        seconds = {"setup": 0.0, "solve": solved - self._started, "certify": now() - solved}
        return outcome_of_search(problem, Angles.shorthand, judged, ending, seconds, interrupted)
