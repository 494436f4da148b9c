"""The choice of the KKT solver of a problem, by an estimate of the seconds of a step.

A dense null-space solver needs a sweep over T stages in both directions for each of its columns, and the cube of their
number; in range space, backward sweeps and the products of all columns. Conjugate gradients in null space need some
thirty sweeps, and a column for each remaining row, start and direction of a large weight. The constants were measured
with compiled loops on one core: the low-pass of a time-varying system with n + k = 3 at T = 1000 to 20 000.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.structured.kkt.null_space import GROWTH, NullSpaceSolver, sort_rows
from lin_freq_ocp.methods.structured.kkt.range_space import CouplingResponse, fine_rows, range_space_solver
from lin_freq_ocp.methods.structured.kkt.recursions import Loops, break_times
from lin_freq_ocp.methods.structured.kkt.reduced import DenseReduced, TwoLevel
from lin_freq_ocp.methods.structured.kkt.system import KKTSolver
from lin_freq_ocp.methods.structured.stages import Stages

COLUMN = 17e-9  # seconds for one entry of y of one stage of one column
BACKWARD = 5e-9  # the same for the sweep backwards alone
SQUARE = 2.2e-11  # seconds for a multiplication in products of a matrix with itself
ITERATIONS = 7e-6  # seconds for one entry of y of one stage in all iterations of conjugate gradients of a step
DIRECTIONS = 100  # of large weights: a common number
FLOP = 5e-11  # seconds for a multiplication in other products and factors of dense matrices
STAGE_SECONDS = 6e-7  # seconds for every pair of entries of y of a stage in a step without rows that couple times
PLAIN_STAGE = 1e-4  # seconds for a stage in a step by loops that are not compiled
LARGEST_BYTES = 1e9  # of a dense matrix and its factor, or of the columns that conjugate gradients keep
RANGE_SPACE_BYTES = 2e9  # of the dense matrix of all rows and its factor, of the rows as signals, and of their sweep


@dataclass(frozen=True)
class Sizes:
    """The sizes that determine the cost of each solver."""

    horizon: int
    entries: int  # of y_t
    channels: int  # of these, on which rows depend
    rows: int  # that couple times
    unknowns: int  # in null space: coefficients, starts and free entries of x_0
    left: int  # rows on these: starts, x_T, and rows that are no stop band
    bands: int

    @property
    def range_space_bytes(self) -> float:
        """Return the memory that the range-space solver needs."""
        return 16.0 * self.rows * (self.rows + self.horizon * self.channels)

    def seconds(self) -> dict[str, float]:
        """Return the seconds of a step by each solver that fits into memory."""
        seconds: dict[str, float] = {}
        directions = self.left + DIRECTIONS
        if self.range_space_bytes <= RANGE_SPACE_BYTES:
            seconds["range space"] = self._range_space(self.rows)
        if self.bands and 16 * self.unknowns**2 <= LARGEST_BYTES:
            M = COLUMN * self.horizon * self.entries * self.unknowns + FLOP * self.unknowns**3 / 3
            seconds["null space"] = M + FLOP * self.unknowns**2 * self.left + FLOP * self.left**3 / 3
        if self.bands and 16 * self.unknowns * directions <= LARGEST_BYTES:
            iterations = self.horizon * self.entries * (ITERATIONS + 2 * COLUMN * directions)  # columns of x and u
            seconds["two-level"] = iterations + FLOP * (self.unknowns * directions**2 + directions**3 / 3)
        return seconds

    def fine_seconds(self, rows: int, rank: int) -> float:
        """Return the seconds of a step, or of its set-up, with rows of low rank."""
        return self._range_space(rank + self.rows - rows) + 3 * SQUARE * rows * rank**2

    def _range_space(self, columns: int) -> float:
        sweep = self.horizon * self.entries * columns
        return BACKWARD * sweep + SQUARE * self.horizon * columns**2 + FLOP * columns**3 / 3


def sizes_of(stages: Stages) -> Sizes:
    """Return the sizes of a problem."""
    bands, rest = sort_rows(stages)
    coupling, T = stages.coupling, stages.horizon
    stopped = sum(len(band.rows) for band in bands)
    banded = {band.entry for band in bands}
    channels = {int(entry) - stages.states for entry in coupling.channels}
    driven = np.flatnonzero(stages.B.any(axis=(0, 1))).tolist()
    whole = (channels | set(driven)) - banded - set(range(-stages.states, 0))
    starts = len(break_times(stages.A, stages.horizon, GROWTH)) * stages.states
    unknowns = T * len(banded) - stopped + (T + 1) * len(whole) + starts + int((~stages.fixed).sum())
    left = starts + len(coupling.terminal) + sum(len(part.at) for part in rest)
    return Sizes(T, stages.H.shape[1], len(channels), coupling.count, unknowns, left, len(bands))


def step_seconds(stages: Stages, loops: Loops) -> float:
    """Return an estimate of the seconds of a step, or of the set-up before it."""
    sizes, fine = sizes_of(stages), fine_rows(CouplingResponse(stages, loops))
    if fine is None:
        coupled = min(sizes.seconds().values(), default=0.0)
    else:
        least = min(part.rows.oversampling for part in stages.coupling.balls if part.rows.oversampling > 1)
        coupled = sizes.fine_seconds(len(fine), len(fine) // least)
    alone = STAGE_SECONDS * sizes.entries**2 if loops.compiled else PLAIN_STAGE
    return coupled + sizes.horizon * alone


def choose_kkt_solver(stages: Stages, loops: Loops) -> KKTSolver:
    """Return the fastest KKT solver that fits; UnsupportedError if none does."""
    if fine_rows(CouplingResponse(stages, loops)) is not None:
        return range_space_solver(stages, loops)
    sizes = sizes_of(stages)
    seconds = sizes.seconds()
    if not seconds:
        raise UnsupportedError(
            f"problem: got {sizes.rows} rows that couple times, {sizes.left} of them no stop band of a control; "
            f"the structured method would need {1e-9 * sizes.range_space_bytes:.3g} GB of memory for them, and takes "
            f"up to {RANGE_SPACE_BYTES * 1e-9:.0f} GB. Choose a shorter horizon, or method='convex'."
        )
    best = min(seconds, key=lambda name: seconds[name])
    if best == "range space":
        return range_space_solver(stages, loops)
    return NullSpaceSolver(stages, loops, DenseReduced if best == "null space" else TwoLevel)
