"""certify(): any trajectory, from anywhere, before the judge."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from lin_freq_ocp.certificate.directions import descent_direction
from lin_freq_ocp.certificate.modes.bound import tree_bound
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE
from lin_freq_ocp.certificate.verdict import Certificate, Rounded, decimals_of, judge
from lin_freq_ocp.errors import ProblemError, UnsupportedError
from lin_freq_ocp.methods.multipliers import ACTIVE, abnormal_multipliers, fit_multipliers
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.simulation import simulate
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.solving.certify_modes import certify_modes
from lin_freq_ocp.solving.judging import LARGEST_TOLERANCE

ROUNDED_TO = (1e-5, 1e-4, 1e-3, 1e-2)
"""Tolerances that a trajectory of few decimals is tried with, if it fails the usual one."""


def certify(
    problem: OptimalControlProblem,
    trajectory: Any,
    multipliers: Multipliers | None = None,
    tolerance: float | None = None,
) -> Certificate:
    """Judge any trajectory, from anywhere, against the maximum principle and the global bound.

    Parameters
    ----------
    problem : OptimalControlProblem
    trajectory : Trajectory, (T, m), Result or SavedSolution
        A trajectory; or controls alone, which are then replayed from the initial state; or what solve or load returned,
        with its trajectory, the search tree, checked again, and, unless others are given, its multipliers.
    multipliers : Multipliers, optional
        Without, normal ones (eta_C = 1) that fit the trajectory best are looked for. If there are none, the certificate
        holds the direction of descent that proves it, and abnormal ones (eta_C = 0) are looked for. With
        piecewise-affine dynamics, also those of other mode sequences that the trajectory lies in, and
        ``certificate.borders`` tells what holds where modes meet, and which change of a mode improves.
    tolerance : float, optional
        Residuals, relative to their scales, up to which conditions hold, and distance at which bounds are active; 1e-6
        by default, at most 1e-2. What is said of borders of modes, and of the global bound, keeps its own.

    Returns
    -------
    Certificate
        Where linear dynamics' conditions fail, and the trajectory has few decimals, ``rounded`` says how far rounding
        explains it.

    Raises
    ------
    ProblemError
        If a shape does not fit the problem, or a result has no trajectory.
    UnsupportedError
        If the tolerance is not above zero, or above 1e-2.

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
        raise UnsupportedError(
            f"tolerance: got {tolerance!r}; expected a number above zero, {LARGEST_TOLERANCE:g} at most."
        )
    allowed = CONDITION_TOLERANCE if tolerance is None else tolerance
    tree = getattr(trajectory, "tree", None)
    trajectory, multipliers = _unpacked(trajectory, multipliers)
    if not isinstance(trajectory, Trajectory):
        trajectory = simulate(problem, trajectory)
    problem.require(trajectory)
    if multipliers is not None:
        certificate = judge(problem, trajectory, multipliers, allowed)
        return certificate if tree is None else replace(certificate, bound=tree_bound(problem, tree).bound_for(problem))
    if problem.dynamics.mode_names:
        return certify_modes(problem, trajectory).within(allowed)
    fit = fit_multipliers(problem, trajectory, max(allowed, ACTIVE))
    normal = judge(problem, trajectory, fit.multipliers, allowed)
    if normal.pmp == "satisfied":
        return normal
    abnormal = abnormal_multipliers(problem, trajectory) if normal.feasible else None
    certificate = normal if abnormal is None else judge(problem, trajectory, abnormal, allowed)
    if certificate.pmp != "satisfied":
        certificate = replace(normal, rounded=_rounded(problem, trajectory))
    return replace(certificate, descent=descent_direction(problem, trajectory, fit.descent))


def _rounded(problem: OptimalControlProblem, trajectory: Trajectory) -> Rounded | None:
    """Return what few decimals explain of a trajectory that does not satisfy the maximum principle, if they do."""
    decimals = decimals_of(trajectory)
    for level in ROUNDED_TO if decimals is not None else ():
        fit = fit_multipliers(problem, trajectory, level)
        if decimals is not None and judge(problem, trajectory, fit.multipliers, level).pmp == "satisfied":
            return Rounded(decimals, level)
    return None


def _unpacked(given: Any, multipliers: Multipliers | None) -> tuple[Any, Multipliers | None]:
    """Return the trajectory of what solve or load returned, and its multipliers unless there are others."""
    if not hasattr(given, "trajectory"):
        return given, multipliers
    if given.trajectory is None:
        expected = "a trajectory, controls, or a result that has a trajectory"
        raise ProblemError("trajectory", f"a result without one, which ended as {given.status!r}", expected)
    return given.trajectory, given.multipliers if multipliers is None else multipliers
