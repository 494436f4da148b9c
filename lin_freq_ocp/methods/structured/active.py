"""Block principal pivoting from a trajectory near the answer, for problems that are solved many times.

Each step solves the problem with the active rows as equations and without the other rows. Then rows with negative
multipliers leave the active set, and violated rows enter it; of violated bounds of states, which move together, only
the peaks enter. If the number of wrong rows does not fall, one row changes at a time (Judice and Pires, Computers and
Operations Research 21, 1994). The answer is exact to rounding. If pivoting fails, the embedding solves the problem.

Without inequalities, the system of a step is that of the regulator with the coupling rows, and is factored once. A row
a of G with the multiplier 1 adds -P G_a' to y; these responses are cached between solves. The active rows A satisfy

    M lambda = G_A y_0 - g_A,   M = G_A P G_A',   y = y_0 - P G_A' lambda.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.methods.structured.embedding import Answer, EmbeddedPoint, Embedding, End, Errors, Targets
from lin_freq_ocp.methods.structured.kkt.dense import Cholesky
from lin_freq_ocp.methods.structured.kkt.system import (
    DYNAMICS,
    EQUATIONS,
    INEQUALITIES,
    INITIAL,
    STAGES,
    KKTSolver,
    StepSystem,
    System,
    Values,
)

MOST_STEPS = 50  # few are needed near the answer, and as many cost less than the embedding
TRIES = 5  # steps without fewer wrong rows, after which one row changes at a time
REFINEMENTS = 3  # of the answer at most; the first corrects for the regularisation of the system
TIGHT = 1e-6  # distance of a trajectory to a bound, in units of order 1, below which the row is active
ROUNDING = 1e-11  # violation of a row, or negative multiplier, that is a rounding error
MOST_NUMBERS = 5e6  # in the cache: 40 MB


def solve_active(system: System, responses: RowResponses, targets: Targets, start: Array) -> Answer | None:
    """Return the answer, beginning with the active rows of ``start`` (T+1, n+k); None if pivoting fails."""
    limits, present = (
        flatten_inequalities(system.b),
        np.concatenate([cone.present.ravel() for cone in system.cones.values()]),
    )
    y, z = responses.step.solve(-system.stages.h, system.b, False)  # without inequalities
    unconstrained = flatten_inequalities(system.rows(y)) - limits
    active = present & (limits - flatten_inequalities(system.rows(start)) <= TIGHT)
    # violated rows of controls enter all at once; rows of states alone only at peaks
    of_controls = np.concatenate(
        [
            system.stages.G[:, :, system.stages.states :].any(axis=2).ravel(),
            np.ones(system.b[INEQUALITIES].size, dtype=bool),
        ]
    )
    fewest, tries = len(limits) + 1, TRIES
    for step in range(1, MOST_STEPS + 1):
        rows = np.flatnonzero(active)
        if now() > targets.end or not responses.prepare(rows, targets.end):
            return None
        multipliers, change = responses.multipliers(rows, unconstrained[rows])
        violation = np.where(present & ~active, np.maximum(unconstrained + change - ROUNDING, 0.0), 0.0)
        wrong = violation > 0
        wrong[rows] = multipliers < -ROUNDING
        count = np.count_nonzero(wrong)
        if not count:
            responses.activate(y, z, system.b, rows)
            refined = _refine(system, responses, targets, rows, y, z)
            return None if refined is None else Answer(End.OPTIMAL, *refined, step)
        tries = TRIES if count < fewest else tries - 1
        fewest = min(count, fewest)
        if tries > 0:
            # at a peak, a row is violated by no less than a time before, and by more than a time after
            peaks, shape = np.zeros_like(wrong), system.b[STAGES].shape
            stages, edge = violation[: system.b[STAGES].size].reshape(shape), np.zeros((1, shape[1]))
            around = np.concatenate([edge, stages, edge])
            peaks[: stages.size] = ((stages >= around[:-2]) & (stages > around[2:])).ravel()
            wrong &= active | of_controls | peaks
        else:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        active = active ^ wrong
    return None


def _refine(
    system: System, responses: RowResponses, targets: Targets, rows: Indices, y: Array, z: Values
) -> tuple[Array, Values, Errors] | None:
    """Return y and z with these active rows, refined until they reach the targets; None if refinement does not."""
    embedding = Embedding(system, responses.step, targets)
    residual = [right - part for right, part in zip(system.b, system.rows(y), strict=True)]
    for _ in range(REFINEMENTS):
        dy, dz = responses.step.solve(-system.stages.h - system.curvature(y) - system.adjoint(z), residual, False)
        responses.activate(dy, dz, residual, rows)
        y, z = y + dy, [a + b for a, b in zip(z, dz, strict=True)]
        residual = [right - part for right, part in zip(system.b, system.rows(y), strict=True)]
        s = {i: np.maximum(residual[i], 0.0) * cone.present for i, cone in system.cones.items()}
        positive = [np.maximum(part, 0.0) if i in s else part for i, part in enumerate(z)]
        errors = embedding.measure(EmbeddedPoint(y, positive, s, 1.0, 0.0)).errors
        if errors.merit(targets) <= 1:
            return y, positive, errors
    return None


class RowResponses:
    """Cached responses of a system without second-order cones; inequalities are flat, those of stages first."""

    def __init__(self, system: System, solver: KKTSolver):
        self._system, self.step = system, StepSystem(system, solver)
        for cone in system.cones.values():
            cone.leave_out()
        self.step.factor()
        self._slots = np.full(len(flatten_inequalities(system.b)), -1)
        self._answers, self._values = np.empty((0, 0)), np.empty((0, len(self._slots)))
        self._count = 0

    def prepare(self, rows: Indices, end: float = np.inf) -> bool:
        """Compute the missing responses of these rows; return False if the cache is full or the time over."""
        new, shapes = rows[self._slots[rows] < 0], [part.shape for part in self._system.b]
        width = self._system.stages.h.size + sum(self._system.b[i].size for i in (DYNAMICS, INITIAL, EQUATIONS))
        # the cache is extended for as many new responses, if the limit allows them
        most, count = int(MOST_NUMBERS / (width + len(self._slots))), self._count + len(new)
        size = min(most, max(count, 2 * len(self._answers)))
        if len(self._answers) < count <= size:
            cached = self._answers[: self._count], self._values[: self._count]
            self._answers, self._values = np.empty((size, width)), np.empty((size, len(self._slots)))
            if self._count:  # else of width 0
                self._answers[: self._count], self._values[: self._count] = cached
        if count > len(self._answers):
            return False
        for row in new:
            if now() > end:
                return False
            unit = [np.zeros(shape) for shape in shapes]
            _add_multipliers(unit, np.array([row]), np.ones(1))
            y, z = self.step.solve(-self._system.adjoint(unit), [np.zeros(shape) for shape in shapes], False)
            self._answers[self._count] = np.concatenate([y.ravel(), z[DYNAMICS].ravel(), z[INITIAL], z[EQUATIONS]])
            self._values[self._count] = flatten_inequalities(self._system.rows(y))
            self._slots[row] = self._count
            self._count += 1
        return True

    def multipliers(self, rows: Indices, violation: Array) -> tuple[Array, Array]:
        """Return lambda for violations G_A y_0 - g_A of cached rows, and the change of the values of all rows."""
        values = self._values[self._slots[rows]]
        multipliers = Cholesky(-values[:, rows]).solve(violation)
        return multipliers, multipliers @ values

    def activate(self, y: Array, z: Values, of_z: Values, rows: Indices) -> None:
        """Change the solution (y, z) of ``step`` without inequalities to that with these rows as equations."""
        if not len(rows):
            return
        multipliers, _ = self.multipliers(
            rows, flatten_inequalities(self._system.rows(y))[rows] - flatten_inequalities(of_z)[rows]
        )
        change = multipliers @ self._answers[self._slots[rows]]
        ends = np.cumsum([y.size, *(z[i].size for i in (DYNAMICS, INITIAL))])
        for part, more in zip((y, z[DYNAMICS], z[INITIAL], z[EQUATIONS]), np.split(change, ends), strict=True):
            part += more.reshape(part.shape)
        _add_multipliers(z, rows, multipliers)


def flatten_inequalities(values: Values) -> Array:
    """Return the values of inequalities, those of stages first."""
    return np.concatenate([values[STAGES].ravel(), values[INEQUALITIES].ravel()])


def _add_multipliers(z: Values, rows: Indices, multipliers: Array) -> None:
    """Add the multipliers of inequalities to z, in place."""
    count = z[STAGES].size
    of_stages = rows < count
    z[STAGES].flat[rows[of_stages]] += multipliers[of_stages]
    z[INEQUALITIES].flat[rows[~of_stages] - count] += multipliers[~of_stages]
