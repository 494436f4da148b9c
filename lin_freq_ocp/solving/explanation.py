"""Why a problem has no solution, as plain data: constraints in conflict, and the least change that helps."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Cure:
    """The least change of one block, all others as they are, after which there is a solution.

    Attributes
    ----------
    block : str
        In words, as in a Conflict.
    amount : float
        By how much its bounds move outwards, in the units of the problem; for an end, the largest move of a component
        relative to its size; for a stop band, how many of its bins are passed on each edge; for an energy bound, of the
        root of its limit.
    words : str
        From what to what.
    """

    block: str
    amount: float
    words: str

    def __str__(self) -> str:
        return f"{self.block}: {self.words}"


@dataclass(frozen=True)
class Explanation:
    """Why a problem has no solution.

    Attributes
    ----------
    family : tuple of str
        Blocks of constraints that, with the dynamics, cannot hold together.
    irreducible : bool
        Whether each was taken away in turn, and the others could then hold together; False only where a solver was
        unsure or the time was over.
    cures : tuple of Cure
        For each block of the family that cures the whole problem by giving way alone: the least by which it must.
    """

    family: tuple[str, ...]
    irreducible: bool
    cures: tuple[Cure, ...]

    def __str__(self) -> str:
        lines = [f"together  {', '.join(self.family)}" + ("" if self.irreducible else " (perhaps fewer)")]
        lines += [f"cure      {cure}" for cure in self.cures]
        return "\n".join(lines)
