"""From a candidate of a method to an outcome: its status is what the judge confirms, not what the method claims."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from lin_freq_ocp.base.activity import activity_step
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.bound import RIGOROUS
from lin_freq_ocp.certificate.rays import Direction, prove_infeasible, unbounded_direction
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE, GAP_TOLERANCE
from lin_freq_ocp.certificate.verdict import Certificate, judge
from lin_freq_ocp.methods.candidate import Candidate, zero_multipliers
from lin_freq_ocp.methods.convex.polish import recession_directions
from lin_freq_ocp.methods.correction import Correction, corrections, simulate_from, trajectory_at_rest
from lin_freq_ocp.methods.repair import repair_trajectory
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.solving.outcome import Judged, Outcome
from lin_freq_ocp.transform.level_rows import few_between_levels
from lin_freq_ocp.transform.reductions import Reduced
from lin_freq_ocp.transform.reformulations import at_frequencies

LARGEST_TOLERANCE = 1e-2  # to which a tolerance of solve loosens the judge's; a larger one would mean nothing


def allowed_residual(tolerance: float | None) -> float:
    """Return the tolerance of the judge's conditions for a tolerance of solve."""
    return min(max(CONDITION_TOLERANCE, tolerance or 0.0), LARGEST_TOLERANCE)


@activity_step("certifying")
def judge_candidate(
    problem: OptimalControlProblem, candidate: Candidate, method: str, backend: str | None, tolerance: float | None
) -> Outcome:
    """Judge the point, ray or direction of a candidate; the status follows from the proof.

    Only a rigorous ray is a proof of infeasibility. Any other claim is refuted by a feasible trajectory.
    """
    clock = now()
    status, message, certificate = candidate.status, candidate.message, None
    if candidate.trajectory is not None and candidate.multipliers is not None:
        allowed = allowed_residual(tolerance)
        trajectory, multipliers, certificate = judge_nearest(problem, candidate, allowed)
        candidate = replace(candidate, trajectory=trajectory, multipliers=multipliers)
        if not candidate.interrupted:
            status, message = _verified_status(status, message, certificate, allowed)
    direction = None if candidate.descent is None else verified_direction(problem, candidate.descent)
    if status == Status.UNBOUNDED and direction is not None:
        t, j = direction.steepest
        message = (
            f"the cost decreases without bound along a verified direction, most with {problem.control_names[j]} "
            f"{'up' if direction.u[t, j] > 0 else 'down'} at t = {t}"
        )
    elif status == Status.UNBOUNDED:
        status, message = Status.NUMERICAL_ERROR, f"{message}, without a verified direction of descent"
    point = candidate.trajectory, candidate.multipliers, certificate
    claims = status == Status.INFEASIBLE
    # near infeasibility, the multipliers of a failed solve become a ray
    failed = not candidate.interrupted and candidate.status in (Status.NUMERICAL_ERROR, Status.LIMIT)
    ray = candidate.ray if claims else candidate.multipliers if failed else None
    proof = None if ray is None else prove_infeasible(problem, ray)
    if proof is not None and proof.bound.kind == RIGOROUS:  # there is no feasible point
        status, message, point, direction = Status.INFEASIBLE, "proven by a rigorous ray", (None, None, None), None
    elif claims:
        excluded = None if proof is None else f"no trajectory with {proof.sizes} satisfies all constraints"
        status, message = Status.INFEASIBLE_CLAIMED, excluded or f"{message}, but its ray proves nothing"
        feasible = _feasible_point(problem)
        if feasible is not None:
            status, point, proof = Status.NUMERICAL_ERROR, feasible, None
            message = f"{candidate.message}, but the controls nearest to zero satisfy all constraints"
    else:
        proof, message = None, "" if status == Status.OPTIMAL else message
    seconds = {**candidate.seconds, "certify": now() - clock}
    return Outcome(problem, status, method, backend, seconds, *point, proof, message, candidate.interrupted, direction)


