"""The methods for linear dynamics: the Fourier-domain method, one sparse convex program, and both in turn."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.bound import NUMERICAL, RIGOROUS
from lin_freq_ocp.certificate.rays import DIRECTION_TOLERANCE, proof_margin, prove_infeasible, unbounded_direction
from lin_freq_ocp.methods.candidate import Candidate, SolveOptions, contradiction_at_ends
from lin_freq_ocp.methods.convex.polish import steepest_recession
from lin_freq_ocp.methods.convex.sparse_program import (
    convex_candidates,
    free_of_cost,
    free_of_slope,
    solve_convex,
    structured_first,
)
from lin_freq_ocp.methods.structured.solver import Prepared, solve_again, solve_structured
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sizes import stated_sizes
from lin_freq_ocp.problem.trajectory import Multipliers
from lin_freq_ocp.solving.judging import judged
from lin_freq_ocp.solving.kept import solve_spectral
from lin_freq_ocp.solving.method import Method, Request, seconds_left
from lin_freq_ocp.solving.outcome import Outcome

PROVER = "clarabel"  # The backend that proves infeasibility and unboundedness, whichever backend met it

SMALL_MARGIN = 1e-5
"""Margin of an infeasibility proof below which rounding of the data may be its reason: the sparse program may find a
point that satisfies every constraint within the judge's tolerance."""

REPLACED_VIOLATION = 1e-8
"""Violation, relative to its scale, up to which an answer may replace one with less: what accurate solvers leave."""

PROVEN = (Status.OPTIMAL, Status.INFEASIBLE, Status.UNBOUNDED)

# Statuses of a first candidate after which the further ones are judged
UNPROVEN = (Status.NUMERICAL_ERROR, Status.INFEASIBLE_CLAIMED)


@dataclass(frozen=True, eq=False)
class _Trial:
    """One solve of a problem by a method, with the tolerance asked for and the time when it ends: what it is judged by.

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

    @property
    def options(self) -> SolveOptions:
        """Return what is asked of a method that begins now."""
        return SolveOptions(self.tolerance, seconds_left(self.end))

    def judge(self, candidate: Candidate) -> Outcome:
        """Judge a candidate as it stands."""
        return judged(self.problem, candidate, self.method, self.backend, self.tolerance)

    def judge_point(self, candidate: Candidate) -> Outcome:
        """Judge a candidate, and a direction of descent in its place where its trajectory is far beyond the data.

        The conditions of such a point hold relative to its own size, and its bound proves nothing: of a problem without
        a finite optimum it says where the solver stopped.
        """
        if candidate.status == "unbounded":
            candidate = self._contradiction() or candidate
        outcome = self.judge(candidate)
        if _rank(outcome) == 2 or outcome.interrupted or not (candidate.status == "unbounded" or _is_far(outcome)):
            return outcome
        try:
            along = steepest_recession(self.problem)
            if along is None or unbounded_direction(self.problem, along) is None:
                return outcome
            claim = self._contradiction() or replace(candidate, status="unbounded", descent=along)
        except UnsupportedError:  # the program does not fit into memory
            return outcome
        found = self.judge(replace(claim, trajectory=None, multipliers=None))
        return found if _rank(found) == 2 else outcome

    def diagnose(self, problem: OptimalControlProblem) -> Candidate | None:
        """Return the claim of the prover, at its own tolerance, that a problem is infeasible or unbounded, or None."""
        claim = solve_convex(problem, PROVER, SolveOptions(time_limit=seconds_left(self.end)))
        return claim if claim.status in ("infeasible", "unbounded") else None

    def _contradiction(self) -> Candidate | None:
        """Return the prover's claim that the problem is infeasible, whatever its cost."""
        return self.diagnose(replace(self.problem, cost=QuadraticCost()))

    def exclusion_at_ends(self) -> Outcome | None:
        """Return the outcome with the proof that an end lies outside its set, or None."""
        ray = contradiction_at_ends(self.problem)
        if ray is None:
            return None
        claim = Candidate("infeasible", ray=ray, message="an end lies outside the state set")
        outcome = self.judge(claim)
        return outcome if outcome.status == Status.INFEASIBLE else None

    def at_no_cost(self, outcome: Outcome) -> Outcome:
        """Return the outcome of a trajectory nearby without cost or slope, if that is optimal, else the outcome."""
        problem, near = self.problem, outcome.trajectory
        if outcome.status not in (Status.LOCALLY_OPTIMAL, Status.NUMERICAL_ERROR) or near is None:
            return outcome
        for candidate in (free_of_cost(problem, near), free_of_slope(problem, near, seconds_left(self.end))):
            if candidate is not None:
                found = self.judge(candidate)
                if found.status == Status.OPTIMAL and not _violates_more(found, outcome):
                    return replace(found, seconds=outcome.seconds)
        return outcome

    def with_proof(self, outcome: Outcome) -> Outcome:
        """Return Clarabel's proof of infeasibility or unboundedness, if it has one, else the outcome."""
        try:
            claim = self.diagnose(self.problem)
        except UnsupportedError:  # it does not fit into memory
            return outcome
        found = outcome if claim is None else self.judge(claim)
        return found if _rank(found) == 2 else outcome


