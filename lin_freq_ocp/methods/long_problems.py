"""Long problems with stop bands: each removed bin is a dense row of a sparse program, which takes hours to factor.

The Fourier-domain and the structured method have no such rows. So where a program would be solved on the way to an
answer, such as a projection, a problem with the same dynamics and stop bands, and another cost, is solved instead.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, split_signals
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.methods.candidate import DEFAULTS, Candidate, SolveOptions
from lin_freq_ocp.methods.spectral.solver import SpectralSolver
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.program.linear_program import dense_rows
from lin_freq_ocp.transform.sizes import stated_sizes

LONGEST_FACTOR = 2.0  # seconds of a factorisation, estimated


def is_long(problem: OptimalControlProblem, seconds: float | None = None) -> bool:
    """Whether a problem of bounds, ends and stop bands has too many dense rows for a factor in LONGEST_FACTOR."""
    plain, most = problem.response is None and not problem.terms, LONGEST_FACTOR if seconds is None else seconds
    return plain and dense_rows(problem).factorisation_seconds > most


def solve_long(
    problem: OptimalControlProblem,
    options: SolveOptions = DEFAULTS,
    spectral: bool = True,
    solver: SpectralSolver | None = None,
) -> Candidate | None:
    """Return the answer of the Fourier-domain method, or of the structured one if that has no optimum or ray.

    ``solver`` is one of a problem of the same structure. None if no method takes the problem.
    """
    with suppress(UnsupportedError):
        if spectral:
            found = (solver or SpectralSolver(problem)).solve_similar(problem, options.time_limit)
            if found.status in (Status.OPTIMAL, Status.INFEASIBLE):
                return found
    with suppress(UnsupportedError):
        from lin_freq_ocp.methods.structured.solver import solve_structured  # few problems need its modules

        return next(solve_structured(problem, options))
    return None


def distance_cost(
    problem: OptimalControlProblem, x_ref: Array | float = 0.0, u_ref: Array | float = 0.0
) -> QuadraticCost:
    """Return half the squared distance from a trajectory, in the sizes that the data state."""
    of_x, of_u = (np.diag(size**-2.0) for size in stated_sizes(problem))
    return QuadraticCost(Q=of_x, R=of_u, P=of_x, x_ref=x_ref, u_ref=u_ref)


def with_sides(
    problem: OptimalControlProblem, lower: Array, upper: Array, offset: Array, cost: QuadraticCost
) -> OptimalControlProblem:
    """Return the problem with other bounds of z_t = (x_t, u_t), (T+1, n+m), another offset and another cost."""
    (x, u), (x_upper, u_upper) = (split_signals(side, problem.state_dim) for side in (lower, upper))
    return problem.derived(
        dynamics=replace(problem.linear, offset=offset),
        cost=cost,
        state_set=Box(x, x_upper),
        control_set=Box(u, u_upper),
        initial_state=Box(x[0], x_upper[0]),
        terminal_state=Box(x[-1], x_upper[-1]),
    )
