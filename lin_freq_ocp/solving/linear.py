"""The methods for linear dynamics: Fourier-domain, structured, one sparse convex program, and these in turn."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

from lin_freq_ocp.base.clock import now, seconds_left
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.bound import RIGOROUS
from lin_freq_ocp.certificate.rays import proof_margin, prove_infeasible
from lin_freq_ocp.methods.candidate import Candidate, SolveOptions, contradiction_at_ends
from lin_freq_ocp.methods.convex.polish import steepest_recession
from lin_freq_ocp.methods.convex.sparse_program import (
    convex_candidates,
    solve_convex,
    structured_first,
    trajectory_without_cost,
)
from lin_freq_ocp.methods.structured.solver import StageCache, solve_from_warm_start, solve_structured
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.solving.judging import judge_candidate, verified_direction
from lin_freq_ocp.solving.method import Method, Request
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solver_cache import solve_spectral

PROVER = "clarabel"  # the backend that proves infeasibility and unboundedness that any backend reports

SMALL_MARGIN = 1e-5
"""Margin of an infeasibility proof below which rounding of the data may explain it: the sparse program may still find a
point that satisfies every constraint within the judge's tolerance."""

PROVEN = (Status.OPTIMAL, Status.INFEASIBLE, Status.UNBOUNDED)

# statuses of a first candidate after which further candidates are judged
UNPROVEN = (Status.NUMERICAL_ERROR, Status.INFEASIBLE_CLAIMED)

# statuses of a point that may lie on the way along a direction without bound; a limit is one of iterations
SEEKS_DIRECTION = (Status.NUMERICAL_ERROR, Status.LOCALLY_OPTIMAL, Status.LIMIT)


@dataclass(frozen=True, eq=False)
class _Trial:
    """One solve of a problem by a method, with its tolerance and its deadline; it judges the candidates of the method.

    Parameters
    ----------
    end : float
        By ``clock.now``; inf without a time limit.
    """

    problem: OptimalControlProblem
    method: str
    tolerance: float | None
    end: float
    backend: str | None = None
    proof: bool = True

    @property
    def options(self) -> SolveOptions:
        """Return the options of a method that begins now."""
        return SolveOptions(self.tolerance, seconds_left(self.end))

    def judge(self, candidate: Candidate) -> Outcome:
        """Judge a candidate; if no proof is asked for, an optimum is what the solver claims."""
        if not self.proof and candidate.status == Status.OPTIMAL and candidate.multipliers is not None:
            point, seconds = (candidate.trajectory, candidate.multipliers), {**candidate.seconds, "certify": 0.0}
            return Outcome(self.problem, candidate.status, self.method, self.backend, seconds, *point)
        return judge_candidate(self.problem, candidate, self.method, self.backend, self.tolerance)

    def judge_point(self, candidate: Candidate) -> Outcome:
        """Judge a candidate, or a direction of descent instead if nothing bounds the cost from below.

        Without a finite optimum, a point where the solver stopped may satisfy the conditions relative to its own size.
        """
        if candidate.status == Status.UNBOUNDED:
            candidate = self._contradiction() or candidate
        outcome = self.judge(candidate)
        stopped = outcome.interrupted or now() > self.end
        if outcome.status not in SEEKS_DIRECTION or stopped or _is_bounded(outcome):
            return outcome
        try:
            along = steepest_recession(self.problem)
            direction = None if along is None else verified_direction(self.problem, along)
            if direction is None:
                return outcome
            descent = Trajectory(direction.x, direction.u)
            claim = self._contradiction() or replace(candidate, status=Status.UNBOUNDED, descent=descent)
        except UnsupportedError:  # the program does not fit into memory
            return outcome
        proof = self.judge(replace(claim, trajectory=None, multipliers=None))
        return proof if _rank(proof) == 2 or proof.infeasibility is not None else outcome

    def diagnose(self, problem: OptimalControlProblem) -> Candidate | None:
        """Return the prover's claim that a problem is infeasible or unbounded, or None, at the default tolerance."""
        claim = solve_convex(problem, PROVER, SolveOptions(time_limit=seconds_left(self.end)))
        return claim if claim.status in (Status.INFEASIBLE, Status.UNBOUNDED) else None

    def _contradiction(self) -> Candidate | None:
        """Return the prover's claim that the problem has no trajectory, by the problem without its cost."""
        return self.diagnose(replace(self.problem, cost=QuadraticCost()))

    def reject_ends(self) -> Outcome | None:
        """Return the outcome with the proof that an end lies outside its set, or None."""
        ray = contradiction_at_ends(self.problem)
        if ray is None:
            return None
        claim = Candidate(Status.INFEASIBLE, ray=ray, message="an end lies outside the state set")
        outcome = self.judge(claim)
        return outcome if outcome.status == Status.INFEASIBLE else None

    def try_without_cost(self, outcome: Outcome) -> Outcome:
        """Return the outcome of the trajectory nearby without cost if that is optimal, else the outcome."""
        if outcome.status not in SEEKS_DIRECTION or outcome.trajectory is None or now() > self.end:
            return outcome
        candidate = trajectory_without_cost(self.problem, outcome.trajectory)
        optimum = None if candidate is None else self.judge(candidate)
        if optimum is None or optimum.status != Status.OPTIMAL:
            return outcome
        return replace(optimum, seconds=outcome.seconds)


