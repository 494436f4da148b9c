"""Transcribe to a scaled sparse program, hand it to a backend, measure the answer, and map it back."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.backends.base import DEFAULT_TOLERANCE, Claim, Solution, Solver, backend
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.methods.candidate import Candidate
from lin_freq_ocp.problem.arrays import Array
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.transcription.dense_rows import dense_rows
from lin_freq_ocp.transcription.linear import LinearTranscription
from lin_freq_ocp.transcription.program import Program, Scaling
from lin_freq_ocp.transcription.units import natural_scaling, revised_scaling, stated_scaling

SOLVED_TOLERANCE = 1e-6
"""Relative residuals of the scaled program up to which a backend's "solved" is accepted."""

NOISE = 1e-10
"""What a solver leaves, on a program scaled to order 1, of states and controls that are zero."""

GRACE = 0.25
"""Seconds beyond a time limit that a solver may take to return a point, however inaccurate."""

LEAST_TIME = 1e-3
"""Seconds that a solver is given then: it makes a step, and stops."""

UNBOUNDED_TOLERANCE = 1e-6
"""Residual of a direction of descent, scaled to slope -1, up to which it counts as one."""


def solve_convex(
    problem: OptimalControlProblem, backend_name: str, tolerance: float | None, time_limit: float | None
) -> Candidate:
    """Solve a problem with linear dynamics and a convex quadratic cost.

    Raises
    ------
    UnsupportedError
        If the cost is not convex, there is no such backend, or the program does not fit into memory.
    """
    require_convex(problem)
    solver = backend(backend_name)
    started = time.perf_counter()
    rows = dense_rows(problem)
    if time_limit is not None and rows.seconds > time_limit + GRACE:
        words = f"time limit of {time_limit:.3g} s; its {rows.count} dense rows need about {rows.seconds:.2g} s"
        return Candidate("limit", None, None, None, None, words, {"setup": 0.0, "solve": 0.0})
    transcription = LinearTranscription(problem)
    scaling = natural_scaling(transcription)
    ready = time.perf_counter()
    left = None if time_limit is None else time_limit - (ready - started) - rows.factorisation_seconds
    if left is not None and left <= -GRACE:
        words = f"time limit of {time_limit:.3g} s, over before the solver began"
        return Candidate("limit", None, None, None, None, words, {"setup": ready - started, "solve": 0.0})
    left = None if left is None else max(left, LEAST_TIME)
    candidate = _attempt(transcription, scaling, solver, tolerance, left)
    revised = _revised(transcription, scaling, candidate)
    left = None if time_limit is None else time_limit - (time.perf_counter() - started)
    if revised is not None and (left is None or left > 0):
        second = _attempt(transcription, revised, solver, tolerance, left)
        candidate = second if second.status == "optimal" else replace(candidate, interrupted=second.interrupted)
    return replace(candidate, seconds={"setup": ready - started, "solve": time.perf_counter() - ready})


def require_convex(problem: OptimalControlProblem) -> None:
    """Raise UnsupportedError, with the time and eigenvalue, unless the cost is convex."""
    worst = problem.quadratic.nonconvexity()
    if worst is not None:
        where = "P" if worst[0] < 0 else f"[[Q, S], [S', R]] at t = {worst[0]}"
        raise UnsupportedError(
            f"cost: {where} has the eigenvalue {worst[1]:g}; a convex method needs it positive semidefinite. "
            "certify() judges trajectories of nonconvex problems too."
        )


def without_noise(transcription: LinearTranscription, z: Array) -> Array:
    """Return a point of the scaled program, with components that are below NOISE at all times at their references."""
    problem, clean = transcription.problem, z.copy()
    ends = (problem.horizon + 1) * problem.state_dim, transcription.signals
    for part, count in ((clean[: ends[0]], problem.state_dim), (clean[ends[0] : ends[1]], problem.control_dim)):
        signal = part.reshape(-1, count)
        signal[:, np.abs(signal).max(0) <= NOISE] = 0.0
    return clean


def scaled_program(problem: OptimalControlProblem) -> tuple[LinearTranscription, Scaling, Program]:
    """Return the transcription, its natural units, and the program in them."""
    transcription = LinearTranscription(problem)
    scaling = natural_scaling(transcription)
    return transcription, scaling, scaling.apply(transcription.program)


