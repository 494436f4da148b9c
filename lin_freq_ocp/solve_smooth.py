"""solve() for piecewise-smooth dynamics: search local optima, polish the best by Newton's method, judge, and bound."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from lin_freq_ocp.certificate.bound import Bound
from lin_freq_ocp.certificate.value_bound import value_bounds
from lin_freq_ocp.certificate.value_step import OutOfTimeError
from lin_freq_ocp.certificate.verdict import Certificate, judge
from lin_freq_ocp.certify_modes import best_multipliers
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.methods.convex import require_convex
from lin_freq_ocp.methods.modes.weights import weighted
from lin_freq_ocp.methods.nonsmooth.local_search import LocalSearch
from lin_freq_ocp.methods.nonsmooth.newton import newton
from lin_freq_ocp.methods.nonsmooth.sequential import LocalOptimum
from lin_freq_ocp.problem.arrays import Indices
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.result import Result

SMOOTH_METHODS = ("nonsmooth",)

LOCAL = "locally; no global bound was asked for"
"""The message of a result without a bound."""

GLOBAL_GAP = 1e-4
"""Relative gap to prove, unless another is asked for."""

GLOBAL_SECONDS = 10.0
"""For the bound, unless there is a time limit: enough for short horizons, and not too long to wait for."""

FEASIBILITY_LOSS = 1.0
"""Of each step, where no cost is known and only the existence of a trajectory is asked for."""

Judged = tuple[Trajectory, Multipliers, Certificate]


def solve_smooth(
    problem: OptimalControlProblem, method: str, backend: str, seconds: float, gap: float | None = None
) -> Result:
    """Return the best local optimum that is found, judged; with the method "auto", and a global bound.

    Raises
    ------
    UnsupportedError
        If the method or backend is not for piecewise-smooth dynamics, or the cost is not convex.
    """
    require_convex(problem)
    if method not in ("auto", *SMOOTH_METHODS):
        known = ", ".join(map(repr, SMOOTH_METHODS))
        raise UnsupportedError(f"method: got {method!r}; with piecewise-smooth dynamics, expected 'auto' or {known}.")
    if backend != "auto":
        raise UnsupportedError(f"backend: got {backend!r}; the method 'nonsmooth' needs none: leave it 'auto'.")
    started = time.perf_counter()
    search = LocalSearch(problem, seconds).run()
    solved = time.perf_counter()
    best = search.best
    found = None if best is None or not best.feasible else _polished(problem, best)
    status, message = _status(search, found)
    if status == "optimal" and method == "auto" and found is not None:
        left = GLOBAL_SECONDS if seconds == float("inf") else seconds - (time.perf_counter() - started)
        found, message, stopped = _bounded(problem, found, gap or GLOBAL_GAP, left)
        search.interrupted |= stopped
    elif found is None and method == "auto" and not search.words:
        left = GLOBAL_SECONDS if seconds == float("inf") else seconds - (time.perf_counter() - started)
        if _excluded(problem, left):
            status, message = "infeasible", "proven by dynamic programming with intervals: no trajectory exists"
    trajectory, multipliers, certificate = (None, None, None) if found is None else found
    return Result(
        problem=problem,
        status=status,
        method="nonsmooth",
        backend=None,
        seconds={"setup": 0.0, "solve": solved - started, "certify": time.perf_counter() - solved},
        trajectory=trajectory,
        multipliers=multipliers,
        certificate=certificate,
        message=message,
        interrupted=search.interrupted,
        sequence=None if trajectory is None else _modes(problem, trajectory),
    )


def _polished(problem: OptimalControlProblem, local: LocalOptimum) -> Judged:
    """Return a local optimum with the multipliers that fit best, by Newton's method if that makes both better."""
    affine = problem.affine_at(local.trajectory)
    first = weighted(affine, local.trajectory, local.sequence, local.multipliers)
    certificate, multipliers = best_multipliers(problem, local.trajectory, first)
    found = local.trajectory, multipliers, certificate
    try:
        run = newton(problem, local.trajectory, multipliers, local.sequence)
    except UnsupportedError:
        return found
    after = judge(problem, run.trajectory, run.multipliers)
    better = (len(after.failed), after.worst.relative) < (len(certificate.failed), certificate.worst.relative)
    return (run.trajectory, run.multipliers, after) if better else found


def _bounded(problem: OptimalControlProblem, found: Judged, gap: float, seconds: float) -> tuple[Judged, str, bool]:
    """Return the answer with the best bound of the time, what is to be said of it, and whether it was interrupted."""
    trajectory, multipliers, certificate = found
    cost, deadline, interrupted = certificate.cost, time.perf_counter() + seconds, False
    wanted = gap * max(1.0, abs(cost))
    try:
        for value in value_bounds(problem, multipliers, cost, wanted, deadline):
            bound = Bound(value, "rigorous", sets="dynamic programming over cells of the states, with intervals")
            certificate = replace(certificate, bound=bound)
    except UnsupportedError as error:
        return found, f"locally; {error}", False
    except OutOfTimeError:
        pass
    except KeyboardInterrupt:
        interrupted = True
    proven = certificate.bound is not None and cost - certificate.bound.value <= wanted
    if certificate.gap is None:
        message = "locally; no global bound was found in time"
    else:
        message = "" if proven else f"locally; the global bound leaves a gap of {certificate.gap:.1e}"
    return (trajectory, multipliers, certificate), message, interrupted


def _excluded(problem: OptimalControlProblem, seconds: float) -> bool:
    """Whether intervals prove that there is no trajectory, whatever the frequency constraints: D is infinite."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    eta, mu, nu = np.zeros((T, n)), np.zeros((T + 1, n)), np.zeros((T, m))
    none = Multipliers(1.0, eta, mu, nu, np.zeros((T // 2 + 1, m)), np.zeros(((T + 1) // 2 + 1, n)))
    try:
        deadline = time.perf_counter() + seconds
        return any(bound == np.inf for bound in value_bounds(problem, none, np.inf, FEASIBILITY_LOSS, deadline))
    except (UnsupportedError, OutOfTimeError):
        return False


def _modes(problem: OptimalControlProblem, trajectory: Trajectory) -> Indices:
    return problem.smooth_pieces.sequence_of(trajectory.x, trajectory.u)


def _status(search: LocalSearch, found: Judged | None) -> tuple[str, str]:
    """Return the status of the result, and in words what is missing."""
    if search.words and (found is None or search.interrupted):
        return "limit", search.words
    if found is None:
        nearest = "" if search.best is None else f"; the nearest violates dynamics by {search.best.violation:.1e}"
        return "numerical_error", f"no trajectory was found from {search.tried} starts{nearest}"
    if found[2].pmp != "satisfied":
        return "numerical_error", f"the point found does not satisfy the maximum principle: {found[2].worst.name}"
    return "optimal", LOCAL
