"""solve() and certify(): the two functions that know every stage, from a problem to a judged result."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any

import numpy as np

from lin_freq_ocp.backends.base import backend as solver_named
from lin_freq_ocp.certificate.conditions import CONDITION_TOLERANCE
from lin_freq_ocp.certificate.conflict import prove_infeasible
from lin_freq_ocp.certificate.directions import Direction, descent_direction, unbounded_direction
from lin_freq_ocp.certificate.rounded import Rounded, decimals_of
from lin_freq_ocp.certificate.verdict import Certificate, judge
from lin_freq_ocp.certify_modes import certify_modes
from lin_freq_ocp.errors import (
    InfeasibleError,
    LimitError,
    LinFreqOCPError,
    NumericalError,
    ProblemError,
    SolveError,
    UnboundedError,
    UnsupportedError,
)
from lin_freq_ocp.methods.candidate import Candidate
from lin_freq_ocp.methods.convex import convex_candidates, solve_convex
from lin_freq_ocp.methods.ends import contradiction_at_ends
from lin_freq_ocp.methods.free_of_cost import free_of_cost, free_of_slope
from lin_freq_ocp.methods.modes.search import GAP, SearchLimits, SearchProgress
from lin_freq_ocp.methods.multipliers import ACTIVE, abnormal_multipliers, fit_multipliers
from lin_freq_ocp.methods.nonsmooth.local_search import SmoothProgress
from lin_freq_ocp.methods.spectral import SpectralSolver, row_form
from lin_freq_ocp.problem.costs import QuadraticCost
from lin_freq_ocp.problem.dynamics import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.piecewise_smooth import PiecewiseSmoothDynamics
from lin_freq_ocp.problem.simulation import simulate
from lin_freq_ocp.problem.starts import start_of
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.result import Result
from lin_freq_ocp.solve_modes import MODE_METHODS, solve_modes
from lin_freq_ocp.solve_options import require_taken
from lin_freq_ocp.solve_smooth import SMOOTH_METHODS, solve_smooth

PROVER = "clarabel"
"""The backend that proves infeasibility and unboundedness, whichever backend met it."""

LEAST_TIME = 1e-3
"""Seconds that are left to a second method when the first one has used them all: it ends at once, with its words."""

DIVERGED = 1e6
"""Multipliers of a failed solve that are larger than this may be a ray: the judge decides."""

EXPLAIN_SECONDS = 5.0
"""Time for saying why a problem has no solution, unless a time limit leaves less."""

LOOSEST = 1e-2
"""The judge forgives what a tolerance allows, up to here: beyond, nothing would be said of the point."""

ROUNDED_TO = (1e-5, 1e-4, 1e-3, 1e-2)
"""Tolerances that a trajectory of few decimals is tried with, if it fails the usual one."""

METHODS = ("auto", "convex", "spectral", *MODE_METHODS, *SMOOTH_METHODS)

ERRORS: dict[str, type[SolveError]] = {
    "infeasible": InfeasibleError,
    "unbounded": UnboundedError,
    "limit": LimitError,
    "numerical_error": NumericalError,
}


def solve(
    problem: OptimalControlProblem,
    method: str = "auto",
    backend: str = "auto",
    time_limit: float | None = None,
    tolerance: float | None = None,
    throw: bool = True,
    node_limit: int | None = None,
    progress: Callable[[SearchProgress | SmoothProgress], None] | None = None,
    executor: Executor | None = None,
    start: Any = None,
) -> Result:
    """Solve a problem, and judge the answer.

    Parameters
    ----------
    problem : OptimalControlProblem
    method : {"auto", "convex", "spectral", "branch_and_bound", "enumerate", "miqp", "nonsmooth", "minlp"}
        Linear dynamics: "spectral", our Fourier-domain method, for time-invariant ones; "convex", one sparse quadratic
        program; "auto", spectral where it applies and its answer is proven, else convex, or convex if a backend is
        named. Piecewise-affine dynamics: "branch_and_bound" over mode sequences, also "auto"; "enumerate", all of them;
        "miqp", a mixed-integer solver's sequence, which branch and bound then proves or improves. Piecewise-smooth
        dynamics: "nonsmooth", local optima of mode sequences, the best polished by a semismooth Newton method; "auto",
        the same and, with up to three states, a global bound, on which it spends 10 s or what the time limit leaves;
        "minlp", a second opinion: the trajectory that a global solver's point leads to, judged by us, with the bound
        that the solver claims in ``claimed_bound``.
    backend : str
        Of "convex": "auto" (Clarabel), "clarabel", "osqp" or "qpsolvers:NAME". Of "miqp": "auto" (SCIP), "scip" or
        "daqp". Of "minlp": "auto" or "scip".
    time_limit : float, optional
        Seconds, set-up included, to which the judge's certificate is added. What is estimated not to end within it is
        not begun.
    tolerance : float, optional
        Convex: relative residuals asked of the solver, on a program scaled to order 1. Spectral: relative violation of
        bounds to stop at. Both: above 1e-6, also what the judge forgives, up to 1e-2. Over modes: the relative gap to
        prove, 1e-6 by default; 1e-4 with piecewise-smooth dynamics. Of "minlp": the relative gap asked of the solver,
        1e-6 by default.
    throw : bool
        Whether to raise if the status is neither "optimal" nor "locally_optimal"; the error holds the result.
    node_limit : int, optional
        Over modes: relaxations to solve at most.
    progress : callable, optional
        Over modes: called with a ``SearchProgress`` (cost, lower_bound, nodes, open, seconds) at every node. Over
        piecewise-smooth dynamics: with a ``SmoothProgress`` (cost, lower_bound, tried, level, share) at every start of
        a local search and every step of the bound.
    executor : concurrent.futures.Executor, optional
        Branch and bound: searches sub-trees with its workers. The answer does not depend on how many there are.
    start : Trajectory, (T, m) or (T,) integers, optional
        Of piecewise-affine and piecewise-smooth dynamics: a trajectory (or a result), controls to be replayed from the
        initial state, or the mode at every time. Branch and bound begins with the best trajectory of these modes, the
        local search at this one: what they end with is not worse.

    Returns
    -------
    Result

    Raises
    ------
    InfeasibleError, UnboundedError, LimitError, NumericalError
        With ``throw``; a subclass of SolveError, with ``.result``.
    UnsupportedError
        If the method or backend does not exist or cannot take this problem, or does not know an option.
    ProblemError
        If the start does not fit the problem.
    """
    require_problem(problem)
    require_options(method, backend, time_limit, tolerance)
    given = {"tolerance": tolerance, "node_limit": node_limit, "executor": executor, "start": start}
    require_taken(problem, method, given)
    _require_positive("node_limit", node_limit)
    begin = None if start is None else start_of(problem, start)
    started = time.perf_counter()
    if isinstance(problem.dynamics, PiecewiseAffineDynamics):
        limits = SearchLimits(tolerance or GAP, time_limit or np.inf, node_limit or SearchLimits.nodes)
        result = solve_modes(problem, method, backend, limits, progress, executor, begin)
    elif isinstance(problem.dynamics, PiecewiseSmoothDynamics):
        result = solve_smooth(problem, method, backend, time_limit or np.inf, tolerance, progress, begin)
    else:
        result = _linear(problem, method, backend, tolerance, time_limit)
    options: dict[str, Any] = {"method": method, "backend": backend, "time_limit": time_limit, "tolerance": tolerance}
    options |= {} if node_limit is None else {"node_limit": node_limit}
    result = replace(result, options=options if begin is None else {**options, "start": begin.saved})
    if throw and result.status == "infeasible":
        left = EXPLAIN_SECONDS if time_limit is None else time_limit - (time.perf_counter() - started)
        result = explained(result, min(left, EXPLAIN_SECONDS))
    if throw and result.status in ERRORS:
        raise ERRORS[result.status](_complaint(result), result)
    return result


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
        with its trajectory and, unless others are given, its multipliers.
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
    """
    require_problem(problem)
    if tolerance is not None and not 0 < tolerance <= LOOSEST:
        raise UnsupportedError(f"tolerance: got {tolerance!r}; expected a number above zero, {LOOSEST:g} at most.")
    allowed = CONDITION_TOLERANCE if tolerance is None else tolerance
    trajectory, multipliers = _unpacked(trajectory, multipliers)
    if not isinstance(trajectory, Trajectory):
        trajectory = simulate(problem, trajectory)
    problem.require(trajectory)
    if multipliers is not None:
        return judge(problem, trajectory, multipliers, allowed)
    if not isinstance(problem.dynamics, LinearDynamics):
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


