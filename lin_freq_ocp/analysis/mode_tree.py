"""A search tree over mode sequences as plain data: what was split, what was left out, and by which multipliers."""

from __future__ import annotations

from dataclasses import dataclass

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.problem.trajectory import Multipliers


@dataclass(frozen=True, eq=False)
class ModeMultipliers:
    """Multipliers that bound the cost of all sequences within a mask.

    Attributes
    ----------
    multipliers : Multipliers
        Those of the theorem, with mu and nu zero: a bound minimises over boxes. eta_C = 0 for a proof that there is no
        trajectory.
    region : (T, modes, rows)
        Of the rows G_i x_t + H_i u_t <= h_i of every mode, zero or above.
    """

    multipliers: Multipliers
    region: Array


@dataclass(frozen=True, eq=False)
class ModeNode:
    """One node.

    Attributes
    ----------
    parent : int
        The node that it was split from; -1 for the root.
    stage : int
        The time at which its parent was split; -1 for the root.
    allowed : (T, modes)
        Its mask of modes, without those that cannot be reached.
    bound : float
        What the search believes to be a lower bound on the cost of all sequences within the mask; inf if none has a
        trajectory.
    proof : ModeMultipliers or None
        What the bound can be checked by; None where the node was split, or nothing within its mask can be reached.
    """

    parent: int
    stage: int
    allowed: Mask
    bound: float
    proof: ModeMultipliers | None


@dataclass(frozen=True, eq=False)
class ModeTree:
    """All nodes; a node that is nobody's parent is a leaf. ``Result.tree`` of a search over modes."""

    nodes: tuple[ModeNode, ...]
