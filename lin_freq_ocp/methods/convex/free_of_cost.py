"""The trajectory that costs nothing, where there is one: solvers come near it only to the root of their tolerance."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.errors import NumericalError
from lin_freq_ocp.methods.candidate import Candidate
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.simulation import simulate
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory


def free_of_cost(problem: OptimalControlProblem, near: Trajectory) -> Candidate | None:
    """Return the trajectory of controls at their references, with multipliers of zero; None if it leads nowhere.

    Controls without a cost of their own, and the first state, are those of ``near``. Of a cost that is never negative,
    a feasible trajectory that costs nothing is an optimum, which the judge is to find out.
    """
    cost, (T, m) = problem.quadratic, near.u.shape
    priced = np.broadcast_to(np.diagonal(cost.R, axis1=-2, axis2=-1) > 0, (T, m))
    u = np.where(priced, cost.u_ref, near.u)
    try:
        trajectory = simulate(problem, u, problem.state_tube.at(0).project(near.x[0]))
    except NumericalError:
        return None
    rho_u, rho_x = np.zeros(problem.control_stop.shape), np.zeros(problem.state_stop.shape)
    none = Multipliers(1.0, np.zeros((T, near.x.shape[1])), np.zeros_like(near.x), np.zeros((T, m)), rho_u, rho_x)
    return Candidate("optimal", trajectory, none, None, None, "controls at their references")
