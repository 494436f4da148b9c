"""Trajectories without cost or slope: solvers approach them only to the root of their tolerance."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.errors import NumericalError
from lin_freq_ocp.methods.candidate import Candidate
from lin_freq_ocp.methods.convex.polish import polished
from lin_freq_ocp.methods.convex.sparse_program import scaled_program
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.simulation import simulate
from lin_freq_ocp.problem.sizes import stated_sizes
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.backends.base import DEFAULT_TOLERANCE, Claim, backend
from lin_freq_ocp.program.program import Program

FLAT = 1e-4  # slope, relative to its terms, below which a trajectory without slope may exist nearby


def free_of_cost(problem: OptimalControlProblem, near: Trajectory) -> Candidate | None:
    """Return the trajectory of controls at their references, with multipliers of zero; None if it diverges.

    Controls without a cost, and the first state, are those of ``near``.
    """
    cost, (T, m) = problem.quadratic, near.u.shape
    priced = np.broadcast_to(np.diagonal(cost.R, axis1=-2, axis2=-1) > 0, (T, m))
    u = np.where(priced, cost.u_ref, near.u)
    follows = problem.dynamics.response(T) is not None  # x_0, too, from the controls
    try:
        trajectory = simulate(problem, u, None if follows else problem.state_tube.at(0).project(near.x[0]))
    except NumericalError:
        return None
    rho_u, rho_x = np.zeros(problem.control_stop.shape), np.zeros(problem.state_stop.shape)
    none = Multipliers(1.0, np.zeros((T, near.x.shape[1])), np.zeros_like(near.x), np.zeros((T, m)), rho_u, rho_x)
    return Candidate("optimal", trajectory, none, message="controls at their references")


def free_of_slope(problem: OptimalControlProblem, near: Trajectory, time_limit: float | None) -> Candidate | None:
    """Return a trajectory that satisfies all constraints and P z + q = 0, with multipliers of zero, or None.

    It is computed where the slope at ``near`` is small.
    """
    if any(not term.hard for term in problem.terms) or _slope(problem, near) > FLAT:
        return None
    transcription, scaling, program = scaled_program(problem)
    curved = np.flatnonzero(abs(program.P).sum(1) + np.abs(program.q))
    flat = Program(
        P=sp.csc_array(program.P.shape),
        q=np.zeros_like(program.q),
        constant=0.0,
        A=sp.csc_array(sp.vstack([program.A, program.P[curved]])),
        lower=np.concatenate([program.lower, -program.q[curved]]),
        upper=np.concatenate([program.upper, -program.q[curved]]),
        rows=program.rows,
        cones=program.cones,
    )
    solution = backend("clarabel")(flat, DEFAULT_TOLERANCE, time_limit)
    if solution.claim is not Claim.SOLVED or solution.z is None or solution.y is None:
        return None
    better = None if program.cones else polished(flat, solution.z, np.zeros_like(solution.y))
    z: Array = scaling.primal(solution.z if better is None else better[0])
    none = transcription.multipliers(np.zeros(len(program.lower)), 1.0)
    return Candidate("optimal", transcription.trajectory(z), none, message="a point where the cost has no slope")


def _slope(problem: OptimalControlProblem, at: Trajectory) -> float:
    """Return the largest slope of the cost, relative to that of terms of the stated sizes."""
    steady = [
        np.broadcast_to(size, signal.shape) for size, signal in zip(stated_sizes(problem), (at.x, at.u), strict=True)
    ]
    slopes = zip(problem.quadratic.gradient(at.x, at.u), steady, strict=True)
    usual = zip(problem.quadratic.gradient_magnitudes(*steady), steady, strict=True)
    most, least = (max(float(np.abs(g * size).max()) for g, size in pairs) for pairs in (usual, slopes))
    return least / most if most > 0 else np.inf