def judge_nearest(problem: OptimalControlProblem, candidate: Candidate, allowed: float) -> Judged:
    """Return a feasible trajectory near that of a candidate, with multipliers and their certificate.

    An optimum is proven by a bound, and by the cost of a trajectory that satisfies every constraint. The repaired
    trajectory is one. If its cost is not close enough to the bound, or there is none, the point is corrected: its
    multipliers may be wrong, as those of a solver are that takes a small residual for rounding. The last trajectory
    that may be proven is that at rest. If none is, the point is judged as it is, and is no optimum. Where a correction
    says nothing, the point itself comes before that at rest, whose multipliers are zero. Variables without a cost are
    there as they are, or zero.
    """
    trajectory, multipliers = candidate.trajectory, candidate.multipliers
    assert trajectory is not None
    assert multipliers is not None
    if problem.mode_names or multipliers.eta_C != 1 or candidate.interrupted:
        return Judged(trajectory, multipliers, judge(problem, trajectory, multipliers, allowed))
    if problem.costs_nothing:  # those of a solver are noise
        multipliers = zero_multipliers(problem, 1.0)
    with np.errstate(over="ignore", invalid="ignore"):  # numbers that are not finite are no repair
        repaired = repair_trajectory(at_frequencies(problem, multipliers.frequencies), trajectory)
    if repaired is not None:
        certificate = judge(problem, repaired, multipliers, allowed)
        if certificate.proven_within(allowed):
            return Judged(repaired, multipliers, certificate)
    claims = candidate.status in (Status.OPTIMAL, Status.NUMERICAL_ERROR)
    if claims:  # a point at a limit of time keeps its controls, which obey the bands
        trajectory = Trajectory(trajectory.x, problem.control_tube.project(trajectory.u))
    own = judge(problem, trajectory, multipliers, allowed)
    if not claims and not own.proven_within(allowed):
        return Judged(trajectory, multipliers, own)
    # atoms of masks at every frequency come in pairs, whose rows are nearly the same: a failure says nothing there
    known = any(term.semi_infinite is not None for term in problem.terms)
    try:
        proof = correct_point(problem, trajectory, multipliers, allowed)
    except UnsupportedError:
        proof, known = None, True
    if proof is not None:
        return proof
    own = own if known else replace(own, worth_of_residuals=np.inf)
    zero = Trajectory(np.zeros_like(trajectory.x), np.zeros_like(trajectory.u))
    near = (trajectory, zero) if claims and not own.proven_within(allowed) else ()
    for resting in filter(None, (trajectory_at_rest(problem, one) for one in near)):
        proof = judge_nearest(problem, Candidate(Status.LIMIT, resting, zero_multipliers(problem, 1.0)), allowed)
        if proof.certificate.proven_within(allowed):
            return proof
    return Judged(trajectory, multipliers, own)