def _linear(
    problem: OptimalControlProblem, method: str, backend: str, tolerance: float | None, time_limit: float | None
) -> Result:
    if method in (*MODE_METHODS, *SMOOTH_METHODS):
        raise UnsupportedError(f"method: got {method!r}, which is for dynamics with modes; these have none.")
    started, first, refused = time.perf_counter(), None, ""
    contradiction = contradiction_at_ends(problem)
    if contradiction is not None:
        claim = Candidate("infeasible", None, None, contradiction, None, "an end lies outside the state set")
        result = _judged(problem, claim, "spectral" if method == "spectral" else "convex", None, tolerance)
        if result.status == "infeasible":
            return result
    if method == "spectral" or (method == "auto" and backend == "auto"):
        try:
            first = _spectral(problem, tolerance, time_limit)
        except UnsupportedError as error:
            if method == "spectral":
                raise
            refused = str(error)
        if first is not None and (method == "spectral" or _ended(first)):
            return first
    left = _left(np.inf if time_limit is None else started + time_limit)
    try:
        second = _convex(problem, PROVER if backend == "auto" else backend, tolerance, left)
    except UnsupportedError as error:
        if not refused or str(error) in refused:
            raise
        raise UnsupportedError(f"{error} Before that: {refused}") from None
    return first if first is not None and _worth(first) > _worth(second) else second


