"""Solve with states counted from where they move, and return and judge the answer in the given coordinates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lin_freq_ocp.certificate.modes.bound import TreeBound
from lin_freq_ocp.certificate.tolerances import GAP_TOLERANCE
from lin_freq_ocp.certificate.verdict import Certificate, judge
from lin_freq_ocp.problem.starts import Start
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.problem.translation import Translation
from lin_freq_ocp.solving.every_frequency import solved_by
from lin_freq_ocp.solving.judging import allowed_residual
from lin_freq_ocp.solving.method import Method, Progress, Report, Request
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.status import Status


def solve_translated(
    method: Method, translation: Translation, request: Request, tolerance: float | None = None
) -> Outcome:
    """Solve the translated problem by a method, and return the outcome for the given problem.

    The request is one of the given problem, but for what it keeps of earlier solves.
    """
    if not translation.moves:
        return solved_by(method, translation.given, request, tolerance)
    start, progress = request.start, request.progress
    request = replace(
        request,
        start=None if start is None else _translated_start(translation, start),
        progress=None if progress is None else _raised_report(progress, translation.cost),
    )
    return restored_outcome(translation, solved_by(method, translation.problem, request, tolerance), tolerance)


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
        found = after.status_within(max(before.gap or 0.0, 0.0) + GAP_TOLERANCE)
        if found != status:
            status, message = found, _rounded(translation)
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


def _rounded(translation: Translation) -> str:
    """Say which state is rounded by how much."""
    i = int(np.argmax(np.abs(translation.origin)))
    size = float(np.spacing(abs(translation.origin[i])))
    return (
        f"{translation.given.state_names[i]} lies so far from zero that double precision rounds it by {size:.1e}. "
        "This rounding is worth more than the gap allows; count it from nearer"
    )


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
