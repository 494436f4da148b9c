"""Transcribe to a scaled sparse program, hand it to a backend, measure the answer, and map it back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.absorbed_cost import absorbed_cost
from lin_freq_ocp.methods.candidate import Candidate
from lin_freq_ocp.methods.convex.attempts import ACCURATE, SOLVED_TOLERANCE, Attempt, Solves, better_of, over
from lin_freq_ocp.methods.convex.retries import further
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.response_curvature import require_convex_bins
from lin_freq_ocp.program.backends.base import DEFAULT_TOLERANCE, backend
from lin_freq_ocp.program.dense_rows import dense_rows
from lin_freq_ocp.program.program import Program, Scaling
from lin_freq_ocp.program.transcription import LinearTranscription
from lin_freq_ocp.program.units import natural_scaling, own_scaling, plain_scaling, revised_scaling, stated_scaling

GRACE = 0.25  # seconds beyond a time limit in which a solver may return a point
REVISIONS = 2  # of the units by the answer


def solve_convex(
    problem: OptimalControlProblem, backend_name: str, tolerance: float | None, time_limit: float | None
) -> Candidate:
    """Solve a problem with linear dynamics and a convex quadratic cost, in units in which it should be of order 1.

    Where the answer shows other sizes, or is inaccurate, it is solved again in other units; the smallest residuals
    count. UnsupportedError if the cost is not convex, the backend is unknown, or the program does not fit into memory.
    """
    return next(convex_candidates(problem, backend_name, tolerance, time_limit))


def convex_candidates(
    problem: OptimalControlProblem, backend_name: str, tolerance: float | None, time_limit: float | None
) -> Iterator[Candidate]:
    """Yield what ``solve_convex`` returns, then other answers, until the time limit, for where the first is not proven.

    After Ctrl-C the last is the first again, interrupted. Raises what ``solve_convex`` raises.
    """
    require_convex(problem)
    absorbed = absorbed_cost(problem)
    if absorbed is not None:
        found = convex_candidates(absorbed.problem, backend_name, tolerance, time_limit)
        yield from map(absorbed.candidate, found)
        return
    solver = backend(backend_name)
    started = now()
    rows = dense_rows(problem)
    if time_limit is not None and rows.seconds > time_limit + GRACE:
        program = f"a program of {rows.variables} variables with {rows.count} dense rows"
        message = f"time limit of {time_limit:.3g} s; {program} needs about {rows.seconds:.2g} s"
        yield Candidate("limit", message=message, seconds={"setup": 0.0, "solve": 0.0})
        return
    transcription = LinearTranscription(problem)
    scaling = natural_scaling(transcription)
    ready = now()
    end = np.inf if time_limit is None else started + time_limit - rows.factorisation_seconds
    if ready >= end + GRACE:
        message = f"time limit of {time_limit:.3g} s, over before the solver began"
        yield Candidate("limit", message=message, seconds={"setup": ready - started, "solve": 0.0})
        return
    interior = backend_name == "clarabel"  # its last steps cost little, and often lead to a proof
    target = max(ACCURATE if interior else SOLVED_TOLERANCE, 0.0 if interior else tolerance or 0.0)
    asked = DEFAULT_TOLERANCE if tolerance is None else min(tolerance, DEFAULT_TOLERANCE) if interior else tolerance
    solves = Solves(transcription, solver, tolerance, asked, end, target)
    best = _best(solves, scaling)
    seconds = {"setup": ready - started, "solve": now() - ready}
    yield replace(best.candidate, seconds=seconds)
    for candidate in further(solves, scaling, best):
        yield replace(candidate, seconds={**seconds, "solve": now() - ready})


def _best(solves: Solves, scaling: Scaling) -> Attempt:
    """Return the best attempt: in the given units, in those of the answers, and in others if none is accurate."""
    best = _followed(solves, solves.attempt(scaling))
    allowed = max(SOLVED_TOLERANCE, solves.tolerance or 0.0)
    for other in _others(solves, scaling):
        if best.ended or best.error <= allowed or over(solves):
            break
        best = better_of(best, _followed(solves, other(best)))
    return best


def _others(solves: Solves, natural: Scaling) -> list[Callable[[Attempt], Attempt]]:
    """Return further solves, each from the best attempt so far."""
    transcription = solves.transcription
    ways: list[Callable[[Attempt], Attempt]] = [
        lambda best: solves.attempt(_of_point(transcription, best, natural, per_time=True)),
        lambda best: solves.attempt(stated_scaling(transcription)),
        lambda best: solves.attempt(plain_scaling(transcription)),
    ]
    if solves.asked > DEFAULT_TOLERANCE:
        ways.insert(0, lambda best: solves.attempt(best.scaling, DEFAULT_TOLERANCE))
    return ways


def _of_point(transcription: LinearTranscription, best: Attempt, natural: Scaling, per_time: bool) -> Scaling:
    return natural if best.z is None else own_scaling(transcription, best.z, natural.columns, per_time)


def _followed(solves: Solves, attempt: Attempt) -> Attempt:
    """Return the attempt, or a better one in units of its own answer."""
    best = attempt
    for _ in range(REVISIONS):
        if best.ended or best.z is None or best.error <= solves.target or over(solves):
            break
        revised = revised_scaling(solves.transcription, best.scaling, best.z)
        if revised is None:
            break
        second = solves.attempt(revised)
        if not second.ended and second.error >= best.error:
            break
        best = better_of(best, second)
    return best


def require_convex(problem: OptimalControlProblem) -> None:
    """Raise UnsupportedError, with the time or the bins and the eigenvalue, unless the cost is convex."""
    response = problem.dynamics.response(problem.horizon)
    if response is not None:
        require_convex_bins(problem, response)
        return
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
    return transcription, scaling, transcription.program.scaled(scaling)
