"""A cover of all mode sequences: what a search begins with when it follows that of the step before in a control loop.

After a step, the tree of the problem before is shifted by one time: splits at time 0 are dropped, with all nodes that
have another mode there; masks and duals move to the time before; the last time is new, with all modes (Marcucci and
Tedrake, IEEE TAC 66(6), 2021). What the reach had left out is not: the state may be disturbed. Every path of splits
still has a node for each mode, so that leaves cover all sequences, whichever mode at time 0 is followed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Mask
from lin_freq_ocp.problem.hybrid.mode_tree import ModeNode
from lin_freq_ocp.program.hybrid.path_bounds import PathDuals
from lin_freq_ocp.program.hybrid.relaxation import Duals

Shift = Callable[[PathDuals], PathDuals]


@dataclass(frozen=True, eq=False)
class CoverNode:
    """A node: its parent and the time at which that was split (-1 for the root), its mask, and duals for a leaf."""

    parent: int
    stage: int
    allowed: Mask
    duals: PathDuals | None


def shifted_cover(
    nodes: Sequence[ModeNode], duals: Sequence[Duals | PathDuals | None], first: int, shift: Shift
) -> tuple[CoverNode, ...]:
    """Return the cover that a tree leaves after a step in mode ``first``; ``shift`` moves duals by one time."""
    children: dict[int, list[int]] = {}
    for index, node in enumerate(nodes[1:], start=1):
        if node.bound < np.inf or duals[index] is not None:  # the reach alone has closed the others
            children.setdefault(node.parent, []).append(index)
    cover: list[CoverNode] = []
    pending = [(0, -1, -1, np.ones_like(nodes[0].allowed))]
    while pending:
        index, parent, stage, mask = pending.pop()
        own = children.get(index, [])
        while own and nodes[own[0]].stage == 0:
            followed = [child for child in own if nodes[child].allowed[0, first]]
            index = followed[0] if followed else -1  # -1: a leaf of which nothing is known
            own = children.get(index, [])
        kept = None if own or index < 0 else duals[index]
        cover.append(CoverNode(parent, stage, mask, shift(kept) if isinstance(kept, PathDuals) else None))
        if own:
            split, here = nodes[own[0]].stage, len(cover) - 1
            chosen = [nodes[child].allowed[split] for child in own]
            pending += [
                (child, here, split - 1, _cut(mask, split - 1, row)) for child, row in zip(own, chosen, strict=True)
            ]
            others = ~np.any(chosen, axis=0)
            if others.any():
                pending.append((-1, here, split - 1, _cut(mask, split - 1, others)))
    return tuple(cover)


def _cut(mask: Mask, t: int, row: Mask) -> Mask:
    found = mask.copy()
    found[t] &= row
    return found
