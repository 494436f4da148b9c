"""What solves of one problem with other numbers share: stages, the responses of their rows, and an answer nearby."""

from __future__ import annotations

from lin_freq_ocp.methods.structured.choice import choose_side
from lin_freq_ocp.methods.structured.kkt.recursions import Loops
from lin_freq_ocp.methods.structured.kkt.row_responses import RowResponses
from lin_freq_ocp.methods.structured.kkt.system import System
from lin_freq_ocp.methods.structured.model.assembly import Assembly, stages_of
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory


class Prepared:
    """Made when it is needed, and kept as long as it fits."""

    def __init__(self):
        self.near: Trajectory | None = None  # a trajectory near the answer
        self._assembly: Assembly | None = None
        self._rows: tuple[Assembly, bool, RowResponses] | None = None

    def assembly(self, problem: OptimalControlProblem) -> Assembly:
        """Return the stages of a problem, with the numbers of the last exchanged if no more differs."""
        exchanged = None if self._assembly is None else self._assembly.exchanged(problem)
        if self._assembly is None or exchanged is None or not exchanged.same_matrices(self._assembly):
            self.near = None  # responses are worth finding for many solves only
        self._assembly = exchanged or stages_of(problem)
        return self._assembly

    def responses(self, assembly: Assembly, loops: Loops) -> RowResponses:
        """Return what active rows of stages add to an answer, which depends on all but their right-hand sides."""
        if self._rows is None or not self._rows[0].same_matrices(assembly) or self._rows[1] != loops.compiled:
            stages = assembly.stages
            rows = RowResponses(System(stages, loops), choose_side(stages, loops))
            self._rows = assembly, loops.compiled, rows
        return self._rows[2]