class _Linear(ABC):
    """A method for linear dynamics: an end outside its set is found before it begins."""

    tolerance: float | None
    shorthand: ClassVar[str]
    takes_start: ClassVar[bool] = False

    def solve(self, problem: OptimalControlProblem, request: Request) -> Outcome:
        """Solve the problem, and judge the answer."""
        trial = _Trial(problem, self.shorthand, self.tolerance, now() + request.time_limit)
        excluded = trial.exclusion_at_ends()
        return self._solve(trial, request) if excluded is None else excluded

    @abstractmethod
    def _solve(self, trial: _Trial, request: Request) -> Outcome: ...


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

    def _solve(self, trial: _Trial, request: Request) -> Outcome:
        backend = PROVER if self.backend == "auto" else self.backend
        trial = replace(trial, backend=backend)
        programs = None if request.again is None else request.again[0].programs
        candidates = convex_candidates(trial.problem, backend, trial.options, programs)
        first = next(candidates)
        if first.status not in ("optimal", "limit") and backend != PROVER:
            first = trial.diagnose(trial.problem) or first
        outcome = trial.at_no_cost(trial.judge_point(first))
        unproven = outcome.status in UNPROVEN or _only_practical(outcome)
        if outcome.interrupted or not (unproven or (backend == PROVER and _at_odds(outcome))):
            return outcome
        for other in map(trial.judge_point, candidates):
            accepted = other.interrupted or (_rank(other) > 0 and not _at_odds(other))
            if accepted and not _only_practical(other):
                return other
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

    def _solve(self, trial: _Trial, request: Request) -> Outcome:
        if request.again is None:
            return trial.judge_point(solve_spectral(trial.problem, trial.options))
        kept, change = request.again
        condensed = kept.condensed(trial.problem, change) if self.tolerance is None else None
        if condensed is not None:
            outcome = replace(trial, method="condensed").judge(condensed)
            if outcome.status == Status.OPTIMAL:  # what is not proven is solved by the method itself
                return outcome
        return trial.judge_point(kept.spectral(trial.problem, change, trial.options))


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

    def _solve(self, trial: _Trial, request: Request) -> Outcome:
        problem, first, doubtful, certified = trial.problem, None, False, 0.0
        prepared = Prepared() if request.again is None else request.again[0].prepared
        again = solve_again(problem, prepared, trial.options)
        if again is not None:
            outcome = trial.judge(again)
            if outcome.status == Status.OPTIMAL and _final(outcome):  # what is not proven is solved from scratch
                prepared.near = outcome.trajectory
                return outcome

        def excludes(ray: Multipliers) -> bool:  # rigorously, and not by a margin of rounding
            proof = prove_infeasible(problem, ray)
            return proof is not None and proof.bound.kind == RIGOROUS and proof_margin(problem, ray) > SMALL_MARGIN

        for candidate in solve_structured(problem, trial.options, excludes, prepared=prepared):
            doubtful = candidate.status in ("unbounded", "numerical_error")
            outcome = trial.judge_point(candidate)
            certified += outcome.seconds["certify"]
            if first is None or _rank(outcome) > _rank(first):
                first = outcome
            if _final(outcome):
                break
        assert first is not None  # there is an answer
        if first.status == Status.OPTIMAL:
            prepared.near = first.trajectory
        first = replace(first, seconds=first.seconds | {"certify": certified})
        if doubtful and _rank(first) < 2 and not first.interrupted:  # such as a direction that is not exactly flat
            first = trial.with_proof(first)
        return trial.at_no_cost(first)


