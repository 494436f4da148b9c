"""Controls of an unstable system without a fixed end, rounded so that its exact trajectory stays near the given one.

The rounding errors of controls grow with the free motion, and no equation at the end moves them back. With a feedback,
u_t = the given control + K_t (the exact x_t - the given one), rounded, each control removes what those before it left:
K_t is that of the linear-quadratic regulator whose weights are 1 for deviations as large as the signals.
"""

from __future__ import annotations

import numpy as np
from flint import arb_mat, ctx

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.certificate.sizes import trajectory_sizes
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.proof.growth import growth, precision

LEAST_GROWTH = 20.0  # of rounding errors in bits below which they need no feedback; units of states may make 10


def needs_feedback(problem: OptimalControlProblem) -> bool:
    """Whether rounding of controls grows towards a free end; removed bins of controls would leave no feedback."""
    free = not problem.state_tube.fixed[-1].all() and not problem.control_stop.any()
    return bool(free and growth(problem.linear.A, problem.horizon) > LEAST_GROWTH)


def with_feedback(problem: OptimalControlProblem, at: Trajectory) -> Trajectory:
    """Return the trajectory with controls whose exact trajectory stays near it."""
    with ctx.workprec(precision(problem.linear.A, problem.horizon)):
        return Trajectory(at.x, _followed(problem, at, regulator(problem, at)))


def _followed(problem: OptimalControlProblem, at: Trajectory, gains: Array) -> Array:
    """Return the rounded controls, (T, m), of a feedback from the trajectory that is their own."""
    start, fixed = problem.state_tube.project(at.x)[0], problem.control_tube.fixed
    x, controls = arb_mat([[one] for one in start.tolist()]), problem.control_tube.project(at.u)
    for t, gain in enumerate(gains):
        A, B, d = problem.linear.at(t)
        away = [float(x[i, 0] - one) for i, one in enumerate(at.x[t].tolist())]
        controls[t] += np.where(fixed[t], 0.0, gain @ away)
        now = arb_mat([[one] for one in controls[t].tolist()])
        x = arb_mat(A.tolist()) * x + arb_mat(B.tolist()) * now + arb_mat([[one] for one in d.tolist()])
    return controls


def regulator(problem: OptimalControlProblem, at: Trajectory) -> Array:
    """Return the gains K_t, (T, m, n)."""
    of_x, of_u = (1.0 / size**2 for size in trajectory_sizes(problem, at))
    Q, R, T = np.diag(of_x), np.diag(of_u), problem.horizon
    gains, P = np.empty((T, len(of_u), len(of_x))), Q
    for t in reversed(range(T)):
        A, B, _ = problem.linear.at(t)
        gains[t] = -np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
        closed = A + B @ gains[t]
        P = Q + gains[t].T @ R @ gains[t] + closed.T @ P @ closed
    return gains
