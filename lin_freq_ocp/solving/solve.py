"""From a problem to a judged outcome: the method is chosen, its options are checked, its answer is judged.

Masks at every frequency are solved by exchange: a method solves problems with masks at finitely many frequencies. A
round adds the frequencies of all local maxima of |V| above the limit, and drops those without a multiplier, or next
to an added one. For a residual vibration, frequencies are points (natural frequency, damping ratio) of a box. A problem
with finitely many of the constraints is a relaxation: its infeasibility proof and its bound are those of the problem,
and its trajectory is judged at every frequency.

References: Hettich and Kortanek, SIAM Review 35, 1993 (semi-infinite programming: exchange methods).
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.phrases import plural
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE, PEAK_TOLERANCE
from lin_freq_ocp.methods.progress import Progress
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.reductions import Inverse
from lin_freq_ocp.problem.reformulations import Translation, sampled_masks, translation_of
from lin_freq_ocp.problem.starts import start_of
from lin_freq_ocp.problem.terms.semi_infinite import peaks_above
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.backends.base import backend as solver_named
from lin_freq_ocp.program.backends.base import names
from lin_freq_ocp.solving.families import choose_method, require_shorthand, saved_options
from lin_freq_ocp.solving.judging import (
    allowed_residual,
    candidate_of,
    judge_candidate,
    recover_outcome,
    reduce_fractional_samples,
)
from lin_freq_ocp.solving.method import Method, Report, Request
from lin_freq_ocp.solving.outcome import Outcome

COARSE = 1e-8  # rounding of a state, relative to what it moves, that may be worth as much as the allowed gap


def solve_judged(
    problem: OptimalControlProblem,
    method: str | Method = "auto",
    time_limit: float | None = None,
    progress: Report | None = None,
    start: object = None,
    backend: str = "auto",
    tolerance: float | None = None,
    gap: float | None = None,
    node_limit: int | None = None,
    executor: Executor | None = None,
    global_bound: bool | None = None,
) -> Outcome:
    """Solve a problem, and judge the answer; parameters and errors are those of ``lfo.solve``."""
    require_problem(problem)
    limits = {"tolerance": tolerance, "gap": gap, "node_limit": node_limit}
    require_options(method, backend, time_limit=time_limit, **limits)
    options = {**limits, "executor": executor, "start": start, "global_bound": global_bound}
    found = choose_method(problem, method, {"backend": None if backend == "auto" else backend, **options})
    begin = None if start is None else start_of(problem, start)
    allowed = tolerance or getattr(found, "tolerance", None)
    request = Request(np.inf if time_limit is None else time_limit, allowed, progress, begin)
    translation = translation_of(problem)
    outcome = reduce_fractional_samples(solve_translated(found, translation, request), tolerance)
    outcome = restore_outcome(translation, outcome, allowed)
    saved = saved_options(problem, method, found) | ({} if begin is None else {"start": begin.saved})
    return replace(outcome, options=saved | {"time_limit": time_limit})


def require_options(method: str | Method, backend: str = "auto", **limits: float | None) -> None:
    """Raise UnsupportedError unless the options of solve exist, MissingExtraError if the backend is not installed.

    ``limits`` are numbers above zero, such as time_limit, tolerance, gap and node_limit; None: not given.
    """
    if isinstance(method, str):
        require_shorthand(method)
    if backend not in ("auto", *names(binaries=True)):
        solver_named(backend)
    for name, value in limits.items():
        if value is not None and not value > 0:
            raise UnsupportedError(f"{name}: got {value!r}; expected a number above zero, or None.")


def solve_translated(method: Method, translation: Translation, request: Request) -> Outcome:
    """Solve the translated problem by a method.

    Start and progress of the request are those of the given problem; what it keeps of earlier solves is not.
    """
    problem, start, progress, constant = translation.problem, request.start, request.progress, translation.cost
    if start is not None and start.trajectory is not None:
        request = replace(request, start=replace(start, trajectory=translation.translated(start.trajectory)))
    if progress is not None and constant:

        def report(at: Progress) -> None:  # for the cost of the given problem
            progress(replace(at, cost=at.cost + constant, lower_bound=at.lower_bound + constant))

        request = replace(request, progress=report)
    if all(term.everywhere is None for term in problem.terms):
        return method.solve(problem, request)
    return solve_at_every_frequency(problem, method, request)


def restore_outcome(translation: Translation, outcome: Outcome, tolerance: float | None = None) -> Outcome:
    """Return an outcome of the translated problem as one of the given problem.

    Its states are rounded to the digits that the given coordinates have. The certificate is that of the rounded
    trajectory.
    """
    if not translation.moves:
        return outcome
    outcome = recover_outcome(translation, outcome, allowed_residual(tolerance))
    at, unproven = outcome.trajectory, outcome.status in (Status.LOCALLY_OPTIMAL, Status.NUMERICAL_ERROR)
    if outcome.certificate is None or at is None or not unproven:
        return outcome
    return replace(outcome, message="; ".join(filter(None, [outcome.message, _rounding_message(translation, at)])))


def _rounding_message(translation: Translation, trajectory: Trajectory) -> str:
    """Return which state is rounded by how much, where that may be why an answer is not optimal; else nothing."""
    size, moves = np.spacing(np.abs(translation.origin)), np.ptp(trajectory.x, axis=0)
    i = int(np.argmax(np.divide(size, moves, out=np.zeros(len(size)), where=moves > 0)))
    if size[i] <= COARSE * moves[i]:
        return ""
    name = translation.given.state_names[i]
    return f"{name} lies so far from zero that double precision rounds it by {size[i]:.1e}: count it from nearer"


LEFT_VIOLATION = 1e-9  # of |V| over its limit, relative: what interior points leave on the frequencies that they know
ROUNDS = 30  # five or six reach LEFT_VIOLATION: convergence is quadratic
IDLE = 1e-6  # part of the largest multiplier below which a frequency is dropped: without it the cost is the same
APART = 1e-4  # of the distance of two bins: |V| differs there by 5e-8 at most, relative to its largest value
LEAST_PROGRESS = 0.5  # part of the violation of a round that a round must leave at most, once it is below SMALL
SMALL = 2e-7  # below the violation that the judge allows

Frequencies = dict[str, Array]


class _Round(NamedTuple):
    """The outcome of a relaxed problem, the way back, and the violation |V|/l - 1 at other frequencies."""

    inverse: Inverse
    found: Outcome
    violation: float


def solve_at_every_frequency(problem: OptimalControlProblem, method: Method, request: Request) -> Outcome:
    """Solve a problem with masks at every frequency by any method, and judge the answer."""
    request = replace(request, cached=None, tree=None)
    end = now() + request.time_limit
    masks = [(term, term.everywhere) for term in problem.terms if term.everywhere is not None]
    frequencies = {term.name: term.map.places for term, _ in masks}
    seconds, violation, rounds = dict[str, float](), np.inf, list[_Round]()
    for _ in range(ROUNDS):
        inverse = sampled_masks(problem, frequencies)
        found = method.solve(inverse.problem, request.with_end(end))
        seconds |= {what: seconds.get(what, 0.0) + value for what, value in found.seconds.items()}
        if found.trajectory is None or found.multipliers is None:
            rounds.append(_Round(inverse, found, np.inf))
            break
        # the frequencies of peaks above their limit, and the largest violation
        x, u, added, largest = found.trajectory.x, found.trajectory.u, Frequencies(), 0.0
        for term, mask in masks:
            known, raised = frequencies[term.name], 1.0
            if not term.hard:  # by how much a soft mask is paid to be exceeded at its frequencies
                size = np.linalg.norm(mask.map.placed(known).values(x, u), axis=1)
                raised = float((size / mask.limit_at(known)).max(initial=1.0))
            added[term.name], ratios = peaks_above(mask, x, u, raised * (1.0 + LEFT_VIOLATION / 2))
            largest = max(largest, float(ratios.max(initial=raised)) / raised - 1.0)
        rounds.append(_Round(inverse, found, largest))
        converged = largest <= LEFT_VIOLATION or (largest < SMALL and largest > LEAST_PROGRESS * violation)
        if converged or found.status == Status.LIMIT or found.interrupted:
            break
        violation, before, frequencies = largest, frequencies, Frequencies()
        for term, mask in masks:
            known, new = before[term.name], added[term.name]
            weight = np.linalg.norm(found.multipliers.stage[term.name], axis=1)
            kept = weight > IDLE * weight.max(initial=0.0)
            nearest = mask.distances(known, new).min(axis=1, initial=np.inf)
            joined = np.unique(np.concatenate([known[kept & (nearest > APART)], new]), axis=0)
            frequencies[term.name] = joined if len(joined) else known
    proven = [one for one in rounds if one.found.status == Status.OPTIMAL and one.violation < PEAK_TOLERANCE]
    best = min(proven, key=lambda one: one.violation) if proven else rounds[-1]
    found = replace(best.found, seconds=seconds)
    if problem.dynamics.mode_names:  # the bound of the search is that of the relaxed problem, below the optimum
        shortfall = f"at the frequencies of {plural(len(masks), 'mask')} only"
        return recover_outcome(best.inverse, found, CONDITION_TOLERANCE, shortfall)
    candidate = best.inverse.recover(candidate_of(found))
    return replace(
        judge_candidate(problem, candidate, found.method, found.backend, request.tolerance), reason=found.reason
    )
