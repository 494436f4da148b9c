"""A search tree over mode sequences as plain data: what was split, what was left out, and by which multipliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.problem.trajectory import Multipliers


@dataclass(frozen=True, eq=False)
class PathMultipliers:
    """What makes multipliers depend on the mode that follows.

    ``vertices`` (T, modes, n) is added to eta_t where that mode follows at t + 1; none follows T - 1, whose are zero.
    ``images`` (T, modes, modes, n), of either sign, are those of the box of the mode that follows (0: of x_T).
    """

    vertices: Array
    images: Array


@dataclass(frozen=True, eq=False)
class ModeMultipliers:
    """Multipliers that bound the cost of all sequences within a mask.

    ``multipliers`` are those of the theorem, with mu and nu zero: a bound minimises over boxes. eta_C = 0 for a proof
    that there is no trajectory. ``region`` (T, modes, rows) >= 0 are those of G_i x_t + H_i u_t <= h_i of every mode;
    with ``paths``, (T, modes, modes, rows), as they depend on the mode that follows (0 at T - 1).
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
    """A node: its parent and the time at which that was split (-1 for the root), and its mask, allowed (T, modes).

    ``bound`` is what the search computed for the mask, inf if it has no trajectory; ``proof`` what the bound is checked
    by, None where the node was split or nothing within its mask can be reached.
    """

    parent: int
    stage: int
    allowed: Mask
    bound: float
    proof: ModeMultipliers | None


@dataclass(frozen=True, eq=False)
class ModeTree:
    """All nodes; a node that is no parent is a leaf. ``Result.tree`` of a search over modes."""

    nodes: tuple[ModeNode, ...]
