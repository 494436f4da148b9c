"""Refinement of a solver's rays.

A ray of descent is projected onto the recession cone: the directions along which every constraint holds for ever and
the cost has no curvature.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.backends.base import DEFAULT_TOLERANCE, Claim, backend
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.program import Program
from lin_freq_ocp.program.units import stated_scaling


def steepest_recession(problem: OptimalControlProblem) -> Trajectory | None:
    """Return the recession direction nearest to minus the slope of the cost, for the judge to verify; None without one.

    The slope along it is minus the square of its length: the cost falls without bound. Lengths are measured in the
    sizes that the data state, so that neither the unit of the cost nor a trajectory affects the result. The direction
    is scaled to length 1 and projected once more: if it is short compared with the slope, the first projection leaves
    it few digits.
    """
    linear = LinearProgram(problem)
    scaling = stated_scaling(linear)
    program = linear.sparse.scaled(scaling)
    along = -program.q
    for _ in range(2):
        if not along.any():
            return None
        along = nearest_recession(program, along / np.abs(along).max())
    return linear.direction(scaling.primal(along))


def nearest_recession(program: Program, z: Array) -> Array:
    """Return the recession direction nearest to z, with P z = 0; z itself if the projection fails.

    A solver's ray may satisfy cones to the root of a tolerance only. A cone with a constant s_0, such as that of a
    mask, requires s = 0 of a direction.
    """
    fixed = np.isfinite(program.upper) & np.isfinite(program.lower)
    limited, curved = np.isfinite(program.upper) | np.isfinite(program.lower), list[int]()
    constant = abs(program.A).sum(1) == 0
    for cone in program.cones:
        if constant[cone.start]:
            fixed[cone] = True
        else:
            curved += range(cone.start, cone.stop)
    alone = np.setdiff1d(np.flatnonzero(limited & ~constant), curved)
    first, size = len(alone) + len(z), float(np.abs(z).max())
    lower = np.where(np.isfinite(program.lower[alone]), 0.0, -np.inf)
    upper = np.where(np.isfinite(program.upper[alone]) | fixed[alone], 0.0, np.inf)
    nearest = Program(
        P=sp.csc_array(sp.eye_array(len(z))),
        q=-z / size,
        A=sp.csc_array(sp.vstack([program.A[alone], program.P, program.A[curved]])),
        lower=np.concatenate([lower, np.zeros(len(z) + len(curved))]),
        upper=np.concatenate([upper, np.zeros(len(z)), np.full(len(curved), np.inf)]),
        cones=consecutive([cone for cone in program.cones if not constant[cone.start]], first),
    )
    solution = backend("clarabel")(nearest, DEFAULT_TOLERANCE, None)
    return z if solution.claim is not Claim.SOLVED or solution.z is None else size * solution.z


def consecutive(cones: Sequence[slice], first: int) -> tuple[slice, ...]:
    """Return slices of the same sizes, one after the other."""
    sizes = [cone.stop - cone.start for cone in cones]
    starts = first + np.cumsum([0, *sizes])
    return tuple(slice(int(start), int(start) + size) for start, size in zip(starts, sizes, strict=False))
