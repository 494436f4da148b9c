"""How far a trajectory is from violating inequalities: what is left to every limit, and how much two share of it.

Room is concave along the way from one trajectory to another: of (1 - s) z + s z' it is at least (1 - s) r + s r'.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.certificate.peaks.proven import proven_peak
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.trajectory import Trajectory


def rooms(problem: OptimalControlProblem, at: Trajectory) -> Iterator[tuple[Array, Array]]:
    """Yield what is left to the limits of each kind, and the sizes that its rounding errors are relative to."""
    yield from _of_box(problem.state_tube, at.x)
    yield from _of_box(problem.control_tube, at.u)
    for term in problem.terms:
        if not term.hard:
            continue
        if term.everywhere is not None:
            peak = proven_peak(term.everywhere, term.everywhere.map.signal(at.x, at.u))
            yield np.array([1 - peak.found]), np.ones(1)
            continue
        values = term.map.values(at.x, at.u)
        excess = np.where(np.isinf(term.penalty.weights), term.penalty.excess(values), -np.inf)
        lower, upper = term.penalty.hard_bounds(term.shape)
        equation = (lower == upper) if excess.shape == lower.shape else (lower == upper).all(axis=1, keepdims=True)
        yield (
            np.where(equation, np.inf, -excess).ravel(),
            np.broadcast_to(term.map.sizes(at.x, at.u).max(initial=0.0), excess.size),
        )


def _of_box(box: Box, signal: Array) -> Iterator[tuple[Array, Array]]:
    size = np.broadcast_to(np.abs(signal).max(axis=0, initial=0.0), signal.shape)
    for room in (box.upper - signal, signal - box.lower):
        yield np.where(box.fixed, np.inf, room).ravel(), size.ravel()


def least_room(problem: OptimalControlProblem, at: Trajectory) -> float:
    """Return the least room, relative to sizes."""
    return min(
        (float((room / np.where(size > 0, size, 1.0)).min(initial=np.inf)) for room, size in rooms(problem, at)),
        default=np.inf,
    )


def share_towards(problem: OptimalControlProblem, at: Trajectory, inner: Trajectory, margin: float) -> float:
    """Return the least share of the way to an inner trajectory, at most 1, at which all room is a margin of sizes."""
    share = 0.0
    for (room, size), (more, _) in zip(rooms(problem, at), rooms(problem, inner), strict=True):
        missing = margin * size - room
        short = missing > 0
        gained = np.maximum(more[short] - room[short], missing[short])
        share = max(share, float((missing[short] / gained).max(initial=0.0)))
    return share
