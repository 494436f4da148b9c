"""Multipliers for a trajectory that came without any: those that violate the maximum principle least.

At a fixed point z of the program, with g = P z + q,

    minimise  1/2 |s|^2   subject to   s = g + A'y,   y_i >= 0 at an active upper bound, <= 0 at a lower one,
                                       y_i = 0 where neither is active, free for equations.

s = 0 iff z is extremal. Nothing here judges: the judge sees only what comes out.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.backends.base import DEFAULT_TOLERANCE, backend
from lin_freq_ocp.errors import NumericalError
from lin_freq_ocp.methods.convex import scaled_program
from lin_freq_ocp.problem.arrays import Array
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transcription.program import Program

ACTIVE = 1e-6
"""Distance to a bound, on a program scaled to order 1, at which it counts as active: other tools stop at about 1e-8."""


def fit_multipliers(problem: OptimalControlProblem, trajectory: Trajectory) -> Multipliers:
    """Return normal multipliers (eta_C = 1) that fit the trajectory best.

    Raises
    ------
    NumericalError
        If the fitting problem could not be solved.
    """
    transcription, scaling, program = scaled_program(problem)
    z = transcription.point(trajectory) / scaling.columns
    solution = backend("clarabel")(_fitting_program(program, z), DEFAULT_TOLERANCE, None)
    if solution.z is None:
        raise NumericalError(f"No multipliers could be fitted to the trajectory ({solution.words}); pass multipliers=.")
    y = solution.z[: len(program.lower)]
    return transcription.multipliers(scaling.dual(y), 1.0)


def _fitting_program(program: Program, z: Array) -> Program:
    """Return the least-squares problem in (y, s), with rows s - A'y = g and the signs of y."""
    rows, variables = program.A.shape
    gradient = program.P @ z + program.q
    Az = program.A @ z
    lower = np.where(Az <= program.lower + ACTIVE, -np.inf, 0.0)
    upper = np.where(Az >= program.upper - ACTIVE, np.inf, 0.0)
    identity = sp.eye_array(variables)
    return Program(
        P=sp.csc_array(sp.block_diag([sp.csc_array((rows, rows)), identity])),
        q=np.zeros(rows + variables),
        constant=0.0,
        A=sp.csc_array(sp.block_array([[-program.A.T, identity], [sp.eye_array(rows), None]])),
        lower=np.concatenate([gradient, lower]),
        upper=np.concatenate([gradient, upper]),
        rows={},
    )
