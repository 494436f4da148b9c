"""solve() for piecewise-smooth dynamics: search local optima, polish the best by Newton's method, judge, and bound."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.arrays import Indices
from lin_freq_ocp.certificate.bound import NEVER_NEGATIVE, Bound, cost_is_never_negative
from lin_freq_ocp.certificate.global_bound.bound import value_bounds
from lin_freq_ocp.certificate.global_bound.step import OutOfTimeError
from lin_freq_ocp.certificate.verdict import Certificate, judge
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.methods.convex.sparse_program import require_convex
from lin_freq_ocp.methods.modes.weights import weighted
from lin_freq_ocp.methods.nonsmooth.local_search import LocalSearch, SmoothProgress
from lin_freq_ocp.methods.nonsmooth.minlp import DEFAULT_GAP as CLAIMED_GAP
from lin_freq_ocp.methods.nonsmooth.minlp import GlobalClaim, polished, solve_minlp
from lin_freq_ocp.methods.nonsmooth.newton import newton
from lin_freq_ocp.methods.nonsmooth.sequential import LocalOptimum
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.result import Result
from lin_freq_ocp.solving.certify_modes import best_multipliers
from lin_freq_ocp.solving.starts import Start

SMOOTH_METHODS = ("nonsmooth", "minlp")

LOCAL = "no global bound was asked for"
"""The message of a result without a bound."""

UNBOUNDED = "no global bound was found in time"
"""The message of a result whose bound got no time, or not enough."""

EXCLUDED = "proven by dynamic programming with intervals: no trajectory exists"
"""The message of an infeasible result, where our bound proves it."""

GLOBAL_GAP = 1e-4
"""Relative gap to prove, unless another is asked for."""

GLOBAL_SECONDS = 10.0
"""For the bound, unless there is a time limit: enough for short horizons, and not too long to wait for."""

SAVED_BY_TOLERANCE = 1e-6
"""Part of its cost by which a start may be below what was found: the judge forgives violations as large."""

FEASIBILITY_LOSS = 1.0
"""Of each step, where no cost is known and only the existence of a trajectory is asked for."""

LEAST_TIME = 0.25
"""Seconds that are left for the trajectory of a solver that has used them all."""

Judged = tuple[Trajectory, Multipliers, Certificate]

Report = Callable[[SmoothProgress], None]


def solve_smooth(
    problem: OptimalControlProblem,
    method: str,
    backend: str,
    seconds: float,
    gap: float | None = None,
    progress: Report | None = None,
    start: Start | None = None,
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
    if start is not None and method == "minlp":
        raise UnsupportedError("start: got one for the method 'minlp'; only 'nonsmooth' and 'auto' begin with one.")
    if method == "minlp":
        return _through_solver(problem, "scip" if backend == "auto" else backend, seconds, gap)
    if backend != "auto":
        raise UnsupportedError(f"backend: got {backend!r}; the method 'nonsmooth' needs none: leave it 'auto'.")
    started = time.perf_counter()
    search = LocalSearch(problem, seconds, progress, start).run()
    solved = time.perf_counter()
    best = search.best
    found = None if best is None or not best.feasible else _polished(problem, best)
    found = found if start is None else _not_above(problem, start, found)
    status, message = _status(search, found)
    if status == "locally_optimal" and method == "auto" and found is not None:
        left = GLOBAL_SECONDS if seconds == float("inf") else seconds - (time.perf_counter() - started)
        bounding = _Bounding(search, found, gap or GLOBAL_GAP, time.perf_counter() + left)
        message = bounding.run() if left > 0 else UNBOUNDED
        found = bounding.found
        status = found[2].status_within(bounding.gap)
    elif found is None and method == "auto" and not search.words:
        left = GLOBAL_SECONDS if seconds == float("inf") else seconds - (time.perf_counter() - started)
        if left > 0 and _excluded(problem, left):
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
    started = time.perf_counter()
    claim = solve_minlp(problem, backend, limit, gap or CLAIMED_GAP)
    clock = time.perf_counter()
    local = polished(problem, claim, max(started + seconds, clock + LEAST_TIME))
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
    words = f"{told} {word}; not proven"
    if claim.status in ("limit", "interrupted"):
        return "limit", words, bound
    if found is None or claim.status == "failed":
        return "numerical_error", f"no trajectory was found from the point it found, {word}", bound
    certificate = found[2]
    if certificate.status_within(CLAIMED_GAP) == "numerical_error":
        worst = certificate.worst.name
        return "numerical_error", f"the point found does not satisfy the maximum principle: {worst}; {words}", bound
    return "locally_optimal", "; ".join([words, *claim.mismatches(certificate.cost, certificate.cost_scale)]), bound


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
    before, now = ((not one.feasible, len(one.failed), one.worst.relative) for one in (certificate, after))
    return (run.trajectory, run.multipliers, after) if now < before else found


def _not_above(problem: OptimalControlProblem, start: Start, found: Judged | None) -> Judged | None:
    """Return what was found, or the start itself where that is a trajectory of less cost."""
    if start.trajectory is None:
        return found
    certificate = judge(problem, start.trajectory, _none(problem))
    saved = found[2].cost - certificate.cost if found is not None and found[2].feasible else np.inf
    if not certificate.feasible or saved <= SAVED_BY_TOLERANCE * abs(certificate.cost):
        return found
    certificate, multipliers = best_multipliers(problem, start.trajectory, _none(problem))
    return start.trajectory, multipliers, certificate


def _none(problem: OptimalControlProblem) -> Multipliers:
    """Return multipliers of which only that of the cost is not zero."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    eta, mu, nu = np.zeros((T, n)), np.zeros((T + 1, n)), np.zeros((T, m))
    return Multipliers(1.0, eta, mu, nu, np.zeros((T // 2 + 1, m)), np.zeros(((T + 1) // 2 + 1, n)))


@dataclass
class _Bounding:
    """The global bound of an answer, and the better answers that it leads to; ``run`` it once."""

    search: LocalSearch
    found: Judged
    gap: float
    deadline: float
    best: float = -float("inf")
    sets: str = ""

    def __post_init__(self):
        self._known = {_modes(self.search.problem, self.found[0]).tobytes()}

    def run(self) -> str:
        """Bound until the gap is proven or the time is over; return what is to be said of the answer."""
        words = ""
        if cost_is_never_negative(self.search.problem):
            self.best, self.sets = 0.0, NEVER_NEGATIVE
        try:
            while not self._proven and self._leads_further():
                pass
        except UnsupportedError as error:
            words = str(error)
        except OutOfTimeError:
            pass
        except KeyboardInterrupt:
            self.search.interrupted = True
        if self.best == -float("inf"):
            return words or UNBOUNDED
        trajectory, multipliers, certificate = self.found
        bound = Bound(self.best, "rigorous", sets=self.sets)
        self.found = trajectory, multipliers, replace(certificate, bound=bound)
        return "" if self._proven else words or f"the global bound leaves a gap of {self.found[2].gap:.1e}"

    @property
    def _wanted(self) -> float:
        return self.gap * self.found[2].cost_scale

    @property
    def _proven(self) -> bool:
        return self.found[2].cost - self.best <= self._wanted

    def _leads_further(self) -> bool:
        """Whether a path of the bound leads to a better answer, which is taken."""
        _, multipliers, certificate = self.found
        levels = value_bounds(
            self.search.problem,
            multipliers,
            certificate.cost,
            self._wanted,
            self.deadline,
            self._report,
            certificate.cost_scale,
        )
        for level in levels:
            if level.value > self.best:
                self.best, self.sets = level.value, "dynamic programming over cells of the states, with intervals"
            if self._proven:
                return False
            if level.path is None or level.sequence is None or level.sequence.tobytes() in self._known:
                continue
            self._known.add(level.sequence.tobytes())
            if self.search.look_near(level.path, level.sequence) and self.search.best is not None:
                better = _polished(self.search.problem, self.search.best)
                if better[2].pmp == "satisfied":
                    self.found = better
                    return True
        return False

    def _report(self, level: int, share: float) -> None:
        if self.search.progress is not None:
            cost = self.found[2].cost
            self.search.progress(SmoothProgress(cost, self.best, self.search.tried, level, share))


def _excluded(problem: OptimalControlProblem, seconds: float) -> bool:
    """Whether intervals prove that there is no trajectory, whatever the frequency constraints: D is infinite."""
    try:
        deadline = time.perf_counter() + seconds
        levels = value_bounds(problem, _none(problem), np.inf, FEASIBILITY_LOSS, deadline, scale=FEASIBILITY_LOSS)
        return any(level.value == np.inf for level in levels)
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
    status = found[2].status_within(0.0)
    if status == "numerical_error":
        return status, f"the point found does not satisfy the maximum principle: {found[2].worst.name}"
    return status, LOCAL
