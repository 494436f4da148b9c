"""What every search over modes is given, reports, and returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.analysis.mode_tree import ModeNode, ModeTree
from lin_freq_ocp.arrays import Indices
from lin_freq_ocp.methods.modes.node import FINE, Duals, relaxed
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.transcription.modes.relaxation import ModeRelaxation

GAP = 1e-6  # relative gap (J - D)/S, S of ``cost_scale``, at which the search ends, unless another is asked for
SEARCH_SHARE = 0.85  # of the time: what was found is solved once more, and the leaves are checked, in the rest


@dataclass(frozen=True)
class SearchLimits:
    """When to stop.

    Attributes
    ----------
    gap : float
        Relative.
    seconds : float
    nodes : int
        Relaxations solved.
    """

    gap: float = GAP
    seconds: float = np.inf
    nodes: int = 10**9

    @property
    def search_seconds(self) -> float:
        """Return the time for solving relaxations; the rest is for the proof."""
        return SEARCH_SHARE * self.seconds

    def reached(self, seconds: float, nodes: int) -> str:
        """Return which limit of time or nodes is reached, in words, or nothing."""
        if seconds > self.search_seconds:
            return f"time limit of {self.seconds:g} s"
        return f"limit of {self.nodes} nodes" if nodes >= self.nodes else ""


@dataclass(frozen=True)
class SearchProgress:
    """How far a search is.

    Attributes
    ----------
    cost, lower_bound : float
        Of the best sequence found, and of all that is left; infinite as long as there is none.
    nodes, open : int
        Relaxations solved, and nodes that are still to be split.
    seconds : float
    """

    cost: float
    lower_bound: float
    nodes: int
    open: int
    seconds: float

    def __str__(self) -> str:
        best = f"cost {self.cost:.6g}" if np.isfinite(self.cost) else "no trajectory yet"
        return f"{best}, bound {self.lower_bound:.6g}, {self.nodes} nodes, {self.open} open"


@dataclass(frozen=True, eq=False)
class SearchOutcome:
    """What a search found.

    Attributes
    ----------
    sequence : (T,) or None
        The best one.
    cost : float
        Its cost, as the relaxations see it; inf without one.
    tree : ModeTree
    words : str
        Why it stopped before it was done; nothing if it was.
    interrupted : bool
    nodes : int
        Relaxations solved.
    setup : float
        Seconds before the first one.
    """

    sequence: Indices | None
    cost: float
    tree: ModeTree
    words: str
    interrupted: bool
    nodes: int
    setup: float = 0.0


def proven_tree(relaxation: ModeRelaxation, nodes: Sequence[ModeNode], duals: Sequence[Duals | None]) -> ModeTree:
    """Return the tree with the multipliers of every node that has duals."""

    def proven(node: ModeNode, own: Duals | None) -> ModeNode:
        return node if own is None else replace(node, proof=relaxation.multipliers(own.rows, own.y, own.eta_C))

    return ModeTree(tuple(proven(*pair) for pair in zip(nodes, duals, strict=True)))


def refined(problem: OptimalControlProblem, tree: ModeTree, leaves: Indices, end: float = np.inf) -> ModeTree:
    """Return the tree with new proofs of some leaves, from relaxations solved as finely as can be until ``end``."""
    relaxation, nodes = ModeRelaxation(problem), list(tree.nodes)
    for index in leaves:
        reach = relaxation.reach.from_start(nodes[index].allowed)
        answer = None if reach is None else relaxed(relaxation, reach, FINE, end)
        if answer is not None and answer.duals is not None:
            own = answer.duals
            proof = relaxation.multipliers(own.rows, own.y, own.eta_C)
            nodes[index] = replace(nodes[index], bound=answer.bound, proof=proof)
    return ModeTree(tuple(nodes))