def _spectral(problem: OptimalControlProblem, tolerance: float | None, time_limit: float | None) -> Result:
    """Return what the Fourier-domain method ends with."""
    started, rows = time.perf_counter(), row_form(problem)
    end = np.inf if time_limit is None else started + time_limit
    solver = SpectralSolver(rows.problem)
    candidate: Candidate = solver.solve(tolerance=tolerance, time_limit=_left(end))
    if rows.polyhedra:
        found = {name: getattr(candidate, name) for name in ("multipliers", "ray")}
        candidate = replace(candidate, **{name: one and rows.multipliers(one) for name, one in found.items()})
    if candidate.status == "unbounded":
        candidate = _if_feasible(problem, candidate, _left(end))
    return _judged(problem, candidate, "spectral", None, tolerance)


def _ended(result: Result) -> bool:
    """Whether the Fourier-domain method's answer is proven, or the time is over: no other method is asked."""
    proven = result.status == "optimal" and result.certificate is not None and result.certificate.pmp == "satisfied"
    excluded = result.status == "infeasible" and "numerical" not in result.message
    return proven or result.interrupted or excluded or result.status == "limit"


def _worth(result: Result) -> int:
    """Return a rank of what is proven by a result."""
    return 2 if result.status in ("optimal", "infeasible", "unbounded") else int(result.status == "locally_optimal")


def _convex(problem: OptimalControlProblem, backend: str, tolerance: float | None, time_limit: float | None) -> Result:
    """Return what the sparse program ends with: the first answer that is worth something, else the first."""
    end = np.inf if time_limit is None else time.perf_counter() + time_limit
    candidates = convex_candidates(problem, backend, tolerance, time_limit)

    def judged(candidate: Candidate) -> Result:
        if candidate.status == "unbounded":
            candidate = _if_feasible(problem, candidate, _left(end))
        return _judged(problem, candidate, "convex", backend, tolerance)

    candidate = next(candidates)
    if candidate.status not in ("optimal", "limit") and backend != PROVER:
        candidate = _accounted(problem, candidate, _left(end))
    result = judged(candidate)
    if result.status in ("locally_optimal", "numerical_error") and result.trajectory is not None:
        for free in (free_of_cost(problem, result.trajectory), free_of_slope(problem, result.trajectory, _left(end))):
            other = result if free is None else _judged(problem, free, "convex", backend, tolerance)
            if other.status == "optimal":
                return replace(other, seconds=result.seconds)
    if result.status == "numerical_error" and not result.interrupted:
        for candidate in candidates:
            other = judged(candidate)
            proven = other.status != "unbounded" or other.direction is not None
            if (_worth(other) and proven) or other.interrupted:
                return other
    return result


