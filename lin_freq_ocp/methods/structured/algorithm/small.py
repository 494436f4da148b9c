"""Small problems by few calls of compiled code: nodes of a search, steps of a controller.

The method and the steps are those of the embedding. What is different: rows that couple times are equations, and few;
the system of a step is refined only after a step that left more than it should; a ray is believed early (who uses it
checks it); and the iteration may stop at a dual objective beyond a cutoff.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from lin_freq_ocp.arrays import Array, Indices
from lin_freq_ocp.methods.structured.algorithm.embedding import (
    LEAST_TAU,
    MOST_STEPS,
    RAY,
    STALLED,
    VANISHED,
    Answer,
    Embedding,
    End,
    Errors,
    Targets,
)
from lin_freq_ocp.methods.structured.kkt.recursions import loops
from lin_freq_ocp.methods.structured.kkt.reduction import StepSystem
from lin_freq_ocp.methods.structured.kkt.stopped_side import stopped_side
from lin_freq_ocp.methods.structured.kkt.system import System
from lin_freq_ocp.methods.structured.model.stages import Stages

if TYPE_CHECKING:
    from lin_freq_ocp.methods.structured.kkt.compiled.small import Data, Numbers

TERMINAL = 1e2  # weight of a terminal row in the regulator, in units of the largest entry of H
LEAST_WEIGHT = 1e-3  # of these entries
EARLY = 1e-2  # tau, relative to kappa, below which a ray is believed early
EARLY_RAY = 1e-7  # at this residual relative to b'z: bounds of the rows make up for it
CUT_RESIDUAL = 1e-7  # dual residual from which a dual objective counts
EXPECTED = 3.0  # residual after a step, in units of what Newton's method leaves, from which systems are refined


def is_small(stages: Stages) -> bool:
    """Whether ``solve_small`` takes a problem: all its rows that couple times are equations."""
    return not stages.coupling.inequalities and not stages.coupling.balls


def small_is_compiled() -> bool:
    """Whether the code of ``solve_small`` is compiled and cached; it takes longer than most solves."""
    if find_spec("numba") is None:
        return False
    from lin_freq_ocp.methods.structured.kkt.compiled import small

    return small.KERNELS.ready


def solve_small(
    stages: Stages,
    targets: Targets | None = None,
    cutoff: float = np.inf,
    steps: int = MOST_STEPS,
    compiled: bool | None = None,
    patient: bool = True,
) -> Answer:
    """Return the answer of the embedding, or End.CUTOFF with a point whose dual objective is beyond a cutoff.

    Rays are believed early, and dual objectives count from small residuals on: who draws conclusions verifies them. Of
    the targets, the time is not watched. ``compiled`` and ``patient`` are those of ``recursions.loops``; without
    compiled code, the embedding answers, and heeds neither the cutoff nor the number of steps.
    """
    targets = targets or Targets()
    if compiled is None:
        compiled = find_spec("numba") is not None
    if compiled:
        from lin_freq_ocp.methods.structured.kkt.compiled import small

        if patient or small.KERNELS.ready:
            small.KERNELS.prepare()
            return _Solve(stages, targets, cutoff - stages.constant, steps).run()
    plain = loops(compiled=False)
    system = System(stages, plain)
    return Embedding(system, StepSystem(system, stopped_side(stages, plain)), targets).run()


@dataclass(frozen=True, eq=False)
class _Record:
    """A point and what is known of it."""

    numbers: Numbers
    errors: Errors
    step: int
    y: Array
    z: Array


class _Solve:
    """One solve; flat arrays and numbers as in compiled/small.py."""

    def __init__(self, stages: Stages, targets: Targets, cutoff: float, steps: int):
        from lin_freq_ocp.methods.structured.kkt.compiled import small

        self._kernels, self._stages, self._targets = small, stages, targets
        self._cutoff, self._most, self._where = cutoff, steps, _present_rows(stages)
        data = self._data = _data(stages, self._where, small.Data)
        self._stop = len(data.b) - len(data.weights)
        self._start = self._stop - len(data.G)
        self._sizes = 1 + float(np.abs(data.h).max()), 1 + float(np.abs(data.b).max(initial=0.0))
        unit = np.zeros(len(data.G))
        unit[: data.ends[0]] = unit[data.ends[:-1]] = 1.0
        z = np.zeros(len(data.b))
        z[self._start : self._stop] = unit
        self._point = np.zeros(len(data.h)), z, unit
        self._residuals = np.empty(len(data.h)), np.empty(len(data.b)), np.empty(len(data.h))
        self._numbers = np.ones(small.NUMBERS)

    def run(self) -> Answer:
        """Iterate until the targets, a ray, the cutoff, or a stall."""
        self._kernels.advance(self._data, self._point, self._residuals, self._numbers, True, False)
        refine, best = False, self._best(self._record(0))
        for step in range(self._most + 1):
            record = self._record(step)
            end = self._ended(record)
            if end is not None:
                return self._answer(end, record)
            if record.errors.merit(self._targets) < best.errors.merit(self._targets):
                best = self._best(record)
            numbers, errors = record.numbers, record.errors
            vanishing = numbers.tau < VANISHED * min(1.0, numbers.kappa)
            stalled = step - best.step > STALLED and not vanishing
            if stalled or numbers.tau < LEAST_TAU or not np.isfinite(sum(errors)):
                break
            self._kernels.advance(self._data, self._point, self._residuals, self._numbers, False, refine)
            refine |= self._inexact(numbers)
        return self._answer(End.STALLED, best)

    @staticmethod
    def _best(record: _Record) -> _Record:
        return replace(record, y=record.y.copy(), z=record.z.copy())

    def _record(self, step: int) -> _Record:
        numbers = self._kernels.Numbers(*self._numbers.tolist())
        return _Record(numbers, self._errors(numbers), step, *self._point[:2])

    def _errors(self, numbers: Numbers) -> Errors:
        tau = numbers.tau
        cost, bound = 0.5 * numbers.yPy / tau**2 + numbers.hy / tau, self._bound(numbers)
        return Errors(
            numbers.size_f_z / tau / (self._sizes[1] + numbers.size_y / tau),
            numbers.size_f_y / tau / (self._sizes[0] + max(numbers.size_Py, numbers.size_z) / tau),
            abs(cost - bound) / max(1.0, min(abs(cost), abs(bound))),
        )

    @staticmethod
    def _bound(numbers: Numbers) -> float:
        return -0.5 * numbers.yPy / numbers.tau**2 - numbers.bz / numbers.tau

    def _ended(self, record: _Record) -> End | None:
        """Return how the iteration ends at a point, if it does."""
        numbers, errors = record.numbers, record.errors
        least = min(1.0, numbers.kappa)
        if errors.merit(self._targets) <= 1:
            return End.OPTIMAL
        ray = max(numbers.size_Atz, numbers.size_Py)
        if numbers.bz < 0 and ray <= (EARLY_RAY if numbers.tau < EARLY * least else RAY) * -numbers.bz:
            return End.INFEASIBLE
        descent = max(numbers.size_Ays, numbers.size_Py)
        if numbers.hy < 0 and numbers.tau < VANISHED * least and descent <= RAY * -numbers.hy:
            return End.UNBOUNDED
        if self._bound(numbers) > self._cutoff and errors.dual <= CUT_RESIDUAL:
            return End.CUTOFF
        return None

    def _inexact(self, before: Numbers) -> bool:
        """Whether a step left more of the residuals than it should."""
        now = self._kernels.Numbers(*self._numbers.tolist())
        left, least = EXPECTED * max(now.left, 0.0), self._targets.residual * now.tau
        return now.size_f_y > left * before.size_f_y + least or now.size_f_z > left * before.size_f_z + least

    def _answer(self, end: End, record: _Record) -> Answer:
        stages, T, n = self._stages, self._stages.horizon, self._stages.states
        numbers = record.numbers
        unit = {End.INFEASIBLE: -numbers.bz, End.UNBOUNDED: -numbers.hy}.get(end, numbers.tau)
        y, z = record.y / unit, record.z / unit
        of_stages = np.zeros(stages.g.shape)
        of_stages[self._where] = z[self._start : self._stop]
        eta, initial = z[: (T + 1) * n].reshape(T + 1, n), z[(T + 1) * n : self._start]
        rows = [eta, initial, of_stages, z[self._stop :], np.zeros((0, 1))]
        return Answer(end, y.reshape(stages.h.shape), rows, record.errors, record.step)


def _present_rows(stages: Stages) -> tuple[Indices, Indices]:
    """Return times and rows of what is present: entries >= 0, then each cone as a whole."""
    linear = stages.g.shape[1] - sum(stages.cones)
    present, firsts = stages.present, np.cumsum([linear, *stages.cones])[:-1]
    times, rows = np.nonzero(present[:, :linear])
    for first, size in zip(firsts, stages.cones, strict=True):
        at = np.flatnonzero(present[:, first])
        times = np.concatenate([times, np.repeat(at, size)])
        rows = np.concatenate([rows, np.tile(np.arange(first, first + size), len(at))])
    return times, rows


def _data(stages: Stages, where: tuple[Indices, Indices], form: Callable[..., Data]) -> Data:
    linear, present = stages.g.shape[1] - sum(stages.cones), stages.present
    firsts = np.cumsum([linear, *stages.cones])[:-1]
    sizes = np.repeat(stages.cones, np.count_nonzero(present[:, firsts], axis=0)).astype(np.intp)
    first, places, entries, right = _equations(stages)
    count = len(stages.coupling.terminal)
    weights = np.zeros(len(right))
    weights[:count] = TERMINAL * max(LEAST_WEIGHT, float(np.abs(stages.H).max()))
    b = [stages.d.ravel(), np.where(stages.fixed, stages.initial, 0.0), stages.g[where], right]
    return form(
        *(np.array(part) for part in (stages.A, stages.B, stages.H, stages.h.ravel())),
        np.concatenate(b),
        stages.G[where],
        np.ascontiguousarray(where[0]),
        np.cumsum(np.concatenate([[np.count_nonzero(present[:, :linear])], sizes]), dtype=np.intp),
        np.flatnonzero(~stages.fixed),
        first,
        places,
        entries,
        weights,
    )


def _equations(stages: Stages) -> tuple[Indices, Indices, Array, Array]:
    """Return where the equations start, those of x_T first, their places in y, entries, and right-hand sides."""
    coupling, (times, width) = stages.coupling, stages.h.shape
    first, places = [np.arange(len(coupling.terminal) + 1)], [(times - 1) * width + coupling.terminal]
    entries, right = [np.ones(len(coupling.terminal))], [coupling.terminal_state]
    for part in coupling.equations:
        count = part.rows.count
        signals = np.zeros((times, len(coupling.channels), count))
        part.rows.add_columns(np.arange(count), signals)
        row, time, channel = np.nonzero(signals.transpose(2, 0, 1))
        places.append(time * width + coupling.channels[channel])
        entries.append(signals[time, channel, row])
        first.append(first[-1][-1] + np.cumsum(np.bincount(row, minlength=count)))
        right.append(part.right)
    return np.concatenate(first), np.concatenate(places), np.concatenate(entries), np.concatenate(right)
