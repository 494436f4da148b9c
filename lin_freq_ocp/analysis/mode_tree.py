"""A search tree over mode sequences as plain data: what was split, what was left out, and by which multipliers."""

from __future__ import annotations

from dataclasses import dataclass

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.problem.trajectory import Multipliers


@dataclass(frozen=True, eq=False)
class ModeMultipliers:
    """Multipliers that bound the cost of all sequences within a mask.

    ``multipliers`` are those of the theorem, with mu and nu zero: a bound minimises over boxes. eta_C = 0 for a proof
    that there is no trajectory. ``region`` (T, modes, rows) >= 0 are those of G_i x_t + H_i u_t <= h_i of every mode.
    """

    multipliers: Multipliers
    region: Array


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
