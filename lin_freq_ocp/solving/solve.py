"""From a problem to a judged outcome: the method is chosen, its options are checked, its answer is judged."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.hybrid.bound import TreeBound
from lin_freq_ocp.certificate.tolerances import GAP_TOLERANCE
from lin_freq_ocp.certificate.verdict import Certificate, judge
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.reformulations import Translation, translation_of
from lin_freq_ocp.problem.starts import Start, start_of
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.backends.base import backend as solver_named
from lin_freq_ocp.program.backends.base import names
from lin_freq_ocp.solving.every_frequency import solved_by
from lin_freq_ocp.solving.families import chosen, require_shorthand, saved_options
from lin_freq_ocp.solving.judging import allowed_residual, with_few_fractional
from lin_freq_ocp.solving.method import Method, Progress, Report, Request
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
    require_options(method, time_limit, backend, tolerance, gap, node_limit)
    options = {"tolerance": tolerance, "gap": gap, "node_limit": node_limit, "executor": executor, "start": start}
    options["global_bound"] = global_bound
    found = chosen(problem, method, {"backend": None if backend == "auto" else backend, **options})
    begin = None if start is None else start_of(problem, start)
    request = Request(np.inf if time_limit is None else time_limit, progress, begin)
    allowed = tolerance or getattr(found, "tolerance", None)
    translation = translation_of(problem)
    outcome = with_few_fractional(solve_translated(found, translation, request, allowed), tolerance)
    outcome = restored_outcome(translation, outcome, allowed)
    saved = saved_options(problem, method, found) | ({} if begin is None else {"start": begin.saved})
    return replace(outcome, options=saved | {"time_limit": time_limit})


def require_options(
    method: str | Method,
    time_limit: float | None = None,
    backend: str = "auto",
    tolerance: float | None = None,
    gap: float | None = None,
    node_limit: int | None = None,
) -> None:
    """Raise UnsupportedError unless the options of solve exist, MissingExtraError if the backend is not installed."""
    if isinstance(method, str):
        require_shorthand(method)
    if backend not in ("auto", *names(binaries=True)):
        solver_named(backend)
    limits = {"time_limit": time_limit, "tolerance": tolerance, "gap": gap, "node_limit": node_limit}
    for name, value in limits.items():
        if value is not None and not value > 0:
            raise UnsupportedError(f"{name}: got {value!r}; expected a number above zero, or None.")


def solve_translated(
    method: Method, translation: Translation, request: Request, tolerance: float | None = None
) -> Outcome:
    """Solve the translated problem by a method.

    Start and progress of the request are those of the given problem; what it keeps of earlier solves is not.
    """
    start, progress = request.start, request.progress
    request = replace(
        request,
        start=None if start is None else _translated_start(translation, start),
        progress=None if progress is None else _raised_report(progress, translation.cost),
    )
    return solved_by(method, translation.problem, request, tolerance)


def restored_outcome(translation: Translation, outcome: Outcome, tolerance: float | None = None) -> Outcome:
    """Return an outcome of the translated problem as one of the given problem.

    Its states are rounded to the digits that the given coordinates have. The certificate is that of the rounded
    trajectory.
    """
    if not translation.moves:
        return outcome
    bound = outcome.tree_bound
    outcome = replace(
        outcome, problem=translation.given, tree_bound=None if bound is None else _raised_tree(bound, translation.cost)
    )
    if outcome.trajectory is None:
        return outcome
    trajectory = translation.restored(outcome.trajectory)
    if outcome.certificate is None or outcome.multipliers is None:
        return replace(outcome, trajectory=trajectory)
    before = outcome.certificate
    after = _judged_again(translation, trajectory, outcome.multipliers, before, allowed_residual(tolerance))
    status, message = outcome.status, outcome.message
    if status in (Status.OPTIMAL, Status.LOCALLY_OPTIMAL):
        gap = max(before.gap or 0.0, 0.0) + GAP_TOLERANCE
        found = after.status_within(gap if status == Status.OPTIMAL else -np.inf)
        if found != status:
            status, message = found, ""
    if status in (Status.LOCALLY_OPTIMAL, Status.NUMERICAL_ERROR):
        message = "; ".join(filter(None, [message, _rounding(translation, trajectory)]))
    return replace(
        outcome, trajectory=trajectory, certificate=after.raised(translation.cost), status=status, message=message
    )


def _judged_again(
    translation: Translation, trajectory: Trajectory, multipliers: Multipliers, before: Certificate, allowed: float
) -> Certificate:
    """Return the certificate of a rounded trajectory; bounds and directions of a search do not depend on it."""
    after = judge(translation.problem, translation.translated(trajectory), multipliers, allowed)
    if translation.given.dynamics.mode_names:
        return replace(after, bound=before.bound, borders=before.borders, descent=before.descent)
    return replace(after, descent=before.descent)


def _rounding(translation: Translation, trajectory: Trajectory) -> str:
    """Return which state is rounded by how much, where that may be why an answer is not optimal; else nothing."""
    size, moves = np.spacing(np.abs(translation.origin)), np.ptp(trajectory.x, axis=0)
    i = int(np.argmax(np.divide(size, moves, out=np.zeros(len(size)), where=moves > 0)))
    if size[i] <= COARSE * moves[i]:
        return ""
    name = translation.given.state_names[i]
    return f"{name} lies so far from zero that double precision rounds it by {size[i]:.1e}: count it from nearer"


def _translated_start(translation: Translation, start: Start) -> Start:
    at = start.trajectory
    return start if at is None else replace(start, trajectory=translation.translated(at))


def _raised_tree(bound: TreeBound, constant: float) -> TreeBound:
    return replace(bound, value=bound.value + constant, bounds=bound.bounds + constant)


def _raised_report(report: Report, constant: float) -> Report:
    """Return a report of progress for the cost of the given problem."""

    def raised(progress: Progress) -> None:
        report(replace(progress, cost=progress.cost + constant, lower_bound=progress.lower_bound + constant))

    return raised if constant else report
