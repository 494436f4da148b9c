"""Which inequalities are active, from a trajectory near the answer: for solves again and again.

Active rows are equations, and the others are left out. Then rows with negative multipliers leave the active ones, and
broken rows enter them: of broken bounds of states, which move together, only the peaks. If this does not lower the
number of wrong rows, single ones change (block principal pivoting; Judice and Pires, Computers and Operations Research
21, 1994). The answer is exact to rounding. Where there is none so, the embedding answers.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.methods.structured.algorithm.embedding import Answer, Embedding, End, Errors, Point, Targets
from lin_freq_ocp.methods.structured.kkt.row_responses import RowResponses, flat
from lin_freq_ocp.methods.structured.kkt.system import INEQUALITIES, STAGES, System, Values

MOST_STEPS = 50  # of which few are needed near the answer; as many cost less than the embedding
TRIES = 5  # steps that do not lower the number of wrong rows before single ones change
REFINEMENTS = 3  # of the answer at most; the first takes back what regularises the system
TIGHT = 1e-6  # distance of a trajectory to a bound, in units of order 1, from which it is on it
ROUNDING = 1e-11  # by which a row is broken, or a multiplier negative, that stays as it is


def solve_active(system: System, responses: RowResponses, targets: Targets, near: Array) -> Answer | None:
    """Return the answer from the active rows of y (T+1, n+k) near it; None if it is not found so."""
    limits, present = flat(system.b), np.concatenate([cone.present.ravel() for cone in system.cones.values()])
    y, z = responses.free(-system.stages.h, system.b)
    alone, joint = flat(system.rows(y)) - limits, ~_of_states(system)
    active = present & (limits - flat(system.rows(near)) <= TIGHT)
    fewest, tries = len(limits) + 1, TRIES
    for step in range(1, MOST_STEPS + 1):
        rows = np.flatnonzero(active)
        if now() > targets.end or not responses.prepare(rows, targets.end):
            return None
        multipliers, change = responses.multipliers(rows, alone[rows])
        excess = np.where(present & ~active, np.maximum(alone + change - ROUNDING, 0.0), 0.0)
        wrong = excess > 0
        wrong[rows] = multipliers < -ROUNDING
        count = np.count_nonzero(wrong)
        if not count:
            responses.hold(y, z, system.b, rows)
            found = _refined(system, responses, targets, rows, y, z)
            return None if found is None else Answer(End.OPTIMAL, *found, step)
        tries = TRIES if count < fewest else tries - 1
        fewest = min(count, fewest)
        if tries > 0:
            wrong &= active | joint | _peaks(excess, system.b[STAGES].shape)
        else:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        active = active ^ wrong
    return None


def _refined(
    system: System, responses: RowResponses, targets: Targets, rows: Indices, y: Array, z: Values
) -> tuple[Array, Values, Errors] | None:
    """Return y and z with these active rows, refined until they are accurate enough; None if that does not help."""
    embedding = Embedding(system, responses.step, targets)
    left = [right - part for right, part in zip(system.b, system.rows(y), strict=True)]
    for _ in range(REFINEMENTS):
        dy, dz = responses.free(-system.stages.h - system.curvature(y) - system.adjoint(z), left)
        responses.hold(dy, dz, left, rows)
        y, z = y + dy, [a + b for a, b in zip(z, dz, strict=True)]
        left = [right - part for right, part in zip(system.b, system.rows(y), strict=True)]
        s = {i: np.maximum(left[i], 0.0) * cone.present for i, cone in system.cones.items()}
        positive = [np.maximum(part, 0.0) if i in s else part for i, part in enumerate(z)]
        errors = embedding.measured(Point(y, positive, s, 1.0, 0.0)).errors
        if errors.merit(targets) <= 1:
            return y, positive, errors
    return None


def _of_states(system: System) -> Mask:
    """Return which inequalities are rows of states alone."""
    of_stages = ~system.stages.G[:, :, system.stages.states :].any(axis=2).ravel()
    return np.concatenate([of_stages, np.zeros(system.b[INEQUALITIES].size, dtype=bool)])


def _peaks(excess: Array, shape: tuple[int, ...]) -> Mask:
    """Return where the excess of rows of stages, of this shape, is no less than a time before and larger than after."""
    stages = excess[: shape[0] * shape[1]].reshape(shape)
    edge, found = np.zeros((1, shape[1])), np.zeros(len(excess), dtype=bool)
    around = np.concatenate([edge, stages, edge])
    found[: stages.size] = ((stages >= around[:-2]) & (stages > around[2:])).ravel()
    return found
