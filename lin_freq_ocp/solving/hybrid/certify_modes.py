"""certify() for dynamics with modes: multipliers where modes meet, and changes of one mode (flips) that improve."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from itertools import chain

import numpy as np

from lin_freq_ocp.base.arrays import Indices
from lin_freq_ocp.base.errors import NumericalError, UnsupportedError
from lin_freq_ocp.certificate.hybrid.clarke import Flip, SwitchingFacts, facts_where_modes_meet
from lin_freq_ocp.certificate.hybrid.smooth import judged_modes
from lin_freq_ocp.certificate.rays import Direction, descent_direction
from lin_freq_ocp.certificate.verdict import Certificate, judge
from lin_freq_ocp.methods.candidate import zero_multipliers
from lin_freq_ocp.methods.fitted_multipliers import abnormal_multipliers, fit_multipliers
from lin_freq_ocp.methods.hybrid.search.multipliers import candidates
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.solving.hybrid.fixed_modes import fix_modes
from lin_freq_ocp.solving.outcome import Judged
from lin_freq_ocp.solving.solve import solve_judged

MOST_FLIPS = 16  # flips that are verified, the steepest first: each needs a fit of multipliers


def certify_modes(problem: OptimalControlProblem, trajectory: Trajectory) -> Certificate:
    """Judge a trajectory of dynamics with modes with the best multipliers, ordered by ``_rank``.

    Every flip that they suggest is tried: the judge checks a direction of descent in the mode sequence with the flip.
    """
    best = best_multipliers(problem, trajectory).certificate
    if not best.failed and _facts(best).flip_stationary:
        return best
    reduced, affine, at, arrays = judged_modes(problem, trajectory)
    sequence = arrays.sequence(at.x, at.u)
    fixed = fix_modes(affine, sequence)

    def certificate_by(multipliers: Multipliers | None) -> Certificate:
        back = multipliers and reduced.multipliers(fixed.multipliers(multipliers, at))
        certificate = best if back is None else judge(problem, trajectory, back)
        return best if certificate.failed else certificate

    if best.failed and best.feasible and affine is problem:
        # every optimum of the sequence has the multipliers of every other
        with suppress(UnsupportedError):
            best = certificate_by(solve_judged(fixed.problem).multipliers)
    facts, descent = _verify_flips(affine, at, sequence, _facts(best))
    descent = descent and replace(descent, x=descent.x[:, : problem.state_dim])
    if best.failed and best.feasible:  # abnormal multipliers may satisfy all conditions
        abnormal = certificate_by(abnormal_multipliers(fixed.problem, at))
        if not abnormal.failed:
            return replace(abnormal, descent=descent)
    return replace(best, borders=facts, descent=descent)


def best_multipliers(
    problem: OptimalControlProblem, trajectory: Trajectory, first: Multipliers | None = None
) -> Judged:
    """Return a trajectory with the best multipliers; ``first`` are judged before others.

    NumericalError if no fit could be solved and ``first`` is None.
    """
    best: Judged | None = None
    reduced, affine, at, arrays = judged_modes(problem, trajectory)
    fits = map(reduced.multipliers, candidates(affine, at, arrays))  # in every mode sequence of the trajectory
    try:
        # at rest, a fit has only residuals, where zeros may satisfy the conditions
        named = {term.name: np.zeros(term.shape) for term in problem.terms}
        zeros = replace(zero_multipliers(problem, 1.0), stage=named)
        for multipliers in chain([] if first is None else [first], fits, [zeros]):
            certificate = judge(problem, trajectory, multipliers)
            if best is None or _rank(certificate) > _rank(best.certificate):
                best = Judged(trajectory, multipliers, certificate)
            if (best.certificate.extremal or not best.certificate.failed) and _facts(best.certificate).flip_stationary:
                break
            if first is not None and (not certificate.feasible or _facts(certificate).jumping is not None):
                break  # no other multipliers can help
    except NumericalError:
        if first is None:
            raise
    assert best is not None  # there are candidates, or an error
    return best


def _facts(certificate: Certificate) -> SwitchingFacts:
    facts = facts_where_modes_meet(certificate)
    assert facts is not None  # the dynamics have modes
    return facts


def _rank(certificate: Certificate) -> tuple[bool, bool, bool, int, float]:
    """Return the order of certificates: conditions, flips, other facts at boundaries, and the largest residual."""
    facts = _facts(certificate)
    stationary = not certificate.failed, facts.flip_stationary, facts.elsewhere
    return *stationary, -len(facts.flips), -certificate.worst.relative


def _verify_flips(
    problem: OptimalControlProblem, trajectory: Trajectory, sequence: Indices, facts: SwitchingFacts
) -> tuple[SwitchingFacts, Direction | None]:
    """Return the facts with the result of every flip, and the steepest verified direction of descent."""
    improves, direction = _try_sequence(problem, trajectory, sequence)
    directions, flips = [direction], list[Flip]()
    for flip in facts.flips[:MOST_FLIPS]:
        if flip.mode != sequence[flip.time]:
            flipped = sequence.copy()
            flipped[flip.time] = flip.mode
            answer, direction = _try_sequence(problem, trajectory, flipped)
            directions.append(direction)
        else:
            answer = improves
        flips.append(flip._replace(improves=answer))
    verified = [direction for direction in directions if direction is not None]
    rest = facts.flips[MOST_FLIPS:]
    return replace(facts, flips=(*flips, *rest)), min(verified, key=lambda direction: direction.slope, default=None)


def _try_sequence(
    problem: OptimalControlProblem, trajectory: Trajectory, sequence: Indices
) -> tuple[bool | None, Direction | None]:
    """Return whether a mode sequence improves on the trajectory to first order, and the direction of descent.

    The first is None if neither a direction of descent nor multipliers of the sequence are known.
    """
    linear = problem.with_modes(sequence)
    try:
        fit = fit_multipliers(linear, trajectory)
    except NumericalError:
        return None, None
    direction = descent_direction(linear, trajectory, fit.descent)
    if direction is not None:
        return True, direction
    return (False if judge(linear, trajectory, fit.multipliers).pmp == "satisfied" else None), None