def nearest_recession(program: Program, z: Array) -> Array:
    """Return the point nearest to z that recedes from no constraint, P z = 0; z itself if it was not found.

    A ray ends where its slope is steep enough, however inaccurate: equations are met to the root of a tolerance where
    they stand in a cone. Here s_0 >= |(s_1, ...)| with a constant s_0, as of a mask, says s = 0.
    """
    fixed = np.isfinite(program.upper) & np.isfinite(program.lower)
    kept, curved = np.isfinite(program.upper) | np.isfinite(program.lower), list[int]()
    constant = abs(program.A).sum(1) == 0
    for cone in program.cones:
        if constant[cone.start]:
            fixed[cone] = True
        else:
            curved += range(cone.start, cone.stop)
    alone = np.setdiff1d(np.flatnonzero(kept & ~constant), curved)
    first, size = len(alone) + len(z), float(np.abs(z).max())
    lower = np.where(np.isfinite(program.lower[alone]), 0.0, -np.inf)
    upper = np.where(np.isfinite(program.upper[alone]) | fixed[alone], 0.0, np.inf)
    sizes = [cone.stop - cone.start for cone in program.cones if not constant[cone.start]]
    starts = first + np.cumsum([0, *sizes])
    nearest = Program(
        P=sp.csc_array(sp.eye_array(len(z))),
        q=-z / size,
        constant=0.0,
        A=sp.csc_array(sp.vstack([program.A[alone], program.P, program.A[curved]])),
        lower=np.concatenate([lower, np.zeros(len(z) + len(curved))]),
        upper=np.concatenate([upper, np.zeros(len(z)), np.full(len(curved), np.inf)]),
        rows={},
        cones=tuple(slice(int(start), int(start) + count) for start, count in zip(starts, sizes, strict=False)),
    )
    solution = backend("clarabel")(nearest, DEFAULT_TOLERANCE, None)
    return z if solution.claim is not Claim.SOLVED or solution.z is None else size * solution.z


def _attempt(
    transcription: LinearTranscription,
    scaling: Scaling,
    solver: Solver,
    tolerance: float | None,
    time_limit: float | None,
) -> Candidate:
    """Solve in the given units, and measure."""
    program = scaling.apply(transcription.program)
    solution = solver(program, tolerance or DEFAULT_TOLERANCE, time_limit)
    candidate = _candidate(transcription, scaling, program, solution)
    return replace(candidate, interrupted=solution.claim is Claim.INTERRUPTED)


def _revised(transcription: LinearTranscription, scaling: Scaling, candidate: Candidate) -> Scaling | None:
    """Return better units if the answer shows that it was solved in wrong ones."""
    if candidate.trajectory is None or candidate.status == "limit":
        return None
    return revised_scaling(transcription, scaling, transcription.point(candidate.trajectory))


def _stated(transcription: LinearTranscription, scaling: Scaling, candidate: Candidate) -> Scaling | None:
    """Return the units that the data state if there is no answer in others: they may be the reason.

    Infeasibility is proven by a ray, which does not depend on units; a solver that works in wrong ones claims it too.
    """
    if candidate.status not in ("infeasible", "numerical_error") or candidate.interrupted:
        return None
    return stated_scaling(transcription, scaling)


def _candidate(transcription: LinearTranscription, scaling: Scaling, program: Program, solution: Solution) -> Candidate:
    z, y, claim = solution.z, solution.y, solution.claim
    if claim is Claim.INFEASIBLE:
        ray = None if y is None else transcription.multipliers(scaling.dual(y), 0.0)
        return Candidate("infeasible", None, None, ray, None, solution.words)
    if claim is Claim.UNBOUNDED:
        ray = None if z is None or program.descent_ray_residual(z) == np.inf else nearest_recession(program, z)
        if ray is None or program.descent_ray_residual(ray) > UNBOUNDED_TOLERANCE:
            return Candidate("numerical_error", None, None, None, None, solution.words)
        along = transcription.direction(scaling.primal(ray))
        return Candidate("unbounded", None, None, None, None, solution.words, descent=along)
    if z is None or y is None:
        return Candidate("numerical_error", None, None, None, None, solution.words)
    z = without_noise(transcription, z)
    if not program.P.nnz and not program.q.any():
        y = np.zeros_like(y)  # nothing to minimise: multipliers of zero are exact, the solver's are rounding
    residuals = program.residuals(z, y)
    if claim in (Claim.LIMIT, Claim.INTERRUPTED):
        status = "limit"
    else:
        status = "optimal" if residuals.worst <= SOLVED_TOLERANCE else "numerical_error"
    return Candidate(
        status,
        transcription.trajectory(scaling.primal(z)),
        transcription.multipliers(scaling.dual(y), 1.0),
        None,
        residuals,
        solution.words,
    )