class _Linear(ABC):
    """A method for linear dynamics; it begins only if no end lies outside its set."""

    tolerance: float | None
    shorthand: ClassVar[str]
    takes_start: ClassVar[bool] = False

    def solve(self, problem: OptimalControlProblem, request: Request) -> Outcome:
        """Solve the problem, and judge the answer."""
        trial = _Trial(problem, self.shorthand, self.tolerance, now() + request.time_limit, proof=request.proof)
        return trial.reject_ends() or self._run(trial, request)

    @abstractmethod
    def _run(self, trial: _Trial, request: Request) -> Outcome: ...


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

    def _run(self, trial: _Trial, request: Request) -> Outcome:
        backend = PROVER if self.backend == "auto" else self.backend
        trial = replace(trial, backend=backend)
        programs = None if request.cached is None else request.cached[0].programs
        candidates = convex_candidates(trial.problem, backend, trial.options, programs)
        first = next(candidates)
        if first.status not in (Status.OPTIMAL, Status.LIMIT) and backend != PROVER:
            first = trial.diagnose(trial.problem) or first
        outcome = trial.try_without_cost(trial.judge_point(first))
        unproven = outcome.status in UNPROVEN
        if outcome.interrupted or not (unproven or (backend == PROVER and _fails_conditions(outcome))):
            return outcome
        for further in map(trial.judge_point, candidates):
            if further.interrupted or (_rank(further) > 0 and not _fails_conditions(further)):
                return further
        return outcome


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

    def _run(self, trial: _Trial, request: Request) -> Outcome:
        if request.cached is None:
            return trial.judge_point(solve_spectral(trial.problem, trial.options))
        cache, change = request.cached
        condensed = cache.condensed(trial.problem, change) if self.tolerance is None else None
        if condensed is not None:
            outcome = replace(trial, method="condensed").judge(condensed)
            # what is not proven is solved by the method itself
            if outcome.status == Status.OPTIMAL or (outcome.status == Status.INFEASIBLE and _is_final(outcome)):
                return outcome
        return trial.judge_point(cache.solve(trial.problem, change, trial.options))


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

    def _run(self, trial: _Trial, request: Request) -> Outcome:
        problem, first, certified = trial.problem, None, 0.0
        stage_cache = StageCache() if request.cached is None else request.cached[0].stage_cache
        candidate = solve_from_warm_start(problem, stage_cache, trial.options)
        if candidate is not None:
            outcome = trial.judge(candidate)
            if outcome.status == Status.OPTIMAL and _is_final(outcome):  # otherwise the embedding solves the problem
                stage_cache.warm_start = outcome.trajectory
                return outcome

        def accept_ray(ray: Multipliers) -> bool:
            proof = prove_infeasible(problem, ray)
            return proof is not None and proof.bound.kind == RIGOROUS and proof_margin(problem, ray) > SMALL_MARGIN

        for candidate in solve_structured(problem, trial.options, accept_ray, stage_cache=stage_cache):
            outcome = trial.judge_point(candidate)
            certified += outcome.seconds["certify"]
            if first is None or _rank(outcome) > _rank(first):
                first = outcome
            if _is_final(outcome):
                break
        assert first is not None  # the method yields an answer, or raises
        if first.status == Status.OPTIMAL:
            stage_cache.warm_start = first.trajectory
        return trial.try_without_cost(replace(first, seconds=first.seconds | {"certify": certified}))


