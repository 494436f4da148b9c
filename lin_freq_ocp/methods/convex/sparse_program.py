"""Transcribe to a scaled sparse program, hand it to a backend, measure the answer, and map it back."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.backends.base import DEFAULT_TOLERANCE, Claim, Solution, Solver, backend
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.methods.candidate import Candidate
from lin_freq_ocp.methods.convex.polish import polished
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.transcription.linear.dense_rows import dense_rows
from lin_freq_ocp.transcription.linear.transcription import LinearTranscription
from lin_freq_ocp.transcription.linear.units import (
    natural_scaling,
    own_scaling,
    own_sizes,
    plain_scaling,
    revised_scaling,
    stated_scaling,
)
from lin_freq_ocp.transcription.program import Program, Residuals, Scaling

SOLVED_TOLERANCE = 1e-6
"""Relative residuals up to which a backend's "solved" is accepted, in units in which the answer is of order 1."""

ACCURATE = 1e-8
"""Relative residuals from which an answer of Clarabel is not improved by other units."""

ENDLESS = 1e100
"""A point beyond so many units is no point."""

FAR = 1e4
"""Bounds that are so many times as large as what they bound is expected to be are left out, as they disturb solvers;
where the answer does not keep them, they come back."""

GRACE = 0.25
"""Seconds beyond a time limit that a solver may take to return a point, however inaccurate."""

LEAST_TIME = 1e-3
"""Seconds that are left to a solver when the time is over: it makes a step, and ends."""

REVISIONS = 2
"""How often the units may follow the answer."""

UNBOUNDED_TOLERANCE = 1e-6
"""Residual of a direction of descent, scaled to slope -1, up to which it counts as one."""


@dataclass(frozen=True, eq=False)
class _Attempt:
    """What one solve in some units ended with.

    Attributes
    ----------
    candidate : Candidate
    scaling : Scaling
        The units.
    z : (variables,) or None
        The point, in the program's own units.
    error : float
        How far it is from an answer: its residuals, in its own units if it is a point.
    """

    candidate: Candidate
    scaling: Scaling
    z: Array | None
    error: float

    @property
    def ended(self) -> bool:
        """Whether nothing more is to be tried."""
        return self.candidate.interrupted or (
            self.candidate.status == "limit" and "time" in self.candidate.words.lower()
        )


@dataclass(frozen=True, eq=False)
class _Solves:
    """One program, a solver, and what is asked of it."""

    transcription: LinearTranscription
    solver: Solver
    tolerance: float | None
    asked: float
    end: float
    enough: float

    @property
    def left(self) -> float | None:
        """Return the seconds that are left, or None for no limit."""
        return None if self.end == np.inf else max(self.end - time.perf_counter(), LEAST_TIME)

    def attempt(self, scaling: Scaling, tolerance: float | None = None) -> _Attempt:
        """Solve in the given units, and measure."""
        program = scaling.apply(self.transcription.program)
        near = program.without_bounds_beyond(FAR)
        if near is None:
            return self._solve(program, scaling, tolerance)
        attempt = self._solve(near, scaling, tolerance)
        if attempt.ended or attempt.candidate.status in ("optimal", "infeasible") or _over(self):
            return attempt
        complete = self._solve(program, scaling, tolerance)
        return complete if attempt.candidate.status == "unbounded" else _better(attempt, complete)

    def _solve(self, program: Program, scaling: Scaling, tolerance: float | None) -> _Attempt:
        solution = self.solver(program, tolerance or self.asked, self.left)
        attempt = _measured(self.transcription, scaling, program, solution, self.tolerance)
        if attempt.z is None or attempt.ended or attempt.error <= self.enough or program.cones or _over(self):
            return attempt
        assert solution.z is not None
        assert solution.y is not None
        better = polished(program, solution.z, solution.y)
        if better is None:
            return attempt
        claimed = replace(solution, claim=Claim.SOLVED, z=better[0], y=better[1])
        return _better(attempt, _measured(self.transcription, scaling, program, claimed, self.tolerance))


