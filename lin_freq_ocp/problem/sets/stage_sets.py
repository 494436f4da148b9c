"""The polyhedral part of the sets of (x_t, u_t): bounds, and rows beyond them, of one time or around all times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.terms.term import LinearRows, Term


@dataclass(frozen=True, eq=False)
class StageSet:
    """{v = (x, u) : lower <= v <= upper, matrix v <= limits}."""

    lower: Array  # (n + m,)
    upper: Array  # (n + m,)
    matrix: Array  # (rows, n + m)
    limits: Array  # (rows,)


@dataclass(frozen=True, eq=False)
class StageSets:
    """The sets of (x_t, u_t), t < T: bounds, rows of polyhedra, and joint rows that must hold; no balls, no cones."""

    states: Box  # bounds (T+1, n)
    controls: Box  # bounds (T, m)
    tube: Box  # the bounds of the states, with those of the ends
    rows: Sequence[LinearRows]  # beyond the bounds
    names: tuple[str, ...]  # of all terms of the problem

    @property
    def horizon(self) -> int:
        """Return T."""
        return len(self.controls.lower)

    def around(self) -> StageSet:
        """Return bounds around the sets of all times, with the rows that hold at all of them."""
        T = self.horizon
        lower = np.concatenate([self.states.lower[:T].min(0), self.controls.lower.min(0)])
        upper = np.concatenate([self.states.upper[:T].max(0), self.controls.upper.max(0)])
        fixed_start = T > 1 and self.tube.fixed[0].all()  # the rows of its sets are no terms
        needed = set(range(int(fixed_start), T))
        lasting = [rows for rows in self.rows if len(rows.C) == 1 and needed <= set(rows.times.tolist())]
        return _stage_set(lower, upper, [(rows.C[0], rows.e.max(0)) for rows in lasting])

    def at(self, t: int) -> StageSet:
        """Return the set of one time."""
        lower = np.append(self.tube.lower[t], self.controls.lower[t])
        upper = np.append(self.tube.upper[t], self.controls.upper[t])
        held = [(rows.matrix(int(k)), rows.e[k]) for rows in self.rows for k in np.flatnonzero(rows.times == t)]
        return _stage_set(lower, upper, held)

    @property
    def constant(self) -> bool:
        """Whether the sets, ends apart, are the same at all times."""
        T = self.horizon
        bounds = self.states.lower[:T], self.states.upper[:T], self.controls.lower, self.controls.upper
        rows = all(len(rows.C) == 1 and (rows.e == rows.e[0]).all() for rows in self.rows)
        return rows and all(bool((bound == bound[0]).all()) for bound in bounds)


def stage_sets(states: Box, controls: Box, tube: Box, terms: Sequence[Term]) -> StageSets:
    """Return the sets, from the bounds of states (T+1, n), of controls (T, m), of states with ends, and from terms."""
    T, rows = len(controls.lower), list[LinearRows]()
    for term in terms:
        found = term.polyhedron(states.lower.shape[1], controls.lower.shape[1])
        if found is not None and (inside := found.times < T).any():
            matrix = found.C if len(found.C) == 1 else found.C[inside]
            rows.append(LinearRows(found.name, found.times[inside], matrix, found.e[inside]))
    return StageSets(states, controls, tube, rows, tuple(term.name for term in terms))


def _stage_set(lower: Array, upper: Array, rows: Sequence[tuple[Array, Array]]) -> StageSet:
    matrix = np.vstack([np.zeros((0, len(lower))), *(matrix for matrix, _ in rows)])
    return StageSet(lower, upper, matrix, np.concatenate([np.zeros(0), *(limits for _, limits in rows)]))