def correct_point(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers, allowed: float
) -> Judged | None:
    """Return a corrected trajectory that is proven optimal, in digits of the user's coordinates; None if there is none.

    UnsupportedError if corrections do not fit into memory, or would take too long.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        found = corrections(problem, trajectory, multipliers)
        return next(filter(None, (_judge_correction(problem, multipliers, one, allowed) for one in found)), None)


def _judge_correction(
    problem: OptimalControlProblem, former: Multipliers, correction: Correction, allowed: float
) -> Judged | None:
    """Return the corrected trajectory with the multipliers that prove it, its own or the former; None if none do.

    Where no bound is close enough, rounding of the data may decide.
    """
    if not np.isfinite(correction.price):
        return None
    for rounded, multipliers in product((False, True), (correction.multipliers, former)):
        rounding = correction.data_rounding if rounded else 0.0
        certificate = judge(problem, correction.trajectory, multipliers, allowed)
        certificate = replace(certificate, worth_of_residuals=correction.price, data_rounding=rounding)
        if certificate.proven_within(allowed):
            return Judged(correction.trajectory, multipliers, certificate)
    return None


def candidate_of(outcome: Outcome) -> Candidate:
    """Return the claim that a judged outcome makes: its point, ray or direction."""
    unsolved = outcome.status in (Status.UNBOUNDED, Status.LIMIT, Status.NUMERICAL_ERROR)
    return Candidate(
        Status.INFEASIBLE if outcome.ray is not None else outcome.status if unsolved else Status.OPTIMAL,
        outcome.trajectory,
        outcome.multipliers,
        outcome.ray,
        message=outcome.message,
        seconds=outcome.seconds,
        interrupted=outcome.interrupted,
        descent=None if outcome.direction is None else Trajectory(outcome.direction.x, outcome.direction.u),
    )


def recover_outcome(reduced: Reduced, outcome: Outcome, allowed: float, shortfall: str = "") -> Outcome:
    """Return the outcome of the given problem from that of the reduced problem; its point is judged once more.

    The bound of a search over modes, and directions, hold for both problems. If a condition is violated by more than
    ``allowed``, or the bound is no longer close enough, the status is weaker, with the message ``shortfall``.
    """
    evidence = None if outcome.evidence is None else outcome.evidence.recovered(reduced)
    outcome = replace(outcome, problem=reduced.given, evidence=evidence)
    if outcome.trajectory is None:
        return outcome
    trajectory = reduced.trajectory(outcome.trajectory)
    multipliers = outcome.multipliers and reduced.multipliers(outcome.multipliers, trajectory)
    before, outcome = outcome.certificate, replace(outcome, trajectory=trajectory, multipliers=multipliers)
    if before is None or multipliers is None:
        return outcome
    after = judge(*reduced.judged_at(trajectory), multipliers, allowed)
    after = replace(after, descent=before.descent, data_rounding=before.data_rounding)
    if reduced.given.mode_names:
        after = replace(after, bound=before.bound, borders=before.borders)
    status, message = outcome.status, outcome.message
    if status.solved:
        gap = max(before.gap or 0.0, 0.0) + GAP_TOLERANCE
        confirmed = after.status_within(gap if status == Status.OPTIMAL else -np.inf)
        if confirmed != status:
            status, message = confirmed, shortfall
    return replace(outcome, certificate=after.raised(reduced.cost), status=status, message=message)


def reduce_fractional_samples(outcome: Outcome, tolerance: float | None) -> Outcome:
    """Return an optimum of the same cost with few samples between levels; the outcome itself if that is not proven."""
    if outcome.status != Status.OPTIMAL or outcome.trajectory is None:
        return outcome
    reduced = few_between_levels(outcome.problem)
    candidate = None if reduced is None else reduced.recover(candidate_of(outcome))
    if candidate is None or candidate.trajectory is outcome.trajectory:
        return outcome
    fewer = judge_candidate(outcome.problem, candidate, outcome.method, outcome.backend, tolerance)
    if fewer.status != Status.OPTIMAL:
        return outcome
    seconds = {**outcome.seconds, "certify": outcome.seconds.get("certify", 0.0) + fewer.seconds["certify"]}
    return replace(fewer, seconds=seconds, reason=outcome.reason, attempts=outcome.attempts)


def _verified_status(status: Status, message: str, certificate: Certificate, gap: float) -> tuple[Status, str]:
    """Return the status of a judged point, and why it is not optimal.

    A point that is proven within ``gap`` is optimal, whether or not its solver claims it. A point that its solver calls
    optimal has the status of its certificate.
    """
    confirmed = certificate.status_within(gap)
    if confirmed == Status.OPTIMAL:
        return confirmed, ""
    if status not in (Status.OPTIMAL, Status.NUMERICAL_ERROR):
        return status, message
    if confirmed == Status.NUMERICAL_ERROR:
        if status == Status.OPTIMAL:
            message = f"residuals of the program are small, but not those of: {certificate.worst.name}"
        return confirmed, message
    # no condition fails, and no global optimum is proven
    if certificate.bound is None or certificate.gap is None:
        missing = "there is no bound"
    elif certificate.bound.kind != RIGOROUS:
        missing = "the bound holds near the trajectory only, as something is not bounded"
    elif certificate.worth_of_residuals == np.inf:
        missing = "no trajectory that satisfies every constraint is known to cost about as much as the bound"
    else:
        worth = certificate.worth_of_residuals / certificate.cost_scale if certificate.cost_scale > 0 else np.inf
        missing = f"the bound leaves a gap of {certificate.gap:.1e}, and residuals are worth {worth:.1e} of the cost"
    return confirmed, f"the maximum principle is satisfied; {missing}"


def verified_direction(problem: OptimalControlProblem, along: Trajectory) -> Direction | None:
    """Return a direction without bound near a solver's, which satisfies the constraints only nearly, or None."""
    return next(filter(None, (unbounded_direction(problem, one) for one in recession_directions(problem, along))), None)


def _feasible_point(problem: OptimalControlProblem) -> Judged | None:
    """Return the trajectory of the controls and the initial state nearest to zero, if it satisfies all constraints."""
    nearest = problem.control_tube.project(np.zeros((problem.horizon, problem.control_dim)))
    trajectory = simulate_from(problem, nearest, np.zeros(problem.state_dim))
    if trajectory is None:
        return None
    multipliers = zero_multipliers(problem, 1.0)
    certificate = judge(problem, trajectory, multipliers)
    return Judged(trajectory, multipliers, certificate) if certificate.feasible else None
