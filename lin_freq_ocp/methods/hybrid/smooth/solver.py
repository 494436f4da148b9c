"""A local optimum of a problem whose dynamics are one smooth map, from a trajectory that need not be feasible."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.methods.hybrid.nonsmooth.sequential import LocalOptimum
from lin_freq_ocp.methods.hybrid.smooth.barrier import FIRST_MU, MOST_STEPS, Barrier, End
from lin_freq_ocp.methods.hybrid.smooth.model import SmoothModel
from lin_freq_ocp.methods.structured.kkt.recursions import loops
from lin_freq_ocp.problem.hybrid.forms import piecewise_smooth
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory

WARM_MU = 1e-3  # first weight of the barrier at a start that is believed to be near
FEW_STEPS = 60  # from others: 15 to 50 are common, and another start is better than many more


def is_smooth(problem: OptimalControlProblem) -> bool:
    """Whether the dynamics are one smooth map that holds everywhere it is defined."""
    dynamics = piecewise_smooth(problem)
    return len(dynamics.modes) == 1 and not dynamics.modes[0].region and not dynamics.norms


def smooth_optimum(
    problem: OptimalControlProblem, start: Trajectory, end: float = np.inf, warm: bool = True
) -> tuple[LocalOptimum | None, End]:
    """Return the local optimum near a trajectory, or the last point, and how the iteration ended.

    None if the map is not defined at the start. ``end`` is by ``clock.now``. ``warm``: the start is believed to
    be near, and worth many steps.
    """
    model = SmoothModel.at(problem, start)
    first = (WARM_MU, MOST_STEPS) if warm else (FIRST_MU, FEW_STEPS)
    barrier = Barrier(model, loops(patient=end == np.inf), end, *first)
    answer = barrier.run(model.assembly.point(start))
    if answer.end is End.UNDEFINED:
        return None, answer.end
    trajectory = model.trajectory(answer.point.y)
    multipliers = model.multipliers(answer.point.y, answer.point.z)
    cost = problem.value(trajectory.x, trajectory.u)
    sequence = np.zeros(problem.horizon, dtype=np.intp)
    return LocalOptimum(sequence, trajectory, multipliers, cost, answer.violation), answer.end
