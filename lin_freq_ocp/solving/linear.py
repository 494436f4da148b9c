"""The methods for linear dynamics: Fourier-domain, structured, one sparse convex program, and these in turn."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, takewhile
from typing import ClassVar

from lin_freq_ocp.base.activity import activity_step
from lin_freq_ocp.base.clock import now, seconds_left
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.bound import RIGOROUS
from lin_freq_ocp.certificate.rays import prove_infeasible
from lin_freq_ocp.methods.candidate import Attempt, Candidate, Reason, SolveOptions, contradiction_at_ends
from lin_freq_ocp.methods.convex.polish import steepest_recession
from lin_freq_ocp.methods.convex.sparse_program import convex_candidates, solve_convex, structured_first
from lin_freq_ocp.methods.long_problems import distance_cost, is_long, solve_long
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.solving.judging import judge_candidate, verified_direction
from lin_freq_ocp.solving.method import Method, Request, take_best
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solver_cache import solve_spectral

CONDENSED = "condensed"  # what the Fourier-domain method is called where it solves again in few unknowns
CHOSEN_FIRST = "time-invariant dynamics, with constraints that the Fourier-domain method takes"
PROVER = "clarabel"  # the backend that proves infeasibility and unboundedness that any backend reports

ANSWERS = (Reason.LOCALLY_OPTIMAL, Reason.UNBOUNDED, Reason.NEARLY_FEASIBLE)  # other units do not prove more
CLAIMS = (Status.INFEASIBLE, Status.UNBOUNDED)
UNPROVEN_POINTS = (Reason.FAILED, Reason.FEASIBLE, Reason.LOCALLY_OPTIMAL)  # perhaps on the way along a direction


@dataclass(eq=False)
class _Trial:
    """One solve of a problem by a method, with its tolerance and its deadline; it judges the candidates of the method.

    Parameters
    ----------
    end : float
        By ``clock.now``; inf without a time limit.
    certified : float
        Seconds of the judge until now.
    """

    problem: OptimalControlProblem
    method: str
    tolerance: float | None
    end: float
    backend: str | None = None
    proof: bool = True
    certified: float = 0.0

    @property
    def options(self) -> SolveOptions:
        """Return the options of a method that begins now."""
        return SolveOptions(self.tolerance, seconds_left(self.end))

    def judge(self, candidate: Candidate) -> Outcome:
        """Judge a candidate; if no proof is asked for, an optimum is what the solver claims."""
        if not self.proof and candidate.status == Status.OPTIMAL and candidate.multipliers is not None:
            point, seconds = (candidate.trajectory, candidate.multipliers), {**candidate.seconds, "certify": 0.0}
            return Outcome(self.problem, candidate.status, self.method, self.backend, seconds, *point)
        outcome = judge_candidate(self.problem, candidate, self.method, self.backend, self.tolerance)
        self.certified += outcome.seconds["certify"]
        return replace(outcome, seconds={**outcome.seconds, "certify": self.certified})

    def judge_guess(self, guess: Candidate) -> Outcome | Attempt:
        """Judge the answer of a warm start, which counts only if it is proven."""
        outcome = self.judge(guess)
        return outcome if outcome.attempt.reason is Reason.PROVEN else outcome.attempt

    def judge_point(self, candidate: Candidate) -> Outcome:
        """Judge a candidate, or a direction of descent instead if nothing bounds the cost from below.

        Without a finite optimum, a point where the solver stopped may satisfy the conditions relative to its own size.
        """
        outcome = self._judge_unbounded(candidate) if candidate.status == Status.UNBOUNDED else self.judge(candidate)
        out_of_steps = outcome.status == Status.LIMIT and not outcome.interrupted and now() <= self.end
        if outcome.attempt.reason not in UNPROVEN_POINTS and not out_of_steps:
            return outcome
        try:
            if self.direction is None:
                return outcome
            proof = self._judge_unbounded(replace(self.direction, seconds=candidate.seconds))
        except UnsupportedError:  # the program does not fit into memory
            return outcome
        return take_best([proof, outcome] if out_of_steps else [outcome, proof])

    @cached_property
    def direction(self) -> Candidate | None:
        """Look for a verified direction of descent of the problem, once for all candidates; None without one."""
        along = steepest_recession(self.problem)
        found = None if along is None else verified_direction(self.problem, along)
        return None if found is None else Candidate(Status.UNBOUNDED, descent=Trajectory(found.x, found.u))

    def _judge_unbounded(self, candidate: Candidate) -> Outcome:
        """Judge a direction of descent, which proves something if the problem without its cost has a trajectory."""
        without_cost = self.problem.derived(cost=QuadraticCost())
        options = SolveOptions(time_limit=seconds_left(self.end))
        if is_long(self.problem):
            found = solve_long(self.problem.derived(cost=distance_cost(self.problem)), options) or candidate
        else:
            found = solve_convex(without_cost, PROVER, options)
        outcome = self.judge(replace(found if found.status in CLAIMS else candidate, seconds=candidate.seconds))
        return replace(outcome, has_trajectory=judge_candidate(without_cost, found, PROVER, None, None).primal)

    def reject_ends(self) -> Iterator[Outcome]:
        """Yield the proof that an end lies outside its set, if it does."""
        ray = contradiction_at_ends(self.problem)
        if ray is not None:
            yield self.judge(Candidate(Status.INFEASIBLE, ray=ray, message="an end lies outside the state set"))


class _Linear(ABC):
    """A method for linear dynamics; it begins only if no end lies outside its set."""

    tolerance: float | None
    shorthand: ClassVar[str]
    takes_start: ClassVar[bool] = False

    def solve(self, problem: OptimalControlProblem, request: Request) -> Outcome:
        """Solve the problem, and judge the answer."""
        trial = _Trial(problem, self.shorthand, self.tolerance, now() + request.time_limit, proof=request.proof)
        with activity_step(f"method {self.shorthand}"):
            return take_best(chain(trial.reject_ends(), self._answers(trial, request)), ANSWERS)

    @abstractmethod
    def _answers(self, trial: _Trial, request: Request) -> Iterator[Outcome | Attempt]: ...


@dataclass(frozen=True)
class Convex(_Linear):
    """One sparse convex program for a solver (linear dynamics).

    Attributes
    ----------
    backend : str
        "auto" (Clarabel), "clarabel", "osqp" or "qpsolvers:NAME".
    tolerance : float, optional
        Relative residuals asked of the solver, on a program scaled to order 1. Above 1e-6, the judge allows as much,
        up to 1e-2.

    Examples
    --------
    >>> lfo.solve(lfo.library.double_integrator(), lfo.solvers.Convex(backend="clarabel")).solver
    'convex, clarabel'
    """

    backend: str = "auto"
    tolerance: float | None = None

    shorthand: ClassVar[str] = "convex"

    def _answers(self, trial: _Trial, request: Request) -> Iterator[Outcome]:
        backend = trial.backend = PROVER if self.backend == "auto" else self.backend
        programs = None if request.cached is None else request.cached[0].programs
        candidates = convex_candidates(trial.problem, backend, trial.options, programs)
        first = next(candidates)
        if first.status not in (Status.OPTIMAL, Status.LIMIT) and backend != PROVER:
            claim = solve_convex(trial.problem, PROVER, SolveOptions(time_limit=seconds_left(trial.end)))
            first = claim if claim.status in CLAIMS else first  # at the default tolerance
        yield from map(trial.judge_point, chain([first], candidates))


@dataclass(frozen=True)
class Spectral(_Linear):
    """The Fourier-domain method (linear time-invariant dynamics; docs/spectral.md).

    Attributes
    ----------
    tolerance : float, optional
        Relative violation of bounds to stop at. Above 1e-6, the judge allows as much, up to 1e-2.

    Examples
    --------
    >>> lfo.solve(lfo.library.double_integrator(), lfo.solvers.Spectral()).solver
    'spectral'
    """

    tolerance: float | None = None

    shorthand: ClassVar[str] = "spectral"

    def _answers(self, trial: _Trial, request: Request) -> Iterator[Outcome | Attempt]:
        if request.cached is None:
            yield trial.judge_point(solve_spectral(trial.problem, trial.options))
            return
        cache, change = request.cached
        condensed = cache.condensed(trial.problem, change) if self.tolerance is None else None
        if condensed is not None:
            yield replace(trial, method=CONDENSED).judge_guess(condensed)
        yield trial.judge_point(cache.solve(trial.problem, change, trial.options))


@dataclass(frozen=True)
class Structured(_Linear):
    """An interior-point method over stages and frequencies (linear dynamics; docs/structured.md).

    Attributes
    ----------
    tolerance : float, optional
        Relative residuals and gap to stop at; 1e-10 and 1e-9 by default. Above 1e-6, the judge allows as much, up to
        1e-2.

    Examples
    --------
    >>> lfo.solve(lfo.library.double_integrator(), lfo.solvers.Structured()).solver
    'structured'
    """

    tolerance: float | None = None

    shorthand: ClassVar[str] = "structured"

    def _answers(self, trial: _Trial, request: Request) -> Iterator[Outcome | Attempt]:
        # few problems need its modules
        from lin_freq_ocp.methods.structured.solver import StageCache, solve_from_warm_start, solve_structured

        problem = trial.problem
        stage_cache = StageCache() if request.cached is None else request.cached[0].stage_cache
        guess = solve_from_warm_start(problem, stage_cache, trial.options)
        if guess is not None:
            yield trial.judge_guess(guess)

        def accept_ray(ray: Multipliers) -> bool:
            proof = prove_infeasible(problem, ray)
            return proof is not None and proof.bound.kind == RIGOROUS

        candidates = solve_structured(problem, trial.options, accept_ray, stage_cache=stage_cache)
        yield from map(trial.judge_point, candidates)

    def solve(self, problem: OptimalControlProblem, request: Request) -> Outcome:
        """Solve the problem, and judge the answer; an optimum is the warm start of the next solve."""
        outcome = super().solve(problem, request)
        if outcome.status == Status.OPTIMAL and request.cached is not None:
            request.cached[0].stage_cache.warm_start = outcome.trajectory
        return outcome


@dataclass(frozen=True)
class LinearAuto:
    """The Fourier-domain method if it applies and its answer is proven; otherwise the structured or the sparse one.

    ``structured_first`` says which of these two comes first, by measured times; the other follows if the answer of the
    first one is not proven. ``result.reason`` says why the method was chosen.

    Attributes
    ----------
    tolerance : float, optional
        As for ``Spectral``, ``Structured`` and ``Convex``.
    backend : str
        If not "auto": the sparse program with this solver.
    """

    tolerance: float | None = None
    backend: str = "auto"

    shorthand: ClassVar[str] = "auto"
    takes_start: ClassVar[bool] = False

    def solve(self, problem: OptimalControlProblem, request: Request) -> Outcome:
        """Solve with one method after another until an answer is proven."""
        if self.backend != "auto":
            return Convex(self.backend, self.tolerance).solve(problem, request)
        best = take_best(self._answers(problem, request))
        first = best.method in (Spectral.shorthand, CONDENSED)
        return replace(best, reason=CHOSEN_FIRST if first else _explain_choice(problem, best))

    def _answers(self, problem: OptimalControlProblem, request: Request) -> Iterator[Outcome | Attempt]:
        """Yield the answers of the methods in turn, and what those say that do not take the problem."""
        end = now() + request.time_limit
        for method in self._methods(problem):
            try:
                yield (outcome := method.solve(problem, request.with_end(end)))
                if outcome.attempt.reason in ANSWERS and is_long(problem):
                    return  # the sparse program would take minutes, and its bound is the same
            except UnsupportedError as error:
                yield Attempt(method.shorthand, None, Reason.REFUSED, str(error))

    def _methods(self, problem: OptimalControlProblem) -> Iterator[Method]:
        """Yield the methods in turn; the order of the last two takes time to find."""
        yield Spectral(self.tolerance)
        methods: list[Method] = [Convex(self.backend, self.tolerance)]
        if problem.response is None:  # there are stages
            methods.insert(0 if structured_first(problem) else 1, Structured(self.tolerance))
        yield from methods


def _explain_choice(problem: OptimalControlProblem, best: Outcome) -> str:
    """Return why a method follows the Fourier-domain method."""
    before = list(takewhile(lambda attempt: attempt.method != best.method, best.attempts))
    ended = [attempt for attempt in reversed(before) if attempt.status is not None]
    if ended:
        last = max(ended, key=lambda attempt: attempt.reason)
        return f"{last.method} ended as {last.status}"
    refusal, large = before[0].message, structured_first(problem) if best.method == Structured.shorthand else ""
    why = refusal.removeprefix("method 'spectral': ").removesuffix(" Use method 'convex'.").rstrip(".")
    return f"the Fourier-domain method does not take it ({why}){'; ' * bool(large)}{large}"
