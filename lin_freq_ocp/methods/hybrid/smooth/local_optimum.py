"""A local optimum of one mode sequence, from a trajectory that need not be feasible."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Indices
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.methods.candidate import Reason, zero_multipliers
from lin_freq_ocp.methods.hybrid.smooth.interior_point import ACCEPTABLE, FIRST_MU, MOST_STEPS, Barrier
from lin_freq_ocp.methods.hybrid.smooth.model import FAR_UNIT, VIOLATION, SmoothModel
from lin_freq_ocp.methods.structured.embedding import End
from lin_freq_ocp.methods.structured.kkt.recursions import loops
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.hybrid.convex_cost import with_norms_as_terms
from lin_freq_ocp.transform.hybrid.forms import piecewise_smooth

WARM_MU = 1e-3  # first weight of the barrier at a start that is taken to be near
UNIT_REVISIONS = 3  # an answer between obstacles, or far within its bounds, is accurate in its own units alone
FEW_STEPS = 60  # from others: 15 to 50 are common, and another start is better than many more


@dataclass(frozen=True, eq=False)
class LocalOptimum:
    """The end of an iteration; ``violation`` is the largest of all rows, in units in which limits are of order 1.

    The multipliers are those of the linearised problem of the mode sequence, with those of regions under REGION. If it
    has not ``converged``, the iteration ended before its residuals were small.
    """

    sequence: Indices
    trajectory: Trajectory
    multipliers: Multipliers
    cost: float
    violation: float
    converged: bool = True

    @property
    def feasible(self) -> bool:
        """Whether it is a trajectory of its mode sequence."""
        return self.violation <= VIOLATION

    @property
    def reason(self) -> Reason:
        """Return why another start may be tried after it."""
        solved = Reason.LOCALLY_OPTIMAL if self.converged else Reason.FEASIBLE
        return solved if self.feasible else Reason.FAILED


def is_smooth(problem: OptimalControlProblem) -> bool:
    """Whether the dynamics are one smooth map, in a region at most."""
    dynamics = piecewise_smooth(problem)
    return len(dynamics.modes) == 1 and not dynamics.norms


def smooth_optimum(
    problem: OptimalControlProblem,
    start: Trajectory,
    sequence: Indices | None = None,
    end: float = np.inf,
    warm: bool = True,
    below: float = np.inf,
) -> tuple[LocalOptimum | None, End]:
    """Return the local optimum of a mode sequence near a trajectory, or the last point, and how the iteration ended.

    Without a sequence, it is the first mode at all times. An optimum that costs ``below`` or more is of no use: as soon
    as that is clear, the iteration ends.

    None if a map is not defined at the start, or no trajectory with the fixed ends has this mode sequence. ``end`` is
    by ``clock.now``. ``warm``: the start is taken to be near an optimum, and worth many steps.
    """
    sequence = np.zeros(problem.horizon, dtype=np.intp) if sequence is None else sequence
    given, problem = problem, with_norms_as_terms(problem)
    below -= given.value(start.x, start.u) - problem.value(start.x, start.u) if below < np.inf else 0.0
    model = SmoothModel.at(problem, start, sequence)
    if model.outside > VIOLATION:
        return None, End.UNDEFINED
    first = (WARM_MU, MOST_STEPS) if warm else (FIRST_MU, FEW_STEPS)
    barrier = Barrier(model, loops(), end, *first, below * model.assembly.units.cost)
    answer = barrier.run(model.assembly.point(start))
    if answer.end is End.UNDEFINED:
        return None, answer.end
    trajectory = model.trajectory(answer.point.y)
    for _ in range(UNIT_REVISIONS if problem.value(trajectory.x, trajectory.u) < below else 0):
        if answer.end is End.OPTIMAL and barrier.unequal:
            again = model.revised(answer.point.y, 0.0 if problem.path_constraints else FAR_UNIT)
            weights = WARM_MU, MOST_STEPS
        else:
            stalled = answer.end is End.STALLED and not barrier.unequal
            assembly, weights = model.assembly.revised(answer.point.y) if stalled else None, first
            again = None if assembly is None else replace(model, assembly=assembly)
        if again is None:
            break
        after = Barrier(again, loops(), end, *weights).run(again.assembly.point(trajectory))
        if barrier.unequal and after.end is not End.OPTIMAL:
            answer = replace(answer, end=after.end if after.end is End.INTERRUPTED else answer.end)
            break
        model, answer = again, after
        trajectory = model.trajectory(answer.point.y)
    cost, before = (given.value(one.x, one.u) for one in (trajectory, start))
    multipliers = zero_multipliers(given, 1.0)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            if answer.end is not End.DEARER:  # then no one asks for them
                multipliers = model.multipliers(answer.point.y, answer.point.z)
                own = {term.name for term in problem.terms} - {term.name for term in given.terms}
                stage = {name: weights for name, weights in multipliers.stage.items() if name not in own}
                multipliers = replace(multipliers, stage=stage)
    except ProblemError:  # the duals grew until they overflowed
        return LocalOptimum(sequence, trajectory, multipliers, cost, np.inf), answer.end
    if before <= cost and model.violation(model.assembly.point(start)) <= answer.violation:
        trajectory, cost = start, before  # no step improves it: the iteration has left it by rounding
    converged = answer.end is End.OPTIMAL or answer.error <= ACCEPTABLE
    return LocalOptimum(sequence, trajectory, multipliers, cost, answer.violation, converged), answer.end
