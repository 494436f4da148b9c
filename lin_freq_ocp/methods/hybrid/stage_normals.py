"""The normal cone of the sets and rows of one stage at (x_t, u_t), by generators, with the multiplier behind each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.sizes import stated_sizes
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

ACTIVE_DISTANCE = 1e-6  # distance, relative to its size, at which a bound or row is active: what the judge accepts
STATE, CONTROL = "mu", "nu"  # the fields of Multipliers that are normals to boxes; other families are names of terms


@dataclass(frozen=True, eq=False)
class Normal:
    """An active bound or row of a stage.

    Attributes
    ----------
    family : str
        STATE, CONTROL, or the name of a term.
    place : (int, int)
        Index of its multiplier in the array of the family.
    sign : float
        1, or -1 for a lower bound, whose multiplier is negative.
    column : (n + m,)
        What a multiplier of ``sign`` adds to the normal (in x, in u).
    """

    family: str
    place: tuple[int, int]
    sign: float
    column: Array

    def value(self, multipliers: Multipliers) -> float:
        """Return how much of the column the multipliers have; of a fixed component, both signs have it."""
        own = {STATE: multipliers.mu, CONTROL: multipliers.nu}
        array = own.get(self.family, multipliers.stage.get(self.family))
        return 0.0 if array is None else max(self.sign * float(array[self.place]), 0.0)


def stage_normals(problem: OptimalControlProblem, trajectory: Trajectory) -> list[list[Normal]]:
    """Return the active bounds of x_t and u_t and the active hard rows of t alone, for t = 0 .. T-1.

    Balls, cones and soft sets are not among them: their multipliers are kept.
    """
    found: list[list[Normal]] = [[] for _ in range(problem.horizon)]
    sizes, signals = stated_sizes(problem), (trajectory.x[:-1], trajectory.u)
    tubes, first = (problem.state_tube, problem.control_tube), 0
    for family, signal, tube, size in zip((STATE, CONTROL), signals, tubes, sizes, strict=True):
        for t, normal in _of_box(family, signal, tube, size, first, problem.state_dim + problem.control_dim):
            found[t].append(normal)
        first = problem.state_dim
    for term in problem.terms:
        for t, normal in _of_rows(term, trajectory, problem.horizon):
            found[t].append(normal)
    return found


def _of_box(family: str, signal: Array, tube: Box, size: Array, first: int, total: int) -> Iterator[tuple[int, Normal]]:
    near = ACTIVE_DISTANCE * (size + np.abs(signal))
    lower, upper = tube.lower[: len(signal)], tube.upper[: len(signal)]
    for sign, active in ((1.0, signal >= upper - near), (-1.0, signal <= lower + near)):
        for t, k in np.argwhere(active):
            column = np.zeros(total)
            column[first + k] = sign
            yield int(t), Normal(family, (int(t), int(k)), sign, column)


def _of_rows(term: Term, trajectory: Trajectory, horizon: int) -> Iterator[tuple[int, Normal]]:
    rows = term.polyhedron(trajectory.x.shape[1], trajectory.u.shape[1])
    if rows is None:
        return
    values = term.map.values(trajectory.x, trajectory.u)
    sizes = term.map.sizes(trajectory.x, trajectory.u).max(0)
    near = ACTIVE_DISTANCE * np.where(sizes > 0, sizes, 1.0)
    for group, row in np.argwhere(values >= term.penalty.bounds(term.shape)[1] - near):
        if rows.times[group] < horizon:
            place = int(group), int(row)
            yield int(rows.times[group]), Normal(term.name, place, 1.0, rows.matrix(int(group))[row])
