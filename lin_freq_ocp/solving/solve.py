"""From a problem to a judged outcome: choose the method, check its options, solve, judge the answer.

Masks at every frequency are semi-infinite constraints, solved by exchange: the method solves problems with masks at
finitely many frequencies. Each round adds the local maxima of |V| above the limit, and drops the frequencies without a
multiplier and those next to an added one. For a residual vibration, a frequency is a point (natural frequency, damping
ratio) of a box. The problem with finitely many constraints is a relaxation: its infeasibility proofs and bounds hold
for the problem itself, and its trajectory is judged at every frequency. If that proves nothing, the last round is
solved once more, with a proof. Where any feasible trajectory is an answer, a round is also solved with limits that
are lower by the violation of the round before: the peaks that it leaves are smaller, and below the limits themselves.

References: Hettich and Kortanek, SIAM Review 35, 1993 (semi-infinite programming: exchange methods).
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lin_freq_ocp.base.activity import activity_step
from lin_freq_ocp.base.arrays import Array, first_largest
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.phrases import plural
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE, PEAK_TOLERANCE
from lin_freq_ocp.certificate.verdict import judge
from lin_freq_ocp.methods.candidate import Progress, Reason
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.terms.semi_infinite import SemiInfiniteConstraint, peaks_above
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.solving.families import DEFAULT_OPTIONS, Options, choose_method, saved_options
from lin_freq_ocp.solving.judging import (
    allowed_residual,
    candidate_of,
    correct_point,
    judge_candidate,
    recover_outcome,
    reduce_fractional_samples,
)
from lin_freq_ocp.solving.method import Method, Report, Request
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.transform.reductions import Reduced
from lin_freq_ocp.transform.reformulations import SampledMasks, Translation, sampled_masks, translation_of
from lin_freq_ocp.transform.starts import start_of

COARSE = 1e-8  # rounding of a state, relative to its motion, that may cost as much as the allowed gap


@one_blas_thread
def solve_judged(
    problem: OptimalControlProblem,
    options: Options = DEFAULT_OPTIONS,
    progress: Report | None = None,
    proof: bool = True,
    any_point: bool = False,
) -> Outcome:
    """Solve a problem and judge the answer; see ``lfo.solve`` for options and errors, ``Request`` for the flags."""
    require_problem(problem)
    chosen = choose_method(problem, options)
    first = None if options.start is None else start_of(problem, options.start)
    allowed = options.tolerance or getattr(chosen, "tolerance", None)
    translation = translation_of(problem)
    request = Request(options.time_limit or np.inf, allowed, progress, first, proof=proof, any_point=any_point)
    outcome = solve_translated(chosen, translation, request)
    outcome = restore_outcome(translation, reduce_fractional_samples(outcome, options.tolerance), allowed)
    saved = saved_options(problem, options, chosen) | ({} if first is None else {"start": first.saved})
    return replace(outcome, options=saved)


def solve_translated(method: Method, translation: Translation, request: Request) -> Outcome:
    """Solve the translated problem by a method.

    Start and progress of the request belong to the given problem, its solver cache to the translated one.
    """
    problem, start, progress, constant = translation.problem, request.start, request.progress, translation.cost
    if start is not None and start.trajectory is not None:
        request = replace(request, start=replace(start, trajectory=translation.start(start.trajectory)))
    if progress is not None and constant:

        def report(state: Progress) -> None:  # with the cost of the given problem
            progress(replace(state, cost=state.cost + constant, lower_bound=state.lower_bound + constant))

        request = replace(request, progress=report)
    if all(term.semi_infinite is None for term in problem.terms):
        return method.solve(problem, request)
    return solve_at_every_frequency(problem, method, request)


def restore_outcome(translation: Translation, outcome: Outcome, tolerance: float | None = None) -> Outcome:
    """Return the outcome of the given problem from that of the translated problem.

    Its states are rounded to the digits of the given coordinates, and its certificate belongs to the rounded states. An
    optimum that moves little more than these digits is corrected in them: there, rounding of the data may decide.
    """
    if not translation.moves:
        return outcome
    allowed, optimal, before = allowed_residual(tolerance), outcome.status == Status.OPTIMAL, outcome.certificate
    outcome = recover_outcome(translation, outcome, allowed)
    trajectory, unproven = outcome.trajectory, outcome.status in (Status.LOCALLY_OPTIMAL, Status.NUMERICAL_ERROR)
    if outcome.certificate is None or trajectory is None or not unproven:
        return outcome
    if optimal and before is not None and translation.problem.mode_names:
        # what rounding to these digits changes of a proven optimum, its cost and residuals, is rounding of the data
        after = outcome.certificate
        changed = abs(after.cost - translation.cost - before.cost) + after.worth_of_residuals + before.allowed_gap
        rounded = replace(after, data_rounding=changed)
        if changed < np.inf and rounded.globally_optimal:
            return replace(outcome, status=Status.OPTIMAL, message="", certificate=rounded)
    if optimal and outcome.multipliers is not None and not translation.problem.mode_names:
        proof = None
        with suppress(UnsupportedError):
            proof = correct_point(translation.problem, translation.start(trajectory), outcome.multipliers, allowed)
        if proof is not None:
            return replace(
                outcome,
                status=Status.OPTIMAL,
                message="",
                trajectory=translation.trajectory(proof.trajectory),
                multipliers=proof.multipliers,
                certificate=proof.certificate.raised(translation.cost),
            )
    # rounding of a state may be the reason that the answer is not optimal
    rounding, motion = np.spacing(np.abs(translation.origin)), np.ptp(trajectory.x, axis=0)
    lost = np.divide(rounding, motion, out=np.zeros(len(motion)), where=motion > 0)
    (i,) = first_largest(lost)
    if lost[i] <= COARSE:
        return outcome
    message = (
        f"{translation.given.state_names[i]} is so far from zero that double precision rounds it by {rounding[i]:.1e}; "
        "measure it from a nearer origin"
    )
    return replace(outcome, message="; ".join(filter(None, [outcome.message, message])))


LEFT_VIOLATION = 1e-9  # of |V| over its limit, relative: interior points leave as much at known frequencies
ROUNDS = 30  # six reach LEFT_VIOLATION if a peak hardly answers to the frequency that holds it, 13 if it overshoots
ANY_POINT = "it satisfies every constraint, and no optimum was asked for"
NEAR = 0.1  # violation below which lower limits are tried first, where any point is an answer
FEWER = 0.1  # part of a reduction of the limits that led to no such point, below which the next is: rounds alone
IDLE = 1e-6  # multiplier, relative to the largest, below which a frequency is dropped: the cost does not change
APART = 1e-4  # of the distance of two bins: |V| differs there by 5e-8 at most, relative to its largest value
LEAST_PROGRESS = 0.5  # factor by which a round must reduce the violation at least, once it is below SMALL
INACCURATE = 3  # rounds with as much violation at known frequencies: the method has no more digits
SMALL = 2e-7  # less than the violation that the judge allows

Frequencies = dict[str, Array]


class _Round(NamedTuple):
    """The outcome of a relaxed problem, the way back, and the violation |V|/l - 1 at other frequencies."""

    reduced: Reduced
    outcome: Outcome
    violation: float


Masks = list[tuple[Term, SemiInfiniteConstraint]]


def _peaks_of(
    masks: Masks, frequencies: Frequencies, trajectory: Trajectory, hard_only: bool
) -> tuple[Frequencies, float, float]:
    """Return the frequencies of peaks above their limit, the largest violation, and that at known frequencies."""
    x, u, found, largest, missed = trajectory.x, trajectory.u, Frequencies(), 0.0, 0.0
    for term, mask in masks:
        known = frequencies[term.name]
        size = np.linalg.norm(mask.map.at_points(known).values(x, u), axis=1)
        raised = float((size / mask.limit_at(known)).max(initial=1.0))
        if term.hard:  # a soft mask may be exceeded as much as at its known frequencies
            missed, raised = max(missed, raised - 1.0), 1.0
        found[term.name], ratios = peaks_above(mask, x, u, raised * (1.0 + LEFT_VIOLATION / 2))
        if term.hard or not hard_only:
            largest = max(largest, float(ratios.max(initial=raised)) / raised - 1.0)
    return found, largest, missed


def _exchange(masks: Masks, frequencies: Frequencies, added: Frequencies, multipliers: Multipliers) -> Frequencies:
    """Return the added frequencies, and the others with a multiplier that are not next to one."""
    exchanged = Frequencies()
    for term, mask in masks:
        known, new = frequencies[term.name], added[term.name]
        weight = np.linalg.norm(multipliers.stage[term.name], axis=1)
        active = weight > IDLE * weight.max(initial=0.0)
        nearest = mask.distances(known, new).min(axis=1, initial=np.inf)
        joined = np.unique(np.concatenate([known[active & (nearest > APART)], new]), axis=0)
        exchanged[term.name] = joined if len(joined) else known
    return exchanged


def _feasible_point(
    problem: OptimalControlProblem, reduced: SampledMasks, outcome: Outcome, request: Request
) -> Outcome | None:
    """Return the trajectory of a sampled problem, if the judge finds that it satisfies all constraints."""
    if outcome.trajectory is None or outcome.multipliers is None:
        return None
    multipliers = reduced.multipliers(outcome.multipliers)
    certificate = judge(problem, outcome.trajectory, multipliers, allowed_residual(request.tolerance))
    found = replace(outcome, problem=problem, status=Status.LIMIT, message=ANY_POINT, any_point=True)
    return replace(found, multipliers=multipliers, certificate=certificate) if certificate.feasible else None


def solve_at_every_frequency(problem: OptimalControlProblem, method: Method, request: Request) -> Outcome:
    """Solve a problem with masks at every frequency by exchange, and judge the answer.

    A problem with modes is proven in each round, and the best round is recovered; the best of another is judged.
    """
    request = replace(request, cached=None, tree=None)
    of_round, end = replace(request, proof=False), now() + request.time_limit
    masks = [(term, term.semi_infinite) for term in problem.terms if term.semi_infinite is not None]
    frequencies = {term.name: term.map.locations for term, _ in masks}
    seconds, violation, rounds, inaccurate = dict[str, float](), np.inf, list[_Round](), 0

    def judge_round(item: _Round) -> Outcome:
        outcome, interrupted = replace(item.outcome, seconds=seconds), rounds[-1].outcome.interrupted
        candidate = item.reduced.recover(candidate_of(outcome))
        answer = judge_candidate(problem, candidate, outcome.method, outcome.backend, request.tolerance)
        return replace(answer, reason=outcome.reason, attempts=outcome.attempts, interrupted=interrupted)

    tried = NEAR / FEWER  # reduction of the limits that was tried last
    any_point = request.any_point and not problem.mode_names  # a search over modes would have to prove every round
    for _ in range(ROUNDS):
        reduced = sampled_masks(problem, frequencies)
        beyond = f", limits exceeded by {violation:.0e}" if rounds else ""
        with activity_step(f"round {len(rounds) + 1}{beyond}"):
            outcome = method.solve(reduced.problem, of_round.with_end(end))
        seconds |= {phase: seconds.get(phase, 0.0) + value for phase, value in outcome.seconds.items()}
        if outcome.trajectory is None or outcome.multipliers is None:
            rounds.append(_Round(reduced, outcome, np.inf))
            break
        added, largest, missed = _peaks_of(masks, frequencies, outcome.trajectory, any_point)
        rounds.append(_Round(reduced, outcome, largest))
        if any_point and largest <= LEFT_VIOLATION and (point := _feasible_point(problem, reduced, outcome, request)):
            return replace(point, seconds=seconds)
        converged = largest <= LEFT_VIOLATION or (largest < SMALL and largest > LEAST_PROGRESS * violation)
        if converged and outcome.certificate is None and request.proof:
            if (answer := judge_round(rounds[-1])).attempt.reason is Reason.PROVEN:
                return answer
            of_round = request  # once more, with a proof
            continue
        inaccurate += missed > LEAST_PROGRESS * largest
        if converged or inaccurate == INACCURATE or outcome.status == Status.LIMIT or outcome.interrupted:
            break
        violation, frequencies = largest, _exchange(masks, frequencies, added, outcome.multipliers)
        if any_point and violation < FEWER * tried:
            tried, reduced = violation, sampled_masks(problem, frequencies, 1 / (1 + violation))
            with activity_step("lower limits"):
                outcome = method.solve(reduced.problem, of_round.with_end(end))
            if point := _feasible_point(problem, reduced, outcome, request):
                return replace(point, seconds=seconds)
            if outcome.interrupted:
                rounds.append(_Round(reduced, outcome, np.inf))
                break
    solved = [item for item in rounds if item.outcome.status == Status.OPTIMAL and item.violation < PEAK_TOLERANCE]
    best = min(solved, key=lambda item: (item.outcome.certificate is None, item.violation), default=rounds[-1])
    if problem.mode_names:  # the search bounds the relaxed problem, and so the problem itself
        shortfall, outcome = f"at the frequencies of {plural(len(masks), 'mask')} only", best.outcome
        outcome = replace(outcome, seconds=seconds, interrupted=rounds[-1].outcome.interrupted)
        return recover_outcome(best.reduced, outcome, CONDITION_TOLERANCE, shortfall)
    answer = judge_round(best)
    if inaccurate < INACCURATE or answer.status != Status.NUMERICAL_ERROR:
        return answer
    error = f"{len(rounds)} rounds leave known frequencies as much over their limits as all, by {best.violation:.0e}"
    advice = "" if answer.backend is None else "; method 'structured' has more digits where frequencies are close"
    return replace(answer, message=f"{answer.message}; {error}{advice}")