def _left(end: float) -> float | None:
    """Return the seconds until then, at least a few, or None for no end."""
    return None if end == np.inf else max(end - time.perf_counter(), LEAST_TIME)


def settled(status: str, words: str, certificate: Certificate, gap: float) -> tuple[str, str]:
    """Return what a method's status is worth once its point was judged, and in words why.

    A point that is proven within ``gap`` is optimal, whatever its solver says; one that a solver calls optimal is what
    the certificate says of it. Points that satisfy the maximum principle only are locally optimal.
    """
    found = certificate.status_within(gap)
    if found == "optimal":
        return found, ""
    if status not in ("optimal", "numerical_error"):
        return status, words
    if found == "locally_optimal":
        return found, f"the maximum principle is satisfied; {_missing(certificate)}"
    if status == "optimal":
        words = f"residuals of the program are small, but not those of: {certificate.worst.name}"
    return found, words


def _missing(certificate: Certificate) -> str:
    """Return why a certificate without failed conditions proves no global optimum."""
    if certificate.bound is None or certificate.gap is None:
        return "there is no bound"
    if certificate.bound.kind != "rigorous":
        return "the bound holds near the trajectory only, as something is not bounded"
    worth = certificate.worth_of_residuals / certificate.cost_scale if certificate.cost_scale > 0 else np.inf
    return f"the bound leaves a gap of {certificate.gap:.1e}, and residuals are worth {worth:.1e} of the cost"


def _accounted(problem: OptimalControlProblem, candidate: Candidate, time_limit: float | None) -> Candidate:
    """Return the prover's account of a problem that another backend did not solve, if it has one."""
    account = solve_convex(problem, PROVER, None, time_limit)
    return account if account.status in ("infeasible", "unbounded") else candidate


def _if_feasible(problem: OptimalControlProblem, candidate: Candidate, time_limit: float | None) -> Candidate:
    """Return the unbounded candidate, or the account of a problem that has no trajectory for its cost to fall along."""
    feasibility = solve_convex(replace(problem, cost=QuadraticCost()), PROVER, None, time_limit)
    return feasibility if feasibility.status == "infeasible" else candidate


def _judged(
    problem: OptimalControlProblem, candidate: Candidate, method: str, backend: str | None, tolerance: float | None
) -> Result:
    clock = time.perf_counter()
    status, words, conflict, ray, certificate = candidate.status, candidate.words, None, None, None
    if candidate.trajectory is not None and candidate.multipliers is not None:
        allowed = min(max(CONDITION_TOLERANCE, tolerance or 0.0), LOOSEST)
        certificate = judge(problem, candidate.trajectory, candidate.multipliers, allowed)
        if not candidate.interrupted:
            status, words = settled(status, words, certificate, allowed)
    direction = None if candidate.descent is None else unbounded_direction(problem, candidate.descent)
    if status == "unbounded":
        words = _fall(problem, direction) if direction else f"{words}, without a verified direction"
    claimed = candidate.ray if status == "infeasible" else _diverged(candidate)
    proof = None if claimed is None else prove_infeasible(problem, claimed)
    if proof is not None:
        status, conflict, ray = "infeasible", proof.conflict, proof.multipliers
        words = f"proven by a {proof.bound.kind} ray"
        candidate = replace(candidate, trajectory=None, multipliers=None)
        certificate = None
    elif status == "infeasible":
        status, words = "numerical_error", f"{words}, but its ray proves nothing"
    return Result(
        problem=problem,
        status=status,
        method=method,
        backend=backend,
        seconds={**candidate.seconds, "certify": time.perf_counter() - clock},
        trajectory=candidate.trajectory,
        multipliers=candidate.multipliers,
        certificate=certificate,
        conflict=conflict,
        ray=ray,
        message="" if status == "optimal" else words,
        interrupted=candidate.interrupted,
        direction=direction,
    )


