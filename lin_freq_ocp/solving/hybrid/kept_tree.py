"""What a search over modes leaves for that of the next step of a control loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from lin_freq_ocp.base.arrays import Indices
from lin_freq_ocp.methods.hybrid.search.branch_and_bound import BranchAndBound as TreeSearch
from lin_freq_ocp.methods.hybrid.search.cover import CoverNode
from lin_freq_ocp.methods.hybrid.search.search import SearchLimits, SearchOutcome, SearchProgress
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.program.hybrid.relaxation import ModeRelaxation
from lin_freq_ocp.solving.kept import SearchCache


class KeptTree(SearchCache):
    """The relaxations of a search, and a cover of the sequences of the next step."""

    def __init__(self):
        self._of: OptimalControlProblem | None = None  # from which the problem of a step differs in its start alone
        self._relaxation: ModeRelaxation | None = None
        self._cover: Sequence[CoverNode] = ()
        self._base: OptimalControlProblem | None = None
        self.solved = 0

    def begins(self, base: OptimalControlProblem | None) -> None:
        """Say from which problem the next differs in its start alone; None if in more."""
        self._base = base

    def search(
        self,
        problem: OptimalControlProblem,
        limits: SearchLimits,
        progress: Callable[[SearchProgress], None] | None,
        start: Indices | None,
    ) -> SearchOutcome:
        """Search from what the step before has left, and keep what this leaves."""
        kept, cover = self._relaxation, self._cover
        if kept is not None and self._base is not None and self._base is self._of:
            search = TreeSearch(problem, limits, progress, kept.moved, compiled_from=0)
        else:
            search = TreeSearch(problem, limits, progress, compiled_from=0)
            cover = [replace(node, duals=None) for node in cover]  # theirs are the units of other data
        self._cover, self.solved = (), 0  # should this one fail
        outcome = search.run(start, cover=cover)
        self.solved = outcome.nodes
        self._of, self._relaxation, self._cover = self._base, search.final_relaxation, search.cover_after_step()
        return outcome