@dataclass(frozen=True)
class LinearAuto:
    """The Fourier-domain method where it applies and its answer is proven, else the structured or the sparse one.

    Which of these two comes first is measured (``structured_first``); the other is tried where that ends without an
    answer. ``result.reason`` says why the method was taken.

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
        """Solve with the methods in turn until an answer is proven."""
        if self.backend != "auto":
            return Convex(self.backend, self.tolerance).solve(problem, request)
        end = now() + request.time_limit
        best: Outcome | None = None
        refusals = list[str]()
        for method in self._in_turn(problem):
            try:
                outcome = method.solve(problem, request.until(end))
            except UnsupportedError as error:
                refusals += [] if str(error) in refusals else [str(error)]
                continue
            if best is None or _better(outcome, best):
                best = replace(outcome, reason=_why(problem, method, refusals, best))
            if _final(outcome) or (_rank(best) > 0 and not isinstance(method, Spectral)):
                break
        if best is None:
            raise UnsupportedError(" Before that: ".join(reversed(refusals)))
        return best

    def _in_turn(self, problem: OptimalControlProblem) -> Iterator[Method]:
        yield Spectral(self.tolerance)
        convex, structured = Convex(self.backend, self.tolerance), Structured(self.tolerance)
        if problem.dynamics.response(problem.horizon) is not None:  # there are no stages
            yield convex
            return
        yield from (structured, convex) if structured_first(problem) else (convex, structured)


def _why(problem: OptimalControlProblem, method: Method, refusals: list[str], before: Outcome | None) -> str:
    """Return why the answer of a method is taken."""
    if before is not None:
        return f"{before.method} ended as {before.status}"
    if isinstance(method, Spectral):
        return "time-invariant dynamics, with constraints that the Fourier-domain method takes"
    large = structured_first(problem) if isinstance(method, Structured) else ""
    return "; ".join([*refusals[:1], *([large] if large else [])])


def _better(outcome: Outcome, best: Outcome) -> bool:
    """Whether an answer replaces that of a method before it."""
    # it satisfies all constraints where a numerical ray said that no trajectory of practical size does
    refutes = _only_practical(best) and outcome.status == Status.LOCALLY_OPTIMAL and outcome.primal
    if best.status == Status.INFEASIBLE and (outcome.status == Status.OPTIMAL or refutes):
        return True
    counts = outcome.status != Status.LIMIT and not _only_practical(outcome)
    return counts and _rank(outcome) >= _rank(best) and not _violates_more(outcome, best)


def _violates_more(outcome: Outcome, best: Outcome) -> bool:
    """Whether an answer violates constraints by more, and not by rounding, than a feasible one before it."""
    if outcome.certificate is None or best.certificate is None or not best.certificate.feasible:
        return False
    return outcome.certificate.violation > max(best.certificate.violation, REPLACED_VIOLATION)


def _final(outcome: Outcome) -> bool:
    """Whether no other method is tried after this outcome: it is proven, or the time is over."""
    certificate = outcome.certificate
    proven = outcome.status == Status.OPTIMAL and certificate is not None and certificate.pmp == "satisfied"
    excluded = outcome.status == Status.INFEASIBLE and outcome.bound == RIGOROUS
    if excluded and outcome.ray is not None:
        excluded = proof_margin(outcome.problem, outcome.ray) > SMALL_MARGIN
    return proven or outcome.interrupted or excluded or outcome.status == Status.LIMIT


def _only_practical(outcome: Outcome) -> bool:
    """Whether infeasibility is proven of trajectories of practical size alone."""
    return outcome.status == Status.INFEASIBLE and outcome.bound == NUMERICAL


def _rank(outcome: Outcome) -> int:
    """2 for proven outcomes, 1 for local optima, 0 for others."""
    return 2 if outcome.status in PROVEN else int(outcome.status == Status.LOCALLY_OPTIMAL)


def _at_odds(outcome: Outcome) -> bool:
    """Whether a trajectory is proven optimal while its multipliers fail a condition: others satisfy it."""
    certificate = outcome.certificate
    return outcome.status == Status.OPTIMAL and certificate is not None and certificate.pmp != "satisfied"


def _is_far(outcome: Outcome) -> bool:
    """Whether a trajectory is so large that, as a direction, it is as near to all constraints as one must be.

    Numbers that are no longer finite are.
    """
    at = outcome.trajectory
    if at is None or outcome.status == Status.LIMIT:
        return outcome.status == Status.NUMERICAL_ERROR
    sizes = zip((at.x, at.u), stated_sizes(outcome.problem), strict=True)
    return max(float((np.abs(signal).max(0) / size).max()) for signal, size in sizes) > 1 / DIRECTION_TOLERANCE
