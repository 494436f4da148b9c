"""The parts common to searches over modes: limits, progress, outcome, and the solution of a node's relaxation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Indices, Mask
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.methods.candidate import Progress
from lin_freq_ocp.methods.hybrid.search.node import NodeSolution, solve_by_clarabel, solve_path_relaxation
from lin_freq_ocp.problem.hybrid.mode_tree import ModeNode, ModeTree
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.program.hybrid.path_relaxation import PathRelaxation
from lin_freq_ocp.program.hybrid.relaxation import ModeRelaxation
from lin_freq_ocp.program.hybrid.rows import Duals
from lin_freq_ocp.transform.hybrid.mode_reach import Reach

GAP = 1e-6  # relative gap (J - D)/S, S of ``cost_scale``, at which the search ends by default
SEARCH_SHARE = 0.6  # of the time, at first: in the rest the leaves are checked, each at most as long as a node takes
# Residuals and gap of a node's relaxation: a hundredth of the gap to be proven; if that fails, a looser tolerance.
# Its bound is weaker, but checked as well
TOLERANCES = (1e-8, 1e-6)
FINE = (1e-11, 1e-9)  # for leaves with too weak a proof
# Violation, in natural units, up to which the point of a single sequence is feasible: ten times the looser tolerance.
# A row that a program or its solver has lost is violated by far more.
FEASIBLE = 1e-5


@dataclass(frozen=True)
class SearchLimits:
    """When to stop: relative gap, seconds in all, relaxations, the cost to be below; and the share for the search."""

    gap: float = GAP
    seconds: float = np.inf
    nodes: int = 10**9
    level: float = np.inf
    share: float = SEARCH_SHARE

    @property
    def search_seconds(self) -> float:
        """Return the time for solving relaxations; the rest is for the proof."""
        return self.share * self.seconds

    @property
    def out_of_time(self) -> str:
        """Return the message of a search that stopped at its time limit."""
        return f"time limit of {self.seconds:g} s"

    def reached(self, seconds: float, nodes: int) -> str:
        """Return which limit of time or nodes is reached, or an empty string."""
        if seconds > self.search_seconds:
            return self.out_of_time
        return f"limit of {self.nodes} nodes" if nodes >= self.nodes else ""


@dataclass(frozen=True)
class SearchProgress(Progress):
    """How far a search over modes is.

    Attributes
    ----------
    nodes, open : int
        Relaxations solved, and nodes still to be split.
    seconds : float
    """

    nodes: int
    open: int
    seconds: float

    def __str__(self) -> str:
        best = f"cost {self.cost:.6g}" if np.isfinite(self.cost) else "no trajectory yet"
        return f"{best}, bound {self.lower_bound:.6g}, {self.nodes} nodes, {self.open} open"


@dataclass(frozen=True, eq=False)
class SearchOutcome:
    """The best sequence (T,) with its relaxed cost (inf: none found), the tree, and the reason for an early stop.

    ``nodes`` relaxations were solved, after ``setup`` seconds. ``resume`` continues a search that stopped at its time
    limit, for so many more seconds; None if it cannot be continued.
    """

    sequence: Indices | None
    cost: float
    tree: ModeTree
    message: str
    interrupted: bool
    nodes: int
    setup: float = 0.0
    resume: Callable[[float], SearchOutcome] | None = None


def solve_relaxation(
    relaxation: ModeRelaxation,
    reach: Reach,
    tolerances: Sequence[float] = TOLERANCES,
    end: float = np.inf,
    cutoff: float | None = None,
) -> NodeSolution:
    """Solve the relaxation of a reach to the first tolerance that the solver reaches until ``end``.

    With a cutoff, the solver stops as soon as it knows on which side of it the node lies; a single sequence below the
    cutoff is solved to the end. The trajectory is None if it is not feasible: then only the bound holds. Raises
    KeyboardInterrupt if the solver was interrupted.
    """
    if now() > end:
        return NodeSolution(reach, -np.inf)
    if isinstance(relaxation, PathRelaxation):
        answer = solve_path_relaxation(relaxation, reach, cutoff)
        checked = None if answer is None else _check_solution(relaxation, answer)
        if checked is not None and (checked is answer or (cutoff is not None and checked.bound >= cutoff)):
            return checked
    answer = solve_by_clarabel(relaxation, reach, tolerances, end, cutoff)
    return _check_solution(relaxation, answer or NodeSolution(reach, -np.inf))


def _check_solution(relaxation: ModeRelaxation, answer: NodeSolution) -> NodeSolution:
    """Return a solution; without its trajectory if that belongs to a single sequence and is not feasible."""
    sequence, trajectory = answer.sequence, answer.trajectory
    if sequence is None or trajectory is None or relaxation.violation(trajectory, sequence) <= FEASIBLE:
        return answer
    return replace(answer, trajectory=None)


def tree_with_proofs(relaxation: ModeRelaxation, nodes: Sequence[ModeNode], duals: Sequence[Duals | None]) -> ModeTree:
    """Return the tree with the multipliers of every node that has duals."""
    pairs = zip(nodes, duals, strict=True)
    return ModeTree(
        tuple(
            node if leaf_duals is None else replace(node, proof=relaxation.multipliers(leaf_duals))
            for node, leaf_duals in pairs
        )
    )


def refine_leaves(
    problem: OptimalControlProblem,
    tree: ModeTree,
    leaves: Indices,
    end: float = np.inf,
    kind: type[ModeRelaxation] = PathRelaxation,
    scale: float = np.inf,
) -> ModeTree:
    """Return the tree with new proofs of some leaves, from relaxations solved to the finest tolerance until ``end``.

    Gaps are relative to the ``scale`` of the cost that is found, in whose units the relaxations are.
    """
    relaxation, nodes = kind(problem, scale), list(tree.nodes)
    for index in leaves:
        reach = relaxation.reach.from_start(nodes[index].allowed)
        answer = None if reach is None else solve_relaxation(relaxation, reach, FINE, end)
        if answer is not None and answer.duals is not None:
            nodes[index] = replace(nodes[index], bound=answer.bound, proof=relaxation.multipliers(answer.duals))
    return replace(tree, nodes=tuple(nodes))


def one_mode_each(allowed: Mask, t: int) -> list[Mask]:
    """Return masks (T, modes), each with one of the modes that are allowed at time t."""
    masks: list[Mask] = []
    for i in np.flatnonzero(allowed[t]):
        mask = allowed.copy()
        mask[t] = np.arange(mask.shape[1]) == i
        masks.append(mask)
    return masks