def _fall(problem: OptimalControlProblem, direction: Direction) -> str:
    t, j = direction.steepest, int(np.argmax(np.abs(direction.u).max(0)))
    return (
        f"the cost falls for ever along a verified direction, most with {problem.control_names[j]} "
        f"{'up' if direction.u[t, j] > 0 else 'down'} at t = {t}"
    )


def _diverged(candidate: Candidate) -> Multipliers | None:
    """Return the multipliers of a solve that failed, divided by their size: near infeasibility they grow into a ray."""
    if candidate.status not in ("numerical_error", "limit") or candidate.multipliers is None or candidate.interrupted:
        return None
    given = candidate.multipliers
    parts = (given.eta, given.mu, given.nu, np.abs(given.rho_u), np.abs(given.rho_x), *given.stage.values())
    size = max(float(np.abs(part).max(initial=0.0)) for part in parts)
    if size < DIVERGED:
        return None
    stage = {name: part / size for name, part in given.stage.items()}
    return Multipliers(
        0.0, given.eta / size, given.mu / size, given.nu / size, given.rho_u / size, given.rho_x / size, stage
    )


def explained(result: Result, seconds: float = EXPLAIN_SECONDS) -> Result:
    """Return an infeasible result with its explanation, if one was found in that time."""
    from lin_freq_ocp.explain import explain

    try:
        return replace(result, explanation=explain(result.problem, seconds) if seconds > 0 else None)
    except LinFreqOCPError:  # the proof stands without it
        return result


def _complaint(result: Result) -> str:
    name = result.problem.name or "the problem"
    if result.status == "infeasible":
        if result.conflict is None:
            return f"No trajectory of {name} satisfies all constraints ({result.message})."
        blocks = "; ".join(str(one) for one in result.conflict)
        cures = "; or ".join(str(one) for one in result.explanation.cures) if result.explanation else ""
        return f"No trajectory of {name} satisfies all constraints ({result.message}). In conflict: {blocks}. " + (
            f"Least change that helps: {cures}." if cures else "Relax one of these."
        )
    if result.status == "unbounded":
        return f"The cost of {name} has no lower bound. Bound the controls, or give every one of them a cost."
    if result.status == "limit":
        return f"{name}: stopped before the answer was accurate ({result.message}); {_reached(result)}."
    return (
        f"{name}: {result.solver} ended with '{result.message}', and its residuals are too large to call it a "
        "solution; what it found is in .result. Try another backend or method."
    )


def _reached(result: Result) -> str:
    """Return cost, bound and gap of the best point that a limit left, in words."""
    figures = (("cost", result.cost), ("lower bound", result.lower_bound), ("gap", result.gap))
    told = ", ".join(f"{what} {'unknown' if value is None else format(value, '.6g')}" for what, value in figures)
    return (
        "no point was found" + ("" if result.lower_bound is None else f", lower bound {result.lower_bound:.6g}")
        if result.trajectory is None
        else f"the best point is in .result: {told}"
    )


def require_options(method: str, backend: str, time_limit: float | None, tolerance: float | None) -> None:
    """Raise UnsupportedError unless the options of solve exist, MissingExtraError if the backend is not installed."""
    if method not in METHODS:
        known = ", ".join(map(repr, METHODS[:-1]))
        raise UnsupportedError(f"method: got {method!r}; expected {known} or {METHODS[-1]!r}.")
    if method == "spectral" and backend != "auto":
        raise UnsupportedError(f"backend: got {backend!r}; the method 'spectral' needs none: leave it 'auto'.")
    if backend != "auto" and method not in ("miqp", "minlp"):
        solver_named(backend)
    _require_positive("time_limit", time_limit)
    _require_positive("tolerance", tolerance)


def _require_positive(name: str, value: float | None) -> None:
    if value is not None and not value > 0:
        raise UnsupportedError(f"{name}: got {value!r}; expected a number above zero, or None.")
