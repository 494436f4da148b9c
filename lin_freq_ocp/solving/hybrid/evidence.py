"""A search tree as the evidence of an outcome."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from lin_freq_ocp.certificate.bound import Bound
from lin_freq_ocp.certificate.hybrid.bound import TreeBound, tree_bound
from lin_freq_ocp.problem.hybrid.mode_tree import ModeNode, ModeTree
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers
from lin_freq_ocp.solving.outcome import Evidence, Outcome


@dataclass(frozen=True, eq=False)
class TreeEvidence(Evidence):
    """The nodes of a search, with the multipliers that prove its leaves, and the bound that the judge verified."""

    tree: ModeTree
    bound: TreeBound

    @property
    def lower_bound(self) -> float:
        """Return the bound of the tree."""
        return self.bound.value

    def verified(self, problem: OptimalControlProblem) -> Bound | None:
        """Check all nodes once more."""
        return tree_bound(problem, self.tree).bound_for(problem)

    def raised(self, constant: float) -> TreeEvidence:
        """Return the same tree with bounds higher by a constant."""
        bound = self.bound
        return replace(self, bound=replace(bound, value=bound.value + constant, bounds=bound.bounds + constant))

    def with_multipliers(self, restated: Callable[[Multipliers], Multipliers]) -> TreeEvidence:
        """Return the tree with the multipliers of all proofs restated."""

        def node_restated(node: ModeNode) -> ModeNode:
            if node.proof is None:
                return node
            return replace(node, proof=replace(node.proof, multipliers=restated(node.proof.multipliers)))

        return replace(self, tree=replace(self.tree, nodes=tuple(map(node_restated, self.tree.nodes))))

    def __str__(self) -> str:
        return f"tree      {len(self.tree.nodes)} nodes, {self.bound.leaves} leaves, each checked"


def tree_of(outcome: Outcome) -> TreeEvidence | None:
    """Return the search tree of an outcome, if it has one."""
    return outcome.evidence if isinstance(outcome.evidence, TreeEvidence) else None
