"""The answers to single inequalities, kept between solves: what an active row adds to the answer without it.

Without inequalities, the system of a step is that of the regulator with the rows that couple times, and is factored
once. A row a of G with the multiplier 1 adds -P G_a' to y. The rows that are active are equations for

    M lambda = G_A y_0 - g_A,   M = G_A P G_A',   y = y_0 - P G_A' lambda.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.methods.structured.kkt.dense import Cholesky
from lin_freq_ocp.methods.structured.kkt.reduction import StepSystem
from lin_freq_ocp.methods.structured.kkt.side import Side
from lin_freq_ocp.methods.structured.kkt.system import (
    DYNAMICS,
    EQUATIONS,
    INEQUALITIES,
    INITIAL,
    STAGES,
    System,
    Values,
)

MOST_NUMBERS = 5e6  # that are kept: 40 MB


class RowResponses:
    """The responses of a system without second-order cones; inequalities are flat, those of stages first."""

    def __init__(self, system: System, side: Side):
        self._system, self.step = system, StepSystem(system, side)
        for cone in system.cones.values():
            cone.leave_out()
        self.step.factor()
        self._places = np.full(len(flat(system.b)), -1)
        self._answers, self._values = np.empty((0, 0)), np.empty((0, len(self._places)))
        self._count = 0

    def prepare(self, rows: Indices, end: float = np.inf) -> bool:
        """Find the responses of these rows that are missing; return whether there is room for them, and time."""
        new, shapes = rows[self._places[rows] < 0], [part.shape for part in self._system.b]
        width = self._system.stages.h.size + sum(self._system.b[i].size for i in (DYNAMICS, INITIAL, EQUATIONS))
        self._reserve(len(new), width)
        if self._count + len(new) > len(self._answers):
            return False
        for row in new:
            if now() > end:
                return False
            unit = [np.zeros(shape) for shape in shapes]
            _add(unit, np.array([row]), np.ones(1))
            y, z = self.step.solve(-self._system.adjoint(unit), [np.zeros(shape) for shape in shapes], False)
            self._answers[self._count] = np.concatenate([y.ravel(), z[DYNAMICS].ravel(), z[INITIAL], z[EQUATIONS]])
            self._values[self._count] = flat(self._system.rows(y))
            self._places[row] = self._count
            self._count += 1
        return True

    def _reserve(self, new: int, width: int) -> None:
        """Make room for as many more responses, if there may be as many."""
        most = int(MOST_NUMBERS / (width + len(self._places)))
        room = min(most, max(self._count + new, 2 * len(self._answers)))
        if self._count + new > len(self._answers) and self._count + new <= room:
            kept = self._answers[: self._count], self._values[: self._count]
            self._answers, self._values = np.empty((room, width)), np.empty((room, len(self._places)))
            if self._count:
                self._answers[: self._count], self._values[: self._count] = kept

    def multipliers(self, rows: Indices, excess: Array) -> tuple[Array, Array]:
        """Return lambda for G_A y_0 - g_A of prepared rows, and by how much it changes the values of all rows."""
        values = self._values[self._places[rows]]
        found = Cholesky(-values[:, rows]).solve(excess)
        return found, found @ values

    def free(self, of_y: Array, of_z: Values) -> tuple[Array, Values]:
        """Return (y, z) with P y + A'z = of_y, A y = of_z, where no inequality counts."""
        return self.step.solve(of_y, of_z, False)

    def hold(self, y: Array, z: Values, of_z: Values, rows: Indices) -> None:
        """Change (y, z) of ``free`` to those where these rows, prepared, count as equations."""
        if not len(rows):
            return
        found, _ = self.multipliers(rows, flat(self._system.rows(y))[rows] - flat(of_z)[rows])
        change = found @ self._answers[self._places[rows]]
        ends = np.cumsum([y.size, *(z[i].size for i in (DYNAMICS, INITIAL))])
        for part, more in zip((y, z[DYNAMICS], z[INITIAL], z[EQUATIONS]), np.split(change, ends), strict=True):
            part += more.reshape(part.shape)
        _add(z, rows, found)


def flat(values: Values) -> Array:
    """Return the values of inequalities, those of stages first."""
    return np.concatenate([values[STAGES].ravel(), values[INEQUALITIES].ravel()])


def _add(z: Values, rows: Indices, multipliers: Array) -> None:
    """Add multipliers of inequalities to z."""
    count = z[STAGES].size
    of_stages = rows < count
    z[STAGES].flat[rows[of_stages]] += multipliers[of_stages]
    z[INEQUALITIES].flat[rows[~of_stages] - count] += multipliers[~of_stages]
