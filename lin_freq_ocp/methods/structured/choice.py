"""Which side solves the linear system of a step: the rows that couple times, or what stop bands keep.

A dense side costs sweeps over T stages for each of its columns, and their cube; conjugate gradients cost some thirty
sweeps, whatever the number of columns. The constants are those of compiled loops on one core, for n + k = 3; a larger
stage changes all sweeps alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.methods.structured.kkt.kept.coefficients import sort_rows
from lin_freq_ocp.methods.structured.kkt.kept.reduced import DenseReduced
from lin_freq_ocp.methods.structured.kkt.kept.side import KeptSide
from lin_freq_ocp.methods.structured.kkt.kept.space import GROWTH, break_times
from lin_freq_ocp.methods.structured.kkt.kept.two_level import TwoLevel
from lin_freq_ocp.methods.structured.kkt.low_rank import fine_rows
from lin_freq_ocp.methods.structured.kkt.recursions import Loops
from lin_freq_ocp.methods.structured.kkt.response import Response
from lin_freq_ocp.methods.structured.kkt.side import Side
from lin_freq_ocp.methods.structured.kkt.stopped_side import stopped_side
from lin_freq_ocp.methods.structured.model.stages import Stages

COLUMN = 50e-9  # seconds for one stage of one column of a dense side
SWEEPS = 30e-6  # seconds for one stage of all iterations of conjugate gradients in a step
FLOP = 1e-10  # seconds for a multiplication in products and factors of dense matrices
LARGEST = 12_000  # columns: a dense matrix of them, and its factor, fill 2.3 GB


@dataclass(frozen=True)
class Sizes:
    """What the cost of each side depends on."""

    horizon: int
    rows: int  # that couple times
    kept: int  # coefficients, starts and free entries of x_0
    left: int  # rows on these: starts, x_T, and rows that are no stop band
    bands: int

    @property
    def stopped_seconds(self) -> float:
        """Return the seconds of a step on the side of the rows."""
        return _dense(self.horizon, self.rows)

    @property
    def kept_seconds(self) -> float:
        """Return the seconds of a step on the side of the coefficients, by dense factors."""
        return _dense(self.horizon, self.kept) + FLOP * self.kept**2 * self.left + _dense(0, self.left)

    @property
    def two_level_seconds(self) -> float:
        """Return the seconds of a step on the side of the coefficients, by conjugate gradients."""
        return self.horizon * (SWEEPS + COLUMN * self.left) + FLOP * self.kept * self.left**2 + _dense(0, self.left)


def _dense(horizon: int, columns: int) -> float:
    return COLUMN * horizon * columns + FLOP * columns**3 / 3


def sizes_of(stages: Stages) -> Sizes:
    """Return the sizes of a problem."""
    bands, rest = sort_rows(stages)
    coupling, T = stages.coupling, stages.horizon
    stopped = sum(len(band.rows) for band in bands)
    banded = {band.entry for band in bands}
    channels = {int(entry) - stages.states for entry in coupling.channels}
    driven = np.flatnonzero(stages.B.any(axis=(0, 1))).tolist()
    whole = (channels | set(driven)) - banded - set(range(-stages.states, 0))
    starts = len(break_times(stages.A, GROWTH)) * stages.states
    kept = T * len(banded) - stopped + (T + 1) * len(whole) + starts + int((~stages.fixed).sum())
    left = starts + len(coupling.terminal) + sum(len(part.at) for part in rest)
    return Sizes(T, coupling.count, kept, left, len(bands))


def choose_side(stages: Stages, loops: Loops) -> Side:
    """Return the fastest side that fits; UnsupportedError if none does."""
    if fine_rows(Response(stages, loops)) is not None:
        return stopped_side(stages, loops)
    sizes = sizes_of(stages)
    fitting = {"stopped": sizes.stopped_seconds} if sizes.rows <= LARGEST else {}
    if sizes.bands and sizes.left <= LARGEST:
        fitting["two-level"] = sizes.two_level_seconds
        if sizes.kept <= LARGEST:
            fitting["kept"] = sizes.kept_seconds
    if not fitting:
        raise UnsupportedError(
            f"problem: got {sizes.rows} rows that couple times, of which {sizes.left} are no stop band of a control; "
            f"the structured method takes up to {LARGEST} (theirs would be matrices of {16e-9 * sizes.left**2:.0f} GB)."
        )
    best = min(fitting, key=lambda name: fitting[name])
    if best == "stopped":
        return stopped_side(stages, loops)
    return KeptSide(stages, loops, DenseReduced if best == "kept" else TwoLevel)
