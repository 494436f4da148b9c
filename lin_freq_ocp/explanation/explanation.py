"""An irreducible family of constraints that cannot hold together, and the least relaxation of each that cures it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lin_freq_ocp.analysis.sizes import stated_sizes
from lin_freq_ocp.arrays import positive_number
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.explanation.blocks import Block, blocks, without
from lin_freq_ocp.explanation.relaxation import least_cure
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.solving.families import family_of
from lin_freq_ocp.solving.outcome import Cure, Explanation, Outcome
from lin_freq_ocp.solving.solve import solve_judged
from lin_freq_ocp.status import Status
from lin_freq_ocp.system.clock import now

# Whether a problem has a solution, by the statuses that decide it.
DECIDED = {Status.OPTIMAL: True, Status.LOCALLY_OPTIMAL: True, Status.INFEASIBLE: False}
LEAST_TIME = 1e-3  # seconds left to a solver when the time is over: it then ends with its limit


def explain(problem: OptimalControlProblem, time_limit: float | None = None) -> Explanation:
    """Explain why a problem has no solution.

    Parameters
    ----------
    problem : OptimalControlProblem
    time_limit : float, optional
        Seconds after which nothing more is tried, nor after Ctrl-C; what was found until then is returned.

    Returns
    -------
    Explanation

    Raises
    ------
    ProblemError
        If the time limit is not above zero.
    UnsupportedError
        If the problem has a solution, or none of the methods could prove that it has none; or if its dynamics have
        modes.

    Examples
    --------
    >>> explanation = lfo.explain(lfo.library.double_integrator(cutoff_hz=0.3))
    >>> print(explanation.cures[0])
    initial state: ...
    """
    require_problem(problem)
    if problem.dynamics.affine and problem.dynamics.mode_names:
        raise UnsupportedError(
            "explain: got piecewise-affine dynamics, where every mode sequence has its own reasons; "
            "explain(problem.with_modes(sequence)) tells those of one."
        )
    if time_limit is not None:
        positive_number("time_limit", time_limit)
    search = _Search(problem, np.inf if time_limit is None else now() + time_limit)
    result = search.solved(problem)
    if result.status != Status.INFEASIBLE:
        raise UnsupportedError(f"explain: this problem was not proven infeasible, it ended as '{result.status}'.")
    family = search.family(result)
    cures = tuple(cure for block in family if (cure := search.cure(block)) is not None)
    return Explanation(tuple(block.name for block in family), search.sure, cures)


class _Search:
    """Solves variants of one problem; ``sure`` until one stays undecided or the time is over."""

    def __init__(self, problem: OptimalControlProblem, end: float):
        cost = QuadraticCost(R=np.diag(1 / stated_sizes(problem)[1] ** 2))
        self.problem, self.end, self.sure = replace(problem, cost=cost), end, True
        self.blocks = blocks(problem)

    def solved(self, problem: OptimalControlProblem) -> Outcome:
        """Return how a variant ends, with a simple cost or none: only feasibility matters."""
        result = solve_judged(replace(problem, cost=self.problem.quadratic), time_limit=self._left())
        if result.interrupted:
            self.end = -np.inf
        if result.interrupted or result.status in DECIDED or "convex" not in family_of(problem).shorthands:
            return result
        return solve_judged(replace(problem, cost=QuadraticCost()), "convex", time_limit=self._left())

    def _left(self) -> float | None:
        return None if self.end == np.inf else max(self.end - now(), LEAST_TIME)

    def feasible(self, problem: OptimalControlProblem) -> bool | None:
        """Whether a variant has a solution; None where that is not known, as where the time is over."""
        if now() > self.end:
            return None
        return DECIDED.get(self.solved(problem).status)

    def family(self, result: Outcome) -> list[Block]:
        """Return an irreducible family: each block is dropped in turn, for good if the others are still infeasible."""
        named = {one.block: one.share for one in result.conflict or ()}
        some = [block for block in self.blocks if block.name in named]
        family = some if self._infeasible(some) else list(self.blocks)
        for block in sorted(family, key=lambda block: named.get(block.name, 0.0)):
            rest = [one for one in family if one is not block]
            if self._infeasible(rest):
                family = rest
        return family

    def _infeasible(self, kept: list[Block]) -> bool:
        """Whether these blocks alone are known to have no solution."""
        if now() > self.end:
            self.sure = False
            return False
        found = self.feasible(without(self.problem, [block for block in self.blocks if block not in kept]))
        self.sure &= found is not None
        return found is False

    def cure(self, block: Block) -> Cure | None:
        """Return the least change of a block that cures the problem, if it does and there is time."""
        return None if now() > self.end else least_cure(self.problem, block, self.feasible, self._left())
