"""certify(): the judge's verdict on any trajectory, with multipliers that fit it best."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.activity import activity
from lin_freq_ocp.base.arrays import Array, brief, real_array
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.certificate.bound import RIGOROUS, Bound
from lin_freq_ocp.certificate.peaks import peak_points
from lin_freq_ocp.certificate.rays import descent_direction
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE
from lin_freq_ocp.certificate.verdict import Certificate, Rounded, decimals_of, judge
from lin_freq_ocp.methods.fitted_multipliers import ACTIVE, abnormal_multipliers, fit_multipliers
from lin_freq_ocp.problem.dynamics.base import entry_for
from lin_freq_ocp.problem.dynamics.frequency_response import FrequencyResponse
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.solving.families import Options, family_of
from lin_freq_ocp.solving.judging import LARGEST_TOLERANCE, correct_point
from lin_freq_ocp.solving.outcome import Evidence
from lin_freq_ocp.solving.solve import solve_judged
from lin_freq_ocp.transform.reformulations import at_frequencies, translation_of
from lin_freq_ocp.transform.simulation import simulate

NEAR_LIMIT = 0.99  # of its limit: a peak of a spectrum above this may have a multiplier
ROUNDED_TO = (1e-5, 1e-4, 1e-3, 1e-2)  # tolerances tried if a trajectory of few decimals fails the default one


@activity("certifying")
@one_blas_thread
def certify(
    problem: OptimalControlProblem,
    trajectory: object,
    multipliers: Multipliers | None = None,
    tolerance: float | None = None,
) -> Certificate:
    """Judge any trajectory, whatever computed it, by the maximum principle and the global bound.

    Parameters
    ----------
    problem : OptimalControlProblem
    trajectory : Trajectory, (T, m), Result or SavedSolution
        A trajectory; or controls alone, (T, m), which are simulated from the initial state, or, where that is free or
        linked to the end, from the one that makes them cheapest; or a result of solve or load: its trajectory, its
        search tree, which is checked again, and its multipliers unless others are given.
    multipliers : Multipliers, optional
        By default, those of an optimum of the problem: every optimal trajectory of a convex problem has them. If they
        do not satisfy the maximum principle, normal multipliers (eta_C = 1) that fit the trajectory best are computed.
        If these do not, either, the certificate holds a direction of descent that proves it, and abnormal multipliers
        (eta_C = 0) are sought. With piecewise-affine dynamics, those of other mode sequences of the same trajectory are
        tried, too, and ``certificate.borders`` has the conditions where modes meet, and the changes of a mode that
        improve.
    tolerance : float, optional
        Residuals, relative to their scales, up to which conditions hold, and distance at which bounds are active; 1e-6
        by default, at most 1e-2. Switching boundaries, and the global bound, have tolerances of their own.

    Returns
    -------
    Certificate
        If conditions of linear dynamics fail, and the trajectory has few decimals, ``rounded`` has the tolerance that
        rounding explains.

    Raises
    ------
    ProblemError
        If a shape does not fit the problem, an entry is not a finite number, or a result has no trajectory.
    UnsupportedError
        If the tolerance is not above zero, or above 1e-2.
    NumericalError
        If controls cannot be simulated, or the program of the multipliers could not be solved.

    References
    ----------
    Kotpalliwar, Paruchuri, Chatterjee and Banavar, "Discrete time optimal control with frequency constraints for
    non-smooth systems", 2019: Theorem 4.1 and its corollaries.

    Examples
    --------
    >>> result = lfo.solve(lfo.library.pendulum())
    >>> lfo.certify(result.problem, result.trajectory).pmp
    'satisfied'
    """
    require_problem(problem)
    if tolerance is not None and not 0 < tolerance <= LARGEST_TOLERANCE:
        text = f"tolerance: got {tolerance!r}; expected a number above zero, {LARGEST_TOLERANCE:g} at most."
        raise UnsupportedError(text)
    allowed = CONDITION_TOLERANCE if tolerance is None else tolerance
    evidence: Evidence | None = getattr(trajectory, "evidence", None)
    if hasattr(trajectory, "trajectory"):  # a result of solve or load
        result, trajectory = trajectory, getattr(trajectory, "trajectory", None)
        if trajectory is None:
            expected = "a trajectory, controls, or a result that has a trajectory"
            got = f"a result without one, which ended as {getattr(result, 'status', None)!r}"
            raise ProblemError("trajectory", got, expected)
        multipliers = getattr(result, "multipliers", None) if multipliers is None else multipliers
    if not (multipliers is None or isinstance(multipliers, Multipliers)):
        advice = "Those of a result are result.multipliers."
        raise ProblemError("multipliers", brief(multipliers), "Multipliers, or None", advice)
    if not isinstance(trajectory, Trajectory):
        trajectory = _trajectory_of(problem, real_array("u", trajectory))
    problem.require(trajectory)
    translation, subject = translation_of(problem), (problem, trajectory)
    problem, at = translation.judged_at(trajectory)
    if multipliers is None:
        certificate = entry_for(CERTIFIERS, problem.form)(problem, at, allowed)
    else:
        certificate = _judge_to_rounding(problem, at, multipliers, allowed)
        if evidence is not None:
            certificate = replace(certificate, bound=evidence.verified(problem))
    return replace(certificate.raised(translation.cost), subject=subject)


def _trajectory_of(problem: OptimalControlProblem, u: Array) -> Trajectory:
    """Return the trajectory of controls; where they leave the initial state open, the cheapest that is feasible.

    If none is, only the ends count, which then determine the initial state.
    """
    T, m = problem.horizon, problem.control_dim
    if problem.response is not None or problem.initial_box.fixed.all() or u.shape != (T, m):
        return simulate(problem, u)
    # the spectra of controls say nothing of x_0, and rounding would contradict them
    given = problem.derived(control_set=[Box(now, now) for now in u], control_spectrum=None)
    for one in (given, given.derived(state_set=None, state_spectrum=None, output_spectrum=None, stage_rows=None)):
        found = solve_judged(one, Options(family_of(one).in_loop)).trajectory
        if found is not None:
            return Trajectory(found.x, u)
    return simulate(problem, u, problem.initial_box.project(np.zeros(problem.state_dim)))


def _judge_to_rounding(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers, allowed: float
) -> Certificate:
    """Judge a trajectory; where that decides, the certificate says what rounding of the data changes of the cost."""
    certificate = judge(problem, trajectory, multipliers, allowed)
    if certificate.pmp == "satisfied" and not certificate.globally_optimal and not problem.mode_names:
        with suppress(UnsupportedError):  # corrections that do not fit into memory
            proof = correct_point(problem, trajectory, multipliers, allowed)
            rounding = 0.0 if proof is None else proof.certificate.data_rounding
            rounded = replace(certificate, data_rounding=rounding)
            certificate = rounded if rounded.globally_optimal else certificate
    return certificate


def _certify_linear(problem: OptimalControlProblem, trajectory: Trajectory, allowed: float) -> Certificate:
    """Judge a trajectory with the multipliers of an optimum, else with those that fit best, else with abnormal ones.

    Every optimal trajectory of a convex problem has the multipliers of every other one.
    """
    with suppress(UnsupportedError):  # such as a cost that is not convex
        best = solve_judged(problem)
        if best.multipliers is not None:  # proven to be optimal or not
            certificate = _judge_to_rounding(problem, trajectory, best.multipliers, allowed)
            bound = None if best.certificate is None else best.certificate.bound
            if bound is not None and bound.kind == RIGOROUS and not certificate.globally_optimal:
                proven = replace(certificate, bound=Bound(bound.value, bound.kind, sets=bound.sets))
                certificate = proven if proven.globally_optimal else certificate
            if certificate.pmp == "satisfied":
                return certificate
    problem = at_frequencies(problem, peak_points(problem, trajectory.x, trajectory.u, NEAR_LIMIT))
    fit = fit_multipliers(problem, trajectory, max(allowed, ACTIVE))
    normal = judge(problem, trajectory, fit.multipliers, allowed)
    if normal.pmp == "satisfied":
        return normal
    abnormal = abnormal_multipliers(problem, trajectory) if normal.feasible else None
    certificate = normal if abnormal is None else judge(problem, trajectory, abnormal, allowed)
    if certificate.pmp != "satisfied":
        certificate, decimals = normal, decimals_of(trajectory)
        # the least tolerance with which the rounded trajectory satisfies the maximum principle
        if decimals is not None:
            fits = ((level, fit_multipliers(problem, trajectory, level).multipliers) for level in ROUNDED_TO)
            levels = (level for level, y in fits if judge(problem, trajectory, y, level).pmp == "satisfied")
            least = next(levels, None)
            certificate = normal if least is None else replace(normal, rounded=Rounded(decimals, least))
    return replace(certificate, descent=descent_direction(problem, trajectory, fit.descent))


CERTIFIERS: dict[type, Callable[[OptimalControlProblem, Trajectory, float], Certificate]] = {
    LinearDynamics: _certify_linear,
    FrequencyResponse: _certify_linear,
}
"""By kind of dynamics: the function that judges a trajectory without multipliers, at a tolerance."""
