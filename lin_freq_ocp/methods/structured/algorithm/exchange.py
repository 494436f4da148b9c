"""Masks on a fine grid by exchange: few of their points matter, and which do is found by solving with few.

The first solves, to rough targets, take the points of the plain DFT, then those near the mask and the largest
violations between them; the last solve has every point that is violated without it. A ray of few points is one of all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from lin_freq_ocp.arrays import Array, Indices
from lin_freq_ocp.methods.structured.algorithm.embedding import Answer, Embedding, End, Targets
from lin_freq_ocp.methods.structured.kkt.reduction import StepSystem
from lin_freq_ocp.methods.structured.kkt.system import BALLS, System, Values
from lin_freq_ocp.methods.structured.model.coupling import Balls
from lin_freq_ocp.methods.structured.model.stages import Stages

FEWER = 64  # balls of a family up to which all are taken at once
NEAR = 0.7  # of the limit, the magnitude from which a point is kept after the first solve
ROUGH = 1e4  # times the targets, those of the solves that only choose points
VIOLATED = 1e-9  # excess, relative to the limit, from which a point is added
MOST_ROUNDS = 12  # 3 to 5 are needed


def solve_with_exchange(
    stages: Stages, step_system: Callable[[System], StepSystem], targets: Targets, believed: Callable[[Values], bool]
) -> Answer:
    """Return the answer for all rows."""
    families = stages.coupling.balls
    chosen = [_first(part) for part in families]
    everything = all(len(points) == len(part.radius) for points, part in zip(chosen, families, strict=True))
    if everything:
        return _solve(stages, chosen, step_system, targets, believed)
    rough = replace(targets, residual=ROUGH * targets.residual, gap=ROUGH * targets.gap)
    final, first = False, True
    answer = _solve(stages, chosen, step_system, rough, believed)
    for _ in range(MOST_ROUNDS):
        if answer.end is not End.OPTIMAL:
            return answer
        added = [_violated(part, stages, answer.y, rough.residual if not final else VIOLATED) for part in families]
        if all(len(np.setdiff1d(new, old)) == 0 for new, old in zip(added, chosen, strict=True)):
            if final:
                return answer
            final = True
        if first:
            chosen = [_near(part, stages, answer.y, old) for part, old in zip(families, chosen, strict=True)]
            first = False
        chosen = [np.union1d(old, new) for old, new in zip(chosen, added, strict=True)]
        answer = _solve(stages, chosen, step_system, targets if final else rough, believed)
    return replace(answer, end=End.STALLED)


def _solve(
    stages: Stages,
    chosen: Sequence[Indices],
    step_system: Callable[[System], StepSystem],
    targets: Targets,
    believed: Callable[[Values], bool],
) -> Answer:
    families = stages.coupling.balls
    balls = tuple(part.picked(points) for part, points in zip(families, chosen, strict=True))
    system = System(replace(stages, coupling=replace(stages.coupling, balls=balls)))

    def complete(z: Values) -> Values:
        rows = [np.zeros((len(part.radius), 1 + part.dim)) for part in families]
        for every, points, own in zip(rows, chosen, z[BALLS:], strict=True):
            every[points] = own
        return [*z[:BALLS], *rows]

    answer = Embedding(system, step_system(system), targets, lambda z: believed(complete(z))).run()
    return replace(answer, z=complete(answer.z))


def _first(part: Balls) -> Indices:
    """Return the points of the first solve."""
    count = len(part.radius)
    return np.arange(0, count, 1 if count <= FEWER else part.rows.oversampling)


def _relative(part: Balls, stages: Stages, y: Array) -> Array:
    """Return the magnitude of every point relative to its limit, (balls,)."""
    channels = stages.coupling.channels
    values = part.rows.forward(y[:, channels, None]).reshape(-1, part.dim) + part.right[:, 1:]
    limits = part.radius
    if part.heads is not None:
        limits = limits + part.heads.forward(y[:, channels, None])[:, 0]
    return np.linalg.norm(values, axis=1) / np.maximum(limits, np.finfo(float).tiny)


def _violated(part: Balls, stages: Stages, y: Array, tolerance: float) -> Indices:
    """Return the violated points that no neighbour exceeds."""
    size = np.pad(_relative(part, stages, y), 1, constant_values=-np.inf)
    peak = (size[1:-1] >= size[:-2]) & (size[1:-1] >= size[2:])
    return np.flatnonzero(peak & (size[1:-1] > 1 + tolerance))


def _near(part: Balls, stages: Stages, y: Array, chosen: Indices) -> Indices:
    """Return the chosen points at which the mask may be met."""
    if len(chosen) == len(part.radius):
        return chosen
    return chosen[_relative(part, stages, y)[chosen] >= NEAR]