def solve_convex(
    problem: OptimalControlProblem, backend_name: str, tolerance: float | None, time_limit: float | None
) -> Candidate:
    """Solve a problem with linear dynamics and a convex quadratic cost.

    The program is solved in units in which its numbers are expected to be of order 1. Where the answer shows that they
    are not, or is no answer, it is solved again in others; the answer with the smallest residuals counts.

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
    end = np.inf if time_limit is None else started + time_limit - rows.factorisation_seconds
    if ready >= end + GRACE:
        words = f"time limit of {time_limit:.3g} s, over before the solver began"
        return Candidate("limit", None, None, None, None, words, {"setup": ready - started, "solve": 0.0})
    interior = backend_name == "clarabel"  # whose last steps cost little, and are worth a proof
    enough = max(ACCURATE if interior else SOLVED_TOLERANCE, 0.0 if interior else tolerance or 0.0)
    asked = DEFAULT_TOLERANCE if tolerance is None else min(tolerance, DEFAULT_TOLERANCE) if interior else tolerance
    candidate = _best(_Solves(transcription, solver, tolerance, asked, end, enough), scaling).candidate
    return replace(candidate, seconds={"setup": ready - started, "solve": time.perf_counter() - ready})


def _best(solves: _Solves, scaling: Scaling) -> _Attempt:
    """Return the best attempt: in the given units, in those of the answers, and in others if none is good."""
    best = _followed(solves, solves.attempt(scaling))
    allowed = max(SOLVED_TOLERANCE, solves.tolerance or 0.0)
    for other in _others(solves, scaling):
        if best.ended or best.error <= allowed or _over(solves):
            break
        best = _better(best, _followed(solves, other(best)))
    return best


def _others(solves: _Solves, natural: Scaling) -> list[Callable[[_Attempt], _Attempt]]:
    """Return further ways to an answer, each from the best attempt until then."""
    transcription = solves.transcription
    ways: list[Callable[[_Attempt], _Attempt]] = [
        lambda best: solves.attempt(_of_point(transcription, best, natural, per_time=True)),
        lambda best: solves.attempt(stated_scaling(transcription)),
        lambda best: solves.attempt(plain_scaling(transcription)),
    ]
    if solves.asked > DEFAULT_TOLERANCE:
        ways.insert(0, lambda best: solves.attempt(best.scaling, DEFAULT_TOLERANCE))
    return ways


def _of_point(transcription: LinearTranscription, best: _Attempt, natural: Scaling, per_time: bool) -> Scaling:
    return natural if best.z is None else own_scaling(transcription, best.z, natural.columns, per_time)


def _followed(solves: _Solves, attempt: _Attempt) -> _Attempt:
    """Return the attempt, or a better one in the units that its answer turned out to need."""
    best = attempt
    for _ in range(REVISIONS):
        if best.ended or best.z is None or best.error <= solves.enough or _over(solves):
            break
        revised = revised_scaling(solves.transcription, best.scaling, best.z)
        if revised is None:
            break
        second = solves.attempt(revised)
        if not second.ended and second.error >= best.error:
            break
        best = _better(best, second)
    return best


def _better(one: _Attempt, other: _Attempt) -> _Attempt:
    """Return the better of two attempts, the other one later; a point is kept where the later solve was cut short."""
    if other.ended:
        return replace(one, candidate=replace(one.candidate, interrupted=other.candidate.interrupted))
    return other if other.error < one.error else one


def _over(solves: _Solves) -> bool:
    return time.perf_counter() >= solves.end


def require_convex(problem: OptimalControlProblem) -> None:
    """Raise UnsupportedError, with the time and eigenvalue, unless the cost is convex."""
    worst = problem.quadratic.nonconvexity()
    if worst is not None:
        where = "P" if worst[0] < 0 else f"[[Q, S], [S', R]] at t = {worst[0]}"
        raise UnsupportedError(
            f"cost: {where} has the eigenvalue {worst[1]:g}; a convex method needs it positive semidefinite. "
            "certify() judges trajectories of nonconvex problems too."
        )


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


def _measured(
    transcription: LinearTranscription, scaling: Scaling, program: Program, solution: Solution, tolerance: float | None
) -> _Attempt:
    """Return an attempt from what a solver said of a program in some units."""
    z, y, claim = solution.z, solution.y, solution.claim
    if claim is Claim.INFEASIBLE:
        ray = None if y is None else transcription.multipliers(scaling.dual(y), 0.0)
        error = np.inf if y is None else program.infeasibility_residual(y)
        return _Attempt(Candidate("infeasible", None, None, ray, None, solution.words), scaling, None, error)
    if claim is Claim.UNBOUNDED:
        ray = None if z is None or program.descent_ray_residual(z) == np.inf else nearest_recession(program, z)
        error = np.inf if ray is None else program.descent_ray_residual(ray)
        if ray is None or error > UNBOUNDED_TOLERANCE:
            return _Attempt(_failed(solution.words), scaling, None, np.inf)
        along = transcription.direction(scaling.primal(ray))
        return _Attempt(
            Candidate("unbounded", None, None, None, None, solution.words, descent=along), scaling, None, error
        )
    if z is None or y is None:
        return _Attempt(replace(_failed(solution.words), interrupted=claim is Claim.INTERRUPTED), scaling, None, np.inf)
    if not program.P.nnz and not program.q.any():
        y = np.zeros_like(y)  # nothing to minimise: multipliers of zero are exact, the solver's are rounding
    point, duals = scaling.primal(z), scaling.dual(y)
    residuals = _residuals(transcription, scaling, point, duals)
    if claim in (Claim.LIMIT, Claim.INTERRUPTED):
        status = "limit"
    else:
        status = "optimal" if residuals.worst <= max(SOLVED_TOLERANCE, tolerance or 0.0) else "numerical_error"
    candidate = Candidate(
        status,
        transcription.trajectory(point),
        transcription.multipliers(duals, 1.0),
        None,
        residuals,
        solution.words,
        interrupted=claim is Claim.INTERRUPTED,
    )
    return _Attempt(candidate, scaling, point if np.isfinite(residuals.worst) else None, residuals.worst)


def _failed(words: str) -> Candidate:
    return Candidate("numerical_error", None, None, None, None, words)


def _residuals(transcription: LinearTranscription, scaling: Scaling, z: Array, y: Array) -> Residuals:
    """Return the residuals of a point and duals, both in the program's own units, in those of the point."""
    if not (np.abs(z) < ENDLESS * scaling.columns).all():  # it has diverged
        return Residuals(np.inf, np.inf, np.inf)
    own = own_scaling(transcription, z, scaling.columns)
    sizes = own_sizes(transcription, z) / own.columns
    return own.apply(transcription.program).residuals(z / own.columns, y * own.cost / own.rows, sizes)
