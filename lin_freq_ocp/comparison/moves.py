"""The shortest moves that leave no more than a residual vibration: of input shapers, and of the problem itself.

A shaper makes a move longer by its last impulse, and calmer. For each, the least profile is looked for, of those that
are optimal without the bound on the vibration, whose shaped control keeps all of the problem's constraints; the
vibration over the box is bounded with proof, for all moves alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import number
from lin_freq_ocp.batch.minimum_time.monotone import obstacles
from lin_freq_ocp.batch.minimum_time.search import Search, searched, stated
from lin_freq_ocp.certificate.peaks.cells import Peak
from lin_freq_ocp.certificate.peaks.proven import proven_peak
from lin_freq_ocp.certificate.tolerances import PEAK_TOLERANCE
from lin_freq_ocp.comparison.shapers import described, impulses, shaped
from lin_freq_ocp.comparison.trajectories import MeasuredTrajectory, replayed
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.reformulations import everywhere_of
from lin_freq_ocp.problem.terms.semi_infinite import PlantBox
from lin_freq_ocp.problem.terms.term import TermKind
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.outcome import Outcome

OURS, UNSHAPED = "optimal", "unshaped"
LONGEST = 4  # times the shortest profile: longer profiles are not tried
TRIED = 100  # profiles at most: of long moves, not every length is tried

Solve = Callable[[OptimalControlProblem], Outcome]


@dataclass(frozen=True, eq=False)
class Move:
    """A move of some samples: its name, how it is made, and its largest vibration over the box."""

    name: str
    description: str
    measured: MeasuredTrajectory | None  # None: there is none of at most so many samples
    samples: int
    sampling_time: float  # seconds
    peaks: tuple[Peak, ...] = ()  # of each control with a bound

    @property
    def seconds(self) -> float:
        """Return its duration, or the longest that was tried."""
        return self.samples * self.sampling_time

    def __str__(self) -> str:
        length = f"{self.samples} samples, {number(self.seconds, 4)} s"
        if self.measured is None:
            return f"none of at most {length}"
        return f"{length}, vibration at most {number(self.ratio, 4)} of its limit"

    @property
    def ratio(self) -> float | None:
        """Return the largest vibration over its limit, proven; None without a move."""
        return max((peak.ratio for peak in self.peaks), default=None)

    @property
    def keeps_everything(self) -> bool:
        """Whether it keeps all constraints of the problem, the bound on the vibration with proof."""
        found = self.measured
        if found is None or not found.meaningful or self.ratio is None or self.ratio > 1 + PEAK_TOLERANCE:
            return False
        parts = (found.controls, found.states, found.end, found.terms)
        return all(bool(part.passed.all()) for part in parts if part is not None)


@dataclass(frozen=True, eq=False)
class Moves:
    """The shortest moves: without a bound on the vibration, by shapers, and with the bound in the problem."""

    problem: OptimalControlProblem
    unshaped: Move
    shaped: tuple[Move, ...]
    ours: Move
    proof: bool  # that one sample less than ours is infeasible

    @property
    def all(self) -> tuple[Move, ...]:
        """Return all moves, that of the problem last."""
        return (self.unshaped, *self.shaped, self.ours)


def boxes_of(problem: OptimalControlProblem) -> tuple[PlantBox, ...]:
    """Return the boxes of modes that controls must not leave ringing."""
    terms = everywhere_of(problem, PlantBox)
    return tuple(box for term, box in terms if term.kind == TermKind.CONTROL_SPECTRUM)


def why_not_shaped(problem: OptimalControlProblem) -> str:
    """Say why input shapers are no competitors of a problem with a bound on residual vibrations; else nothing."""
    boxes = boxes_of(problem)
    if not boxes:
        return "no control has a bound on its residual vibration"
    if any((box.low != boxes[0].low).any() or (box.high != boxes[0].high).any() for box in boxes):
        return "the controls have boxes of modes that differ"
    try:
        stated(problem, problem.horizon + 1)
    except ProblemError as error:
        return f"{error.field}: it depends on time"
    return "; ".join(obstacles(lambda _: problem, 1, problem.horizon, same_data=True))


def shortest_moves(problem: OptimalControlProblem, solve: Solve, names: Sequence[str]) -> Moves:
    """Return the shortest moves of a problem for which ``why_not_shaped`` says nothing."""
    free = replace(problem, control_spectrum=None)
    before, ours = _least(free, solve), _least(problem, solve)
    plan = cache(lambda T: solve(stated(free, T)).trajectory)
    shortest = before.horizon or problem.horizon
    return Moves(
        problem,
        _of_search(UNSHAPED, "without the bound on the vibration", before, problem),
        tuple(_shaped_move(name, problem, plan, shortest) for name in names),
        _of_search(OURS, "with the bound in the problem", ours, problem),
        ours.horizon is not None and (ours.horizon == 1 or ours.horizon - 1 in ours.proven),
    )


def _least(problem: OptimalControlProblem, solve: Solve) -> Search:
    return searched(1, problem.horizon, True, lambda T: solve(stated(problem, T)))


def _of_search(name: str, description: str, search: Search, problem: OptimalControlProblem) -> Move:
    if search.best is None or search.best.trajectory is None:
        return Move(name, description, None, problem.horizon, boxes_of(problem)[0].sampling_time)
    trajectory = search.best.trajectory
    return _move(name, description, MeasuredTrajectory(name, stated(problem, len(trajectory.u)), trajectory))


def _shaped_move(
    name: str, problem: OptimalControlProblem, plan: Callable[[int], Trajectory | None], shortest: int
) -> Move:
    box = boxes_of(problem)[0]
    longer, description = len(impulses(name, box)) - 1, described(name, box)
    step = -(-(LONGEST - 1) * shortest // TRIED)
    description += "" if step == 1 else f"; profiles tried are {step} samples apart"
    for T in range(shortest, LONGEST * shortest, step):
        profile = plan(T)
        if profile is None:
            continue
        at = stated(problem, T + longer)
        held = np.concatenate([profile.x, np.repeat(profile.x[-1:], longer, axis=0)])
        u = shaped(name, box, profile.u)
        move = _move(name, description, replayed(name, at, u, Trajectory(held, u)))
        if move.keeps_everything:
            return move
    return Move(name, description, None, LONGEST * shortest + longer - 1, box.sampling_time)


def _move(name: str, description: str, measured: MeasuredTrajectory) -> Move:
    x, u = measured.trajectory.x, measured.trajectory.u
    boxes = boxes_of(measured.problem)
    peaks = tuple(proven_peak(box, box.map.signal(x, u)) for box in boxes)
    return Move(name, description, measured, len(u), boxes[0].sampling_time, peaks)
