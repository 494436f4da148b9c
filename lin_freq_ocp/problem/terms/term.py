"""A term h(L(x, u)) of a problem: a constraint, hard or soft, or a nonsmooth cost, with one multiplier per value."""

from __future__ import annotations

from dataclasses import dataclass

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.problem.terms.maps import TrajectoryMap
from lin_freq_ocp.problem.terms.penalties import Penalty, hard

KINDS = (
    *("state set", "control set", "stage rows", "state spectrum", "control spectrum", "output spectrum"),
    *("stage cost", "terminal cost"),
)
"""Where a term comes from: the field of the problem that it was given in."""


@dataclass(frozen=True, eq=False)
class Term:
    """h(L(x, u)), with h convex and L affine.

    Attributes
    ----------
    name : str
        Under which its multipliers stand, of shape (groups, dim) like its values.
    kind : str
        One of KINDS.
    map : StageMap, SpectrumMap or SumMap
        L.
    penalty : Below, Norm or Cone
        h.
    source : (field, index) or None
        The field of the problem that it was given in, and its place there.
    per_limit : float
        Change of the penalty's limit for each unit of the limit (of an energy, of its root) that was given.
    """

    name: str
    kind: str
    map: TrajectoryMap
    penalty: Penalty
    source: tuple[str, int] | None = None
    per_limit: float = 1.0

    @property
    def hard(self) -> bool:
        """Whether it is a constraint that must hold."""
        return hard(self.penalty.weight)

    @property
    def shape(self) -> tuple[int, int]:
        """Return (groups, dim)."""
        return self.map.shape

    def cost(self, x: Array, u: Array) -> Array:
        """Return what it adds to J, one number a group."""
        return self.penalty.cost(self.map.values(x, u))

    def violation(self, x: Array, u: Array) -> Array:
        """Return by how much it is violated where it is hard, (groups, dim) or (groups, 1)."""
        return self.penalty.violation(self.map.values(x, u))
