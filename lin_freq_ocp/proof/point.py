"""The section POINT of a proof: controls near the optimal ones, whose trajectory is strictly inside all limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.certificate.peaks.proven import proven_peak
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.proof.lines import line, rows
from lin_freq_ocp.proof.held import needs_feedback, with_feedback
from lin_freq_ocp.proof.interior import interior
from lin_freq_ocp.proof.room import least_room, share_towards
from lin_freq_ocp.solving.outcome import Outcome

MARGINS = (2.0**-46, 2.0**-40, 2.0**-34, 2.0**-27, 2.0**-20)  # room to limits relative to sizes, tried in turn
LEVEL_MARGINS = 4  # by which the level of a soft mask is above the largest value found, if that is below the proven one


@dataclass(frozen=True, eq=False)
class Point:
    """Controls from an initial state, with the mode at every time and the levels of masks over all frequencies."""

    start: Array  # x_0, (n,)
    controls: Array  # (T, m)
    modes: list[int]
    levels: list[float]

    def lines(self) -> Iterator[str]:
        """Yield the section POINT."""
        yield line(section="point", x=self.start, levels=np.array(self.levels))
        for t, (u, mode) in enumerate(zip(rows(self.controls), self.modes, strict=True)):
            yield line(t=t, u=u, mode=mode)


def points(
    problem: OptimalControlProblem, outcome: Outcome, at: Trajectory, margins: Sequence[float] = MARGINS
) -> Iterator[tuple[Point, Trajectory]]:
    """Yield points with more and more room to all limits, and the trajectories that they are of.

    None is yielded if nothing is found that is strictly inside.
    """
    inner = None
    for margin in margins:
        if inner is None and least_room(problem, at) < margin:
            inner = interior(outcome, problem, at)
            if inner is None:
                return
        share = 0.0 if inner is None else share_towards(problem, at, inner, margin)
        if share < 1:
            found = at if inner is None else between(at, inner, share)
            found = with_feedback(problem, found) if needs_feedback(problem) else found
            yield point_of(problem, found, margin), found


def between(at: Trajectory, inner: Trajectory, share: float) -> Trajectory:
    """Return the trajectory at a share of the way from one to another."""
    return Trajectory(at.x + share * (inner.x - at.x), at.u + share * (inner.u - at.u))


def point_of(problem: OptimalControlProblem, at: Trajectory, margin: float) -> Point:
    """Return the point of a trajectory within its bounds; a margin is relative."""
    levels = list[float]()
    for term in problem.terms:
        if term.everywhere is not None:
            peak = proven_peak(term.everywhere, term.everywhere.map.signal(at.x, at.u))
            above = min(peak.found * (1 + LEVEL_MARGINS * margin), peak.ratio * (1 + margin))
            levels.append(1.0 if term.hard else max(1.0, above))
    start, u = problem.state_tube.project(at.x)[0], problem.control_tube.project(at.u)
    return Point(start, u, [0] * problem.horizon, levels)
