"""A search tree over mode sequences as plain data: the splits, the bounds, and the multipliers that prove them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.problem.trajectory import Multipliers


@dataclass(frozen=True, eq=False)
class PathMultipliers:
    """Additions to multipliers that depend on the next mode.

    ``vertices`` (T, modes, n) is added to eta_t if that mode is the next one, at t + 1; the last row is zero, because
    no mode follows T - 1. ``images`` (T, modes, modes, n), of either sign, are the multipliers of the box of the next
    mode (index 0 at T - 1: of x_T).
    """

    vertices: Array
    images: Array


@dataclass(frozen=True, eq=False)
class ModeMultipliers:
    """Multipliers that bound the cost of all sequences within a mask.

    ``multipliers`` are those of the theorem with mu and nu zero, because the bound minimises over boxes; eta_C = 0
    proves that no trajectory exists. ``region`` (T, modes, rows) >= 0 are the multipliers of G_i x_t + H_i u_t <= h_i
    of every mode; with ``paths`` they depend on the next mode, too: (T, modes, modes, rows), index 0 at T - 1.
    """

    multipliers: Multipliers
    region: Array
    paths: PathMultipliers | None = None

    def region_along(self, sequence: Indices) -> Array:
        """Return the region multipliers of the modes of a sequence, (T, rows)."""
        times = np.arange(len(sequence))
        if self.paths is None:
            return self.region[times, sequence]
        return self.region[times, sequence, np.append(sequence[1:], 0)]


@dataclass(frozen=True, eq=False)
class ModeNode:
    """A node: its parent, the time of the parent's split (-1 for the root), and its mask ``allowed``, (T, modes).

    ``bound`` is the bound that the search computed for the mask, inf without a trajectory. ``proof`` are the
    multipliers of the bound, None if the node was split or no sequence of its mask can be reached.
    """

    parent: int
    stage: int
    allowed: Mask
    bound: float
    proof: ModeMultipliers | None


@dataclass(frozen=True, eq=False)
class ModeTree:
    """All nodes of a mode search (``Result.tree``); a leaf is a node that is no parent.

    They cover the trajectories that cost less than ``level``.
    """

    nodes: tuple[ModeNode, ...]
    level: float = np.inf