@dataclass(frozen=True)
class LinearAuto:
    """The Fourier-domain method if it applies and its answer is proven; otherwise the structured or the sparse one.

    ``structured_first`` says which of these two comes first, by measured times; the other follows if the first one ends
    without an answer. ``result.reason`` says why the method was chosen.

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
        end = now() + request.time_limit
        best: Outcome | None = None
        refusals = list[str]()
        for method in self._order_methods(problem):
            try:
                outcome = method.solve(problem, request.with_end(end))
            except UnsupportedError as error:
                refusals += [] if str(error) in refusals else [str(error)]
                continue
            if best is None or _is_better(outcome, best):
                if best is not None:
                    reason = f"{best.method} ended as {best.status}"
                elif isinstance(method, Spectral):
                    reason = "time-invariant dynamics, with constraints that the Fourier-domain method takes"
                else:
                    large = structured_first(problem) if isinstance(method, Structured) else ""
                    why = (
                        refusals[0]
                        .removeprefix("method 'spectral': ")
                        .removesuffix(" Use method 'convex'.")
                        .rstrip(".")
                    )
                    reason = f"the Fourier-domain method does not take it ({why}){'; ' * bool(large)}{large}"
                best = replace(outcome, reason=reason)
            if _is_final(outcome) or (_rank(best) > 0 and not isinstance(method, Spectral)):
                break
        if best is None:
            raise UnsupportedError(" Before that: ".join(reversed(refusals)))
        return best

    def _order_methods(self, problem: OptimalControlProblem) -> Iterator[Method]:
        """Yield the methods in the order in which they are tried."""
        yield Spectral(self.tolerance)
        convex, structured = Convex(self.backend, self.tolerance), Structured(self.tolerance)
        if problem.form.response(problem.horizon) is not None:  # there are no stages
            yield convex
            return
        yield from (structured, convex) if structured_first(problem) else (convex, structured)


def _is_better(outcome: Outcome, best: Outcome) -> bool:
    """Whether an answer replaces that of the method before."""
    if best.status == Status.INFEASIBLE and outcome.status == Status.OPTIMAL:
        return True
    # a claim with a ray says how far it holds; a failed solve refutes it by a feasible point only
    fails = best.infeasibility is not None and outcome.status in UNPROVEN and not outcome.primal
    counts = outcome.status != Status.LIMIT and not fails
    return counts and _rank(outcome) >= _rank(best)


def _is_final(outcome: Outcome) -> bool:
    """Whether no other method follows this outcome: it is proven, or the time is over."""
    satisfied = outcome.certificate is None or outcome.certificate.pmp == "satisfied"
    proven = outcome.status == Status.OPTIMAL and outcome.multipliers is not None and satisfied
    excluded, ray = outcome.status == Status.INFEASIBLE and outcome.bound == RIGOROUS, outcome.ray
    excluded = excluded and (ray is None or proof_margin(outcome.problem, ray) > SMALL_MARGIN)
    return proven or outcome.interrupted or excluded or outcome.status == Status.LIMIT


def _rank(outcome: Outcome) -> int:
    """Return 2 for proven outcomes, 1 for local optima, 0 for others."""
    return 2 if outcome.status in PROVEN else int(outcome.status == Status.LOCALLY_OPTIMAL)


def _fails_conditions(outcome: Outcome) -> bool:
    """Whether a trajectory is proven optimal, but its multipliers fail a condition that others satisfy."""
    certificate = outcome.certificate
    return outcome.status == Status.OPTIMAL and certificate is not None and certificate.pmp != "satisfied"


def _is_bounded(outcome: Outcome) -> bool:
    """Whether a rigorous bound excludes that the cost decreases without bound."""
    bound = None if outcome.certificate is None else outcome.certificate.bound
    return bound is not None and bound.kind == RIGOROUS and bound.value > -float("inf")
