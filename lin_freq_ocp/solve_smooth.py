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
from lin_freq_ocp.methods.nonsmooth.minlp import DEFAULT_GAP as CLAIMED_GAP
from lin_freq_ocp.methods.nonsmooth.minlp import GlobalClaim, polished, solve_minlp
from lin_freq_ocp.methods.nonsmooth.newton import newton
from lin_freq_ocp.methods.nonsmooth.sequential import LocalOptimum
from lin_freq_ocp.problem.arrays import Indices
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.result import Result

SMOOTH_METHODS = ("nonsmooth", "minlp")

LOCAL = "locally; no global bound was asked for"
"""The message of a result without a bound."""

EXCLUDED = "proven by dynamic programming with intervals: no trajectory exists"
"""The message of an infeasible result, where our bound proves it."""

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
    if method == "minlp":
        return _through_solver(problem, "scip" if backend == "auto" else backend, seconds, gap)
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
            status, message = "infeasible", EXCLUDED
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


def _through_solver(problem: OptimalControlProblem, backend: str, seconds: float, gap: float | None) -> Result:
    """Return the trajectory that a global solver's point leads to, judged by us, and what the solver claims."""
    limit = None if seconds == float("inf") else seconds
    claim = solve_minlp(problem, backend, limit, gap or CLAIMED_GAP)
    clock = time.perf_counter()
    local = polished(problem, claim)
    found = None if local is None or not local.feasible else _polished(problem, local)
    left = GLOBAL_SECONDS if limit is None else min(GLOBAL_SECONDS, limit - sum(claim.seconds.values()))
    status, message, bound = _weighed(problem, claim, found, backend, left)
    trajectory, multipliers, certificate = (None, None, None) if found is None else found
    return Result(
        problem=problem,
        status=status,
        method="minlp",
        backend=backend,
        seconds={**claim.seconds, "certify": time.perf_counter() - clock},
        trajectory=trajectory,
        multipliers=multipliers,
        certificate=certificate,
        message=message,
        interrupted=claim.status == "interrupted",
        sequence=None if trajectory is None else _modes(problem, trajectory),
        claimed_bound=bound,
    )


def _weighed(
    problem: OptimalControlProblem, claim: GlobalClaim, found: Judged | None, backend: str, left: float
) -> tuple[str, str, float | None]:
    """Return the status of the result, in words what the claim is worth, and the bound that is claimed."""
    word = f"by the word of {backend} ('{claim.words}')"
    if claim.excluded:
        return "infeasible", "proven by intervals: the dynamics cannot lead from one end to the other", None
    if claim.status == "infeasible":
        if _excluded(problem, left):
            return "infeasible", EXCLUDED, None
        return "infeasible", f"{word}; not proven", float("inf")
    if claim.status == "unbounded":
        return "unbounded", f"{word}; not proven", -float("inf")
    bound = claim.bound
    told = "no lower bound" if bound is None else f"the lower bound {bound:.9g}"
    words = f"locally; {told} {word}; not proven"
    if claim.status in ("limit", "interrupted"):
        return "limit", words, bound
    if found is None or claim.status == "failed":
        return "numerical_error", f"no trajectory was found from the point it found, {word}", bound
    certificate = found[2]
    if certificate.pmp != "satisfied":
        worst = certificate.worst.name
        return "numerical_error", f"the point found does not satisfy the maximum principle: {worst}; {words}", bound
    return "optimal", "; ".join([words, *claim.mismatches(certificate.cost)]), bound


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
