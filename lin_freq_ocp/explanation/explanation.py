"""An irreducible family of constraints that cannot hold together, and the least relaxation of each that cures it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.arrays import positive_number
from lin_freq_ocp.base.clock import now, processor_now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.explanation.blocks import Block, blocks, without
from lin_freq_ocp.explanation.relaxation import least_cure
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.sizes import stated_sizes
from lin_freq_ocp.solving.families import family_of
from lin_freq_ocp.solving.outcome import Cure, Explanation, Outcome
from lin_freq_ocp.solving.solve import solve_judged

# Whether a problem has a solution, by the statuses that decide it.
DECIDED = {Status.OPTIMAL: True, Status.LOCALLY_OPTIMAL: True, Status.INFEASIBLE: False}
BUSY = 20.0  # seconds that a solve may last for each processor second that is left: solves watch the other clock
LEAST_TIME = 1e-3  # seconds left to a solver when the time is over: it then ends with its limit


def explain(
    problem: OptimalControlProblem, time_limit: float | None = None, processor_time: float | None = None
) -> Explanation:
    """Explain why a problem has no solution.

    Parameters
    ----------
    problem : OptimalControlProblem
    time_limit : float, optional
        Seconds after which nothing more is tried, nor after Ctrl-C; what was found until then is returned.
    processor_time : float, optional
        The same in processor seconds of this process: what else runs on the machine takes nothing away.

    Returns
    -------
    Explanation

    Raises
    ------
    ProblemError
        If a limit is not above zero.
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
    limits = {"time_limit": (now, time_limit), "processor_time": (processor_now, processor_time)}
    ends = [
        (clock, clock() + positive_number(name, limit)) for name, (clock, limit) in limits.items() if limit is not None
    ]
    with one_blas_thread():  # several would use up the processor time while they wait for each other
        search = _Search(problem, ends)
        result = search.solved(problem)
        if result.status != Status.INFEASIBLE:
            raise UnsupportedError(f"explain: this problem was not proven infeasible, it ended as '{result.status}'.")
        family = search.family(result)
        cures = tuple(cure for block in family if (cure := search.cure(block)) is not None)
    return Explanation(tuple(block.name for block in family), search.sure, cures)


class _Search:
    """Solves variants of one problem; ``sure`` until one stays undecided or the time is over."""

    def __init__(self, problem: OptimalControlProblem, ends: list[tuple[Callable[[], float], float]]):
        cost = QuadraticCost(R=np.diag(1 / stated_sizes(problem)[1] ** 2))
        self.problem, self.ends, self.sure, self.interrupted = replace(problem, cost=cost), ends, True, False
        self.blocks = blocks(problem)

    def solved(self, problem: OptimalControlProblem) -> Outcome:
        """Return how a variant ends, with a simple cost or none: only feasibility matters."""
        result = solve_judged(replace(problem, cost=self.problem.quadratic), time_limit=self._left())
        self.interrupted |= result.interrupted
        if result.interrupted or result.status in DECIDED or "convex" not in family_of(problem).shorthands:
            return result
        return solve_judged(replace(problem, cost=QuadraticCost()), "convex", time_limit=self._left())

    def _left(self) -> float | None:
        left = [(end - clock()) * (BUSY if clock is processor_now else 1.0) for clock, end in self.ends]
        return max(min(left), LEAST_TIME) if left else None

    def _over(self) -> bool:
        return self.interrupted or any(clock() > end for clock, end in self.ends)

    def feasible(self, problem: OptimalControlProblem) -> bool | None:
        """Whether a variant has a solution; None where that is not known, as where the time is over."""
        if self._over():
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
        if self._over():
            self.sure = False
            return False
        found = self.feasible(without(self.problem, [block for block in self.blocks if block not in kept]))
        self.sure &= found is not None
        return found is False

    def cure(self, block: Block) -> Cure | None:
        """Return the least change of a block that cures the problem, if it does and there is time."""
        return None if self._over() else least_cure(self.problem, block, self.feasible, self._left())
